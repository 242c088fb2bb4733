"""JSON of every command that fails."""

from __future__ import annotations

from typing import Literal

from pydantic import ConfigDict, Field

from pamid.schemas.model import Model, Text


class ErrorFile(Model):
    """Error, its place and its cure."""

    model_config = ConfigDict(title="Every command that fails")

    schema_: Literal["pamid.error/1"] = Field(default="pamid.error/1", alias="schema")
    code: Text = Field(description="a stable word for scripts")
    message: Text = Field(description="what is wrong and where")
    hint: Text = Field(description="how to mend it")
