"""Training: full-batch Levenberg-Marquardt with Bayesian regularisation, for any network of this package.

A network is anything with `n_weights`, `initial(seed)`, `simulate(weights, inputs)` and
`normal_equations(weights, inputs, target, washout)`. With e the errors and w the weights the objective is
    F = beta sum(e^2) + alpha sum(w^2)
and a step solves (beta J'J + (alpha + mu) I) dw = beta J'e - alpha w. The damping mu follows the customary schedule:
times 0.1 after a step that lowers F, times 10 after one that does not. alpha and beta are re-estimated after every
accepted step (bayes.py). Trial steps cost a simulation, accepted ones a pass with derivatives.
References: Marquardt (1963), SIAM J. 11(2); Hagan and Menhaj (1994), IEEE TNN 5(6); Foresee and Hagan (1997), ICNN.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pamid.networks.bayes import (
    Evidence,
    effective_samples,
    first_guess,
    promised_decrease,
    reestimate,
    solve_damped,
)
from pamid.networks.checkpoints import Attempt, Checkpoint, Step, load_checkpoint, save_checkpoint
from pamid.networks.problem import Damping, Goals, Network, Problem, check_problem, fingerprint, recordings
from pamid.networks.scaling import Scaling, scaling_of

__all__ = ["Damping", "Goals", "Network", "Scaling", "Step", "Training", "scaling_of", "trace_rows", "train"]

Array = NDArray[np.float64]
Progress = Callable[[Step, int], None]

SETTLED = 1e-4  # at the largest mu: a full step promising less than this share of F means the minimum is reached
CHECKPOINT_SECONDS = 5.0
_GOALS, _DAMPING = Goals(), Damping()


@dataclass(frozen=True)
class Training:
    """The best start of a training.

    `trace` holds one array per field of `Step`; `why` says in words what ended it; `samples` counts the errors in the
    objective and `effective_samples` how many independent ones they are worth; `starts_mse` is every start's last mse,
    in order of starting, `best` the number of the start kept.
    """

    weights: Array
    trace: dict[str, Array]
    why: str
    converged: bool
    samples: int
    effective_samples: float
    best: int
    starts_mse: tuple[float, ...]

    @property
    def remark(self) -> str:
        """What the correlation of the residual means for gamma; "" where it means nothing."""
        if self.effective_samples > 0.5 * self.samples:
            return ""
        return (
            f"{self.samples} samples carry about as much as {self.effective_samples:.0f} independent ones, because "
            f"the residual is correlated in time; gamma, alpha and beta count every sample, so gamma is an upper bound."
        )


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
    resume: Path | None = None,
) -> Training:
    """Fit a network's output to a target, both scaled into [-1, 1].

    `inputs` (N, m) and `target` (N,), or equally long lists of these: several recordings, each from a zero state.
    Start s begins at `network.initial(seed + s)` and may take `iterations` steps; the start with the smallest mse is
    kept. The first `washout` samples of every recording are simulated but not counted. `regularise=False` is plain
    least squares (alpha 0, beta 1). `progress(step, start)` is called after every step; KeyboardInterrupt, there or
    anywhere, ends the training with what it has. `checkpoint` is rewritten every few seconds and at the end; `resume`
    names such a file to go on from. Not converging is told in the result; DataError is for data that cannot be fitted.
    """
    problem = Problem(network, recordings(inputs, target), washout, regularise, damping, goals)
    check_problem(problem, iterations, starts)
    key = fingerprint(problem, seed)
    attempts = list(load_checkpoint(resume, key, network.n_weights).attempts) if resume else []
    clock = _Clock(checkpoint, key)
    try:
        for start in range(max(len(attempts) - 1, 0), starts):
            if start == len(attempts):
                attempts.append(_fresh(problem, seed, start))
            for attempt in _climb(problem, attempts[start], iterations):
                attempts[start] = attempt
                clock.keep(attempts)
                if progress and not attempt.why:
                    progress(attempt.steps[-1], start)
    except KeyboardInterrupt:
        attempts = attempts or [_fresh(problem, seed, 0)]
        attempts[-1] = replace(attempts[-1], why=attempts[-1].why or "interrupted")
    clock.keep(attempts, always=True)
    return _summary(problem, attempts)


def trace_rows(training: Training, seconds: bool = True) -> list[list[str]]:
    """The trace as rows of text for trace.csv, header first; numbers in full precision.

    `seconds=False` leaves the one column out that differs when the same training is run again.
    """
    trace = {name: values for name, values in training.trace.items() if seconds or name != "seconds"}
    columns = [
        [str(int(v)) if name in ("iteration", "trials") else repr(float(v)) for v in values]
        for name, values in trace.items()
    ]
    return [list(trace), *(list(row) for row in zip(*columns, strict=True))]


def _climb(problem: Problem, attempt: Attempt, iterations: int) -> Iterator[Attempt]:
    """Yield the attempt after every accepted step; the last one yielded says why it ended."""
    begun = time.perf_counter() - (attempt.steps[-1].seconds if attempt.steps else 0.0)
    found = problem.evaluate(attempt.weights)
    if found is None:
        yield replace(attempt, why="diverged: the network's output or its derivative overflows at the first weights")
        return
    fresh = not attempt.steps
    point = _Point(replace(attempt, why="", converged=False), *found)
    if fresh:
        point = _row(problem, point, begun, trials=0)
        yield point.attempt
    while True:
        why, converged = _goal_reached(problem, point.attempt)
        if not why and point.attempt.steps[-1].iteration >= iterations:
            why = "iterations used up"
        if not why:
            point, why, converged = _step(problem, point, begun)
        yield replace(point.attempt, why=why, converged=converged) if why else point.attempt
        if why:
            return


def _goal_reached(problem: Problem, attempt: Attempt) -> tuple[str, bool]:
    last = attempt.steps[-1]
    if last.mse <= problem.goals.mse:
        return f"mean squared error below {problem.goals.mse:g}", True
    if last.gradient <= problem.goals.gradient:
        return f"gradient below {problem.goals.gradient:g}", True
    return "", False


def _step(problem: Problem, point: _Point, begun: float) -> tuple[_Point, str, bool]:
    """Raise mu until a step lowers F, take it, lower mu, re-estimate alpha and beta; or say that mu ran out."""
    old, damping = point.attempt, problem.damping
    evidence, mu, trials = old.evidence, old.mu, 0
    matrix, right = point.half_hessian, point.descent
    objective = evidence.beta * point.sse + evidence.alpha * float(old.weights @ old.weights)
    while mu <= damping.largest:
        weights = old.weights + solve_damped(matrix, mu, right)
        trials += 1
        penalty = evidence.alpha * float(weights @ weights)
        if evidence.beta * problem.sse(weights) + penalty < objective:
            found = problem.evaluate(weights)
            # where the output is finite but its derivative overflows, the step led to weights nobody can leave
            if found is not None:
                mu = max(mu * damping.decrease, damping.smallest)
                moved = _Point(replace(old, weights=weights, mu=mu), *found)
                return _row(problem, moved, begun, trials), "", False
        mu *= damping.increase
    promised = promised_decrease(matrix, right) / max(objective, 1e-300)
    why, converged = f"mu reached {damping.largest:g}", promised < SETTLED
    if not converged:
        why += f", though a full step promises to lower the objective by {100.0 * promised:.2g} %"
    return replace(point, attempt=replace(old, mu=mu)), why, converged


def _row(problem: Problem, point: _Point, begun: float, trials: int) -> _Point:
    """Re-estimate the evidence at a new point and append the point to the trace."""
    old = point.attempt
    evidence = old.evidence
    if problem.regularise and trials:
        ssw = float(old.weights @ old.weights)
        evidence = reestimate(evidence, point.jtj, problem.samples, point.sse, ssw)
    point = replace(point, attempt=replace(old, evidence=evidence))
    step = Step(
        iteration=len(old.steps),
        mse=point.sse / problem.samples,
        gradient=2.0 * float(np.linalg.norm(point.descent)),
        mu=old.mu,
        gamma=evidence.gamma,
        alpha=evidence.alpha,
        beta=evidence.beta,
        seconds=time.perf_counter() - begun,
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


def _summary(problem: Problem, attempts: Sequence[Attempt]) -> Training:
    best = min(attempts, key=lambda a: a.mse)
    columns = np.array(best.steps, dtype=np.float64).reshape(len(best.steps), len(Step._fields)).T
    residual = problem.residual(best.weights)
    finite = all(np.isfinite(e).all() for e in residual)
    return Training(
        weights=best.weights,
        trace=dict(zip(Step._fields, columns, strict=True)),
        why=best.why,
        converged=best.converged,
        samples=problem.samples,
        effective_samples=sum(effective_samples(e) for e in residual) if finite else 0.0,
        best=best.start,
        starts_mse=tuple(a.mse for a in attempts),
    )


class _Clock:
    """Writes the checkpoint when enough time has passed since the last one."""

    def __init__(self, path: Path | None, problem: str) -> None:
        self.path, self.problem, self.last = path, problem, time.perf_counter()

    def keep(self, attempts: Sequence[Attempt], always: bool = False) -> None:
        now = time.perf_counter()
        if self.path is not None and (always or now - self.last > CHECKPOINT_SECONDS):
            save_checkpoint(self.path, Checkpoint(self.problem, tuple(attempts)))
            self.last = now
