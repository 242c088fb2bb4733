"""A run: one folder of plain files, each written whole or not at all.

`run.json` is written first (with `ended: null`) and closed last, so that a run that was killed says so itself. It is
the only file with wall-clock times: the same inputs and the same seed give the same bytes everywhere else.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import math
import os
import platform
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from pamid.errors import FileError, PamidError

RUN_SCHEMA = "pamid.run/1"
FIT_FILE, RESIDUAL_FILE = "fit.json", "residual.csv"
RUN_FILES = ("run.json", FIT_FILE, RESIDUAL_FILE, "network.json", "network.npz", "trace.csv", "diagnosis.json",
             "missing.csv", "next-experiment.csv", "next-experiment.toml", "report.html", "checkpoint.npz",
             "force-law.json", "rig.py")  # fmt: skip
FIGURES = "figures"
JOBS, JOURNAL = "jobs", "journal.jsonl"      # results of single jobs while a run goes on (pamid.results)
_PACKAGES = ("pamid", "numpy", "scipy", "pandas", "numba", "llvmlite", "torch", "pysindy", "matplotlib", "sympy")


@dataclass(frozen=True)
class Run:
    """A run folder. Make one with `Run.create`, come back to it with `Run.open`."""

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

        `overwrite` replaces an existing run (its own files only); a folder that holds anything else is never touched.
        `resume` comes back to the run of the same seed, inputs and options that the folder holds, if it holds one
        (None: this command cannot); unless that has come to its end, it counts as begun again.
        """
        path = Path(folder)
        if resume and (path / "run.json").is_file():
            return cls.open(path)._resumed(command, seed, _hashes(inputs), dict(options or {}))
        _require_free(path, overwrite, resumable=resume is not None)
        record = {
            "schema": RUN_SCHEMA,
            "command": _command_line(command),
            "seed": seed,
            "options": dict(options or {}),
            "inputs": _hashes(inputs),
            "versions": _versions(),
            "platform": platform.platform(),
            "begun": _now(),
            "ended": None,
            "outcome": None,
            "steps": [],
        }
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FileError(f"{path}: the run folder cannot be made: {error.strerror}.", code="run-folder") from error
        write_json(path / "run.json", record)
        # after run.json: if this is cut short, the folder already says that it is unfinished
        _remove_old(path)
        return cls(path)

    @classmethod
    def open(cls, folder: str | Path) -> Run:
        """An existing run; FileError if the folder holds none."""
        path = Path(folder)
        if not (path / "run.json").is_file():
            hint = "Give the folder that `pamid fit` or `pamid diagnose` wrote with --output."
            raise FileError(f"{path} is not a run folder: it has no run.json.", hint, code="not-a-run")
        run = cls(path)
        schema = run.record.get("schema")
        if schema != RUN_SCHEMA:
            raise FileError(f"{path / 'run.json'}: schema is {schema!r}, expected {RUN_SCHEMA!r}.", code="not-a-run")
        return run

    def _resumed(self, command: str | Sequence[str], seed: int | None, inputs: list[dict[str, str]],
                 options: dict[str, Any]) -> Run:
        record, asked = self.record, {"seed": seed, "inputs": inputs, "options": options}
        other = [what for what, value in asked.items() if record.get(what) != json.loads(json_text(value))]
        if other:
            hint = "Repeat the command as it was, give --output another folder, or --overwrite to replace that run."
            raise FileError(f"{self.folder} holds another run: what differs is its {' and '.join(other)}.", hint,
                            code="run-folder")
        if record["outcome"] != "done":
            again = {"command": _command_line(command), "versions": _versions(), "begun": _now()}
            write_json(self.folder / "run.json", {**record, "resumed": [*record.get("resumed", []), again],
                                                  "ended": None, "outcome": None})
            _sweep(self.folder)
            _sweep(self.folder / JOBS)
        return self

    @property
    def record(self) -> dict[str, Any]:
        """The content of run.json."""
        record = read_json(self.folder / "run.json")
        if not isinstance(record, dict):
            raise FileError(f"{self.folder / 'run.json'} must hold one JSON object.", code="not-a-run")
        for key, empty in (("options", {}), ("inputs", []), ("steps", []), ("ended", None), ("outcome", None)):
            record.setdefault(key, empty)
        for key in ("steps", "inputs"):
            if not (isinstance(record[key], list) and all(isinstance(one, dict) for one in record[key])):
                raise FileError(f"{self.folder / 'run.json'}: {key} must be a list of objects.", code="not-a-run")
        if not isinstance(record["options"], dict):
            raise FileError(f"{self.folder / 'run.json'}: options must be an object.", code="not-a-run")
        return record

    @property
    def finished(self) -> bool:
        """True if the run and every later step of it came to their end."""
        record = self.record
        return all(part.get("ended") is not None for part in [record, *record.get("steps", [])])

    def path(self, name: str) -> Path:
        """The path of a file of this run; its parent folder is made."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path

    def begin_step(
        self,
        *,
        command: str | Sequence[str],
        seed: int | None,
        inputs: Sequence[str | Path] = (),
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """Note a later command that works on this run (`train-residual`, `report`); `finish` closes it."""
        record = self.record
        step = {"command": _command_line(command), "seed": seed, "options": dict(options or {}),
                "inputs": _hashes(inputs), "versions": _versions(), "begun": _now(), "ended": None,
                "outcome": None}  # fmt: skip
        write_json(self.folder / "run.json", {**record, "steps": [*record.get("steps", []), step]})
        _sweep(self.folder)

    def finish(self, outcome: str = "done", **more: Any) -> None:
        """Close the latest step, if one was begun, else the run, with a word for how it ended; more: entries to add."""
        record = self.record
        open_steps = [step for step in record.get("steps", []) if step["ended"] is None]
        part = open_steps[-1] if open_steps else record
        part.update(more, ended=_now(), outcome=outcome)
        write_json(self.folder / "run.json", record)


def write_atomically(path: str | Path, data: bytes) -> None:
    """Write `data` to `path` whole or not at all; on any failure the old file stays and no temporary file is left."""
    target = Path(path)
    # the process number lets a later run tell a leftover of a killed process from a write in progress
    temporary = target.with_name(f".{target.name}.{os.getpid()}.{secrets.token_hex(4)}.tmp")
    try:
        with open(temporary, "xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError):
            _refuse_write(target, error)
        raise


def write_json(path: str | Path, obj: Any) -> None:
    """Write strict JSON (no NaN, no infinity), atomically. NumPy scalars and arrays become numbers and lists."""
    write_atomically(path, json_text(obj, Path(path).name).encode())


def json_text(obj: Any, name: str = "") -> str:
    """Strict JSON text, ended by a newline. PamidError naming the key that cannot be written."""
    text = json.dumps(_plain(obj, name or "value"), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    # the name of a file may be any bytes: what is no UTF-8 in it becomes an escape of JSON
    return text.encode("utf-8", "backslashreplace").decode()


def read_json(path: str | Path) -> Any:
    """Read strict JSON; FileError with line and column where it is not."""
    source = Path(path)
    try:
        text = source.read_bytes().decode("utf-8")
        return json.loads(text, parse_constant=_refuse_constant, parse_float=_finite, parse_int=_whole)
    except FileNotFoundError:
        raise FileError(f"{source} does not exist.", code="missing") from None
    except OSError as error:
        raise FileError(f"{source} cannot be read: {error.strerror}.") from error
    except UnicodeDecodeError as error:
        raise FileError(f"{source} is not UTF-8 text (byte {error.start}).", code="json") from None
    except json.JSONDecodeError as error:
        message = f"{source}, line {error.lineno}, column {error.colno}: not JSON: {error.msg}."
        raise FileError(message, code="json") from None
    except RecursionError:
        raise FileError(f"{source}: nested too deeply to be one of pamid's files.", code="json") from None
    except ValueError as error:
        raise FileError(f"{source}: {error}", code="json") from None


def sha256_of(path: str | Path) -> str:
    """The sha256 of a file's bytes, in hex; FileError if it cannot be read."""
    source = Path(path)
    try:
        with open(source, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        raise FileError(f"{source} does not exist.", code="missing") from None
    except OSError as error:
        raise FileError(f"{source} cannot be read: {error.strerror}.") from error


def _refuse_write(target: Path, error: OSError) -> NoReturn:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        hint = "Free some space and run it again; the former content is untouched."
        raise FileError(f"{target} was not written: the disk is full.", hint, code="disk-full") from error
    raise FileError(f"{target} cannot be written: {error.strerror or error}.", code="write") from error


def _finite(text: str) -> float:
    value = float(text)
    if math.isinf(value):
        raise ValueError(f"{text:.12} is larger than any number a computer calculates with.")
    return value


def _whole(text: str) -> int:
    _finite(text)
    return int(text)


def _refuse_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is not allowed in strict JSON.")


def _plain(value: Any, where: str) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        if not math.isfinite(value):
            raise PamidError(f"{where} is {value}: strict JSON holds finite numbers only.", code="not-finite")
        return value
    if isinstance(value, Mapping):
        return {_key(key, where): _plain(item, f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item, f"{where}[{index}]") for index, item in enumerate(value)]
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise PamidError(f"{where} is a {type(value).__name__}, which has no JSON form.", code="json")


def _key(key: Any, where: str) -> str:
    if isinstance(key, str):
        return key
    raise PamidError(f"{where} has the key {key!r}; keys of JSON are text.", code="json")


def _require_free(path: Path, overwrite: bool, resumable: bool) -> None:
    if path.exists() and not path.is_dir():
        raise FileError(f"{path} is a file, not a folder.", "Give --output another name.", code="run-folder")
    if not path.exists() or not any(path.iterdir()):
        return
    if not (path / "run.json").is_file():
        hint = "Give --output a new or empty folder."
        raise FileError(f"{path} is taken: it holds files that are not a run.", hint, code="run-folder")
    if not overwrite:
        unfinished = resumable and Run.open(path).record["outcome"] != "done"
        hint = "Give --output another folder, or --overwrite to replace that run."
        hint = f"Go on with it by --resume. {hint}" if unfinished else hint
        raise FileError(f"{path} is taken: it already holds {'an unfinished' if unfinished else 'a'} run.", hint,
                        code="run-folder")


def _remove_old(path: Path) -> None:
    _sweep(path)
    old = [path / name for name in RUN_FILES if name != "run.json"]
    old += [item for item in (path / FIGURES).glob("*") if item.suffix in (".svg", ".png", ".pdf", ".gif")]
    for item in old:
        item.unlink(missing_ok=True)
    remove_jobs(path / JOBS)


def remove_jobs(folder: Path) -> None:
    """Remove the results of single jobs, and their folder unless it holds anything else."""
    for item in (*folder.glob("*.npz"), *folder.glob(".*.tmp"), folder / JOURNAL):
        item.unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        folder.rmdir()


def _sweep(folder: Path) -> None:
    """Remove what killed processes left half-written; a process still alive may be writing, so its files stay."""
    for leftover in folder.glob(".*.tmp"):
        owner = leftover.name.split(".")[-3]
        if owner.isdigit() and int(owner) != os.getpid() and not _alive(int(owner)):
            leftover.unlink(missing_ok=True)


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _command_line(command: str | Sequence[str]) -> list[str]:
    return [command] if isinstance(command, str) else [str(word) for word in command]


def _hashes(inputs: Sequence[str | Path]) -> list[dict[str, str]]:
    return [{"path": str(path), "sha256": sha256_of(path)} for path in inputs]


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[package] = metadata.version(package)
    return found


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
