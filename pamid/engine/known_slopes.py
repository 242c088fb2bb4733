"""Slopes of a simulator's steps that are kept along a track, and used again where they still hold.

By differences the slopes of one step cost as many more steps as there are states, forces and
parameters; a fit runs along the same track again and again, each time a little off the last.
An exchange whose slopes D are known at z0 = (states, forces, parameters) is stepped plainly from
z, and D is taken once more where

    |after - (after0 + D dz)|  <=  STILL_HOLDS |D - 1| |dz|    dz = z - z0, row by row
    |change of (after - x)|    <=  STILL_HOLDS level           its root mean square along the run

that is, where the slopes foretell the step that was made, as far as something acted differently,
and where what acted is about what acted then: slopes by parameters go with that (of a force by
its gain, of an acceleration by the inertia), and without parameters only the first line counts. So
an impact that comes earlier, a stick that slips, or parameters that have moved far are noticed by
what they do; what is at rest does nothing, and there parameters may have moved by `FAR` at most.

A violated line says that D may be wrong, not that it is: a motion that lies elsewhere often has the
slopes of the old one. So D is probed at z before it is replaced. One more copy has all states and
forces moved at once, if the first line or `FAR` is violated; another one all parameters. Where D
foretells both to `SIDES_AGREE` (`pamid.engine.simulator`) it is kept, with z as its new z0, but for
the slopes by parameters that have moved by more than `FAR`. Slopes by parameters alone are worked
out anew where only their probe fails, all of them where the other one does. A probe costs one step
in place of thirty; columns that cancel in its sum go unnoticed, which slows a fit down and leaves
its end as it is.

Slopes by a force are worked out where something that is sought moves it, and where it differs from
that of z0; a force that follows the recorded inputs alone needs none.

Slopes by a parameter are used in proportion to it, p dx/dp being what is kept: masses, gains and
dampings that grow together leave a motion as it is, and so does that sum of slopes then; were it
off by a little, a fit would crawl along what nothing but the priors tells.

This is Gauss-Newton with an approximate Jacobian: it converges linearly, at a rate of about
`STILL_HOLDS` (Dennis and Schnabel (1996), Numerical Methods for Unconstrained Optimization, ch. 5
and 10.2; the chord method reuses one Jacobian, this reuses its parts). With probes to 0.3 in place
of `SIDES_AGREE` a mass on a floor ends 8 % off (`tests/integration/test_slopes_of_contacts.py`).

The step itself is foretold, and not made, where slopes have shown how well they do that. With z1
where it was last made, b = |z1 - z0| and r the way to there from where it was made before, both as
far as something acts differently there (|D - 1| |dz|, in levels), the part that slopes missed then
grows with the square of the way from z0, as what they leave out does:

    after1 + D (z - z1)    where    |z - z1| = d <= r
                           and      missed (2b + d) d / ((2b' + r) r) <= FORETOLD

b' being b as it was then. What has moved no farther than it was seen to, and was foretold to
`FORETOLD` of a level there, is no impact. What is cheap is believed as far as it has been checked,
as in the trust regions of Alexandrov, Dennis, Lewis and Torczon (1998), Structural Optimization 15,
16-23, here exchange by exchange. What is to be exact forgets slopes first, and foretells nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.engine.simulator import SLOPE_ROUNDING

Array = NDArray[np.float64]

STILL_HOLDS = 0.1  # of what a step does: a change that leaves slopes as they were
FAR = 0.3  # of a parameter: at rest, nothing else shows that it has moved
FORETOLD = 1e-3  # of a level: what a step may be off that is not made
MOST_NUMBERS = 2**25  # of a table, 256 MiB; where a track needs more, nothing is kept


@dataclass(frozen=True, eq=False)
class KnownSlopes:
    """One row per exchange. made (rows,): are there any? x (rows, states), f (rows, forces), p
    (rows, own parameters): where; after (rows, told): readings and states behind the step; slopes
    (rows, told, states + forces + chosen), zero by forces that are not `pushed` (rows, forces);
    last (rows, states + forces + own parameters), led (rows, told): where the step was made last,
    and what came of it; trust (rows, 3): b, r and missed / ((2b' + r) r), infinite where nothing
    was checked; chosen: places of the parameters; substeps: exchanges per sample; counts (3,): how
    often slopes were worked out, used again, and a step was foretold; foretold: how far one may be
    off, in levels."""

    made: NDArray[np.bool_]
    x: Array
    f: Array
    p: Array
    after: Array
    slopes: Array
    pushed: NDArray[np.bool_]
    last: Array
    led: Array
    trust: Array
    chosen: NDArray[np.intp]
    substeps: int
    counts: NDArray[np.int64]
    foretold: float = FORETOLD

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
        # Without a table a fit is slower but the same. Memory that runs out would end it.
        numbers = samples * substeps * (readings + nx) * (nx + nf + len(chosen))
        return cls._empty(samples, substeps, sizes, chosen) if numbers <= MOST_NUMBERS else None

    @classmethod
    def none(cls, sizes: tuple[int, int, int, int]) -> KnownSlopes:
        """Of a run that keeps nothing: without rows; sizes: as of `room`."""
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
        names = ("made", "x", "f", "p", "after", "slopes", "pushed", "last", "led", "trust")
        return {name: what(getattr(self, name)) for name in names}

    def part(self, start: int, stop: int) -> KnownSlopes:
        """The rows of these samples, the same ones."""
        rows = slice(start * self.substeps, stop * self.substeps)
        return replace(self, **self._by_rows(lambda a: a[rows]))

    def copy(self) -> KnownSlopes:
        """Rows of its own, with what is known so far."""
        return replace(self, **self._by_rows(np.copy), counts=np.zeros(3, np.int64))

    def without_foretelling(self) -> KnownSlopes:
        """The same rows, with which every step is made."""
        return replace(self, foretold=0.0)

    def forgotten(self) -> KnownSlopes:
        """Rows of its own of which nothing is known, with which every step is made."""
        fresh = replace(self.copy(), foretold=0.0)
        fresh.forget()
        return fresh

    def forget(self) -> None:
        self.made[:] = False
        self.pushed[:] = False

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
        """Slopes that hold for a step; how far the row is trusted else stays."""
        self.x[row], self.f[row], self.p[row] = x, f, p
        self.after[row], self.slopes[row] = after, slopes
        self.last[row], self.led[row] = np.concatenate([x, f, p]), after
        if not self.made[row]:
            self.trust[row, 1:] = 0.0, np.inf
        self.trust[row, 0], self.made[row] = 0.0, True

    def parts(self, row: int, p: Array) -> tuple[Array, Array, Array]:
        """Slopes of a row by states, forces, and parameters as they are now."""
        nx, nf = self.x.shape[1], self.f.shape[1]
        by = self.scaled(row, p)
        return by[:, :nx], by[:, nx : nx + nf], by[:, nx + nf :]

    def scaled(self, row: int, p: Array) -> Array:
        """Slopes of a row, those by parameters as these are now."""
        by, at = self.slopes[row].copy(), self.x.shape[1] + self.f.shape[1]
        before, now = self.p[row, self.chosen], p[self.chosen]
        # The addition only avoids a division by zero in the branch that is not used.
        by[:, at:] *= np.where((before == now) | (now == 0.0), 1.0, before / (now + (now == 0.0)))
        return by

    def lacking(self, row: int, f: Array, pushed: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Forces that are pushed, or differ from those of the row, and whose slopes were never
        worked out there."""
        return (pushed | (f != self.f[row])) & ~self.pushed[row]

    def hold(
        self, row: int, x: Array, f: Array, p: Array, after: Array, level: Array
    ) -> tuple[bool, bool]:
        """Are the slopes of a row by states and forces, and those by parameters, free of doubt for
        a step from x under f with p that led to `after`? See the module's docstring; level: of the
        run."""
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

    @np.errstate(all="ignore")  # what is no number is not trusted
    def foretells(self, row: int, x: Array, f: Array, p: Array, level: Array) -> Array | None:
        """Where a step from x under f with p leads, without making it; None where that has not been
        checked."""
        if self.foretold == 0.0 or not self._in_reach(row, f, p):
            return None
        dz, (base, reach, bend) = self._moved(row, x, f, p), self.trust[row]
        way = self._way(row, dz, level)
        # The error of a linear prediction grows with the square of the distance, here from the
        # point of the slopes.
        near = way == 0.0 or bend * (2.0 * base + way) * way <= self.foretold
        if not (near and way <= reach):
            return None
        return np.asarray(self.led[row] + self.slopes[row] @ dz)

    @np.errstate(all="ignore")
    def check(self, row: int, x: Array, f: Array, p: Array, after: Array, level: Array) -> None:
        """A step was made: how well would its slopes have foretold it?"""
        if self.foretold == 0.0 or not self._in_reach(row, f, p):
            return
        dz = self._moved(row, x, f, p)
        way, base = self._way(row, dz, level), self.trust[row, 0]
        if 0.0 < way < np.inf:
            missed = _most(np.abs(after - self.led[row] - self.slopes[row] @ dz), level)
            self.trust[row, 1:] = way, missed / ((2.0 * base + way) * way)
        point = np.concatenate([x, f, p])
        self.last[row], self.led[row] = point, after
        away = np.concatenate([x - self.x[row], f - self.f[row], (p - self.p[row])[self.chosen]])
        self.trust[row, 0] = self._way(row, away, level)

    def _in_reach(self, row: int, f: Array, p: Array) -> bool:
        """Are there slopes by all that has moved in forces and parameters, and has no parameter
        moved far?"""
        if not self.made[row] or ((f != self.f[row]) & ~self.pushed[row]).any():
            return False
        if self.far(row, p).any():
            return False
        dp = p - self.p[row]
        dp[self.chosen] = 0.0
        return not dp.any()

    def far(self, row: int, p: Array) -> NDArray[np.bool_]:
        """Parameters that have moved far."""
        return np.asarray(np.abs(p - self.p[row]) > FAR * np.abs(self.p[row]))

    def _moved(self, row: int, x: Array, f: Array, p: Array) -> Array:
        """From where the step was made last."""
        at = len(x) + len(f)
        dz = np.concatenate([x, f, p]) - self.last[row]
        return np.concatenate([dz[:at], dz[at:][self.chosen]])

    def _differently(self, row: int, dz: Array) -> Array:
        """|D - 1| |dz|, by what is told."""
        acted, nx = self.slopes[row].copy(), self.x.shape[1]
        acted[len(acted) - nx :, :nx] -= np.eye(nx)
        return np.asarray(np.abs(acted) @ np.abs(dz))

    def _way(self, row: int, dz: Array, level: Array) -> float:
        return _most(self._differently(row, dz), level)


def _most(size: Array, level: Array) -> float:
    """The largest in levels; of what has none, nothing alone is little."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.where(size == 0.0, 0.0, size / level).max(initial=0.0))
