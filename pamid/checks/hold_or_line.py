"""Is an input held between samples, or does it lead in a straight line to the next one?

Both are tried: a short fit of the rig's parameters and of a start state for each of some windows,
with the input the one way and the other, everything else alike. What a hold and a straight line
differ by is half a sample of delay and what lies between samples; a parameter cannot make up for
it where the rig answers within few samples, and then the error says which one is right. A delay
of half a sample that the rig does not have looks alike.

    cost        sum over windows |W (y(x_w, p) - y_measured)|^2 + |(p - p_sheet)/spread|^2
    W           1/sigma per channel, sigma its noise and at least LEAST_SIGMA of its spread
    better      an error at most BETTER times the other's, smaller in SURE of the windows

The start states are eliminated window by window (variable projection by block elimination: Golub,
Pereyra 2003, Inverse Problems 19, R1-R26).

Where only a way that is taken wrongly is of interest (`wrongly_taken`), two fits per input are
mostly in vain. With an input the other way the outputs change by d at the fitted parameters, which
is one run; what the error becomes once everything has followed is to first order

    min over (p, x_w) of  |W (r + d + A dp + B dx_w)|^2 + |(p + dp - p_sheet)/spread|^2

(r, A, B: residuals and derivatives of the fit). Only an input by which this falls is tried.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import PamidError
from pamid.base.metrics import motion
from pamid.base.units import NONE, split_column, to_si
from pamid.engine.damped_gauss_newton import DampingRule, Iteration, LeastSquares, iterate
from pamid.engine.program import Memory, Program, Stepping
from pamid.model.assembly import Assembly
from pamid.model.between_samples import HELD, LINEAR, between_of, other, stated
from pamid.model.rig import Rig
from pamid.model.step_rig import StepRig
from pamid.recording.recording import Recording, match_column
from pamid.simulation.free_runs import choose_stepping, measured_outputs
from pamid.simulation.tracks import Track, noise_of, stated_noise, track_of
from pamid.simulation.windows import Runner, Window
from pamid.symbolic.expression import symbol

Array = NDArray[np.float64]

COMPARED_WINDOWS, FEWEST_WINDOWS = 40, 6
WINDOW_SAMPLES, LEAST_WINDOW_SAMPLES = 60, 20  # samples of a window
LEAST_SIGMA = 0.01  # of a channel's spread: the weight of one without noise
STEPS = 30
BETTER, SURE = 0.9, 0.7
# of the error, to first order: below it an input is tried; half way to BETTER, for what fits gain
# beyond the first order
MAYBE_BETTER = 0.95
SETTLED_GAIN = 1e-5  # relative gain of a step


@dataclass(frozen=True)
class HoldOrLine:
    """One input tried both ways.

    taken      "held" or "linear", as the rig or the recording states it; stated: whether it does
    better     the way that fits clearly better, "" where neither does
    channel    the output that shows it most; held, linear: its root mean square error over the
               windows, in its unit; windows: how many
    """

    column: str
    taken: str
    stated: bool
    better: str
    channel: str
    held: float
    linear: float
    windows: int

    @property
    def wrong(self) -> bool:
        """Does the other way than the one that is taken fit clearly better?"""
        return self.better not in ("", self.taken)

    def text(self, recording: Recording) -> str:
        """What was found, and what to write where."""
        unit = split_column(self.channel)[1]
        unit = "" if unit == NONE else f" {unit}"
        by = {HELD: self.held, LINEAR: self.linear}
        way, rest = (self.better or self.taken), other(self.better or self.taken)
        said = {HELD: "held between samples", LINEAR: "linear between samples"}
        figures = (
            f"{self.channel} {by[way]:.3g}{unit} RMS against {by[rest]:.3g} {rest}, over "
            f"{self.windows} windows"
        )
        if not self.better:
            return (
                f"{self.column} is taken as {said[self.taken]}; this recording does not tell "
                f"({figures})"
            )
        if not self.wrong:
            return f"{self.column} is {said[self.taken]}, which fits better ({figures})"
        own = match_column(recording.columns, self.column)
        return (
            f"{self.column} is taken as {said[self.taken]}, but {self.better} fits clearly better: "
            f'{figures}. Write between = {{"{self.column}": "{self.better}"}} into the rig file, '
            f'or [between] {own} = "{self.better}" into '
            f"{recording.path.with_suffix('.toml').name}"
        )


def tried_both_ways(
    recording: Recording, rig: Rig, columns: Iterable[str] | None = None
) -> list[HoldOrLine]:
    """The recording's inputs (of these, if they are named) held and linear; none where the rig
    cannot be run on it, or steps by itself once a sample, so that both are the same to it. A
    command that a controller sends is held, and is not tried.

    rig: with what the recording states (`as_recorded`).
    """
    return _both_ways(recording, rig, columns, screened=False)


def short_fit_errors(recording: Recording, rig: Rig) -> Array | None:
    """Per measured output that moves: root mean square error of a short refit, in its weights (one
    over noise); None where the rig cannot be fitted."""
    try:
        trial = _trial_of(recording, rig)
        return None if trial is None else np.sqrt(trial.fitted(rig).point.errors.mean(axis=0))
    except (PamidError, FloatingPointError, np.linalg.LinAlgError):
        return None


def _both_ways(
    recording: Recording, rig: Rig, columns: Iterable[str] | None, screened: bool
) -> list[HoldOrLine]:
    try:
        trial = _trial_of(recording, rig)
        names = _open_inputs(recording, rig, rig.inputs if columns is None else columns)
        if trial is None or not names:
            return []
        problem = _ShortFit.of(trial, trial.rig)
        # what steps by itself is told its inputs at the begin of a step: one step a sample, and
        # both ways are one
        if isinstance(rig, StepRig) and problem.runner.stepping.substeps == 1:
            return []
        return _tried(trial, names, problem, screened)
    except (PamidError, FloatingPointError, np.linalg.LinAlgError):
        return []


def wrongly_taken(
    recording: Recording, rig: Rig, columns: Iterable[str] | None = None
) -> list[HoldOrLine]:
    """Of `tried_both_ways` those inputs that fit clearly better the other way, at a fraction of its
    cost: an input is tried where to first order it may be one."""
    return [one for one in _both_ways(recording, rig, columns, screened=True) if one.wrong]


def unstated(rig: Rig) -> list[str]:
    """Inputs of which neither rig nor recording says what they do between samples."""
    return [column for column in rig.inputs if column not in rig.between]


def _open_inputs(recording: Recording, rig: Rig, columns: Iterable[str]) -> list[str]:
    sent = {loop.command for loop in rig.loops}
    return [
        c
        for c in columns
        if c not in sent and recording.has(c) and motion(recording.signal(c)) > 0.0
    ]


def _tried(
    trial: _TriedOn, names: list[str], problem: _ShortFit, screened: bool
) -> list[HoldOrLine]:
    """Every input the other way, or those that are worth it; where several fit better so, the best
    first and the others beside it."""
    found: dict[str, HoldOrLine] = {}
    base = trial.fitted(trial.rig, problem=problem)
    if not np.isfinite(base.error):
        return []  # the model runs away either way
    while True:
        left = [c for c in names if c not in found]
        worth = trial.worth_trying(base, left) if screened else left
        tried = {c: trial.compared(base, c) for c in worth}
        # where it runs away the other way there is nothing to compare
        tried = {c: t for c, t in tried.items() if np.isfinite([t[0].held, t[0].linear]).all()}
        wrong = [c for c, (one, _) in tried.items() if one.wrong]
        if len(wrong) < 2:
            found |= {c: one for c, (one, _) in tried.items()}
            return [found[c] for c in names if c in found]
        best = min(wrong, key=lambda c: tried[c][1].error)
        found[best], base = tried[best]


# ---- a short fit ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Point:
    """Scaled parameters s and states x at the windows' starts (windows x states); cost, half its
    Hessian and gradient in s with the states eliminated, and what gives their steps; errors:
    squared weighted residuals, windows x channels."""

    s: Array
    x: Array
    cost: float
    H: Array
    g: Array
    gains: Array  # windows x states x parameters: how the start states follow s
    own: Array  # windows x states: their steps where s stays
    errors: Array


@dataclass(frozen=True, eq=False)
class _Fitted:
    """A fit with the inputs of `rig` as they are there."""

    rig: Rig
    point: _Point
    problem: _ShortFit

    @property
    def error(self) -> float:
        return float(np.sqrt(self.point.errors.mean()))


@dataclass(frozen=True, eq=False)
class _TriedOn:
    """What both fits share: the recording's windows, weights and free parameters."""

    rig: Rig
    names: tuple[str, ...]
    track: Track
    windows: tuple[Window, ...]
    weight: Array

    def fitted(
        self,
        rig: Rig,
        begin: _Point | None = None,
        problem: _ShortFit | None = None,
        stepping: Stepping | None = None,
    ) -> _Fitted:
        """problem: of a fit of the same rig before, whose model is there already; stepping: of a
        fit that differs in its inputs alone."""
        problem = problem or _ShortFit.of(self, rig, stepping)
        start = problem.sheet() if begin is None else problem.at(begin.s, begin.x)
        point = iterate(problem, Iteration(start, problem.rule.start), STEPS).point
        return _Fitted(rig, point, problem)

    def compared(self, base: _Fitted, column: str) -> tuple[HoldOrLine, _Fitted]:
        """The input the one way and the other, each from where the other one led as well."""
        taken = between_of(base.rig, column)
        other_way = stated(base.rig, {column: other(taken)})
        stepping = base.problem.runner.stepping
        turned = self.fitted(other_way, base.point, stepping=stepping)
        again = self.fitted(base.rig, turned.point, base.problem)
        here = again if again.error < base.error else base
        # an exact fit and one that runs away have no logarithm
        logs = [
            np.log(np.clip(fit.point.errors.mean(axis=0), 1e-300, 1e300)) for fit in (turned, here)
        ]
        shows = int(np.argmax(np.abs(logs[0] - logs[1])))
        both = {taken: here, other(taken): turned}
        rms = {way: self._rms(one, shows) for way, one in both.items()}
        better = next((way for way in both if _clear(both[way], both[other(way)])), "")
        return (
            HoldOrLine(
                column,
                taken,
                column in base.rig.between,
                better,
                self.names[shows],
                rms[HELD],
                rms[LINEAR],
                len(self.windows),
            ),
            turned,
        )

    def worth_trying(self, base: _Fitted, columns: list[str]) -> list[str]:
        """Those of these inputs by which the error of the fit would to first order fall, were they
        the other way."""
        # one model serves all: in it an input that does not rise over a sample is held
        moving = stated(base.rig, dict.fromkeys(columns, LINEAR))
        program = Assembly(moving, outputs=self.names).for_fitting().program
        if not columns or not isinstance(program, Program):
            return columns
        inputs, moves = program.inputs, [program.inputs[i] for i in program.linear]
        rises = np.diff(self.track.u, axis=0, append=self.track.u[-1:])
        ways = [{c: between_of(base.rig, c) for c in moves}]
        ways += [ways[0] | {c: other(ways[0][c])} for c in columns]
        told = [
            np.column_stack(
                [self.track.u, *(rises[:, inputs.index(c)] * (way[c] == LINEAR) for c in moves)]
            )
            for way in ways
        ]
        reached = base.problem.reached(base.point, program, told)
        return [
            c
            for c, error in zip(columns, reached[1:], strict=True)
            if not error > MAYBE_BETTER * reached[0]
        ]

    def _rms(self, one: _Fitted, channel: int) -> float:
        symbol_ = split_column(self.names[channel])[1]
        mean = float(np.sqrt(one.point.errors[:, channel].mean())) / self.weight[channel]
        return mean / float(to_si(1.0, symbol_) - to_si(0.0, symbol_))


def _clear(one: _Fitted, rest: _Fitted) -> bool:
    """Does one fit clearly better than the other?"""
    if not np.isfinite(one.error) or one.error > BETTER * rest.error:
        return False
    smaller = one.point.errors.sum(axis=1) < rest.point.errors.sum(axis=1)
    return float(smaller.mean()) >= SURE


def _trial_of(recording: Recording, rig: Rig) -> _TriedOn | None:
    names = measured_outputs(Assembly(rig), recording)
    names = tuple(n for n in names if motion(recording.signal(n)) > 0.0)
    if not names:
        return None
    assembly = Assembly(rig, outputs=names)
    track = track_of(assembly, recording, names, timescale_s=rig.timescale_s or 1.0)
    windows = _windows(track)
    if len(windows) < FEWEST_WINDOWS:
        return None
    noise = noise_of((track,), stated_noise(rig, names))
    weight = 1.0 / np.maximum(noise, LEAST_SIGMA * track.y.std(axis=0))
    return _TriedOn(rig, names, track, windows, weight)


def _windows(track: Track) -> tuple[Window, ...]:
    """The windows in which inputs change most from sample to sample."""
    length = min(WINDOW_SAMPLES, len(track) // FEWEST_WINDOWS)
    if length < LEAST_WINDOW_SAMPLES:
        return ()
    count = len(track) // length
    moves = np.abs(np.diff(track.u, axis=0, prepend=track.u[:1]))
    size = moves.mean(axis=0)
    moved = (moves / np.where(size > 0.0, size, 1.0)).sum(axis=1)
    busy = moved[: count * length].reshape(count, length).sum(axis=1)
    chosen = np.sort(np.argsort(-busy, kind="stable")[:COMPARED_WINDOWS])
    return tuple(Window(int(k) * length, int(k + 1) * length) for k in chosen)


@dataclass(frozen=True, eq=False)
class _ShortFit(LeastSquares[_Point, Array]):
    """Parameters and start states of the windows by damped Gauss-Newton."""

    trial: _TriedOn
    runner: Runner
    rule = DampingRule(1e-3, falls=0.2, least=1e-9, rises=10.0, most=1e8)

    @classmethod
    def of(cls, trial: _TriedOn, rig: Rig, stepping: Stepping | None = None) -> _ShortFit:
        a = Assembly(rig, outputs=trial.names).for_fitting()
        t = trial.track
        step = stepping or choose_stepping(a, t.u, t.p, t.period_s, a.start(t.p))
        free = tuple(
            i
            for i, b in enumerate(a.parameters)
            if b.fitted and i not in t.known and np.isfinite(b.spread) and b.spread > 0.0
        )
        return cls(trial, Runner(a, t, step, free))

    def sheet(self) -> _Point:
        """The data sheet's parameters, and the states to which its run leads."""
        a, t = self.runner.assembly, self.trial.track
        n = self.runner.start_states
        program = a.program_with({f"state.{s.name}": symbol("state", s.name) for s in a.rig.states})
        memory = program.memory(a.start(t.p), stepping=self.runner.stepping, period_s=t.period_s)
        Y, _, _ = program.run(memory, t.u, t.p, period_s=t.period_s, stepping=self.runner.stepping)
        led = Y[[w.start for w in self.trial.windows]][:, Y.shape[1] - n :]
        x = np.where(np.isfinite(led), led, a.start(t.p)[:n])
        return self.at(np.zeros(len(self.runner.free)), x)

    def parameters(self, s: Array) -> tuple[Array, Array]:
        """Values (SI) at scaled parameters s, within their bounds, and their slopes by s."""
        p, slopes = self.trial.track.p.copy(), np.zeros(len(s))
        for k, (i, scaled) in enumerate(zip(self.runner.free, s, strict=True)):
            b = self.runner.assembly.parameters[i]
            value = p[i] * np.exp(b.spread * scaled) if b.log else p[i] + b.spread * scaled
            p[i] = min(max(value, b.low), b.high)
            inside = p[i] == value
            slopes[k] = (b.spread * p[i] if b.log else b.spread) if inside else 0.0
        return p, slopes

    def at(self, s: Array, x: Array) -> _Point:
        trial, m = self.trial, len(s)
        n, channels = self.runner.start_states, len(trial.names)
        p, slopes = self.parameters(s)
        fresh = self.runner.memory(p)
        H, g = np.eye(m), s.copy()
        cost = float(s @ s)
        gains, own = np.zeros((len(x), n, m)), np.zeros((len(x), n))
        errors = np.zeros((len(x), channels))
        for k, window in enumerate(trial.windows):
            rows = self._rows(fresh.copy(), window, x[k], p, slopes)
            if rows is None:
                return _Point(s, x, np.inf, H, g, gains, own, np.full_like(errors, np.inf))
            A, B, r = rows
            solve = _solving(B)
            gains[k], own[k] = -solve @ (B.T @ A), -solve @ (B.T @ r)
            H += A.T @ A + A.T @ B @ gains[k]
            g += A.T @ r + A.T @ B @ own[k]
            errors[k] = (r.reshape(-1, channels) ** 2).mean(axis=0)
            cost += float(r @ r)
        return _Point(s, x, cost, H, g, gains, own, errors)

    def _rows(
        self, memory: Memory, window: Window, x: Array, p: Array, slopes: Array
    ) -> tuple[Array, Array, Array] | None:
        """Of one window derivatives by parameters and by its start, and residuals, weighted; None
        where the model runs away."""
        m, n, weight = len(slopes), self.runner.start_states, self.trial.weight
        self.runner.enter(memory, x)
        Y, J, fine = self.runner.run(memory, window, p, True, weight)
        if not fine or not np.isfinite(J).all():
            return None
        left = (Y - self.trial.track.y[window.start : window.stop]) * weight
        return J[:, :m] * slopes, J[:, m : m + n], left.ravel()

    def reached(self, at: _Point, program: Program, told: list[Array]) -> Array:
        """Root mean square errors, one per way of telling `program` the inputs, once parameters and
        start states have followed to first order. told: inputs of the track with their rises; the
        first as here."""
        runner, t = self.runner, self.trial.track
        p, slopes = self.parameters(at.s)
        fresh, begun = runner.memory(p), runner.assembly.start(p)
        plain = program.memory(begun, stepping=runner.stepping, period_s=t.period_s)
        H, g = np.eye(len(at.s)), np.tile(at.s[:, None], len(told))
        reduced = []
        for window, x in zip(self.trial.windows, at.x, strict=True):
            rows = self._rows(fresh.copy(), window, x, p, slopes)
            if rows is None:
                return np.full(len(told), np.nan)
            A, B, r = rows
            seen = []
            for u in told:
                memory = plain.copy()
                memory.x[: len(x)], memory.join = x, True
                Y, _, _ = program.run(
                    memory,
                    u[window.start : window.stop],
                    p,
                    period_s=t.period_s,
                    time_s=(t.first + window.start) * t.period_s,
                    stepping=runner.stepping,
                )
                seen.append((Y * self.trial.weight).ravel())
            changed = r[:, None] + np.column_stack([y - seen[0] for y in seen])
            both = np.column_stack([A, changed])
            both -= B @ (_solving(B) @ (B.T @ both))
            A, changed = both[:, : len(at.s)], both[:, len(at.s) :]
            H += A.T @ A
            g += A.T @ changed
            reduced.append((A, changed))
        if not np.isfinite(g).all():  # run away with one of them
            return np.full(len(told), np.nan)
        step = -np.linalg.lstsq(H, g, rcond=None)[0]
        left = [np.mean((changed + A @ step) ** 2, axis=0) for A, changed in reduced]
        return np.asarray(np.sqrt(np.mean(left, axis=0)))

    def step(self, at: _Point, damping: float) -> Array | None:
        if not np.isfinite(at.cost):
            return None
        scale = np.maximum(at.H.diagonal(), 1.0)
        s = np.linalg.lstsq(at.H + np.diag(damping * scale), -at.g, rcond=None)[0]
        x = at.own + at.gains @ s
        return np.concatenate([s, x.ravel()])

    def moved(self, at: _Point, step: Array, last: bool) -> _Point:
        m = len(at.s)
        return self.at(at.s + step[:m], at.x + step[m:].reshape(at.x.shape))

    def settled(self, gain: float, before: _Point, after: _Point) -> bool:
        return gain < SETTLED_GAIN * after.cost


def _solving(B: Array) -> Array:
    """The pseudo-inverse of B'B, its columns scaled."""
    inner = B.T @ B
    scale = np.sqrt(inner.diagonal())
    scale[scale == 0.0] = 1.0
    root = np.linalg.pinv(inner / np.outer(scale, scale), rcond=1e-12)
    return np.asarray(root / np.outer(scale, scale))


def figures(found: Sequence[HoldOrLine]) -> list[dict[str, object]]:
    """The same as plain data."""
    return [
        {
            "column": one.column,
            "taken": one.taken,
            "stated": one.stated,
            "better": one.better,
            "channel": one.channel,
            "rms_held": one.held,
            "rms_linear": one.linear,
            "windows": one.windows,
        }
        for one in found
    ]
