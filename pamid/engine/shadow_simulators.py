"""Runs of a simulator with hidden states, such as a foreign model in a library.

Hidden states cannot be moved for a finite difference. Each sensitivity therefore has a shadow: a
copy of the simulator that runs in parallel from the start, with a parameter moved by d and the
forces f + d df/dp. Its readings differ from the plain ones by d times the sensitivity.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.program import Memory

BLOWN_UP = 1e15
MOVED = 1e-4  # of a parameter: a simulator that controls its step knows its outputs to 1e-6


class Carrier:
    """Copies of a simulator, side by side; values SI.

    whole_samples: it takes steps of a sample only; longest_s: see `Simulator`.
    """

    whole_samples: bool
    longest_s: float

    def begin(self, p: Array) -> Array:
        """Copies at the start of a recording with parameters p (n, parameters); returns their
        readings (n, readings)."""
        raise NotImplementedError

    def resume(self, saved: Sequence[Any], p: Array) -> Array:
        """Copies from the saved states, now with parameters p; returns their readings."""
        raise NotImplementedError

    def step(self, f: Array, h: float) -> Array:
        """States h seconds later, under f (n, forces)."""
        raise NotImplementedError

    def save(self) -> tuple[Any, ...]:
        """Return a state per copy to resume from. The copies are then free for other runs."""
        raise NotImplementedError


class ShadowCourse:
    """The simulator's part of a run: it moves readings on in x (first of all there), and their rows
    of S. parameter_count: number of the first parameters, which belong to the simulator."""

    def __init__(
        self,
        carrier: Carrier,
        memory: Memory,
        x: Array,
        S: Array,
        p: Array,
        columns: NDArray[np.int64] | None,
        parameter_count: int,
    ) -> None:
        self.carrier, self.memory, self.x, self.S = carrier, memory, x, S
        self.readings = len(x) - len(memory.x)
        self.parameter_count, self.p = parameter_count, np.asarray(p, float)
        moved: dict[int, tuple[float, int]] = {}  # column -> by how much, and of which parameter
        if columns is not None:
            moved = {
                int(c): (MOVED * abs(float(self.p[i])) or MOVED, i)
                for i, c in enumerate(columns)
                if c >= 0
            }
            for c in np.flatnonzero(np.abs(S[self.readings :]).any(axis=0)).tolist():
                moved.setdefault(c, (MOVED, -1))  # a state of the equations at the start
        self.places = np.array(list(moved), np.intp)
        self.by = np.array([by for by, _ in moved.values()])
        self.of = [i for _, i in moved.values()]

    def read(self) -> None:
        """Start the copies where the run begins, and take their readings."""
        p = np.tile(self.p[: self.parameter_count], (1 + len(self.by), 1))
        for k, (i, by) in enumerate(zip(self.of, self.by, strict=True)):
            if 0 <= i < self.parameter_count:
                p[1 + k, i] += by
        saved = self.memory.saved
        if self.memory.begin or saved is None:
            readings = self.carrier.begin(p)
        else:
            # A column without a copy begins with its window: the plain state is then its state as
            # well.
            plain, copies = saved
            readings = self.carrier.resume(
                [plain, *(copies.get(c, plain) for c in self.places.tolist())], p
            )
        self._take(readings)

    def step(self, f: Array, by: Array, h: float) -> None:
        """An exchange of h seconds under f (forces), whose sensitivities are `by` (forces,
        columns)."""
        forces = np.tile(f, (1 + len(self.by), 1))
        if len(self.by):
            # A moved copy needs the force that its parameter would cause, so that the chain
            # rule is part of the run.
            forces[1:] += (by[:, self.places] * self.by).T
        self._take(self.carrier.step(forces, h))

    def _take(self, readings: Array) -> None:
        self.x[: self.readings] = readings[0]
        if len(self.by):
            self.S[: self.readings] = 0.0
            self.S[: self.readings, self.places] = (readings[1:] - readings[0]).T / self.by

    def keep(self, memory: Memory) -> None:
        plain, *copies = self.carrier.save()
        memory.saved = (plain, dict(zip(self.places.tolist(), copies, strict=True)))
