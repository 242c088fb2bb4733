"""paper.json and arm-paper.json: the tables of the reproduced papers."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, ConfigDict, Field, ValidationInfo, model_validator

from pamid.base.schemas.diagnosis_file import Cause
from pamid.base.schemas.estimates import PERIOD, SEED, UNIT, WHY_ENDED, WORD, Interval
from pamid.base.schemas.force_law_file import AnfisErrors, LawErrors
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
    Written,
    expected,
    numbers_only,
)
from pamid.base.schemas.network_file import TrainingSummary

QUICK = "too little to be believed"
PLAN = "requested plan"
NOTES = "what all of it is not, a sentence each"
ByCase = MapOf[Number | None]


class JointPlanUsed(Model):
    seconds: Written[Number] = Field(None, description="length of the training record, s")
    iterations: Written[Count] = Field(None, description="of the network, at most")
    starts: Written[Count] = Field(None, description="of the network")
    seed: Written[Count] = Field(None, description=SEED)
    jobs: Written[Count] = None
    quick: Flag = Field(False, description=QUICK)


class JointTwinUsed(Model):
    """The twin's hidden numbers by name with unit, and:"""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Number] = Field(init=False)

    analytic_mae_without_noise: MapOf[Number] = Field(
        {}, description="by which the analytic model misses it, deg by inertia"
    )

    @model_validator(mode="before")
    @classmethod
    def _texts_are_passed_over(cls, data: Any, info: ValidationInfo) -> Any:
        return numbers_only(data, info)


class PaperTraining(TrainingSummary):
    """How a network's training went."""

    not_read: ClassVar = (
        "alpha",
        "beta",
        "supported_weights",
        "samples",
        "effective_samples",
        "start",
        "plain",
    )

    seconds: Sometimes[Number] = None
    rmse_of_range: Number = Field(
        description="root of the mean squared error, as a share of the range"
    )


class PublishedFigures(Model):
    """Figures of the paper."""

    mae: MapOf[MapOf[Number]] = Field(description="model -> inertia -> deg")
    improvement: Number = Field(description="share by which the network lowers the error")
    training: PaperTraining


class PaperRow(Model):
    """A model's errors on the steps, in deg by inertia; null where it became unstable."""

    model: Text
    mae: ByCase
    mae_after_1_s: ByCase = Field(description="without the start-up")
    improvement: ByCase = Field(description="share by which the analytic model's error is lowered")
    published: MapOf[Number] = Field(description="the paper's error")
    seconds: Annotated[Number | None, MAY_LACK] = Field(
        default=None, description="that it took; printed, not in the file"
    )


class PaperDiagnosis(Model):
    """Causes that the diagnosis names from the training record alone."""

    verdict: Text
    sentence: Text = Field("", description="the verdict in words")
    causes: ListOf[Cause] = Field((), description="as in diagnosis.json")


def _some(rows: Any) -> Any:
    if not isinstance(rows, list | tuple) or not rows:
        raise expected("a list of models")
    return rows


class PaperFile(
    Model, schema="pamid.paper/1", title="paper.json: the first paper's table on a calibrated twin"
):
    """The models on the steps of the first paper, next to the published figures."""

    quick: Flag = Field(False, description=QUICK)
    plan: Written[JointPlanUsed] = Field(None, description=PLAN)
    notes: ListOf[Text] = Field((), description=NOTES)
    twin: JointTwinUsed
    published: PublishedFigures
    rows: Annotated[ListOf[PaperRow], BeforeValidator(_some)]
    training: PaperTraining
    diagnosis: PaperDiagnosis


# ---- the arm -----------------------------------------------------------------------------------


class ArmPlanUsed(Model):
    swing_s: Number = Field(description="length of each gravity test, s")
    muscles: ListOf[Text] = Field(description="those that are pulsed")
    period_s: Number = Field(description=PERIOD)
    seed: Count | None = Field(description=SEED)
    quick: Flag = Field(description=QUICK)


class ArmTwinUsed(Model):
    """Hidden parameters of the twin."""

    law: Text = Field(description="of its muscles")
    hidden: MapOf[Number] = Field(description="by name with unit")


class ArmRecording(Model):
    """A recording of the twin."""

    name: Text
    kind: Text = Field(description="gravity or pulses")
    held_out: Flag
    known: dict[Text, Number] = Field(description="settings of the arm, by name with unit")
    samples: Count = Field(description="number of samples")


class ArmForceLaw(Model):
    """Of force-law.json."""

    finding: Text = ""
    advice: ListOf[Text] = ()
    anfis: Written[AnfisErrors] = None
    laws: ListOf[LawErrors] = ()


class ArmErrors(Model):
    """Mean absolute errors of a variable on recordings that no fit has seen, by model."""

    unit: Text = Field(description=UNIT)
    data_sheet: Number | None = None
    without_dry_friction: Sometimes[Number] = Field(
        default=None, description="fitted with viscous friction of the joints alone"
    )
    analytic_alone: Sometimes[Number] = None
    anfis_alone: Sometimes[Number] = None
    fitted_analytic: Sometimes[Number] = None
    fitted_anfis: Sometimes[Number] = None
    noise_floor: Number | None = Field(None, description="error of the twin itself")


class ArmCoupling(Model):
    """Motion of a joint under pulses on the valves of the other, on a held-out recording."""

    pulsed: Text = Field(description="joint whose valves are pulsed")
    moved: Text = Field(description="angle of the other joint")
    from_s: Number = Field(description="where the pulses on the first joint alone begin, s")
    to_s: Number = Field(description="where they end, s")
    swing_deg: Number = Field(description="range of that angle without noise, deg")
    mae: MapOf[Number] = Field(
        description="mean absolute errors of that angle, deg: data_sheet, fitted, "
        "without_coupling (fitted, with M12 and the velocity terms struck out), noise_floor"
    )


class ArmTarget(Model):
    """Do the fitted angles of the gravity tests lie at the noise floor?"""

    share: Number = Field(description="by which they may lie above it")
    error_over_floor: MapOf[MapOf[Number]] = Field({}, description="model -> angle -> ratio")
    worst: Number = Field(description="the largest ratio")
    reached: Flag = False


class StageEstimate(Interval):
    """A value as a stage of the fits knows it."""

    word: Text = Field("", description=WORD)
    holds: Flag | None = Field(None, description="whether the interval contains the true value")


class ArmEstimate(Model):
    """A value by stage of the fits."""

    unit: Text = Field("", description=UNIT)
    data_sheet: Number | None = None
    truth: Number | None = None
    without_payload: Sometimes[StageEstimate] = Field(
        default=None, description="gravity tests without the known payload"
    )
    gravity: Sometimes[StageEstimate] = Field(default=None, description="all gravity tests")
    analytic_alone: Sometimes[StageEstimate] = None
    anfis_alone: Sometimes[StageEstimate] = None
    fitted_analytic: Sometimes[StageEstimate] = None
    fitted_anfis: Sometimes[StageEstimate] = None


class ArmTie(Model):
    """Parameters that a stage knows only in combination."""

    parameters: ListOf[Text] = Field(description="by name with unit")
    known: dict[Text, Number] = Field(description="the combinations that are known")


class StageEnd(Model):
    """How the fit of a stage ended."""

    converged: Flag = True
    why: Text = Field("", description=WHY_ENDED)


class ArmPaperFile(
    Model, schema="pamid.paper-arm/1", title="arm-paper.json: the second paper on a virtual arm"
):
    """The second paper's validation; errors: test -> variable -> models."""

    quick: Flag = Field(False, description=QUICK)
    plan: Written[ArmPlanUsed] = Field(None, description=PLAN)
    notes: ListOf[Text] = Field((), description=NOTES)
    twin: ArmTwinUsed
    recordings: ListOf[ArmRecording] = ()
    force_law: ArmForceLaw
    mae: MapOf[MapOf[ArmErrors]] = Field({}, description="of free runs")
    windowed_mae: MapOf[MapOf[ArmErrors]] = Field(
        {}, description="in short windows, each with an estimated initial state"
    )
    target: ArmTarget
    coupling: ListOf[ArmCoupling] = Field(
        (), description="between the joints, an entry per pulsed joint"
    )
    combinations: MapOf[ArmEstimate] = Field({}, description="of the inertial data, by name")
    parameters: MapOf[ArmEstimate] = Field({}, description="by name with unit")
    tied: MapOf[ListOf[ArmTie]] = Field({}, description="by stage")
    fits: MapOf[StageEnd] = Field({}, description="by stage")
