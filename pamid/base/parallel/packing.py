"""Serialisation of job results to plain data, for another process or a file.

A result is broken down to numbers, strings and arrays. The question (the work and its item) is not
copied; a path refers to each of its objects. A receiver with the same question rebuilds the result
from its objects. Unpacking imports no module and calls no constructor: classes are those of the
question, or classes of pamid that are already loaded.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[Any]
Path = tuple[str | int, ...]

TYPE = ""  # step of a path from an object to its class
_PLAIN = (str, bool, int, type(None))


@dataclass(frozen=True)
class Packed:
    """A result as strict JSON and arrays of numbers."""

    tree: Any
    arrays: tuple[Numbers, ...]


class Question:
    """Objects of a work and its item, to which a result may refer."""

    def __init__(self, *roots: object) -> None:
        self._roots = roots

    @cached_property
    def _paths(self) -> dict[int, tuple[Path, object]]:
        """Path to every object by its id, and the object itself, so that its id stays valid."""
        paths: dict[int, tuple[Path, object]] = {}
        pending: list[tuple[object, Path]] = [(self._roots, ())]
        while pending:
            thing, path = pending.pop()
            if isinstance(thing, (*_PLAIN, float)) or id(thing) in paths:
                continue
            paths[id(thing)] = path, thing
            if not isinstance(thing, type):
                pending.append((type(thing), (*path, TYPE)))
            pending += [(part, (*path, step)) for step, part in parts_of(thing).items()]
        return paths

    def packed(self, result: object) -> Packed:
        """Pack a result. TypeError for an object that is neither plain data, nor of a class of
        pamid, nor part of the question."""
        packer = _Packer(self._paths)
        tree = packer.pack(result)
        return Packed(tree, tuple(packer.arrays))

    def unpacked(self, packed: Packed) -> Any:
        """Rebuild the result. LookupError, TypeError, ValueError or AttributeError if it belongs to
        another question."""
        return _Unpacker(self._roots, packed.arrays).unpack(packed.tree)


def parts_of(thing: object) -> dict[str | int, Any]:
    """Defining parts of an object by name or index, without values computed from them."""
    if isinstance(thing, Mapping):
        return dict(enumerate(thing.values()))
    if isinstance(thing, list | tuple):
        return dict(enumerate(thing))
    if is_dataclass(thing) and not isinstance(thing, type):
        return {
            f.name: getattr(thing, f.name)
            for f in fields(thing)
            if bool(f.compare or (f.default is MISSING and f.default_factory is MISSING))
        }
    kind = type(thing)
    if not any(base.__module__.split(".")[0] == "pamid" for base in kind.__mro__):
        return {}
    if kind.__getstate__ is not object.__getstate__:
        state: dict[str | int, Any] = thing.__getstate__()  # type: ignore[assignment]
        return state
    return {
        name: part
        for name, part in getattr(thing, "__dict__", {}).items()
        if not isinstance(getattr(kind, name, None), cached_property)
    }


class _Packer:
    def __init__(self, paths: Mapping[int, tuple[Path, object]]) -> None:
        self._paths = paths
        self.arrays: list[Numbers] = []
        self._numbers: dict[int, tuple[int, object]] = {}

    def pack(self, thing: Any) -> Any:
        if isinstance(thing, np.generic):
            return {"scalar": self._array(np.asarray(thing))}
        if isinstance(thing, _PLAIN) or type(thing) is float and math.isfinite(thing):
            return thing
        if type(thing) is float:
            return {"float": str(thing)}
        if id(thing) in self._paths:
            return {"at": list(self._paths[id(thing)][0])}
        if id(thing) in self._numbers:
            return {"same": self._numbers[id(thing)][0]}
        tree = self._new(thing)
        self._numbers[id(thing)] = len(self._numbers), thing
        return tree

    def _new(self, thing: Any) -> dict[str, Any]:
        if isinstance(thing, np.ndarray) and thing.dtype.kind in "biuf":
            return {"array": self._array(thing)}
        if type(thing) is dict:
            return {"dict": [[self.pack(k), self.pack(v)] for k, v in thing.items()]}
        if type(thing) in (list, tuple):
            return {type(thing).__name__: [self.pack(part) for part in thing]}
        if type(thing) in (set, frozenset):
            return {type(thing).__name__: [self.pack(part) for part in sorted(thing)]}
        kind = self._class(type(thing))
        if isinstance(thing, tuple):
            return {"named": kind, "parts": [self.pack(part) for part in thing]}
        return {
            "object": kind,
            "parts": {str(name): self.pack(part) for name, part in parts_of(thing).items()},
        }

    def _class(self, kind: type) -> Any:
        if id(kind) in self._paths:
            return list(self._paths[id(kind)][0])
        if _loaded(kind.__module__, kind.__qualname__) is not kind:
            raise TypeError(f"the result of a job holds a {kind.__name__}, which is no plain data")
        return f"{kind.__module__}:{kind.__qualname__}"

    def _array(self, array: Numbers) -> int:
        self.arrays.append(array if array.flags.f_contiguous else np.ascontiguousarray(array))
        return len(self.arrays) - 1


class _Unpacker:
    def __init__(self, roots: tuple[object, ...], arrays: tuple[Numbers, ...]) -> None:
        self._roots, self._arrays = roots, arrays
        self._done: list[Any] = []  # in the order in which the packer numbered them

    def unpack(self, tree: Any) -> Any:
        if not isinstance(tree, dict):
            return tree
        if "scalar" in tree:
            return self._arrays[tree["scalar"]][()]
        if "float" in tree:
            return float(tree["float"])
        if "at" in tree:
            return self._at(tree["at"])
        if "same" in tree:
            return self._done[tree["same"]]
        thing = self._new(tree)
        self._done.append(thing)
        return thing

    def _new(self, tree: dict[str, Any]) -> Any:
        if "array" in tree:
            return self._arrays[tree["array"]]
        if "dict" in tree:
            return {self.unpack(k): self.unpack(v) for k, v in tree["dict"]}
        for kind in (list, tuple, set, frozenset):
            if kind.__name__ in tree:
                return kind(self.unpack(part) for part in tree[kind.__name__])
        if "named" in tree:
            entries = [self.unpack(part) for part in tree["parts"]]
            named: Any = self._class(tree["named"])
            return tuple.__new__(named, entries)
        thing: Any = object.__new__(self._class(tree["object"]))
        parts = {name: self.unpack(part) for name, part in tree["parts"].items()}
        if is_dataclass(thing):
            for f in fields(thing):
                if f.name not in parts:
                    parts[f.name] = (
                        f.default if f.default_factory is MISSING else f.default_factory()
                    )
        elif hasattr(thing, "__setstate__"):
            thing.__setstate__(parts)
            return thing
        for name, part in parts.items():
            object.__setattr__(thing, name, part)
        return thing

    def _at(self, path: list[str | int]) -> Any:
        thing: Any = self._roots
        for step in path:
            thing = type(thing) if step == TYPE else parts_of(thing)[step]
        return thing

    def _class(self, kind: str | list[str | int]) -> type:
        loaded = self._at(kind) if isinstance(kind, list) else _loaded(*kind.split(":"))
        if not isinstance(loaded, type):
            raise ValueError(f"{kind} is no class")
        return loaded


def _loaded(module: str, name: str) -> Any:
    """Return a loaded class of pamid; None for any other name."""
    thing: Any = sys.modules.get(module) if module.split(".")[0] == "pamid" else None
    for part in name.split("."):
        thing = getattr(thing, part, None)
    # exclude objects that a module of pamid imports from elsewhere
    return thing if getattr(thing, "__module__", None) == module else None
