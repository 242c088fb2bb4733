"""A model with latent values at some of its ports, smoothed together with its states over held-out recordings.

At every place of a port an unknown value is added that wanders as an Ornstein-Uhlenbeck process (a Matern-1/2 Gaussian
process in time). States and value are found together, slice by slice, by Gauss-Newton on a block-tridiagonal system:
the Kalman smoother of the linearised model, with its Laplace evidence. After Rogers and Friis (2022), Vibration 3, and
Engelhardt, Froehlich and Kschischo (2016), Sci. Rep. 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pamid.assembly import Assembly
from pamid.attaching import Attachment
from pamid.diagnosis.contest import Contender, transferred
from pamid.effect import Effect, State
from pamid.engine.blocks import eliminate
from pamid.equations import Expr, Number
from pamid.evidence import Evidence
from pamid.residuals import Replay
from pamid.windows import Runner, Window, cut

Array = NDArray[np.float64]

SLICE_S = 0.05              # length of the slices over which the value is constant
ROUNDS = 12                 # Gauss-Newton steps at most, damped as the ground demands
CALM = 1e-3                 # of the cost: a gain below it ends them
LEAST_DAMPING = 1e-10       # of a diagonal scaled to one
STIFF = 1e-4                # standard deviation of a state's jump between slices, in standard deviations of the state
FREE = 1e3                  # ... of its jump where a window begins
SIZES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)   # standard deviations tried, in sizes of the port's value
TIMES_S = (0.1, 1.0)        # time constants tried


class Latent(Effect):
    """A value that is simply missing: it wanders and is not explained. Sizes are those of the port's value."""

    name = "latent"
    family = "latent"
    kinds = ()
    states = (State("missing"),)

    def __init__(self, size: float) -> None:
        self.size = size

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> tuple[Number, dict[str, Number]]:
        return value + self.size * z.missing, {"missing": 0.0}


@dataclass(frozen=True, eq=False)
class Smoother:
    """The model of `base` with latent values at `ports`, linearised about its best path over one held-out replay."""

    evidence: Evidence
    base: Contender
    ports: tuple[str, ...]
    along: Smoother | None = None       # one without latent values, whose path is where this one starts

    @cached_property
    def assembly(self) -> Assembly:
        b, rig = self.base.assembly, self.evidence.rig
        added = tuple(Attachment(Latent(size_at(b, port)), (port,), f"latent.{port}") for port in self.ports)
        return Assembly(rig, (*b.attachments, *added), background=True, sizes=b.sizes, outputs=b.outputs,
                        sensitive=frozenset())

    @cached_property
    def parameters(self) -> Array:
        return transferred(self.assembly, self.base.assembly, self.base.fit.p)

    @cached_property
    def missing(self) -> NDArray[np.intp]:
        """Places of the latent values among the states."""
        return np.flatnonzero([s.endswith(".missing") for s in self.assembly.program.states])

    @cached_property
    def paths(self) -> tuple[_Path, ...]:
        return tuple(self._path(i, r) for i, r in enumerate(self.base.replays))

    def _path(self, i: int, r: Replay) -> _Path:
        runner = Runner(self.assembly, r.track, self.base.fit.stepping, whole=True)
        values = runner.parameters(self.parameters)
        slices, opens = _slices(r)
        if self.along is None:
            return _Path(self, runner, values, slices, opens, _start_path(runner, values, r, slices, opens))
        known, own = self.along.assembly.program.states, self.assembly.program.states
        starts = np.zeros((len(slices), len(own)))
        starts[:, [own.index(s) for s in known]] = self.along.paths[i].x
        return _Path(self, runner, values, slices, opens, starts)

    def evidence_at(self, size: float, time_s: float, rounds: int = 0) -> float:
        """Log evidence (nats, up to a constant shared by all ports) with values of this size and time constant."""
        found = sum(path.solve(size, time_s, rounds) for path in self.paths)
        return found if np.isfinite(found) else -np.inf

    @cached_property
    def best(self) -> tuple[float, float, float]:
        """(log evidence, size, time constant): the most likely size and time constant of a coarse grid."""
        if not self.ports:
            return self.evidence_at(1.0, 1.0, ROUNDS), 1.0, 1.0
        middle = [(self.evidence_at(s, TIMES_S[0]), s) for s in SIZES]
        size = max(middle)[1]
        self.evidence_at(size, TIMES_S[0], ROUNDS)
        found = [(self.evidence_at(s, t), s, t) for s in SIZES if 0.2 * size < s < 5.0 * size for t in TIMES_S]
        return max(found)


class _Linear(NamedTuple):
    """The data about the states at the start of every slice, at one path: information (slices x n x n), gradient
    (slices x n), state at the end of the slice and its derivative by the start, squared error in noise variances."""

    information: Array
    gradient: Array
    end: Array
    slope: Array
    cost: float


class _Prior(NamedTuple):
    """What is known before: information of the joints between slices (slices-1 x n) and of the first value (n), decay
    of the states over a slice (n), log determinant of the latent values' part."""

    joint: Array
    first: Array
    decay: Array
    log_det: float


@dataclass(eq=False)
class _Path:
    """States at the start of every slice of one track, and the data about them."""

    smoother: Smoother
    runner: Runner
    values: Array
    slices: list[Window]
    opens: NDArray[np.bool_]        # slices that begin a window: the rig's states are free there
    x: Array                        # slices x states
    linear: _Linear | None = None

    def linearise(self, x: Array) -> _Linear:
        runner, count, n = self.runner, *x.shape
        memory = runner.memory(self.values)
        noise = self.smoother.evidence.noise
        information, slope = np.zeros((count, n, n)), np.zeros((count, n, n))
        gradient, end, cost = np.zeros((count, n)), np.zeros((count, n)), 0.0
        for k, window in enumerate(self.slices):
            runner.enter(memory, x[k])
            Y, J, fine = runner.run(memory, window, self.values, True, 1.0 / noise)
            if not fine:
                return _Linear(information, gradient, end, slope, np.inf)
            r, A = ((Y - runner.track.y[window.start : window.stop]) / noise).ravel(), J[:, :n]
            information[k], gradient[k], cost = A.T @ A, A.T @ r, cost + float(r @ r)
            end[k], slope[k] = memory.x[:n], memory.S[:n, :n]
        return _Linear(information, gradient, end, slope, cost)

    def solve(self, size: float, time_s: float, rounds: int) -> float:
        """Log evidence; with rounds > 0 the path is improved first, else the last linearisation serves."""
        linear, damping = self.linear or self.linearise(self.x), LEAST_DAMPING
        prior = self.prior(size, time_s)
        for _ in range(rounds):
            step, before, promised, _ = self.step(linear, prior, damping)
            x = self.x + step
            there = self.linearise(x)
            gain = before - there.cost - _surprise(x, there, prior)
            if gain > 0.0:  # False where it is not a number
                self.x, linear, damping = x, there, max(0.01 * damping, LEAST_DAMPING)
                if gain < CALM * before:
                    break
            elif promised < CALM * before:
                break
            else:
                damping = max(30.0 * damping, 1e-4)
        self.linear = linear
        _, before, gain, log_det = self.step(linear, self.prior(size, time_s), LEAST_DAMPING)
        return -0.5 * (before - gain + log_det)

    def prior(self, size: float, time_s: float) -> _Prior:
        missing = self.smoother.missing
        spread = np.maximum(self.x.std(axis=0), 1e-9 * np.abs(self.x).max(axis=0) + 1e-100)
        joint = np.tile(1.0 / (STIFF * spread) ** 2, (len(self.slices) - 1, 1))
        free = FREE * spread
        free[: len(self.runner.track.jump)] = np.minimum(free[: len(self.runner.track.jump)], self.runner.track.jump)
        joint[self.opens[1:]] = 1.0 / free**2
        length = (self.slices[0].stop - self.slices[0].start) * self.runner.track.period_s
        keep = float(np.exp(-length / time_s))
        first, decay = np.zeros(len(spread)), np.ones(len(spread))
        joint[:, missing], first[missing] = 1.0 / (size**2 * (1.0 - keep**2)), 1.0 / size**2
        decay[missing] = keep
        return _Prior(joint, first, decay, float(np.log(joint[:, missing]).sum() + np.log(first[missing]).sum()))

    def step(self, linear: _Linear, prior: _Prior, damping: float) -> tuple[Array, float, float, float]:
        """Damped Gauss-Newton step, cost before it, promised gain, log det of the information against the prior's.

        The system is scaled to a unit diagonal: states in pascals and radians stand side by side.
        """
        joint, decay, n = prior.joint, prior.decay, self.x.shape[1]
        D, g = linear.information.copy(), linear.gradient.copy()
        jump = self.x[1:] - decay * linear.end[:-1]
        A = decay[:, None] * linear.slope[:-1]
        off = -joint[:, :, None] * A
        D[:-1] -= np.einsum("kji,kjl->kil", A, off)
        D[1:] += np.einsum("ki,ij->kij", joint, np.eye(n))
        g[:-1] -= np.einsum("kji,kj->ki", A, joint * jump)
        g[1:] += joint * jump
        D[0] += np.diag(prior.first)
        g[0] += prior.first * self.x[0]
        scale = 1.0 / np.sqrt(np.einsum("kii->ki", D) + 1e-300)
        D *= scale[:, :, None] * scale[:, None, :]
        off *= scale[1:, :, None] * scale[:-1, None, :]
        z, log_det = eliminate(D, off, (scale * g)[:, :, None], damping)
        step = -scale * z[:, :, 0]
        before = linear.cost + _surprise(self.x, linear, prior)
        return step, before, -float((g * step).sum()), log_det - 2.0 * float(np.log(scale).sum()) - prior.log_det


def _surprise(x: Array, linear: _Linear, prior: _Prior) -> float:
    """Squared distance of a path from what was known before."""
    jump = x[1:] - prior.decay * linear.end[:-1]
    return float((prior.joint * jump**2).sum() + (prior.first * x[0] ** 2).sum())


def _slices(r: Replay) -> tuple[list[Window], NDArray[np.bool_]]:
    """Slices that do not straddle the replay's windows, and which of them begin one."""
    slices, opens = [], []
    length = max(4, round(SLICE_S / r.track.period_s))
    for w in r.windows:
        for k, s in enumerate(cut(w.stop - w.start, length)):
            slices.append(Window(w.start + s.start, w.start + s.stop))
            opens.append(k == 0)
    return slices, np.array(opens)


def _start_path(runner: Runner, values: Array, r: Replay, slices: list[Window], opens: NDArray[np.bool_]) -> Array:
    """States at the start of every slice along the replay, latent values zero."""
    memory = runner.memory(values)
    narrow = Runner(runner.assembly, r.track, runner.stepping)
    starts = iter(r.entered)
    out = np.zeros((len(slices), len(memory.x)))
    for k, window in enumerate(slices):
        if opens[k]:
            narrow.enter(memory, next(starts))
        out[k] = memory.x
        narrow.run(memory, window, values, False)
        if not np.isfinite(memory.x).all():
            memory = runner.memory(values)
    return out


def size_at(assembly: Assembly, port: str) -> float:
    """Size of the value at a port, SI."""
    declared = assembly.rig.ports[port].size.get("value")
    return declared or assembly.sizes.get((port, "value")) or 1.0
