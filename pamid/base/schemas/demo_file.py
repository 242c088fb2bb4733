"""Withheld effect and diagnosis of `pamid demo`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pamid.base.schemas.diagnosis_file import Cause, Reach, Verdict
from pamid.base.schemas.estimates import SEED, Estimate
from pamid.base.schemas.model import Count, ListOf, MapOf, Model, Number, Text
from pamid.base.schemas.network_file import ChannelErrors

Hit = Literal["right", "among", "missed"]


class WithheldFile(
    Model, schema="pamid.withheld/1", title="withheld.json: the hidden effect of the demo"
):
    """Hidden effect and parameters, which only the final comparison reads."""

    seed: Count | None = Field(description=SEED)
    effect: Text
    family: Text
    as_simulated: ListOf[Text] = Field(description="the effect with its values")
    parameters: dict[Text, Number] = Field(description="true values, by name with unit")
    over_data_sheet: dict[Text, Number] = Field(description="true value over that of the sheet")


class DemoOutput(
    Model, schema="pamid.demo/1", title="pamid demo: the withheld effect and the diagnosis"
):
    """The withheld effect and the diagnosis."""

    withheld: WithheldFile
    hit: Hit = Field(
        description="whether the withheld family was named: alone, among several, or not"
    )
    verdict: Verdict
    sentence: Text = Field(description="the verdict in words")
    causes: ListOf[Cause] = Field(description="as in diagnosis.json")
    parameters: MapOf[Estimate] = Field(description="wrong parameters, by name with unit")
    how_far: MapOf[Reach] = Field(description="as in diagnosis.json, by channel")
    network: MapOf[ChannelErrors] | None = Field(
        description="as `mae` in network.json; null on another rig than one-dof"
    )
    page: Text = Field(description="path of the report")
