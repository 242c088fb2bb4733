"""Known values of a rig's parameters, held against the bounds of these parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pamid.model.bound_parameter import Bound

#: A step between SI prefixes (g for kg, mm for m). Bounds hold every specimen that the author of
#: the rig expects; a value farther off than that is a slip of the unit or of the exponent, no
#: specimen.
IMPOSSIBLE_FACTOR = 1e3
CURE = "Correct it under [known] in the recording's TOML, or widen the bounds in the rig."


@dataclass(frozen=True)
class KnownObjection:
    """A known value outside the bounds of its parameter. impossible: no specimen has it; else it is
    merely not expected."""

    name: str
    text: str
    impossible: bool


def objection(b: Bound, name: str, value: float, si: float) -> KnownObjection | None:
    """The objection to a known value, None where it lies within the bounds.

    name, value: as written, in the unit of that name; si: the same value in SI.
    """
    if b.low <= si <= b.high:
        return None
    low, high = b.low / b.factor, b.high / b.factor
    bounds = f"the bounds {low:g} .. {high:g} {b.unit}".rstrip()
    has_sign = b.low >= 0.0 or b.high <= 0.0
    # a range that excludes 0 is that of a mass, a stiffness, a time: something that is there
    wrong_sign = has_sign and (si == 0.0 or (si > 0.0) != (b.high > 0.0))
    small, large = sorted((abs(b.low), abs(b.high)))
    # below the smallest of bounds of the same sign, or beyond the largest
    too_small = b.low * b.high > 0.0 and abs(si) < small / IMPOSSIBLE_FACTOR
    if not math.isfinite(si):
        fault = "is not finite"
    elif wrong_sign:
        fault = f"{'is zero' if si == 0.0 else 'has the wrong sign'}; see {bounds}"
    elif too_small or abs(si) > IMPOSSIBLE_FACTOR * large:
        fault = f"lies more than {IMPOSSIBLE_FACTOR:g} times beyond {bounds}"
    else:
        return KnownObjection(name, f"[known] {name} = {value:g} lies outside {bounds}", False)
    return KnownObjection(
        name, f"[known] {name} = {value:g} is impossible: the value {fault}", True
    )
