"""`pamid report`: Turn a run into tables, figures and an HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from pamid.api.options.record import (
    AnyPath,
    FilePath,
    RigName,
    argument,
    option,
)
from pamid.base.errors import UsageError

from . import frame
from .terminal import staged_progress, warning

HELP_ORDER = 110
EXAMPLE = """
pamid report run --output report.html
pamid report run --pdf
pamid report --compare run fitted
"""
_NEXT_TO_PAGE = "-"  # --pdf without a file


@dataclass(frozen=True)
class Arguments:
    """Write a self-contained HTML page and figures for the run folder RUN. A run of `pamid trial`
    or `pamid reproduce-paper` gets a page as well.

    The page begins with three answers: where the gap lies, which effect causes it, and how far it
    shrinks. Plots of all samples and the evidence follow. The page works offline, has a light and a
    dark theme, and can be printed. The figures are written to RUN/figures as PNG.
    """

    runs: Sequence[AnyPath] = argument(default=(), metavar="RUN")
    output: FilePath | None = option(
        None, "Page to write. [default: RUN/report.html, or comparison.html]"
    )
    pdf: str | None = option(
        None,
        "Also print the page as a PDF, by an installed Chromium, Chrome or Edge. [default: next to "
        "the page]",
        metavar="[FILE]",
        click={
            "is_flag": False,
            "flag_value": _NEXT_TO_PAGE,
            "type": click.Path(dir_okay=False),
        },
    )
    compare: bool = option(
        False, "Compare two or more runs: causes, parameters, errors and differences of the data."
    )
    rig: RigName | None = option(
        None,
        "Path of the rig file of the run (it is run), for a rig outside the catalogue: the "
        "animation needs its pose.",
    )
    overwrite: bool = option(False, "Replace the page even if it is not a report of pamid.")

    def page_and_pdf(self, default: Path) -> tuple[Path, Path | None]:
        """Paths of the page and, on request, of the PDF."""
        page = default if self.output is None else Path(self.output)
        if self.pdf is None:
            return page, None
        return page, page.with_suffix(".pdf") if self.pdf == _NEXT_TO_PAGE else Path(self.pdf)


@frame.command("report", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    runs = [Path(run) for run in arguments.runs]
    if not runs:
        raise UsageError(
            "The run folder is missing.", "`pamid runs` lists the runs in and below this folder."
        )
    if arguments.compare and arguments.rig is not None:
        raise UsageError("--compare draws no rig.", "Leave --rig out.")
    if arguments.compare:
        return _comparison(runs, arguments)
    if len(runs) > 1:
        raise UsageError(
            f"A page shows a single run, but {len(runs)} were given.",
            "Add --compare to compare them.",
        )
    return _page(runs[0], arguments)


def _page(run: Path, arguments: Arguments) -> frame.Result:
    """Page of a run."""
    from pamid.base.schemas.command_files import WrittenReport
    from pamid.report.channel_errors import mae_text
    from pamid.report.recording_errors import recording_errors_text
    from pamid.report.writing import write_report

    page, pdf = arguments.page_and_pdf(run / "report.html")
    output = None if arguments.output is None else page
    with staged_progress("report") as progress:
        progress.say("reading the run")
        report = write_report(run, output, pdf, rig=arguments.rig, overwrite=arguments.overwrite)
    for note in report.notes:
        warning(f"{report.page}: {note}")
    content = WrittenReport(
        page=str(report.page),
        figures=tuple(map(str, report.figures)),
        mae=report.mae,
        recordings=report.recordings,
    )
    table = f"{mae_text(report.errors)}\n\n" if report.errors else ""
    if report.recordings:
        table += f"{recording_errors_text(report.recordings)}\n\n"
    written = ""
    if report.pdf is not None:
        content = content.model_copy(update={"pdf": str(report.pdf)})
        written = f"\nPDF:  {report.pdf}"
    return frame.Result(content, f"{table}Page: {report.page}{written}")


def _comparison(runs: list[Path], arguments: Arguments) -> frame.Result:
    """Page that compares several runs."""
    from pamid.base.schemas.command_files import WrittenComparison
    from pamid.report.comparison_page import changes_of, compared_runs, comparison_sentence
    from pamid.report.run_summaries import summary_of
    from pamid.report.writing import write_comparison

    comparison = compared_runs(runs)
    page, pdf = arguments.page_and_pdf(Path("comparison.html"))
    write_comparison(comparison, page, pdf, overwrite=arguments.overwrite)
    changed = changes_of(comparison)
    written = WrittenComparison(
        page=str(page), runs=tuple(map(summary_of, runs)), changed=tuple(changed)
    )
    lines = [comparison_sentence(comparison).replace("\u00a0", " ")]
    lines += [f"Differs in: {', '.join(changed)}."] if changed else []
    lines += ["", f"Page: {page}", *([f"PDF:  {pdf}"] if pdf is not None else [])]
    return frame.Result(written, "\n".join(lines))
