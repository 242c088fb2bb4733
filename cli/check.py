"""`pamid check`: Find faults of a recording, rig or effect before any fitting."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pamid.api.options.preparing import CheckArguments
from pamid.api.options.record import FilePath, option
from pamid.base.errors import UsageError, quoted

from . import frame
from .figures import require_png, write_figure
from .hints import rig_words
from .terminal import staged_progress

if TYPE_CHECKING:
    from pamid.base.work_stages import WorkStage

HELP_ORDER = 40
EXAMPLE = """
pamid check rec.csv --rig one-dof --figure card.png
"""
WRONG = 3


@dataclass(frozen=True, kw_only=True)
class Arguments(CheckArguments):
    __doc__ = CheckArguments.__doc__

    figure: FilePath | None = option(
        None,
        "PNG to draw: every channel of a recording, with the places of each finding; a rig as a "
        "block diagram of its ports.",
    )
    everything: bool = option(False, "Print every finding and port of a rig.", "--all")
    overwrite: bool = option(False, "Replace the figure if it exists.", formerly="--force")


@frame.command("check", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    from pamid.api.checking import check

    file, figure = Path(str(arguments.subject)), arguments.figure
    require_png(figure, arguments.overwrite)
    with staged_progress("check", stages=_stages(file)) as progress:
        progress.say("reading")
        result = check.of(arguments)
    content, text = result.to_dict(), result.summary(everything=arguments.everything)
    if figure is not None and result.kind not in ("recording", "rig"):
        raise UsageError(
            "--figure draws recordings and rigs only.", f"Leave it out: {file} is neither."
        )
    if figure is not None and result.drawable:
        text = f"{text}\n{write_figure(figure, result.plot_png())}"
        content = {**content, "figure": str(figure)}
    follow = _follow(file, str(arguments.rig or ""), result.kind, content)
    return frame.Result(content, f"{text}\nNext: {follow}", 0 if result.ok else WRONG)


def _follow(file: Path, rig: str, kind: str, content: dict[str, Any]) -> str:
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
    return f"pamid new-rig {path}   (writes a rig for it; use --rig for an existing rig)"


def _recording_of(rig: Path) -> str:
    """The recording whose columns a rig file names, if it is near; else a placeholder."""
    text = rig.read_text(encoding="utf-8", errors="replace") if rig.suffix == ".py" else ""
    if named := re.search(r"with the columns of ([\w./-]+\.csv)\.$", text, re.MULTILINE):
        for path in (Path(named[1]), rig.parent / named[1]):
            if path.is_file():
                return quoted(path)
    return "rec.csv"


def _stages(file: Path) -> tuple[WorkStage, ...]:
    """Work stages for a file of this kind; () for an effect, which has a stage per port it fits."""
    from pamid.base.trust import MODEL_ENDINGS
    from pamid.base.work_stages import WORK_STAGES

    if file.suffix == ".csv":
        return WORK_STAGES["check"]
    if file.suffix in MODEL_ENDINGS:
        return WORK_STAGES["check a model"]
    try:
        text = file.read_text(encoding="utf-8", errors="replace") if file.suffix == ".py" else ""
    except OSError:
        text = ""
    # judged by its text: the file is not run
    is_effect = re.search(r"^class \w+\([^)]*Effect\)", text, re.MULTILINE)
    return () if is_effect else WORK_STAGES["check a rig"]
