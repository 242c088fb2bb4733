"""The rig's state at the start of a window, estimated from the window's data and from where the
window before has led to.

    min over x  sum over samples |W (y(x) - y_measured)|^2 + |L (x - x_carried)|^2

by damped Gauss-Newton; the second term is the arrival cost of moving-horizon estimation. Rao,
Rawlings and Mayne (2003), IEEE Trans. Autom. Control 48(2), 246-258.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.damped_gauss_newton import DampingRule, Iteration, LeastSquares, iterate
from pamid.engine.program import Memory
from pamid.simulation.windows import Runner, Window

# what the squared residuals have to fall by for a sign to be turned that no reading shows: as three
# standard deviations would say it
TURNED = 9.0
FLAT = 0.05  # of the slopes without effects: a limit may let a part through
MISSED = 3.0  # residual over noise at which a flat reading gets other slopes
FIRST_STEPS = 12  # Gauss-Newton steps for the first reading of a window alone
READING_STEPS = 3  # and over each of its growing beginnings
CARRIED_INFORMATION = 1e-5  # information of a carried state relative to that of a window


class _StatePoint(NamedTuple):
    """A state at the start of a window, its cost, half Hessian and half gradient there."""

    x: Array
    cost: float
    H: Array
    g: Array


@dataclass(frozen=True, eq=False)
class WindowStart(LeastSquares[_StatePoint, Array]):
    """The least squares of a window over its initial state, with the carried state as prior (the
    arrival cost of moving-horizon estimation: Rao, Rawlings and Mayne (2003), IEEE TAC 48(2)).

    memory: at the start of the window, with room for the runner's sensitivities; resting: where a
    state stays that this window does not show.
    """

    runner: Runner
    memory: Memory
    window: Window
    p: Array
    y: Array
    weight: Array
    carried: Array
    known: Array  # information of the carried state
    resting: Array
    # begins at 1e-3, lowered once as by a step that was taken
    rule = DampingRule(1e-4, falls=0.1, least=1e-9, rises=30.0, most=1e8)

    def at(self, x: Array) -> _StatePoint:
        run, n, away = self.runner, self.runner.start_states, x - self.carried
        m = self.memory.copy()
        run.enter(m, x)
        Y, A, fine = run.run(m, self.window, self.p, True, self.weight)
        if not fine:
            return _StatePoint(x, np.inf, np.zeros((n, n)), np.zeros(n))
        r = ((Y - self.y) * self.weight).ravel()
        cost = float(r @ r) + float((away**2 * self.known).sum())
        A = self.slopes(x, A, r)
        H, g = (A.T @ A)[:n, :n], (A.T @ r)[:n]
        # a pull too weak to count in the cost
        rests = np.maximum(CARRIED_INFORMATION * H.diagonal() - self.known, 0.0)
        H = H + np.diag(self.known + rests)
        return _StatePoint(x, cost, H, g + self.known * away + rests * (x - self.resting))

    def slopes(self, x: Array, A: Array, r: Array) -> Array:
        """Slopes that the steps follow, A being those of the outputs at x (rows x columns, the
        states first)."""
        return A

    def step(self, at: _StatePoint, damping: float) -> Array | None:
        if not np.isfinite(at.H).all():
            return None
        scale = at.H.diagonal() + 1e-300
        change = np.linalg.lstsq(at.H + np.diag(damping * scale), -at.g, rcond=None)[0]
        return np.asarray(change, np.float64) if np.isfinite(change).all() else None

    def moved(self, at: _StatePoint, step: Array, last: bool) -> _StatePoint:
        return self.at(at.x + step)

    def settled(self, gain: float, before: _StatePoint, after: _StatePoint) -> bool:
        return gain < 1e-4 * after.cost + 1e-9

    @classmethod
    def of(
        cls,
        runner: Runner,
        memory: Memory,
        window: Window,
        p: Array,
        weight: Array,
        carried: Array,
        jump: Array | None = None,
    ) -> WindowStart:
        """The least squares of a window. memory is left untouched. weight: 1/sigma per channel.
        jump: by what each state may depart from the carried value (standard deviation; None or
        infinite where nothing is known of it: a weak pull remains)."""
        start_runner = Runner(
            runner.assembly, runner.track, runner.stepping, all_states=runner.all_states
        ).keeping()
        y, seen = runner.track.y[window.start : window.stop], runner.track.seen
        if not seen.all():
            weight, y = np.where(seen, weight, 0.0), np.where(seen, y, 0.0)
        known = np.zeros(start_runner.start_states) if jump is None else 1.0 / jump**2
        return cls(
            start_runner,
            start_runner.widened(memory),
            window,
            p,
            y,
            weight,
            carried,
            known,
            carried,
        )

    def estimate(self, steps: int = 11) -> tuple[Array, bool]:
        """Rig state at the start of the window from its data, by Gauss-Newton with a pull to the
        carried state, and whether it is usable.

        Where a reading does not show the sign of a state (a speed read as |v|), both signs are
        tried: no derivative leads between them. The same holds where an effect flattens a
        reading, as a limit does beyond it: if that fits badly, a start is sought with the slopes of
        the rig without the effects at its readings.
        """
        problem, carried, runner = self, self.carried, self.runner
        begun = problem.at(carried.copy())
        if not runner.start_states:
            return begun.x, bool(np.isfinite(begun.cost))
        # an error of the carried state grows with the window, so that no derivative may lead back
        if not begun.cost <= TURNED * self.y.size:
            x = self.from_readings()
            read = replace(problem, resting=x)
            if not begun.cost <= (point := read.at(x)).cost:
                problem, begun = read, point
        if not np.isfinite(begun.cost):
            return carried.copy(), False
        best = problem.solved(begun, steps)
        for i in runner.assembly.even_states:
            x, from_there = best.x.copy(), carried.copy()
            x[i], from_there[i] = -x[i], -from_there[i]
            turned = replace(problem, carried=from_there, resting=from_there)
            begun = turned.at(x)
            if np.isfinite(begun.cost):
                other = turned.solved(begun, steps)
                best = other if other.cost < best.cost - TURNED else best
        followed = _Followed.of_flat(problem) if best.cost > TURNED * self.y.size else None
        if followed is not None:
            # the start at which the rig without the effects at its readings fits the window
            without, _ = WindowStart.of(
                followed.plain,
                followed.plain_memory,
                self.window,
                followed.plain_p,
                self.weight,
                carried,
            ).estimate()
            for x in (carried, without):
                begun = followed.at(x)
                if np.isfinite(begun.cost):
                    x = followed.solved(begun, steps).x
                    other = problem.solved(problem.at(x), steps)
                    best = other if other.cost < best.cost - TURNED else best
        return best.x, True

    def from_readings(self) -> Array:
        """The state that fits the first reading, then ever longer beginnings of the window.

        A single reading shows the states that the output map holds, whatever the model does from
        there; few of them show the slopes, too, before its errors have grown. A state that they do
        not show stays where it was carried to.
        """
        x, first, length = self.carried, self.window.start, 1
        while length < len(self.y):
            window = Window(first, first + length)
            part = replace(self, window=window, y=self.y[:length], resting=x)
            begun = part.at(x)
            if not np.isfinite(begun.cost):
                break
            # a far attitude is many steps away, and from halfway longer beginnings lead elsewhere
            x = part.solved(begun, FIRST_STEPS if length == 1 else READING_STEPS).x
            length *= 2
        return x

    def solved(self, begun: _StatePoint, steps: int) -> _StatePoint:
        """The point to which so many steps lead at most."""
        return iterate(self, Iteration(begun, self.rule.start), steps).point


@dataclass(frozen=True, eq=False)
class _Followed(WindowStart):
    """The same with the slopes that the rig has without the effects at its readings, at samples
    that a flat reading misses: beyond a limit its slope leads nowhere. What it does not miss
    has no weight there, as it should.

    plain: runs the rig without these effects; plain_memory: at its start; plain_p: its parameters.
    """

    plain: Runner
    plain_memory: Memory
    plain_p: Array

    @classmethod
    def of_flat(cls, problem: WindowStart) -> _Followed | None:
        """None where no effect acts at a reading, or a step is too expensive to be tried twice."""
        runner = problem.runner
        plain = runner.assembly.with_plain_readings
        if plain is None or plain.program.keeps_slopes:
            return None
        values = plain.values()
        for key, place in plain.keys.items():
            values[place] = problem.p[runner.assembly.keys[key]]
        plain_runner = Runner(plain, runner.track, runner.stepping)
        given = {f.name: getattr(problem, f.name) for f in fields(problem)}
        return cls(
            **given, plain=plain_runner, plain_memory=plain_runner.memory(values), plain_p=values
        )

    def slopes(self, x: Array, A: Array, r: Array) -> Array:
        m = self.plain_memory.copy()
        self.plain.enter(m, x)
        _, B, fine = self.plain.run(m, self.window, self.plain_p, True, self.weight)
        if not fine:
            return A
        n = self.runner.start_states
        missed = np.abs(r) > MISSED
        flat = (np.abs(A[:, :n]) < FLAT * np.abs(B[:, :n])).any(axis=1)
        return np.where((flat & missed)[:, None], B[:, :n], A[:, :n])
