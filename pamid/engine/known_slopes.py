"""Slopes of a simulator's steps along a track, reused where they still hold.

Finite differences cost one more step per state, force and parameter. A fit runs along the same
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
probed at z before it is replaced. One copy moves all states and forces, if the first line or `FAR`
is violated. Another copy moves all parameters. D is kept with z as its new z0 where it predicts
both to `SIDES_AGREE` (`pamid.engine.simulator`), except for slopes by parameters that moved by more
than `FAR`. If the probe of the parameters fails, only their slopes are replaced; if the other probe
fails, all are. A probe costs one step instead of thirty. Columns that cancel in its sum go
unnoticed: the fit then is slower, and its optimum stays.

Slopes by a force are computed where a free parameter moves the force, and where the force differs
from that of z0. A force that follows the recorded inputs alone needs none.

Slopes by a parameter are scaled with it, so that p dx/dp is constant. Masses, gains and dampings
that grow together leave a motion as it is, and this scaling preserves the zero of their sum. With a
small error in it a fit would crawl along a direction that only the priors determine.

This is Gauss-Newton with an approximate Jacobian: it converges linearly, at a rate of about
`STILL_HOLDS` (Dennis and Schnabel (1996), Numerical Methods for Unconstrained Optimization, ch. 5
and 10.2; the chord method reuses one Jacobian, this reuses its parts). With probes to 0.3 in place
of `SIDES_AGREE` a mass on a floor ends 8 % off (`tests/integration/test_slopes_of_contacts.py`).

A step is predicted instead of made where the slopes have proved accurate. Let z1 be where the step
was last made, b = |z1 - z0|, and r the distance from z1 to the simulation before it. Distances are
changes of the action there (|D - 1| |dz|, in levels). The error of a linear prediction grows with
the square of the distance from z0:

    after1 + D (z - z1)    where    |z - z1| = d <= r
                           and      missed (2b + d) d / ((2b' + r) r) <= PREDICTION_LIMIT

b' is the value of b at that check. A step no farther than the checked one, predicted to
`PREDICTION_LIMIT` of a level, contains no impact. A cheap model is trusted as far as it was
checked, as in the trust regions of Alexandrov, Dennis, Lewis and Torczon (1998), Structural
Optimization 15, 16-23, here exchange by exchange. An exact run forgets its slopes first and
predicts nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.engine.simulator import SLOPE_ROUNDING

Array = NDArray[np.float64]

STILL_HOLDS = 0.1  # of a step's action: a change within which slopes hold
FAR = 0.3  # of a parameter: at rest, nothing else shows that it has moved
PREDICTION_LIMIT = 1e-3  # of a level: largest error of a predicted step
MOST_NUMBERS = 2**25  # of a table, 256 MiB; where a track needs more, nothing is kept


@dataclass(frozen=True, eq=False)
class KnownSlopes:
    """Table of slopes, one row per exchange.

    filled           (rows,): has the row slopes?
    x, f, p          (rows, states), (rows, forces), (rows, parameters of the simulator): z0
    after            (rows, values): readings and states after the step from z0
    slopes           (rows, values, states + forces + chosen); zero by forces that are not `pushed`
    pushed           (rows, forces)
    last, last_after (rows, states + forces + parameters), (rows, values): z1 and the step from it
    trust            (rows, 3): b, r and missed / ((2b' + r) r), infinite before the first check
    chosen           places of the parameters
    substeps         exchanges per sample
    counts           (3,): slopes computed, slopes reused, steps predicted
    prediction_limit largest error of a predicted step, in levels
    """

    filled: NDArray[np.bool_]
    x: Array
    f: Array
    p: Array
    after: Array
    slopes: Array
    pushed: NDArray[np.bool_]
    last: Array
    last_after: Array
    trust: Array
    chosen: NDArray[np.intp]
    substeps: int
    counts: NDArray[np.int64]
    prediction_limit: float = PREDICTION_LIMIT

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
            substeps,
            np.zeros(3, np.int64),
        )

    def _by_rows(self, what: Callable[[NDArray[Any]], NDArray[Any]]) -> dict[str, Any]:
        names = (
            "filled",
            "x",
            "f",
            "p",
            "after",
            "slopes",
            "pushed",
            "last",
            "last_after",
            "trust",
        )
        return {name: what(getattr(self, name)) for name in names}

    def part(self, start: int, stop: int) -> KnownSlopes:
        """The rows of these samples, the same ones."""
        rows = slice(start * self.substeps, stop * self.substeps)
        return replace(self, **self._by_rows(lambda a: a[rows]))

    def copy(self) -> KnownSlopes:
        """A copy with all rows, whose counts are zero."""
        return replace(self, **self._by_rows(np.copy), counts=np.zeros(3, np.int64))

    def without_prediction(self) -> KnownSlopes:
        """The same rows for a run that makes every step."""
        return replace(self, prediction_limit=0.0)

    def forgotten(self) -> KnownSlopes:
        """An empty copy for a run that makes every step."""
        fresh = replace(self.copy(), prediction_limit=0.0)
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

    def keep(self, row: int, x: Array, f: Array, p: Array, after: Array, slopes: Array) -> None:
        """Store the slopes of a step. The limits of trust stay."""
        self.x[row], self.f[row], self.p[row] = x, f, p
        self.after[row], self.slopes[row] = after, slopes
        self.last[row], self.last_after[row] = np.concatenate([x, f, p]), after
        if not self.filled[row]:
            self.trust[row, 1:] = 0.0, np.inf
        self.trust[row, 0], self.filled[row] = 0.0, True

    def parts(self, row: int, p: Array) -> tuple[Array, Array, Array]:
        """Slopes of a row by states, by forces, and by the present parameters."""
        nx, nf = self.x.shape[1], self.f.shape[1]
        by = self.scaled(row, p)
        return by[:, :nx], by[:, nx : nx + nf], by[:, nx + nf :]

    def scaled(self, row: int, p: Array) -> Array:
        """Slopes of a row, scaled to the present parameters."""
        by, at = self.slopes[row].copy(), self.x.shape[1] + self.f.shape[1]
        before, now = self.p[row, self.chosen], p[self.chosen]
        # The addition only avoids a division by zero in the branch that is not used.
        by[:, at:] *= np.where((before == now) | (now == 0.0), 1.0, before / (now + (now == 0.0)))
        return by

    def lacking(self, row: int, f: Array, pushed: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Forces that are pushed or differ from those of the row, without slopes in it."""
        return (pushed | (f != self.f[row])) & ~self.pushed[row]

    def hold(
        self, row: int, x: Array, f: Array, p: Array, after: Array, level: Array
    ) -> tuple[bool, bool]:
        """Whether the slopes by states and forces, and those by parameters, hold without a probe.

        For a step from x under f with p that led to `after`; level: of the run. See the module."""
        if not self._in_reach(row, f, p):
            return False, False
        dx, dp = x - self.x[row], (p - self.p[row])[self.chosen]
        dz = np.concatenate([dx, f - self.f[row], dp])
        # Something at rest changes by rounding alone, which no slope predicts.
        tiny, first = SLOPE_ROUNDING * (np.abs(after) + level), len(after) - len(x)
        change = after - self.after[row]
        off = np.abs(change - self.slopes[row] @ dz)
        change[first:] -= dx
        moves = off <= STILL_HOLDS * self._differently(row, dz) + tiny
        acts = np.abs(change) <= STILL_HOLDS * level + tiny
        return bool(moves.all()), bool(moves.all() and (acts.all() or not len(self.chosen)))

    @np.errstate(all="ignore")  # NaN is not trusted
    def predict_step(self, row: int, x: Array, f: Array, p: Array, level: Array) -> Array | None:
        """Predict a step from x under f with p; None beyond the checked distance."""
        if self.prediction_limit == 0.0 or not self._in_reach(row, f, p):
            return None
        dz, (base, reach, bend) = self._difference(row, x, f, p), self.trust[row]
        way = self._distance(row, dz, level)
        # The error of a linear prediction grows with the square of the distance, here from the
        # point of the slopes.
        near = way == 0.0 or bend * (2.0 * base + way) * way <= self.prediction_limit
        if not (near and way <= reach):
            return None
        return np.asarray(self.last_after[row] + self.slopes[row] @ dz)

    @np.errstate(all="ignore")
    def check(self, row: int, x: Array, f: Array, p: Array, after: Array, level: Array) -> None:
        """Compare a step that was made with its prediction, and update the trust."""
        if self.prediction_limit == 0.0 or not self._in_reach(row, f, p):
            return
        dz = self._difference(row, x, f, p)
        way, base = self._distance(row, dz, level), self.trust[row, 0]
        if 0.0 < way < np.inf:
            missed = _largest_in_levels(
                np.abs(after - self.last_after[row] - self.slopes[row] @ dz), level
            )
            self.trust[row, 1:] = way, missed / ((2.0 * base + way) * way)
        point = np.concatenate([x, f, p])
        self.last[row], self.last_after[row] = point, after
        away = np.concatenate([x - self.x[row], f - self.f[row], (p - self.p[row])[self.chosen]])
        self.trust[row, 0] = self._distance(row, away, level)

    def _in_reach(self, row: int, f: Array, p: Array) -> bool:
        """Whether the row has slopes by every force and parameter that moved, none of them far."""
        if not self.filled[row] or ((f != self.f[row]) & ~self.pushed[row]).any():
            return False
        if self.far(row, p).any():
            return False
        dp = p - self.p[row]
        dp[self.chosen] = 0.0
        return not dp.any()

    def far(self, row: int, p: Array) -> NDArray[np.bool_]:
        """Parameters that moved by more than `FAR`."""
        return np.asarray(np.abs(p - self.p[row]) > FAR * np.abs(self.p[row]))

    def _difference(self, row: int, x: Array, f: Array, p: Array) -> Array:
        """Difference from the point where the step was last made."""
        at = len(x) + len(f)
        dz = np.concatenate([x, f, p]) - self.last[row]
        return np.concatenate([dz[:at], dz[at:][self.chosen]])

    def _differently(self, row: int, dz: Array) -> Array:
        """|D - 1| |dz|, row by row."""
        acted, nx = self.slopes[row].copy(), self.x.shape[1]
        acted[len(acted) - nx :, :nx] -= np.eye(nx)
        return np.asarray(np.abs(acted) @ np.abs(dz))

    def _distance(self, row: int, dz: Array, level: Array) -> float:
        return _largest_in_levels(self._differently(row, dz), level)


def _largest_in_levels(size: Array, level: Array) -> float:
    """Largest size in levels; infinite for a value without a level that is not zero."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.where(size == 0.0, 0.0, size / level).max(initial=0.0))
