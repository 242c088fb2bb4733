"""A trained static network as the force law of a muscle, inside the equations of a rig.

    class TrainedJoint(OneDof):
        def __init__(self) -> None:
            super().__init__()
            self.static_force = force_law_of(Path(__file__).parent / "muscle_20mm")

The network is written out as an equation, so it is compiled with the rig and its derivatives are
exact. Its inputs are a pressure (gauge) and a dimensionless contraction, its output a force, in
any order and any unit of these.

Outside the range it was trained in the law goes on along its tangent plane at the edge, without a
kink. Held at the edge it would leave the joint without stiffness there, and the bare network bends
off.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import DataError
from pamid.base.units import compatible, split_column, to_si, unit
from pamid.engine.symbolic.derivative import gradients
from pamid.engine.symbolic.expression import substitute, symbol
from pamid.engine.symbolic.vocabulary import ZERO, Expr, clip
from pamid.networks.anfis import Anfis
from pamid.networks.trained_network import TrainedNetwork, load_network

CHECKED_POINTS = 121  # per input, of the grid on which a law is checked
# how far that grid goes past each end of the scaled range [-1, 1]: a tenth of the range
CHECKED_BEYOND = 0.2
MONOTONE_TOLERANCE = 5e-3  # of the trained range of forces: what a law may move the wrong way
# scaled; along it, towards the inside, the check takes the tangent plane by a difference
NUDGE = 1e-4


@dataclass(frozen=True)
class ForceLaw:
    """Force (N) of contraction (1) and gauge pressure (Pa), as expressions."""

    trained: TrainedNetwork

    def __call__(self, contraction: Expr, pressure: Expr) -> Expr:
        by_unit = {"1": contraction, "Pa": pressure}
        low, high = (_si(self.trained, end) for end in ("low", "high"))
        scaled = [
            (by_unit[unit_] - a) * (2.0 / (b - a)) - 1.0
            for unit_, a, b in zip(_order(self.trained), low, high, strict=True)
        ]
        held = [clip(x, -1.0, 1.0) for x in scaled]
        inside = [symbol("state", f"input {k}") for k in range(len(scaled))]
        output = cast(Anfis, self.trained.network).expression(self.trained.weights, inside)
        slopes = gradients([output])[0]
        total, *tangent = substitute(
            [output, *(slopes.get(x, ZERO) for x in inside)], dict(zip(inside, held, strict=True))
        )
        for slope, x, edge in zip(tangent, scaled, held, strict=True):
            total = total + slope * (x - edge)
        a, b = _force_si(self.trained)
        return a + (total + 1.0) * (0.5 * (b - a))


def force_law_of(source: TrainedNetwork | Path | str, *, strict: bool = True) -> ForceLaw:
    """Force law of a trained network, or of the folder that holds it.

    Parameters
    ----------
    source
        Network or folder.
    strict
        Raise where the law is not monotone; else warn.

    Raises
    ------
    DataError
        Inputs and output are not contraction, pressure and force, the network has memory, or the
        law is not monotone.
    FileError
        As `load_network`.
    """
    trained = source if isinstance(source, TrainedNetwork) else load_network(source)
    _, fault = check_force_law(trained)
    if fault and strict:
        raise DataError(
            fault,
            "Train with fewer sets or more starts, add data there, or accept it with strict=False.",
        )
    if fault:
        warnings.warn(fault, stacklevel=2)
    return ForceLaw(trained)


def check_force_law(trained: TrainedNetwork) -> tuple[tuple[float, float], str]:
    """Check that the force grows with pressure and falls with contraction, in the trained range and
    a tenth beyond.

    Returns the largest move the wrong way (N) along pressure and along contraction, and where and
    by how much it is more than `MONOTONE_TOLERANCE` of the range of forces allows, else "". A force
    below zero counts as none: a rig's muscle does not push.
    """
    order = _order(trained)
    low, high = _force_si(trained)
    scaled = _extended(lambda u: trained.network.simulate(trained.weights, u))
    scaled = scaled.reshape(CHECKED_POINTS, CHECKED_POINTS)  # axes in the order of the inputs
    forces = np.maximum(low + 0.5 * (scaled + 1.0) * (high - low), 0.0)
    axis = order.index("Pa")
    violations = [_worst(forces, axis, 1.0), _worst(forces, 1 - axis, -1.0)]
    allowed = MONOTONE_TOLERANCE * (high - low)
    steps = trained.input_scaling.backward(np.stack([_steps(), _steps()], axis=1)).T
    faults = []
    for k, (by, (begin, end)) in zip((axis, 1 - axis), violations, strict=True):
        if by > allowed:
            moved, held = trained.input_names[k], trained.input_names[1 - k]
            verb = "falls" if forces[end] < forces[begin] else "grows"
            faults.append(
                f"at {held} = {steps[1 - k][begin[1 - k]]:.4g} it {verb} from "
                f"{forces[begin]:.4g} N to {forces[end]:.4g} N between {moved} = "
                f"{steps[k][begin[k]]:.4g} and {steps[k][end[k]]:.4g}"
            )
    text = f"The force law moves the wrong way by more than {allowed:.3g} N: {'; '.join(faults)}."
    return (violations[0][0], violations[1][0]), text if faults else ""


Place = tuple[int, int]


def _worst(forces: Array, axis: int, sign: float) -> tuple[float, tuple[Place, Place]]:
    """How far the force falls (sign 1; rises: -1) below its highest value before, and between which
    grid points."""
    along = np.moveaxis(sign * forces, axis, 0)
    fall = np.maximum.accumulate(along, axis=0) - along
    end, other = np.unravel_index(int(np.argmax(fall)), fall.shape)
    begin = int(np.argmax(along[: end + 1, other]))
    places = [(int(i), int(other)) if axis == 0 else (int(other), int(i)) for i in (begin, end)]
    return float(fall[end, other]), (places[0], places[1])


def _extended(of: Callable[[Array], Array]) -> Array:
    """Extend a function of the scaled inputs linearly on the grid (POINTS^2, ...): beyond the
    trained range along its tangent plane at the edge."""
    table = np.stack(np.meshgrid(_steps(), _steps(), indexing="ij"), axis=-1).reshape(-1, 2)
    held = np.clip(table, -1.0, 1.0)
    nudge = NUDGE * (table - held)
    edge, before = (of(held - by) for by in (0.0, nudge))
    return edge + (edge - before) / NUDGE


def grid_of_law(trained: TrainedNetwork) -> tuple[Array, float, int]:
    """The grid on which a law that is linear in some of its weights is checked: features (POINTS^2,
    weights), of which the scaled force is the product with these weights; the scaled force at which
    the muscle pulls no more; the axis of the grid, 0 or 1, that is the pressure. DataError as
    `check_force_law`."""
    low, high = _force_si(trained)
    features = _extended(lambda u: trained.network.features(trained.weights, u))
    return features, -1.0 - 2.0 * low / (high - low), _order(trained).index("Pa")


def _steps() -> Array:
    return np.linspace(-1.0 - CHECKED_BEYOND, 1.0 + CHECKED_BEYOND, CHECKED_POINTS)


def _order(trained: TrainedNetwork) -> list[str]:
    """SI units of the inputs, ("1", "Pa") or the other way round; DataError where the network is no
    force law."""
    symbols = [split_column(name)[1] for name in trained.input_names]
    order = ["1" if compatible(s, "1") else "Pa" if compatible(s, "Pa") else s for s in symbols]
    if sorted(order) != ["1", "Pa"] or not compatible(split_column(trained.output_name)[1], "N"):
        raise DataError(
            "A force law gives a force from a contraction and a pressure, not "
            f"{trained.output_name!r} from {', '.join(trained.input_names)}.",
            "Name the signals with their units: contraction, pressure_kpa; force_n.",
        )
    if not isinstance(trained.network, Anfis):
        raise DataError(
            f"A force law is an equation, and a network of kind {trained.network.kind!r} has none.",
            "Train an anfis.",
        )
    return order


def _si(trained: TrainedNetwork, end: str) -> list[float]:
    """An end of every input's range in SI."""
    values = getattr(trained.input_scaling, end)
    return [
        float(to_si(v, split_column(n)[1]))
        for v, n in zip(values, trained.input_names, strict=True)
    ]


def _force_si(trained: TrainedNetwork) -> tuple[float, float]:
    """Ends of the range of forces, N."""
    factor = unit(split_column(trained.output_name)[1]).factor
    return trained.output_scaling.low[0] * factor, trained.output_scaling.high[0] * factor
