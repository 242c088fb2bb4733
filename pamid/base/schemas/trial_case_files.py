"""Cases of the blind trial: planted effects and results."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from pamid.base.schemas.command_files import ErrorFile
from pamid.base.schemas.estimates import HIGH, LOW, RIG, SEED, SHA256, FailedJob
from pamid.base.schemas.model import (
    MAY_LACK,
    Count,
    Flag,
    ListOf,
    MapOf,
    Model,
    Number,
    Sometimes,
    Text,
)

WORLD = "open where further effects act as well and maps and loggers are poor"


class ChannelForecast(Model):
    """Shrinkage of the error of a channel."""

    low: Number | None = Field(description=LOW)
    high: Number | None = Field(description=HIGH)
    predicted: Number | None
    achieved: Number | None = Field(description="on a fresh recording")


class ShrinkageForecast(ChannelForecast):
    """1 - error with the cause / error of the refitted model, in the channel with the largest gap:
    predicted, and achieved on a fresh recording."""

    channels: MapOf[ChannelForecast]


class PlantedTruth(Model):
    """Right answer to a planted fault."""

    fault: Text
    family: Text
    port: Text
    exact: ListOf[Text] = Field(description="effects that are the very same")


class ActingEffect(PlantedTruth):
    """An effect that acts in a case, with what it changes."""

    planted: Flag = Field(description="or a further, lesser effect")
    change: Number = Field(
        description="change of the held-out readings without it, as a root mean square "
        "in their standard deviations"
    )
    removes: Annotated[Number | None, MAY_LACK] = Field(
        default=None,
        description="share of the refitted model's held-out error that vanishes without it",
    )


class TrialCaseFile(Model, schema="pamid.trial-case/1", title="Result of a case of a trial"):
    """The result of a case."""

    case: Count = Field(description="its number")
    sha256: Text = Field(description="of the case and its label, hexadecimal")
    failed: ErrorFile | None = Field(description="the error, if there is no result")
    diagnosis: Sometimes[dict[Text, Any]] = Field(default=None, description="see pamid.diagnosis/3")
    seconds: Sometimes[Number] = Field(default=None, description="CPU time of the diagnosis, s")
    visibility: Annotated[Number | None, MAY_LACK] = Field(
        default=None,
        description="refitted error over that without the fault; null where nothing is planted",
    )
    visibility_each: Annotated[Number | None, MAY_LACK] = Field(
        default=None, description="of two faults, that of the less visible alone"
    )
    acting: Sometimes[ListOf[ActingEffect]] = Field(
        default=None, description="effects of an open case, the largest first"
    )
    shrinkage: Annotated[ShrinkageForecast | None, MAY_LACK] = Field(
        default=None, description="null without a cause, or where a model became unstable"
    )


class CaseLabel(Model):
    """Kind of a case, and its planted effects."""

    number: Count
    part: Text = Field(description="calibration or test")
    seed: Count | None = Field(description=SEED)
    stratum: Text
    planted: MapOf[dict[Text, Number]] = Field(description="fault -> its sizes")
    removed: ListOf[Text] = Field(description="effects removed from the catalogue")
    conditions: dict[Text, Any] = Field(description="of the recording and of the machine")
    rig: Text | None = Field(description=RIG)
    sha256: Text = Field(description=SHA256)
    truth: ListOf[PlantedTruth]
    bare: Sometimes[bool] = Field(
        default=None,
        description="whether the machine's tolerances were withheld from the diagnosis",
    )
    world: Sometimes[Text] = Field(default=None, description=WORLD)
    further: Sometimes[MapOf[dict[Text, Number]]] = Field(
        default=None, description="candidates for further effects -> sizes before they are scaled"
    )
    shares: Sometimes[ListOf[Number]] = Field(
        default=None,
        description="of further effects: change of the readings, in that by the planted effect",
    )


class TrialLabelsFile(
    Model,
    schema="pamid.trial-labels/1",
    title="labels.json: planted effects of the cases of a trial",
):
    """Labels, which only the scorer reads."""

    rig: Text | None = Field(description=RIG)
    part: Text = Field(description="calibration or test")
    seed: Count | None = Field(description=SEED)
    cases_sha256: Text = Field(description="digest of all cases")
    cases: ListOf[CaseLabel]
    bare: Sometimes[bool] = Field(
        default=None,
        description="whether the machine's tolerances were withheld from the diagnosis",
    )
    world: Sometimes[Text] = Field(default=None, description=WORLD)


class TrialShare(
    Model, schema="pamid.trial-share/1", title="pamid trial --index: the share of an array task"
):
    """Cases that a machine of many has completed."""

    index: Count = Field(description="of the share, from 1")
    of: Count = Field(description="number of shares")
    cases: ListOf[Count] = Field(description="their numbers")
    failed_jobs: ListOf[FailedJob] = Field(description="and why; the exit code is 6")
