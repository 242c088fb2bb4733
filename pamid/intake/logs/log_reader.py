"""Entry point for raw logs: `read_log` determines the kind of a file by content and name, and calls
its reader.

A log may come from an untrusted source. No reader executes code of a file, and every fault of a
file is a FileError.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from pamid.base.errors import FileError, PamidError, nearest, quoted
from pamid.base.files import LOG, MIB, open_data
from pamid.base.npz import load_arrays
from pamid.base.parallel.limited_process import ProcessFailure, ProcessLimits, run_limited
from pamid.base.parallel.packing import Packed, Question
from pamid.base.scanned import modules_of
from pamid.intake.logs.channel_builder import ChannelBuilder, Kind
from pamid.intake.logs.channels import Log
from pamid.intake.logs.readers.lerobot import data_set_of
from pamid.intake.logs.stamp_parts import join_stamp_parts

HEAD_BYTES = 4096
#: processor time of a reader, s, and the addition for each MB of the file
READER_S = 50.0
READER_S_PER_MB = 3.0
#: elapsed time, s, in addition to READER_S_PER_MB
PATIENCE = 120.0
#: bytes that a reader may allocate, and more for each byte of the file
READER_MEMORY = 3072 * MIB
READER_MEMORY_PER_BYTE = 6

_PICKLE = (
    "a pickle, which pamid does not load because it runs code",
    "Load it in the program that wrote it, and save the table: table.to_parquet('log.parquet').",
)
_PICKLE_SUFFIXES = (".pkl", ".pickle", ".pck", ".joblib")  # the oldest pickles begin with no mark
_SQLITE = b"SQLite format 3\0"
_FEATHER = "Save it as Parquet: pandas.read_feather(FILE).to_parquet('log.parquet')."
#: files that are often mistaken for a log, with the remedy
_OTHER_FORMATS = (
    *((bytes((0x80, protocol)), *_PICKLE) for protocol in range(2, 6)),
    (b"\x1f\x8b", "packed with gzip", "Unpack it first: gunzip -k FILE."),
    (b"BZh", "packed with bzip2", "Unpack it first: bunzip2 -k FILE."),
    (b"\xfd7zXZ", "packed with xz", "Unpack it first: unxz -k FILE."),
    (b"\x28\xb5\x2f\xfd", "packed with zstd", "Unpack it first: unzstd FILE."),
    (b"7z\xbc\xaf", "packed with 7-Zip", "Unpack it first: 7z x FILE."),
    (b"\xd0\xcf\x11\xe0", "a workbook", "Save it as CSV."),
    (b"\x93NUMPY", "an array of NumPy", "Save it with names: CSV, Parquet, HDF5 or MAT."),
    (b"TDSh", "an index of a TDMS file", "Read the .tdms file next to it."),
    (b"ARROW1", "a Feather or Arrow file", _FEATHER),
    (
        b"ULog\x01",
        "a ULog of a PX4",
        "Make a CSV of each topic: ulog2csv FILE (pip install pyulog).",
    ),
    (
        b"LOGG",
        "a BLF trace of CAN frames",
        "Decode it with the DBC file and save it as MDF4 or CSV.",
    ),
)
#: kinds of archives by their first member
_ARCHIVES = (
    (
        b".npy",
        "an archive of NumPy (npz)",
        "Save its arrays with names: CSV, Parquet, HDF5 or MAT.",
    ),
    (b".xml", "a workbook", "Save it as CSV."),
    (b"xl/", "a workbook", "Save it as CSV."),
    (b"", "a packed archive", "Unpack it first: unzip FILE."),
)


def read_log(path: Path, kind: str | None = None) -> Log:
    """Signals of a raw log. `kind` is among `known_kinds`. Default: by the file's content and
    suffix.

    Raises FileError if the file is missing, damaged or of an unknown kind, or if the package that
    reads it is not installed.
    """
    path = Path(path)
    if kind is not None and kind not in known_kinds():
        hint = nearest(kind, known_kinds()) or "Valid kinds are: " + ", ".join(known_kinds()) + "."
        raise FileError(f"There is no kind of log called {kind!r}.", hint, code="kind")
    if not path.exists():
        near = (
            nearest(path.name, [other.name for other in path.parent.iterdir()])
            if path.parent.is_dir()
            else ""
        )
        raise FileError(f"{path}: there is no such file.", near)
    log_kind, note = _kind_of(path, kind)
    log = _read_in_child(path, log_kind.name) if log_kind.extra else read_here(path, log_kind.name)
    return join_stamp_parts(replace(log, details=(note, *log.details)) if note else log)


def _kind_of(path: Path, wanted: str | None) -> tuple[Kind, str]:
    """Kind of a file, and a note if name and content disagree."""
    if path.is_dir():
        if data_set_of(path):
            return known_kinds()["lerobot"], ""
        if not (path / "metadata.yaml").is_file():
            raise FileError(
                f"{path} is a folder.",
                "Name a log. Only two kinds of folders are logs: ROS 2 bags with a metadata.yaml, "
                "and LeRobot data sets with a meta/info.json.",
            )
        for part in sorted(path.rglob("*")):
            if not part.is_dir():
                _head(part)
        return known_kinds()["ros"], ""
    head, kinds = _head(path).removeprefix(b"\xef\xbb\xbf"), known_kinds().values()
    by_content = next((kind for kind in kinds if kind.marks and head.startswith(kind.marks)), None)
    by_name = next((kind for kind in kinds if path.suffix.lower() in kind.suffixes), None)
    in_set = by_content is not None and by_content.name == "parquet" and data_set_of(path)
    if in_set and wanted in (None, "lerobot"):
        return known_kinds()["lerobot"], ""
    if wanted is not None:
        if by_content and by_content.name != wanted:
            raise FileError(
                f"{path} is not a {wanted} file: its content is {by_content.name}.", code="kind"
            )
        return known_kinds()[wanted], ""
    if by_content:
        odd = by_name is not None and by_name is not by_content and by_name.name != "csv"
        note = f"named {path.suffix}, but its content is {by_content.name}"
        return by_content, note if odd else ""
    if by_name is None:
        named = [kind for kind in kinds if kind.suffixes]
        known = ", ".join(f"{kind.name} ({' '.join(kind.suffixes)})" for kind in named)
        raise FileError(
            f"{path}: neither the suffix nor the content shows the kind of log.",
            f"Valid kinds are: {known}.",
            code="kind",
        )
    if by_name.marks and by_name.name != "mat":  # MAT v4 has no magic number
        raise FileError(
            f"{path} has the suffix {path.suffix}, but does not begin as a {by_name.name} file.",
            "It may be damaged, incomplete or of another kind.",
            code="damaged",
        )
    return by_name, ""


def _head(path: Path) -> bytes:
    try:
        with open_data(path, LOG) as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror}.") from error
    if not head.strip(b"\0 \r\n\t"):
        raise FileError(f"{path} is empty.")
    formats = ((what, hint) for mark, what, hint in _OTHER_FORMATS if head.startswith(mark))
    what, hint = next(formats, ("", ""))
    if head.startswith(b"PK\x03\x04"):
        member = head[30 : 30 + int.from_bytes(head[26:28], "little")]
        what, hint = next((what, hint) for part, what, hint in _ARCHIVES if part in member)
    elif head.startswith(_SQLITE) and path.suffix.lower() not in known_kinds()["ros"].suffixes:
        table = 'sqlite3 -header -csv FILE "select * from TABLE" > log.csv'
        what, hint = "an SQLite database, not a ROS bag", f"Save its table as CSV: {table}."
    elif path.suffix.lower() in _PICKLE_SUFFIXES:
        what, hint = _PICKLE
    if what:
        hint = hint.replace("FILE", quoted(path))
        raise FileError(f"{path} is {what}, which pamid cannot read as a log.", hint, code="kind")
    return head


@lru_cache
def known_kinds() -> dict[str, Kind]:
    """Every kind by its name: the `KIND` of each file in `pamid.intake.logs.readers`."""
    modules = modules_of("pamid.intake.logs.readers").values()
    return {module.KIND.name: module.KIND for module in modules if hasattr(module, "KIND")}


def read_here(path: Path, kind: str) -> Log:
    """Signals of a log of this kind, read in this process; FileError for every fault of it."""
    reader = known_kinds()[kind]
    try:
        builder = ChannelBuilder(path)
        reader.read(builder)
        return builder.log(kind)
    except PamidError:
        raise
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in reader.packages:
            raise
        raise FileError(
            f"{path}: reading such a {kind} file needs {error.name}, which is not installed.",
            f"pip install 'pamid[{reader.extra}]'",
            code="missing-extra",
        ) from error
    except MemoryError as error:
        raise FileError(
            f"{path} cannot be read as {kind}: there is not enough memory.",
            "Export fewer channels or a shorter part of it.",
            code="too-large",
        ) from error
    except Exception as error:  # a foreign reader may raise anything on a damaged file
        reason = " ".join(str(error).split())[:200] or "no reason given"
        raise FileError(
            f"{path} cannot be read as {kind}: {reason} ({type(error).__name__}).",
            "It may be damaged, incomplete or of another kind. Export it again from the program "
            "that wrote it.",
            code="damaged",
        ) from error


def _read_in_child(path: Path, kind: str) -> Log:
    """`read_here` in a separate process: on a damaged file a foreign parser may crash or never end,
    and not only raise.

    Channels are returned as plain numbers (npz without objects) and JSON, which execute nothing.
    Raises FileError as there, and if the process crashes or exceeds its limits.
    """
    parts = path.rglob("*") if path.is_dir() else [path]
    size = sum(part.stat().st_size for part in parts if part.is_file())
    longer = READER_S_PER_MB * size / 1e6
    limits = ProcessLimits(
        READER_S + longer, PATIENCE + longer, READER_MEMORY + READER_MEMORY_PER_BYTE * size
    )
    whole = str(path.absolute())
    with tempfile.TemporaryDirectory(prefix="pamid-") as name:
        folder = Path(name)
        try:
            arguments = {"path": whole, "kind": kind}
            function, label = f"{__name__}:packed_log", f"reading {path.name}"
            answer = run_limited(function, arguments, folder, limits, label)
        except ProcessFailure as failure:
            raise FileError(
                f"{path} cannot be read as {kind}: the reader failed: {failure}.",
                "The file is probably damaged. Export it again from the program that wrote it, or "
                "export fewer channels.",
                code="damaged",
            ) from failure
        except FileError as error:
            raise FileError(
                error.message.replace(whole, str(path)), error.hint, code=error.code
            ) from error
        arrays = load_arrays(folder / "channels.npz", most=LOG)
        packed = Packed(answer["log"], tuple(arrays[f"arr_{i}"] for i in range(len(arrays))))
        channels, details, stated = Question().unpacked(packed)
        return Log(path, kind, channels, details, stated=stated)


def packed_log(path: str, kind: str, folder: Path) -> dict[str, Any]:
    """Read a log, write its numbers into the folder, and return the other fields for JSON."""
    log = read_here(Path(path), kind)
    packed = Question().packed((log.channels, log.details, log.stated))
    np.savez(folder / "channels.npz", *packed.arrays)
    return {"log": packed.tree}
