"""diagnosis.json: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, ConfigDict, Field, ValidationInfo, WithJsonSchema

from pamid.base.schemas.estimates import (
    CONVERGED,
    HIGH,
    LOW,
    SHARE,
    SHRINKAGE,
    UNIT,
    WHY_ENDED,
    Estimate,
    FailedJob,
)
from pamid.base.schemas.model import (
    Count,
    Figures,
    Flag,
    ListOf,
    MapOf,
    Model,
    Number,
    Pair,
    Sometimes,
    Text,
    Written,
    expected,
)
from pamid.base.schemas.rig_map import RigMap

Verdict = Literal[
    "explained",
    "partly-explained",
    "ambiguous",
    "unknown-effect",
    "no-structural-gap",
    "cannot-tell",
]
#: how the note begins that stands in the place of an experiment
WITHHELD = "No next experiment is proposed"
CAUSED = ("explained", "partly-explained", "ambiguous")  # verdicts that name a cause
ERROR = "mean absolute error, in the unit of the channel"


class GapShare(Model):
    """A share of the gap between the refitted model and the noise floor, on held-out windows."""

    share: Number = Field(description=SHARE)
    low: Number = Field(description=f"{LOW}, paired window by window")
    high: Number = Field(description=HIGH)
    standard_errors: Written[Number] = Field(None, description="the share in its standard errors")

    @property
    def z(self) -> float:
        """The share in its standard errors; 0 where it is not known."""
        return self.standard_errors or 0.0

    @property
    def rest(self) -> GapShare:
        """The share of the gap that remains."""
        return GapShare(
            share=1.0 - self.share, low=1.0 - self.high, high=1.0 - self.low, standard_errors=0.0
        )


class Cause(Model):
    """An effect that the verdict adds."""

    effect: Text = Field(description="label, effect@port where the place is not unique")
    family: Text = Field("", description="of effects that are mistaken for each other")
    port: Text = Field("", description="group of ports that it acts on")
    or_at: ListOf[Text] = Field(
        (), description="groups of ports at which an effect of its family fits as well"
    )
    instead: ListOf[Text] = Field(
        (), description="families that fit as well in its place, together with the other causes"
    )
    parameters: MapOf[Estimate] = Field({}, description="by name with unit")
    probability: Number | None = Field(
        None, description="calibrated frequency of such a cause, 0 to 1"
    )
    removes: GapShare | None = Field(
        None, description="share of the gap that it removes in addition to the other causes"
    )
    figures: MapOf[Number] = Field({}, description="inputs of the probability")
    share: Number | None = Field(
        None, description="its part of the sum of the shares of all causes, 0 to 1"
    )


class Remainder(Model):
    """Remaining gap with the causes; without a cause, the gap itself."""

    share: Written[Number] = Field(None, description=SHARE)
    low: Written[Number] = Field(None, description=LOW)
    high: Written[Number] = Field(None, description=HIGH)
    floors: Written[Number] = Field(
        None, description="remaining error divided by the noise floor, in the worst channel"
    )
    real: Flag = Field(
        True, description="whether it is material: a fifth of the gap or more, above the floor"
    )
    port: Text = Field("", description="group of ports at which it enters; empty where not real")
    formula: Text = Field(
        "", description="formula of the missing value, in the signals at the port"
    )
    family: Text = Field(
        "", description="family of a nonparametric curve that fits it; empty without a fit"
    )
    missing_rms: Sometimes[Number] = Field(
        default=None,
        description="root mean square of the missing value at the port for the model as "
        "fitted, where that is known",
    )
    passing_rms: Sometimes[Number] = Field(
        default=None, description="root mean square of the total value at the port"
    )
    unit: Sometimes[Text] = Field(default=None, description="of both")


class HeldOut(Model):
    """Errors of a channel before and after a candidate, on held-out windows."""

    mae_before: Written[Number] = Field(None, description=f"refitted model: {ERROR}")
    mae_after: Written[Number] = Field(None, description=f"with the candidate: {ERROR}")


class Candidate(Model):
    """An effect that was refitted together with the model."""

    effect: Text = Field(description="label, effect@port where the place is not unique")
    family: Text = Field("", description="of effects that are mistaken for each other")
    port: Text = Field("", description="group of ports that it acts on")
    probability: Number | None = Field(
        None, description="calibrated frequency at which such a candidate is the cause, 0 to 1"
    )
    held_out: MapOf[HeldOut] = Field({}, description="by channel")
    removes: GapShare | None = Field(None, description="share of the gap, alone")
    behind: Written[Number] = Field(
        None, description="distance from the first of the ranking, in standard errors"
    )
    shrinkage: Written[Number] = Field(
        None, description=f"{SHRINKAGE}, all channels weighed by their floors"
    )
    low: Written[Number] = Field(None, description=LOW)
    high: Written[Number] = Field(None, description=HIGH)
    converged: Flag = Field(True, description=CONVERGED)
    why: Text = Field("", description=WHY_ENDED)
    parameters: MapOf[Estimate] = Field({}, description="of the effect, by name with unit")
    at_bound: ListOf[Text] = Field((), description="parameters at a bound that is not physical")
    figures: MapOf[Number] = Field({}, description="inputs of the probability")
    set_aside: ListOf[Text] = Field((), description="physical reasons against it")


class SetMember(Model):
    """A model of the confidence set."""

    effect: Text = Field(description="label of the effect that the step adds")
    family: Text = Field("", description="of effects that are mistaken for each other")
    port: Text = Field("", description="group of ports that it acts on")
    removes: GapShare = Field(description="share of the gap, against the reference of the step")
    losses: ListOf[Number] = Field((), description="per held-out window, in noise floors")


class ComparisonStep(Model):
    """Models compared on the same held-out windows, on top of the same reference."""

    reference: Text = Field(description="effects of the reference; baseline for none")
    reference_losses: ListOf[Number] = Field(
        (), description="of the reference, per held-out window, in noise floors"
    )
    tied: ListOf[SetMember] = Field(
        (), description="confidence set: a model per family, the best first"
    )


class Forecast(Model):
    """Share of the error that the causes remove on a fresh recording, as predicted."""

    share: Number = Field(description=SHRINKAGE)
    low: Number = Field(description=LOW)
    high: Number = Field(description=HIGH)


class PortShare(Model):
    """How much of the gap enters at a port."""

    port: Text
    share: Number = Field(description=SHARE)


class Sensor(Model):
    """A further sensor that would separate what the present ones cannot."""

    sensor: Text
    splits: ListOf[ListOf[Text]] = Field((), description="groups of ports that it would separate")


class Regime(Model):
    """A range of a signal in which the gap is concentrated."""

    signal: Text
    low: Written[Number] = Field(None, description="lower end of the range")
    high: Written[Number] = Field(None, description="upper end of the range")
    unit: Text = Field("", description=UNIT)
    share_of_gap: Written[Number] = Field(None, description=SHARE)
    share_of_time: Written[Number] = Field(None, description=SHARE)


def _band(value: Any, info: ValidationInfo) -> Any:
    if info.context is None:
        return value
    if value and (not isinstance(value, list) or len(value) != 2):
        raise expected("made of pairs of numbers")
    return value or []


class Where(Model):
    """Where the gap enters, and when it shows."""

    port: Text = Field("", description="group of ports")
    ports: ListOf[PortShare] = Field((), description="all groups of ports; shares sum to 1")
    indistinguishable: ListOf[ListOf[Text]] = Field(
        (), description="groups of ports that these sensors or recordings cannot separate"
    )
    redundancy: Written[Count] = Field(
        None, description="independent checks that these sensors allow"
    )
    unseen: ListOf[Text] = Field((), description="ports that do not affect any sensor")
    sensors: ListOf[Sensor] = Field((), description="useful further sensors, best first")
    regimes: ListOf[Regime] = Field((), description="ranges of signals in which the gap is large")
    frequency_hz: Annotated[tuple[Number, ...], BeforeValidator(_band)] = Field(
        (), description="[low, high] of the band with most of the gap, Hz; else empty"
    )
    windows_s: ListOf[Pair] = Field(
        (), description="[begin, end] of the worst windows, s of the recording"
    )

    def inseparable_from(self, port: str) -> set[str]:
        """The other ports that these sensors or recordings cannot separate from it."""
        return {o for group in self.indistinguishable if port in group for o in group} - {port}


class Reach(Model):
    """Errors of a measured channel on held-out data that were not used to choose the model."""

    mae_data_sheet: Written[Number] = Field(None, description=f"data-sheet parameters: {ERROR}")
    mae_refitted: Written[Number] = Field(None, description=f"refitted parameters: {ERROR}")
    mae_with_cause: Written[Number] = Field(
        None,
        description="refitted together with the causes, where there are none as mae_refitted: "
        f"{ERROR}",
    )
    noise_floor: Written[Number] = Field(
        None, description="error of a perfect model, by the noise of the sensors"
    )
    mae_refitted_short: Number | None = Field(
        None, description=f"mae_refitted, with a start estimated in every window: {ERROR}"
    )
    shrinkage: Written[Number] = Field(None, description=SHRINKAGE)
    low: Written[Number] = Field(None, description=LOW)
    high: Written[Number] = Field(None, description=HIGH)


class ChannelTransfer(Model):
    """Errors of a channel of a recording."""

    mae_refitted: Written[Number] = Field(None, description=f"refitted parameters: {ERROR}")
    mae_with_cause: Written[Number] = Field(None, description=f"with the cause: {ERROR}")
    shrinkage: Written[Number] = Field(None, description=SHRINKAGE)


Condition = Annotated[Any, WithJsonSchema({"type": ["number", "string", "object"]})]


class Transfer(Model):
    """A held-out recording under other conditions than all fitted ones; in addition to the keys
    below it has a table per channel."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, ChannelTransfer] = Field(init=False)

    recording: Text = Field("", description="first 12 digits of its sha256")
    differs: dict[Text, Condition] = Field({}, description="new conditions: known values, loop ...")

    @property
    def channels(self) -> dict[str, ChannelTransfer]:
        return self.__pydantic_extra__


INSEPARABLE = "no experiment that was tried separates them clearly"  # as part of `why`


class NextExperiment(Model):
    """Next experiment."""

    name: Text
    why: Text = Field("", description="purpose, in words")
    separates: ListOf[Text] = Field((), description="effects that it would separate")
    expected_separation: Written[Number] = Field(
        None,
        description="smallest rms difference between two of their models, in noise standard "
        "deviations",
    )
    minutes: Written[Number] = Field(None, description="at the rig, min")
    excitation: Text = Field("", description="the first of `excitations`")
    excitations: ListOf[Text] = Field(
        (), description="files of the run folder to send, a file per entry of `settings`"
    )
    settings: ListOf[Figures] = Field((), description="known values of each repetition")
    cautions: ListOf[Text] = Field(
        (),
        description="remarks before the experiment: inputs to send, inputs that vary as recorded, "
        "and predicted ranges compared with the recordings",
    )

    @property
    def separates_little(self) -> bool:
        return INSEPARABLE in self.why

    @property
    def files(self) -> tuple[str, ...]:
        """The files to send; of an older version a single file at most."""
        return self.excitations or tuple(filter(None, [self.excitation]))


class Pull(Model):
    """A correction within a tolerance, which is part of every model."""

    pull: Number = Field(description="fitted value over tolerance")
    share_of_gap: Written[Number] = Field(None, description=SHARE)


class FormCurve(Model):
    """Nonparametric curve that is added to a value or subtracted from it, over the recorded
    range."""

    signal: Text = Field(description="signal of the abscissa")
    signal_unit: Text = Field("", description=UNIT)
    shown: Text = Field("", description="content, in words")
    unit: Text = Field("", description=UNIT)
    x: ListOf[Number] = Field((), description="of the signal; of a loop, there and back")
    y: ListOf[Number] = Field((), description="a value per entry of x")
    low: ListOf[Number] = Field((), description=LOW)
    high: ListOf[Number] = Field((), description=HIGH)


class FamilyForm(Model):
    """A family whose nonparametric curve fits the missing effect."""

    effect: Text = Field(description="label of the nonparametric curve")
    family: Text
    port: Text = Field("", description="group of ports that it acts on")
    known_by: Text = Field("", description="common property of the family, in words")
    removes: GapShare | None = Field(None, description="share of the gap")
    shrinkage: Written[Number] = Field(None, description=SHRINKAGE)
    low: Written[Number] = Field(None, description=LOW)
    high: Written[Number] = Field(None, description=HIGH)
    curve: Written[FormCurve] = Field(None, description="with its 95 % band")


class Unknown(Model):
    """Description of an effect that the catalogue does not contain."""

    port: Text = Field("", description="where it enters")
    formula: Text = Field(
        "", description="formula of the missing value, in the signals at the port"
    )
    variables: ListOf[Text] = Field((), description="signals that the formula uses")
    inclusion: Written[Number] = Field(
        None, description="share of resampled fits with the terms of the formula"
    )
    described: Written[Number] = Field(
        None, description="share of the term's variance that the formula describes"
    )
    dissipative: Written[Flag] = Field(None, description="whether it takes energy out")
    parity: Text = Field("none", description="odd, even or none, in the velocity")
    memory: Written[Flag] = Field(None, description="whether it depends on the past")
    free_forms: ListOf[FamilyForm] = Field(
        (),
        description="nonparametric curves of families that fit it, best first, which these "
        "recordings cannot separate: any of these families, in a form outside the catalogue; else "
        "empty",
    )


class DiagnosisFile(
    Model,
    schema="pamid.diagnosis/3",
    title="diagnosis.json and pamid diagnose: where the gap lies, which effect causes it, "
    "how far it shrinks",
):
    """Where the gap lies, which effect causes it, how far it shrinks."""

    earlier: ClassVar = {
        "pamid.diagnosis/1": "every cause now has a separate probability and the share of the "
        "gap that it removes, `remainder` tells what is left, and the verdicts partly-explained "
        "and cannot-tell are new"
    }
    readable: ClassVar = ("pamid.diagnosis/2",)
    written_by: ClassVar = "pamid diagnose"

    verdict: Verdict
    sentence: Text = Field("", description="the verdict in words")
    remark: Text = Field(
        "",
        description="first check, if the recordings do not depend on the model; else empty",
    )
    doubts: ListOf[Text] = Field(
        (),
        description="doubts of `pamid check` about the recordings that a fit would attribute to "
        "the machine: an offset, another scale; part of the sentence",
    )
    causes: ListOf[Cause] = Field(
        (),
        description="effects that the verdict adds, strongest first; for ambiguous the members "
        "that cannot be separated",
    )
    remainder: Remainder | None = Field(None, description="remaining gap; null without a gap")
    ranking: ListOf[Candidate] = Field(
        (), description="every candidate that was refitted, best first"
    )
    comparison: ListOf[ComparisonStep] = Field(
        (), description="confidence sets, in the order in which effects were added"
    )
    horizon_s: Written[Number] = Field(
        None, description="time over which the model predicts from an estimated state, s"
    )
    forecast: Forecast | None = Field(
        None, description="for a fresh recording; null without causes"
    )
    where: Written[Where] = Field(None, description="where the gap enters")
    how_far: MapOf[Reach] = Field({}, description="by channel")
    transfer: ListOf[Transfer] = Field(
        (), description="errors with the cause under other conditions"
    )
    next_experiment: NextExperiment | None = Field(None, description="recommended next experiment")
    parameters: MapOf[Estimate] = Field({}, description="of the rig, by name with unit")
    background: MapOf[Pull] = Field({}, description="by name")
    unknown: Unknown | None = Field(
        None, description="description of an effect outside the catalogue"
    )
    rig: Sometimes[RigMap] = Field(default=None, description="its ports and their connections")
    notes: ListOf[Text] = Field((), description="remarks on the reliability of the figures")
    failed_jobs: Sometimes[ListOf[FailedJob]] = None

    @property
    def withheld(self) -> str:
        """The note on why no experiment is proposed, or ""."""
        return next((note for note in self.notes if note.startswith(WITHHELD)), "")

    @property
    def tied(self) -> tuple[str, ...]:
        """Effects that tie with the first cause, an effect per family, the first included."""
        return tuple(m.effect for m in self.comparison[0].tied) if self.comparison else ()
