"""A start of a training: Levenberg-Marquardt steps, alpha and beta re-estimated at each.

With e = target - y the errors, J = dy/dw and w the weights the objective is
    F = beta sum(e^2) + alpha sum(w^2)                 (MacKay 1992; Foresee and Hagan 1997)
and a step v solves (beta J'J + (alpha + mu) I) v = beta J'e - alpha w, the Gauss-Newton Hessian of
F/2 damped by mu (Levenberg, Marquardt). Four things are added to the textbook's:
  * geodesic acceleration: half of a, which solves the same system for - beta J'(d2y along v), bends
    the step where the model of the errors is not linear, as long as it is short compared with v;
  * variable projection: after the step the weights in which the output is linear take their best
    values;
  * gain-ratio damping: mu changes with the actual over the promised decrease (`Damping.factor`);
  * a bounded context: a step after which a small disturbance of the context would grow by more than
    `GROWTH` along a recording (`_bounded`) is not taken, however far it lowers F.
`TrainingOptions.plain` keeps only the third, and `Damping.decrease` omits that as well. Trial steps
cost simulations, accepted steps a pass with derivatives, and a second pass where J'J does not hold
enough (root_sums.py). The iteration is not that of engine/damped_gauss_newton.py, which minimises
a fixed cost: here F itself changes with alpha and beta after every step, the trial steps of a
point are computed side by side, and an attempt has to be resumable after each of them.

References: Marquardt (1963), SIAM J. 11(2); Hagan and Menhaj (1994), IEEE TNN 5(6); MacKay (1992),
Neural Computation 4(3); Foresee and Hagan (1997), ICNN; Golub and Pereyra (1973), SIAM J. Numer.
Anal. 10(2); Transtrum and Sethna (2012), arXiv:1201.5885.
"""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pamid.base.arrays import Array
from pamid.networks.bayes import (
    Evidence,
    effective_weights,
    evidence_of,
    promised_decrease,
    resolved,
    solve_damped,
)
from pamid.networks.checkpoints import Attempt, TrainingStep
from pamid.networks.root_sums import Spectrum
from pamid.networks.training_problem import Errors, TrainingProblem

USED_UP = "iterations used up"
# an acceleration longer than this share of the step is not trusted (Transtrum and Sethna)
SHORT = 0.75
# natural logarithm by which a disturbance may grow along a recording, in the mean of several: over
# a few hundred samples a memory that keeps everything grows by as much before it has settled
GROWTH = 1.0


@dataclass(frozen=True)
class Point:
    """An attempt with the normal equations at its weights; these are recomputed, not stored, on
    resuming. spectrum: of J, where J'J does not hold enough of it."""

    attempt: Attempt
    errors: Errors
    jtj: Array
    jte: Array
    spectrum: Spectrum | None = None

    @property
    def sse(self) -> float:
        return self.errors.sse

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
        return objective(self.attempt.evidence, self.sse, self.attempt.weights)

    @property
    def promise(self) -> float:
        """The share of F that an undamped step would take away from a linear network."""
        evidence = self.attempt.evidence
        if self.spectrum is None:
            promised = promised_decrease(self.half_hessian, self.descent)
        else:
            promised = self.spectrum.promised(evidence.beta, evidence.alpha, self.attempt.weights)
        return promised / max(self.objective, 1e-300)

    def step(self, mu: float) -> Array:
        """v of (beta J'J + (alpha + mu) I) v = beta J'e - alpha w."""
        evidence, weights = self.attempt.evidence, self.attempt.weights
        if self.spectrum is None:
            return solve_damped(self.half_hessian, mu, self.descent)
        return self.spectrum.step(evidence.beta, evidence.alpha, mu, weights)

    def solved(self, mu: float, right: Array) -> Array:
        """The same system for another right-hand side."""
        evidence = self.attempt.evidence
        if self.spectrum is None:
            return solve_damped(self.half_hessian, mu, right)
        return self.spectrum.solved(evidence.beta, evidence.alpha + mu, right)


def objective(evidence: Evidence, sse: float, weights: Array) -> float:
    return evidence.beta * sse + evidence.alpha * float(weights @ weights)


def fresh(problem: TrainingProblem, start: int) -> Attempt:
    """The attempt before its first pass."""
    network, seed, mu = problem.network, problem.options.seed, problem.options.damping.start
    begun = (
        network.random_start(seed + start)
        if problem.plain
        else network.start(problem.records, problem.washout, seed + start)
    )
    weights = np.array(begun, dtype=np.float64)
    if not problem.options.regularise:
        return Attempt(start, weights, mu, Evidence(float(len(weights)), 0.0, 1.0), ())
    # The first alpha and beta need errors, and errors of arbitrary output weights say nothing. A
    # projection settles both.
    weights, errors = problem.projected(weights, _first(problem, weights, problem.errors(weights)))
    return Attempt(start, weights, mu, _first(problem, weights, errors), ())


def _first(problem: TrainingProblem, weights: Array, errors: Errors) -> Evidence:
    with np.errstate(over="ignore"):
        counted = problem.counted_samples(errors) if np.isfinite(errors.sse) else problem.samples
        return evidence_of(float(len(weights)), counted, errors.sse, float(weights @ weights))


def levenberg_marquardt_steps(
    problem: TrainingProblem, attempt: Attempt, iterations: int
) -> Iterator[Attempt]:
    """Yield the attempt after every accepted step; the last attempt has the reason of its end."""
    point = _evaluate(
        problem, replace(attempt, why="", converged=False), problem.errors(attempt.weights)
    )
    if point is None:
        why = "diverged: the network's output or its derivative overflows at the first weights"
        yield replace(attempt, why=why)
        return
    if not attempt.steps:
        point = _with_row(problem, point, trials=0)
        yield point.attempt
    while True:
        why, converged = _stop_reason(problem, point, iterations)
        if not why:
            point, why, converged = _step(problem, point)
        if why:
            yield replace(point.attempt, why=why, converged=converged)
            return
        yield point.attempt


def _evaluate(problem: TrainingProblem, attempt: Attempt, errors: Errors) -> Point | None:
    """Normal equations at the attempt's weights.

    `errors` are those of a plain simulation. The pass with derivatives adds up in another order,
    and a step must be compared by the same arithmetic before and after, to the last bit.
    """
    point = problem.evaluate(attempt.weights) if np.isfinite(errors.sse) else None
    if point is None:
        return None
    # The root costs a second pass, and most points do not need it.
    if resolved(attempt.evidence, point[1]):
        return Point(attempt, errors, point[1], point[2])
    spectrum = problem.spectrum(attempt.weights, attempt.evidence)
    return Point(attempt, errors, point[1], point[2], spectrum)


def _stop_reason(problem: TrainingProblem, point: Point, iterations: int) -> tuple[str, bool]:
    steps, goals = point.attempt.steps, problem.options.goals
    last = steps[-1]
    if last.mse <= goals.mse:
        return f"mean squared error below {goals.mse:g}", True
    if last.gradient <= goals.gradient:
        return f"gradient below {goals.gradient:g}", True
    if last.iteration > 0:
        pairs = ((steps[-2].alpha, last.alpha), (steps[-2].beta, last.beta))
        # F alone is no criterion: it moves with alpha and beta even where the weights do not.
        still = all(abs(new - old) <= goals.drift * abs(new) for old, new in pairs)
        if still and point.promise < goals.promise:
            return "settled: objective, alpha and beta have stopped changing", True
    return (USED_UP, False) if last.iteration >= iterations else ("", False)


class _Trial(NamedTuple):
    """A step with damping mu: weights, errors, decrease of F, and the share of its promise."""

    mu: float
    weights: Array
    errors: Errors
    lowered: float
    gain: float


def _step(problem: TrainingProblem, point: Point) -> tuple[Point, str, bool]:
    """Raise mu until a step lowers F, take it, change mu by its gain, re-estimate alpha and beta;
    or say that mu ran out."""
    old, damping, unbounded = point.attempt, problem.options.damping, False
    for trials, trial in enumerate(_trials(problem, point), start=1):
        if trial.lowered > 0.0:
            if not _bounded(problem, point, trial):
                unbounded = True
                continue
            # A floor keeps mu from underflowing to zero, from where no factor could raise it.
            following = max(trial.mu * damping.factor(trial.gain), damping.smallest)
            moved = _evaluate(
                problem, replace(old, weights=trial.weights, mu=following), trial.errors
            )
            # where the output is finite but its derivative overflows, the step led to weights
            # nobody can leave
            if moved is not None:
                return _with_row(problem, moved, trials), "", False
    why = f"mu reached {damping.largest:g}: no step lowers the objective"
    why += " with a bounded context" if unbounded else ""
    # Steps also fail at a minimum, by rounding. The promised decrease tells that case from a
    # failure.
    converged = point.promise < problem.options.goals.stuck
    if not converged:
        why += f", though a full step promises {100.0 * point.promise:.2g} % of it"
    return replace(point, attempt=replace(old, mu=trial.mu * damping.increase)), why, converged


def _bounded(problem: TrainingProblem, point: Point, trial: _Trial) -> bool:
    """Whether a small disturbance of the context grows along the recordings no more than `GROWTH`,
    or no more than before the step.

    The poles of the context's weights are no measure of this: in the range where its units are
    bent, a context with a pole of 1.3 forgets its start within 30 samples, while a context of
    1.0035 never does (40 s of the first paper's twin). Keeping every pole below 1, by the
    projection that costs least in the metric of the step, was tried as well. It left twice the mean
    squared error after 60 steps (median of five seeds), and 1.5 times after 150 steps on 200 s
    (three).
    """
    if problem.plain:
        return True
    grown = problem.growth(trial.weights, trial.errors)
    return grown <= GROWTH * len(problem.records) or grown <= problem.growth(
        point.attempt.weights, point.errors
    )


def _trials(problem: TrainingProblem, point: Point) -> Iterator[_Trial]:
    """Trials with rising mu; with several threads some are computed ahead."""
    # All trials of a point share its normal equations; only the damping differs.
    right = point.descent
    mu = [point.attempt.mu]
    while mu[-1] * problem.options.damping.increase <= problem.options.damping.largest:
        mu.append(mu[-1] * problem.options.damping.increase)
    at_once = max(1, min(problem.threads, 2))
    for k in range(0, len(mu), at_once):
        ahead = mu[k : k + at_once]
        if len(ahead) < 2:
            yield from (_trial(problem, point, right, m) for m in ahead)
        else:
            # A plain pool, since it is part of every step: a pool of jobs first settles the threads
            # of BLAS, which takes milliseconds.
            with ThreadPoolExecutor(len(ahead)) as pool:
                yield from list(pool.map(lambda m: _trial(problem, point, right, m), ahead))


def _trial(problem: TrainingProblem, point: Point, right: Array, mu: float) -> _Trial:
    step, old = point.step(mu), point.attempt
    # the quadratic's decrease of F: 2 v'g - v'Hv = v'(mu v + g), since (H + mu I) v = g
    promised = float(step @ (mu * step + right))
    pulled = None if problem.plain else problem.curvature(old.weights, step)
    # Where the second derivative overflows the plain step is still a descent direction.
    if pulled is not None:
        bend = 0.5 * point.solved(mu, -old.evidence.beta * pulled)
        step = step + bend if 2.0 * np.linalg.norm(bend) <= SHORT * np.linalg.norm(step) else step
    weights, errors = problem.projected(old.weights + step, old.evidence)
    lowered = point.objective - objective(old.evidence, errors.sse, weights)
    return _Trial(mu, weights, errors, lowered, lowered / promised if promised > 0.0 else 0.0)


def _with_row(problem: TrainingProblem, point: Point, trials: int) -> Point:
    """Re-estimate the evidence at a new point (not the start's); append it to the trace."""
    old = point.attempt
    evidence = old.evidence
    # The start's weights are a draw, so that alpha and beta of these would regularise against the
    # draw.
    if problem.options.regularise and old.steps:
        counted = problem.counted_samples(point.errors)
        gamma = effective_weights(evidence, point.spectrum or point.jtj)
        evidence = evidence_of(gamma, counted, point.sse, float(old.weights @ old.weights))
    point = replace(point, attempt=replace(old, evidence=evidence))
    step = TrainingStep(
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
