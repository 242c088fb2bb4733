"""Static force laws of a 20 mm fluidic muscle: force in N from contraction (1) and gauge pressure
(Pa).

The coefficients are refits to the maker's chart of the 20 mm muscle (contraction -3..25 %, 0..6
bar) unless said otherwise; measured specimens lie 10-19 % above the chart, so every rig scales the
law by a fitted factor.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from pamid.base.errors import FileError, nearest
from pamid.symbolic.vocabulary import Expr, clip, exp, where

Law = Callable[[Expr, Expr], Expr]


def exponential(contraction: Expr, pressure: Expr) -> Expr:
    """Six coefficients after Sarosi: F = (a1 p + a2) exp(a3 e) + a4 p e + a5 p + a6, e in %, p in
    bar (rms 7.0 N)."""
    p, e = pressure * 1e-5, contraction * 100.0
    return (-15.3369 * p + 275.7318) * exp(-0.3046 * e) - 8.2115 * p * e + 268.3102 * p - 274.2475


POLYNOMIAL = (  # rows: power of contraction/0.25, columns: power of pressure/6 bar
    (-1.36, 1504.22, 157.62, -436.95, 509.58, -220.13),
    (-2185.39, -171.49, -1124.58, 1064.05, -140.73),
    (8350.92, -2525.45, -90.58, -698.82),
    (-15852.86, 4091.67, 914.05),
    (13702.48, -2437.82),
    (-4301.99,),
)


def polynomial(contraction: Expr, pressure: Expr) -> Expr:
    """Fifth-order surface as in the first paper (rms 5.5 N); held at the edge outside -3..25 %,
    where it bends off."""
    x, y = clip(contraction, -0.03, 0.25) * 4.0, clip(pressure, 0.0, 6.5e5) * (1.0 / 6e5)
    total: Expr | float = 0.0
    for row in reversed(POLYNOMIAL):
        inner: Expr | float = 0.0
        for coefficient in reversed(row):
            inner = inner * y + coefficient
        total = total * x + inner
    # beyond the edges the muscle still softens: continue with the chart's mean slope, N per unit
    # contraction
    return total - 4.0e3 * (contraction - clip(contraction, -0.03, 0.25))


def braid_and_rubber(contraction: Expr, pressure: Expr) -> Expr:
    """Chou-Hannaford / Tondu-Lopez braid, 25.1 deg, end factor 0.959, less the rubber's own pull
    (rms 10.3 N)."""
    angle, end, radius = math.radians(25.10), 0.959, 0.010
    a, b = 3.0 / math.tan(angle) ** 2, 1.0 / math.sin(angle) ** 2
    braid = math.pi * radius**2 * pressure * (a * (1.0 - end * contraction) ** 2 - b)
    rubber = 629.0 * contraction + 160.5 * (1.0 - exp(-43.6 * contraction))
    return braid - rubber


def three_element(contraction: Expr, pressure: Expr) -> Expr:
    """Contractile element against a spring, after Serres (2008) for a 20 mm muscle, 250 mm long.

    F = F_ce(p) - K(p) x with x in mm and p in kPa, identified for 150..550 kPa and held outside.
    """
    p = pressure * 1e-3
    spring = where(
        p < 314.0, 32.7 - 0.0321 * clip(p, 150.0, 314.0), 17.0 + 0.0179 * clip(p, 314.0, 550.0)
    )
    return 2.91 * p + 44.6 - spring * (contraction * 250.0)


LAWS: dict[str, Law] = {
    "exponential": exponential,
    "polynomial": polynomial,
    "braid-and-rubber": braid_and_rubber,
    "three-element": three_element,
}


def law_named(name: str) -> Law:
    """A law of LAWS. FileError for an unknown name."""
    if name not in LAWS:
        raise FileError(
            f"unknown force law {name!r}", nearest(name, list(LAWS)) or f"laws: {', '.join(LAWS)}"
        )
    return LAWS[name]
