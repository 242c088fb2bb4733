"""`pamid ingest`: Turn raw logs into recordings: columns, units, an even time base."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from . import frame, names
from .hints import unused
from .options import parse_known
from .terminal import aside, progress_line, quoted

HELP_ORDER = 30
EXAMPLE = """
pamid ingest --guess data/example/joint.csv --rig one-dof --pressures gauge --output map.toml
pamid ingest data/example/joint.csv --mapping map.toml --output joint.csv
"""


@frame.command("ingest", example=EXAMPLE)
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--mapping",
    type=click.Path(dir_okay=False, path_type=Path),
    help="TOML that assigns channels to columns.",
)
@click.option(
    "--guess",
    is_flag=True,
    help="Write a first mapping for LOG instead, with comments. Check and correct it.",
)
@click.option(
    "--rig",
    help="Rig by name, or the path of a rig file (it is run). [default: the rig that the mapping "
    "names; with --guess none, and every channel keeps its name]",
)
@click.option(
    "--pressures",
    type=click.Choice(["gauge", "absolute"]),
    help="Kind of all pressures of the log. Required if the mapping does not state it.",
)
@click.option(
    "--period",
    type=click.FloatRange(min=0.0, min_open=True),
    metavar="SECONDS",
    help="Sampling period of a log without a clock. Required if the mapping does not state it.",
)
@click.option(
    "--angles",
    type=click.Choice(["deg", "rad"]),
    help="With --guess: unit of all angles for which the log states none.",
)
@click.option(
    "--only",
    metavar="TEXT",
    help="With --guess, for a log with several robots: use channels whose names contain this.",
)
@click.option(
    "--time-base",
    "repair",
    type=click.Choice(names.cures()),
    help="Repair of uneven stamps. Overrides the mapping's time.repair.",
)
@click.option(
    "--known",
    multiple=True,
    metavar="NAME=VALUE",
    help="Parameter of the rig known for these recordings, as inertia_kg_m2=0.0896. Overrides the "
    "mapping.",
)
@click.option("--kind", help="Format of the logs, if their name and content do not determine it.")
@click.option(
    "--memory-limit",
    type=click.FloatRange(min=0.0, min_open=True),
    metavar="GIB",
    help="Most memory for reading one log, in GiB. A log that declares more is refused before it "
    "is read. [default: 1]",
)
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    help="CSV file (several recordings are numbered) or folder. [default: recording.csv] With "
    "--guess the TOML file. [default: print it]",
)
@frame.overwrite_option("Replace outputs that exist.")
def command(
    logs: tuple[Path, ...],
    mapping: Path | None,
    guess: bool,
    rig: str | None,
    pressures: str | None,
    period: float | None,
    angles: str | None,
    only: str | None,
    repair: str | None,
    known: tuple[str, ...],
    kind: str | None,
    memory_limit: float | None,
    output: Path | None,
    overwrite: bool,
) -> frame.Result:
    """Convert raw LOGS to recordings: units, signs, gauge pressures, an even time base.

    First write a mapping with `--guess`, and check it. With the mapping, each log becomes a CSV, a
    TOML next to it, and a record of all conversions (.ingest.json). Uneven stamps are diagnosed and
    repaired. If the data do not determine the repair, an error names the options. A long gap splits
    the recording and is never bridged. If one log has several recordings, each becomes a separate
    CSV; `*` in the mapping stands for its part. In a robot's log (ROS JointState, LeRobot, MuJoCo's
    vectors) `--guess` finds the joints and motors of a model by name or order.
    """
    from pamid.base.errors import UsageError
    from pamid.ingest.ingesting import ingest

    if guess:
        if mapping is not None or len(logs) != 1:
            raise UsageError("--guess takes one LOG and no --mapping.")
        answers = {
            "pressures": pressures,
            "period": period,
            "angles": angles,
            "only": only or "",
            "kind": kind,
            "memory_limit": memory_limit,
        }
        return _guess(logs[0], rig, answers, parse_known(known), output, overwrite)
    if angles or only:
        raise UsageError(f"{'--angles' if angles else '--only'} belongs to --guess.")
    if mapping is None:
        raise UsageError(
            "--mapping is missing.",
            f"`pamid ingest --guess {quoted(logs[0])} --output {unused('map.toml')}` writes a "
            "mapping.",
        )
    with progress_line("reading logs", len(logs)) as progress:
        ingested = ingest(
            logs,
            mapping,
            rig=rig,
            pressures=pressures,
            period=period,
            repair=repair,
            known=parse_known(known),
            kind=kind,
            memory_limit=memory_limit,
            output=output or Path("recording.csv"),
            overwrite=overwrite,
            progress=progress,
        )
    for note in ingested.notes:
        aside(f"Warning: {note}")
    first = ingested.accounts[0].recording
    assert first is not None
    text = f"{ingested.summary()}\nNext: pamid check {quoted(first.path)}{_named(ingested.rig)}"
    return frame.Result(ingested.to_dict(), text)


def _guess(
    log: Path,
    rig: str | None,
    answers: dict[str, Any],
    known: dict[str, float],
    output: Path | None,
    overwrite: bool,
) -> frame.Result:
    from pamid.ingest.ingesting import guess_mapping
    from pamid.schemas.command_files import GuessedMappingFile

    guess = guess_mapping(log, rig, **answers, known=known, output=output, overwrite=overwrite)
    further = "".join(
        f" {option} {value}"
        for option, value in (
            ("--kind", answers["kind"]),
            ("--memory-limit", answers["memory_limit"]),
        )
        if value
    )
    content = GuessedMappingFile(
        log=str(log),
        output=str(output) if output else None,
        toml=guess.text,
        open=guess.open,
        notes=guess.notes,
    )
    for note in guess.notes:
        aside(f"Warning: {note}")
    if output is None:
        return frame.Result(content, guess.text)
    to_answer = "".join(f"\n  to be filled in: {key}" for key in guess.open)
    text = (
        f"{output}: {guess.mapped} of {guess.channels} channels guessed.{to_answer}\n"
        f"Next: check the mapping, then pamid ingest {quoted(log)} --mapping "
        f"{quoted(output)}{_named(rig or '')}"
        f"{further} --output {quoted(unused('recording.csv', [log]))}"
    )
    return frame.Result(content, text)


def _named(rig: str) -> str:
    """The --rig option for a rig file, since a file named by a mapping or recording is not run."""
    from pamid.base.trust import is_code

    return f" --rig {quoted(rig)}" if is_code(rig) else ""
