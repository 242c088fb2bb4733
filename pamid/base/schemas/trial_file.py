"""trial.json: how often the blind trial's answers were right."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import Field, ValidationInfo, model_validator

from pamid.base.schemas.estimates import HIGH, LOW, SEED, FailedJob
from pamid.base.schemas.model import MISSING, Count, ListOf, MapOf, Model, Number, Text


class Rate(Model):
    """A share of cases with its 95 % Wilson interval."""

    share: Number | None = Field(None, description="0 to 1; null of no cases")
    low: Number = Field(description=LOW)
    high: Number = Field(description=HIGH)
    hits: Count = Field(description="cases that count")
    of: Count = Field(description="cases in all")

    @model_validator(mode="before")
    @classmethod
    def _only_of_no_cases_there_is_none(cls, data: Any, info: ValidationInfo) -> Any:
        cases = data.get("of") if info.context is not None and isinstance(data, dict) else None
        if isinstance(cases, int | float) and cases > 0 and data.get("share") is None:
            return {**data, "share": MISSING}
        return data


class Figure(Model):
    """A figure with its 95 % bootstrap interval over cases; null of no cases."""

    value: Number | None = Field(description="in the unit of the table's row")
    low: Number | None = Field(description=LOW)
    high: Number | None = Field(description=HIGH)
    of: Count = Field(description="cases in all")


class Bin(Model):
    """Answers that were given with a probability between low and high."""

    low: Number = Field(0.0, description="lower edge of the bin")
    high: Number = Field(1.0, description="upper edge of the bin")
    said: Number = Field(description="mean stated probability")
    right: Rate = Field(description="share of right answers")


class TrialFile(Model, schema="pamid.trial/1", title="trial.json: the scored trial"):
    """The scored trial."""

    not_read: ClassVar = ("failed_jobs",)

    part: Text = Field(description="calibration or test")
    seed: Count = Field(description=SEED)
    cases: Count = Field(description="how many were drawn")
    rates: MapOf[Rate] = Field({}, description="by name")
    figures: MapOf[Figure] = Field({}, description="by name")
    reliability: ListOf[Bin] = Field(
        (), description="stated probabilities against the share of right answers"
    )
    strata: MapOf[MapOf[MapOf[Rate]]] = Field(
        {}, description="condition of the cases -> bin -> name of a rate -> rate"
    )
    confusion: MapOf[MapOf[Count]] = Field(
        {}, description="planted family -> answer -> number of visible single faults"
    )
    baselines: MapOf[Rate] = Field({}, description="rates of answers that ignore the data")
    rig: Text = Field(default="one-dof", description="name of the rig, or of its file")
    world: Text = Field(default="closed", description="open if further effects act as well")
    cases_sha256: Text = Field("", description="digest of all cases and their labels")
    failures: dict[Text, Text] = Field({}, description="number of a case -> why it failed")
    failed_jobs: ListOf[FailedJob] = Field((), description="cases, or jobs of their diagnosis")
