"""What steps by itself, as the engine asks it: steps, readings, and the slopes of a step, by finite
differences over copies where it does not tell them."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DIFFERENCE = 1e-6  # of a value's size: rounding and curvature each leave about 1e-9 of a slope
# of such a difference, where it lies across a jump: the square root of what rounding leaves of a
# value is the least one worth having (Nocedal and Wright (2006), ch. 8.1)
THIN = float(np.sqrt(np.finfo(float).eps)) / DIFFERENCE
SIDES_AGREE = 0.1  # of what a step does: curvature leaves 1e-6 of it, a jump ten times as much
SLOPE_ROUNDING = 1e-9  # of a value's size: what differences leave of a slope


class Simulator(Protocol):
    """What steps by itself. All values SI; n copies side by side, each with values of its own.

    sizes (states, forces): typical magnitudes, of which differences take a share;
    longest_s: longest step (s) that it may be asked for, infinite where nothing is known of it.
    """

    sizes: tuple[Array, Array]
    longest_s: float

    def steps(self, x: Array, f: Array, p: Array, h: float) -> tuple[Array, Array]:
        """States (n, states) and readings (n, readings) after a step of h seconds from x (n,
        states) under f (n, forces), with parameters p (n, parameters)."""

    def reads(self, x: Array, p: Array) -> Array:
        """Readings (n, readings) at x (n, states), p (n, parameters)."""

    def in_c(self, p: Array, h: float) -> AbstractContextManager[LibraryStep | None]:
        """The same steps of h seconds as a function of a library, with parameters p (n,
        parameters); None where there is none, or where there are readings."""


@dataclass(frozen=True, eq=False)
class LibraryStep:
    """What steps, in a library of C functions; addresses are int64.

    step: function (model, data) that moves data on, `count` times an exchange; models (n,): with
    parameters of their own; state_at, force_at: where the states and forces (float64) stand in
    data; cleared_at: numbers of it that every exchange begins with at zero; kept: what must live as
    long as these.
    """

    step: int
    data: int
    models: NDArray[np.int64]
    count: int
    state_at: NDArray[np.int64]
    force_at: NDArray[np.int64]
    cleared_at: NDArray[np.int64]
    kept: tuple[Any, ...]


class Slopes(NamedTuple):
    """Readings and states (in this order) after a step, and their derivatives by the states before
    it, the forces, and the chosen parameters."""

    after: Array
    by_state: Array
    by_force: Array
    by_parameter: Array


def slopes_of(
    simulator: Simulator,
    x: Array,
    f: Array,
    p: Array,
    h: float,
    chosen: NDArray[np.intp],
    pushed: NDArray[np.intp] | None = None,
) -> Slopes:
    """By forward differences over copies: one plain, then one for each value that is moved; or as
    the simulator itself tells them, where it has `slopes` that do. chosen: places of parameters;
    pushed: of forces, all without it.

    One more copy has everything moved to the other side. Where that is not what the slopes foretell
    a jump lies between, as where a contact closes, and a difference across it is the jump over the
    width of the difference, whatever that is. Such slopes are worked out on the other side as well,
    as near as rounding allows, and each is the one of the two by which less happens, as by the
    minmod limiter (Roe (1986), Annu. Rev. Fluid Mech. 18, 337-365).
    """
    told = getattr(simulator, "slopes", None)
    if told is not None and (own := told(x, f, p, h, chosen)) is not None:
        known = Slopes(*own)
        return known if pushed is None else known._replace(by_force=known.by_force[:, pushed])
    nx, nf = len(x), len(f)
    forces = np.arange(nf) if pushed is None else pushed
    at = np.concatenate([np.arange(nx), nx + forces, nx + nf + chosen])
    plain = np.concatenate([x, f, p])
    by = DIFFERENCE * np.maximum(np.abs(plain), np.concatenate([*simulator.sizes, p == 0.0]))[at]

    def behind(moves: Array) -> Array:
        copies = np.tile(plain, (len(moves), 1))
        copies[:, at] += moves
        parts = copies[:, :nx], copies[:, nx : nx + nf], copies[:, nx + nf :]
        after, readings = simulator.steps(*parts, h)
        return np.concatenate([readings, after], axis=1)

    both = behind(np.concatenate([np.zeros((1, len(at))), np.diag(by), -by[None]]))
    first, back = both[0], both[-1]
    slopes = (both[1:-1] - first).T / by
    own = np.eye(len(first), len(at), nx - len(first))
    limits = SIDES_AGREE * np.abs(slopes - own) @ by + SLOPE_ROUNDING * np.abs(first)
    if not (np.abs(back - first + slopes @ by) <= limits).all():
        other = (behind(np.diag(-THIN * by)) - first).T / (-THIN * by)
        slopes = np.where(np.abs(other - own) < np.abs(slopes - own), other, slopes)
    return Slopes(first, *np.split(slopes, [nx, nx + len(forces)], axis=1))
