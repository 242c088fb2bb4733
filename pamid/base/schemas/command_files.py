"""JSON of the smaller commands: a model per command.

`pamid --help`, completion scripts and errors are made without pydantic, which would be half of
their time: their models only describe them.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, WithJsonSchema

from pamid.base.schemas.estimates import EFFECTS, PERIOD, RIG, SEED, UNIT
from pamid.base.schemas.model import (
    Count,
    Figures,
    Flag,
    ListOf,
    MapOf,
    Model,
    Number,
    Sometimes,
    Text,
)
from pamid.base.schemas.score_file import RecordingError

LOOP = "closed or open: was a controller producing the command?"
SEEN_BY = "error of the refitted model over the noise floor"


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


class ErrorFile(Model, schema="pamid.error/1", title="Every command that fails"):
    """Error, its place and its cure."""

    code: Text = Field(description="a stable word for scripts")
    message: Text = Field(description="what is wrong and where")
    hint: Text = Field(description="how to correct it")


class RunSummary(Model):
    """A run folder at a glance."""

    path: Text = Field(description="folder of the run")
    kind: Text = Field(description="diagnosis, fit, trial, paper, other or damaged")
    command: Text = Field(description="name of its command")
    rig: Text = Field(description=RIG)
    recordings: ListOf[Text] = Field(description="names of the recordings")
    begun: Text = Field(description="UTC, ISO 8601")
    outcome: Text = Field(description="how it ended; empty while it runs")
    verdict: Text = Field(description="of a diagnosis, as in diagnosis.json")
    sentence: Text = Field(description="result in words, or the damage")
    causes: ListOf[Text] = Field(description="labels of the effects that the verdict names")
    mae: MapOf[Figures] = Field(
        description="held-out mean absolute error in the channel's unit: channel -> model",
    )


class RunList(
    Model, schema="pamid.runs/1", title="pamid runs: the runs below a folder with their results"
):
    """The runs below a folder."""

    folder: Text = Field(description="searched folder")
    runs: ListOf[RunSummary] = Field(default=(), description="by path")


class WrittenComparison(
    Model, schema="pamid.comparison/1", title="pamid report --compare: a comparison of runs"
):
    """A page that compares runs."""

    page: Text = Field(description="path of the page")
    runs: ListOf[RunSummary] = Field(
        default=(), description="in the order in which they were given"
    )
    changed: ListOf[Text] = Field(default=(), description="differences in data and settings")


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
