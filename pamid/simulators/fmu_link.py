"""Interface of the engine to an FMU: units, and requests to its host."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pamid.engine.shadow_simulators import Carrier
from pamid.engine.simulator import LibraryStep

Array = NDArray[np.float64]

_EMPTY = np.zeros((0, 0))


class SavedState:
    """A saved state, by its number in the host."""

    def __init__(self, number: int) -> None:
        self.number = number


class UnitScale(NamedTuple):
    """Conversion from an FMU's units to SI: value * scale + offset."""

    scale: Array
    offset: Array

    def outside(self, values: Array) -> Array:
        scaled: Array = (values - self.offset) / self.scale
        return scaled

    def inside(self, values: Array) -> Array:
        scaled: Array = values * self.scale + self.offset
        return scaled


class FmuUnits(NamedTuple):
    inputs: UnitScale
    outputs: UnitScale
    parameters: UnitScale
    states: UnitScale


class FmuLink(Carrier):
    """Copies of an FMU, as a `pamid.engine.shadow_simulators.Carrier`.

    If its states are seen, `SeenFmu` drives it.
    """

    units: FmuUnits

    def _request(
        self, what: str, table: Array, h: float = 0.0, numbers: Sequence[int] = ()
    ) -> Array:
        """Answer to a request."""
        raise NotImplementedError

    # ---- as a carrier ----------------------------------------------------------------------------

    def begin(self, p: Array) -> Array:
        return self._readings("begin", self.units.parameters.outside(p))

    def resume(self, saved: Sequence[Any], p: Array) -> Array:
        numbers = [state.number for state in saved]
        return self._readings("resume", self.units.parameters.outside(p), numbers=numbers)

    def step(self, f: Array, h: float) -> Array:
        return self._readings("step", self.units.inputs.outside(f), h)

    def save(self) -> tuple[SavedState, ...]:
        return tuple(SavedState(int(number)) for number in self._request("keep", _EMPTY)[0])

    # ---- where its states are seen ---------------------------------------------------------------

    def step_states(self, x: Array, f: Array, p: Array, h: float) -> tuple[Array, Array]:
        """States and outputs after h, of n copies; all SI."""
        return self._split_columns(self._request("step states", self._rows(x, f, p), h))

    def read_outputs(self, x: Array, p: Array) -> Array:
        """Outputs at these states; all SI."""
        rows = np.concatenate([self.units.states.outside(x), self.units.parameters.outside(p)], 1)
        return self._readings("read outputs", rows)

    def in_c(
        self, p: Array, h: float, places: NDArray[np.intp]
    ) -> AbstractContextManager[LibraryStep | None]:
        """See `pamid.engine.simulator.Simulator`; places: indices of the readings among the
        outputs.

        None if another process holds the FMU, because it makes whole runs.
        """
        return nullcontext()

    def _rows(self, x: Array, f: Array, p: Array) -> Array:
        file = self.units
        given = file.states.outside(x), file.inputs.outside(f), file.parameters.outside(p)
        return np.concatenate(given, axis=1)

    def _split_columns(self, rows: Array) -> tuple[Array, Array]:
        seen = len(self.units.outputs.scale)
        return self.units.states.inside(rows[:, seen:]), self.units.outputs.inside(rows[:, :seen])

    def _readings(
        self, what: str, table: Array, h: float = 0.0, numbers: Sequence[int] = ()
    ) -> Array:
        return self.units.outputs.inside(self._request(what, table, h, numbers))


@dataclass
class SeenFmu:
    """FMU whose states are seen, as a `pamid.engine.simulator.Simulator`.

    places: indices of the readings among the outputs.
    """

    link: FmuLink
    places: NDArray[np.intp]
    sizes: tuple[Array, Array]
    longest_s: float = field(default=float("inf"))

    def steps(self, x: Array, f: Array, p: Array, h: float) -> tuple[Array, Array]:
        after, outputs = self.link.step_states(x, f, p, h)
        return after, outputs[:, self.places]

    def reads(self, x: Array, p: Array) -> Array:
        if not len(self.places):
            return np.empty((len(x), 0))
        return self.link.read_outputs(x, p)[:, self.places]

    def in_c(self, p: Array, h: float) -> AbstractContextManager[LibraryStep | None]:
        return self.link.in_c(p, h, self.places)
