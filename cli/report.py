"""`pamid report`: Turn a run into tables, figures and one HTML page."""

from __future__ import annotations

from pathlib import Path

import click

from . import frame
from .terminal import told_progress, warning

PLACE = 110
EXAMPLE = """
pamid report run --output report.html
pamid report run --pdf
pamid report --compare run fitted
"""
_BESIDE = "-"  # --pdf without a file


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
    flag_value=_BESIDE,
    type=click.Path(dir_okay=False),
    help="Print it as a PDF as well, by an installed Chromium, Chrome or Edge; without FILE beside "
    "the page.",
    metavar="[FILE]",
)
@click.option(
    "--compare",
    is_flag=True,
    help="Put two or more runs side by side: causes, parameters, errors, what changed in the data.",
)
@click.option(
    "--rig",
    help="Path of the file of the run's rig (it is run), where that is not of the catalogue: for "
    "the animation, which needs its pose.",
)
@frame.overwrite_option("Replace the page also where it is no report of pamid's.")
def command(
    runs: tuple[Path, ...],
    output: Path | None,
    pdf: str | None,
    compare: bool,
    rig: str | None,
    overwrite: bool,
) -> frame.Result:
    """Turn the run folder RUN into one self-contained HTML page and figures; or that of a trial, or
    of a paper.

    The page puts three answers first: where the gap lies, which effect causes it, how far it
    shrinks; then plots of all samples and the evidence. It needs no network, follows light and
    dark, and prints. Figures go to RUN/figures as PNG.
    """
    from pamid.base.errors import UsageError

    if not runs:
        raise UsageError("No run was named.", "`pamid runs` lists those in and below this folder.")
    if compare and rig is not None:
        raise UsageError("--compare draws no rig.", "Leave --rig out.")
    if compare:
        return _comparison(runs, output, pdf, overwrite)
    if len(runs) > 1:
        raise UsageError(
            f"One run makes a page; {len(runs)} were named.", "To put them side by side: --compare."
        )
    return _page(runs[0], output, pdf, rig, overwrite)


def _page(
    run: Path, output: Path | None, pdf: str | None, rig: str | None, overwrite: bool
) -> frame.Result:
    """The page of one run."""
    from pamid.report.recording_errors import recording_errors_text
    from pamid.report.tables import mae_text
    from pamid.report.writing import write_report
    from pamid.schemas.command_files import WrittenReport

    page = run / "report.html" if output is None else output
    paper = None if pdf is None else page.with_suffix(".pdf") if pdf == _BESIDE else Path(pdf)
    with told_progress("report") as progress:
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
    """The page of several runs, side by side."""
    from pamid.report.comparison_page import changes_of, compared_runs, comparison_sentence
    from pamid.report.run_summaries import summary_of
    from pamid.report.writing import write_comparison
    from pamid.schemas.runs_file import WrittenComparison

    comparison = compared_runs(runs)
    page = Path("comparison.html") if output is None else output
    paper = None if pdf is None else page.with_suffix(".pdf") if pdf == _BESIDE else Path(pdf)
    write_comparison(comparison, page, paper, overwrite=overwrite)
    changed = changes_of(comparison)
    written = WrittenComparison(
        page=str(page), runs=tuple(map(summary_of, runs)), changed=tuple(changed)
    )
    lines = [comparison_sentence(comparison).replace("\u00a0", " ")]
    lines += [f"Differs in: {', '.join(changed)}."] if changed else []
    lines += ["", f"Page: {page}", *([f"PDF:  {paper}"] if paper is not None else [])]
    return frame.Result(written, "\n".join(lines))
