"""Slopes of a simulator's steps along a track, reused where they still hold.

Finite differences cost a further step per state, force and parameter. A fit runs along the same
track many times, each time with slightly different parameters. The slopes D of an exchange are
known at z0 = (states, forces, parameters). A run makes the plain step from z and takes D again
where

    |after - (after0 + D dz)|  <=  STILL_HOLDS |D - 1| |dz|    dz = z - z0, row by row
    |change of (after - x)|    <=  STILL_HOLDS level           its root mean square along the run

The first line compares the prediction with the step, relative to the change of the action. The
second line compares the action itself, since slopes by parameters are proportional to it: those of
a force by its gain, those of an acceleration by the inertia. Without parameters the second line is
not needed. An earlier impact, a stick that slips and a large change of parameters violate a line.
At rest nothing acts, and a parameter may move by `FAR` at most.

A violated line does not prove D wrong: a motion elsewhere often has the old slopes. D is therefore
probed at z before it is replaced. A copy moves all states and forces, if the first line or `FAR`
is violated. Another copy moves all parameters. D is kept with z as its new z0 where it predicts
both to `SIDES_AGREE`, except for slopes by parameters that moved by more
than `FAR`. If the probe of the parameters fails, only their slopes are replaced; if the other probe
fails, all are. A probe costs a single step instead of thirty. Columns that cancel in its sum go
unnoticed: the fit then is slower, and its optimum stays.

Slopes by a force are computed where a free parameter moves the force, and where the force differs
from that of z0. A force that follows the recorded inputs alone needs none.

Slopes by a parameter are scaled with it, so that p dx/dp is constant. Masses, gains and dampings
that grow together leave a motion as it is, and this scaling preserves the zero of their sum. With a
small error in it a fit would crawl along a direction that only the priors determine.

This is Gauss-Newton with an approximate Jacobian: it converges linearly, at a rate of about
`STILL_HOLDS` (Dennis and Schnabel (1996), Numerical Methods for Unconstrained Optimization, ch. 5
and 10.2; the chord method reuses a whole Jacobian, this reuses its parts). With probes to 0.3 in
place of `SIDES_AGREE` a mass on a floor ends 8 % off
(`tests/integration/test_slopes_of_contacts.py`).

A step is predicted instead of made where the slopes have proved accurate. Let z1 be where the step
was last made, b = |z1 - z0|, and r the distance from z1 to the simulation before it. Distances are
changes of the action there (|D - 1| |dz|, in levels). The error of a linear prediction grows with
the square of the distance from z0:

    after1 + D (z - z1)    where    |z - z1| = d <= r
                           and      missed (2b + d) d / ((2b' + r) r) <= PREDICTION_LIMIT

b' is the value of b at that check. A step no farther than the checked step, predicted to
`PREDICTION_LIMIT` of a level, contains no impact. A cheap model is trusted as far as it was
checked, as in the trust regions of Alexandrov, Dennis, Lewis and Torczon (1998), Structural
Optimization 15, 16-23, here exchange by exchange. An exact run forgets its slopes first and
predicts nothing.

`pamid.engine.stepped_kernel` holds the rule and its limits, this file the table.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array

PREDICTION_LIMIT = 1e-3  # of a level: largest error of a predicted step
MOST_NUMBERS = 2**25  # of a table, 256 MiB; where a track needs more, nothing is kept
ROWS = ("filled", "x", "f", "p", "after", "slopes", "pushed", "last", "last_after", "trust")


class KnownSlopes(NamedTuple):
    """Table of slopes, a row per exchange, as compiled code takes it.

    filled           (rows,): has the row slopes?
    x, f, p          (rows, states), (rows, forces), (rows, parameters of the simulator): z0
    after            (rows, values): readings and states after the step from z0
    slopes           (rows, values, states + forces + chosen); zero by forces that are not `pushed`
    pushed           (rows, forces)
    last, last_after (rows, states + forces + parameters), (rows, values): z1 and the step from it
    trust            (rows, 3): b, r and missed / ((2b' + r) r), infinite before the first check
    chosen           places of the parameters
    counts           (3,): slopes computed, slopes reused, steps predicted
    substeps         exchanges per sample
    prediction_limit largest error of a predicted step, in levels
    """

    filled: Any
    x: Any
    f: Any
    p: Any
    after: Any
    slopes: Any
    pushed: Any
    last: Any
    last_after: Any
    trust: Any
    chosen: Any
    counts: Any
    substeps: int
    prediction_limit: float

    @classmethod
    def room(
        cls,
        samples: int,
        substeps: int,
        sizes: tuple[int, int, int, int],
        chosen: NDArray[np.intp],
    ) -> KnownSlopes | None:
        """An empty table, None where it would be too large. sizes: readings, states, forces,
        parameters of the simulator."""
        readings, nx, nf, _ = sizes
        # Without a table a fit is slower but the same. Memory that runs out would end it.
        numbers = samples * substeps * (readings + nx) * (nx + nf + len(chosen))
        return cls._empty(samples, substeps, sizes, chosen) if numbers <= MOST_NUMBERS else None

    @classmethod
    def none(cls, sizes: tuple[int, int, int, int]) -> KnownSlopes:
        """A table without rows, for a run that reuses nothing. sizes: as of `room`."""
        return cls._empty(0, 1, sizes, np.zeros(0, np.intp))

    @classmethod
    def _empty(
        cls,
        samples: int,
        substeps: int,
        sizes: tuple[int, int, int, int],
        chosen: NDArray[np.intp],
    ) -> KnownSlopes:
        readings, nx, nf, parameters = sizes
        rows, entries = samples * substeps, readings + nx
        return cls(
            np.zeros(rows, bool),
            np.zeros((rows, nx)),
            np.zeros((rows, nf)),
            np.zeros((rows, parameters)),
            np.zeros((rows, entries)),
            np.zeros((rows, entries, nx + nf + len(chosen))),
            np.zeros((rows, nf), bool),
            np.zeros((rows, nx + nf + parameters)),
            np.zeros((rows, entries)),
            np.zeros((rows, 3)),
            chosen,
            np.zeros(3, np.int64),
            substeps,
            PREDICTION_LIMIT,
        )

    def part(self, start: int, stop: int) -> KnownSlopes:
        """The rows of these samples, the same ones."""
        rows = slice(start * self.substeps, stop * self.substeps)
        return self._replace(**{name: getattr(self, name)[rows] for name in ROWS})

    def copy(self) -> KnownSlopes:
        """A copy with all rows, whose counts are zero."""
        rows = {name: getattr(self, name).copy() for name in ROWS}
        return self._replace(**rows, counts=np.zeros(3, np.int64))

    def without_prediction(self) -> KnownSlopes:
        """The same rows for a run that makes every step."""
        return self._replace(prediction_limit=0.0)

    def forgotten(self) -> KnownSlopes:
        """An empty copy for a run that makes every step."""
        fresh = self.copy().without_prediction()
        fresh.forget()
        return fresh

    def forget(self) -> None:
        self.filled[:] = False
        self.pushed[:] = False

    def is_by(self, chosen: NDArray[np.intp]) -> bool:
        """Whether the slopes are by these parameters."""
        return np.array_equal(self.chosen, chosen)

    def fits(self, other: KnownSlopes) -> bool:
        """Whether both tables have the same exchanges and the same columns."""
        return (
            self.substeps == other.substeps
            and self.slopes.shape == other.slopes.shape
            and self.p.shape == other.p.shape
            and self.is_by(other.chosen)
        )

    @property
    def level(self) -> Array:
        """Root mean square (values,) of the change by a step, over the filled rows."""
        if not self.filled.any():
            return np.zeros(self.after.shape[1])
        done = self.after[self.filled].copy()
        done[:, done.shape[1] - self.x.shape[1] :] -= self.x[self.filled]
        return np.asarray(np.sqrt((done**2).mean(axis=0)))
