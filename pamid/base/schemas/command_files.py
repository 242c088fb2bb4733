"""JSON of the smaller commands: a model per command.

`pamid --help`, completion scripts and errors are made without pydantic, which would be half of
their time: their models only describe them.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, WithJsonSchema

from pamid.base.schemas.estimates import EFFECTS, PERIOD, RIG, SEED
from pamid.base.schemas.model import Count, Flag, ListOf, MapOf, Model, Number, Sometimes, Text
from pamid.base.schemas.score_file import RecordingError

LOOP = "closed or open: was a controller producing the command?"


class PrintedText(
    Model, schema="pamid.text/1", title="A command that prints text only, such as --help"
):
    """A command whose only result is a text."""

    text: Text = Field(description="the printed text")


class CompletionScript(
    Model, schema="pamid.completion/1", title="pamid completion: the script of a shell"
):
    """Script by which a shell completes pamid's commands."""

    shell: Literal["bash", "zsh", "fish"]
    script: Text = Field(description="script for the shell")
    line: Text = Field(description="the line that runs it")
    place: Text = Field(description="the file in which the line belongs")


OPTION_VALUE = {
    "type": ["array", "boolean", "null", "number", "string"],
    "items": {"type": "string"},
}


class OptionSetting(Model):
    """The value of an option without a command line."""

    value: Annotated[Any, WithJsonSchema(OPTION_VALUE)] = Field(description="in the option's unit")
    origin: Text = Field(description="source of the value")


class AllSettings(
    Model, schema="pamid.config/1", title="pamid config: the value of every option and its source"
):
    """Every option of the requested commands."""

    file: Text | None = Field(description="the pamid.toml in use; null without a file")
    commands: MapOf[MapOf[OptionSetting]] = Field(description="command -> option -> its value")
    ignored: dict[Text, Text] = Field(description="ignored settings files, and the reason")
    harmless_only: Text = Field(
        description="why files to run, a cluster and permission to replace files are ignored in "
        "the file; empty if they are used"
    )


class SimulatedFile(
    Model, schema="pamid.simulate/1", title="pamid simulate: the simulated recording"
):
    """A recording that was made by a model."""

    output: Text = Field(description="path of the recording")
    samples: Count = Field(description="number of samples")
    rig: Text | None = Field(description=RIG)
    loop: Text | None = Field(description=LOOP)
    effects: ListOf[Text] = Field(description=EFFECTS)
    seed: Count | None = Field(description=SEED)


class GuessedMappingFile(
    Model, schema="pamid.mapping/1", title="pamid ingest --guess: a first mapping"
):
    """A first mapping of a raw log, which the user must check."""

    log: Text = Field(description="path of the log")
    output: Text | None = Field(description="file of the mapping; null if it is only printed")
    toml: Text = Field(description="the mapping as text")
    open: ListOf[Text] = Field(description="keys that the user must fill in")
    notes: ListOf[Text] = Field(
        default=(), description="columns and joints without a channel, with nearest names"
    )


class WrittenReport(Model, schema="pamid.report/1", title="pamid report: the page and its figures"):
    """The files of a report."""

    page: Text = Field(description="path of the HTML page")
    figures: ListOf[Text] = Field(description="paths of the pictures")
    mae: MapOf[MapOf[Number]] = Field(
        description="mean absolute error, in the unit of the channel: channel -> model -> error"
    )
    recordings: ListOf[RecordingError] = Field(
        (), description="the same per held-out recording, comparison and channel, with RMS"
    )
    pdf: Sometimes[Text] = Field(default=None, description="path of the PDF, if requested")


class WrittenAnimation(
    Model, schema="pamid.animate/1", title="pamid animate: a GIF of a rig's motion"
):
    """An animated picture of a stretch of a recording."""

    output: Text = Field(description="path of the GIF")
    rig: Text | None = Field(description=RIG)
    recording: Text = Field(description="its name")
    from_s: Number = Field(description="first moment, s of the recording")
    to_s: Number = Field(description="last moment, s of the recording")
    speed: Number = Field(description="seconds of the recording per second of the animation")
    frames: Count
    frames_per_second: Count
    width_px: Count
    height_px: Count
    bytes: Count = Field(description="size of the file")
    mean_gap: MapOf[MapOf[Number]] = Field(
        description="per channel and model, in the unit of the channel"
    )


class PlainChannel(Model):
    """Mean absolute errors of a channel on held-out data, in its unit."""

    before: Number = Field(description="of the file that was written into")
    now: Number = Field(description="of the new file")
    stated: Number | None = Field(None, description="value in the run; null without a value")
    best: Number = Field(description="of the new file with the best step and integrator")


class PlainSettings(Model):
    """Time step and integrator of a simulator."""

    timestep_s: Number = Field(description="s")
    integrator: Text = Field(description="as a model file names it")


class PlainMujoco(PlainSettings):
    """A written model file run in plain MuJoCo, with the step and integrator of the file."""

    channels: MapOf[PlainChannel] = Field(description="errors by channel")
    best: PlainSettings = Field(
        description="step and integrator that reach the errors which the run states, else the best "
        "that were tried"
    )
    reached: Flag | None = Field(
        description="whether these reach the stated errors, up to a fifth; null where the run "
        "states none"
    )


class WrittenExport(
    Model, schema="pamid.export/1", title="pamid export: the files of an exported model"
):
    """The files of an exported model."""

    to: Text = Field(description="the form")
    files: ListOf[Text] = Field(description="paths of the written files")
    binary: Text | None = Field(description="platform that an FMU was built for; empty for none")
    rig: Text | None = Field(description=RIG)
    effects: ListOf[Text] = Field(description=EFFECTS)
    network: Text | None = Field(description="kind of the network in it; empty for none")
    period_s: Number = Field(description=PERIOD)
    inputs: ListOf[Text] = Field(description="input columns")
    outputs: ListOf[Text] = Field(description="output columns")
    notes: ListOf[Text] = Field(description="remarks for the user, a sentence each")
    plain_mujoco: Sometimes[PlainMujoco] = Field(
        default=None, description="of a model file: its errors in plain MuJoCo"
    )
