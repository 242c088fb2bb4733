"""Roles that `pamid new-rig` gave to a recording's columns."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pamid.base.schemas.estimates import UNIT
from pamid.base.schemas.model import Flag, ListOf, Model, Number, Text


class TakenColumn(Model):
    """A recorded column and what it is in the rig."""

    column: Text = Field(description="as recorded")
    unit: Text = Field(description=UNIT)
    role: Literal["input", "output", "reference"]
    stands_for: Text = Field(description="the column of the rig that was started from")
    by: Literal["name", "word", "unit", "you"] = Field(
        description="how it was identified; you: by --column"
    )
    scaled: Flag = Field(description="whether a gain is fitted, because the quantities differ")


class OtherMatch(Model):
    """Another rig that the columns fit."""

    rig: Text
    score: Number = Field(description="1 where everything fits by name")


class NewRigFile(
    Model, schema="pamid.new-rig/1", title="pamid new-rig: a rig file from a recording's columns"
):
    """The rig file, and where its columns come from."""

    output: Text = Field(description="the rig file")
    rig: Text = Field(description="its name")
    like: Text = Field(description="rig of the catalogue on which it is based")
    score: Number = Field(description="1 where everything fits by name")
    columns: ListOf[TakenColumn]
    unrecorded: ListOf[Text] = Field(description="columns of the rig that were not recorded")
    unused: ListOf[Text] = Field(description="recorded columns that the rig has no place for")
    unobserved: ListOf[Text] = Field(
        (), description="states that were left out: no recorded column depends on them"
    )
    turned: ListOf[Text] = Field(
        (), description="rigs to start from in which cause and effect have changed places"
    )
    also: ListOf[OtherMatch] = Field(description="other rigs that fit, best first")
