"""Training the paper's Elman network (5-10-1, 171 weights, 66667 samples): pass, iteration, memory,
second core, torch.

    python benchmarks/elman_pass.py [--device cpu] [--device cuda] [--starts 1 --starts 64]

All in one process, on one core but for the last lines: the pass with exact derivatives and the
share it reaches of the rate of a matrix product measured in the same process, the simulation that a
trial step costs, a whole accepted iteration with all its trials, peak memory, and the gain by a
second core. With --device only the passes of torch for Elman and NARX, next to those of the
compiled kernels. Peers: elman_peers.py.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from peers.measuring import Stamps, cpu_seconds, dgemm_rate, peak_mb, teacher_record

from pamid.base.arrays import Array
from pamid.networks.bayes import Evidence, effective_weights, resolved, solve_damped
from pamid.networks.elman import Elman
from pamid.networks.narx import Narx
from pamid.networks.network_training import train
from pamid.networks.root_sums import RootSums, Spectrum
from pamid.networks.torch_passes import engine_on
from pamid.networks.training_problem import TrainingOptions

SAMPLES = 66_667  # 200 s at 3 ms
PAPER_SECONDS = 36_101 / 5_000  # Table I: 5000 iterations
ROUNDS = 15


def wall_seconds(call: Callable[[], object], rounds: int = ROUNDS) -> float:
    """The fastest of several calls, by the clock."""
    taken = []
    for _ in range(rounds):
        begun = time.perf_counter()
        call()
        taken.append(time.perf_counter() - begun)
    return min(taken)


def operations(network: Elman, samples: int) -> float:
    """Of a pass: carrying S and the output's row over its columns, and the symmetric product."""
    n, h = network.n_weights, network.hidden
    carried = n - h - 1
    return samples * (2.0 * carried * (h * h + h) + n * (n + 1.0))


def root_pass(network: Elman, weights: Array, u: Array, target: Array) -> Spectrum | None:
    """The pass that keeps what J'J loses, all of it in the coordinates of the root."""
    sums = RootSums(network.n_weights, 1e-20)
    network.add_to(sums, weights, u, target)
    return sums.spectrum()


def on_one_core() -> dict[str, float]:
    """CPU seconds, the rate of dgemm (flop/s), and the pass's share of it."""
    network = Elman()
    u, target = teacher_record(SAMPLES)
    weights = network.initial(2)
    _, jtj, jte = network.normal_equations(weights, u, target)
    stamps = Stamps()
    training = train(network, u, target, options=TrainingOptions(iterations=19, progress=stamps))
    iteration, memory = stamps.step["cpu_s"], peak_mb()
    rates = [dgemm_rate(ROUNDS)]
    one_pass = cpu_seconds(lambda: network.normal_equations(weights, u, target), ROUNDS)
    rates.append(dgemm_rate(ROUNDS))
    begin = Evidence(0.0, 1.0, 1.0)
    rate = float(np.median(rates))
    return {
        "dgemm": rate,
        "pass": one_pass,
        "share": operations(network, SAMPLES) / one_pass / rate,
        "simulation": cpu_seconds(lambda: network.simulate(weights, u), ROUNDS),
        "algebra": cpu_seconds(
            lambda: (solve_damped(jtj, 1.0, jte), effective_weights(begin, jtj)), ROUNDS
        ),
        "check": cpu_seconds(lambda: resolved(begin, jtj), ROUNDS),
        "with_root": cpu_seconds(lambda: root_pass(network, weights, u, target), ROUNDS),
        "iteration": iteration,
        "trials": float(training.trace["trials"][1:].mean()),
        "memory_mb": memory,
    }


def on_two_cores() -> dict[str, float]:
    """By the clock: how many times faster a pass, and two starts, are on two cores than on one."""
    network = Elman()
    u, target = teacher_record(SAMPLES)
    weights = network.initial(2)
    alone, both = (
        wall_seconds(lambda k=k: network.normal_equations(weights, u, target, 0, k)) for k in (1, 2)
    )
    races = []
    for threads in (1, 2):
        begun = time.perf_counter()
        train(network, u, target, options=TrainingOptions(iterations=10, starts=2, threads=threads))
        races.append(time.perf_counter() - begun)
    return {"pass": alone / both, "starts": races[0] / races[1]}


def each_start(method: Callable[..., Any], weights: Array, *record: Array) -> list[Any]:
    """Results of a network's method, start by start."""
    return [method(w, *record) for w in weights]


def by_torch(device: str, batches: Sequence[int]) -> None:
    """By the clock, as a device computes beside the processor: pass and simulation of several
    starts by torch and by the compiled kernels, the largest relative difference of J'e, and the
    error that a training reaches."""
    print(
        f"N = {SAMPLES}, torch on {device}; s by the clock, one core; load {os.getloadavg()[0]:.1f}"
    )
    print(
        f"  {'':18s} {'pass':>8s} {'compiled':>9s} {'simulate':>9s} {'compiled':>9s} {'differ':>9s}"
    )
    for network in (Elman(), Narx()):
        u, target = teacher_record(SAMPLES)
        engine = engine_on(device, network)
        for starts in batches:
            weights = np.stack([network.initial(seed) for seed in range(starts)])
            calls = (
                partial(engine.normal_equations, weights, u, target),
                partial(each_start, network.normal_equations, weights, u, target),
                partial(engine.simulate, weights, u),
                partial(each_start, network.simulate, weights, u),
            )
            seconds = [wall_seconds(call, 3) for call in calls]
            sums, compiled = calls[0]()[2], np.array([part[2] for part in calls[1]()])
            differ = np.max(np.abs(sums - compiled)) / np.max(np.abs(compiled))
            figures = "".join(f" {s:9.4f}" for s in seconds)
            print(f"  {network.kind:6s} {starts:3d} starts {figures} {differ:9.1e}")
        ends = [
            train(
                network,
                u[:10_000],
                target[:10_000],
                engine=e,
                options=TrainingOptions(iterations=20),
            ).starts_mse[0]
            for e in (engine, None)
        ]
        print(f"  {network.kind:6s} 20 steps, MSE {ends[0]:.4g}, compiled {ends[1]:.4g}")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--device", action="append", default=[])
    parser.add_argument("--starts", action="append", type=int, help="of a batch of torch")
    options = parser.parse_args()
    for device in options.device:
        by_torch(device, options.starts or (1, 8))
    if options.device:
        return
    one, two = on_one_core(), on_two_cores()
    print(
        f"Elman 5-10-1, {Elman().n_weights} weights, N = {SAMPLES}, float64; CPU s; load "
        f"{os.getloadavg()[0]:.1f}"
    )
    for words, seconds, remark in (
        ("pass: sse, J'J, J'e, exact derivatives", one["pass"], f"{one['share']:.0%} of dgemm"),
        ("trial step: simulation alone", one["simulation"], ""),
        (
            "is J'J good enough for gamma and the step?",
            one["check"],
            f"{one['check'] / one['pass']:.1%} of a pass",
        ),
        (
            "where it is not: one more pass, by the root",
            one["with_root"],
            f"{one['with_root'] / one['pass']:.2f} passes, singular values included",
        ),
        ("linear algebra of a step", one["algebra"], ""),
        (
            f"whole iteration, {one['trials']:.1f} trials on average",
            one["iteration"],
            f"{one['iteration'] / one['pass']:.2f} passes",
        ),
    ):
        print(f"  {words:43s} {seconds:9.4f} s   {remark}".rstrip())
    for words, figure in (
        ("dgemm of this process", f"{one['dgemm'] / 1e9:9.1f} GF/s"),
        ("peak memory of this process so far", f"{one['memory_mb']:9.0f} MB"),
        (
            "the paper's 7.22 s (another machine)",
            f"{PAPER_SECONDS / one['iteration']:9.1f} times the iteration above",
        ),
        ("two cores, by the clock: one pass", f"{two['pass']:9.2f} times faster"),
        ("two cores, by the clock: two starts", f"{two['starts']:9.2f} times faster"),
    ):
        print(f"  {words:43s} {figure}")


if __name__ == "__main__":
    main()
