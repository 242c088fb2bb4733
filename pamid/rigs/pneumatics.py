"""Air through valves and into a braided muscle."""

from __future__ import annotations

from typing import Any

from pamid.engine.symbolic.vocabulary import Expr, Number, clip, expression, maximum, sqrt, where
from pamid.model.parameter import Parameter

ATMOSPHERE_PA = 101325.0
# pressure ratio above which the ellipse is replaced by its chord: its slope is infinite at 1
LAMINAR = 0.995


def iso_flow(upstream: Number, downstream: Number, critical_ratio: Number) -> Expr:
    """Flow per unit of sonic conductance, Pa (ISO 6358; eq. 5 of the first paper at equal
    temperatures).

    upstream, downstream absolute Pa; times C in m3/(s Pa) it is the flow at atmospheric conditions
    in m3/s. Zero where the downstream pressure is the higher.
    """
    up = expression(upstream)
    ratio = clip(downstream / up, 0.0, 1.0)
    s = (ratio - critical_ratio) / (1.0 - critical_ratio)
    edge = (LAMINAR - critical_ratio) / (1.0 - critical_ratio)
    ellipse = sqrt(1.0 - maximum(where(ratio < LAMINAR, s, edge), 0.0) ** 2)
    return up * where(ratio < LAMINAR, ellipse, ellipse * (1.0 - ratio) * (1.0 / (1.0 - LAMINAR)))


_BRAID = "eq. 4: exact braid V = (Lf^2 L - L^3)/(4 pi n^2), D0 20 mm, L0 250 mm, 28.6 deg"
# eq. 4 of the first paper, V = a chi^3 + b chi^2 + c chi + d, d at rest
VOLUME = (
    Parameter.held("volume_cubic", 2.6421e-4, 0.0, 1e-3, "m3").with_source(_BRAID),
    Parameter.held("volume_quadratic", -7.9263e-4, -1e-3, 1e-3, "m3").with_source(_BRAID),
    Parameter.held("volume_linear", 4.4988e-4, 3e-4, 6e-4, "m3").with_source(_BRAID),
    Parameter.held("volume_at_rest", 7.8540e-5, 4e-5, 2e-4, "m3").with_source(_BRAID),
)
TEMPERATURE_RATIO = Parameter.held("temperature_ratio", 1.0, 0.7, 1.4).with_source(
    "eq. 5 of the first paper: T0 of the data sheet over T1 upstream; 1: air at 20 C"
)


def conductances(p: Any) -> tuple[Expr, Expr]:
    """Sonic conductances of the fill and the vent valve at the temperature of the air, m3/(s Pa):
    C sqrt(T0/T1) of eq. 5 of the first paper."""
    warm = sqrt(p.temperature_ratio)
    return p.conductance_in * warm, p.conductance_out * warm


def muscle_volume(contraction: Expr, p: Any) -> Expr:
    """Air volume of a muscle with its tube and fittings, m3; p: VOLUME and dead_volume (m3)."""
    cubic = (p.volume_cubic * contraction + p.volume_quadratic) * contraction
    rest: Expr = p.volume_at_rest + p.dead_volume
    return (cubic + p.volume_linear) * contraction + rest


def muscle_volume_slope(contraction: Expr, p: Any) -> Expr:
    """dV/dcontraction, m3; p: VOLUME."""
    steep: Expr = 3.0 * p.volume_cubic * contraction + 2.0 * p.volume_quadratic
    return steep * contraction + p.volume_linear
