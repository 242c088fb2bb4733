"""Interface of a form of export, and the forms found by scanning `pamid.export.forms`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from pamid.base.scanned import modules_of
from pamid.correction.identified_model import Identified
from pamid.export.plain_check import PlainCheck


@dataclass(frozen=True)
class Written:
    """Content of the exported files. binary: the platform that an FMU was built for, "" for none;
    notes: what the user has to know; check: of a model file, its errors in the simulator that reads
    it."""

    files: dict[Path, bytes]
    binary: str = ""
    notes: tuple[str, ...] = ()
    check: PlainCheck | None = None


def _one_file(step: Any, path: Path) -> tuple[Path, ...]:
    return (path,)


@dataclass(frozen=True)
class Form:
    """A form in which a model is handed on. ending: of its file, "" where it is a folder; write:
    the contents for the model, what one of its samples does (`SampleStep`), and the files that are
    to be written; files: these, where they are others than the path that was asked for; sampled:
    whether it is made of that; a form that is not gets None for it, and can take a model that is
    stepped."""

    ending: str
    write: Callable[[Identified, Any, tuple[Path, ...]], Written]
    files: Callable[[Any, Path], tuple[Path, ...]] = _one_file
    sampled: bool = True


@lru_cache
def known_forms() -> dict[str, Form]:
    """Every form by its names: that of its file in `pamid.export.forms`, and those in its `ALSO`.
    Each file holds a `FORM`; the first line of its docstring is the form's line in the help."""
    return {
        name: module.FORM
        for form_module, module in modules_of("pamid.export.forms").items()
        for name in (form_module, *getattr(module, "ALSO", ()))
    }
