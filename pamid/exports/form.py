"""Interface of an export form, and the registry of `pamid.exports.forms`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from pamid.base.scanned import modules_of
from pamid.exports.plain_check import PlainCheck
from pamid.networks.correction.identified_model import Identified


@dataclass(frozen=True)
class Written:
    """Content of the exported files.

    binary: platform of an FMU's binary, "" for none; notes: remarks for the user; check: for a
    model file, its errors in its simulator.
    """

    files: dict[Path, bytes]
    binary: str = ""
    notes: tuple[str, ...] = ()
    check: PlainCheck | None = None


@dataclass(frozen=True)
class Form:
    """An export form.

    ending   of its file, "" for a folder
    write    contents from the model, its sample step (`SampleStep`) and the files to be written
    files    these files, if they differ from the requested path
    sampled  True if it needs the sample step; any other form gets None for it, and accepts a
             stepped model
    """

    ending: str
    write: Callable[[Identified, Any, tuple[Path, ...]], Written]
    files: Callable[[Any, Path], tuple[Path, ...]] = lambda _, path: (path,)
    sampled: bool = True


@lru_cache
def known_forms() -> dict[str, Form]:
    """Every form by its names: that of its file in `pamid.exports.forms`, and those in its `ALSO`.

    Each file holds a `FORM`; the first line of its docstring is the form's line in the help.
    """
    return {
        name: module.FORM
        for form_module, module in modules_of("pamid.exports.forms").items()
        for name in (form_module, *getattr(module, "ALSO", ()))
    }
