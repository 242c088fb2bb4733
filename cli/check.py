"""`pamid check`: Say what is wrong with a recording, rig or effect, before any fitting."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import frame
from .options import figure_option, require_png, rig_words, write_figure
from .terminal import quoted, told_progress

if TYPE_CHECKING:
    from pamid.base.work_stages import WorkStage

PLACE = 40
EXAMPLE = """
pamid check rec.csv --rig one-dof --figure card.png
"""
WRONG = 3


@frame.command("check", example=EXAMPLE)
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--rig", help="Rig (name or file) the recording is meant for. [default: the one its TOML names]"
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
    """Say what is in FILE and everything that is wrong with it: a recording, a rig file, an effect
    file or a MuJoCo or URDF model.

    A recording (.csv): sampling, range, rest, noise and step of every column; what is clipped,
    frozen, lost, bridged, spiked, coarse or hardly excited; with a rig, columns exchanged, of the
    opposite sign, in another unit or late, inputs beyond their range, and whether each input is
    held or linear between samples. A rig (.py): its equations build, every port is used, nothing
    blows up over the bounds, sensitivities are exact; for every port what passes, its sign, which
    effects can act there and which others each further signal would let act. A model (.xml, .urdf):
    the same, after how it goes and what of it is left out, by element and line. What does not fit
    one screen is shortened there, and complete with --all and --json. An effect (.py):
    its data sheet is complete, its null is exact, and it behaves wherever it fits. Exit code 3 if
    anything is wrong; notes leave it at 0.
    """
    from pamid.api.checking import check
    from pamid.base.errors import UsageError

    require_png(figure, overwrite)
    with told_progress("check", stages=_stages(file)) as progress:
        progress.say("reading")
        result = check(file, rig)
    content, text = result.to_dict(), result.summary(everything=everything)
    if figure is not None and result.kind not in ("recording", "rig"):
        raise UsageError(
            "--figure draws recordings and rigs.", f"Leave it out: {file} holds neither."
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
        return f"mend it, then pamid check {path}{named}"
    if kind == "effect":
        return f"pamid diagnose rec.csv --effect {path}"
    if kind != "recording":
        return f"pamid check {_recording_of(file)} {rig_words(file)}"
    if rig or content["rig"]:
        return f"pamid diagnose {path}{named}"
    return f"pamid new-rig {path}   (writes a rig for it; --rig names one that there is)"


def _recording_of(rig: Path) -> str:
    """The recording whose columns a rig file names, where it is near; else a place for one."""
    text = rig.read_text(encoding="utf-8", errors="replace") if rig.suffix == ".py" else ""
    if named := re.search(r"with the columns of ([\w./-]+\.csv)\.$", text, re.MULTILINE):
        for path in (Path(named[1]), rig.parent / named[1]):
            if path.is_file():
                return quoted(path)
    return "rec.csv"


def _stages(file: Path) -> tuple[WorkStage, ...]:
    """Work stages of a file of this kind; an effect counts one per place where it fits."""
    from pamid.base.trust import MODEL_ENDINGS
    from pamid.base.work_stages import WORK_STAGES

    if file.suffix == ".csv":
        return WORK_STAGES["check"]
    if file.suffix in MODEL_ENDINGS:
        return WORK_STAGES["check a model"]
    return () if _is_effect(file) else WORK_STAGES["check a rig"]


def _is_effect(file: Path) -> bool:
    """By its words, before anything of it is run."""
    try:
        text = file.read_text(encoding="utf-8", errors="replace") if file.suffix == ".py" else ""
    except OSError:
        return False
    return re.search(r"^class \w+\([^)]*Effect\)", text, re.MULTILINE) is not None
