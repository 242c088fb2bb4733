"""`pamid report`: Turn a run into tables, figures and one HTML page."""

from __future__ import annotations

from pathlib import Path

import click

from . import frame
from .terminal import staged_progress, warning

HELP_ORDER = 110
EXAMPLE = """
pamid report run --output report.html
pamid report run --pdf
pamid report --compare run fitted
"""
_NEXT_TO_PAGE = "-"  # --pdf without a file


@frame.command("report", example=EXAMPLE)
@click.argument("runs", nargs=-1, type=click.Path(path_type=Path), metavar="RUN")
@click.option(
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Page to write. [default: RUN/report.html, or comparison.html]",
)
@click.option(
    "--pdf",
    is_flag=False,
    flag_value=_NEXT_TO_PAGE,
    type=click.Path(dir_okay=False),
    help="Also print the page as a PDF, by an installed Chromium, Chrome or Edge. [default: next "
    "to the page]",
    metavar="[FILE]",
)
@click.option(
    "--compare",
    is_flag=True,
    help="Compare two or more runs: causes, parameters, errors and differences of the data.",
)
@click.option(
    "--rig",
    help="Path of the rig file of the run (it is run), for a rig outside the catalogue: the "
    "animation needs its pose.",
)
@frame.overwrite_option("Replace the page even if it is not a report of pamid.")
def command(
    runs: tuple[Path, ...],
    output: Path | None,
    pdf: str | None,
    compare: bool,
    rig: str | None,
    overwrite: bool,
) -> frame.Result:
    """Write one self-contained HTML page and figures for the run folder RUN. A run of `pamid trial`
    or `pamid reproduce-paper` gets a page as well.

    The page begins with three answers: where the gap lies, which effect causes it, and how far it
    shrinks. Plots of all samples and the evidence follow. The page works offline, has a light and a
    dark theme, and can be printed. The figures are written to RUN/figures as PNG.
    """
    from pamid.base.errors import UsageError

    if not runs:
        raise UsageError(
            "The run folder is missing.", "`pamid runs` lists the runs in and below this folder."
        )
    if compare and rig is not None:
        raise UsageError("--compare draws no rig.", "Leave --rig out.")
    if compare:
        return _comparison(runs, output, pdf, overwrite)
    if len(runs) > 1:
        raise UsageError(
            f"A page shows one run, but {len(runs)} were given.", "Add --compare to compare them."
        )
    return _page(runs[0], output, pdf, rig, overwrite)


def _page(
    run: Path, output: Path | None, pdf: str | None, rig: str | None, overwrite: bool
) -> frame.Result:
    """Page of one run."""
    from pamid.report.recording_errors import recording_errors_text
    from pamid.report.tables import mae_text
    from pamid.report.writing import write_report
    from pamid.schemas.command_files import WrittenReport

    page = run / "report.html" if output is None else output
    paper = None if pdf is None else page.with_suffix(".pdf") if pdf == _NEXT_TO_PAGE else Path(pdf)
    with staged_progress("report") as progress:
        progress.say("reading the run")
        report = write_report(run, output, paper, rig=rig, overwrite=overwrite)
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


def _comparison(
    runs: tuple[Path, ...], output: Path | None, pdf: str | None, overwrite: bool
) -> frame.Result:
    """Page that compares several runs."""
    from pamid.report.comparison_page import changes_of, compared_runs, comparison_sentence
    from pamid.report.run_summaries import summary_of
    from pamid.report.writing import write_comparison
    from pamid.schemas.runs_file import WrittenComparison

    comparison = compared_runs(runs)
    page = Path("comparison.html") if output is None else output
    paper = None if pdf is None else page.with_suffix(".pdf") if pdf == _NEXT_TO_PAGE else Path(pdf)
    write_comparison(comparison, page, paper, overwrite=overwrite)
    changed = changes_of(comparison)
    written = WrittenComparison(
        page=str(page), runs=tuple(map(summary_of, runs)), changed=tuple(changed)
    )
    lines = [comparison_sentence(comparison).replace("\u00a0", " ")]
    lines += [f"Differs in: {', '.join(changed)}."] if changed else []
    lines += ["", f"Page: {page}", *([f"PDF:  {paper}"] if paper is not None else [])]
    return frame.Result(written, "\n".join(lines))
