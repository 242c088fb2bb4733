"""Memory that the variables of a MAT file (v4, v5) need, counted without holding them.

A variable of v5 is compressed, and its parts say how long they are before they come. The walk reads
these tags alone, decompressing in small pieces, so that neither a bomb nor a false length costs
memory (MathWorks, MAT-File Format, sections 1 and 2).
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import BinaryIO, Protocol

from pamid.base.errors import FileError
from pamid.intake.logs.memory_budget import MemoryBudget

HEADER_BYTES = 128  # bytes before the first variable
MATRIX_TYPE, COMPRESSED_TYPE = 14, 15
#: data type -> bytes of a value in the file
SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 16: 1, 17: 2, 18: 4}
TAKEN_BYTES = 1 << 16
DEEPEST_ARRAY = 60  # arrays in arrays: MATLAB's loader and scipy's recurse as well


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


def charge_matlab(budget: MemoryBudget) -> None:
    """Charge `budget` for every variable of its file.

    Raises FileError if the declared size of a part exceeds that of its array, or if the sum exceeds
    the budget.
    """
    with budget.path.open("rb") as file:
        head = file.read(HEADER_BYTES)
        if not head.startswith(b"MATLAB") or head[126:128] not in (b"IM", b"MI"):
            from scipy.io import whosmat

            for name, shape, _ in whosmat(budget.path):
                values = 1
                for length in shape:
                    values *= int(length)
                budget.charge(name, values, raw=values * 8)
            return
        order = "<" if head[126:128] == b"IM" else ">"
        while len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}2I", tag)
            end = file.tell() + size
            if kind == COMPRESSED_TYPE:
                unpacked = _Unpacked(file, size)
                inner = unpacked.read(8)
                if len(inner) == 8 and struct.unpack(f"{order}2I", inner)[0] == MATRIX_TYPE:
                    _walk(budget, unpacked, order, struct.unpack(f"{order}2I", inner)[1], 0)
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
        kind, length = struct.unpack(f"{order}2I", tag)
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
