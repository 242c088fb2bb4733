"""Arrays from npz files that somebody else may have made: plain numbers only, and no code runs."""

from __future__ import annotations

import io
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.errors import FileError

#: what a damaged or crafted archive may raise; a header that promises more than memory holds is a MemoryError
_REFUSED = (ValueError, OSError, EOFError, KeyError, TypeError, MemoryError, NotImplementedError, RuntimeError,
            zipfile.BadZipFile, zlib.error)


def load_arrays(path: Path, data: bytes | None = None) -> dict[str, NDArray[Any]]:
    """Every array of an npz file, refusing pickled objects; FileError says what is wrong with the file.

    `data` are the file's bytes where the caller has read them already (to check a hash on the very same bytes).
    """
    try:
        content = path.read_bytes() if data is None else data
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror}.", "Check the path.") from None
    if not content.startswith(b"PK"):  # a bare pickle or .npy would take another branch of numpy.load
        raise FileError(f"{path} is not an npz file.", "Give the file that pamid wrote.")
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            return {name: arrays[name] for name in arrays.files}
    except _REFUSED as error:
        raise FileError(f"{path} is not a plain npz file ({error}).",
                        "Pickled objects are never loaded; make the file anew.") from None
