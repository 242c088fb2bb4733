"""The TOML file beside a recording: which rig, which loop, what is known, the controller's gains."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pamid.errors import FileError, nearest

_TABLES = ("recording", "known", "controller")
_RECORDING_KEYS = ("rig", "loop", "sampling_period_s")
_LOOPS = ("closed", "open")
_CONTROLLER_KEYS = ("kp_per_deg", "kd_s_per_deg", "derivative_filter_s", "command_limit")
# A user's own rig has gains in other units (`kp_per_m`); only the first word is held against the list.
_CONTROLLER_WORDS = ("kp_", "kd_", "ki_", "kv_", "derivative_filter_", "command_limit")


@dataclass(frozen=True)
class Sidecar:
    """What the TOML file of a recording says; all None or empty where there is no file."""

    rig: str | None = None
    loop: str | None = None
    sampling_period_s: float | None = None
    known: dict[str, float] = field(default_factory=dict)
    controller: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def read_sidecar(path: Path) -> Sidecar:
    """Read the TOML file of a recording. A missing file is legal; FileError on syntax or on a value of a wrong kind."""
    try:
        text = path.read_bytes().decode("utf-8-sig")
        tables = tomllib.loads(text)
    except FileNotFoundError:
        return Sidecar()
    except OSError as error:
        raise FileError(f"Cannot read {path}: {error.strerror or error}.") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FileError(f"{path} is not valid TOML: {error}.", "Write `key = value` lines under [tables].") from error
    for name in _TABLES:
        if not isinstance(tables.get(name, {}), dict):
            raise FileError(f"{path}: '{name}' must be a table.", f"Write [{name}] on a line of its own.")
    about = tables.get("recording", {})
    period_s = _numbers(path, "recording", {k: v for k, v in about.items() if k == "sampling_period_s"})
    if any(value <= 0.0 for value in period_s.values()):
        raise FileError(f"{path}: [recording] sampling_period_s must be positive.", "Give it in seconds, as 0.003.")
    return Sidecar(
        rig=_text(path, about, "rig"),
        loop=_loop(path, about),
        sampling_period_s=period_s.get("sampling_period_s"),
        known=_numbers(path, "known", tables.get("known", {})),
        controller=_numbers(path, "controller", tables.get("controller", {})),
        warnings=_unknown_names(path, tables),
    )


def _text(path: Path, table: dict[str, Any], key: str) -> str | None:
    value = table.get(key)
    if value is not None and not (isinstance(value, str) and value):
        raise FileError(f"{path}: [recording] {key} must be a text, not {value!r}.", f'Write {key} = "...".')
    return value


def _loop(path: Path, table: dict[str, Any]) -> str | None:
    loop = _text(path, table, "loop")
    if loop is not None and loop not in _LOOPS:
        hint = nearest(loop, _LOOPS) or "Write loop = \"closed\" or loop = \"open\"."
        raise FileError(f"{path}: [recording] loop is '{loop}', not 'closed' or 'open'.", hint)
    return loop


def _numbers(path: Path, name: str, table: dict[str, Any]) -> dict[str, float]:
    for key, value in table.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise FileError(f"{path}: [{name}] {key} must be a finite number, not {value!r}.", f"Write {key} = 0.5.")
    return {key: float(value) for key, value in table.items()}


def _unknown_names(path: Path, tables: dict[str, Any]) -> tuple[str, ...]:
    """Return a sentence for every name that nothing reads; keys of [known] belong to the rig and are checked there."""
    unknown = [(f"table [{key}]", nearest(key, _TABLES)) for key in tables if key not in _TABLES]
    unknown += [
        (f"key '{key}' in [recording]", nearest(key, _RECORDING_KEYS))
        for key in tables.get("recording", {})
        if key not in _RECORDING_KEYS
    ]
    unknown += [
        (f"key '{key}' in [controller]", nearest(key, _CONTROLLER_KEYS))
        for key in tables.get("controller", {})
        if not key.startswith(_CONTROLLER_WORDS)
    ]
    return tuple(f"{path.name}: unknown {what}, ignored. {hint}".rstrip() for what, hint in unknown)
