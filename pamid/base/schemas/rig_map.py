"""The rig as a chain of places: which ports it has, and which leads to which."""

from __future__ import annotations

from pydantic import Field

from pamid.base.schemas.estimates import UNIT
from pamid.base.schemas.model import ListOf, Model, Text


class MappedPort(Model):
    """A port of the rig, its places combined."""

    port: Text
    group: Text = Field("", description="name of the group in the shares of the gap")
    kind: Text = Field("", description="kind of value: motion, actuator-force, flow ...")
    unit: Text = Field("", description=UNIT)
    leads_to: ListOf[Text] = Field(
        (), description="ports that are reached from here with no other port between"
    )


class RigMap(Model):
    """Data for a drawing of the rig; no figure depends on them."""

    name: Text
    inputs: ListOf[Text] = Field((), description="columns that are sent to it")
    outputs: ListOf[Text] = Field((), description="columns that were measured")
    ports: ListOf[MappedPort] = Field((), description="in the order of the rig")
