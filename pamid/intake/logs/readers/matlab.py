"""MAT files v4 to v7.3: arrays, Structure With Time, ControlDesk's X and Y, structs with Time and
Data, tables.

Objects of MATLAB classes (timeseries, Simulink's Dataset) are opaque outside MATLAB; they are left
out with advice.
"""

from __future__ import annotations

import math
import warnings
import zlib
from pathlib import Path
from struct import unpack
from typing import Any, BinaryIO, Protocol

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.intake.logs.channel_builder import ChannelBuilder, Kind
from pamid.intake.logs.memory_budget import MemoryBudget
from pamid.intake.logs.readers.hdf5 import charge_hdf5
from pamid.intake.logs.readers.text import decode

OPAQUE = (
    "an object of a MATLAB class; save the struct('Time', x.Time, 'Data', x.Data) of a timeseries "
    "x, the timetable of a Dataset"
)
CELL_TEXT_BYTES = 80  # bytes of a short text and of its place in a list
OCTAVE_STRUCTS = ("struct", "scalar struct")
HEADER_BYTES = 128  # bytes before the first variable
MATRIX_TYPE, COMPRESSED_TYPE = 14, 15
#: data type -> bytes of a value in the file
SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 16: 1, 17: 2, 18: 4}
TAKEN_BYTES = 1 << 16
DEEPEST_ARRAY = 60  # arrays in arrays: MATLAB's loader and scipy's recurse as well


def read_matlab(builder: ChannelBuilder) -> None:
    """Variables as channels named by their fields. Stamps where a struct brings its time, none for
    plain arrays: their time is a channel like the others."""
    with builder.path.open("rb") as file:
        head = file.read(1024)
    if head.startswith(b"# Created by Octave"):
        _read_octave_text(builder)
        return
    hdf5 = head[512:520] == b"\x89HDF\r\n\x1a\n"
    # v7.3 is HDF5; in a v5 file a part of its own keeps objects of classes
    if hdf5 or (head.startswith(b"MATLAB") and head[116:124].strip(b" \0") != b""):
        from matio import load_from_mat as load
    else:
        from scipy.io import loadmat as load
    if hdf5:
        charge_hdf5(builder)
    else:
        _charge_matlab(builder.budget)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of single variables: what cannot be read shows as opaque
        variables = dict(load(str(builder.path)))
    for name, value in variables.items():
        if not name.startswith("__") and name != "None":
            _enter(builder, name, _plain(value))


def _plain(value: Any) -> Any:
    """MATLAB's arrays of structs and cells as dicts and lists, its texts as str; numbers and tables
    as they are."""
    if not isinstance(value, np.ndarray) or type(value).__name__.startswith("Matlab"):
        return value
    if value.dtype.names:
        structs = [
            {name: _plain(item[name]) for name in value.dtype.names} for item in value.ravel()
        ]
        return structs[0] if len(structs) == 1 else structs
    if value.dtype.kind == "O":
        items = [_plain(item) for item in value.ravel()]
        return items[0] if len(items) == 1 else items
    if value.dtype.kind in "UST":
        return str(value.ravel()[0]) if value.size == 1 else [str(text) for text in value.ravel()]
    return value


def _enter(builder: ChannelBuilder, name: str, value: Any) -> None:
    """Enter a variable or field, whatever it is."""
    if isinstance(value, np.ndarray):
        builder.add(name, value)
    elif isinstance(value, dict):
        _enter_struct(builder, name, value)
    elif isinstance(value, list):
        for index, item in enumerate(value):
            _enter(builder, f"{name}/{index + 1}", item)
    elif type(value).__module__.startswith("pandas") and hasattr(value, "columns"):
        # a table, or a timetable, whose row times become the stamps
        times = np.asarray(value.index.to_numpy())
        stamps = None
        if times.dtype.kind in "mM" and times.size:
            spans = times - times[0] if times.dtype.kind == "M" else times
            stamps = spans.astype("timedelta64[ns]").astype(np.int64) / 1e9
            builder.note(f"{name}: timetable, stamps from its row times")
        for column in value.columns:
            _add(builder, f"{name}/{column}", value[column].to_numpy(), stamps, "")
    elif type(value).__module__.startswith("pandas"):
        builder.leave_out(name, "not an array of numbers")
    elif isinstance(value, str):
        builder.leave_out(name, "text")
    else:
        builder.leave_out(name, OPAQUE)


def _enter_struct(builder: ChannelBuilder, name: str, value: dict[str, Any]) -> None:
    folded = {key.casefold(): key for key in value}
    if "X" in value and "Y" in value and all("Data" in struct for struct in _structs(value["Y"])):
        # ControlDesk: X has the stamps, and XIndex (from 1) of each Y points to its stamps
        rasters = [_stamps(struct.get("Data")) for struct in _structs(value["X"])]
        builder.note(f"{name}: ControlDesk structure, stamps from X")
        for index, struct in enumerate(_structs(value["Y"])):
            which = struct.get("XIndex")
            raster = 0
            if isinstance(which, np.ndarray) and which.size:
                raster = int(np.ravel(which)[0]) - 1
            label = str(struct.get("Name") or index + 1).replace('"', "")
            stamps = rasters[raster] if 0 <= raster < len(rasters) else None
            _add(builder, f"{name}/{label}", struct["Data"], stamps, _unit(struct))
    elif {"time", "signals"} <= folded.keys():
        # Structure With Time of Simulink; without time its signals have no stamps
        stamps, signals = _stamps(value[folded["time"]]), _structs(value[folded["signals"]])
        source = "without time" if stamps is None else "stamps from its time"
        builder.note(f"{name}: Simulink structure, {source}")
        for index, signal in enumerate(signals):
            label = signal.get("label") or (str(index + 1) if len(signals) > 1 else "")
            full = f"{name}/{label}" if isinstance(label, str) and label else name
            _add(builder, full, signal.get("values"), stamps, _unit(signal))
    elif {"time", "data"} <= folded.keys() and isinstance(value[folded["time"]], np.ndarray):
        stamps = _stamps(value[folded["time"]])
        builder.note(f"{name}: stamps from its field {folded['time']}")
        _add(builder, name, value[folded["data"]], stamps, _unit(value))
    else:
        for key, inside in value.items():
            _enter(builder, f"{name}/{key}", inside)


def _add(builder: ChannelBuilder, name: str, values: Any, stamps: Array | None, unit: str) -> None:
    if isinstance(values, np.ndarray):
        if values.dtype.kind == "O":  # a column of a table: cells, all of equal size
            values = np.stack([np.ravel(cell) for cell in values]) if values.size else values
        builder.add(name, values, stamps, unit)
    else:
        builder.leave_out(name, "not numbers")


def _stamps(time: Any) -> Array | None:
    """Times in s; None if there are none."""
    if not isinstance(time, np.ndarray) or time.size < 2 or time.dtype.kind not in "biufm":
        return None
    if time.dtype.kind == "m":
        return time.ravel().astype("timedelta64[ns]").astype(np.int64) / 1e9
    return np.asarray(time.ravel(), dtype=np.float64)


def _structs(value: Any) -> list[dict[str, Any]]:
    items = value if isinstance(value, list) else [value]
    return [item for item in items if isinstance(item, dict)]


def _unit(struct: dict[str, Any]) -> str:
    """The unit a struct gives: Unit, Units, or DataInfo.Units as a timeseries has it."""
    inside = struct.get("DataInfo")
    for owner in (struct, inside if isinstance(inside, dict) else {}):
        for key in ("Unit", "Units", "unit", "units"):
            if isinstance(owner.get(key), str):
                return str(owner[key])
    return ""


# ---- text that Octave's `save` writes unless a format is given -----------------------------------


def _read_octave_text(builder: ChannelBuilder) -> None:
    """Matrices as channels without stamps, also those inside structs; everything else is left out
    by name."""
    text, _ = decode(builder.budget)
    for block in text.split("# name: ")[1:]:
        lines = block.split("\n")
        tags = (line.lstrip("# ").partition(":") for line in lines[1:] if line.startswith("#"))
        head = {key: value.strip() for key, _, value in tags}
        kind, shape = head.get("type", "unknown"), (head.get("rows", ""), head.get("columns", ""))
        if kind == "matrix" and all(map(str.isdecimal, shape)):
            rows, columns = map(int, shape)
            numbers = [line for line in lines[1:] if not line.startswith("#")]
            written = sum(len(line.split()) for line in numbers)
            most = max(written, rows * columns)
            builder.budget.charge(lines[0], most, raw=CELL_TEXT_BYTES * written)
            cells = " ".join(numbers).split()
            if len(cells) != rows * columns:
                raise FileError(
                    f"{builder.path}: {lines[0]} has {len(cells)} values, but its header has "
                    f"{rows} x {columns}.",
                    "The file is damaged or truncated. Save it again.",
                    code="damaged",
                )
            values = np.array(["nan" if cell == "NA" else cell for cell in cells], dtype=np.float64)
            builder.add(lines[0], values.reshape(rows, columns))
        elif kind not in OCTAVE_STRUCTS:
            builder.leave_out(lines[0], f"{kind}, save it with -v7")
    builder.note("text saved by Octave")


# ---- memory that the variables need ------------------------------------------------------------


class _Source(Protocol):
    def read(self, size: int) -> bytes: ...


class _Unpacked:
    """Stream of the bytes that `size` compressed ones of a file give."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self.file, self.left, self.unpack = file, size, zlib.decompressobj()

    def read(self, size: int) -> bytes:
        parts: list[bytes] = []
        while size > 0 and not self.unpack.eof:
            packed = self.unpack.unconsumed_tail
            if not packed:
                packed = self.file.read(min(self.left, TAKEN_BYTES))
                self.left -= len(packed)
            if not packed:
                break
            parts.append(self.unpack.decompress(packed, size))
            size -= len(parts[-1])
        return b"".join(parts)


def _charge_matlab(budget: MemoryBudget) -> None:
    """Charge the variables of a MAT file (v4, v5), counted without holding them.

    A variable of v5 is compressed, and its parts say how long they are before they come. The walk
    reads these tags alone, decompressing in small pieces, so that neither a bomb nor a false length
    costs memory (MathWorks, MAT-File Format, sections 1 and 2). Raises FileError if the declared
    size of a part exceeds that of its array, or if the sum exceeds the budget.
    """
    with budget.path.open("rb") as file:
        head = file.read(HEADER_BYTES)
        if not head.startswith(b"MATLAB") or head[126:128] not in (b"IM", b"MI"):
            from scipy.io import whosmat

            for name, shape, _ in whosmat(budget.path):
                values = math.prod(map(int, shape))
                budget.charge(name, values, raw=values * 8)
            return
        order = "<" if head[126:128] == b"IM" else ">"
        while len(tag := file.read(8)) == 8:
            kind, size = unpack(f"{order}2I", tag)
            end = file.tell() + size
            if kind == COMPRESSED_TYPE:
                unpacked = _Unpacked(file, size)
                inner = unpacked.read(8)
                if len(inner) == 8 and unpack(f"{order}2I", inner)[0] == MATRIX_TYPE:
                    _walk(budget, unpacked, order, unpack(f"{order}2I", inner)[1], 0)
            elif kind == MATRIX_TYPE:
                _walk(budget, file, order, size, 0)
            file.seek(end)


def _walk(budget: MemoryBudget, source: _Source, order: str, size: int, depth: int) -> None:
    """Charge the parts of an array of `size` bytes, arrays inside it included."""
    if depth > DEEPEST_ARRAY:
        raise _damaged(budget.path, f"its arrays are nested more than {DEEPEST_ARRAY} deep")
    while size >= 8:
        tag = source.read(8)
        if len(tag) < 8:
            return  # cut: the reader reports it
        kind, length = unpack(f"{order}2I", tag)
        size -= 8
        if kind >> 16:  # a short part, whose data stand in the tag
            continue
        padded = length + (-length % 8 if kind != COMPRESSED_TYPE else 0)
        if length > size:
            raise _damaged(budget.path, f"a part declares {length} bytes, but only {size} are left")
        if kind == MATRIX_TYPE:
            _walk(budget, source, order, length, depth + 1)
        else:
            budget.charge("its variables", length // SIZES.get(kind, 1), raw=length)
            left = min(padded, size)
            while left > 0 and (piece := source.read(min(left, TAKEN_BYTES))):
                left -= len(piece)
        size -= padded


def _damaged(path: Path, why: str) -> FileError:
    return FileError(
        f"{path} cannot be read as mat: {why}.",
        "It is damaged. Save it again from the program that wrote it.",
        code="damaged",
    )


KIND = Kind(
    "mat", (".mat",), read_matlab, (b"MATLAB ", b"# Created by Octave"), "matlab", ("matio", "h5py")
)
