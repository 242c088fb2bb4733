"""Training: full-batch Levenberg-Marquardt with Bayesian regularisation, for any network of this
package.

The steps of a start are in levenberg_marquardt.py. Several starts run in parallel, a core each,
as a race. At the iterations `GATES` the worse half of the running starts is stopped, and the last
start has all cores for its passes (successive halving: Jamieson and Talwalkar 2016, AISTATS).
"""

import math
import queue
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pamid.base.arrays import Array
from pamid.networks.bayes import effective_samples, effective_weights, resolved
from pamid.networks.checkpoints import Attempt, TrainingStep, load_checkpoint, save_checkpoint
from pamid.networks.levenberg_marquardt import USED_UP, fresh, levenberg_marquardt_steps
from pamid.networks.network import Network
from pamid.networks.torch_passes import BatchQueue, TorchPasses, engine_on
from pamid.networks.training_problem import (
    TrainingOptions,
    TrainingProblem,
    check_problem,
    fingerprint,
    recordings,
)

GATES = (10, 20, 40, 80, 160)  # iterations at which the worse half of the starts is left behind
_CHECKPOINT_SECONDS = 5.0


@dataclass(frozen=True)
class Training:
    """The best start of a training; nothing in it depends on the clock.

    `trace` holds an array per field of `TrainingStep` (empty where the start diverged); `why`
    states in words what ended the training; `samples` counts the errors in the objective and
    `effective_samples` how many independent ones they are worth; `supported_weights` is gamma when
    only these are counted. `starts_mse` is every start's last mse, `best` the number of the start
    kept.
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
    plain: bool = False

    @property
    def remark(self) -> str:
        """Consequence of the residual's correlation for gamma; "" where there is none."""
        if self.effective_samples > 0.5 * self.samples or not len(self.trace["gamma"]):
            return ""
        return (
            f"The residual is correlated in time: {self.samples} samples carry about as much as "
            f"{self.effective_samples:.0f} independent ones. gamma {self.trace['gamma'][-1]:.1f} "
            f"counts every sample; counting the independent ones, {self.supported_weights:.1f} of "
            f"{len(self.weights)} weights are supported."
        )

    @property
    def summary(self) -> dict[str, Any]:
        """Course of the training in plain numbers and words, for strict JSON (None: not finite)."""
        last = {name: _finite(column[-1]) for name, column in self.trace.items() if len(column)}
        return {
            "why": self.why,
            "converged": self.converged,
            "remark": self.remark,
            "iterations": int(last.get("iteration") or 0),
            **{
                name: last.get(name) for name in ("mse", "gradient", "mu", "gamma", "alpha", "beta")
            },
            "n_weights": len(self.weights),
            "supported_weights": _finite(self.supported_weights),
            "samples": self.samples,
            "effective_samples": _finite(self.effective_samples),
            "start": self.best,
            "starts_mse": [_finite(mse) for mse in self.starts_mse],
            "plain": self.plain,
        }


def train(
    network: Network,
    inputs: ArrayLike | Sequence[ArrayLike],
    target: ArrayLike | Sequence[ArrayLike],
    options: TrainingOptions = TrainingOptions(),  # noqa: B008 (frozen)
    engine: TorchPasses | None = None,
) -> Training:
    """Fit a network's output to a target, both scaled into [-1, 1].

    `inputs` (N, m) and `target` (N,), or equally long lists of these: several recordings, each from
    a zero state. The starts race (module), and the winner is kept. KeyboardInterrupt, in
    `options.progress` or anywhere, ends the training with what it has. engine: computes the passes
    of all starts that are running in a batch (default: that of `options.device`).

    A failure to converge is reported in the result; DataError is for fewer data than weights
    and for options beyond their limits, FileError for a checkpoint of another training, UsageError
    for a device that is not there.
    """
    problem = TrainingProblem(network, recordings(inputs, target), options)
    check_problem(problem)
    checkpoint = options.checkpoint
    # Computed before the first step, so that a checkpoint of other data is refused before any of
    # it is overwritten.
    key = fingerprint(problem)
    attempts: dict[int, Attempt] = {}
    if options.resume and checkpoint is not None and checkpoint.exists():
        attempts = load_checkpoint(checkpoint, key, network.n_weights)
    clock, engine = _Clock(checkpoint, key), engine or engine_on(options.device, network)
    interrupted, running = False, list(range(options.starts))
    try:
        for gate in (g for g in GATES if g < options.iterations):
            _run_until(gate, problem, engine, attempts, running, clock)
            running = _better_half(attempts, running, gate)
        _run_until(options.iterations, problem, engine, attempts, running, clock)
    except KeyboardInterrupt:
        interrupted = True
        attempts = attempts or {0: fresh(problem, 0)}
    clock.keep(attempts, always=True)
    return _training_of(problem, [attempts[k] for k in sorted(attempts)], running, interrupted)


def _run_until(
    gate: int,
    problem: TrainingProblem,
    engine: TorchPasses | None,
    attempts: dict[int, Attempt],
    running: list[int],
    clock: "_Clock",
) -> None:
    """Bring every running start to iteration `gate`, or its end, in parallel; `attempts`
    follows."""
    # A single thread writes attempts and reports progress, so that neither needs a lock.
    messages: queue.SimpleQueue[Attempt | None] = queue.SimpleQueue()
    stop = Event()
    open_starts = [s for s in running if s not in attempts or not _ended(attempts[s], gate)]
    if not open_starts:
        return
    count, threads = len(open_starts), max(problem.options.threads, 1)
    if engine:  # a batch serves all starts: each has to be there to request its pass
        batch_queue = BatchQueue(engine, problem.records, problem.washout, count)
        problem, threads = replace(problem, batch_queue=batch_queue), count
    problem = replace(problem, threads=max(1, threads // count))
    progress = problem.options.progress

    def go(start: int) -> None:
        try:
            begun = attempts[start] if start in attempts else fresh(problem, start)
            for attempt in levenberg_marquardt_steps(problem, begun, gate):
                messages.put(attempt)
                if stop.is_set():
                    return
        finally:
            if problem.batch_queue:
                problem.batch_queue.leave()
            messages.put(None)

    with ThreadPoolExecutor(threads) as pool:
        jobs = [pool.submit(go, s) for s in open_starts]
        try:
            left = len(jobs)
            while left:
                attempt = messages.get()
                if attempt is None:
                    left -= 1
                    continue
                attempts[attempt.start] = attempt
                clock.keep(attempts)
                if progress and not attempt.why:
                    progress(attempt.steps[-1], attempt.start)
        finally:
            stop.set()
            for job in jobs:
                job.cancel()
    for job in jobs:
        job.result()


def _ended(attempt: Attempt, gate: int) -> bool:
    """Whether it takes no step up to this gate. A start that was used up may have more now."""
    # A start that has converged or diverged takes no step at any later gate.
    return bool(attempt.why and attempt.why != USED_UP) or (len(attempt.steps) > gate)


def _better_half(attempts: dict[int, Attempt], running: list[int], gate: int) -> list[int]:
    """The better half by the error that each had at this gate; the others end with a reason."""

    def standing(start: int) -> float:
        steps = attempts[start].steps
        return steps[min(gate, len(steps) - 1)].mse if steps else math.inf

    # The error at the gate, not the last error: a start that ran ahead after a resume must not win
    # by that.
    order = sorted(running, key=lambda s: (standing(s), s))
    staying = order[: (len(order) + 1) // 2]
    for s in order[len(staying) :]:
        if attempts[s].why == USED_UP:
            attempts[s] = replace(
                attempts[s], why=f"left behind by start {order[0]} at iteration {gate}"
            )
    return sorted(staying)


def _training_of(
    problem: TrainingProblem, attempts: Sequence[Attempt], running: list[int], interrupted: bool
) -> Training:
    # Only among those still in the race. The result must not depend on how far a stopped start had
    # come.
    best = min((a for a in attempts if a.start in running), key=lambda a: a.mse)
    columns = (
        np.array(best.steps, dtype=np.float64).reshape(len(best.steps), len(TrainingStep._fields)).T
    )
    residual = problem.errors(best.weights).each
    independent = (
        sum(effective_samples(e) for e in residual)
        if all(np.isfinite(e).all() for e in residual)
        else 0.0
    )
    counted = independent if problem.options.independent else problem.samples
    # gamma as if only the independent samples had been counted: the precision shrinks as they do
    tempered = replace(best.evidence, beta=best.evidence.beta * independent / max(counted, 1.0))
    supported, sums = math.nan, problem.evaluate(best.weights)
    if sums is not None:
        jtj = sums[1]
        spectrum = None if resolved(tempered, jtj) else problem.spectrum(best.weights, tempered)
        supported = effective_weights(tempered, spectrum or jtj)
    return Training(
        weights=best.weights,
        trace=dict(zip(TrainingStep._fields, columns, strict=True)),
        why="interrupted" if interrupted else best.why,
        converged=best.converged and not interrupted,
        samples=problem.samples,
        effective_samples=independent,
        supported_weights=supported,
        best=best.start,
        starts_mse=tuple(a.mse for a in attempts),
        plain=problem.plain,
    )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


class _Clock:
    """Writes the checkpoint when enough time has passed since the last checkpoint."""

    def __init__(self, path: Path | None, problem: str) -> None:
        self.path, self.problem, self.last = path, problem, -math.inf

    def keep(self, attempts: dict[int, Attempt], always: bool = False) -> None:
        now = time.perf_counter()
        # By the clock, as steps take from milliseconds to minutes. The clock decides when to write
        # and nothing else.
        if self.path is not None and (always or now - self.last > _CHECKPOINT_SECONDS):
            save_checkpoint(self.path, self.problem, (attempts[k] for k in sorted(attempts)))
            self.last = now
