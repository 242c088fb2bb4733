"""Training: full-batch Levenberg-Marquardt with Bayesian regularisation, for any network of this package.

A network is anything with `n_weights`, `initial(seed)`, `simulate(weights, inputs)` and
`normal_equations(weights, inputs, target, washout)`. With e the errors and w the weights the objective is
    F = beta sum(e^2) + alpha sum(w^2)
and a step solves (beta J'J + (alpha + mu) I) dw = beta J'e - alpha w. The damping mu follows the customary schedule:
times 0.1 after a step that lowers F, times 10 after one that does not. alpha and beta are re-estimated after every
accepted step (bayes.py). Trial steps cost a simulation, accepted ones a pass with derivatives.
References: Marquardt (1963), SIAM J. 11(2); Hagan and Menhaj (1994), IEEE TNN 5(6); Foresee and Hagan (1997), ICNN.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pamid.errors import DataError
from pamid.networks.bayes import (
    Evidence,
    effective_samples,
    effective_weights,
    first_guess,
    promised_decrease,
    reestimate,
    solve_damped,
)
from pamid.networks.checkpoints import Attempt, Checkpoint, Step, load_checkpoint, save_checkpoint
from pamid.networks.problem import Damping, Goals, Network, Problem, check_problem, fingerprint, recordings
from pamid.networks.scaling import Scaling, scaling_of

__all__ = ["Damping", "Goals", "Network", "Scaling", "Step", "Training", "scaling_of", "train"]

Array = NDArray[np.float64]
Progress = Callable[[Step, int], None]

_DAMPING, _GOALS = Damping(), Goals()
_CHECKPOINT_SECONDS = 5.0


@dataclass(frozen=True)
class Training:
    """The best start of a training; nothing in it depends on the clock.

    `trace` holds one array per field of `Step` (empty where the start diverged); `why` says in words what ended the
    training; `samples` counts the errors in the objective and `effective_samples` how many independent ones they are
    worth; `supported_weights` is gamma when only these are counted. `starts_mse` is every start's last mse, `best` the
    number of the start kept.
    """

    weights: Array
    trace: dict[str, Array]
    why: str
    converged: bool
    samples: int
    effective_samples: float
    supported_weights: float
    best: int
    starts_mse: tuple[float, ...]

    @property
    def remark(self) -> str:
        """What the correlation of the residual means for gamma; "" where it means nothing."""
        if self.effective_samples > 0.5 * self.samples or not len(self.trace["gamma"]):
            return ""
        return (
            f"The residual is correlated in time: {self.samples} samples carry about as much as "
            f"{self.effective_samples:.0f} independent ones. gamma {self.trace['gamma'][-1]:.1f} counts every sample; "
            f"counting the independent ones, {self.supported_weights:.1f} of {len(self.weights)} weights are supported."
        )

    @property
    def summary(self) -> dict[str, Any]:
        """How the training went, in plain numbers and words fit for strict JSON (None: not finite)."""
        last = {name: _finite(column[-1]) for name, column in self.trace.items() if len(column)}
        return {
            "why": self.why,
            "converged": self.converged,
            "remark": self.remark,
            "iterations": int(last.get("iteration") or 0),
            **{name: last.get(name) for name in ("mse", "gradient", "mu", "gamma", "alpha", "beta")},
            "n_weights": len(self.weights),
            "supported_weights": _finite(self.supported_weights),
            "samples": self.samples,
            "effective_samples": _finite(self.effective_samples),
            "start": self.best,
            "starts_mse": [_finite(mse) for mse in self.starts_mse],
        }


@dataclass(frozen=True)
class _Point:
    """An attempt with the normal equations at its weights; these are recomputed, not stored, on resuming."""

    attempt: Attempt
    sse: float
    jtj: Array
    jte: Array

    @property
    def descent(self) -> Array:
        """Half of -dF/dw."""
        evidence, weights = self.attempt.evidence, self.attempt.weights
        return np.asarray(evidence.beta * self.jte - evidence.alpha * weights)

    @property
    def half_hessian(self) -> Array:
        evidence = self.attempt.evidence
        return evidence.beta * self.jtj + evidence.alpha * np.eye(len(self.jtj))

    @property
    def objective(self) -> float:
        return _objective(self.attempt.evidence, self.sse, self.attempt.weights)

    @property
    def promise(self) -> float:
        """The share of F that an undamped step would take away were the network linear in its weights."""
        return promised_decrease(self.half_hessian, self.descent) / max(self.objective, 1e-300)


def train(
    network: Network,
    inputs: ArrayLike | Sequence[ArrayLike],
    target: ArrayLike | Sequence[ArrayLike],
    *,
    iterations: int = 1000,
    seed: int = 0,
    starts: int = 1,
    washout: int = 0,
    regularise: bool = True,
    goals: Goals = _GOALS,
    damping: Damping = _DAMPING,
    progress: Progress | None = None,
    checkpoint: Path | None = None,
    resume: bool = False,
) -> Training:
    """Fit a network's output to a target, both scaled into [-1, 1].

    `inputs` (N, m) and `target` (N,), or equally long lists of these: several recordings, each from a zero state.
    Start s begins at `network.initial(seed + s)` and may take `iterations` steps; the start with the smallest mse is
    kept. The first `washout` samples of every recording are simulated but not counted. `regularise=False` is plain
    least squares (alpha 0, beta 1). `progress(step, start)` is called after every step; KeyboardInterrupt, there or
    anywhere, ends the training with what it has.

    `checkpoint` is a file rewritten every few seconds and at the end. With `resume` the training goes on from it (from
    the beginning where there is none yet) and ends with the very numbers of an undisturbed one; more `iterations` than
    before are allowed. Not converging is told in the result; DataError is for data that cannot be fitted, FileError
    for a checkpoint of another training.
    """
    problem = Problem(network, recordings(inputs, target), washout, regularise, damping, goals)
    check_problem(problem, iterations, starts, seed)
    if resume and checkpoint is None:
        raise DataError("There is nothing to resume from.", "Name the checkpoint file.")
    key = fingerprint(problem, seed)
    attempts: list[Attempt] = []
    if resume and checkpoint is not None and checkpoint.exists():
        attempts = list(load_checkpoint(checkpoint, key, network.n_weights).attempts)[:starts]
    clock = _Clock(checkpoint, key)
    interrupted = False
    try:
        for start in range(starts):
            if start == len(attempts):
                attempts.append(_fresh(problem, seed, start))
            for attempt in _climb(problem, attempts[start], iterations):
                attempts[start] = attempt
                clock.keep(attempts)
                if progress and not attempt.why:
                    progress(attempt.steps[-1], start)
    except KeyboardInterrupt:
        interrupted = True
        attempts = attempts or [_fresh(problem, seed, 0)]
    clock.keep(attempts, always=True)
    return _conclude(problem, attempts, interrupted)


def _climb(problem: Problem, attempt: Attempt, iterations: int) -> Iterator[Attempt]:
    """Yield the attempt after every accepted step; the last one yielded says why it ended."""
    point = _evaluate(problem, replace(attempt, why="", converged=False), problem.sse(attempt.weights))
    if point is None:
        why = "diverged: the network's output or its derivative overflows at the first weights"
        yield replace(attempt, why=why)
        return
    if not attempt.steps:
        point = _row(problem, point, trials=0)
        yield point.attempt
    while True:
        why, converged = _finished(problem, point, iterations)
        if not why:
            point, why, converged = _step(problem, point)
        if why:
            yield replace(point.attempt, why=why, converged=converged)
            return
        yield point.attempt


def _evaluate(problem: Problem, attempt: Attempt, sse: float) -> _Point | None:
    """Normal equations at the attempt's weights.

    `sse` is that of a plain simulation: the pass with derivatives adds up in another order, and a step must be judged
    by the same arithmetic before and after, to the last bit.
    """
    found = problem.evaluate(attempt.weights) if np.isfinite(sse) else None
    return None if found is None else _Point(attempt, sse, found[1], found[2])


def _finished(problem: Problem, point: _Point, iterations: int) -> tuple[str, bool]:
    steps, goals = point.attempt.steps, problem.goals
    last = steps[-1]
    if last.mse <= goals.mse:
        return f"mean squared error below {goals.mse:g}", True
    if last.gradient <= goals.gradient:
        return f"gradient below {goals.gradient:g}", True
    if last.iteration > 0:
        pairs = ((steps[-2].alpha, last.alpha), (steps[-2].beta, last.beta))
        still = all(abs(new - old) <= goals.drift * abs(new) for old, new in pairs)
        if still and point.promise < goals.promise:
            return "settled: objective, alpha and beta have stopped changing", True
    return ("iterations used up", False) if last.iteration >= iterations else ("", False)


def _step(problem: Problem, point: _Point) -> tuple[_Point, str, bool]:
    """Raise mu until a step lowers F, take it, lower mu, re-estimate alpha and beta; or say that mu ran out."""
    old, damping = point.attempt, problem.damping
    matrix, right, objective = point.half_hessian, point.descent, point.objective
    mu, trials = old.mu, 0
    while mu <= damping.largest:
        weights = old.weights + solve_damped(matrix, mu, right)
        sse, trials = problem.sse(weights), trials + 1
        if _objective(old.evidence, sse, weights) < objective:
            lowered = max(mu * damping.decrease, damping.smallest)
            moved = _evaluate(problem, replace(old, weights=weights, mu=lowered), sse)
            # where the output is finite but its derivative overflows, the step led to weights nobody can leave
            if moved is not None:
                return _row(problem, moved, trials), "", False
        mu *= damping.increase
    why = f"mu reached {damping.largest:g}: no step lowers the objective"
    converged = point.promise < problem.goals.stuck
    if not converged:
        why += f", though a full step promises {100.0 * point.promise:.2g} % of it"
    return replace(point, attempt=replace(old, mu=mu)), why, converged


def _objective(evidence: Evidence, sse: float, weights: Array) -> float:
    return evidence.beta * sse + evidence.alpha * float(weights @ weights)


def _row(problem: Problem, point: _Point, trials: int) -> _Point:
    """Re-estimate the evidence at a new point (not at the start's) and append the point to the trace."""
    old = point.attempt
    evidence = old.evidence
    if problem.regularise and old.steps:
        evidence = reestimate(evidence, point.jtj, problem.samples, point.sse, float(old.weights @ old.weights))
    point = replace(point, attempt=replace(old, evidence=evidence))
    step = Step(
        iteration=len(old.steps),
        mse=point.sse / problem.samples,
        gradient=2.0 * float(np.linalg.norm(point.descent)),
        mu=old.mu,
        gamma=evidence.gamma,
        alpha=evidence.alpha,
        beta=evidence.beta,
        trials=trials,
    )
    return replace(point, attempt=replace(point.attempt, steps=(*old.steps, step)))


def _fresh(problem: Problem, seed: int, start: int) -> Attempt:
    weights = np.array(problem.network.initial(seed + start), dtype=np.float64)
    n = len(weights)
    evidence = Evidence(float(n), 0.0, 1.0)
    if problem.regularise:
        evidence = first_guess(n, problem.samples, problem.sse(weights), float(weights @ weights))
    return Attempt(start, weights, problem.damping.start, evidence, ())


def _conclude(problem: Problem, attempts: Sequence[Attempt], interrupted: bool) -> Training:
    best = min(attempts, key=lambda a: a.mse)
    columns = np.array(best.steps, dtype=np.float64).reshape(len(best.steps), len(Step._fields)).T
    residual = problem.residual(best.weights)
    independent = sum(effective_samples(e) for e in residual) if all(np.isfinite(e).all() for e in residual) else 0.0
    found = problem.evaluate(best.weights)
    tempered = replace(best.evidence, beta=best.evidence.beta * independent / problem.samples)
    return Training(
        weights=best.weights,
        trace=dict(zip(Step._fields, columns, strict=True)),
        why="interrupted" if interrupted else best.why,
        converged=best.converged and not interrupted,
        samples=problem.samples,
        effective_samples=independent,
        supported_weights=effective_weights(tempered, found[1]) if found else math.nan,
        best=best.start,
        starts_mse=tuple(a.mse for a in attempts),
    )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


class _Clock:
    """Writes the checkpoint when enough time has passed since the last one."""

    def __init__(self, path: Path | None, problem: str) -> None:
        self.path, self.problem, self.last = path, problem, -math.inf

    def keep(self, attempts: Sequence[Attempt], always: bool = False) -> None:
        now = time.perf_counter()
        if self.path is not None and (always or now - self.last > _CHECKPOINT_SECONDS):
            save_checkpoint(self.path, Checkpoint(self.problem, tuple(attempts)))
            self.last = now
