"""TOML files that somebody wrote by hand, or a program wrote to be believed: read whole, or refused
with a reason."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from pamid.base.errors import FileError
from pamid.base.files import TOML, read_data

_DEEPEST_TABLE = 50
_LARGEST_INTEGER = 2**63  # as TOML itself has it: whole numbers are of 64 bits


def read_toml(path: Path, missing: Callable[[], str] = str) -> dict[str, Any]:
    """The tables of a file. FileError where there is none (`missing` makes the hint), it cannot be
    read, is no TOML, nested without end, or holds a whole number beyond 64 bits."""
    try:
        tables = tomllib.loads(read_data(path, TOML).decode("utf-8-sig"))
    except FileNotFoundError:
        raise FileError(f"{path} does not exist.", missing(), code="missing") from None
    except OSError as error:
        raise FileError(
            f"{path} cannot be read: {error.strerror}.", "Give a TOML file that you may read."
        ) from error
    except UnicodeDecodeError as error:
        raise FileError(
            f"{path} is not UTF-8 text (byte {error.start}).", "Save it as UTF-8.", code="encoding"
        ) from None
    except tomllib.TOMLDecodeError as error:
        raise FileError(
            f"{path} is not TOML: {error}.",
            "Write text in quotes and numbers with a decimal point; each line is "
            "`key = value` or [table].",
            code="toml",
        ) from None
    except RecursionError:
        _too_deep(path)
    except ValueError:  # Python reads no number of more than 4300 digits
        raise _too_large(path) from None
    _require_plain(path, tables, 0)
    return tables


def _require_plain(path: Path, node: Any, depth: int) -> None:
    if depth > _DEEPEST_TABLE:
        _too_deep(path)
    if isinstance(node, int) and not -_LARGEST_INTEGER <= node < _LARGEST_INTEGER:
        raise _too_large(path)
    for part in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
        _require_plain(path, part, depth + 1)


def _too_deep(path: Path) -> NoReturn:
    raise FileError(
        f"{path}: tables or lists are nested too deeply.",
        "Correct the brackets: pamid reads at most three levels.",
        code="toml",
    ) from None


def _too_large(path: Path) -> FileError:
    return FileError(
        f"{path} holds a whole number of more than 19 digits.",
        "Correct it, or write it as 1e20.",
        code="toml",
    )
