"""Arrays from npz files that somebody else may have made: plain numbers only, and no code runs.

pamid packs without compression. So an archive whose arrays would take more room than the archive
itself is none of pamid's, and is refused by its directory and the headers of its arrays, before any
of it is unpacked.
"""

from __future__ import annotations

import io
import math
import os
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from pamid.base.errors import FileError
from pamid.base.files import ARRAYS, MIB, open_data

#: what a damaged or crafted archive may raise; a header that promises more than memory holds is a
#: MemoryError
_REFUSED = (
    ValueError,
    OSError,
    EOFError,
    KeyError,
    TypeError,
    MemoryError,
    NotImplementedError,
    RuntimeError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)
# the record that ends a zip file and states how long its directory is
_END = struct.Struct("<4s4H2LH")
_DIRECTORY = 8 * MIB  # of tens of thousands of arrays
_HEADER_READERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def load_arrays(
    path: Path, data: bytes | None = None, *, most: int = ARRAYS
) -> dict[str, NDArray[Any]]:
    """Every array of an npz file of at most so many bytes, refusing pickled objects; FileError
    states what is wrong.

    `data` are the file's bytes where the caller has read them already (to check a hash on the very
    same bytes).
    """
    try:
        with open_data(path, most) if data is None else io.BytesIO(data) as file:
            # a bare pickle or .npy would take another branch of numpy.load
            if file.read(2) != b"PK":
                raise FileError(f"{path} is not an npz file.", "Give the file that pamid wrote.")
            try:
                return _unpacked(file)
            except _REFUSED as error:
                raise FileError(
                    f"{path} is not a plain npz file ({error}).",
                    "Create the file again, without pickled objects and without compression.",
                ) from None
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror}.", "Check the path.") from None


def _unpacked(file: BinaryIO) -> dict[str, NDArray[Any]]:
    size = file.seek(0, os.SEEK_END)
    _require_short_directory(file, size)
    with zipfile.ZipFile(file) as archive:
        members = archive.infolist()
        if any(
            m.compress_type != zipfile.ZIP_STORED or m.file_size != m.compress_size for m in members
        ):
            raise ValueError("it is compressed")
        if sum(m.file_size for m in members) > size:
            raise ValueError("its directory declares more data than the file contains")
        return {m.filename.removesuffix(".npy"): _array(archive, m) for m in members}


def _require_short_directory(file: BinaryIO, size: int) -> None:
    """ValueError unless the directory is of a size that may be read: zipfile takes it whole."""
    tail = 20 + _END.size  # the locator of a directory beyond 4 GB would stand before the end
    file.seek(max(size - tail, 0))
    last = file.read(tail)
    mark, *_, length, _, comment = _END.unpack(last[-_END.size :])
    if mark != b"PK\x05\x06" or comment or last.startswith(b"PK\x06\x07") or length > _DIRECTORY:
        raise ValueError("its directory is damaged or too long")
    file.seek(0)


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(member) as file:
        read_header = _HEADER_READERS.get(npy.read_magic(file))
        if read_header is None:
            raise ValueError(f"{member.filename} is of another version")
        shape, _, dtype = read_header(file)
        if dtype.hasobject:
            raise ValueError(f"{member.filename} holds pickled objects")
        if math.prod(shape) * dtype.itemsize != member.file_size - file.tell():
            raise ValueError(f"{member.filename} does not match its header")
    with archive.open(member) as file:
        return np.asarray(npy.read_array(file, allow_pickle=False))
