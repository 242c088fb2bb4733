"""The results of a paper on a twin of its rig, into a run folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol, cast

from pamid.base.errors import PamidError, UsageError, nearest
from pamid.base.progress import Progress, silent
from pamid.base.run_folder import Run
from pamid.base.scanned import modules_of


class Paper(Protocol):
    """A module of the folder `papers`. OPTIONS: what its plan takes besides seed and quick,
    and "resume" where it can go on with what was interrupted. The docstring tells what is done; it
    stands in the command's help."""

    OPTIONS: tuple[str, ...]

    def plan(self, *, seed: int, quick: bool, **options: Any) -> Any:
        """A frozen dataclass with all that the results depend on; quick: too little to be
        believed, to see it work."""

    def reproduce(
        self, run: Run, plan: Any, *, progress: Progress, **resume: bool
    ) -> dict[str, Any]:
        """Run the reproduction, write all files into the run, and return the result in the schema
        of its file."""

    def text(self, content: dict[str, Any]) -> str:
        """The same for people."""

    def converged(self, content: dict[str, Any]) -> bool:
        """Is it what it was to become?"""


def paper_named(name: str) -> Paper:
    """The paper of this name; UsageError where there is none."""
    papers = modules_of("pamid.api.replications.papers")
    if name not in papers:
        raise UsageError(f"There is no paper {name!r}.", nearest(name, papers))
    return cast(Paper, papers[name])


def reproduce_paper(
    name: str,
    output: Path,
    *,
    command: Sequence[str],
    options: Mapping[str, Any],
    resume: bool = False,
    overwrite: bool = False,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Reproduce the paper of this name; the run in `output` is closed with its outcome. PamidError
    where there is no such paper or the folder is taken, and whatever the paper raises.

    options: arguments of `Paper.plan`; resume: go on in a folder where the same was interrupted.
    """
    paper = paper_named(name)
    plan, seed = paper.plan(**options), options["seed"]
    noted = {"paper": name, **asdict(plan)}
    if resume:
        run = Run.open(output)
        run.begin_step(command=command, seed=seed, options=noted)
    else:
        run = Run.create(output, command=command, seed=seed, options=noted, overwrite=overwrite)
    more = {"resume": resume} if "resume" in paper.OPTIONS else {}
    try:
        content = paper.reproduce(run, plan, progress=progress, **more)
    except (PamidError, KeyboardInterrupt) as error:
        run.finish("failed" if isinstance(error, PamidError) else "interrupted")
        raise
    run.finish()
    return content


def number_cell(value: float | None, width: int) -> str:
    """A number of a table, or a dash."""
    return f"{'-':>{width}s}" if value is None else f"{value:{width}.4f}"
