"""The first paper's training: plain Levenberg-Marquardt, a random start, MATLAB's mu."""

import numpy as np

from pamid.networks.bayes import Evidence, evidence_of
from pamid.networks.elman import Elman
from pamid.networks.network_training import train
from pamid.networks.training_problem import PAPER_DAMPING, TrainingOptions


def data(n=400, seed=5):
    draw = np.random.default_rng(seed)
    u = np.repeat(draw.uniform(-1.0, 1.0, (n // 20, 2)), 20, axis=0)
    teacher = Elman(2, 2)
    y = teacher.simulate(0.6 * draw.normal(size=teacher.n_weights), u)
    return u, y / np.abs(y).max() + 0.05 * draw.normal(size=n)


def trainbr(network, u, target, steps, seed):
    """The algorithm of MATLAB's trainbr, written down once more: mean of squares aside, its sums,
    its order of updates, its mu."""
    weights = network.random_start(seed)
    n, count, mu, rows = len(weights), len(target), 0.005, []
    sse, jtj, jte = network.normal_equations(weights, u, target)
    evidence = evidence_of(n, count, sse, weights @ weights)
    for _ in range(steps):
        alpha, beta = evidence.alpha, evidence.beta
        before = beta * sse + alpha * weights @ weights
        while mu <= 1e10:
            step = np.linalg.solve(
                beta * jtj + (mu + alpha) * np.eye(n), beta * jte - alpha * weights
            )
            error = target - network.simulate(weights + step, u)
            if beta * error @ error + alpha * np.sum((weights + step) ** 2) < before:
                mu = max(0.1 * mu, 1e-20)
                break
            mu *= 10.0
        weights = weights + step
        sse, jtj, jte = network.normal_equations(weights, u, target)
        gamma = n - alpha * np.trace(np.linalg.inv(beta * jtj + alpha * np.eye(n)))
        evidence = Evidence(gamma, gamma / (2.0 * weights @ weights), (count - gamma) / (2.0 * sse))
        rows.append((sse / count, mu, gamma, evidence.alpha, evidence.beta))
    return np.array(rows)


def test_it_is_matlabs_trainbr():
    u, target = data()
    network, steps = Elman(2, 2), 8
    trace = train(
        network,
        u,
        target,
        options=TrainingOptions(iterations=steps, seed=4, plain=True, damping=PAPER_DAMPING),
    ).trace
    expected = trainbr(network, u, target, steps, 4)
    found = np.column_stack([trace[name][1:] for name in ("mse", "mu", "gamma", "alpha", "beta")])
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    # by ten and by a tenth, as often as it was tried
    np.testing.assert_allclose(
        trace["mu"][1:] / trace["mu"][:-1], 10.0 ** (trace["trials"][1:] - 2.0), rtol=1e-9
    )
