"""An FMU as the engine sees it: its units, and its steps if its states are seen."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pamid.engine.simulator import LibraryStep

Array = NDArray[np.float64]


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


class VisibleStates(Protocol):
    """Copies of an FMU whose states are its whole memory; all SI."""

    def step_states(self, x: Array, f: Array, p: Array, h: float) -> tuple[Array, Array]:
        """States and outputs h seconds after x (n, states) under f, with parameters p."""

    def read_outputs(self, x: Array, p: Array) -> Array:
        """Outputs at these states."""

    def in_c(
        self, p: Array, h: float, places: NDArray[np.intp]
    ) -> AbstractContextManager[LibraryStep | None]:
        """See `pamid.engine.simulator.Simulator`; places: indices of the readings among the
        outputs."""


@dataclass
class SeenFmu:
    """FMU whose states are seen, as a `pamid.engine.simulator.Simulator`.

    places: indices of the readings among the outputs.
    """

    copies: VisibleStates
    places: NDArray[np.intp]
    sizes: tuple[Array, Array]
    longest_s: float = field(default=float("inf"))

    def steps(self, x: Array, f: Array, p: Array, h: float) -> tuple[Array, Array]:
        after, outputs = self.copies.step_states(x, f, p, h)
        return after, outputs[:, self.places]

    def reads(self, x: Array, p: Array) -> Array:
        if not len(self.places):
            return np.empty((len(x), 0))
        return self.copies.read_outputs(x, p)[:, self.places]

    def in_c(self, p: Array, h: float) -> AbstractContextManager[LibraryStep | None]:
        return self.copies.in_c(p, h, self.places)
