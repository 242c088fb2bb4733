"""`pamid report`: Turn a run into tables, figures and one HTML page."""

from __future__ import annotations

from pathlib import Path

import click

from . import frame

PLACE = 110
EXAMPLE = """
pamid report run --output report.html
pamid report run --pdf
"""
_BESIDE = "-"  # --pdf without a file


@frame.command("report", example=EXAMPLE)
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Page to write. [default: RUN/report.html]",
)
@click.option(
    "--pdf",
    is_flag=False,
    flag_value=_BESIDE,
    type=click.Path(dir_okay=False),
    help="Write it as a PDF as well; without FILE beside the page.",
    metavar="[FILE]",
)
def command(run: Path, output: Path | None, pdf: str | None) -> frame.Result:
    """Turn the run folder RUN into one self-contained HTML page and figures; or that of a trial, or
    of a paper.

    The page puts three answers first: where the gap lies, which effect causes it, how far it
    shrinks; then plots of all samples and the evidence. It needs no network, follows light and
    dark, and prints. Figures go to RUN/figures as PNG.
    """
    from pamid.report.recording_errors import recording_errors_text
    from pamid.report.tables import mae_text
    from pamid.report.writing import write_report
    from pamid.schemas.command_files import WrittenReport

    page = run / "report.html" if output is None else output
    paper = None if pdf is None else page.with_suffix(".pdf") if pdf == _BESIDE else Path(pdf)
    report = write_report(run, output, paper)
    found = WrittenReport(
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
        found = found.model_copy(update={"pdf": str(report.pdf)})
        written = f"\nPDF:  {report.pdf}"
    return frame.Result(found, f"{table}Page: {report.page}{written}")
