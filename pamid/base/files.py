"""Files: what is read of somebody else's, and how pamid's are written, whole or not at all.

Whatever holds data is opened here. It has to be a regular file (a pipe would block, a device never
ends) and no larger than the limit of its kind, so that a folder from a stranger costs neither the
memory nor the patience of who opens it.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import io
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePath
from typing import NoReturn, TypeAlias

from pamid.base.errors import FileError

PathLike: TypeAlias = str | os.PathLike[str]

MIB, GIB = 1 << 20, 1 << 30
#: bytes that are read at most of a file of a kind
JSON = 64 * MIB  # run.json, fit.json, diagnosis.json, labels of a trial ...
TOML = 1 * MIB  # next to a recording, a mapping, pamid.toml
TABLE = 1024 * MIB  # a recording, residual.csv, a raw log that is text
LONGEST_LINE = 1 * MIB  # of such a table
MAP = 64 * MIB  # a force map
ARRAYS = 1024 * MIB  # npz: results of jobs, checkpoints
WEIGHTS = 64 * MIB  # of a network
PICTURE = 64 * MIB
PAGE = 256 * MIB  # a report that a new page replaces
LOG = 4096 * MIB  # any raw log; also the most of which a digest is taken
LOG_MEMORY = 1024 * MIB  # that reading a raw log may take, as `pamid ingest` reads it by default

#: what a killed process leaves of `temporary_of`
TEMPORARY_NAME = re.compile(r"\..+\.([0-9]+)\.[0-9a-f]+\.tmp", re.DOTALL)
#: kind of a file by the first letter of its mode
_WORDS = {"d": "a folder", "p": "a pipe", "s": "a socket", "c": "a device", "b": "a device"}


# ---- reading -----------------------------------------------------------------------------------


def open_data(path: str | Path, most: int) -> io.BufferedReader:
    """Open a file of at most so many bytes to read. FileError if it is larger or no regular file (a
    link to a file is as good); OSError where it is missing or forbidden."""
    source = Path(path)
    _require_regular(source, os.stat(source))  # a device is not even opened
    handle = os.open(source, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        status = os.fstat(handle)
        _require_regular(source, status)  # whatever stands under that name by now
        if status.st_size > most:
            raise FileError(
                f"{source} is too large: {size_words(status.st_size)}; the limit for such a file "
                f"is {size_words(most)}.",
                "Check that this is the intended file.",
                code="too-large",
            )
        return open(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def read_data(path: str | Path, most: int) -> bytes:
    """The bytes of a file; errors as `open_data`. What is appended meanwhile is left out."""
    with open_data(path, most) as file:
        return file.read(os.fstat(file.fileno()).st_size)


def read_lines(
    path: str | Path, most: int = TABLE, encoding: str = "utf-8-sig", errors: str = "strict"
) -> Iterator[str]:
    """The lines of a text file with their ends; errors as `open_data`, and FileError for a line
    without end."""
    with io.TextIOWrapper(
        open_data(path, most), encoding=encoding, errors=errors, newline=""
    ) as file:
        number = 0
        while line := file.readline(LONGEST_LINE):
            number += 1
            if len(line) == LONGEST_LINE:
                raise FileError(
                    f"{path}, line {number} is longer than {size_words(LONGEST_LINE)}: "
                    "this is not a table.",
                    code="too-large",
                )
            yield line


def sha256_of(path: str | Path) -> str:
    """The sha256 of a file's bytes, in hex; FileError if it cannot be read."""
    source = Path(path)
    try:
        with open_data(source, LOG) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        raise FileError(f"{source} does not exist.", code="missing") from None
    except OSError as error:
        raise FileError(f"{source} cannot be read: {error.strerror}.") from error


def _require_regular(path: Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise FileError(
            f"{path} is {_word(status)}, not a file.",
            "Give a plain file with the data in it.",
            code="not-a-file",
        )


def _word(status: os.stat_result) -> str:
    return _WORDS.get(stat.filemode(status.st_mode)[0], "something else")


def size_words(count: int) -> str:
    """A number of bytes in the largest unit that it fills: "1.5 GiB"."""
    if count < MIB:
        return f"{count} bytes"
    return f"{count / GIB:.4g} GiB" if count >= GIB else f"{count / MIB:.4g} MiB"


# ---- writing -----------------------------------------------------------------------------------


def write_atomically(path: str | Path, data: bytes) -> None:
    """Write `data` to `path` whole or not at all; on any failure the old file stays and no
    temporary file is left.

    A link is replaced, what it leads to stays as it is; FileError for what is no file (a folder, a
    device).
    """
    write_together({Path(path): data})


def require_new(paths: Iterable[Path], overwrite: bool, option: str = "--output") -> None:
    """FileError for the first of these that exists already, unless it may be overwritten; option:
    by which it was chosen."""
    for path in paths:
        if path.exists() and not overwrite:
            raise FileError(
                f"{path} exists already.",
                f"Choose another {option}, or --overwrite to replace it.",
                code="exists",
            )


def write_together(files: Mapping[Path, bytes]) -> None:
    """Write files, all or none: everything is on the disk before the first of them takes its place,
    and where that fails, those before it become what they were."""
    made: dict[Path, Path] = {}
    target = Path()
    try:
        for target, data in files.items():
            _require_replaceable(target)
            made[target] = temporary_of(target)
            with open(made[target], "xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
        replace_together(made)
    except BaseException as error:
        for temporary in made.values():
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            refuse_write(target, error)
        raise


def replace_together(made: Mapping[Path, Path]) -> None:
    """Move finished files (target -> where it was made, on the same disk) to their places, all or
    none."""
    backups: dict[Path, Path] = {}  # a second name of what stood there
    begun: list[Path] = []
    try:
        # whether the last file takes its place decides: it needs no way back
        for target in list(made)[:-1]:
            if os.path.lexists(target):
                backups[target] = temporary_of(target)
                try:
                    os.link(target, backups[target], follow_symlinks=False)
                except OSError:  # no such links on this disk
                    shutil.copy2(target, backups[target], follow_symlinks=False)
        for target, temporary in made.items():
            begun.append(target)
            os.replace(temporary, target)
    except BaseException:
        for target in begun[:-1]:
            with contextlib.suppress(OSError):
                os.replace(backups[target], target) if target in backups else target.unlink(
                    missing_ok=True
                )
        raise
    finally:
        for second in backups.values():
            with contextlib.suppress(OSError):
                second.unlink(missing_ok=True)


def make_folder(path: Path) -> None:
    """Make a folder and those above it; FileError if that cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        refuse_write(path, error)


def temporary_of(target: Path) -> Path:
    """A name next to `target` that nobody has; its process number lets a later run tell a leftover
    of a killed process from a write in progress."""
    return target.with_name(f".{target.name}.{os.getpid()}.{secrets.token_hex(4)}.tmp")


def refuse_write(target: Path, error: OSError) -> NoReturn:
    """FileError: this could not be written."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        hint = "Free some space and run it again; the former content is untouched."
        raise FileError(
            f"{target} was not written: the disk is full.", hint, code="disk-full"
        ) from error
    hint = "Check its permissions, and that no part of the path is a file where a folder is needed."
    raise FileError(
        f"{target} cannot be written: {error.strerror or error}.", hint, code="write"
    ) from error


def _require_replaceable(target: Path) -> None:
    """A folder, a pipe or a device is not replaced by a file, nor is a link to these
    (/dev/stdout)."""
    with contextlib.suppress(FileNotFoundError):
        status = os.stat(target)
        if not stat.S_ISREG(status.st_mode):
            raise FileError(
                f"{target} cannot be written: it is {_word(status)}, not a file.",
                "Give another name.",
                code="write",
            )


# ---- removing ----------------------------------------------------------------------------------


def remove_file(path: Path) -> None:
    """Remove a regular file; a link, a folder or anything else is left where it is."""
    with contextlib.suppress(OSError, ValueError):  # ValueError: no name that a file can have
        if stat.S_ISREG(os.lstat(path).st_mode):
            path.unlink()


def is_inside(folder: Path, below: PurePath) -> bool:
    """Is this place within the folder, and reached without a link?"""
    try:
        base, target = folder.resolve(), (folder / below).resolve()
        return target == base / below and target.is_relative_to(base)
    except (OSError, ValueError, RuntimeError):
        return False


def sweep(folder: Path) -> None:
    """Remove what killed processes left half-written; a process still alive may be writing, so its
    files stay."""
    for item in _abandoned(folder):
        remove_file(item)


def sweep_stages(folder: Path, name: str) -> None:
    """Remove folders that killed processes made under `temporary_of(folder / name)`, with the files
    that lie directly in them; a folder that holds anything else stays."""
    for stage in _abandoned(folder):
        if stage.name.startswith(f".{name}.") and stage.is_dir() and not stage.is_symlink():
            for item in stage.iterdir():
                remove_file(item)
            with contextlib.suppress(OSError):
                stage.rmdir()


def _abandoned(folder: Path) -> list[Path]:
    """Temporary files in a folder whose process no longer runs."""
    if folder.is_symlink():
        return []
    named = [(item, TEMPORARY_NAME.fullmatch(item.name)) for item in folder.glob(".*.tmp")]
    return [
        item
        for item, match in named
        if match and int(match[1]) != os.getpid() and not _alive(int(match[1]))
    ]


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    return True
