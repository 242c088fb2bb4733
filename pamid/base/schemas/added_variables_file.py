"""added-variables.json: the refitted model's residual over what each candidate adds."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from pamid.base.schemas.model import ListOf, Model, Number, Text

SLOPE = "as a multiple of the refitted effect: 1 is its refitted size, negative the opposite sign"


class AddedVariable(Model):
    """The added-variable plot of a candidate: a point per sample, evenly thinned."""

    effect: Text = Field(description="the candidate, with its port where it fits several")
    beside: ListOf[Text] = Field(
        (), description="further effects of the refitted model that it is added to"
    )
    channel: Text = Field(description="channel of the samples, by name with unit")
    slope: Number = Field(
        description=f"least-squares slope over the samples of all channels, {SLOPE}"
    )
    low: Number = Field(description="lower end of the 95 % interval of the slope")
    high: Number = Field(description="upper end of the 95 % interval of the slope")
    share: Number = Field(
        description="share of the channel's squared residual that the effect explains, projected"
    )
    added: ListOf[Number] = Field(
        description="what the effect adds to the channel, the other parameters projected out, in "
        "the unit of the channel"
    )
    residual: ListOf[Number] = Field(
        description="measured less the refitted model, projected in the same way"
    )


class AddedVariablesFile(
    Model,
    schema="pamid.added-variables/1",
    title="added-variables.json: the refitted model's residual over what each candidate adds",
):
    """Added-variable plots of a diagnosis, on the recordings that were fitted."""

    written_by: ClassVar = "pamid diagnose"

    plots: ListOf[AddedVariable] = Field(
        description="of several causes each next to the others, then of each candidate of the "
        "ranking by itself, in its order"
    )
