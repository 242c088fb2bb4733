"""Which port a missing value would have to enter at: a latent value per port, smoothed over the held-out recordings.

At every place of a port an unknown value is added that wanders as an Ornstein-Uhlenbeck process (a Matern-1/2 Gaussian
process in time). States and value are found together, slice by slice, by Gauss-Newton on a block-tridiagonal system:
the Kalman smoother of the linearised model. Its Laplace evidence says how much better the recordings are explained
when something may enter there; a port at which a small, slow value explains every channel wins over one that has to
follow each sensor's error by itself. After Rogers and Friis (2022) and Engelhardt et al. (2016).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import factorial
from typing import Any

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
from pamid.rig import Rig
from pamid.windows import Runner, Window, cut

Array = NDArray[np.float64]

SLICE_S = 0.05              # length of the slices over which the value is constant
ROUNDS = 4                  # Gauss-Newton steps
STIFF = 1e-4                # standard deviation of a state's jump between slices, in standard deviations of the state
SIZES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)   # standard deviations tried, in sizes of the port's value
TIMES_S = (0.1, 1.0)        # time constants tried
ALIKE = 0.98                # ports with this share of another one's evidence: these recordings do not tell them apart
PLAYERS = 3                 # ports whose joint evidence is computed


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
            return _Path(self, runner, values, slices, opens, _start_path(self, runner, values, r, slices, opens))
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
            return self.evidence_at(1.0, 1.0), 1.0, 1.0
        middle = [(self.evidence_at(s, TIMES_S[0]), s) for s in SIZES]
        size = max(middle)[1]
        self.evidence_at(size, TIMES_S[0], ROUNDS)
        found = [(self.evidence_at(s, t), s, t) for s in SIZES if 0.2 * size < s < 5.0 * size for t in TIMES_S]
        return max(found)


@dataclass(eq=False)
class _Path:
    """States at the start of every slice of one track, and the normal equations of the data about them."""

    smoother: Smoother
    runner: Runner
    values: Array
    slices: list[Window]
    opens: NDArray[np.bool_]        # slices that begin a window: the rig's states are free there
    x: Array                        # slices x states
    normal: tuple[Array, Array, Array, Array, float] | None = None

    def linearise(self, x: Array) -> tuple[Array, Array, Array, Array, float]:
        """Per slice: information, gradient, end state, its derivative by the start; and the squared error."""
        runner, n = self.runner, self.x.shape[1]
        memory = runner.memory(self.values)
        noise = self.smoother.evidence.noise
        count = len(self.slices)
        D, g, end, slope, cost = np.zeros((count, n, n)), np.zeros((count, n)), np.zeros((count, n)), \
            np.zeros((count, n, n)), 0.0
        for k, window in enumerate(self.slices):
            runner.enter(memory, x[k])
            Y, J, fine = runner.run(memory, window, self.values, True, 1.0 / noise)
            if not fine:
                return D, g, end, slope, np.inf
            r = ((Y - runner.track.y[window.start : window.stop]) / noise).ravel()
            A = J[:, :n]
            D[k], g[k], cost = A.T @ A, A.T @ r, cost + float(r @ r)
            end[k], slope[k] = memory.x[:n], memory.S[:n, :n]
        return D, g, end, slope, cost

    def solve(self, size: float, time_s: float, rounds: int) -> float:
        """Log evidence; with rounds > 0 the path is improved first, else the last linearisation serves."""
        if self.normal is None:
            self.normal = self.linearise(self.x)
        for _ in range(rounds):
            step, before, _ = self._step(self.x, self.normal, size, time_s)
            for shorter in (1.0, 0.3, 0.1):
                x = self.x + shorter * step
                normal = self.linearise(x)
                if np.isfinite(normal[4]) and normal[4] + self._prior(x, normal, size, time_s) < before:
                    self.x, self.normal = x, normal
                    break
            else:
                break
        _, cost, log_det = self._step(self.x, self.normal, size, time_s, gain=True)
        return -0.5 * (cost + log_det)

    def _joints(self, size: float, time_s: float) -> tuple[Array, Array, Array, Array]:
        """Information of the joints (slices-1 x states), of the values themselves, decay per slice, log det of both."""
        n = self.x.shape[1]
        missing = self.smoother.missing
        spread = np.maximum(self.x.std(axis=0), 1e-9 * np.abs(self.x).max(axis=0) + 1e-100)
        joint = np.tile(1.0 / (STIFF * spread) ** 2, (len(self.slices) - 1, 1))
        joint[self.opens[1:]] = 1e-6 / spread**2
        length = (self.slices[0].stop - self.slices[0].start) * self.runner.track.period_s
        keep = float(np.exp(-length / time_s))
        decay = np.ones(n)
        decay[missing] = keep
        joint[:, missing] = 1.0 / (size**2 * (1.0 - keep**2))
        first = np.full(n, 0.0)
        first[missing] = 1.0 / size**2
        logs = np.array([np.log(joint[:, missing]).sum() + np.log(first[missing]).sum()])
        return joint, first, decay, logs

    def _prior(self, x: Array, normal: tuple[Array, Array, Array, Array, float], size: float, time_s: float) -> float:
        joint, first, decay, _ = self._joints(size, time_s)
        jump = x[1:] - decay * normal[2][:-1]
        return float((joint * jump**2).sum() + (first * x[0] ** 2).sum())

    def _step(self, x: Array, normal: tuple[Array, Array, Array, Array, float], size: float, time_s: float,
              gain: bool = False) -> tuple[Array, float, float]:
        """Gauss-Newton step; cost (after it, with `gain`) and log det of the information against the prior's."""
        D, g, end, slope, cost = normal
        joint, first, decay, logs = self._joints(size, time_s)
        n, count = x.shape[1], len(x)
        D, g = D.copy(), g.copy()
        off = np.zeros((count - 1, n, n))
        jump = x[1:] - decay * end[:-1]
        A = decay[:, None] * slope[:-1]
        weighted = joint[:, :, None] * A
        D[:-1] += np.einsum("kji,kjl->kil", A, weighted)
        D[1:] += np.einsum("ki,ij->kij", joint, np.eye(n))
        off[:] = -weighted
        g[:-1] -= np.einsum("kji,kj->ki", A, joint * jump)
        g[1:] += joint * jump
        D[0] += np.diag(first)
        g[0] += first * x[0]
        diagonal = np.einsum("kii->ki", D)
        scale = 1.0 / np.sqrt(diagonal + 1e-300)
        D *= scale[:, :, None] * scale[:, None, :]
        off *= scale[1:, :, None] * scale[:-1, None, :]
        z, log_det = eliminate(D, off, (scale * g)[:, :, None], 1e-10)
        step = -scale * z[:, :, 0]
        total = cost + self._prior(x, normal, size, time_s)
        if gain:
            total += float((g * step).sum())
        return step, total, log_det - 2.0 * float(np.log(scale).sum()) - float(logs[0])


def _slices(r: Replay) -> tuple[list[Window], NDArray[np.bool_]]:
    """Slices that do not straddle the replay's windows, and which of them begin one."""
    slices, opens = [], []
    length = max(4, round(SLICE_S / r.track.period_s))
    for w in r.windows:
        for k, s in enumerate(cut(w.stop - w.start, length)):
            slices.append(Window(w.start + s.start, w.start + s.stop))
            opens.append(k == 0)
    return slices, np.array(opens)


def _start_path(smoother: Smoother, runner: Runner, values: Array, r: Replay, slices: list[Window],
                opens: NDArray[np.bool_]) -> Array:
    """States at the start of every slice along the replay, latent values zero."""
    from pamid.windows import estimate_start

    memory = runner.memory(values)
    narrow = Runner(smoother.assembly, r.track, runner.stepping)
    out = np.zeros((len(slices), len(memory.x)))
    for k, window in enumerate(slices):
        if opens[k]:
            whole = next(w for w in r.windows if w.start == window.start)
            x, _, usable = estimate_start(narrow, memory, whole, values, 1.0 / smoother.evidence.noise,
                                          memory.x[: narrow.rig_states].copy())
            if usable:
                narrow.enter(memory, x)
        out[k] = memory.x
        narrow.run(memory, window, values, False)
        if not np.isfinite(memory.x).all():
            memory = runner.memory(values)
    return out


def size_at(assembly: Assembly, port: str) -> float:
    """Size of the value at a port, SI."""
    declared = assembly.rig.ports[port].size.get("value")
    return declared or assembly.sizes.get((port, "value")) or 1.0


@dataclass(frozen=True)
class Located:
    """Log evidence gained (nats) by a latent value at each port.

    classes: ports about which these recordings say the same, the leading one first, strongest class first; worth: each
    class's Shapley value (nats), by its leading port.
    """

    gains: dict[str, float]
    classes: tuple[tuple[str, ...], ...]
    worth: dict[str, float]
    smoothers: dict[str, Smoother]

    def shares(self, rig: Rig, named: str = "") -> dict[str, float]:
        """Every port group's share of the whole: the groups of a class divide its worth unless one is named."""
        out = {rig.group_of(name): 0.0 for name in rig.ports}
        for members in self.classes:
            groups = list(dict.fromkeys(rig.group_of(name) for name in members))
            groups = [named] if named in groups else groups
            for group in groups:
                out[group] += self.worth.get(members[0], 0.0) / len(groups)
        total = sum(out.values())
        return {k: v / total if total > 0.0 else 1.0 / len(out) for k, v in out.items()}

    @property
    def most(self) -> float:
        """The largest evidence, nats."""
        return max(self.gains.values(), default=0.0)

    @property
    def port(self) -> str:
        """The port with the largest evidence."""
        return self.classes[0][0]


def locate(evidence: Evidence, base: Contender, run: Callable[[Callable[[str], Any], list[str]], list[Any]],
           ports: list[str] | None = None) -> Located:
    """Evidence for a latent value at every port, and Shapley values of the classes of ports.

    run(work, items) does the jobs. With `ports` only these are tried, and nothing is shared out. Joint evidence is
    computed for the leading ports of three classes.
    """
    plain = Smoother(evidence, base, ())
    nothing = plain.best[0]
    names = ports or list(evidence.rig.ports)
    smoothers = {name: Smoother(evidence, base, (name,), plain) for name in names}
    gains = dict(zip(names, run(lambda name: _gained(smoothers[name], nothing), names), strict=True))
    classes: dict[str, list[str]] = {}
    for name in sorted(names, key=lambda k: -gains[k]):
        leader = next((k for k in classes if gains[name] >= ALIKE * gains[k]), name)
        classes.setdefault(leader, []).append(name)
    found = tuple(tuple(k) for k in classes.values())
    if ports is not None:
        return Located(gains, found, {}, smoothers)
    players = [leader for leader in classes if gains[leader] > 0.0][:PLAYERS]
    value: dict[frozenset[str], float] = {frozenset(): 0.0} | {frozenset((k,)): gains[k] for k in players}
    for size in range(2, len(players) + 1):
        for members in combinations(players, size):
            joint = _gained(Smoother(evidence, base, members, plain), nothing)
            value[frozenset(members)] = max([joint, *(value[frozenset(members) - {m}] for m in members)])
    return Located(gains, found, shapley(players, value), smoothers)


def _gained(smoother: Smoother, nothing: float) -> float:
    """Log evidence beyond that without a latent value; 0 where neither path can be followed."""
    here = smoother.best[0]
    return max(here - nothing, 0.0) if np.isfinite(here) and np.isfinite(nothing) else 0.0


def shapley(players: list[str], value: dict[frozenset[str], float]) -> dict[str, float]:
    """Shapley value of every player of a game given by the worth of every coalition."""
    n = len(players)
    out = {}
    for one in players:
        others = [q for q in players if q != one]
        out[one] = sum(factorial(k) * factorial(n - k - 1) / factorial(n)
                       * (value[frozenset((*c, one))] - value[frozenset(c)])
                       for k in range(n) for c in combinations(others, k))
    return out
