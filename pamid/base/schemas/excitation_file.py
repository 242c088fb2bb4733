"""JSON next to an excitation: its columns, and their coverage of amplitude and frequency."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, WithJsonSchema

from pamid.base.schemas.command_files import LOOP
from pamid.base.schemas.estimates import RIG, SEED, SHA256, UNIT
from pamid.base.schemas.model import MAY_LACK, Count, ListOf, Model, Number, Pair, Sometimes, Text


class ChangesCovered(Model):
    """Sizes and paces of the changes."""

    size_edges: ListOf[Number] = Field(description="of the bins, as shares of the range")
    pace_edges_hz: ListOf[Number] = Field(description="of the bins, Hz")
    share_of_time: ListOf[ListOf[Number]] = Field(description="size by pace, 0 to 1")


class SignalCoverage(Model):
    """Coverage of a signal."""

    evenness: Number = Field(description="1: every level equally often, 0: a single level")
    visited: Number = Field(description="share of the range, 0 to 1")
    steps: Count = Field(description="number of changes of level or direction")
    shortest_hold_s: Number
    longest_hold_s: Number
    power_95_hz: Number = Field(description="95 % of the power lies below")
    band_20db_hz: Pair = Field(description="within 20 dB of the strongest frequency")
    histogram: ListOf[Number] = Field(description="share of time in equal bins of the range")
    crest: Number = Field(description="highest deviation from the mean over the rms")
    library_condition: Number | None = Field(
        description="condition number of 1, v, v², v³; null if they are not independent"
    )
    even_condition: Number | None = Field(description="the same of 1 and v²")
    changes: ChangesCovered | None = Field(description="null of fewer than two changes")
    sentences: ListOf[Text] = Field(description="the same in words")


ColumnSeed = Annotated[
    Any, WithJsonSchema({"type": ["array", "integer", "null"], "items": {"type": "integer"}})
]


class SentColumn(Model):
    """A column, if several are excited."""

    column: Text
    unit: Text = Field(description=UNIT)
    range: Pair = Field(description="[low, high] in the unit of the column")
    seed: Annotated[ColumnSeed, MAY_LACK] = Field(default=None, description=SEED)
    part: Sometimes[Number] = Field(
        default=None, description="of the common sequence, at which it begins, 0 to 1"
    )
    coverage: Sometimes[SignalCoverage] = Field(default=None, description="coverage of the signal")


class CommandKept(Model):
    """Effect of a model's limits on a command."""

    column: Text
    factor: Number = Field(
        description="reduction of the requested signal about its centre, up to 1"
    )
    shift: Number = Field(description="of the centre, in the unit of the column")
    why: ListOf[Text] = Field(description="violated limits, in words")

    @property
    def changed(self) -> bool:
        return self.factor != 1.0 or self.shift != 0.0


class LimitsKept(Model):
    """Limits of a model, under which the signal was simulated first."""

    checked: ListOf[Text] = Field(description="checked limits, in words")
    commands: ListOf[CommandKept]
    reached: dict[Text, Pair] = Field(description="joint -> lowest and highest position, rad or m")


class ExcitationFile(
    Model, schema="pamid.excitation/1", title="JSON next to an excitation, and pamid generate-aprbs"
):
    """Excitation: a single column with the settings, or several in a list."""

    generator: Text = Field(description="program and version")
    file: Text | None = Field(description="name of the file that it describes")
    sha256: Text = Field(description=SHA256)
    rig: Text | None = Field(description=RIG)
    signal: Sometimes[Text] = None
    experiment: Sometimes[Text] = None
    loop: Annotated[Text | None, MAY_LACK] = Field(default=None, description=LOOP)
    column: Sometimes[Text] = None
    unit: Sometimes[Text] = Field(default=None, description=UNIT)
    range: Sometimes[Pair] = Field(default=None, description="[low, high] of the column")
    columns: Sometimes[ListOf[SentColumn]] = None
    muscles: Sometimes[ListOf[Text]] = Field(default=None, description="pulsed, in their order")
    level: Sometimes[Number] = Field(default=None, description="duty of the pulses")
    hold_s: Sometimes[Pair] = Field(default=None, description="shortest and longest hold, s")
    levels: Annotated[Count | None, MAY_LACK] = Field(
        default=None, description="number of levels; null for any value"
    )
    band_hz: Sometimes[Pair] = Field(default=None, description="lowest and highest frequency, Hz")
    periods: Sometimes[Count] = Field(default=None, description="equal ones in all")
    sweep: Sometimes[Text] = Field(default=None, description="log or linear")
    rate_limit_per_s: Annotated[Number | None, MAY_LACK] = Field(
        default=None, description="of the column, in its unit per s; null for none"
    )
    seed: Annotated[Count | None, MAY_LACK] = Field(default=None, description=SEED)
    known: Sometimes[dict[Text, Number]] = Field(
        default=None, description="settings of the rig, by name with unit"
    )
    sampling_period_s: Sometimes[Number] = None
    samples: Sometimes[Count] = Field(default=None, description="number of samples")
    coverage: Sometimes[SignalCoverage] = Field(default=None, description="coverage of the signal")
    limits: Sometimes[LimitsKept] = Field(
        default=None,
        description="of a MuJoCo or URDF model, and the changes of the signal for them",
    )
    format: Sometimes[Text] = Field(default=None, description="of the file, unless it is a CSV")
    interpolation: Sometimes[Text] = Field(
        default=None, description="interpolation between samples on the rig"
    )
