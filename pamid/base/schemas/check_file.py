"""JSON of `pamid check` for a recording, a rig file or an effect file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from pamid.base.schemas.estimates import UNIT
from pamid.base.schemas.model import (
    MAY_LACK,
    Count,
    Flag,
    ListOf,
    MapOf,
    Model,
    Number,
    Pair,
    Sometimes,
    Text,
)


class Finding(Model):
    """A check with its outcome."""

    check: Text
    ok: Flag
    advice: Flag = Field(description="worth knowing, no error")
    detail: Text


class Column(Model):
    """Content of a column of the recording, in its unit."""

    unit: Text = Field(description=UNIT)
    low: Number
    high: Number
    mean: Number
    rest_value: Number = Field(description="level of the rest at the start")
    rest_s: Number = Field(description="length of that rest, s")
    distinct_values: Count
    constant: Flag


class Quality(Model):
    """Span, step and noise of a signal, in its unit."""

    span: Number | None
    step: Number | None = Field(description="of its quantisation; 0 where none shows")
    noise: Number | None = Field(description="standard deviation")


class Issue(Model):
    """Something that the signals themselves show."""

    kind: Text = Field(description="a stable word for scripts")
    columns: ListOf[Text]
    severity: Literal["wrong", "advice"] = Field(description="wrong: any fit on it is nonsense")
    message: Text = Field(description="the finding")
    hint: Text = Field(description="remedy; empty if unknown")
    windows_s: ListOf[Pair] = Field(description="[begin, end] in s; empty for all of it")
    figures: dict[Text, Number] = Field(description="the numbers behind it, by name with unit")


class SignalQuality(Model):
    """Quality of the signals."""

    channels: MapOf[Quality]
    issues: ListOf[Issue]


class BetweenSamples(Model):
    """An input tried both ways: held between samples, and linear to the next sample."""

    column: Text
    taken: Literal["held", "linear"] = Field(description="by rig or recording; held by default")
    stated: Flag = Field(description="whether rig or recording state it")
    better: Text = Field(
        description="the assumption that fits clearly better; empty if neither does"
    )
    channel: Text = Field(description="the output with the largest difference")
    rms_held: Number = Field(description="error over the windows, in its unit")
    rms_linear: Number = Field(description="as rms_held, for a linear input")
    windows: Count


class Unlocked(Model):
    """Effects that could act at a port if it offered these signals, too."""

    signals: ListOf[Text]
    effects: ListOf[Text]


class CheckedPort(Model):
    """A port of a rig file: what passes, its sign, and what can act there."""

    rig: Text
    port: Text
    kind: Text
    unit: Text = Field(description="SI, of the value; empty for none")
    signals: dict[Text, Text] = Field(description="offered there, with their SI units")
    passes: Text
    sign: Text = Field(description="direction of positive values")
    imposed: Flag = Field(description="whether an input imposes its position or velocity")
    size: dict[Text, Number] = Field(
        description="typical size stated by the rig, SI; else determined from data"
    )
    effects: ListOf[Text] = Field(description="effects that can act there")
    unlocks: ListOf[Unlocked] = Field(description="further effects by the signal that they need")


class CheckFile(
    Model,
    schema="pamid.check/1",
    title="pamid check: faults of a recording, a rig file or an effect file",
):
    """Faults of a recording, a rig file or an effect file."""

    file: Text = Field(description="its path")
    kind: Text = Field(description="recording, rig, effect, or python: neither of these")
    rigs: Sometimes[ListOf[Text]] = Field(default=None, description="names of the rigs in it")
    effects: Sometimes[ListOf[Text]] = Field(default=None, description="names of the effects in it")
    ports: Sometimes[ListOf[CheckedPort]] = Field(
        default=None, description="of the rigs in it, where their equations can be built"
    )
    samples: Sometimes[Count] = None
    duration_s: Sometimes[Number] = None
    sampling_period_s: Sometimes[Number] = None
    loop: Annotated[Text | None, MAY_LACK] = Field(
        default=None, description="closed if a controller produced the command, else open"
    )
    rig: Annotated[Text | None, MAY_LACK] = Field(default=None, description="rig of the check")
    known: Sometimes[dict[Text, Number]] = Field(default=None, description="by name with unit")
    controller: Sometimes[dict[Text, Number]] = Field(default=None, description="its settings")
    columns: Sometimes[MapOf[Column]] = Field(default=None, description="by name")
    quality: Sometimes[SignalQuality] = None
    between: Sometimes[ListOf[BetweenSamples]] = Field(
        default=None, description="inputs, simulated as held and as linear between samples"
    )
    ok: Flag = Field(description="whether every check passed, apart from advice")
    code: Sometimes[Text] = Field(default=None, description="of the error, if any")
    message: Sometimes[Text] = Field(default=None, description="the first fault")
    hint: Sometimes[Text] = None
    findings: ListOf[Finding] = Field(description="every check with its outcome")
    figure: Sometimes[Text] = Field(default=None, description="file of the picture")
