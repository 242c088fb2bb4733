"""Archives that declare more than they hold: HDF5 shapes and compound types, Parquet row counts,
members of zip, npz and FMU files, MAT dimensions, counts of any binary log."""

import io
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np

#: numbers of values that a file declares
HUGE = (10**6, 199_999_999, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**62)
MIB = 1 << 20


# ---- HDF5 --------------------


def hdf5(random: Random, path: Path) -> None:
    """An HDF5 file of a few kB, damaged in one way of `HDF5`."""
    import h5py

    with h5py.File(path, "w") as file:
        file["time"] = np.arange(30) * 0.01
        file["angle"] = np.sin(np.arange(30.0))
        random.choice(HDF5)(random, file)


def _shapes(random: Random, file: object) -> None:
    """Datasets that are declared, chunked and never written."""
    count = random.choice(HUGE[:-1])
    for k in range(random.choice((1, 8, 40))):
        file.create_dataset(  # type: ignore[attr-defined]
            f"x{k}",
            shape=random.choice(((count,), (count, 2), (3, count))),
            dtype=random.choice(("f8", "f4", "i1")),
            chunks=True,
            compression=random.choice((None, "gzip")),
        )


def _compound(random: Random, file: object) -> None:
    """Records with a field that is an array, or with many fields."""
    if random.random() < 0.5:
        # HDF5 refuses a type of 4 GiB or more
        fields = [("t", "f8"), ("block", "f8", (random.choice((1000, 10**6, 10**8)),))]
    else:
        fields = [(f"f{k}", "f8") for k in range(random.choice((10, 500)))]
    file.create_dataset(  # type: ignore[attr-defined]
        "records",
        shape=(random.choice((30, 10**4, 199_999_999)),),
        dtype=np.dtype(fields),
        chunks=(1,),
    )


def _many(random: Random, file: object) -> None:
    for k in range(random.choice((50, 300, 300, 3000))):
        file[f"x{k}"] = np.arange(3.0)  # type: ignore[index]


def _nested(random: Random, file: object) -> None:
    """Groups within groups, also within themselves."""
    import h5py

    group = file
    for _ in range(random.choice((3, 100, 500))):
        group = group.create_group("g")  # type: ignore[attr-defined]
    group["x"] = np.arange(30.0)  # type: ignore[index]
    link = random.choice(("hard", "soft", "outer", "device"))
    group["again"] = {  # type: ignore[index]
        "hard": lambda: file["/"],  # type: ignore[index]
        "soft": lambda: h5py.SoftLink("/g"),
        "outer": lambda: h5py.ExternalLink("log.h5", "/"),
        "device": lambda: h5py.ExternalLink("/dev/zero", "/x"),
    }[link]()


HDF5: tuple[Callable[[Random, object], None], ...] = (_shapes, _shapes, _compound, _many, _nested)


# ---- MAT --------------------


def _element(kind: int, data: bytes, declared: int | None = None) -> bytes:
    size = len(data) if declared is None else declared
    return struct.pack("<II", kind, size % 2**32) + data + b"\0" * (-len(data) % 8)


def mat_v5(random: Random) -> bytes:
    """A MAT file of version 5 whose dimensions or lengths exceed its data, or that inflates."""
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    count = random.choice(HUGE)
    dimensions = struct.pack("<ii", *(min(n, 2**31 - 1) for n in (random.choice((1, 60)), count)))
    values = np.arange(60.0).tobytes()
    if random.random() < 0.3:
        values = b"\0" * random.choice((MIB, 16 * MIB, 64 * MIB))
    body = (
        _element(6, struct.pack("<II", 6, 0))
        + _element(5, dimensions)
        + _element(1, b"angle")
        + _element(9, values, random.choice((None, count)))
    )
    matrix = _element(14, body, random.choice((None, None, count)))
    if random.random() < 0.5 or len(matrix) > MIB:
        matrix = _element(15, zlib.compress(matrix, 1))
    return head + matrix


def mat_v4(random: Random) -> bytes:
    count = min(random.choice(HUGE), 2**31 - 1)
    rows = random.choice((1, 60, count))
    return (
        struct.pack("<5i", random.choice((0, 10, 20, 50)), rows, count, random.choice((0, 1)), 6)
        + b"angle\0"
        + np.arange(60.0).tobytes()
    )


def octave_text(random: Random, text: str) -> str:
    return text.replace("60", str(random.choice(HUGE)), random.choice((1, 2, -1)))


# ---- Parquet --------------------


def parquet(random: Random, path: Path) -> None:
    """Columns that pack to nothing, or a footer with another number of rows."""
    import pyarrow
    import pyarrow.parquet

    rows, columns = random.choice(((200, 3), (200, 2000), (10**5, 40), (2 * 10**6, 4)))
    if random.random() < 0.02:
        rows, columns = 2 * 10**6, 150
    values = pyarrow.array(np.zeros(rows))
    table = pyarrow.table({f"c{k}": values for k in range(columns)})
    pyarrow.parquet.write_table(table, path, compression="zstd")
    if random.random() < 0.6:
        # varint of Thrift's compact protocol: the same number of bytes, another number
        old = _varint(2 * rows)
        new = b"\xff" * (len(old) - 1) + b"\x7e"
        data = path.read_bytes()
        at = data.rfind(old)
        if at > 0:
            path.write_bytes(data[:at] + new + data[at + len(old) :])


def _varint(value: int) -> bytes:
    digits = []
    while value >= 128:
        digits.append(value % 128 | 128)
        value //= 128
    return bytes([*digits, value])


# ---- zip --------------------


def npz(random: Random, names: tuple[str, ...]) -> bytes:
    """An npz file with these members: shapes without content, content without shape, bombs."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name in names:
            archive.writestr(f"{name}.npy", _npy(random))
        for k in range(random.choice((0, 0, 0, 2000))):
            archive.writestr(f"x{k}.npy", b"")
    return lying_zip(random, buffer.getvalue()) if random.random() < 0.4 else buffer.getvalue()


def _npy(random: Random) -> bytes:
    shape = random.choice(
        ("(3,)", "()", f"({random.choice(HUGE)},)", "(-1,)", "(3.5,)", "(2147483648, 2147483648)")
    )
    kind = random.choice(("<f8", "<f8", "<i8", "|O", "|V2147483647", "<U536870911", "<M8[s]"))
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    data = b"\0" * random.choice((0, 24, 64, 64 * MIB if random.random() < 0.1 else 24))
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode() + data


def lying_zip(random: Random, data: bytes) -> bytes:
    """The archive with other sizes in the headers of one of its members."""
    value = struct.pack("<I", min(random.choice((0, 1, 100, *HUGE)), 2**32 - 1))
    places = {b"PK\x03\x04": (18, 22), b"PK\x01\x02": (20, 24)}
    for mark, offsets in places.items():
        at = data.find(mark)
        if at >= 0 and random.random() < 0.8:
            at += random.choice(offsets)
            data = data[:at] + value + data[at + 4 :]
    return data


# ---- any --------------------


def larger_counts(random: Random, data: bytes, counts: tuple[int, ...]) -> bytes:
    """Enlarge one to three of the integers that count the samples or bytes of binary data."""
    width = random.choice((4, 8))
    places = []
    for count in counts:
        mark = count.to_bytes(width, "little")
        at = data.find(mark)
        while at >= 0:
            places.append(at)
            at = data.find(mark, at + 1)
    for at in random.sample(places, min(len(places), random.randint(1, 3))):
        value = min(random.choice(HUGE), 256**width - 1)
        data = data[:at] + value.to_bytes(width, "little") + data[at + width :]
    return data
