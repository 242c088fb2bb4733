"""A run: a folder of plain files, each written whole or not at all.

`run.json` is written first (with `ended: null`) and closed last, so that a run that was killed is
known by it. It is the only file with wall-clock times: the same inputs and the same seed give the
same bytes everywhere else.
"""

from __future__ import annotations

import contextlib
import errno
import json
import platform
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path, PurePath
from typing import Any

from pamid.base.errors import FileError
from pamid.base.files import (
    TEMPORARY_NAME,
    is_inside,
    make_folder,
    refuse_write,
    remove_file,
    sha256_of,
    sweep,
)
from pamid.base.json_file import json_text, read_json, write_json

RUN_SCHEMA = "pamid.run/1"
RUN_FILE, FIT_FILE, DIAGNOSIS_FILE = "run.json", "fit.json", "diagnosis.json"
RESIDUAL_FILE, MISSING_FILE = "residual.csv", "missing.csv"
NETWORK_FILE, WEIGHTS_FILE = "network.json", "network.npz"
ADDED_VARIABLES_FILE, FREE_RUN_FILE = "added-variables.json", "free-run.csv"
FIGURES_FOLDER = "figures"
# results of single jobs while a run goes on (pamid.base.parallel.result_store)
JOBS, JOURNAL = "jobs", "journal.jsonl"
_BEGINNING = re.compile(r"\.run\.json\.[0-9]+\.[0-9a-f]+\.tmp")
_JOB = re.compile(r"[0-9a-f]{64}\.npz")
_PACKAGES = [
    "pamid",
    "numpy",
    "scipy",
    "pandas",
    "numba",
    "llvmlite",
    "torch",
    "pysindy",
    "matplotlib",
]


@dataclass(frozen=True)
class Run:
    """A run folder. Make it with `Run.create`, come back to it with `Run.open`."""

    folder: Path

    @classmethod
    def create(
        cls,
        folder: str | Path,
        *,
        command: str | Sequence[str],
        seed: int | None,
        inputs: Sequence[str | Path] = (),
        options: Mapping[str, Any] | None = None,
        overwrite: bool = False,
        resume: bool | None = None,
    ) -> Run:
        """Claim `folder` and write its `run.json`; FileError if it is taken.

        `overwrite` replaces an existing run, but takes away only files that its record lists; a
        folder that holds no run is never touched. `resume` comes back to the run of the same seed,
        inputs and options that the folder holds, if it holds a run (None: this command cannot);
        unless that has come to its end, it counts as begun again.
        """
        path = Path(folder)
        if resume and (path / RUN_FILE).is_file():
            return cls.open(path)._resumed(command, seed, _hashes(inputs), dict(options or {}))
        _require_free(path, overwrite, resumable=resume is not None)
        _require_inside(path, JOBS)
        old = _written(path)
        from pamid.base.schemas.run_file import RunFile  # not to be loaded by what only opens a run

        begun = _begun(command, seed, inputs, options)
        record = RunFile(**begun, platform=platform.platform(), steps=(), files=()).as_json()
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.EDQUOT):
                refuse_write(path, error)
            raise FileError(
                f"{path}: the run folder cannot be made: {error.strerror}.", code="run-folder"
            ) from error
        write_json(path / RUN_FILE, record | {"files": old})
        # after run.json: if this is cut short, the folder already states that it is unfinished, and
        # what may be there
        sweep(path)
        _remove_listed(path, old)
        remove_jobs(path / JOBS)
        if old:
            write_json(path / RUN_FILE, record)
        return cls(path)

    @classmethod
    def open(cls, folder: str | Path) -> Run:
        """An existing run; FileError if the folder holds none."""
        path = Path(folder)
        if not (path / RUN_FILE).is_file():
            hint = "Give the folder that `pamid fit` or `pamid diagnose` wrote with --output."
            raise FileError(
                f"{path} is not a run folder: it has no run.json.", hint, code="not-a-run"
            )
        run = cls(path)
        schema = run.record.get("schema")
        if schema != RUN_SCHEMA:
            raise FileError(
                f"{path / RUN_FILE}: schema is {schema!r}, expected {RUN_SCHEMA!r}.",
                code="not-a-run",
            )
        return run

    def _resumed(
        self,
        command: str | Sequence[str],
        seed: int | None,
        inputs: list[dict[str, str]],
        options: dict[str, Any],
    ) -> Run:
        record, request = self.record, {"seed": seed, "inputs": inputs, "options": options}
        other = [
            what
            for what, value in request.items()
            if record.get(what) != json.loads(json_text(value))
        ]
        _require_inside(self.folder, JOBS)
        if other:
            hint = (
                "Repeat the command unchanged, choose another folder for --output, or replace "
                "that run with --overwrite."
            )
            raise FileError(
                f"{self.folder} contains another run. Differences: {', '.join(other)}.",
                hint,
                code="run-folder",
            )
        if record["outcome"] != "done":
            again = {"command": _command_line(command), "versions": _versions(), "begun": _now()}
            write_json(
                self.folder / RUN_FILE,
                {
                    **record,
                    "resumed": [*record.get("resumed", []), again],
                    "ended": None,
                    "outcome": None,
                },
            )
            sweep(self.folder)
            sweep(self.folder / JOBS)
        else:  # it may have been killed after its end, before its jobs were cleared away
            remove_jobs(self.folder / JOBS)
        return self

    @property
    def record(self) -> dict[str, Any]:
        """The content of run.json."""
        record = read_json(self.folder / RUN_FILE)
        if not isinstance(record, dict):
            raise FileError(
                f"{self.folder / RUN_FILE} must hold a single JSON object.", code="not-a-run"
            )
        for key, empty in (
            ("options", {}),
            ("inputs", []),
            ("steps", []),
            ("ended", None),
            ("outcome", None),
        ):
            record.setdefault(key, empty)
        for key in ("steps", "inputs"):
            if not (
                isinstance(record[key], list)
                and all(isinstance(entry, dict) for entry in record[key])
            ):
                raise FileError(
                    f"{self.folder / RUN_FILE}: {key} must be a list of objects.",
                    code="not-a-run",
                )
        if not isinstance(record["options"], dict):
            raise FileError(
                f"{self.folder / RUN_FILE}: options must be an object.", code="not-a-run"
            )
        return record

    def path(self, name: str) -> Path:
        """The path of a file that this run writes; see `claim`."""
        return self.claim(name)[0]

    def claim(self, *names: str) -> list[Path]:
        """The paths of files that this run is about to write: run.json lists them from now on, so
        that --overwrite knows what may go, and their folders are made. FileError where any of these
        is a link."""
        paths = [self.folder / name for name in names]
        for name, path in zip(names, paths, strict=True):
            _require_inside(self.folder, PurePath(name).parent)
            make_folder(path.parent)
        known = _written(self.folder)
        new = [name for name in dict.fromkeys(names) if name not in known]
        if new:
            write_json(self.folder / RUN_FILE, {**self.record, "files": [*known, *new]})
        return paths

    def remove(self, *names: str) -> None:
        """Take away files that this run is known to have written."""
        known = _written(self.folder)
        if gone := [name for name in names if name in known]:
            _remove_listed(self.folder, gone)
            write_json(
                self.folder / RUN_FILE,
                {**self.record, "files": [n for n in known if n not in gone]},
            )

    def begin_step(
        self,
        *,
        command: str | Sequence[str],
        seed: int | None,
        inputs: Sequence[str | Path] = (),
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """Note a later command that works on this run (`train-residual`, `report`); `finish` closes
        it."""
        record = self.record
        from pamid.base.schemas.run_file import Step

        step = Step(**_begun(command, seed, inputs, options))
        steps = [*record.get("steps", []), step.as_json()]
        write_json(self.folder / RUN_FILE, {**record, "steps": steps})
        sweep(self.folder)

    def finish(self, outcome: str = "done", **more: Any) -> None:
        """Close the latest step, if any was begun, else the run, with a word for how it ended;
        more: entries to add."""
        record = self.record
        open_steps = [step for step in record.get("steps", []) if step.get("ended") is None]
        part = open_steps[-1] if open_steps else record
        part.update(more, ended=_now(), outcome=outcome)
        write_json(self.folder / RUN_FILE, record)


def _require_free(path: Path, overwrite: bool, resumable: bool) -> None:
    if path.exists() and not path.is_dir():
        raise FileError(
            f"{path} is a file, not a folder.", "Give --output another name.", code="run-folder"
        )
    if not path.exists() or all(_BEGINNING.fullmatch(item.name) for item in path.iterdir()):
        return  # at most what is left of a run that was killed before it had its run.json
    if not (path / RUN_FILE).is_file():
        hint = "Give --output a new or empty folder."
        raise FileError(f"{path} contains files and is not a run folder.", hint, code="run-folder")
    if not overwrite:
        unfinished = resumable and Run.open(path).record["outcome"] != "done"
        hint = "Give --output another folder, or --overwrite to replace that run."
        hint = f"Continue that run with --resume. {hint}" if unfinished else hint
        raise FileError(
            f"{path} already holds {'an unfinished' if unfinished else 'a'} run.",
            hint,
            code="run-folder",
        )
    if _listed(path) is None and any(item.name != RUN_FILE for item in path.iterdir()):
        raise FileError(
            f"{path}: run.json does not list its files (damaged, or of an earlier version). "
            "Without the list, pamid cannot separate its files from yours.",
            "Give --output another folder, or delete this folder yourself.",
            code="run-folder",
        )


def _written(folder: Path) -> list[str]:
    """Files that the run in a folder lists as written; only these are ever deleted."""
    return [name for name in _listed(folder) or [] if name != RUN_FILE]


def _listed(folder: Path) -> list[str] | None:
    """The files that run.json lists; None where it has no such list or cannot be read."""
    if not (folder / RUN_FILE).is_file():
        return []
    try:
        files = Run(folder).record.get("files")
    except FileError:
        return None
    return [name for name in files if isinstance(name, str)] if isinstance(files, list) else None


def _remove_listed(folder: Path, names: Sequence[str]) -> None:
    for name in names:
        if is_inside(folder, PurePath(name).parent):
            remove_file(folder / name)


def remove_jobs(folder: Path) -> None:
    """Remove the results of single jobs, and their folder unless it is a link or holds anything
    else."""
    if folder.is_symlink():
        return
    for item in folder.glob("*"):
        if _JOB.fullmatch(item.name) or TEMPORARY_NAME.fullmatch(item.name) or item.name == JOURNAL:
            remove_file(item)
    with contextlib.suppress(OSError):
        folder.rmdir()


def _require_inside(folder: Path, below: str | PurePath) -> None:
    if not is_inside(folder, PurePath(below)):
        raise FileError(
            f"{folder / below} is a link, or leads out of the run folder: nothing is written "
            "there.",
            "Remove the link, or give another run folder.",
            code="run-folder",
        )


def _command_line(command: str | Sequence[str]) -> list[str]:
    return [command] if isinstance(command, str) else [str(word) for word in command]


def _hashes(inputs: Sequence[str | Path]) -> list[dict[str, str]]:
    return [{"path": str(path), "sha256": sha256_of(path)} for path in inputs]


def _begun(
    command: str | Sequence[str],
    seed: int | None,
    inputs: Sequence[str | Path],
    options: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """Initial record of a run or of any of its steps."""
    return {
        "command": tuple(_command_line(command)),
        "seed": seed,
        "options": dict(options or {}),
        "inputs": _hashes(inputs),
        "versions": _versions(),
        "begun": _now(),
        "ended": None,
        "outcome": None,
    }


def _versions() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for package in _PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[package] = metadata.version(package)
    return versions


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
