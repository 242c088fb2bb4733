"""What commands share that do many independent jobs: who does them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from pamid.base.run_folder import Run
    from pamid.parallel.jobs import WorkerPool

cluster_option = click.option(
    "--cluster",
    metavar="tcp://HOST:8786",
    help="Hand the jobs to the Dask cluster of this scheduler instead; results "
    "are the same. Scheduler and workers must be trusted: jobs and results are pickled, so "
    "whoever can reach the "
    "scheduler can run code on the workers and here. Over TLS: tls://HOST:8786, with certificates "
    "from Dask's "
    "configuration or DASK_DISTRIBUTED__COMM__TLS__CA_FILE, ..__CLIENT__CERT, ..__CLIENT__KEY. "
    "(pip install 'pamid[cluster]')",
)


@contextlib.contextmanager
def pool_of(jobs: int, cluster: str | None, *, kept: Path | None = None) -> Iterator[WorkerPool]:
    """Who does the jobs: processes of this machine, or a cluster; kept: the folder of their
    results."""
    from pamid.parallel.jobs import WorkerPool
    from pamid.parallel.result_store import Store

    store = Store(kept) if kept else None
    if cluster is None:
        yield WorkerPool(jobs, store)
        return
    from pamid.parallel.dask_backend import cluster as connected

    with connected(cluster) as executor:
        yield WorkerPool(jobs, store, executor)


@contextlib.contextmanager
def carried_through(run: Run, pool: WorkerPool) -> Iterator[None]:
    """Close the run with a word for how it ended, and how many jobs it took; their results go once
    all are done."""
    try:
        yield
    except BaseException as error:
        run.finish(
            "interrupted" if isinstance(error, KeyboardInterrupt) else "failed", jobs=pool.counts
        )
        raise
    run.finish("partial" if pool.failed else "done", jobs=pool.counts)
    if pool.store and not pool.failed:
        pool.store.clear()


def require_one_of(resume: bool, overwrite: bool) -> None:
    """UsageError where both are asked for."""
    from pamid.base.errors import UsageError

    if resume and overwrite:
        raise UsageError(
            "--resume goes on with the earlier run, --overwrite replaces it.", "Give one of them."
        )


def kept(path: Path, text_of: Callable[[dict[str, Any]], str]) -> tuple[dict[str, Any], str]:
    """What a finished run holds, and its text; FileError where it is not what was once written
    there."""
    from pamid.base.errors import FileError
    from pamid.base.json_file import read_json

    found = read_json(path)
    try:
        return found, text_of(found)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise FileError(
            f"{path} is damaged: it lacks entries, or they are not what they should be "
            f"({type(error).__name__}: {error}).",
            "Make the run again with --overwrite.",
            code="damaged",
        ) from None


def failed_text(found: dict[str, Any]) -> list[str]:
    """A line per job that failed."""
    return [f"Failed    {f['job']}: {f['why']}" for f in found.get("failed_jobs", ())]
