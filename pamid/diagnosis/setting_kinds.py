"""How a setting is stated, and of what kind its value has to be: that of its default."""

from __future__ import annotations

import math
from dataclasses import field
from typing import Any

from pamid.base.errors import UsageError

#: what speaks for a value that has no source of its own
JUDGEMENT = (
    "engineering judgement, not varied by itself: decision with all others by the blind trial "
    "(docs/measured/blind-trial.md)"
)
COST = "bounds the cost; what another value would do to verdicts was not measured by itself"
SHOWN_ONLY = "presentation only: no verdict rests on it"


def setting(default: Any, unit: str, meaning: str, evidence: str = JUDGEMENT) -> Any:
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "evidence": evidence})


def require_like(name: str, value: Any, default: Any) -> None:
    """UsageError where `value` is of another kind than `default` (number, whole number from 1 on,
    tuple of numbers or of pairs), negative or not finite."""
    if isinstance(default, tuple):
        fine = isinstance(value, tuple) and len(value) > 0
        pairs = isinstance(default[0], tuple)
        numbers = [x for one in value for x in (one if pairs else (one,))] if fine else []
        fine = fine and all(isinstance(x, int | float) and 0 < x < math.inf for x in numbers)
        kind = "a tuple of pairs" if pairs else "a tuple of numbers above 0"
    else:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        fine = number and math.isfinite(value) and value >= 0
        kind = "a number from 0 on"
        if isinstance(default, int):
            fine, kind = fine and isinstance(value, int) and value >= 1, "a whole number from 1 on"
    if not fine:
        raise UsageError(f"setting {name!r} is {value!r}", f"It takes {kind}.")
