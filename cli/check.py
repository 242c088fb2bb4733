"""`pamid check`: Find faults of a recording, rig or effect before any fitting."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import frame
from .options import figure_option, require_png, rig_words, write_figure
from .terminal import quoted, staged_progress

if TYPE_CHECKING:
    from pamid.base.work_stages import WorkStage

HELP_ORDER = 40
EXAMPLE = """
pamid check rec.csv --rig one-dof --figure card.png
"""
WRONG = 3


@frame.command("check", example=EXAMPLE)
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--rig", help="Rig of the recording, by name or file. [default: the one that its TOML names]"
)
@figure_option(
    "every channel of a recording, with the places of each finding; a rig as a block diagram of "
    "its ports"
)
@click.option("--all", "everything", is_flag=True, help="Print every finding and port of a rig.")
@frame.overwrite_option("Replace the figure if it exists.", formerly_force=True)
def command(
    file: Path, rig: str | None, figure: Path | None, everything: bool, overwrite: bool
) -> frame.Result:
    """List the contents and all faults of FILE: a recording, a rig file, an effect file or a MuJoCo
    or URDF model.

    A recording (.csv): sampling, and range, rest, noise and resolution of every column. Faults are
    clipped, frozen, lost, bridged, spiked, coarse or hardly excited signals. With a rig, further
    faults are exchanged columns, opposite signs, wrong units, delays and inputs beyond their range.
    The check also determines whether each input is held or linear between samples.

    A rig (.py): whether its equations build, every port is used, all values stay finite over the
    bounds, and sensitivities are exact. Every port is listed with its quantity, its sign and the
    effects that can act there, also those that a further signal would allow.

    A model (.xml, .urdf): the same, after a list of the elements that are left out, with their
    lines.

    An effect (.py): whether its data sheet is complete, its null is exact, and it behaves at every
    port where it fits.

    Long lists are shortened on the screen, and complete with --all and --json. The exit code is 3
    if there is a fault, and 0 if there are only notes.
    """
    from pamid.api.checking import check
    from pamid.base.errors import UsageError

    require_png(figure, overwrite)
    with staged_progress("check", stages=_stages(file)) as progress:
        progress.say("reading")
        result = check(file, rig)
    content, text = result.to_dict(), result.summary(everything=everything)
    if figure is not None and result.kind not in ("recording", "rig"):
        raise UsageError(
            "--figure draws recordings and rigs only.", f"Leave it out: {file} is neither."
        )
    if figure is not None and result.drawable:
        text = f"{text}\n{write_figure(figure, result.plot_png())}"
        content = {**content, "figure": str(figure)}
    follow = _follow(file, rig, result.kind, content)
    return frame.Result(content, f"{text}\nNext: {follow}", 0 if result.ok else WRONG)


def _follow(file: Path, rig: str | None, kind: str, content: dict[str, Any]) -> str:
    """Next command, for the last line of the output."""
    path, named = quoted(file), f" {rig_words(rig)}" if rig else ""
    if not content["ok"]:
        return f"repair it, then pamid check {path}{named}"
    if kind == "effect":
        return f"pamid diagnose rec.csv --effect {path}"
    if kind != "recording":
        return f"pamid check {_recording_of(file)} {rig_words(file)}"
    if rig or content["rig"]:
        return f"pamid diagnose {path}{named}"
    return f"pamid new-rig {path}   (writes a rig for it; use --rig for an existing one)"


def _recording_of(rig: Path) -> str:
    """The recording whose columns a rig file names, if it is near; else a placeholder."""
    text = rig.read_text(encoding="utf-8", errors="replace") if rig.suffix == ".py" else ""
    if named := re.search(r"with the columns of ([\w./-]+\.csv)\.$", text, re.MULTILINE):
        for path in (Path(named[1]), rig.parent / named[1]):
            if path.is_file():
                return quoted(path)
    return "rec.csv"


def _stages(file: Path) -> tuple[WorkStage, ...]:
    """Work stages for a file of this kind; () for an effect, which has one per port it fits."""
    from pamid.base.trust import MODEL_ENDINGS
    from pamid.base.work_stages import WORK_STAGES

    if file.suffix == ".csv":
        return WORK_STAGES["check"]
    if file.suffix in MODEL_ENDINGS:
        return WORK_STAGES["check a model"]
    return () if _is_effect(file) else WORK_STAGES["check a rig"]


def _is_effect(file: Path) -> bool:
    """Whether the file defines an effect, judged by its text: the file is not run."""
    try:
        text = file.read_text(encoding="utf-8", errors="replace") if file.suffix == ".py" else ""
    except OSError:
        return False
    return re.search(r"^class \w+\([^)]*Effect\)", text, re.MULTILINE) is not None
