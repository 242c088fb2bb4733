"""A model with latent values at some of its ports, smoothed together with its states over held-out
recordings.

At every place of a port an unknown value is added that wanders as an Ornstein-Uhlenbeck process (a
Matern-1/2 Gaussian process in time). States, value and the model's parameters, within what the fit
knows of them, are found together, slice by slice, by Gauss-Newton on a block-tridiagonal system
that the parameters border: the Kalman smoother of the linearised model, with its Laplace evidence.
The parameters move, too, because those of the fit have already bent to what is missing. After
Rogers and Friis (2022), Vibration 3; Engelhardt, Froehlich and Kschischo (2016), Sci. Rep. 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pamid.diagnosis.candidate_model import CandidateModel, transferred
from pamid.diagnosis.smoothed_trajectory import (
    Followed,
    Linear,
    Path,
    Prior,
    slices_of,
    start_path,
    surprise,
)
from pamid.estimation.gauss_newton import Scale
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment
from pamid.model.effect import Effect, State
from pamid.simulation.data_split import Evidence
from pamid.simulation.replay import Replay
from pamid.simulation.windows import Runner
from pamid.symbolic.vocabulary import Expr, Number

Array = NDArray[np.float64]

ROUNDS = 20  # Gauss-Newton steps at most, damped as the ground demands
CALM = 1e-3  # of the cost: a gain below it ends them
TRUSTED = 0.1  # of the cost: what a step that was not taken may promise
LEAST_DAMPING = 1e-10  # of a diagonal scaled to one
# standard deviations tried, in sizes of the port's value
SIZES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
TIMES_S = (0.1, 1.0)  # time constants tried


class Latent(Effect):
    """A value that is simply missing: it wanders and is not explained. Sizes are those of the
    port's value."""

    name = "latent"
    family = "latent"
    kinds = ()
    states = (State("missing"),)

    def __init__(self, size: float) -> None:
        self.size = size

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> tuple[Number, dict[str, Number]]:
        return value + self.size * z.missing, {"missing": 0.0}


class _Step(NamedTuple):
    """Of the parameters (in prior spreads) and of every track's states; what it promises to gain;
    log determinant of the information against the priors'."""

    s: Array
    x: list[Array]
    gain: float
    log_det: float


@dataclass(eq=False)
class Smoother:
    """The model of `base` with latent values at `ports`, linearised about its best path over the
    held-out replays."""

    evidence: Evidence
    base: CandidateModel
    ports: tuple[str, ...]
    linear: list[Linear] | None = None
    moved: bool = False  # was it linearised by the parameters, too?

    @cached_property
    def assembly(self) -> Assembly:
        b, rig = self.base.assembly, self.evidence.rig
        added = tuple(
            Attachment(Latent(size_at(b, port)), (port,), f"latent.{i}")
            for i, port in enumerate(self.ports)
        )
        return Assembly(
            rig, (*b.attachments, *added), background=True, sizes=b.sizes, outputs=b.outputs
        ).for_fitting()

    @cached_property
    def free(self) -> tuple[int, ...]:
        """Places of the parameters that move."""
        b = self.base.assembly
        return tuple(self.assembly.keys[b.parameters[i].key] for i in self.base.fit.problem.free)

    @cached_property
    def scale(self) -> Scale:
        free = list(self.free)
        return Scale([self.assembly.parameters[i] for i in free], self.assembly.values()[free])

    @cached_property
    def values(self) -> Array:
        """All parameters of the fit, SI."""
        return transferred(self.assembly, (self.base.assembly, self.base.fit.p))

    @cached_property
    def fitted(self) -> Array:
        """Those that move, in prior spreads."""
        return np.clip(
            self.scale.inside(self.values[list(self.free)]), self.scale.low, self.scale.high
        )

    @cached_property
    def known(self) -> Array:
        """What the fit knows of them, as information: little where what it left is large."""
        found: Array = np.linalg.pinv(self.base.fit.covariance, hermitian=True).astype(
            np.float64, copy=False
        )
        return found

    @cached_property
    def s(self) -> Array:
        """The parameters in prior spreads."""
        return self.fitted.copy()

    def parameters(self, s: Array) -> Array:
        p = self.values.copy()
        p[list(self.free)] = self.scale.outside(s)
        return p

    @cached_property
    def missing(self) -> NDArray[np.intp]:
        """Places of the latent values among the states."""
        return np.flatnonzero([s.endswith(".missing") for s in self.assembly.program.states])

    @cached_property
    def paths(self) -> tuple[Path, ...]:
        return tuple(self._path(i, r) for i, r in enumerate(self.base.replays))

    def _path(self, i: int, r: Replay) -> Path:
        runner = Runner(self.assembly, r.track, self.base.fit.stepping, self.free, whole=True)
        slices, opens = slices_of(r)
        return Path(
            runner, slices, opens, start_path(runner, self.parameters(self.s), r, slices, opens)
        )

    @cached_property
    def rough(self) -> tuple[float, float, float]:
        """(log evidence, size, time constant) as `best`, but with the parameters held: several
        times as fast."""
        if not self.ports:
            return self.evidence_at(1.0, 1.0, ROUNDS, moving=False), 1.0, 1.0
        size = max((self.evidence_at(s, TIMES_S[0], trusted=1.0, moving=False), s) for s in SIZES)[
            1
        ]
        self.evidence_at(size, TIMES_S[0], ROUNDS, moving=False)
        return max((self.evidence_at(s, t, moving=False), s, t) for s, t in _near(size))

    @cached_property
    def best(self) -> tuple[float, float, float]:
        """(log evidence, size, time constant): the most likely size and time constant of a coarse
        grid."""
        _, size, time_s = self.rough
        found = self.evidence_at(size, time_s, ROUNDS)
        return (
            max((self.evidence_at(s, t), s, t) for s, t in _near(size))
            if self.ports
            else (found, size, time_s)
        )

    def evidence_at(
        self,
        size: float,
        time_s: float,
        rounds: int = 0,
        trusted: float = TRUSTED,
        moving: bool = True,
    ) -> float:
        """Log evidence (nats, up to a constant shared by all ports) with values of this size and
        time constant.

        With rounds > 0 parameters and paths are improved first, else the last linearisation serves.
        trusted: share of the cost that a further step may promise and be believed. moving: do the
        parameters?
        """
        priors = [path.prior(self.missing, size, time_s) for path in self.paths]
        linear = self.linear
        if linear is None or (moving and not self.moved):
            linear, self.moved = self._linearised(moving), moving
        damping = LEAST_DAMPING
        for _ in range(rounds):
            here = self.s, [q.x for q in self.paths]
            before = self._cost(linear, priors)
            step = self._step(linear, priors, damping, moving)
            self.s = here[0] + step.s
            for path, d in zip(self.paths, step.x, strict=True):
                path.x = path.x + d
            gain = before - self._cost(self._followed(), priors)
            if gain > 0.0:  # False where it is not a number
                linear, damping = self._linearised(moving), max(0.01 * damping, LEAST_DAMPING)
                if gain < CALM * before:
                    break
                continue
            self.s = here[0]
            for path, x in zip(self.paths, here[1], strict=True):
                path.x = x
            if step.gain < CALM * before:
                break
            damping = max(30.0 * damping, 1e-4)
        self.linear = linear
        priors = [path.prior(self.missing, size, time_s) for path in self.paths]
        step = self._step(linear, priors, LEAST_DAMPING, moving)
        cost = self._cost(linear, priors)
        found = -0.5 * (cost - min(step.gain, trusted * cost) + step.log_det)
        return found if np.isfinite(found) else -np.inf

    def _linearised(self, moving: bool) -> list[Linear]:
        p, slope = self.parameters(self.s), self.scale.slope(self.scale.outside(self.s))
        return [path.linearise(p, slope, self.evidence.noise, moving) for path in self.paths]

    def _followed(self) -> list[Followed]:
        return [path.follow(self.parameters(self.s), self.evidence.noise) for path in self.paths]

    def _cost(self, linear: Sequence[Followed | Linear], priors: list[Prior]) -> float:
        away = self.s - self.fitted
        return float(away @ self.known @ away) + sum(
            one.cost + surprise(path.x, one, prior)
            for path, one, prior in zip(self.paths, linear, priors, strict=True)
        )

    def _step(
        self, linear: list[Linear], priors: list[Prior], damping: float, moving: bool
    ) -> _Step:
        """Damped Gauss-Newton step; parameters at a bound that would leave it stay."""
        s, k = self.s, len(self.s)
        H, g, log_det, parts = self.known, self.known @ (s - self.fitted), 0.0, []
        for path, one, prior in zip(self.paths, linear, priors, strict=True):
            more, right, gx, X, x, det = path.eliminated(one, prior, damping)
            H, g, log_det = H + more, g + right, log_det + det
            parts.append((gx, X, x))
        free = moving & ~(
            ((s <= self.scale.low + 1e-12) & (g > 0)) | ((s >= self.scale.high - 1e-12) & (g < 0))
        )
        ds = np.zeros(k)
        A = H[np.ix_(free, free)]
        if free.any():
            ds[free] = -np.linalg.lstsq(A + damping * np.diag(A.diagonal()), g[free], rcond=None)[0]
            log_det += float(np.linalg.slogdet(A)[1])
        ds = np.clip(s + ds, self.scale.low, self.scale.high) - s
        dx = [-(x + X @ ds) for _, X, x in parts]
        gain = -float(g @ ds) + sum(float((gx * x).sum()) for gx, _, x in parts)
        return _Step(ds, dx, gain, log_det)


def _near(size: float) -> list[tuple[float, float]]:
    """Sizes and time constants of the grid around a size."""
    return [(s, t) for s in SIZES if 0.2 * size < s < 5.0 * size for t in TIMES_S]


def size_at(assembly: Assembly, port: str) -> float:
    """Size of the value at a port, SI."""
    declared = assembly.rig.ports[port].size.get("value")
    return declared or assembly.sizes.get((port, "value")) or 1.0
