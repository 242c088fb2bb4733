"""Short fit of a rig to a recording: parameters within their priors, and a start state for each of
some windows.

It decides every check on whether a recording suits its rig: another unit, an opposite sign, an
input that is held between samples. A separate start state in every window makes it blind to drift.
The priors measure the necessary change of the data sheet.

    cost        sum over windows |W (y(x_w, p) - y_measured)|^2 + |(p - p_sheet)/spread|^2
    W           1/sigma per channel, sigma its noise and at least LEAST_SIGMA of its spread

The start states are eliminated window by window (variable projection by block elimination: Golub,
Pereyra 2003, Inverse Problems 19, R1-R26).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.metrics import motion
from pamid.engine.damped_gauss_newton import DampingRule, Iteration, LeastSquares, iterate
from pamid.engine.program import Stepping
from pamid.engine.symbolic.expression import symbol
from pamid.intake.checks.sheet_comparison import OPENING_SAMPLES, shapes
from pamid.model.assembly import Assembly
from pamid.model.rig import Rig
from pamid.recording.noise import noise_level
from pamid.recording.recording import Recording
from pamid.simulation.free_runs import choose_stepping
from pamid.simulation.initial_state import WindowStart
from pamid.simulation.rig_data import data_of
from pamid.simulation.tracks import Track, noise_of, stated_noise, track_of
from pamid.simulation.windows import Runner, Window

COMPARED_WINDOWS, FEWEST_WINDOWS = 40, 6
WINDOW_SAMPLES, LEAST_WINDOW_SAMPLES = 60, 20  # samples of a window
LEAST_SIGMA = 0.01  # of a channel's spread: assumed noise of a noiseless channel
FIRST_STAGE_SAMPLES = 6  # of the shortest windows of a fit by stages, at least
STEPS = 30
SETTLED_GAIN = 1e-5  # relative gain of a step
EXACT = 0.01  # smallest error that counts, as a share of the motion
INDEPENDENT = 12.0  # effective number of independent windows
RUNAWAY = 1e6  # error as a share of the motion: no more is counted
LEAST_NOISES = 5.0  # smallest motion, in noises
USUAL_ERROR = 0.2  # of the motion of a channel: a recording that suits its rig leaves no more
# standard deviations of the strain above its mean, of a recording that suits its rig
USUAL_DEVIATIONS = 4.0
FURTHEST = 300.0  # largest logarithm of a factor on the data sheet, beyond any bound


@dataclass(frozen=True, eq=False)
class FitPoint:
    """Scaled parameters s and states x at the windows' starts (windows x states), with their cost.

    The start states are eliminated from half the Hessian and the gradient in s; their steps follow
    from the remaining fields. left: weighted residuals, windows x samples x channels, infinite if
    the model diverges; linearised: True with derivatives.
    """

    s: Array
    x: Array
    cost: float
    H: Array
    g: Array
    gains: Array  # windows x states x parameters: derivatives of the start states by s
    start_steps: Array  # windows x states: steps of the start states at constant s
    left: Array
    linearised: bool = True

    @cached_property
    def errors(self) -> Array:
        """Mean squares of the weighted residuals, windows x channels."""
        return np.asarray((self.left**2).mean(axis=1))


@dataclass(frozen=True)
class Judgement:
    """Quality of a short fit.

    errors      root mean square error of each channel, as a share of its motion
    strain      sum of squares of the parameters' distances from the data sheet, in prior spreads
    determined  number of parameters that the data determine against their priors: the mean of the
                strain if the priors hold
    """

    errors: dict[str, float]
    strain: float = 0.0
    determined: float = 0.0
    problem: ShortFit | None = field(default=None, compare=False, repr=False)

    @property
    def score(self) -> float:
        """Lower for a better fit, in the unit of a log likelihood."""
        logs = [math.log(min(max(e, EXACT), RUNAWAY)) for e in self.errors.values()]
        return INDEPENDENT * sum(logs) + 0.5 * self.strain

    @property
    def suspicious(self) -> bool:
        # a chi-squared distribution has a variance of twice its mean
        usual = self.determined + USUAL_DEVIATIONS * math.sqrt(2.0 * self.determined)
        return max(self.errors.values(), default=0.0) > USUAL_ERROR or self.strain > usual

    def smallest_error(self, columns: Sequence[str]) -> float:
        """Smallest error of these outputs, or of any if none is named."""
        errors = [self.errors[c] for c in columns if c in self.errors] or [*self.errors.values()]
        return min(errors, default=RUNAWAY)

    def error_ratio(self, other: Judgement) -> float:
        """Errors over those of another judgement, all channels together."""
        logs = [
            math.log(max(e, EXACT) / max(other.errors[c], EXACT)) for c, e in self.errors.items()
        ]
        return math.exp(sum(logs))


@dataclass(frozen=True, eq=False)
class FittedWindows:
    """Result of a fit with the inputs of `rig`."""

    rig: Rig
    point: FitPoint
    problem: ShortFit

    @property
    def error(self) -> float:
        return float(np.sqrt(self.point.errors.mean()))

    @cached_property
    def judgement(self) -> Judgement:
        data, s, H = self.problem.trial, self.point.s, self.point.H
        errors = np.sqrt(self.point.errors.mean(axis=0)) / data.weight / data.motions
        errors = np.where(np.isfinite(errors), errors, RUNAWAY)
        return Judgement(
            dict(zip(data.names, errors.tolist(), strict=True)),
            strain=float(s @ s),
            determined=float(len(H) - np.trace(np.linalg.pinv(H))),
            problem=self.problem,
        )


@dataclass(frozen=True, eq=False)
class FitData:
    """Windows, weights and free parameters of a recording, shared by both fits."""

    rig: Rig
    names: tuple[str, ...]
    track: Track
    windows: tuple[Window, ...]
    weight: Array

    def fitted(
        self,
        rig: Rig,
        begin: FitPoint | None = None,
        problem: ShortFit | None = None,
        stepping: Stepping | None = None,
        steps: int = STEPS,
        restart: bool = False,
    ) -> FittedWindows:
        """Fit a rig to the data.

        begin: start point; by default the data sheet. problem: earlier fit of the same rig, whose
        model is compiled already. stepping: stepping of a fit that only differs in its inputs.
        restart: while the fit is poor, also start from the states that the readings show, by
        stages. A fit that took no step, or that has parameters of zero, starts there in any case.
        """
        problem = problem.with_data(self) if problem else ShortFit.of(self, rig, stepping)
        start = problem.sheet() if begin is None else problem.at(begin.s, begin.x)
        best = FittedWindows(rig, problem.minimum(start, steps), problem)
        restarts = restart or problem.unset.any() or not best.point.s.any()
        # from where the data sheet's run has gone, or from an inertia of zero, no step may lead to
        # what was measured
        if begin is not None or not restarts:
            return best
        reach = problem.minimum_by_stages if restart else problem.minimum
        read: FitPoint | None = None
        further = [np.zeros(len(problem.unset)), problem.unset.astype(float)]
        for s in further[: 1 + problem.unset.any()]:
            if max(best.judgement.errors.values()) > USUAL_ERROR:
                read = problem.at(s, read.x) if read else problem.readings(s)
                fit = FittedWindows(rig, reach(read, steps), problem)
                best = min(best, fit, key=lambda fit: fit.judgement.score)
        return best

    def shifted(self, columns: Iterable[str], rows: int) -> FitData:
        """The data with these channels later by a number of rows; the rows at the end that nothing
        fills keep the last value there."""
        table, places = self.track.y.copy(), [self.names.index(name) for name in columns]
        rows_from = np.clip(np.arange(len(table)) - rows, 0, len(table) - 1)
        table[:, places] = table[rows_from][:, places]
        return replace(self, track=replace(self.track, y=table))

    @cached_property
    def motions(self) -> Array:
        """Per channel: root mean square of the motion within the windows, at least the noise.

        Level and trend are left out, because a separate start state produces both.
        """
        y, length = self.track.y, self.windows[0].stop - self.windows[0].start
        parts = np.concatenate([y[w.start : w.stop] for w in self.windows])
        return np.maximum(
            np.sqrt((shapes(parts, length) ** 2).mean(axis=(1, 2))),
            np.maximum(LEAST_NOISES * noise_level(y), 1e-12 * np.abs(y).max(axis=0)),
        )


def fit_data_of(recording: Recording, rig: Rig, timescales: float = 0.0) -> FitData | None:
    """Windows of a recording to fit; None if it is too short, or if nothing moves.

    timescales: length of a window in correlation times of the recording. A window has at least
    WINDOW_SAMPLES; longer windows are fewer.
    """
    data = data_of(rig, recording)
    names = tuple(n for n in data.measured(rig) if motion(data.values[n]) > 0.0)
    if not names:
        return None
    assembly = Assembly(rig, outputs=names)
    track = track_of(assembly, data, names, timescale_s=rig.timescale_s or 1.0)
    slow = track_of(assembly, data, names).timescale_s if timescales else 0.0
    windows = _windows(track, max(WINDOW_SAMPLES, round(timescales * slow / track.period_s)))
    if len(windows) < FEWEST_WINDOWS:
        return None
    noise = noise_of((track,), stated_noise(rig, names))
    weight = 1.0 / np.maximum(noise, LEAST_SIGMA * track.y.std(axis=0))
    return FitData(rig, names, track, windows, weight)


def _windows(track: Track, length: int) -> tuple[Window, ...]:
    """Windows with the largest changes of inputs from sample to sample."""
    most = max(FEWEST_WINDOWS, COMPARED_WINDOWS * WINDOW_SAMPLES // length)
    length = min(length, len(track) // FEWEST_WINDOWS)
    if length < LEAST_WINDOW_SAMPLES:
        return ()
    count = len(track) // length
    moves = np.abs(np.diff(track.u, axis=0, prepend=track.u[:1]))
    size = moves.mean(axis=0)
    moved = (moves / np.where(size > 0.0, size, 1.0)).sum(axis=1)
    busy = moved[: count * length].reshape(count, length).sum(axis=1)
    chosen = np.sort(np.argsort(-busy, kind="stable")[:most])
    return tuple(Window(int(k) * length, int(k + 1) * length) for k in chosen)


@dataclass(frozen=True, eq=False)
class ShortFit(LeastSquares[FitPoint, Array]):
    """Damped Gauss-Newton fit of the parameters and the start states of the windows."""

    trial: FitData
    runner: Runner
    rule = DampingRule(1e-3, falls=0.2, least=1e-9, rises=10.0, most=1e8)

    @classmethod
    def of(cls, trial: FitData, rig: Rig, stepping: Stepping | None = None) -> ShortFit:
        a = Assembly(rig, outputs=trial.names).for_fitting()
        t = trial.track
        step = stepping or choose_stepping(a, t.u, t.p, t.period_s, a.start(t.p))
        free = tuple(
            i
            for i, b in enumerate(a.parameters)
            if b.fitted and i not in t.known and np.isfinite(b.spread) and b.spread > 0.0
        )
        return cls(trial, Runner(a, t, step, free).keeping())

    def with_data(self, trial: FitData) -> ShortFit:
        """The same model with other measurements or weights.

        Slopes of a stepped rig along the windows are reused while they are valid.
        """
        return replace(self, trial=trial, runner=replace(self.runner, track=trial.track))

    def matches_data(self, trial: FitData) -> bool:
        """True if the model belongs to these data, with the same inputs and data sheet."""
        ours, theirs = self.trial, trial
        return (
            ours.rig is theirs.rig
            and ours.names == theirs.names
            and ours.track.period_s == theirs.track.period_s
            and ours.track.first == theirs.track.first
            and ours.track.known == theirs.track.known
            and np.array_equal(ours.track.u, theirs.track.u)
            and np.array_equal(ours.track.p, theirs.track.p)
        )

    @property
    def unset(self) -> NDArray[np.bool_]:
        """Free parameters that are zero in the data sheet, at the end of their range: an inertia
        that nobody has measured."""
        bounds = [self.runner.assembly.parameters[i] for i in self.runner.free]
        values = self.trial.track.p[list(self.runner.free)]
        return np.array(
            [v == b.low == 0.0 for v, b in zip(values, bounds, strict=True)], dtype=bool
        )

    def sheet(self) -> FitPoint:
        """Parameters of the data sheet, and the states of its run."""
        s = np.zeros(len(self.runner.free))
        return self.at(s, self._run_states(s))

    def readings(self, s: Array) -> FitPoint:
        """Scaled parameters s, and the states that the readings show."""
        p, x = self.parameters(s)[0], self._run_states(s)
        fresh, rest = self.runner.memory(p), self.runner.assembly.start(p)[: x.shape[1]]
        for k, window in enumerate(self.trial.windows):
            opening = Window(window.start, min(window.start + OPENING_SAMPLES, window.stop))
            # no step leads back from a state of a run that has left the recording
            starts = [
                WindowStart.of(self.runner, fresh.copy(), opening, p, self.trial.weight, carried)
                for carried in (x[k], rest)
            ]
            reached = [start.at(start.from_readings()) for start in starts]
            x[k] = min(reached, key=lambda point: point.cost).x
        return self.at(s, x)

    def minimum(self, start: FitPoint, steps: int) -> FitPoint:
        return iterate(self, Iteration(start, self.rule.start), steps).point

    def minimum_by_stages(self, point: FitPoint, steps: int) -> FitPoint:
        """Minimum that is reached with windows whose length doubles.

        Over a few samples the readings hold an arm whose data sheet is far off; over a whole window
        its error is beyond any linear prediction.
        """
        whole = self.trial.windows
        length = whole[0].stop - whole[0].start
        stages = range(int(np.log2(length / FIRST_STAGE_SAMPLES)), -1, -1)
        for halvings in stages:
            windows = tuple(Window(w.start, w.start + (length >> halvings)) for w in whole)
            stage = self.with_data(replace(self.trial, windows=windows))
            point = stage.minimum(stage.at(point.s, point.x), steps)
        return point

    def _run_states(self, s: Array) -> Array:
        """States at the windows' starts, of a run with parameters s."""
        a, t = self.runner.assembly, self.trial.track
        n, p = self.runner.start_states, self.parameters(s)[0]
        program = a.program_with({f"state.{s.name}": symbol("state", s.name) for s in a.rig.states})
        memory = program.memory(a.start(p), stepping=self.runner.stepping, period_s=t.period_s)
        Y, _, _ = program.run(memory, t.inputs, p, stepping=self.runner.stepping)
        led = Y[[w.start for w in self.trial.windows]][:, Y.shape[1] - n :]
        return np.where(np.isfinite(led), led, a.start(p)[:n])

    def parameters(self, s: Array) -> tuple[Array, Array]:
        """Values (SI) at scaled parameters s, within their bounds, and their slopes by s.

        The slopes at a bound are included, so that a fit can leave the bound again.
        """
        p, slopes = self.trial.track.p.copy(), np.zeros(len(s))
        for k, (i, scaled) in enumerate(zip(self.runner.free, s, strict=True)):
            b = self.runner.assembly.parameters[i]
            by = float(np.clip(b.spread * scaled, -FURTHEST, FURTHEST)) if b.log else 0.0
            value = p[i] * np.exp(by) if b.log else p[i] + b.spread * scaled
            p[i] = min(max(value, min(b.low, p[i])), max(b.high, p[i]))
            slopes[k] = b.spread * p[i] if b.log else b.spread
        return p, slopes

    def at(self, s: Array, x: Array, derivatives: bool = True) -> FitPoint:
        """Point of scaled parameters s and start states x; its cost is infinite if the model
        diverges."""
        trial, m = self.trial, len(s)
        n, length = self.runner.start_states, trial.windows[0].stop - trial.windows[0].start
        p, slopes = self.parameters(s)
        fresh = self.runner.memory(p)
        H, g = np.eye(m), s.copy()
        cost = float(s @ s)
        gains, start_steps = np.zeros((len(x), n, m)), np.zeros((len(x), n))
        left = np.full((len(x), length, len(trial.names)), np.inf)
        for k, window in enumerate(trial.windows):
            memory = fresh.copy()
            self.runner.enter(memory, x[k])
            Y, J, fine = self.runner.run(memory, window, p, derivatives, trial.weight)
            if not fine or derivatives and not np.isfinite(J).all():
                return FitPoint(s, x, np.inf, H, g, gains, start_steps, np.full_like(left, np.inf))
            left[k] = (Y - trial.track.y[window.start : window.stop]) * trial.weight
            r = left[k].ravel()
            cost += float(r @ r)
            if not derivatives:
                continue
            A, B = J[:, :m] * slopes, J[:, m : m + n]
            # pseudo-inverse of B'B with scaled columns
            inner = B.T @ B
            scale = np.sqrt(inner.diagonal())
            scale[scale == 0.0] = 1.0
            sizes = np.outer(scale, scale)
            solve = np.linalg.pinv(inner / sizes, rcond=1e-12) / sizes
            gains[k], start_steps[k] = -solve @ (B.T @ A), -solve @ (B.T @ r)
            H += A.T @ A + A.T @ B @ gains[k]
            g += A.T @ r + A.T @ B @ start_steps[k]
        return FitPoint(s, x, cost, H, g, gains, start_steps, left, derivatives)

    def step(self, at: FitPoint, damping: float) -> Array | None:
        if not np.isfinite(at.cost):
            return None
        scale = np.maximum(at.H.diagonal(), 1.0)
        s = np.linalg.lstsq(at.H + np.diag(damping * scale), -at.g, rcond=None)[0]
        x = at.start_steps + at.gains @ s
        return np.concatenate([s, x.ravel()])

    def moved(self, at: FitPoint, step: Array, last: bool) -> FitPoint:
        m = len(at.s)
        reach = np.empty((2, m))  # lowest and highest scaled parameters
        for k, i in enumerate(self.runner.free):
            b, value = self.runner.assembly.parameters[i], float(self.trial.track.p[i])
            ends = np.array([min(b.low, value), max(b.high, value)])
            with np.errstate(divide="ignore"):
                ends = np.log(ends / value) if b.log else ends - value
            reach[:, k] = ends / b.spread
        s = np.clip(at.s + step[:m], *reach)
        # derivatives cost many times as much as a run, and most of the steps from an unsuitable
        # data sheet are rejected
        return self.at(s, at.x + step[m:].reshape(at.x.shape), derivatives=False)

    def linearised(self, at: FitPoint, last: bool) -> FitPoint:
        return at if at.linearised else self.at(at.s, at.x)

    def settled(self, gain: float, before: FitPoint, after: FitPoint) -> bool:
        return gain < SETTLED_GAIN * after.cost
