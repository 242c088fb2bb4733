"""`pamid ingest`: Turn raw logs into recordings: columns, units, an even time base."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import frame
from .hints import unused
from .options import parse_known
from .terminal import aside, progress_line, quoted

if TYPE_CHECKING:
    from pamid.ingest.conversion import Conversion
    from pamid.model.rig import Rig

PLACE = 30
EXAMPLE = """
pamid ingest --guess data/example/joint.csv --pressures gauge --output map.toml
pamid ingest data/example/joint.csv --mapping map.toml --output joint.csv
"""
CURES = ("ask", "late-stamps", "jittered-sampling", "none")


@frame.command("ingest", example=EXAMPLE)
@click.argument("logs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--mapping",
    type=click.Path(dir_okay=False, path_type=Path),
    help="TOML that says which channel becomes which column.",
)
@click.option(
    "--guess",
    is_flag=True,
    help="Write a first mapping for LOG instead, with comments, to be corrected.",
)
@click.option(
    "--rig",
    help="Rig by name, or the path of a rig file (it is run). [default: the one the mapping names; "
    "with --guess one-dof]",
)
@click.option(
    "--pressures",
    type=click.Choice(["gauge", "absolute"]),
    help="What all pressures of the log are; where neither this nor the mapping says, it is asked.",
)
@click.option(
    "--time-base",
    "repair",
    type=click.Choice(CURES),
    help="How to mend uneven stamps, over the mapping's time.repair.",
)
@click.option(
    "--known",
    multiple=True,
    metavar="NAME=VALUE",
    help="Parameter of the rig known for these recordings, as inertia_kg_m2=0.0896; over the "
    "mapping's.",
)
@click.option("--kind", help="Format of the logs, where their name and content do not tell.")
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    help="CSV file; several recordings are numbered. Or a folder. With --guess the TOML file "
    "[default: printed].",
)
@frame.overwrite_option("Replace outputs that exist.")
def command(
    logs: tuple[Path, ...],
    mapping: Path | None,
    guess: bool,
    rig: str | None,
    pressures: str | None,
    repair: str | None,
    known: tuple[str, ...],
    kind: str | None,
    output: Path | None,
    overwrite: bool,
) -> frame.Result:
    """Turn raw LOGS into recordings: units, signs, gauge pressures, an even time base.

    First `--guess` writes a mapping to look through. With it, each log becomes a CSV with a TOML
    beside it and an account of everything that was done (.ingest.json). Uneven stamps are diagnosed
    before they are mended; where the data do not tell, it is asked. Long gaps split a recording,
    they are never bridged.
    """
    from pamid.base.errors import UsageError

    if guess:
        if mapping is not None or len(logs) != 1:
            raise UsageError("--guess takes one LOG and no --mapping.")
        return _guess(
            logs[0], rig or "one-dof", pressures, parse_known(known), kind, output, overwrite
        )
    if mapping is None or output is None:
        missing = "--mapping" if mapping is None else "--output"
        hint = (
            f"`pamid ingest --guess {quoted(logs[0])} --output {unused('map.toml')}` writes a "
            "mapping."
        )
        raise UsageError(
            f"{missing} is missing.",
            hint if mapping is None else f"For example --output {unused('recording.csv', logs)}.",
        )
    return _ingest(
        logs, mapping, rig, pressures, repair, parse_known(known), kind, output, overwrite
    )


def _guess(
    log: Path,
    rig: str,
    pressures: str | None,
    known: dict[str, float],
    kind: str | None,
    output: Path | None,
    overwrite: bool,
) -> frame.Result:
    from pamid.base.errors import FileError
    from pamid.base.files import write_atomically
    from pamid.ingest.guessed_mapping import guess_mapping
    from pamid.ingest.log_reader import read_log
    from pamid.model.registry import rig_named

    if output is not None and output.exists() and not overwrite:
        raise FileError(
            f"{output} exists already.",
            "Choose another --output, or --overwrite to replace it.",
            code="exists",
        )
    found = guess_mapping(read_log(log, kind), rig, rig_named(rig), pressures, known)
    said = {
        "schema": "pamid.mapping/1",
        "log": str(log),
        "output": str(output) if output else None,
        "toml": found.text,
        "open": list(found.open),
    }
    if output is None:
        return frame.Result(said, found.text)
    write_atomically(output, found.text.encode())
    to_answer = "".join(f"\n  to be answered: {key}" for key in found.open)
    text = (
        f"{output}: {found.mapped} of {found.channels} channels guessed.{to_answer}\n"
        f"Next: look it through, then pamid ingest {quoted(log)} --mapping "
        f"{quoted(output)}{_named(rig)}"
        f"{f' --kind {kind}' if kind else ''} --output {quoted(unused('recording.csv', [log]))}"
    )
    return frame.Result(said, text)


def _ingest(
    logs: tuple[Path, ...],
    mapping: Path,
    rig_name: str | None,
    pressures: str | None,
    repair: str | None,
    known: dict[str, float],
    kind: str | None,
    output: Path,
    overwrite: bool,
) -> frame.Result:
    from pamid.base.errors import FileError
    from pamid.ingest.account import outputs_for, write_conversions
    from pamid.ingest.conversion import convert
    from pamid.ingest.log_reader import read_log
    from pamid.ingest.mapping import load_mapping

    parsed = load_mapping(mapping, pressures)
    rig = _rig(rig_name or parsed.rig, bool(rig_name), mapping)
    parsed = parsed.model_copy(
        update={"rig": rig_name or parsed.rig, "known": {**parsed.known, **known}}
    )
    made = []
    with progress_line("reading logs", len(logs)) as progress:
        for number, log in enumerate(logs):
            progress.update(number, log.name)
            made.append(convert(read_log(log, kind), parsed, rig, str(mapping), repair or ""))
    as_folder = output.is_dir() or not output.suffix  # a Path does not keep a trailing slash
    if as_folder and output.is_file() or not as_folder and output.suffix != ".csv":
        raise FileError(
            f"{output} is neither a .csv file nor a folder.",
            "A recording's name ends in .csv.",
            code="write",
        )
    accounts = write_conversions(made, outputs_for(made, output, as_folder), mapping, overwrite)
    warnings = [note for conversion in made for note in conversion.notes]
    for note in dict.fromkeys(warnings):
        aside(f"Warning: {note}")
    said = {"schema": "pamid.ingest/1", "recordings": accounts}
    return frame.Result(said, _text(made, accounts, _named(rig_name or parsed.rig or "")))


def _rig(name: str | None, named_here: bool, mapping: Path) -> Rig | None:
    from pamid.base.errors import FileError
    from pamid.base.trust import is_code
    from pamid.model.registry import catalogue_rig, rig_named

    if name is None or named_here:
        return rig_named(name) if name is not None else None
    if is_code(name):
        raise FileError(
            f"{mapping} names the rig file {name!r}.",
            f"A rig file is code, run only when you name it yourself: add --rig {quoted(name)}.",
        )
    return catalogue_rig(name)


def _named(rig: str) -> str:
    """The option that names a rig's file: one that a mapping or a recording names is not run."""
    from pamid.base.trust import is_code

    return f" --rig {quoted(rig)}" if is_code(rig) else ""


def _text(made: list[Conversion], accounts: list[dict[str, Any]], rig: str) -> str:
    lines = []
    for account in accounts:
        about = account["recording"]
        lines.append(
            f"{about['path']}: {about['samples']} samples, {about['sampling_period_s']:g} s apart, "
            f"{about['duration_s']:.4g} s: {', '.join(about['columns'])}."
        )
    for conversion in made:
        lines.append(
            f"{conversion.log.path.name} ({conversion.log.kind}): "
            f"{'; '.join(conversion.log.details)}."
        )
        for clock in conversion.clocks:
            if clock.found is not None:
                cure = "kept" if clock.cure == "none" else f"mended as {clock.cure}"
                lines.append(f"  {clock.name}: {cure}; {clock.found.why}.")
            lines += [
                f"    {repair.detail}" for repair in (*clock.rows.repairs, *clock.base.repairs)
            ]
        if abs(conversion.stretch - 1.0) > 1e-6:
            ppm = 1e6 * (conversion.stretch - 1.0)
            lines.append(f"    its clock and {conversion.period:g} s differ by {ppm:.0f} ppm")
    return "\n".join([*lines, f"Next: pamid check {quoted(accounts[0]['recording']['path'])}{rig}"])
