"""Slopes of a simulator's steps that are kept along a track, and used again where they still hold.

By differences the slopes of one step cost as many more steps as there are states, forces and
parameters; a fit runs along the same track again and again, each time a little beside the last.
An exchange whose slopes D are known at z0 = (states, forces, parameters) is stepped plainly from
z, and D is taken once more where

    |after - (after0 + D dz)|  <=  STILL_HOLDS |D - 1| |dz|    dz = z - z0, row by row
    |change of (after - x)|    <=  STILL_HOLDS level           its root mean square along the run

that is, where the slopes foretell the step that was made, as far as something acted differently,
and where what acted is about what acted then: slopes by parameters go with that (of a force by
its gain, of an acceleration by the inertia). Else they are worked out anew, and kept. So an impact
that comes earlier, a stick that slips, or parameters that have moved far are noticed by what they
do; what is at rest does nothing, and there parameters may have moved by `FAR` at most.

Slopes by a parameter are used in proportion to it, p dx/dp being what is kept: masses, gains and
dampings that grow together leave a motion as it is, and so does that sum of slopes then; were it
off by a little, a fit would crawl along what nothing but the priors tells.

This is Gauss-Newton with an approximate Jacobian: it converges linearly, at a rate of about
`STILL_HOLDS` (Dennis and Schnabel (1996), Numerical Methods for Unconstrained Optimization, ch. 5
and 10.2; the chord method reuses one Jacobian, this reuses its parts). What is to be exact forgets
them first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STILL_HOLDS = 0.1  # of what a step does: a change that leaves slopes as they were
FAR = 0.3  # of a parameter: at rest, nothing else shows that it has moved
SLOPE_ROUNDING = 1e-9  # of a value's size: what differences leave of a slope
MOST_NUMBERS = 2**25  # of a table, 256 MiB; where a track needs more, nothing is kept


@dataclass(frozen=True, eq=False)
class KnownSlopes:
    """One row per exchange. made (rows,): are there any? x (rows, states), f (rows, forces), p
    (rows, own parameters): where; after (rows, told): readings and states behind the step; slopes
    (rows, told, states + forces + chosen); chosen: places of the parameters; substeps: exchanges
    per sample; counts (2,): how often slopes were worked out, and used again."""

    made: NDArray[np.bool_]
    x: Array
    f: Array
    p: Array
    after: Array
    slopes: Array
    chosen: NDArray[np.intp]
    substeps: int
    counts: NDArray[np.int64]

    @classmethod
    def room(
        cls,
        samples: int,
        substeps: int,
        sizes: tuple[int, int, int, int],
        chosen: NDArray[np.intp],
    ) -> KnownSlopes | None:
        """Nothing known yet; sizes: readings, states, forces, own parameters. None of what would
        be too much to keep."""
        readings, nx, nf, _ = sizes
        numbers = samples * substeps * (readings + nx) * (nx + nf + len(chosen))
        return cls._empty(samples, substeps, sizes, chosen) if numbers <= MOST_NUMBERS else None

    @classmethod
    def none(cls, states: int, forces: int, own: int) -> KnownSlopes:
        """Of a run that keeps nothing: without rows."""
        return cls._empty(0, 1, (0, states, forces, own), np.zeros(0, np.intp))

    @classmethod
    def _empty(
        cls,
        samples: int,
        substeps: int,
        sizes: tuple[int, int, int, int],
        chosen: NDArray[np.intp],
    ) -> KnownSlopes:
        readings, nx, nf, own = sizes
        rows, told = samples * substeps, readings + nx
        return cls(
            np.zeros(rows, bool),
            np.zeros((rows, nx)),
            np.zeros((rows, nf)),
            np.zeros((rows, own)),
            np.zeros((rows, told)),
            np.zeros((rows, told, nx + nf + len(chosen))),
            chosen,
            substeps,
            np.zeros(2, np.int64),
        )

    def part(self, start: int, stop: int) -> KnownSlopes:
        """The rows of these samples, the same ones."""
        rows = slice(start * self.substeps, stop * self.substeps)
        return replace(
            self,
            made=self.made[rows],
            x=self.x[rows],
            f=self.f[rows],
            p=self.p[rows],
            after=self.after[rows],
            slopes=self.slopes[rows],
        )

    def copy(self) -> KnownSlopes:
        """Rows of its own, with what is known so far."""
        return replace(
            self,
            made=self.made.copy(),
            x=self.x.copy(),
            f=self.f.copy(),
            p=self.p.copy(),
            after=self.after.copy(),
            slopes=self.slopes.copy(),
            counts=np.zeros(2, np.int64),
        )

    def forget(self) -> None:
        self.made[:] = False

    def is_by(self, chosen: NDArray[np.intp]) -> bool:
        """Are they by these parameters?"""
        return np.array_equal(self.chosen, chosen)

    def fits(self, other: KnownSlopes) -> bool:
        """Are they of the same exchanges, by the same values?"""
        return (
            self.substeps == other.substeps
            and self.slopes.shape == other.slopes.shape
            and self.p.shape == other.p.shape
            and self.is_by(other.chosen)
        )

    @property
    def level(self) -> Array:
        """Root mean square (told,) of what the steps do, over the rows that are made."""
        if not self.made.any():
            return np.zeros(self.after.shape[1])
        done = self.after[self.made].copy()
        done[:, done.shape[1] - self.x.shape[1] :] -= self.x[self.made]
        return np.asarray(np.sqrt((done**2).mean(axis=0)))

    def keep(self, row: int, x: Array, f: Array, p: Array, after: Array, slopes: Array) -> None:
        self.x[row], self.f[row], self.p[row] = x, f, p
        self.after[row], self.slopes[row], self.made[row] = after, slopes, True

    def parts(self, row: int, p: Array) -> tuple[Array, Array, Array]:
        """Slopes of a row by states, forces, and parameters as they are now."""
        nx, nf = self.x.shape[1], self.f.shape[1]
        by = self.slopes[row]
        before, now = self.p[row, self.chosen], p[self.chosen]
        share = np.where(before == now, 1.0, before / np.where(now == 0.0, 1.0, now))
        return by[:, :nx], by[:, nx : nx + nf], by[:, nx + nf :] * share

    def hold(self, row: int, x: Array, f: Array, p: Array, after: Array, level: Array) -> bool:
        """Do the slopes of a row hold for a step from x under f with p that led to `after`? See the
        module's docstring; level: of the run."""
        if not self.made[row]:
            return False
        dp = p - self.p[row]
        moved = dp[self.chosen]
        if (np.abs(dp) > FAR * np.abs(self.p[row])).any():
            return False
        dp[self.chosen] = 0.0
        if dp.any():
            return False  # by a parameter whose slopes were not asked for
        dx = x - self.x[row]
        by, dz = self.slopes[row], np.concatenate([dx, f - self.f[row], moved])
        tiny, first = SLOPE_ROUNDING * (np.abs(after) + level), len(after) - len(x)
        change = after - self.after[row]
        off = np.abs(change - by @ dz)
        acted = by.copy()
        acted[first:, : len(x)] -= np.eye(len(x))
        differently = np.abs(acted) @ np.abs(dz)
        change[first:] -= dx
        return bool(
            (off <= STILL_HOLDS * differently + tiny).all()
            and (np.abs(change) <= STILL_HOLDS * level + tiny).all()
        )
