"""force-law.json: the force law of a measured map next to the analytic laws."""

from __future__ import annotations

from pydantic import Field

from pamid.base.schemas.model import Count, Flag, ListOf, Model, Number, Text, Written
from pamid.base.schemas.network_file import TrainingSummary


class MeasuredRange(Model):
    """Between which values a column lies."""

    low: Number
    high: Number


class MapUsed(Model):
    """The measured map."""

    path: Text
    points: Count
    slack_points: Count = Field(description="at which the muscle does not pull")
    contraction: MeasuredRange = Field(description="share of the length at rest")
    pressure_kpa: MeasuredRange = Field(description="gauge")
    force_n: MeasuredRange


class AnfisErrors(Model):
    """The network, on points held out."""

    sets: Count | None = Field(description="membership sets per input")
    n_weights: Count
    rms_n: Number
    worst_n: Number
    rms_n_each_way: ListOf[Number] = Field(description="by fold of the cross-validation")
    contraction_held_out_rms_n: Number | None = Field(
        description="with whole contractions held out"
    )
    rms_n_trained_on_all: Number


class LawErrors(Model):
    """An analytic law, as printed and with its scale fitted to the points not held out."""

    law: Text
    scale: Number = Field(description="fitted to all points")
    rms_n: Number
    worst_n: Number
    scaled_rms_n: Number | None
    scaled_worst_n: Number
    contraction_held_out_scaled_rms_n: Number | None


class Monotone(Model):
    """Does the force grow with pressure and fall with contraction?"""

    ok: Flag
    wrong_way_along_pressure_n: Number = Field(description="largest fall")
    wrong_way_along_contraction_n: Number = Field(description="largest rise")
    constrained: Flag = Field(
        False, description="whether the trained law had to be constrained to that"
    )
    words: Text


class WrittenRig(Model):
    """The rig file that takes its muscle force from the network."""

    file: Text = Field(description="in the run folder")
    name: Text
    derives_from: Text
    strict: Flag = Field(description="whether it refuses a law that is not monotone")


class ForceLawFile(Model, schema="pamid.force-law/1", title="force-law.json and pamid force-law"):
    """All forces in N, errors on points held out unless the key states otherwise."""

    finding: Text = Field(description="in a sentence")
    advice: ListOf[Text]
    map: Written[MapUsed] = None
    held_out_every: Written[Count] = Field(None, description="a point in so many")
    anfis: Written[AnfisErrors] = None
    laws: ListOf[LawErrors] = Field((), description="the analytic ones")
    monotone: Written[Monotone] = None
    training: Written[TrainingSummary] = None
    rig: WrittenRig | None = None
