"""`write_report`: from the folder of a run or a trial to its page and figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pamid.errors import FileError
from pamid.report.budget import ChannelErrors, errors_of, headline, worst_window
from pamid.report.evidence import pulls_drawing, pulls_of, timeline_drawing, training_drawing
from pamid.report.figures import (
    budget_drawing,
    missing_drawing,
    ports_drawing,
    ranking_drawing,
    regimes_drawing,
    window_drawing,
)
from pamid.report.load import RunData, load_run, read_steps
from pamid.report.page import MARK, page_html
from pamid.report.style import Drawing, Picture, render
from pamid.report.trial import read_trial
from pamid.report.trial_figures import trial_drawings
from pamid.report.trial_page import trial_html
from pamid.run import FIGURES, Run, write_atomically

#: every figure this version can write; older ones of these names are removed when a run no longer has them
FIGURE_NAMES = ("ports", "regimes", "timeline", "missing", "ranking", "budget", "window", "window-network",
                "background", "training", "targets", "reliability", "confusion", "strata")
TRIAL = "trial.json"


@dataclass(frozen=True)
class Report:
    """What was written; `errors` are the rows of the MAE table."""

    page: Path
    figures: tuple[Path, ...]
    errors: tuple[ChannelErrors, ...]

    @property
    def mae(self) -> dict[str, dict[str, float]]:
        """Channel -> model -> held-out MAE in the channel's unit."""
        return {row.channel: row.known() for row in self.errors}


def write_report(run_folder: Path, output: Path | None = None) -> Report:
    """Read a run or a trial, write `report.html` (or `output`) and RUN/figures/*.png; same run, same bytes.

    FileError if the folder is no run, holds no result, a file of it is damaged, or `output` exists and is no report.
    """
    page = run_folder / "report.html" if output is None else output
    trial = read_trial(run_folder / TRIAL)
    if trial is not None:
        Run.open(run_folder)
        steps = read_steps(run_folder / "run.json")
        return _written(run_folder, page, (), trial_drawings(trial), lambda found: trial_html(trial, steps, found))
    run = load_run(run_folder)
    rows = errors_of(run)
    return _written(run_folder, page, rows, drawings_of(run, rows), lambda found: page_html(run, rows, found))


def _written(run_folder: Path, page: Path, rows: tuple[ChannelErrors, ...], drawings: list[Drawing],
             html_of: Callable[[dict[str, Picture]], str]) -> Report:
    """Everything is drawn before anything is written."""
    _require_own(page)
    pictures = {drawing.name: render(drawing) for drawing in drawings}
    html = html_of(pictures)
    folder = run_folder / FIGURES
    _make(folder)
    _make(page.parent)
    for name in FIGURE_NAMES:
        if name in pictures:
            write_atomically(folder / f"{name}.png", pictures[name].png)
        else:
            (folder / f"{name}.png").unlink(missing_ok=True)
    write_atomically(page, html.encode("utf-8", errors="replace"))
    return Report(page, tuple(folder / f"{name}.png" for name in FIGURE_NAMES if name in pictures), rows)


def drawings_of(run: RunData, rows: tuple[ChannelErrors, ...]) -> list[Drawing]:
    """The drawings that the content of this run allows."""
    found: list[Drawing | None] = []
    diagnosis, row = run.diagnosis, headline(rows)
    gap = diagnosis is None or diagnosis.verdict != "no-structural-gap"
    if diagnosis is not None:
        found += [ranking_drawing(diagnosis), missing_drawing(run)]
        found += [ports_drawing(diagnosis), regimes_drawing(diagnosis)] if gap else []
    found += [budget_drawing(rows, diagnosis), pulls_drawing(pulls_of(run))]
    if run.residual is not None and row is not None:
        found += [*([timeline_drawing(run, row.channel)] if gap else []), *_windows(run, row.channel)]
    if run.trace is not None:
        found.append(training_drawing(run.trace, run.network))
    return [drawing for drawing in found if drawing is not None]


def _windows(run: RunData, channel: str) -> list[Drawing]:
    """The worst window with the cause, and again with the network where its trace was written."""
    residual = run.residual
    window = worst_window(residual, channel) if residual is not None else None
    if residual is None or window is None:
        return []
    found = [window_drawing(run, residual, channel, window, ("data_sheet", "refitted", "cause"))]
    if residual.of(channel, "network") is not None:
        found.append(window_drawing(run, residual, channel, window, ("refitted", "network")))
    return found


def _require_own(page: Path) -> None:
    """A page that pamid made is replaced without asking; anything else is somebody's file."""
    if not page.exists():
        return
    try:
        with open(page, "rb") as file:
            own = file.read(len(MARK)) == MARK.encode()
    except OSError as error:
        raise FileError(f"{page} cannot be replaced: {error.strerror}.", "Choose another --output.") from error
    if not own:
        raise FileError(f"{page} exists and is not a report.", "Choose another --output.", code="exists")


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{folder} cannot be made: {error.strerror}.", code="write") from error
