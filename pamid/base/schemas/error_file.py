"""JSON of every command that fails."""

from __future__ import annotations

from pydantic import Field

from pamid.base.schemas.model import Model, Text


class ErrorFile(Model, schema="pamid.error/1", title="Every command that fails"):
    """Error, its place and its cure."""

    code: Text = Field(description="a stable word for scripts")
    message: Text = Field(description="what is wrong and where")
    hint: Text = Field(description="how to correct it")
