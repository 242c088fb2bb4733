"""CPU time of one training pass of the paper's Elman network (5-10-1, 171 weights, 66667 samples).

    OMP_NUM_THREADS=1 python benchmarks/elman_pass.py

Everything is measured in this process, on one core: the pass with exact derivatives, the forward simulation that a
trial step costs, a whole accepted iteration, the matrix product rate the machine reaches, and the same pass by
automatic differentiation (torch.func.jacfwd). The latter runs on a short record and is scaled up, and says so.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Callable

import numpy as np

from pamid.networks.bayes import Evidence, effective_weights, solve_damped
from pamid.networks.elman import Elman
from pamid.networks.training import train

SAMPLES = 66_667  # 200 s at 3 ms
PAPER_SECONDS = 36_101 / 5_000  # Table I: 5000 iterations
TORCH_SAMPLES = 4_000
TORCH_SAMPLES_SHORT = 1_000


def cpu_seconds(call: Callable[[], object], repeats: int = 5) -> float:
    """The fastest of several calls."""
    best = float("inf")
    for _ in range(repeats):
        begun = time.process_time()
        call()
        best = min(best, time.process_time() - begun)
    return best


def dgemm_rate() -> float:
    """Floating-point operations per second of a square matrix product."""
    a = np.random.default_rng(0).normal(size=(1000, 1000))
    return 2.0 * 1000**3 / cpu_seconds(lambda: a @ a)


def torch_pass_seconds(network: Elman, weights: np.ndarray, u: np.ndarray, target: np.ndarray) -> float:
    """CPU seconds of Jacobian, J'J and J'e by forward-mode automatic differentiation."""
    import torch

    torch.set_num_threads(1)
    h, m = network.hidden, network.inputs
    rows, wanted = torch.from_numpy(u), torch.from_numpy(target)

    def output(flat):
        units = flat[: -h - 1].reshape(h, h + m + 1)
        drive = rows @ units[:, h:-1].T + units[:, -1]
        x, states = torch.zeros(h, dtype=torch.float64), []
        for k in range(len(rows)):
            x = torch.tanh(units[:, :h] @ x + drive[k])
            states.append(x)
        return torch.stack(states) @ flat[-h - 1 : -1] + flat[-1]

    def one_pass():
        flat = torch.from_numpy(weights)
        jacobian, error = torch.func.jacfwd(output)(flat), wanted - output(flat)
        return jacobian.T @ jacobian, jacobian.T @ error

    jtj = one_pass()[0].numpy()
    assert np.allclose(jtj, network.normal_equations(weights, u, target)[1], rtol=1e-9, atol=1e-9)
    return cpu_seconds(one_pass, repeats=2)


def main() -> None:
    network = Elman()
    draw = np.random.default_rng(0)
    u = np.repeat(draw.uniform(-1.0, 1.0, (SAMPLES // 200 + 1, 5)), 200, axis=0)[:SAMPLES]
    teacher = network.simulate(0.3 * np.random.default_rng(1).normal(size=network.n_weights), u)
    target = teacher / np.abs(teacher).max() + 0.02 * draw.normal(size=SAMPLES)
    weights = network.initial(2)
    _, jtj, jte = network.normal_equations(weights, u, target)

    rate = dgemm_rate()
    one_pass = cpu_seconds(lambda: network.normal_equations(weights, u, target))
    simulation = cpu_seconds(lambda: network.simulate(weights, u))
    algebra = cpu_seconds(lambda: (solve_damped(jtj, 1.0, jte), effective_weights(Evidence(0.0, 1.0, 1.0), jtj.copy())))
    begun = time.process_time()
    training = train(network, u, target, iterations=20)
    iteration = (time.process_time() - begun) / len(training.trace["mse"])

    n, h, carried = network.n_weights, network.hidden, network.n_weights - network.hidden - 1
    # carrying S, slope and output row over the columns, and the symmetric product
    operations = 2.0 * SAMPLES * carried * (h * h + 1.5 * h) + SAMPLES * n * (n + 1)
    short, long = (
        torch_pass_seconds(network, weights, u[:k], target[:k]) for k in (TORCH_SAMPLES_SHORT, TORCH_SAMPLES)
    )
    per_sample = long / TORCH_SAMPLES

    print(f"Elman {network.inputs}-{h}-1, {n} weights, N = {SAMPLES}, float64, one core, CPU seconds")
    print(f"  dgemm of this process                     {rate / 1e9:9.1f} GF/s")
    share = operations / one_pass / rate
    print(f"  pass: sse, J'J, J'e, exact derivatives    {one_pass:9.4f} s   {share:.0%} of dgemm")
    print(f"  trial step: simulation alone              {simulation:9.4f} s")
    print(f"  linear algebra of a step                  {algebra:9.4f} s")
    print(f"  whole iteration (mean of {len(training.trace['mse'])}, all trials)  {iteration:9.4f} s")
    print(f"  the paper's 7.22 s (another machine)      {PAPER_SECONDS / iteration:9.1f} times the iteration above")
    print(f"  torch jacfwd, measured at N = {TORCH_SAMPLES_SHORT}        {short:9.4f} s")
    print(f"  torch jacfwd, measured at N = {TORCH_SAMPLES}        {long:9.4f} s")
    print(f"  torch jacfwd, SCALED linearly to N        {per_sample * SAMPLES:9.1f} s   not measured at N")
    print(f"  scaled torch pass / our pass              {per_sample * SAMPLES / one_pass:9.1f} times")


if __name__ == "__main__":
    main()
