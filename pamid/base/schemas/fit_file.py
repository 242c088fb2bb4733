"""fit.json: parameters with intervals, errors per channel, and what a later command starts from."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from pamid.base.schemas.estimates import (
    CONVERGED,
    EFFECTS,
    SEED,
    SHA256,
    WHY_ENDED,
    Estimate,
    FailedJob,
)
from pamid.base.schemas.model import (
    MAY_LACK,
    Count,
    Figures,
    Flag,
    ListOf,
    MapOf,
    Model,
    Number,
    Sometimes,
    Text,
    Written,
)
from pamid.base.schemas.score_file import RecordingError


class RecordingUsed(Model):
    """A recording and the part it played."""

    not_read: ClassVar = ("controller", "lacks")

    name: Text
    path: Text = Field("", description="as it was given")
    sha256: Text = Field("", description=SHA256)
    role: Text = Field("", description="fit, held-out, or both if it was split in time")
    samples: Written[Count] = Field(None, description="number of samples")
    period_s: Number | None = Field(None, description="sampling period, s")
    loop: Text | None = Field(
        None, description="closed if a controller produced the command, else open"
    )
    controller: dict[Text, Number] = Field({}, description="settings of the controller, by name")
    known: Annotated[dict[Text, Number], MAY_LACK] = Field(
        default={}, description="parameters that it states as known, by name with unit"
    )
    lacks: ListOf[Text] = Field(
        (), description="channels that other recordings of the run have and this recording has not"
    )


class Steps(Model):
    """How the model is integrated over a sample."""

    substeps: Written[Count] = Field(None, description="steps per sample")
    implicit: Flag = Field(False, description="whether by an implicit rule")


class CheckedSteps(Steps):
    """How the model was integrated over a sample, and whether that was fine enough."""

    recheck: Written[Number] = Field(
        None,
        description="largest change of an output by doubled steps, in noise standard deviations",
    )


class BackgroundPull(Model):
    """A correction within a tolerance, which is part of every model."""

    pull: Number = Field(description="fitted value over tolerance")


class LoopError(Model):
    """Mean absolute error of the model in its control loop, in the unit of the channel."""

    data_sheet: Number | None = Field(None, description="data-sheet parameters")
    refitted: Number | None = Field(None, description="refitted parameters")
    band: Number | None = Field(
        None, description="by how much the error moves when the conductances change by 0.1 %"
    )


class Combination(Estimate):
    """A function of several parameters that the data determine."""

    members: ListOf[Text] = Field((), description="the fitted parameters in it")
    declared: Flag = Field(False, description="whether the rig declares it")


class Tie(Model):
    """Parameters that are known only in combination."""

    parameters: ListOf[Text] = Field((), description="by name with unit")
    directions: Written[Count] = Field(None, description="how many combinations are known")
    known: ListOf[Text] = Field((), description="keys of `combinations`")


class Posterior(Model):
    """Starting point of `pamid fit --from`; numbers in prior spreads around each centre."""

    keys: ListOf[Text] = Field(description="free parameters, in the order of the lists below")
    log: ListOf[Flag] = Field(description="whether the prior is in the logarithm")
    centre: ListOf[Number] = Field(description="centre of the prior, SI or its logarithm")
    spread: ListOf[Number] = Field(description="standard deviation of the prior, likewise")
    value: ListOf[Number] = Field(description="fitted, in spreads from the centre")
    held: ListOf[Number] = Field(description="gradient at a bound; 0 between bounds")
    others: dict[Text, Number] = Field(description="the rig's other parameters, SI, by key")
    covariance: ListOf[ListOf[Number]] = Field(description="lower triangle, row by row")


class FittedModel(Model):
    """Data that rebuild a fitted model to the last bit."""

    effects: ListOf[Text] = Field(description=EFFECTS)
    stepping: Steps
    values: dict[Text, Number] = Field(description="every parameter, SI, by key")
    between: Sometimes[dict[Text, Text]] = Field(
        default=None,
        description="what inputs do between samples, held or linear, by column, and "
        "which outputs are read before the command of their row; without it all inputs are held",
    )
    form: Sometimes[Text] = Field(
        default=None,
        description="of a model file, where the recordings decided it: equations or stepped (by "
        "its simulator)",
    )
    posterior: Sometimes[Posterior] = Field(
        default=None, description="of a model with a cause: how well its parameters are known"
    )


class Rival(Model):
    """A cause of several that the recordings cannot separate."""

    probability: Number = Field(description="calibrated frequency with which such a cause acts")
    model: FittedModel = Field(description="the model with it")


class StartedFrom(Model):
    """The earlier fit whose posterior was the prior."""

    path: Text = Field(description="folder of its run")
    sha256: Text = Field(description=SHA256)
    recordings: ListOf[Text] = Field(description="sha256 of all that it rests on")
    remarks: ListOf[Text] = Field(description="remarks for the reader, a sentence each")


class FitFile(
    Model,
    schema="pamid.fit/1",
    title="fit.json and pamid fit: parameters with intervals, errors per channel",
):
    """The refitted model: parameters with intervals, and errors per channel on held-out data."""

    not_read: ClassVar = (
        "seed",
        "noise",
        "intervals",
        "posterior",
        "model",
        "from",
        "cause",
        "rivals",
    )

    rig: Text = Field(description="name of the rig")
    effects: ListOf[Text] = Field((), description=EFFECTS)
    seed: Count | None = Field(None, description=SEED)
    recordings: ListOf[RecordingUsed] = Field(
        (), description="in the order in which they were given"
    )
    channels: ListOf[Text] = Field((), description="measured outputs that were fitted")
    inputs: Sometimes[ListOf[Text]] = Field(
        default=None, description="inputs of the rig that every recording has; in residual.csv"
    )
    converged: Flag = Field(True, description=CONVERGED)
    why: Text = Field("", description=WHY_ENDED)
    iterations: Written[Count] = Field(None, description="of the optimiser")
    stepping: Written[CheckedSteps] = Field(None, description="how the model was integrated")
    noise: dict[Text, Number] = Field(
        {}, description="standard deviation of the sensors, in the unit of the channel"
    )
    parameters: MapOf[Estimate] = Field({}, description="by name with unit")
    intervals: Text = Field("", description="block bootstrap or Jacobian: where they come from")
    background: MapOf[BackgroundPull] = Field({}, description="by name")
    mae: MapOf[Figures] = Field(
        {},
        description="mean absolute error on held-out data, in the unit of the channel: channel -> "
        "data_sheet, refitted, noise_floor",
    )
    closed_loop: MapOf[LoopError] | None = Field(
        None, description="by channel; null where no recording was made in a closed loop"
    )
    loops: Sometimes[ListOf[RecordingError]] = Field(
        default=None,
        description="the same per held-out recording and channel, by model, with RMS",
    )
    combinations: MapOf[Combination] = Field(
        {}, description="combinations of parameters that the data determine, by name with unit"
    )
    tied: ListOf[Tie] = Field((), description="parameters known only in combination")
    posterior: Written[Posterior] = Field(None, description="priors for a later fit")
    model: Written[FittedModel] = Field(None, description="the refitted model")
    from_: Sometimes[StartedFrom] = Field(
        default=None, alias="from", description="the fit before this fit"
    )
    cause: Sometimes[FittedModel] = Field(
        default=None, description="of a diagnosis: the model with the cause"
    )
    rivals: Sometimes[MapOf[Rival]] = Field(
        default=None,
        description="for an ambiguous diagnosis: the causes that cannot be separated, by label",
    )
    notes: Sometimes[ListOf[Text]] = Field(
        default=None, description="remarks on the reliability of the figures, sentences"
    )
    failed_jobs: Sometimes[ListOf[FailedJob]] = Field(default=None, description="and why")
