"""Problem of a training: network, recordings, sample weights, stopping rules, all checked."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import DataError
from pamid.networks.bayes import Evidence, effective_samples, solve_damped
from pamid.networks.checkpoints import TrainingStep
from pamid.networks.network import Network
from pamid.networks.root_sums import RootSums, Spectrum
from pamid.networks.torch_passes import BatchQueue

StepProgress = Callable[[TrainingStep, int], None]


@dataclass(frozen=True)
class Damping:
    """The schedule of mu: `increase` after a step that does not lower F, else `decrease`, or by the
    gain ratio where that is None.

    DataError where it could not end, or would not damp.
    """

    start: float = 0.005
    increase: float = 3.0
    largest: float = 1e10
    smallest: float = 1e-20
    decrease: float | None = None

    def __post_init__(self) -> None:
        for name in ("start", "increase", "largest", "decrease"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise DataError(f"Damping: {name} must be a positive number, not {value!r}.")
        if self.increase <= 1.0:
            raise DataError(f"Damping: increase must be above 1, not {self.increase!r}.")
        if self.decrease is not None and self.decrease >= 1.0:
            raise DataError(f"Damping: decrease must be below 1, not {self.decrease!r}.")
        if self.start > self.largest:
            raise DataError(f"Damping: mu begins at {self.start:g}, above {self.largest:g}.")

    def factor(self, gain: float) -> float:
        """Factor of mu after an accepted step that lowered F by `gain` times its prediction: the
        better the quadratic model, the less the next step is damped (the gain ratio of trust
        regions: Nocedal and Wright 2006, Numerical Optimization, ch. 4.1); or `decrease`."""
        if self.decrease is not None:
            return self.decrease
        steps = ((0.98, 0.1), (0.75, 1.0 / 3.0), (0.5, 2.0 / 3.0), (0.25, 1.0))
        return next((factor for above, factor in steps if gain > above), 2.0)


#: of MATLAB's `trainbr` (mu, mu_inc, mu_max, mu_dec), and the first paper's number of epochs
PAPER_DAMPING = Damping(start=0.005, increase=10.0, largest=1e10, decrease=0.1)
PAPER_ITERATIONS = 5000


@dataclass(frozen=True)
class Errors:
    """Errors of a plain simulation for every recording from the washout on, and the sum of their
    squares. features: regressors of the linear weights, where there are any."""

    each: tuple[Array, ...]
    features: tuple[Array, ...] = ()

    @cached_property
    def sse(self) -> float:
        with np.errstate(all="ignore"):
            return float(sum(e @ e for e in self.each))


@dataclass(frozen=True)
class Goals:
    """When a training has converged: any of mse, gradient, or promise together with drift.

    `mse` is the mean squared error (below the default, float64 signals in [-1, 1] are fitted
    exactly and beta would run away); `gradient` the norm of dF/dw; `promise` the share of F that a
    full step could still take away, `drift` the share by which alpha and beta moved in the last
    step. `stuck`: with mu at its largest, a full step that promises less than this share of F is
    taken for rounding at a minimum.
    """

    mse: float = 1e-24
    gradient: float = 1e-7
    promise: float = 1e-10
    drift: float = 1e-6
    stuck: float = 1e-4


@dataclass(frozen=True)
class TrainingOptions:
    """Course of a training.

    iterations: steps of the start that wins the race, at most. seed, starts: start s begins at
    `network.start(..., seed + s)`. washout: samples at the beginning of every recording that are
    simulated but not counted. regularise: else plain least squares (alpha 0, beta 1). independent:
    alpha and beta count only the independent samples of the errors: at 3 ms far fewer, and more
    regularisation. plain: as the first paper trained, by the textbook's steps from a random start
    (no geodesic acceleration, the linear weights like the others, the context not kept bounded);
    the damping that goes with it is `PAPER_DAMPING`. threads: cores used; the result does not
    depend on it. device: where torch computes the passes of all running starts together; None: the
    compiled kernels do, and the sums differ in the last digits. progress(step, start) is called
    after every step. checkpoint: a file rewritten every few seconds and at the end; with `resume`
    the training goes on from it (from the beginning where there is none yet) and ends with the very
    numbers of an undisturbed training; more `iterations` than before are allowed.
    """

    iterations: int = 1000
    seed: int = 0
    starts: int = 1
    washout: int = 0
    regularise: bool = True
    goals: Goals = Goals()
    damping: Damping = Damping()
    independent: bool = False
    plain: bool = False
    threads: int = 1
    device: str | None = None
    checkpoint: Path | None = None
    resume: bool = False
    progress: StepProgress | None = None


@dataclass(frozen=True)
class TrainingProblem:
    """Recordings are (inputs (N, m), target (N,)) pairs, each simulated from a zero state.

    threads: for each pass; batch_queue: computes the passes of several starts together; None where
    every start computes its pass.
    """

    network: Network
    records: tuple[tuple[Array, Array], ...]
    options: TrainingOptions = TrainingOptions()
    threads: int = 1
    batch_queue: BatchQueue | None = None

    @property
    def washout(self) -> int:
        return self.options.washout

    @property
    def plain(self) -> bool:
        return self.options.plain

    @property
    def samples(self) -> int:
        return sum(len(t) - self.washout for _, t in self.records)

    def counted_samples(self, errors: Errors) -> float:
        """Samples that alpha and beta count."""
        return (
            sum(effective_samples(e) for e in errors.each)
            if self.options.independent
            else float(self.samples)
        )

    def errors(self, weights: Array) -> Errors:
        """Added up as `projected` does where that solves for weights: to the last bit."""
        linear = self.network.linear
        with np.errstate(all="ignore"):
            if linear.start == linear.stop:
                return self._left([self.network.simulate(weights, u) for u, _ in self.records])
            # A step is accepted by comparing these errors with those of `projected`, so that both
            # must add up in the same order.
            features = tuple(self.network.features(weights, u) for u, _ in self.records)
            return self._left([f @ weights[linear] for f in features], features)

    def _left(self, outputs: Sequence[Array], features: tuple[Array, ...] = ()) -> Errors:
        pairs = zip(outputs, self.records, strict=True)
        return Errors(tuple((t - y)[self.washout :] for y, (_, t) in pairs), features)

    def projected(self, weights: Array, evidence: Evidence) -> tuple[Array, Errors]:
        """The weights with those in which the output is linear at the minimum of F for the others,
        and the errors."""
        network, linear = self.network, self.network.linear
        count = linear.stop - linear.start
        if not count or self.plain:
            return weights, self.errors(weights)
        gram, right = np.zeros((count, count)), np.zeros(count)
        with np.errstate(all="ignore"):
            features = tuple(network.features(weights, u) for u, _ in self.records)
            for f, (_, t) in zip(features, self.records, strict=True):
                # The minimum over the counted samples only: the washout is no part of F.
                rows = f[self.washout :]
                gram, right = gram + rows.T @ rows, right + rows.T @ t[self.washout :]
            if not np.isfinite(gram).all():
                return weights, Errors((np.array([np.inf]),))
            weights = weights.copy()
            weights[linear] = solve_damped(
                evidence.beta * gram, evidence.alpha, evidence.beta * right
            )
            return weights, self._left([f @ weights[linear] for f in features], features)

    def growth(self, weights: Array, errors: Errors) -> float:
        """The network's `growth` over all recordings, of a run that had these errors."""
        with np.errstate(all="ignore"):
            return sum((self.network.growth(weights, f) for f in errors.features), start=0.0)

    def curvature(self, weights: Array, step: Array) -> Array | None:
        """J' times the second derivative of the output along `step`; None where that overflows."""
        total = np.sum(
            [self.network.curvature(weights, step, u, self.washout) for u, _ in self.records],
            axis=0,
        )
        return np.asarray(total) if np.isfinite(total).all() else None

    def evaluate(self, weights: Array) -> tuple[float, Array, Array] | None:
        """Sums over all recordings; None where weights are so wild that a number overflows."""
        sse, jtj, jte = 0.0, np.zeros((len(weights), len(weights))), np.zeros(len(weights))
        for i, (u, t) in enumerate(self.records):
            part = (
                self.network.normal_equations(weights, u, t, self.washout, self.threads)
                if self.batch_queue is None
                else self.batch_queue.normal_equations(i, weights)
            )
            sse, jtj, jte = sse + part[0], jtj + part[1], jte + part[2]
        return (
            (sse, jtj, jte)
            if np.isfinite(sse) and np.isfinite(jtj).all() and np.isfinite(jte).all()
            else None
        )

    def spectrum(self, weights: Array, evidence: Evidence) -> Spectrum | None:
        """J by its singular values, down to what matters next to alpha, from a separate pass of the
        compiled kernels; None where J'J holds as much after all."""
        sums = RootSums(len(weights), evidence.alpha / evidence.beta)
        for u, t in self.records:
            self.network.add_to(sums, weights, u, t, self.washout, self.threads)
        return sums.spectrum()


def recordings(inputs: object, target: object) -> tuple[tuple[Array, Array], ...]:
    """A recording or several as pairs of contiguous arrays, inputs (N, m) and target (N,)."""
    several = isinstance(inputs, list | tuple)
    us, ts = (inputs, target) if several else ([inputs], [target])
    return tuple(
        (np.ascontiguousarray(u, dtype=np.float64), np.ascontiguousarray(t, dtype=np.float64))
        for u, t in zip(us, ts, strict=True)  # type: ignore[call-overload]
    )


def check_problem(problem: TrainingProblem) -> None:
    """DataError where there is nothing to fit, or less data than weights."""
    for name, low in {"iterations": 0, "starts": 1, "seed": 0, "washout": 0}.items():
        value = getattr(problem.options, name)
        if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < low:
            raise DataError(
                f"Training needs {name} to be a whole number of at least {low}, not {value!r}."
            )
    shortest = min(len(t) for _, t in problem.records)
    if shortest <= problem.washout:
        raise DataError(
            f"A washout of {problem.washout} samples leaves nothing of a recording of {shortest}."
        )
    # Regularisation would still give an answer, but an answer that the prior alone decides.
    if problem.samples < problem.network.n_weights:
        raise DataError(
            f"{problem.samples} samples cannot decide {problem.network.n_weights} weights.",
            "Record longer, shorten the washout, or reduce the hidden units.",
        )


def fingerprint(problem: TrainingProblem) -> str:
    """Identify the training of a checkpoint. The length of the training and the number of cores are
    not part of it."""
    digest, o = hashlib.sha256(), problem.options
    for u, t in problem.records:
        # With the shape, because the same bytes can be cut into other columns.
        digest.update(repr(u.shape).encode() + u.tobytes() + t.tobytes())
    flags = int(o.washout), bool(o.regularise), bool(o.independent)
    begun = bool(o.plain), int(o.seed), int(o.starts)
    digest.update(repr((problem.network, *flags, o.damping, o.goals, *begun)).encode())
    return digest.hexdigest()
