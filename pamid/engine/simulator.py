"""A simulator as the engine drives it: steps, readings, and the slopes of a step by finite
differences over copies."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array

DIFFERENCE = 1e-6  # of a value's size: rounding and curvature each leave about 1e-9 of a slope
# of such a difference, where it lies across a jump: the square root of what rounding leaves of a
# value is the least worth having (Nocedal and Wright (2006), ch. 8.1)
THIN = float(np.sqrt(np.finfo(float).eps)) / DIFFERENCE
# widths of a difference by which a probe of known slopes goes: to a tenth curvature does not count
# there, and rounding counts less
PROBED = 10.0


class Simulator(Protocol):
    """Interface of a simulator that steps by itself. All values SI; n copies side by side, each
    with separate values.

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


class LibraryStep(NamedTuple):
    """A function with the calling convention of C that steps; addresses are int64.

    step        function (model, data) that moves data on, `repeats` times an exchange
    data        what it moves
    models      (n,): each with separate parameters
    state_at, force_at
                (states,), (forces,): where these numbers (float64) stand in data
    cleared_at  numbers that every exchange begins with at zero
    reading_at  (readings,): where the readings stand after a step
    leads_at    address of a number that is 1 for the step itself and 0 for those from moved values,
                whose internal steps follow it; 0: there is none
    """

    step: int
    data: int
    models: Any
    repeats: int
    state_at: Any
    force_at: Any
    cleared_at: Any
    reading_at: Any
    leads_at: int


class StepScales(NamedTuple):
    """Numbers of a run for the differences of its steps, and for the known slopes of these.

    difference       share of a value's size by which states and forces are moved
    state_size, force_size
                     (states,), (forces,): typical magnitudes
    moved_by, place  (moved parameters,): by how much each is moved, and its sensitivity column
    p                (parameters of the simulator,)
    level            (values,): root mean square of a step's action along the run
    """

    difference: float
    state_size: Any
    force_size: Any
    moved_by: Any
    place: Any
    p: Any
    level: Any


class Slopes(NamedTuple):
    """Readings and states (in this order) after a step, and their derivatives by the states before
    it, the forces, and the chosen parameters."""

    after: Array
    by_state: Array
    by_force: Array
    by_parameter: Array


@contextmanager
def library_step(simulator: Simulator, p: Array, h: float, readings: int) -> Iterator[LibraryStep]:
    """Steps of h seconds with parameters p (n, parameters) for compiled code.

    A simulator without a compiled function is called back. What it raises is raised when the block
    ends; the states are NaN from there on.
    """
    with simulator.in_c(p, h) as compiled:
        if compiled is not None:
            yield compiled
            return
        nx, nf = map(len, simulator.sizes)
        numbers = np.zeros(nx + nf + readings)
        x, f, y = np.split(numbers, [nx, nx + nf])
        errors: list[BaseException] = []

        def step(model: int, _: int) -> None:
            try:
                if not errors:
                    x[:], y[:] = simulator.steps(x[None].copy(), f[None].copy(), p[model, None], h)
            except BaseException as error:  # an exception cannot pass through compiled code
                errors.append(error)
            if errors:
                numbers[:] = np.nan

        function = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_int64)(step)
        at = np.asarray(numbers.ctypes.data + 8 * np.arange(len(numbers)), np.int64)
        yield LibraryStep(
            ctypes.cast(function, ctypes.c_void_p).value or 0,
            0,
            np.arange(len(p)),
            1,
            at[:nx],
            at[nx : nx + nf],
            at[:0],
            at[nx + nf :],
            0,
        )
        if errors:
            raise errors[0]


def moved_parameters(p: Array, chosen: NDArray[np.intp]) -> tuple[Array, Array]:
    """Parameters (copies, parameters) of all copies that differences may need, and the widths
    (chosen,) by which they are moved.

    The copies are the plain copy, each with a parameter moved up, all moved down, each with a
    parameter moved down by `THIN` of that, and all by `PROBED`; the plain copy alone if none is
    chosen.
    """
    n, size = len(chosen), np.abs(p[chosen])
    by = DIFFERENCE * (size + (size == 0.0))
    copies = np.tile(p, (3 + 2 * n if n else 1, 1))
    if n:
        copies[1 + np.arange(n), chosen] += by
        copies[1 + n, chosen] -= by
        copies[2 + n + np.arange(n), chosen] -= THIN * by
        copies[2 + 2 * n, chosen] -= PROBED * by
    return copies, by
