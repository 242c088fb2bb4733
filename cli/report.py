"""`pamid report`: a run as tables, figures and one HTML page."""

from __future__ import annotations

from pathlib import Path

import click

from . import frame

EXAMPLE = """
pamid report RUN --output report.html
"""


@frame.command("report", example=EXAMPLE)
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--output", type=click.Path(dir_okay=False, path_type=Path),
              help="Page to write. [default: RUN/report.html]")
def command(run: Path, output: Path | None) -> frame.Result:
    """Turn the run folder RUN, or that of a trial, into one self-contained HTML page and figures.

    The page puts three answers first: where the gap lies, which effect causes it, how far it shrinks; then the
    evidence. It needs no network, follows light and dark, and prints. Figures go to RUN/figures as PNG.
    """
    from pamid.report.tables import mae_text
    from pamid.report.writing import write_report

    report = write_report(run, output)
    found = {"schema": "pamid.report/1", "page": report.page, "figures": list(report.figures), "mae": report.mae}
    table = f"{mae_text(report.errors)}\n\n" if report.errors else ""
    return frame.Result(found, f"{table}Page: {report.page}")
