"""A simulator as the engine drives it: steps, readings, and the slopes of a step by finite
differences over copies."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DIFFERENCE = 1e-6  # of a value's size: rounding and curvature each leave about 1e-9 of a slope
# of such a difference, where it lies across a jump: the square root of what rounding leaves of a
# value is the least one worth having (Nocedal and Wright (2006), ch. 8.1)
THIN = float(np.sqrt(np.finfo(float).eps)) / DIFFERENCE
SIDES_AGREE = 0.1  # of a step's action: curvature leaves 1e-6 of it, a jump ten times as much
SLOPE_ROUNDING = 1e-9  # of a value's size: rounding error of a slope by differences
# widths of a difference by which a probe of known slopes goes: to a tenth curvature does not count
# there, and rounding counts less
PROBED = 10.0


class Simulator(Protocol):
    """Interface of a simulator that steps by itself. All values SI; n copies side by side, each
    with values of its own.

    sizes (states, forces): typical magnitudes, of which differences take a share;
    longest_s: longest admissible step (s), infinite where none is known.
    """

    sizes: tuple[Array, Array]
    longest_s: float

    def steps(self, x: Array, f: Array, p: Array, h: float) -> tuple[Array, Array]:
        """States (n, states) and readings (n, readings) after a step of h seconds from x (n,
        states) under f (n, forces), with parameters p (n, parameters)."""

    def reads(self, x: Array, p: Array) -> Array:
        """Readings (n, readings) at x (n, states), p (n, parameters)."""

    def in_c(self, p: Array, h: float) -> AbstractContextManager[LibraryStep | None]:
        """The same steps of h seconds as a compiled function, with parameters p (n, parameters);
        None where there is none."""


@dataclass(frozen=True, eq=False)
class LibraryStep:
    """A compiled function that steps; addresses are int64.

    step: function (model, data) that moves data on, `count` times an exchange; models (n,): with
    parameters of their own; state_at, force_at: where the states and forces (float64) stand in
    data; reading_at: where the readings stand after a step; cleared_at: numbers that every exchange
    begins with at zero; leads_at: address of a number that is 1 for the step itself and 0 for those
    from moved values, whose internal steps follow it (0: there is none); keep_alive: objects that
    must live as long as these.
    """

    step: int
    data: int
    models: NDArray[np.int64]
    count: int
    state_at: NDArray[np.int64]
    force_at: NDArray[np.int64]
    cleared_at: NDArray[np.int64]
    reading_at: NDArray[np.int64]
    leads_at: int
    keep_alive: tuple[Any, ...]


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
    """By forward differences over copies (`Differences`). chosen: places of parameters; pushed: of
    forces, all without it."""
    nx, nf = len(x), len(f)
    forces = np.arange(nf) if pushed is None else pushed
    step = Differences(simulator, x, f, p, h)
    slopes = step.slopes(np.concatenate([np.arange(nx), nx + forces, nx + nf + chosen]))
    return Slopes(step.after, *np.split(slopes, [nx, nx + len(forces)], axis=1))


@dataclass(frozen=True, eq=False)
class Differences:
    """Differences of one step of h seconds over copies of the simulator. Places count through
    states, forces and parameters, in this order."""

    simulator: Simulator
    x: Array
    f: Array
    p: Array
    h: float

    @cached_property
    def plain(self) -> Array:
        return np.concatenate([self.x, self.f, self.p])

    @cached_property
    def widths(self) -> Array:
        """Widths by which the values are moved."""
        # A value of zero has no size of its own: states and forces then move by a share of a
        # typical one, a parameter by a share of one.
        sizes = np.concatenate([*self.simulator.sizes, self.p == 0.0])
        return DIFFERENCE * np.maximum(np.abs(self.plain), sizes)

    @cached_property
    def after(self) -> Array:
        """Readings and states after the step itself."""
        return self.behind(self.plain[None])[0]

    def behind(self, values: Array) -> Array:
        """Readings and states (n, rows) after steps with other values (n, places)."""
        nx, nf = len(self.x), len(self.f)
        parts = values[:, :nx], values[:, nx : nx + nf], values[:, nx + nf :]
        after, readings = self.simulator.steps(*parts, self.h)
        return np.concatenate([readings, after], axis=1)

    def slopes(self, at: NDArray[np.intp]) -> Array:
        """Slopes (rows, places) by forward differences at these places.

        One more copy has all of them moved to the other side. Where the slopes do not predict it, a
        jump lies between, as where a contact closes. A difference across it is the jump over the
        arbitrary width of the difference. Such slopes are computed on the other side as well, as
        near as rounding allows. The smaller action of the two is taken, as by the minmod limiter
        (Roe (1986), Annu. Rev. Fluid Mech. 18, 337-365).
        """
        slopes = self._differences(at, self.widths[at])
        if not self.agree(at, slopes):
            # As near as possible, because the jump that was crossed lies within one width of the
            # point.
            other = self._differences(at, -THIN * self.widths[at])
            still = self._still(at)
            slopes = np.where(np.abs(other - still) < np.abs(slopes - still), other, slopes)
        return slopes

    def agree(self, at: NDArray[np.intp], slopes: Array, widths: float = 1.0) -> bool:
        """Whether slopes predict the step with all these values moved down at once, by so many
        widths of a difference."""
        moved, by = self.plain.copy(), widths * self.widths[at]
        moved[at] -= by
        limits = SIDES_AGREE * np.abs(slopes - self._still(at)) @ by
        limits += SLOPE_ROUNDING * np.abs(self.after)
        off = self.behind(moved[None])[0] - self.after + slopes @ by
        return bool((np.abs(off) <= limits).all())

    def _differences(self, at: NDArray[np.intp], by: Array) -> Array:
        values = np.tile(self.plain, (len(at), 1))
        values[np.arange(len(at)), at] += by
        return (self.behind(values) - self.after).T / by

    def _still(self, at: NDArray[np.intp]) -> Array:
        """Slopes of a step that does nothing."""
        rows = len(self.after)
        return np.eye(rows, len(self.plain), len(self.x) - rows)[:, at]
