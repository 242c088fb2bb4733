"""`pamid reproduce-paper`: The results of the two papers, on calibrated virtual rigs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pamid.api.options.names import papers
from pamid.api.options.record import (
    FolderPath,
    jobs_option,
    option,
    seed_option,
)
from pamid.base.errors import join_words

from . import frame
from .terminal import progress_line

HELP_ORDER = 90
EXAMPLE = """
pamid reproduce-paper --quick --output paper-run
pamid reproduce-paper --paper arm --quick --output arm-run
"""
PAPERS = papers()


def _for_papers(name: str, text: str) -> dict[str, Any]:
    """Help of an option that not every paper has, and the papers that have it."""
    owners = tuple(paper for paper, (options, _) in PAPERS.items() if name in options)
    return {"text": text.format(f"({join_words(owners, 'or')})"), "applies_to": owners}


@dataclass(frozen=True)
class Arguments:
    __doc__ = "\n\n".join(
        [
            "Print the result tables of a paper, computed on a virtual twin of its rig.",
            *(f"{name}: {what}." for name, (_, what) in PAPERS.items()),
            "The rigs are virtual twins, not the authors'.",
        ]
    )

    paper: str = option("joint", "Paper to reproduce.", choices=tuple(PAPERS))
    iterations: int | None = option(
        None,
        least=1,
        **_for_papers(
            "iterations",
            "Levenberg-Marquardt steps at most, for every start. {} [default: 1000; 30 with "
            "--quick]",
        ),
    )
    starts: int = option(
        4,
        least=1,
        most=1000,
        **_for_papers("starts", "Random starts of the network; the best is kept. {}"),
    )
    seed: int = seed_option("Seed of excitation, noise and networks.")
    seconds: float | None = option(
        None,
        least=12.0,
        most=3600.0,
        **_for_papers(
            "seconds", "Length of the training record. {} [default: 200; 30 with --quick]"
        ),
    )
    jobs: int = jobs_option(**_for_papers("jobs", "Processes for the diagnosis. {}"))
    output: FolderPath = option("paper-run", "Run folder to create.")
    quick: bool = option(False, "Use short records and few iterations, for a trial.")
    resume: bool = option(
        False,
        **_for_papers("resume", "Continue the same command where it was interrupted. {}"),
    )
    overwrite: bool = option(False, "Replace an earlier run in that folder.")


@frame.command("reproduce-paper", Arguments, example=EXAMPLE)
def command(arguments: Arguments) -> frame.Result:
    from pamid.api.replications.reproducing import paper_named, reproduce_paper
    from pamid.base.work_stages import WORK_STAGES

    a, chosen = arguments, paper_named(arguments.paper)
    special = ("iterations", "starts", "seconds", "jobs", "resume")
    frame.refuse_inapplicable(Arguments, f"--paper {a.paper}")
    options = {name: getattr(a, name) for name in special if name in chosen.OPTIONS}
    resume = options.pop("resume", False)
    how = f"--paper {a.paper}" if a.paper != "joint" else "--quick" if a.quick else ""
    stages = WORK_STAGES.get(f"reproduce-paper {how}".rstrip())
    with progress_line("reproduce-paper", stages=stages) as progress:
        content = reproduce_paper(
            a.paper,
            Path(a.output),
            command=frame.command_line(),
            options={"seed": a.seed, "quick": a.quick, **options},
            resume=resume,
            overwrite=a.overwrite,
            progress=progress.say,
        )
    return frame.Result(content, chosen.text(content), 0 if chosen.converged(content) else 5)
