"""What the exact derivative is worth: the same training with a derivative that ignores the
recurrence.

    OMP_NUM_THREADS=1 python benchmarks/peers/static_derivative.py [--samples 10000] [--iterations
    80] [--starts 4]

The static derivative takes the fed-back state x(k) for a given input, as MATLAB's elmannet is
documented to do. Both train by the same loop from the same starts on a teacher network's answer
with 2 % noise (variance 4e-4: the floor).
"""

import argparse
import os
from collections.abc import Iterator

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from measuring import teacher_record
from numpy.typing import ArrayLike, NDArray

from pamid.networks.elman import Elman
from pamid.networks.network import Records, Rows
from pamid.networks.network_training import train
from pamid.networks.training_problem import TrainingOptions

Array = NDArray[np.float64]
NOISE = 0.02


class RandomElman(Elman):
    """An Elman network that begins at random weights whatever the data."""

    def start(self, records: Records, washout: int, seed: int) -> Array:
        return self.initial(seed)


class StaticElman(RandomElman):
    """An Elman network whose derivative stops at x(k); it simulates as any other."""

    def sweep(self, weights: ArrayLike, inputs: ArrayLike) -> Iterator[Rows]:
        """The exact sweep's rows hold the state as derivative of the output weights; the rest is
        made from it."""
        h, out = self.hidden, self.layers(weights).output
        u, last = self.table(inputs), np.zeros((1, h))
        for start, y, jacobian in super().sweep(weights, inputs):
            n = len(y)
            after = jacobian[:, -h - 1 : -1].copy()
            seen = np.hstack([np.vstack([last, after[:-1]]), u[start : start + n], np.ones((n, 1))])
            # wild trial weights may overflow, as in the exact sweep
            with np.errstate(all="ignore"):
                slope = out * (1.0 - after**2)
                jacobian[:, : -h - 1] = (slope[:, :, None] * seen[:, None, :]).reshape(n, -1)
            last = after[-1:]
            yield start, y, jacobian


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, default in (("samples", 10_000), ("iterations", 80), ("starts", 4)):
        parser.add_argument(f"--{name}", type=int, default=default)
    options = parser.parse_args()
    u, target = teacher_record(options.samples, NOISE)
    print(
        f"N = {options.samples}, at most {options.iterations} steps, noise variance {NOISE**2:.1e}"
    )
    print(f"{'start':5s} {'exact mse':>11s} {'static mse':>11s} {'ratio':>6s}   ended")
    for seed in range(options.starts):
        exact, static = (
            train(n, u, target, options=TrainingOptions(iterations=options.iterations, seed=seed))
            for n in (RandomElman(), StaticElman())
        )
        mse = [t.trace["mse"][-1] for t in (exact, static)]
        print(
            f"{seed:5d} {mse[0]:11.3e} {mse[1]:11.3e} {mse[1] / mse[0]:6.2f}   "
            f"exact: {exact.why} ({len(exact.trace['mse']) - 1}); "
            f"static: {static.why} ({len(static.trace['mse']) - 1})",
            flush=True,
        )


if __name__ == "__main__":
    main()
