"""How long the first paper's training job takes from random starts: 200 s of the twin, Elman
5-10-1, best of 4 starts.

    python benchmarks/paper_training.py [--seconds 60] [--iterations 2000] [--seed 0]

Trains for so many seconds by the clock, notes where it stands, goes on from its checkpoint until it
settles, and prints how far the early error is from the last one: the target is 2 % after 60 s on
two cores.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path

from threadpoolctl import threadpool_limits

from pamid.networks.elman import Elman
from pamid.networks.network_training import Training, TrainingStep
from pamid.networks.trained_network import train_on_signals
from pamid.replications.joint_paper import JointPlan, record_twin, residual_data_of
from pamid.replications.joint_twin import PERIOD_S, Twin

STARTS = 4


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--iterations", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1, "blas"):
        one = residual_data_of(record_twin(Path(folder), Twin(), JointPlan(seed=options.seed)))
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
                iterations=options.iterations,
                seed=options.seed,
                starts=STARTS,
                threads=os.cpu_count() or 1,
                checkpoint=Path(folder) / "checkpoint.npz",
                **more,
            )[1]

        early = go(progress=watch)
        spent = time.perf_counter() - begun
        late = go(resume=True)
        settled = time.perf_counter() - begun
    mse, best = early.trace["mse"][-1], late.trace["mse"][-1]
    print(
        f"{os.cpu_count()} cores, {STARTS} starts, {early.samples} samples, load "
        f"{os.getloadavg()[0]:.1f}"
    )
    print(
        f"  after {spent:6.1f} s   MSE {mse:.4e} at iteration {len(early.trace['mse']) - 1} of "
        f"start {early.best}"
    )
    print(
        f"  after {settled:6.1f} s   MSE {best:.4e} at iteration {len(late.trace['mse']) - 1}: "
        f"{late.why}"
    )
    print(f"  the early one is {mse / best - 1.0:.1%} above the last one (target: 2 % after 60 s)")
    within = next(k for k, value in enumerate(late.trace["mse"]) if value <= 1.02 * best)
    print(f"  within 2 % from iteration {within} on")


if __name__ == "__main__":
    main()
