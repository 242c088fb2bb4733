"""Modules found by scanning a folder: effects, rigs, networks, log readers, exports, papers."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType
from typing import Any


def modules_of(package: str) -> dict[str, ModuleType]:
    """The modules of a package, loaded, by their name in it and in its order."""
    folder = import_module(package)
    names = sorted(module.name for module in iter_modules(folder.__path__))
    return {name: import_module(f"{package}.{name}") for name in names}


def classes_of(module: ModuleType, base: type) -> list[type[Any]]:
    """The classes derived from `base` that a module itself defines."""
    return [
        member
        for member in vars(module).values()
        if isinstance(member, type)
        and issubclass(member, base)
        and member is not base
        and member.__module__ == module.__name__
    ]
