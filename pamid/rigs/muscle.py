"""Static force laws of a 20 mm fluidic muscle: force in N from contraction (1) and gauge pressure
(Pa).

The coefficients are refits to the maker's chart of the 20 mm muscle (contraction -3..25 %, 0..6
bar) unless stated otherwise; measured specimens lie 10-19 % above the chart, so every rig scales
the law by a fitted factor. They are parameters of every rig that has such a law, held at these
values unless a recording's [known] or the rig states others: another muscle has others.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from pamid.base.errors import FileError, nearest
from pamid.engine.symbolic.vocabulary import Expr, clip, cos, exp, sin, where
from pamid.model.parameter import Parameter

Law = Callable[[Expr, Expr], Expr]

CHART = "refit to the maker's chart of the 20 mm muscle"
WITHIN = 0.1  # bounds of a coefficient; beyond them a surface of this form is soon none of a muscle


@dataclass(frozen=True)
class CoefficientLaw:
    """A law of contraction (1) and gauge pressure (Pa) with coefficients; called with these two
    alone it has those of its data sheet.

    form        force, N, from contraction, pressure and what holds the coefficients by name
    parameters  the coefficients, which a rig with this law has in addition to its parameters
    """

    form: Callable[[Expr, Expr, Any], Expr]
    parameters: tuple[Parameter, ...]

    def __call__(self, contraction: Expr, pressure: Expr) -> Expr:
        sheet = SimpleNamespace(**{p.name: p.value * p.factor for p in self.parameters})
        return self.form(contraction, pressure, sheet)


def law_with(law: Law, p: Any) -> Law:
    """The law with the coefficients that p holds by name; a law without coefficients as it is."""
    if not isinstance(law, CoefficientLaw):
        return law
    form = law.form
    return lambda contraction, pressure: form(contraction, pressure, p)


class StaticForce:
    """The attribute `static_force` of a rig, its muscles' law: what is set there brings its
    coefficients along into the rig's parameters, behind the `option_parameters` that it has."""

    def __set_name__(self, kind: type, name: str) -> None:
        self.name = name

    def __get__(self, rig: Any, kind: type) -> Any:
        return self if rig is None else vars(rig)[self.name]

    def __set__(self, rig: Any, law: Law) -> None:
        vars(rig)[self.name] = law
        coefficients = law.parameters if isinstance(law, CoefficientLaw) else ()
        options = vars(rig).get("option_parameters", ())
        rig.parameters = (*type(rig).parameters, *options, *coefficients)


def _held(name: str, value: float, unit: str = "", source: str = CHART) -> Parameter:
    """A coefficient that is known, not fitted."""
    room = WITHIN * abs(value)
    held = Parameter.held(name, value, value - room, value + room, unit, spread=room)
    return held.with_source(source)


# ---- exponential --------------------------------------------------------------------------------

_SAROSI = (-15.3369, 275.7318, -0.3046, -8.2115, 268.3102, -274.2475)


def _exponential(contraction: Expr, pressure: Expr, c: Any) -> Expr:
    """Six coefficients after Sarosi: F = (a1 p + a2) exp(a3 e) + a4 p e + a5 p + a6, e in %, p in
    bar (rms 7.0 N)."""
    p, e = pressure * 1e-5, contraction * 100.0
    falling = -c.exponential_4  # taken off: where sums are fused, as with a number in its place
    pull = (c.exponential_1 * p + c.exponential_2) * exp(c.exponential_3 * e) - falling * p * e
    force: Expr = pull + c.exponential_5 * p + c.exponential_6
    return force


exponential = CoefficientLaw(
    _exponential,
    tuple(
        _held(
            f"exponential_{k}",
            value,
            source=f"{CHART}: a{k} of (a1 p + a2) exp(a3 e) + a4 p e + a5 p + a6, p bar, e %",
        )
        for k, value in enumerate(_SAROSI, 1)
    ),
)

# ---- polynomial ---------------------------------------------------------------------------------

POLYNOMIAL = (  # rows: power of contraction/0.25, columns: power of pressure/6 bar
    (-1.36, 1504.22, 157.62, -436.95, 509.58, -220.13),
    (-2185.39, -171.49, -1124.58, 1064.05, -140.73),
    (8350.92, -2525.45, -90.58, -698.82),
    (-15852.86, 4091.67, 914.05),
    (13702.48, -2437.82),
    (-4301.99,),
)


def _polynomial(contraction: Expr, pressure: Expr, c: Any) -> Expr:
    """Fifth-order surface as in the first paper (rms 5.5 N); held at the edge outside -3..25 %,
    where it bends off."""
    x, y = clip(contraction, -0.03, 0.25) * 4.0, clip(pressure, 0.0, 6.5e5) * (1.0 / 6e5)
    total: Any = 0.0
    for i, row in reversed([*enumerate(POLYNOMIAL)]):
        inner: Any = 0.0
        for j in reversed(range(len(row))):
            inner = inner * y + getattr(c, f"polynomial_x{i}y{j}")
        total = total * x + inner
    # beyond the edges the muscle still softens: continue with the chart's mean slope, N per unit
    # contraction
    force: Expr = total - 4.0e3 * (contraction - clip(contraction, -0.03, 0.25))
    return force


polynomial = CoefficientLaw(
    _polynomial,
    tuple(
        _held(
            f"polynomial_x{i}y{j}",
            value,
            source=f"{CHART}, N: times (contraction/0.25)^{i} (pressure/6 bar)^{j}",
        )
        for i, row in enumerate(POLYNOMIAL)
        for j, value in enumerate(row)
    ),
)

# ---- braid and rubber ---------------------------------------------------------------------------


def _braid_and_rubber(contraction: Expr, pressure: Expr, c: Any) -> Expr:
    """Chou-Hannaford / Tondu-Lopez braid, 25.1 deg, end factor 0.959, less the rubber's pull
    (rms 10.3 N)."""
    sine, cosine = sin(c.braid_angle), cos(c.braid_angle)
    a, b = 3.0 * cosine * cosine / (sine * sine), 1.0 / (sine * sine)
    inside = math.pi * c.braid_radius * c.braid_radius
    shortened = 1.0 - c.braid_end * contraction
    rubber = c.rubber_slope * contraction + c.rubber_rise * (
        1.0 - exp(-c.rubber_decay * contraction)
    )
    force: Expr = inside * pressure * (a * shortened * shortened - b) - rubber
    return force


braid_and_rubber = CoefficientLaw(
    _braid_and_rubber,
    (
        _held("braid_angle", 25.10, "deg", f"{CHART}: from the muscle's axis"),
        _held("braid_end", 0.959, source=f"{CHART}: end factor of the contraction"),
        _held("braid_radius", 0.010, "m", "data sheet, half the bore"),
        _held("rubber_slope", 629.0, "N", f"{CHART}: per unit of contraction"),
        _held("rubber_rise", 160.5, "N", f"{CHART}: F = rise (1 - exp(-decay contraction))"),
        _held("rubber_decay", 43.6, "", CHART),
    ),
)

# ---- three elements -----------------------------------------------------------------------------

_SERRES = "Serres (2008), 20 mm muscle of 250 mm"


def _three_element(contraction: Expr, pressure: Expr, c: Any) -> Expr:
    """Contractile element against a spring, after Serres (2008) for a 20 mm muscle, 250 mm long.

    F = F_ce(p) - K(p) x with x in mm and p in kPa, identified for 150..550 kPa and held outside.
    """
    p = pressure * 1e-3
    spring = where(
        p < 314.0,
        c.spring_low - c.spring_fall * clip(p, 150.0, 314.0),
        c.spring_high + c.spring_growth * clip(p, 314.0, 550.0),
    )
    force: Expr = c.contractile_gain * p + c.contractile_offset - spring * (contraction * 250.0)
    return force


three_element = CoefficientLaw(
    _three_element,
    (
        _held("contractile_gain", 2.91, "", f"{_SERRES}: F_ce = gain p + offset, p kPa"),
        _held("contractile_offset", 44.6, "N", f"{_SERRES}: F_ce = gain p + offset, p kPa"),
        _held("spring_low", 32.7, "", f"{_SERRES}: K = low - fall p below 314 kPa, N/mm"),
        _held("spring_fall", 0.0321, "", f"{_SERRES}: K below 314 kPa"),
        _held("spring_high", 17.0, "", f"{_SERRES}: K = high + growth p from 314 kPa, N/mm"),
        _held("spring_growth", 0.0179, "", f"{_SERRES}: K from 314 kPa"),
    ),
)

LAWS: dict[str, CoefficientLaw] = {
    "exponential": exponential,
    "polynomial": polynomial,
    "braid-and-rubber": braid_and_rubber,
    "three-element": three_element,
}


def law_named(name: str) -> CoefficientLaw:
    """A law of LAWS. FileError for an unknown name."""
    if name not in LAWS:
        raise FileError(
            f"unknown force law {name!r}", nearest(name, list(LAWS)) or f"laws: {', '.join(LAWS)}"
        )
    return LAWS[name]
