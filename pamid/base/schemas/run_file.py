"""run.json: origin of the files of a folder: command, inputs, versions and time."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, Field, ValidationInfo

from pamid.base.schemas.estimates import SEED, SHA256
from pamid.base.schemas.model import Count, ListOf, Model, Sometimes, Text, expected

UTC = "UTC, ISO 8601"


class InputFile(Model):
    """A file that a command read."""

    path: Text
    sha256: Text = Field(description=SHA256)


def _with_named_rig(value: Any, info: ValidationInfo) -> Any:
    rig = value.get("rig") if info.context is not None and isinstance(value, dict) else None
    if rig is not None and not isinstance(rig, str):
        raise expected("an object whose rig is a text")
    return value


class Step(Model):
    """A command that worked on the run."""

    command: ListOf[Text] = Field((), description="the words of the command line")
    seed: Count | None = Field(None, description=SEED)
    options: Annotated[dict[Text, Any], BeforeValidator(_with_named_rig)] = Field(
        {}, description="settings that determine the result, by name"
    )
    inputs: ListOf[InputFile] = Field((), description="files that it read")
    versions: dict[Text, Text] = Field({}, description="of Python and of the packages")
    platform: Sometimes[Text] = Field(default=None, description="of the run itself")
    begun: Text = Field("", description=UTC)
    ended: Text | None = Field(None, description=f"{UTC}; null while it runs")
    outcome: Text | None = Field(None, description="how it ended; null while it runs")

    @property
    def rig(self) -> str:
        """The rig as it was named, by name or by file; "" if none was."""
        return self.options.get("rig") or ""


class Resumption(Model):
    """A command that continued an interrupted run."""

    command: ListOf[Text]
    versions: dict[Text, Text]
    begun: Text = Field(description=UTC)


class RunFile(Step, schema="pamid.run/1", title="run.json: origin of the files of a run"):
    """Origin of the files of a run. A killed run has `ended` null."""

    not_read: ClassVar = ("files", "resumed")

    steps: ListOf[Step] = Field((), description="later commands on the same run")
    files: Sometimes[ListOf[Text]] = Field(
        default=None,
        description="files that pamid wrote, relative to the folder, which --overwrite removes",
    )
    resumed: Sometimes[ListOf[Resumption]] = Field(default=None, description="in their order")
