"""Detectability of every effect in an experiment, before anything is measured."""

from __future__ import annotations

from pydantic import Field

from pamid.base.schemas.estimates import RIG, SEED, UNIT
from pamid.base.schemas.model import ListOf, MapOf, Model, Number, Text

SEEN_BY = "error of the refitted model over the noise floor"


class UsualAmount(Model):
    """The parameter for the size of an effect."""

    parameter: Text = Field(description="by name with unit")
    unit: Text = Field(description=UNIT)
    usual: Number = Field(description="its value at the usual size")
    least: Number | None = Field(description="the smallest detectable value; null if none tried is")


class ShownEffect(Model):
    """Detectability of an effect in the experiment."""

    effect: Text = Field(description="label, effect@port where the place is not unique")
    family: Text = Field(description="of effects that are mistaken for each other")
    port: Text = Field(description="group of ports that it acts on")
    amount: UsualAmount | None
    visible: ListOf[Number] = Field(
        description=f"{SEEN_BY}, worst channel, at each of `sizes`; empty where it failed"
    )
    standard_errors: ListOf[Number] = Field(description="its size in standard errors, likewise")
    by_channel: MapOf[Number] = Field(
        description=f"{SEEN_BY} at the usual size if that sensor were the only sensor"
    )
    confused: ListOf[Text] = Field(
        description="effects of other families with which it would be confused at its usual size"
    )
    failed: Text = Field(description="reason of a failure; else empty")


class PowerFile(
    Model,
    schema="pamid.power/1",
    title="pamid power: what an experiment would show of every effect, and what it would confuse",
):
    """Detectability of every effect in an experiment, and the effects it would confuse."""

    rig: Text = Field(description=RIG)
    excitation: Text
    seconds: Number = Field(description="of the experiment, s")
    noise: Number = Field(description="factor on the noise of the rig's sensors")
    seed: int = Field(description=SEED)
    channels: ListOf[Text]
    sizes: ListOf[Number] = Field(description="multiples of the usual size that were tried")
    seen: Number = Field(description="an effect shows where `visible` is as large")
    effects: ListOf[ShownEffect] = Field(description="the plainest first")
