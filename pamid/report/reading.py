"""Reading the files of a run with complaints that say where: file, place in it, what was expected.

Only strict JSON and plain numbers are read; nothing in a run is ever executed.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import FileError
from pamid.base.files import TABLE, read_data
from pamid.base.json_file import read_json
from pamid.base.result_file import REMEDY

FloatArray = NDArray[np.float64]
SQUARED = 1e150  # what is larger cannot be squared
_BLANK_CELL = re.compile(r"(?<=,)(?=[,\n])")


@dataclass(frozen=True)
class Node:
    """One JSON object and its place in the file ("" at the top)."""

    file: Path
    where: str
    content: Mapping[str, Any]

    def refuse(self, key: str, expected: str) -> NoReturn:
        """FileError: what stands at `key` is not what was expected."""
        found = "missing" if key not in self.content else f"{self.content[key]!r:.60}"
        raise FileError(
            f"{self.file}: {self._place(key)} should be {expected}, it is {found}.",
            REMEDY,
            code="damaged",
        )

    def number(self, key: str) -> float:
        found = self.maybe(key)
        if found is None:
            self.refuse(key, "a number")
        return found

    def maybe(self, key: str) -> float | None:
        """A finite number, or None where the key is missing or null."""
        value = self.content.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.refuse(key, "a number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.refuse(key, "a finite number")
        return number

    def text(self, key: str, default: str | None = None) -> str:
        """A text; without a default it must be there. Null counts as missing."""
        value = self.content.get(key)
        if value is None and default is not None:
            return default
        if not isinstance(value, str):
            self.refuse(key, "a text")
        return value

    def flag(self, key: str, default: bool) -> bool:
        value = self.content.get(key)
        if value is None:
            return default
        if not isinstance(value, bool):
            self.refuse(key, "true or false")
        return value

    def maybe_flag(self, key: str) -> bool | None:
        """True or false; None where the key is missing or null."""
        return None if self.content.get(key) is None else self.flag(key, False)

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of texts; () where it is missing."""
        values = self._list(key)
        if not all(isinstance(value, str) for value in values):
            self.refuse(key, "a list of texts")
        return tuple(values)

    def span(self, key: str) -> tuple[float, float] | None:
        """Two numbers; None where they are missing."""
        return None if self.content.get(key) is None else self._pair(key, self.content[key])

    def child(self, key: str) -> Node | None:
        """The object at `key`; None where it is missing or null."""
        value = self.content.get(key)
        return None if value is None else self._node(key, value)

    def children(self, key: str) -> dict[str, Node]:
        """The objects in the object at `key`, by name; {} where it is missing."""
        parent = self.child(key)
        return {} if parent is None else parent.nested()

    def nested(self) -> dict[str, Node]:
        """The objects in this object, by name."""
        return {name: self._node(name, value) for name, value in self.content.items()}

    def needed(self, key: str) -> Node:
        """The object at `key`, which must be there."""
        found = self.child(key)
        if found is None:
            self.refuse(key, "an object")
        return found

    def listed(self, key: str) -> list[Node]:
        """The objects in the list at `key`; [] where it is missing."""
        return [self._node(f"{key}[{index}]", value) for index, value in enumerate(self._list(key))]

    def _place(self, key: str) -> str:
        return f"{self.where}.{key}" if self.where else key

    def _list(self, key: str) -> list[Any]:
        value = self.content.get(key)
        if value is None:
            return []
        if not isinstance(value, list):
            self.refuse(key, "a list")
        return value

    def _node(self, key: str, value: Any) -> Node:
        if not isinstance(value, dict):
            place = self._place(key)
            raise FileError(
                f"{self.file}: {place} should be an object, it is {value!r:.60}.",
                REMEDY,
                code="damaged",
            )
        return Node(self.file, self._place(key), value)

    def _pair(self, key: str, value: Any) -> tuple[float, float]:
        if not isinstance(value, list) or len(value) != 2:
            self.refuse(key, "made of pairs of numbers")
        pair = Node(self.file, self._place(key), {"0": value[0], "1": value[1]})
        return pair.number("0"), pair.number("1")


def read_object(path: Path, schema: str | None = None) -> Node | None:
    """The JSON object in a file; None if there is no such file, FileError if it holds anything
    else."""
    if not path.exists():
        return None
    content = read_json(path)
    if not isinstance(content, dict):
        raise FileError(f"{path} should hold one JSON object.", REMEDY, code="damaged")
    node = Node(path, "", content)
    if schema is not None and content.get("schema") != schema:
        node.refuse("schema", repr(schema))
    return node


def read_columns(path: Path) -> dict[str, FloatArray] | None:
    """The columns of a numeric CSV by name, each (n,); None if there is no such file. A blank cell
    reads as nan."""
    if not path.exists():
        return None
    try:
        text = read_data(path, TABLE).decode("utf-8").replace("\r\n", "\n")
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(
            f"{path} cannot be read as text: {error}.", REMEDY, code="damaged"
        ) from None
    header, _, body = text.partition("\n")
    names = header.split(",")
    if not body.strip():
        raise FileError(f"{path} has no rows.", REMEDY, code="damaged")
    if len(set(names)) != len(names) or not all(names):
        raise FileError(f"{path}: every column needs a name of its own.", REMEDY, code="damaged")
    try:
        table = np.loadtxt(
            _BLANK_CELL.sub("nan", body).splitlines(), delimiter=",", ndmin=2, comments=None
        )
    except ValueError as error:
        raise FileError(f"{path}, below the header: {error}.", REMEDY, code="damaged") from None
    if table.shape[1] != len(names):
        message = f"{path}: {len(names)} names stand above {table.shape[1]} columns."
        raise FileError(message, REMEDY, code="damaged")
    if (np.abs(table) > SQUARED).any():
        raise FileError(
            f"{path} holds a number beyond {SQUARED:g}, which nothing shows.",
            REMEDY,
            code="damaged",
        )
    return dict(zip(names, table.T.copy(), strict=True))
