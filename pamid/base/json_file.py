"""JSON files: strict (no NaN, no infinity), written whole or not at all, read or refused with line
and column."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from pamid.base.errors import FileError, PamidError
from pamid.base.files import JSON, read_data, write_atomically

# of names that are no UTF-8: no file can hold them as they are
_HALF = re.compile("[\ud800-\udfff]")


def write_json(path: str | Path, obj: Any) -> None:
    """Write strict JSON (no NaN, no infinity), atomically. NumPy scalars and arrays become numbers
    and lists."""
    write_atomically(path, json_bytes(obj, Path(path).name))


def json_bytes(obj: Any, name: str) -> bytes:
    """Bytes that `write_json` writes into a file of this name."""
    return json_text(obj, name).encode()


def json_text(obj: Any, name: str = "") -> str:
    """Strict JSON text, ended by a newline. PamidError naming the key that cannot be written."""
    text = (
        json.dumps(_plain(obj, name or "value"), indent=1, ensure_ascii=False, allow_nan=False)
        + "\n"
    )
    return _HALF.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def read_json(path: str | Path) -> Any:
    """Read strict JSON; FileError with line and column where it is not."""
    source = Path(path)
    try:
        text = read_data(source, JSON).decode("utf-8")
        return json.loads(
            text, parse_constant=_refuse_constant, parse_float=_finite, parse_int=_whole
        )
    except FileNotFoundError:
        raise FileError(f"{source} does not exist.", code="missing") from None
    except OSError as error:
        raise FileError(f"{source} cannot be read: {error.strerror}.") from error
    except UnicodeDecodeError as error:
        raise FileError(f"{source} is not UTF-8 text (byte {error.start}).", code="json") from None
    except json.JSONDecodeError as error:
        message = f"{source}, line {error.lineno}, column {error.colno}: not JSON: {error.msg}."
        raise FileError(message, code="json") from None
    except RecursionError:
        raise FileError(f"{source}: nested too deeply for a file of pamid.", code="json") from None
    except ValueError as error:
        raise FileError(f"{source}: {error}", code="json") from None


def _finite(text: str) -> float:
    value = float(text)
    if math.isinf(value):
        raise ValueError(f"{text:.12} is not a finite number.")
    return value


def _whole(text: str) -> int:
    _finite(text)
    return int(text)


def _refuse_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is not allowed in strict JSON.")


def _plain(value: Any, where: str) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        if not math.isfinite(value):
            raise PamidError(
                f"{where} is {value}: strict JSON holds finite numbers only.", code="not-finite"
            )
        return value
    if isinstance(value, Mapping):
        return {_key(key, where): _plain(item, f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item, f"{where}[{index}]") for index, item in enumerate(value)]
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise PamidError(f"{where} is a {type(value).__name__}, which has no JSON form.", code="json")


def _key(key: Any, where: str) -> str:
    if isinstance(key, str):
        return key
    raise PamidError(f"{where} has the key {key!r}; keys of JSON are text.", code="json")
