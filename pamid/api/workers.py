"""Run folders that results refer to, and the jobs of a run."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

from pamid.base.errors import FileError
from pamid.base.files import TABLE, PathLike, is_inside, read_data, write_atomically
from pamid.base.json_file import read_json, write_json
from pamid.base.parallel.jobs import WorkerPool
from pamid.base.parallel.result_store import Store
from pamid.base.run_folder import FIT_FILE, JOBS, RUN_FILE, Run
from pamid.model.effect import Effect
from pamid.model.rig import Rig
from pamid.report.load import RunData, load_run

if TYPE_CHECKING:
    from pamid.recording.plot import NotebookFigure


class RunHome:
    """The folder of a run: named by the user, or a temporary folder that goes with the last
    result that refers to it."""

    def __init__(self, folder: Path | None) -> None:
        if folder is None:
            folder = Path(tempfile.mkdtemp(prefix="pamid-"))
            weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self.folder = folder


#: a rig and effects, as `load_identified` takes them
RunCode: TypeAlias = tuple[str | Rig | None, tuple[str | type[Effect], ...]]


@dataclass(frozen=True, kw_only=True)
class OpenedRun:
    """A run folder, with the rig and effects of the run where they are files or Python objects."""

    result_file: ClassVar[str] = FIT_FILE

    folder: Path
    code: RunCode = (None, ())
    _home: RunHome = field(repr=False)

    @classmethod
    def of(cls, run: OpenedRun | PathLike) -> OpenedRun:
        """The run, opened where it is a folder."""
        if isinstance(run, OpenedRun):
            return run
        return OpenedRun(folder=Path(run), _home=RunHome(Path(run)))

    @cached_property
    def data(self) -> RunData:
        """All that the files of the run hold."""
        return load_run(self.folder)

    def to_dict(self) -> dict[str, Any]:
        """JSON object of the command."""
        content: dict[str, Any] = read_json(self.folder / self.result_file)
        return content

    def plot_worst_window(self, channel: str | None = None) -> NotebookFigure:
        """Measured and modelled over the held-out window in which the refitted model errs most;
        channel [default: the most informative]."""
        from pamid.api.plots import worst_window_figure

        return worst_window_figure(self.data, channel)

    def save(self, folder: PathLike, *, overwrite: bool = False) -> Path:
        """Copy the run folder: its record (run.json) and every file that the record lists, byte by
        byte. `pamid.open_run` opens it again.

        FileError where something else is in `folder`, or a file would lead out of the run.
        """
        source, target = self.folder, Path(folder)
        if target.resolve() == source.resolve():
            return target
        record = Run.open(source).record
        listed = record.get("files")
        names = [n for n in listed if isinstance(n, str)] if isinstance(listed, list) else []
        content = {}
        for name in names:
            path, inside = source / name, PurePath(name)
            if not path.exists():
                continue
            if inside.is_absolute() or not is_inside(source, inside) or path.is_symlink():
                raise FileError(
                    f"{source / RUN_FILE} lists {name!r}, which is not a file of that folder.",
                    "Take it out of the list, or copy the folder by hand.",
                    code="run-folder",
                )
            content[name] = read_data(path, TABLE)
        copy = Run.create(
            target,
            command=record.get("command") or "pamid",
            seed=record.get("seed"),
            options=record["options"],
            overwrite=overwrite,
        )
        for name, path in zip(content, copy.claim(*content), strict=True):
            write_atomically(path, content[name])
        write_json(target / RUN_FILE, {**record, "files": list(content)})
        return target

    def _figure(self, content: str) -> NotebookFigure:
        # with matplotlib, which no run needs
        from pamid.api.plots import figure

        return figure(self.data, content)


@contextmanager
def worker_pool(
    jobs: int, cluster: str | None = None, *, run_folder: Path | None = None
) -> Iterator[WorkerPool]:
    """Processes of this machine, or the Dask cluster of a scheduler; run_folder: where results of
    single jobs stay while the run goes on."""
    store = Store(run_folder / JOBS) if run_folder else None
    if cluster is None:
        yield WorkerPool(jobs, store)
        return
    from pamid.base.parallel.dask_backend import cluster as connected

    with connected(cluster) as executor:
        yield WorkerPool(jobs, store, executor)


@contextmanager
def closing(run: Run, pool: WorkerPool, *, further: bool = False) -> Iterator[None]:
    """Record the outcome of a run or of a further step when the block ends.

    A run also records its job counts. Stored job results are deleted if no job failed.
    """

    def finish(outcome: str) -> None:
        run.finish(outcome, **({} if further else {"jobs": pool.counts}))

    try:
        yield
    except BaseException as error:
        finish("interrupted" if isinstance(error, KeyboardInterrupt) else "failed")
        raise
    finish("partial" if pool.failed else "done")
    if pool.store and not pool.failed:
        pool.store.clear()
