"""`pamid ingest`: Turn raw logs into recordings: columns, units, an even time base."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pamid.api.options.names import cures
from pamid.api.options.record import (
    AnyPath,
    FilePath,
    RigName,
    argument,
    known_option,
    option,
    overwrite_option,
)
from pamid.base.errors import UsageError, quoted
from pamid.base.trust import is_code

from . import frame
from .hints import unused
from .terminal import progress_line, warning

HELP_ORDER = 30
EXAMPLE = """
pamid ingest --guess data/example/joint.csv --rig one-dof --pressures gauge --output map.toml
pamid ingest data/example/joint.csv --mapping map.toml --output joint.csv
"""


@dataclass(frozen=True)
class Arguments:
    """Convert raw LOGS to recordings: units, signs, gauge pressures, an even time base.

    First write a mapping with `--guess`, and check it. With the mapping, each log becomes a CSV, a
    TOML next to it, and a record of all conversions (.ingest.json). Uneven stamps are diagnosed and
    repaired. If the data do not determine the repair, an error names the options. A long gap splits
    the recording and is never bridged. If a log has several recordings, each becomes a separate
    CSV; `*` in the mapping stands for its part. In a robot's log (ROS JointState, LeRobot, MuJoCo's
    vectors) `--guess` finds the joints and motors of a model by name or order.
    """

    logs: Sequence[AnyPath] = argument()
    mapping: FilePath | None = option(None, "TOML that assigns channels to columns.")
    guess: bool = option(
        False, "Write a first mapping for LOG instead, with comments. Check and correct it."
    )
    rig: RigName | None = option(
        None,
        "Rig by name, or the path of a rig file (it is run). [default: the rig that the mapping "
        "names. --guess without a rig: every channel keeps its name]",
    )
    pressures: Literal["gauge", "absolute"] | None = option(
        None, "Kind of all pressures of the log. Required if the mapping does not state it."
    )
    period: float | None = option(
        None,
        "Sampling period of a log without a clock. Required if the mapping does not state it.",
        metavar="SECONDS",
        above=0.0,
    )
    angles: Literal["deg", "rad"] | None = option(
        None, "With --guess: unit of all angles for which the log states none."
    )
    only: str | None = option(
        None,
        "With --guess, for a log with several robots: use channels whose names contain this.",
        metavar="TEXT",
    )
    repair: str | None = option(
        None,
        "Repair of uneven stamps. Overrides the mapping's time.repair.",
        "--time-base",
        choices=cures(),
    )
    known: Mapping[str, float] | None = known_option(
        "Parameter of the rig known for these recordings, as inertia_kg_m2=0.0896. Overrides the "
        "mapping."
    )
    kind: str | None = option(
        None, "Format of the logs, if their name and content do not determine it."
    )
    memory_limit: float | None = option(
        None,
        "Most memory for reading a log, in GiB. A log that declares more is refused before it is "
        "read. [default: 1]",
        metavar="GIB",
        above=0.0,
    )
    output: AnyPath | None = option(
        None,
        "CSV file (several recordings are numbered) or folder. [default: recording.csv] With "
        "--guess the TOML file. [default: print it]",
    )
    overwrite: bool = overwrite_option("Replace outputs that exist.")

    def shared(self) -> dict[str, Any]:
        """Arguments that a conversion and a guess share."""
        names = ("rig", "pressures", "period", "known", "kind", "memory_limit", "overwrite")
        return {name: getattr(self, name) for name in names}


@frame.command("ingest", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    from pamid.ingest.ingesting import ingest

    a, logs = arguments, [Path(log) for log in arguments.logs]
    if a.guess:
        if a.mapping is not None or len(logs) != 1:
            raise UsageError("--guess takes a single LOG and no --mapping.")
        return _guess(logs[0], a)
    if a.angles or a.only:
        raise UsageError(f"{'--angles' if a.angles else '--only'} belongs to --guess.")
    if a.mapping is None:
        raise UsageError(
            "--mapping is missing.",
            f"`pamid ingest --guess {quoted(logs[0])} --output {unused('map.toml')}` writes a "
            "mapping.",
        )
    output = Path(a.output or "recording.csv")
    with progress_line("reading logs", len(logs)) as progress:
        ingested = ingest(
            logs, a.mapping, **a.shared(), repair=a.repair, output=output, progress=progress
        )
    for note in ingested.notes:
        warning(note)
    first = ingested.accounts[0].recording
    assert first is not None
    text = f"{ingested.summary()}\nNext: pamid check {quoted(first.path)}{_named(ingested.rig)}"
    return frame.Result(ingested.to_dict(), text)


def _guess(log: Path, a: Arguments) -> frame.Result:
    from pamid.base.schemas.command_files import GuessedMappingFile
    from pamid.ingest.ingesting import guess_mapping

    output = None if a.output is None else Path(a.output)
    guess = guess_mapping(log, **a.shared(), angles=a.angles, only=a.only or "", output=output)
    content = GuessedMappingFile(
        log=str(log),
        output=str(output) if output else None,
        toml=guess.text,
        open=guess.open,
        notes=guess.notes,
    )
    for note in guess.notes:
        warning(note)
    if output is None:
        return frame.Result(content, guess.text)
    to_answer = "".join(f"\n  to be filled in: {key}" for key in guess.open)
    further = f" --kind {a.kind}" if a.kind else ""
    further += f" --memory-limit {a.memory_limit}" if a.memory_limit else ""
    text = (
        f"{output}: {guess.mapped} of {guess.channels} channels guessed.{to_answer}\n"
        f"Next: check the mapping, then pamid ingest {quoted(log)} --mapping "
        f"{quoted(output)}{_named(a.rig or '')}"
        f"{further} --output {quoted(unused('recording.csv', [log]))}"
    )
    return frame.Result(content, text)


def _named(rig: str) -> str:
    """The --rig option for a rig file, since a file named by a mapping or recording is not run."""
    return f" --rig {quoted(rig)}" if is_code(rig) else ""
