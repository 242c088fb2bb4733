"""`pamid reproduce-paper`: The results of the two papers, on calibrated virtual rigs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from . import frame, names
from .options import jobs_option, run_output_option, seed_option
from .terminal import progress_line

HELP_ORDER = 90
EXAMPLE = """
pamid reproduce-paper --quick --output paper-run
pamid reproduce-paper --paper arm --quick --output arm-run
"""
PAPERS = names.papers()
HELP = "\n\n".join(
    [
        "Print the result tables of a paper, computed on a virtual twin of its rig.",
        *(f"{name}: {what}." for name, (_, what) in PAPERS.items()),
        "The rigs are virtual twins, not the authors'.",
    ]
)


def _owners(option: str) -> str:
    """Papers with this option, for its help."""
    return f"({names.listed([name for name, (options, _) in PAPERS.items() if option in options])})"


@frame.command("reproduce-paper", example=EXAMPLE, help=HELP)
@click.option(
    "--paper",
    type=click.Choice(list(PAPERS)),
    default="joint",
    show_default=True,
    help="Paper to reproduce.",
)
@click.option(
    "--iterations",
    type=click.IntRange(1),
    help="Levenberg-Marquardt steps at most, for every start. "
    f"{_owners('iterations')} [default: 1000; 30 with --quick]",
)
@click.option(
    "--starts",
    type=click.IntRange(1, 1000),
    default=4,
    show_default=True,
    help=f"Random starts of the network; the best is kept. {_owners('starts')}",
)
@seed_option("Seed of excitation, noise and networks.")
@click.option(
    "--seconds",
    type=click.FloatRange(12.0, 3600.0),
    help=f"Length of the training record. {_owners('seconds')} [default: 200; 30 with --quick]",
)
@jobs_option(f"Processes for the diagnosis. {_owners('jobs')}")
@run_output_option("paper-run")
@click.option("--quick", is_flag=True, help="Use short records and few iterations, for a trial.")
@click.option(
    "--resume",
    is_flag=True,
    help=f"Continue the same command where it was interrupted. {_owners('resume')}",
)
@frame.overwrite_option("Replace an earlier run in that folder.")
def command(
    paper: str, output: Path, overwrite: bool, seed: int, quick: bool, **options: Any
) -> frame.Result:
    from pamid.base.work_stages import WORK_STAGES
    from pamid.replications.reproducing import paper_named, reproduce_paper

    chosen = paper_named(paper)
    _refuse_foreign_options(paper, [name for name in options if name not in chosen.OPTIONS])
    known = {name: value for name, value in options.items() if name in chosen.OPTIONS}
    how = f"--paper {paper}" if paper != "joint" else "--quick" if quick else ""
    stages = WORK_STAGES.get(f"reproduce-paper {how}".rstrip())
    with progress_line("reproduce-paper", stages=stages) as progress:
        content = reproduce_paper(
            paper,
            output,
            command=frame.command_line(),
            seed=seed,
            quick=quick,
            resume=known.pop("resume", False),
            options=known,
            overwrite=overwrite,
            progress=progress.say,
        )
    return frame.Result(content, chosen.text(content), 0 if chosen.converged(content) else 5)


def _refuse_foreign_options(paper: str, foreign: list[str]) -> None:
    """Raise UsageError if an option was given that belongs to other papers."""
    from pamid.base.errors import UsageError

    context = click.get_current_context()
    for name in foreign:
        if context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
            owners = [other for other, (options, _) in PAPERS.items() if name in options]
            raise UsageError(
                f"--{name} does not apply to --paper {paper}.",
                f"It belongs to --paper {names.listed(owners)}.",
            )
