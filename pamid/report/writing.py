"""`write_report`: from a run, a trial or a reproduced paper to its page, figures and PDF."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from pamid.base.errors import FileError
from pamid.base.files import PAGE, make_folder, read_data, write_together
from pamid.base.progress import tell
from pamid.base.run_files import read_steps
from pamid.base.run_folder import DIAGNOSIS_FILE, FIGURES_FOLDER, RUN_FILE, Run
from pamid.base.schemas.score_file import RecordingError
from pamid.report.added_variable_figure import added_drawing, added_places
from pamid.report.channel_errors import ChannelErrors, errors_of, headline, worst_window
from pamid.report.comparison_page import ComparedRun, comparison_page
from pamid.report.evidence_figures import (
    correlation_drawing,
    error_signal_drawing,
    pulls_drawing,
    timeline_drawing,
    training_drawing,
)
from pamid.report.figures import (
    budget_drawing,
    comparison_drawing,
    free_form_drawing,
    free_run_drawing,
    missing_drawing,
    ports_drawing,
    ranking_drawing,
    regimes_drawing,
    window_drawing,
)
from pamid.report.load import RunData, load_run
from pamid.report.motion import NO_POSE, rig_of_run
from pamid.report.page import MARK, Page, html_of
from pamid.report.paper_page import paper_page, read_paper
from pamid.report.pdf import PDF_MARK, printed
from pamid.report.recording_errors import held_out_errors
from pamid.report.rig_figure import rig_drawing
from pamid.report.run_page import run_page
from pamid.report.style import Drawing, Picture, render
from pamid.report.trial_figures import trial_drawings
from pamid.report.trial_page import trial_page
from pamid.report.trial_results import read_trial

#: every figure this version can write; older ones of these names are removed when a run no longer
#: has them
FIGURE_NAMES = (
    "rig",
    "ports",
    "regimes",
    "timeline",
    "error-signal",
    "free-form",
    "missing",
    "ranking",
    "comparison",
    "added-variable",
    "budget",
    "free-run",
    "window",
    "window-network",
    "background",
    "correlation",
    "training",
    "targets",
    "reliability",
    "confusion",
    "strata",
)
TRIAL = "trial.json"


@dataclass(frozen=True)
class Report:
    """Written report; `errors`: rows of the MAE table, `recordings`: errors per recording, `pdf`:
    path if requested, `notes`: remarks about omitted parts."""

    page: Path
    figures: tuple[Path, ...]
    errors: tuple[ChannelErrors, ...]
    pdf: Path | None = None
    recordings: tuple[RecordingError, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def mae(self) -> dict[str, dict[str, float]]:
        """Channel -> model -> held-out MAE in the channel's unit."""
        return {row.channel: row.known() for row in self.errors}


@dataclass(frozen=True)
class Content:
    """Content of a report: rows of the MAE table, drawings, and the page once those are drawn."""

    errors: tuple[ChannelErrors, ...]
    drawings: list[Drawing]
    page_of: Callable[[dict[str, Picture]], Page]
    recordings: tuple[RecordingError, ...] = ()
    notes: tuple[str, ...] = ()


def write_report(
    run_folder: Path,
    output: Path | None = None,
    pdf: Path | None = None,
    *,
    rig: str | None = None,
    overwrite: bool = False,
) -> Report:
    """Read a run, a trial or a reproduced paper, write `report.html` (or `output`) and
    RUN/figures/*.png; the same folder gives the same bytes. pdf: a file for the same on paper; rig:
    the file of the run's rig (it is run), whose pose is played; overwrite: replace `output` and
    `pdf` whatever they are.

    FileError if the folder is no run, holds no result, a file of it is damaged, `output` or `pdf`
    exists and is no report, no browser prints the PDF, or `rig` is another rig or has no pose.
    """
    page = run_folder / "report.html" if output is None else output
    content = content_of(run_folder, rig)
    if not overwrite:
        _require_ours(page, pdf)
    pictures = {}
    for k, drawing in enumerate(content.drawings):
        tell(f"pictures {k}/{len(content.drawings)}: {drawing.name}")
        pictures[drawing.name] = render(drawing)
    tell("the page")
    files = _files(content.page_of(pictures), page, pdf)  # before anything is written
    figure_names = {f"{FIGURES_FOLDER}/{name}.png": name for name in FIGURE_NAMES}
    drawn = [file for file, name in figure_names.items() if name in pictures]
    run = Run.open(run_folder)
    run.remove(*(file for file in figure_names if file not in drawn))
    figures = run.claim(*drawn, *(item.name for item in files if item.parent == run_folder))
    figures = figures[: len(drawn)]
    pngs = {
        path: pictures[figure_names[file]].png for path, file in zip(figures, drawn, strict=True)
    }
    write_together({**pngs, **files})
    return Report(page, tuple(figures), content.errors, pdf, content.recordings, content.notes)


def _files(content: Page, page: Path, pdf: Path | None) -> dict[Path, bytes]:
    """The page, on request also printed, and folders for them."""
    html = html_of(content).encode(errors="replace")
    files = {pdf: printed(html), page: html} if pdf is not None else {page: html}
    for path in files:
        make_folder(path.parent)
    return files


def content_of(run_folder: Path, rig: str | None = None) -> Content:
    """Read and check the content of a folder; FileError as above."""
    trial = read_trial(run_folder / TRIAL)
    paper = read_paper(run_folder)
    if trial is not None or paper is not None:
        Run.open(run_folder)
        steps = read_steps(run_folder / RUN_FILE)
    if trial is not None:
        return Content((), trial_drawings(trial), partial(trial_page, trial, steps))
    if paper is not None and not (run_folder / DIAGNOSIS_FILE).exists():
        return Content((), [], partial(paper_page, paper, steps, None, ()))
    run = load_run(run_folder)
    rows = errors_of(run)
    drawings, recordings = drawings_of(run, rows), held_out_errors(run)
    if paper is not None:
        return Content(rows, drawings, partial(paper_page, paper, steps, run, rows), recordings)
    drawn_by, notes = None, tuple[str, ...]()
    try:
        drawn_by = None if rig is None else rig_of_run(run, rig)
    except FileError as error:
        if error.code != NO_POSE:
            raise
        notes = (f"no animation: {error.message} {error.hint}",)
    page_of = partial(run_page, run, rows, drawn_by=drawn_by)
    return Content(rows, drawings, page_of, recordings, notes)


def drawings_of(run: RunData, rows: tuple[ChannelErrors, ...]) -> list[Drawing]:
    """The drawings that the content of this run allows."""
    drawings: list[Drawing | None] = []
    diagnosis, row = run.diagnosis, headline(rows)
    gap = diagnosis is None or diagnosis.verdict != "no-structural-gap"
    if diagnosis is not None:
        drawings += [
            rig_drawing(diagnosis),
            ranking_drawing(diagnosis, added_places(run)),
            added_drawing(run),
            comparison_drawing(diagnosis),
            free_form_drawing(diagnosis),
            missing_drawing(run),
        ]
        drawings += [ports_drawing(diagnosis), regimes_drawing(diagnosis)] if gap else []
    drawings += [budget_drawing(rows, diagnosis), pulls_drawing(run), correlation_drawing(run.fit)]
    if run.residual is not None and row is not None:
        channel, residual = row.channel, run.residual
        over = [timeline_drawing(run, channel), error_signal_drawing(run, channel)]
        drawings += [*(over if gap else []), free_run_drawing(run, residual, channel)]
        kinds: list[tuple[str, ...]] = [("data_sheet", "refitted", "cause")]
        if residual.of(channel, "network") is not None:
            before = ("refitted", "cause") if run.network_on_causes(channel) else ("refitted",)
            kinds.append((*before, "network"))
        if (window := worst_window(residual, channel)) is not None:
            drawings += [window_drawing(run, residual, channel, window, k) for k in kinds]
    if run.trace is not None:
        drawings.append(training_drawing(run.trace, run.network))
    return [drawing for drawing in drawings if drawing is not None]


def write_comparison(
    runs: Sequence[ComparedRun], page: Path, pdf: Path | None = None, *, overwrite: bool = False
) -> None:
    """Write the page of several runs, also as PDF; FileError if a file exists and is not a report,
    unless it may be overwritten."""
    if not overwrite:
        _require_ours(page, pdf)
    write_together(_files(comparison_page(runs), page, pdf))


def _require_ours(page: Path, pdf: Path | None) -> None:
    """Raise unless pamid wrote the files: only those are replaced without a question."""
    for path, begin, end in ((page, MARK.encode(), b""), (pdf, b"%PDF", PDF_MARK)):
        if path is None or not path.exists():
            continue
        try:
            content = read_data(path, PAGE)
        except OSError as error:
            raise FileError(
                f"{path} cannot be replaced: {error.strerror}.", "Choose another name."
            ) from error
        if not (content.startswith(begin) and content.endswith(end)):
            raise FileError(
                f"{path} exists and is not a report.",
                "Choose another name, or replace it by --overwrite.",
                code="exists",
            )
