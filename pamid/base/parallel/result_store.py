"""Results of independent jobs, each in a separate file under the digest of everything that went
into it.

A job is a pure function of what it is given, so its result is known by the digest of the function,
of its arguments and of the code: who has the same question finds the answer, whichever process or
machine has worked it out. Files hold plain arrays and strict JSON, never pickle, and vouch for
themselves: a file that is damaged, or stands under another's name, is worked out again.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import marshal
import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property, lru_cache, partial
from importlib import metadata
from pathlib import Path
from types import BuiltinFunctionType, FunctionType, MethodType
from typing import Any

import numpy as np

from pamid.base.errors import FileError
from pamid.base.files import make_folder, refuse_write, write_atomically
from pamid.base.npz import load_arrays
from pamid.base.parallel.packing import Packed
from pamid.base.run_folder import JOURNAL, remove_jobs

_ABOUT = "about"
# packages that results depend on
_DECIDE = ("numpy", "scipy", "numba", "llvmlite", "threadpoolctl", "pysindy")


@dataclass(frozen=True)
class Store:
    """The results in a folder. Several processes may share it: files appear whole."""

    folder: Path

    def get(self, key: str) -> Packed | None:
        """The result of this key; None if there is none, or none that can be trusted."""
        with contextlib.suppress(FileError, ValueError, KeyError, TypeError, RecursionError):
            held = load_arrays(self.folder / f"{key}.npz")
            about = json.loads(held[_ABOUT].tobytes())
            arrays = tuple(held[f"a{i}"] for i in range(about["arrays"]))
            result = Packed(about["result"], arrays)
            if about["key"] == key and about["sha256"] == _digest_of(result):
                return result
        return None

    def put(self, key: str, what: str, result: Packed) -> None:
        """Keep a result, whole or not at all, and note in the journal that it was worked out."""
        make_folder(self.folder)
        about: dict[str, Any] = {"key": key, "what": what, "sha256": _digest_of(result)}
        about |= {"arrays": len(result.arrays), "result": result.tree}
        by_name = {f"a{i}": a for i, a in enumerate(result.arrays)}
        by_name[_ABOUT] = np.frombuffer(json.dumps(about, allow_nan=False).encode(), np.uint8)
        buffer = io.BytesIO()
        np.savez(buffer, **by_name)  # type: ignore[arg-type]
        write_atomically(self.folder / f"{key}.npz", buffer.getvalue())
        line = json.dumps({"key": key, "what": what}) + "\n"
        try:
            with open(self.folder / JOURNAL, "ab", buffering=0) as journal:
                # appended as a whole, also where several processes write
                journal.write(line.encode())
        except OSError as error:
            refuse_write(self.folder / JOURNAL, error)

    def clear(self) -> None:
        remove_jobs(self.folder)


def _digest_of(result: Packed) -> str:
    return digest(json.dumps(result.tree), *result.arrays)


# ---- digests -----------------------------------------------------------------------------------


def digest(*things: object) -> str:
    """A single sha256 over values, arrays, objects and the code of classes, the same in every
    process.

    Of an object its class and fields count, but not what is computed from them (cached properties,
    fields declared with compare=False); of a class or function outside pamid the file that defines
    it, of code inside only its name: the code of pamid has a separate digest. Not seen are modules
    that such a file imports, and files that it reads later on.
    """
    return _Digests().of(things).hex()


class _Digests:
    """Digests of parts, each worked out once: the same recording is part of many things."""

    def __init__(self) -> None:
        # with the part itself: its number stays taken
        self._known: dict[int, tuple[object, bytes]] = {}

    def of(self, thing: object) -> bytes:
        if thing is None or isinstance(thing, bool | int | float | str | bytes):
            return _sha(type(thing).__name__.encode(), repr(thing).encode())
        known = self._known.get(id(thing))
        if known is None:
            self._known[id(thing)] = thing, b"a part of itself"
            known = self._known[id(thing)] = thing, self._computed(thing)
        return known[1]

    def _computed(self, thing: object) -> bytes:
        if isinstance(thing, np.ndarray | np.generic):
            array = np.asarray(thing)
            if array.dtype.hasobject:
                return self._all("array", array.shape, *array.ravel().tolist())
            order = b"F" if array.flags.f_contiguous and not array.flags.c_contiguous else b"C"
            kind, shape = array.dtype.str.encode(), repr(array.shape).encode()
            return _sha(b"array", kind, shape, order, array.tobytes())
        if isinstance(thing, os.PathLike):
            return self._all("path", os.fspath(thing))
        if isinstance(thing, Mapping):
            return self._all("mapping", *(part for pair in thing.items() for part in pair))
        if isinstance(thing, set | frozenset):
            return _sha(b"set", *sorted(self.of(part) for part in thing))
        if isinstance(thing, tuple | list):
            return self._all(type(thing).__name__, *thing)
        if isinstance(thing, type):
            return self._class(thing)
        if isinstance(thing, partial):
            return self._all("partial", thing.func, thing.args, thing.keywords)
        if isinstance(thing, FunctionType | BuiltinFunctionType | MethodType):
            return self._function(thing)
        return self._all("object", type(thing), *(part for pair in _parts(thing) for part in pair))

    def _all(self, kind: str, *parts: object) -> bytes:
        return _sha(kind.encode(), *(self.of(part) for part in parts))

    def _class(self, cls: type) -> bytes:
        name = f"{cls.__module__}.{cls.__qualname__}"
        if _ours(cls.__module__) or cls.__module__ == "builtins":
            return _sha(b"class", name.encode())
        members = [(k, v) for k, v in vars(cls).items() if not k.startswith("__")]
        return self._all("class", name, _source(cls.__module__) or members, *cls.__bases__)

    def _function(self, f: Any) -> bytes:
        name = f"{f.__module__}.{f.__qualname__}"
        bound = getattr(f, "__self__", None) if isinstance(f, MethodType) else None
        inner = getattr(f, "__closure__", None) or ()
        held = [cell.cell_contents for cell in inner]
        code = getattr(f, "__code__", None)
        if _ours(f.__module__) or code is None:
            return self._all("function", name, bound, *held)
        return self._all(
            "function",
            name,
            bound,
            _source(f.__module__) or marshal.dumps(code.replace(co_filename=""), 2),
            *held,
        )


def _parts(thing: object) -> list[tuple[str, object]]:
    """The fields that make an object what it is."""
    if is_dataclass(thing):
        return [(f.name, getattr(thing, f.name)) for f in fields(thing) if f.compare]
    kind = type(thing)
    slots = [name for cls in kind.__mro__ for name in getattr(cls, "__slots__", ())]
    held = {name: getattr(thing, name) for name in slots if hasattr(thing, name)}
    held |= getattr(thing, "__dict__", {})
    return [
        pair
        for pair in held.items()
        if not isinstance(getattr(kind, pair[0], None), cached_property)
    ]


def _sha(*parts: bytes) -> bytes:
    hasher = hashlib.sha256()
    for part in parts:
        hasher.update(len(part).to_bytes(8, "big"))
        hasher.update(part)
    return hasher.digest()


def _ours(module: str | None) -> bool:
    return (module or "").split(".")[0] == "pamid"


@lru_cache
def _source(module: str) -> bytes:
    """Digest of the file that defines a module; b"" if it has none."""
    path = getattr(sys.modules.get(module), "__file__", None)
    try:
        return _sha(Path(path).read_bytes()) if path else b""
    except OSError:
        return b""


@lru_cache
def code_sha256() -> str:
    """Digest of pamid's files and of the versions of what it computes with."""
    folder = Path(__file__).parents[2]
    files = sorted(p for pattern in ("*.py", "*.json") for p in folder.rglob(pattern))
    parts = [
        part for p in files for part in (p.relative_to(folder).as_posix().encode(), p.read_bytes())
    ]
    versions = [f"python {sys.version_info[:2]}"]
    for package in _DECIDE:
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions.append(f"{package} {metadata.version(package)}")
    return _sha(*parts, *(v.encode() for v in versions)).hex()
