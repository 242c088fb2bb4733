"""Model files of other programs as rigs: the kinds there are, found by scanning
`pamid.rigs.simulators.kinds`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from pamid.base.scanned import modules_of
from pamid.model.rig import Rig


@dataclass(frozen=True)
class ModelKind:
    """A kind of model file. suffixes: endings of its files, which `pamid.base.trust.MODEL_ENDINGS`
    has to know, too; rig: the rig in a file, which runs nothing of it, FileError whatever is wrong
    with it."""

    name: str
    suffixes: tuple[str, ...]
    rig: Callable[[Path], Rig]


@lru_cache
def model_kinds() -> dict[str, ModelKind]:
    """Every kind by the endings of its files: the `MODEL_KIND` of each file in
    `pamid.rigs.simulators.kinds`."""
    modules = modules_of("pamid.rigs.simulators.kinds").values()
    return {
        suffix: module.MODEL_KIND for module in modules for suffix in module.MODEL_KIND.suffixes
    }
