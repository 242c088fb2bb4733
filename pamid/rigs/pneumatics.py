"""Air through valves and into a braided muscle."""

from __future__ import annotations

from pamid.symbolic.vocabulary import Expr, Number, clip, expression, maximum, sqrt, where

ATMOSPHERE_PA = 101325.0
# pressure ratio above which the ellipse is replaced by its chord: its slope is infinite at 1
LAMINAR = 0.995


def iso_flow(upstream: Number, downstream: Number, critical_ratio: Number) -> Expr:
    """Flow per unit of sonic conductance, Pa (ISO 6358; eq. 5 of the first paper at equal
    temperatures).

    upstream, downstream absolute Pa; times C in m3/(s Pa) it is the flow at atmospheric conditions
    in m3/s. Zero where the downstream pressure is the higher one.
    """
    up = expression(upstream)
    ratio = clip(downstream / up, 0.0, 1.0)
    s = (ratio - critical_ratio) / (1.0 - critical_ratio)
    edge = (LAMINAR - critical_ratio) / (1.0 - critical_ratio)
    ellipse = sqrt(1.0 - maximum(where(ratio < LAMINAR, s, edge), 0.0) ** 2)
    return up * where(ratio < LAMINAR, ellipse, ellipse * (1.0 - ratio) * (1.0 / (1.0 - LAMINAR)))


# Exact braid V = (Lf^2 L - L^3)/(4 pi n^2) for D0 = 20 mm, L0 = 250 mm, 28.6 deg: cubic in the
# contraction, m3
VOLUME_M3 = (7.8540e-5, 4.4988e-4, -7.9263e-4, 2.6421e-4)


def muscle_volume(contraction: Expr, dead_volume_m3: Number) -> Expr:
    """Air volume of a 20 mm x 250 mm muscle with its tube and fittings, m3."""
    d, c, b, a = VOLUME_M3
    return ((a * contraction + b) * contraction + c) * contraction + (d + dead_volume_m3)


def muscle_volume_slope(contraction: Expr) -> Expr:
    """dV/dcontraction, m3."""
    _, c, b, a = VOLUME_M3
    return (3.0 * a * contraction + 2.0 * b) * contraction + c
