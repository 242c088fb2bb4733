"""Training the first paper's network (Elman 5-10-1, 171 weights) on what the analytic model leaves
of a twin: as the paper trained, and as pamid does, beside the paper's own figures.

    python benchmarks/paper_training.py                        # 40 s of record, a few minutes
    python benchmarks/paper_training.py --record 200 --iterations 300 --starts 1 --jobs 1
    python benchmarks/paper_training.py --full [--jobs 2]      # 200 s, 5000 and 1000 steps: hours
    python benchmarks/paper_training.py --seconds 60 --seed 0  # where it stands after so many s
    python benchmarks/paper_training.py --until 0.02           # seconds until it is within 2 %

The table: five seeds of either way on one record, lowest, median and highest of each figure. MSE is
of signals within [-1, 1]; gamma counts the weights that the data decide (J's singular values, none
dropped for its size); pole is the spectral radius of the context's weights, above 1 where the
network would run away without tanh; forgets is the time, in samples, in which a small disturbance
of the context shrinks by e along the record, infinite where it grows. Errors are of the test steps,
deg, at the inertia that was trained at and at the one never seen.

The same seed gives the same network on processors of one kind only: sums are rounded in the order
that the widest vectors ask for, and a training of hundreds of steps takes that up. The spread over
seeds is the larger by far.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from pamid.correction.output_network import train_correction
from pamid.correction.residual_data import derived
from pamid.networks.elman import Elman
from pamid.networks.network_training import Training, TrainingStep
from pamid.networks.trained_network import train_on_signals
from pamid.networks.training_problem import (
    PAPER_DAMPING,
    PAPER_ITERATIONS,
    Damping,
    TrainingOptions,
)
from pamid.replications.joint_paper import (
    ANALYTIC_MODEL,
    ELMAN,
    PUBLISHED,
    PUBLISHED_TRAINING,
    JointPlan,
    JointRecords,
    record_twin,
    residual_data_of,
)
from pamid.replications.joint_twin import ANGLE_COLUMN, PERIOD_S, TRAINED, UNSEEN, Twin

STARTS = 4
SEEDS = 5
FIGURES = (
    "mse",
    "gamma",
    "alpha",
    "gradient",
    "mu",
    "pole",
    "forgets",
    "steps",
    "cpu_s",
    TRAINED,
    UNSEEN,
)


@dataclass(frozen=True)
class Way:
    """How a network is trained."""

    name: str
    plain: bool
    damping: Damping
    iterations: int
    starts: int


def trained(records: JointRecords, way: Way, seed: int, jobs: int) -> dict[str, float]:
    """The figures of one training."""
    begun = time.process_time()
    found = train_correction(
        residual_data_of(records),
        options=TrainingOptions(
            plain=way.plain,
            damping=way.damping,
            iterations=way.iterations,
            starts=way.starts,
            seed=seed,
            threads=jobs,
        ),
    )
    spent = time.process_time() - begun
    network, trace = found.trained.network, found.training.trace
    assert isinstance(network, Elman)
    poles = np.linalg.eigvals(network.layers(found.training.weights).context)
    (own,) = found.residual.of_part(0)
    inputs = np.column_stack(list(found.residual.signals(own).values()))
    states = network.features(found.training.weights, found.trained.input_scaling.forward(inputs))
    growth = network.growth(found.training.weights, states) / len(states)
    loops, first = records.analytic, len(records.training)
    errors = {}
    for case, one in records.steps.items():
        angle = loops[case][derived(ANGLE_COLUMN, "loop")] + found.values[first : first + len(one)]
        errors[case] = float(np.abs(one.signal(ANGLE_COLUMN) - angle).mean())
        first += len(one)
    last = {name: float(trace[name][-1]) for name in ("mse", "gamma", "alpha", "gradient", "mu")}
    return {
        **last,
        "pole": float(np.abs(poles).max()),
        "forgets": -1.0 / growth if growth < 0.0 else float("inf"),
        "steps": float(trace["iteration"][-1]),
        "cpu_s": spent,
        **errors,
    }


def spread(values: Sequence[float]) -> str:
    return " .. ".join(f"{f(values):.3g}" for f in (min, np.median, max))


def table(records: JointRecords, ways: Sequence[Way], seeds: int, jobs: int) -> None:
    rows = {}
    for way in ways:
        rows[way.name] = []
        for seed in range(seeds):
            one = trained(records, way, seed * way.starts, jobs)
            rows[way.name].append(one)
            print(
                f"  {way.name}, seed {seed}: " + ", ".join(f"{k} {v:.4g}" for k, v in one.items()),
                flush=True,
            )
    paper = {
        "mse": PUBLISHED_TRAINING["mse"],
        "gamma": PUBLISHED_TRAINING["gamma"],
        "gradient": PUBLISHED_TRAINING["gradient"],
        "mu": PUBLISHED_TRAINING["mu"],
        "steps": PUBLISHED_TRAINING["iterations"],
        "cpu_s": PUBLISHED_TRAINING["seconds"],
        TRAINED: PUBLISHED[ELMAN][TRAINED],
    }
    print(f"\n{'':10s}{'paper':>10s}" + "".join(f"{way.name:>34s}" for way in ways))
    for figure in FIGURES:
        published = paper.get(figure)
        cells = [spread([one[figure] for one in rows[way.name]]) for way in ways]
        word = "" if published is None else f"{published:g}"
        print(f"{figure:10s}{word:>10s}" + "".join(f"{cell:>34s}" for cell in cells))
    for case, one in records.steps.items():
        angle = records.analytic[case][derived(ANGLE_COLUMN, "loop")]
        error = np.abs(one.signal(ANGLE_COLUMN) - angle).mean()
        print(
            f"analytic model alone, {case}: {error:.4g} deg (paper: "
            f"{PUBLISHED[ANALYTIC_MODEL][case]})"
        )


def early(records: JointRecords, options: argparse.Namespace, folder: Path) -> None:
    """How far from its end the training is after so many seconds by the clock."""
    one = residual_data_of(records)
    (own,) = one.of_part(0)
    begun = time.perf_counter()

    def watch(step: TrainingStep, start: int) -> None:
        if time.perf_counter() - begun > options.seconds:
            raise KeyboardInterrupt

    def go(**more: object) -> Training:
        return train_on_signals(
            Elman(),
            [one.signals(own)],
            [one.target[own.rows]],
            output_name=one.channel,
            period_s=PERIOD_S,
            options=TrainingOptions(
                iterations=options.iterations or 2000,
                seed=options.seed,
                starts=STARTS,
                threads=options.jobs,
                checkpoint=folder / "checkpoint.npz",
                **more,
            ),
        )[1]

    first = go(progress=watch)
    spent = time.perf_counter() - begun
    late = go(resume=True)
    settled = time.perf_counter() - begun
    mse, best = first.trace["mse"][-1], late.trace["mse"][-1]
    print(
        f"  after {spent:6.1f} s   MSE {mse:.4e} at iteration {len(first.trace['mse']) - 1} of "
        f"start {first.best}"
    )
    print(
        f"  after {settled:6.1f} s   MSE {best:.4e} at iteration {len(late.trace['mse']) - 1}: "
        f"{late.why}"
    )
    print(f"  the early one is {mse / best - 1.0:.1%} above the last one (target: 2 % after 60 s)")
    within = next(k for k, value in enumerate(late.trace["mse"]) if value <= 1.02 * best)
    print(f"  within 2 % from iteration {within} on")


def seconds_until(
    records: JointRecords, share: float, jobs: int, seed: int = 0, iterations: int = 2000
) -> dict[str, float]:
    """By the clock and in CPU seconds of all threads: from the beginning of a training of STARTS
    starts until one of them was within this share of where the best one ends, and until the end."""
    one = residual_data_of(records)
    (own,) = one.of_part(0)
    passed: list[tuple[float, float, float]] = []
    begun = time.perf_counter(), time.process_time()

    def watch(step: TrainingStep, start: int) -> None:
        passed.append(
            (step.mse, time.perf_counter() - begun[0], time.process_time() - begun[1]),
        )

    found = train_on_signals(
        Elman(),
        [one.signals(own)],
        [one.target[own.rows]],
        output_name=one.channel,
        period_s=PERIOD_S,
        options=TrainingOptions(
            iterations=iterations, seed=seed, starts=STARTS, threads=jobs, progress=watch
        ),
    )[1]
    end = float(found.trace["mse"][-1])
    clock, cpu = next((c, s) for mse, c, s in passed if mse <= (1.0 + share) * end)
    return {
        "clock": clock,
        "cpu": cpu,
        "whole_clock": time.perf_counter() - begun[0],
        "mse": end,
        "iterations": float(found.trace["iteration"][-1]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--full", action="store_true", help="the paper's record and steps")
    parser.add_argument("--record", type=float, help="length of the record, s")
    parser.add_argument("--iterations", type=int, help="most steps, of either way")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--starts", type=int, default=STARTS, help="of ours; the paper has one")
    parser.add_argument("--seconds", type=float, help="how far it is after so many seconds instead")
    parser.add_argument("--until", type=float, help="seconds until within this share of its end")
    parser.add_argument("--seed", type=int, default=0, help="of the record")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    whole = options.full or options.seconds is not None or options.until is not None
    length = options.record or (200.0 if whole else 40.0)
    most = options.iterations or (None if options.full else 60)
    ways = (
        Way("as in the paper", True, PAPER_DAMPING, most or PAPER_ITERATIONS, 1),
        Way("pamid's own", False, Damping(), most or 1000, options.starts),
    )
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1, "blas"):
        plan = JointPlan(seed=options.seed, seconds=length)
        records = record_twin(Path(folder), Twin(), plan)
        print(
            f"{length:g} s of the twin, {len(records.training)} samples, Elman 5-10-1, "
            f"{options.jobs} cores, {STARTS if options.seconds else options.starts} starts, load "
            f"{os.getloadavg()[0]:.1f}"
        )
        if options.until is not None:
            found = seconds_until(records, options.until, options.jobs, options.seed)
            print(", ".join(f"{k} {v:.4g}" for k, v in found.items()))
        elif options.seconds is not None:
            early(records, options, Path(folder))
        else:
            table(records, ways, options.seeds, options.jobs)


if __name__ == "__main__":
    main()
