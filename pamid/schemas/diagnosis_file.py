"""diagnosis.json: where the gap lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, ConfigDict, Field, ValidationInfo, WithJsonSchema

from pamid.schemas.estimates import (
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
from pamid.schemas.model import (
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
from pamid.schemas.rig_map import RigMap

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


class Cause(Model):
    """An effect that the verdict adds."""

    effect: Text = Field(description="label, effect@port where the place is not unique")
    family: Text = Field("", description="of effects that are mistaken for each other")
    port: Text = Field("", description="group of ports that it acts on")
    or_at: ListOf[Text] = Field(
        (), description="groups of ports at which an effect of its family does as well"
    )
    instead: ListOf[Text] = Field(
        (), description="families that do as well in its place, next to the other causes"
    )
    parameters: MapOf[Estimate] = Field({}, description="by name with unit")
    probability: Number | None = Field(
        None, description="calibrated frequency with which such a cause is there, 0 to 1"
    )
    removes: GapShare | None = Field(
        None, description="share of the gap that it removes beside the other causes"
    )
    figures: MapOf[Number] = Field({}, description="of which the probability is made")
    share: Number | None = Field(
        None, description="its part of what the causes remove one by one, 0 to 1"
    )


class Remainder(Model):
    """Remaining gap with the causes; without a cause, the gap itself."""

    share: Written[Number] = Field(None, description=SHARE)
    low: Written[Number] = Field(None, description=LOW)
    high: Written[Number] = Field(None, description=HIGH)
    floors: Written[Number] = Field(
        None, description="error that is left over the noise floor, in the worst channel"
    )
    real: Flag = Field(
        True, description="whether it is material: a fifth of the gap or more, above the floor"
    )
    port: Text = Field("", description="group of ports at which it enters; empty where not real")
    formula: Text = Field("", description="what is missing there, in the signals at the port")
    family: Text = Field("", description="whose free form would take it up; empty where none does")
    missing_rms: Sometimes[Number] = Field(
        default=None,
        description="root mean square of what is missing there to the model as "
        "fitted, where that is known",
    )
    passing_rms: Sometimes[Number] = Field(
        default=None, description="... of what passes there, with all that acts"
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
        None, description="calibrated frequency with which such a candidate is the cause, 0 to 1"
    )
    held_out: MapOf[HeldOut] = Field({}, description="by channel")
    removes: GapShare | None = Field(None, description="share of the gap, alone")
    behind: Written[Number] = Field(
        None, description="standard errors by which the first of the ranking removes more"
    )
    shrinkage: Written[Number] = Field(
        None, description=f"{SHRINKAGE}, all channels weighed by their floors"
    )
    low: Written[Number] = Field(None, description=LOW)
    high: Written[Number] = Field(None, description=HIGH)
    converged: Flag = Field(True, description=CONVERGED)
    why: Text = Field("", description=WHY_ENDED)
    parameters: MapOf[Estimate] = Field({}, description="of the effect, by name with unit")
    at_bound: ListOf[Text] = Field(
        (), description="of these, those at a bound that physics did not set"
    )
    figures: MapOf[Number] = Field({}, description="of which the probability is made")
    set_aside: ListOf[Text] = Field((), description="physical reasons for which it is not named")


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
        (), description="confidence set: one model per family, the best first"
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
    unseen: ListOf[Text] = Field((), description="ports that no sensor tells anything about")
    sensors: ListOf[Sensor] = Field((), description="further sensors that would help, best first")
    regimes: ListOf[Regime] = Field((), description="when it shows")
    frequency_hz: Annotated[tuple[Number, ...], BeforeValidator(_band)] = Field(
        (), description="[low, high] of the band that holds most of the gap, Hz; else empty"
    )
    windows_s: ListOf[Pair] = Field(
        (), description="[begin, end] of the worst windows, s of the recording"
    )

    def not_told_from(self, port: str) -> set[str]:
        """The other ports that these sensors or recordings cannot tell from this one."""
        return {o for group in self.indistinguishable if port in group for o in group} - {port}


class Reach(Model):
    """Errors of a measured channel on held-out data that chose nothing."""

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
    """Errors of a channel of one recording."""

    mae_refitted: Written[Number] = Field(None, description=f"refitted parameters: {ERROR}")
    mae_with_cause: Written[Number] = Field(None, description=f"with the cause: {ERROR}")
    shrinkage: Written[Number] = Field(None, description=SHRINKAGE)


Condition = Annotated[Any, WithJsonSchema({"type": ["number", "string", "object"]})]


class Transfer(Model):
    """A held-out recording made under other conditions than all that were fitted; beside the keys
    below it has one per channel."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, ChannelTransfer] = Field(init=False)

    recording: Text = Field("", description="first 12 digits of its sha256")
    differs: dict[Text, Condition] = Field({}, description="what is new: known values, loop ...")

    @property
    def channels(self) -> dict[str, ChannelTransfer]:
        return self.__pydantic_extra__


class NextExperiment(Model):
    """Next experiment."""

    name: Text
    why: Text = Field("", description="what it is good for, in words")
    separates: ListOf[Text] = Field((), description="effects that it would tell from each other")
    expected_separation: Written[Number] = Field(
        None,
        description="smallest rms difference of two of their models on it, in noise standard "
        "deviations",
    )
    minutes: Written[Number] = Field(None, description="at the rig, min")
    excitation: Text = Field("", description="the first of `excitations`")
    excitations: ListOf[Text] = Field(
        (), description="files of the run folder to send, one per entry of `settings`"
    )
    settings: ListOf[Figures] = Field((), description="known values of each repetition")
    cautions: ListOf[Text] = Field(
        (),
        description="before it is sent: which inputs are sent and which vary as recorded, and "
        "where it leads as predicted, compared with what was recorded",
    )

    @property
    def files(self) -> tuple[str, ...]:
        """The files to send; of an older version one at most."""
        return self.excitations or tuple(filter(None, [self.excitation]))


class Pull(Model):
    """A tolerance-sized correction that stands in every model."""

    pull: Number = Field(description="fitted value over tolerance")
    share_of_gap: Written[Number] = Field(None, description=SHARE)


class FormCurve(Model):
    """Curve that a free form subtracts from a value or adds to it, over the recorded range."""

    signal: Text = Field(description="over which it is drawn")
    signal_unit: Text = Field("", description=UNIT)
    shown: Text = Field("", description="what it shows, in words")
    unit: Text = Field("", description=UNIT)
    x: ListOf[Number] = Field((), description="of the signal; of a loop, there and back")
    y: ListOf[Number] = Field((), description="one per entry of x")
    low: ListOf[Number] = Field((), description=LOW)
    high: ListOf[Number] = Field((), description=HIGH)


class FamilyForm(Model):
    """A family whose free form, a curve without a law, takes up what is missing."""

    effect: Text = Field(description="label of the free form")
    family: Text
    port: Text = Field("", description="group of ports that it acts on")
    known_by: Text = Field("", description="what the family has in common, in words")
    removes: GapShare | None = Field(None, description="share of the gap")
    shrinkage: Written[Number] = Field(None, description=SHRINKAGE)
    low: Written[Number] = Field(None, description=LOW)
    high: Written[Number] = Field(None, description=HIGH)
    curve: Written[FormCurve] = Field(None, description="with its 95 % band")


class Unknown(Model):
    """Description of an effect that the catalogue does not contain."""

    port: Text = Field("", description="where it enters")
    formula: Text = Field("", description="of what is missing, in the signals at the port")
    variables: ListOf[Text] = Field((), description="signals that the formula uses")
    inclusion: Written[Number] = Field(
        None, description="share of resampled fits in which the formula's terms came up"
    )
    described: Written[Number] = Field(
        None, description="share of the term's variance that the formula describes"
    )
    dissipative: Written[Flag] = Field(None, description="whether it takes energy out")
    parity: Text = Field("none", description="odd, even or none, in the velocity")
    memory: Written[Flag] = Field(None, description="whether it depends on the past")
    free_forms: ListOf[FamilyForm] = Field(
        (),
        description="free forms of families, best first, that take it up and that these recordings "
        "cannot tell apart: it is of one of them, in a form not in the catalogue; else empty",
    )


class DiagnosisFile(Model):
    """Where the gap lies, which effect causes it, how far it shrinks."""

    model_config = ConfigDict(
        title="diagnosis.json and pamid diagnose: where the gap lies, which effect causes it, "
        "how far it shrinks"
    )

    earlier: ClassVar = {
        "pamid.diagnosis/1": "every cause now has a probability of its own and the share of the "
        "gap that it removes, `remainder` tells what is left, and the verdicts partly-explained "
        "and cannot-tell are new"
    }
    readable: ClassVar = ("pamid.diagnosis/2",)
    written_by: ClassVar = "pamid diagnose"

    schema_: Literal["pamid.diagnosis/3"] = Field(default="pamid.diagnosis/3", alias="schema")
    verdict: Verdict
    sentence: Text = Field("", description="the verdict in words")
    remark: Text = Field(
        "",
        description="what to check first, where the recordings show nothing of the model; else "
        "empty",
    )
    doubts: ListOf[Text] = Field(
        (),
        description="what `pamid check` doubts about the recordings and a fit would put down to "
        "the machine: an offset, another scale; part of the sentence",
    )
    causes: ListOf[Cause] = Field(
        (),
        description="effects that the verdict adds, strongest first; for ambiguous the members "
        "that cannot be told from each other",
    )
    remainder: Remainder | None = Field(
        None, description="what is left; null where nothing was there to explain"
    )
    ranking: ListOf[Candidate] = Field(
        (), description="every candidate that was refitted, best first"
    )
    comparison: ListOf[ComparisonStep] = Field(
        (), description="confidence sets, in the order in which effects were added"
    )
    horizon_s: Written[Number] = Field(
        None, description="time over which the model predicts from one estimated state, s"
    )
    forecast: Forecast | None = Field(
        None, description="for a fresh recording; null without causes"
    )
    where: Written[Where] = Field(None, description="where the gap enters")
    how_far: MapOf[Reach] = Field({}, description="by channel")
    transfer: ListOf[Transfer] = Field((), description="does the cause hold elsewhere?")
    next_experiment: NextExperiment | None = Field(None, description="what to measure next")
    parameters: MapOf[Estimate] = Field({}, description="of the rig, by name with unit")
    background: MapOf[Pull] = Field({}, description="by name")
    unknown: Unknown | None = Field(None, description="of an effect without a name")
    rig: Sometimes[RigMap] = Field(default=None, description="its ports and which leads to which")
    notes: ListOf[Text] = Field(
        (), description="what a reader should know before believing a figure, in words"
    )
    failed_jobs: Sometimes[ListOf[FailedJob]] = None

    @property
    def withheld(self) -> str:
        """The note on why no experiment is proposed, or ""."""
        return next((note for note in self.notes if note.startswith(WITHHELD)), "")

    @property
    def tied(self) -> tuple[str, ...]:
        """Effects that tie with the first cause, one per family, the first included."""
        return tuple(m.effect for m in self.comparison[0].tied) if self.comparison else ()
