"""`pamid ingest`: Turn raw logs into recordings: columns, units, an even time base."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Literal

from pamid.api.options.logs import (
    RIG_TEXT,
    IngestArguments,
    LogArguments,
    angles_option,
    only_option,
)
from pamid.api.options.record import AnyPath, RigName, argument, option
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


@dataclass(frozen=True, kw_only=True)
class Arguments(IngestArguments):
    __doc__ = IngestArguments.__doc__

    logs: Sequence[AnyPath] = argument()
    rig: RigName | None = option(
        None,
        f"{RIG_TEXT} [default: the rig that the mapping names. --guess without a rig: every "
        "channel keeps its name]",
    )
    guess: bool = option(
        False, "Write a first mapping for LOG instead, with comments. Check and correct it."
    )
    angles: Literal["deg", "rad"] | None = angles_option()
    only: str | None = only_option()
    output: AnyPath | None = option(
        None,
        "CSV file (several recordings are numbered) or folder. [default: recording.csv] With "
        "--guess the TOML file. [default: print it]",
    )


@frame.command("ingest", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    from pamid.api.ingesting import ingest

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
    with progress_line("reading logs", len(logs)) as progress:
        wanted = replace(a, output=Path(a.output or "recording.csv"), progress=progress)
        ingested = ingest.of(wanted)
    for note in ingested.notes:
        warning(note)
    first = ingested.accounts[0].recording
    assert first is not None
    text = f"{ingested.summary()}\nNext: pamid check {quoted(first.path)}{_named(ingested.rig)}"
    return frame.Result(ingested.to_dict(), text)


def _guess(log: Path, a: Arguments) -> frame.Result:
    from pamid.api.ingesting import guess_mapping
    from pamid.base.schemas.command_files import GuessedMappingFile

    output = None if a.output is None else Path(a.output)
    shared = {item.name: getattr(a, item.name) for item in fields(LogArguments)}
    guess = guess_mapping(log, a.rig, **shared, angles=a.angles, only=a.only, output=output)
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
