"""Of what kind the value of a setting has to be: that of its default."""

from __future__ import annotations

import math
from typing import Any

from pamid.base.errors import UsageError


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
