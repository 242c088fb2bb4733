"""Gamma and steps where J'J in 16 digits holds too little, against arithmetic in 100 digits."""

import mpmath
import numpy as np
import pytest
from scipy.linalg import eigh

from pamid.networks.bayes import Evidence, effective_weights, resolved
from pamid.networks.elman import Elman
from pamid.networks.root_sums import LOST, RootSums, Spectrum

DIGITS = 100


def solved_exactly(jacobian, error, weights, evidence, mu=0.0):
    """(gamma, step) from beta J'J + (alpha + mu) I, inverted in 100 digits."""
    with mpmath.workdps(DIGITS):
        rows, n = mpmath.matrix(jacobian.tolist()), jacobian.shape[1]
        alpha, beta = mpmath.mpf(evidence.alpha), mpmath.mpf(evidence.beta)
        hessian, unit = beta * rows.T * rows, mpmath.eye(n)
        undecided = mpmath.inverse(hessian + alpha * unit)
        gamma = n - alpha * sum(undecided[i, i] for i in range(n))
        gradient = beta * rows.T * mpmath.matrix(error.tolist())
        gradient -= alpha * mpmath.matrix(weights.tolist())
        step = mpmath.lu_solve(hessian + (alpha + mpmath.mpf(mu)) * unit, gradient)
        return float(gamma), np.array([float(x) for x in step])


def summed(jacobian, error, finest, chunk):
    sums = RootSums(jacobian.shape[1], finest)
    for k in range(0, len(error), chunk):
        sums.add(jacobian[k : k + chunk], error[k : k + chunk])
    return sums


def close_columns(n=8, rows=60, apart=1e-9, seed=0):
    """Every other column is its neighbour but for one part in 1e9: J'J holds nothing of the
    difference."""
    draw = np.random.default_rng(seed)
    jacobian = draw.normal(size=(rows, n))
    jacobian[:, 1::2] = jacobian[:, ::2] + apart * jacobian[:, 1::2]
    return jacobian * 1e3, draw.normal(size=rows), draw.normal(size=n)


def rank_above_rounding(evidence, jtj):
    """What stood here before: only eigenvalues above n eps trace are counted."""
    values = eigh(evidence.beta * jtj, eigvals_only=True)
    values = values[values > len(jtj) * np.finfo(float).eps * evidence.beta * np.trace(jtj)]
    return float(np.sum(values / (values + evidence.alpha)))


@pytest.mark.parametrize("alpha", [1e-13, 1e-11, 1e-9])
@pytest.mark.parametrize("chunk", [7, 60])
def test_gamma_and_step_of_columns_that_rounding_cannot_tell_apart(alpha, chunk):
    jacobian, error, weights = close_columns()
    evidence = Evidence(8.0, alpha, 1.0)
    gamma, step = solved_exactly(jacobian, error, weights, evidence, mu=alpha)
    assert not resolved(evidence, jacobian.T @ jacobian)
    found = summed(jacobian, error, alpha, chunk).spectrum()
    assert isinstance(found, Spectrum)
    assert effective_weights(evidence, found) == pytest.approx(gamma, abs=8 * LOST)
    moved = found.step(1.0, alpha, alpha, weights)
    assert np.linalg.norm(jacobian @ (moved - step)) < 1e-3 * np.linalg.norm(jacobian @ step)
    assert 4.1 < gamma < 8.0 or alpha == 1e-13
    assert rank_above_rounding(evidence, jacobian.T @ jacobian) == pytest.approx(4.0, abs=1e-6)


def test_gamma_of_a_recurrent_network_at_the_edge_of_stability():
    """Poles at 0.999 and states that hardly bend: sensitivities in a ratio of 1e6, J from the
    network's own sweep."""
    network, draw = Elman(1, 3), np.random.default_rng(2)
    layers = network.layers(network.initial(0))
    layers.units[:, :3] = np.diag([0.999, 0.9989, 0.5])
    layers.units[:, 3:] *= 1e-6
    weights = network.flatten(layers)
    u = draw.uniform(-1.0, 1.0, (400, 1))
    jacobian = network.jacobian(weights, u)
    target = draw.normal(size=400)
    evidence = Evidence(float(network.n_weights), 1e-14, 1e3)
    gamma, _ = solved_exactly(
        jacobian, target - network.simulate(weights, u), np.zeros(len(weights)), evidence
    )
    sums = RootSums(network.n_weights, evidence.alpha / evidence.beta)
    network.add_to(sums, weights, u, target)
    spectrum = sums.spectrum()
    assert spectrum is not None
    assert effective_weights(evidence, spectrum) == pytest.approx(
        gamma, abs=network.n_weights * LOST
    )
    assert gamma - rank_above_rounding(evidence, jacobian.T @ jacobian) > 1.0


def test_sums_are_those_of_the_whole_record():
    draw = np.random.default_rng(3)
    jacobian, error = draw.normal(size=(300, 5)), draw.normal(size=300)
    plain = summed(jacobian, error, 0.0, 64)
    assert plain.spectrum() is None
    np.testing.assert_allclose(plain.jtj, jacobian.T @ jacobian, rtol=1e-12)
    root = summed(jacobian, error, 1e-30, 64)
    found = root.spectrum()
    np.testing.assert_allclose(found.values, np.linalg.svd(jacobian)[1], rtol=1e-12)
    scaled = found.vectors * found.values
    np.testing.assert_allclose(scaled @ scaled.T, jacobian.T @ jacobian, atol=1e-10)
    np.testing.assert_allclose(scaled @ found.along, jacobian.T @ error, atol=1e-10)
    assert root.sse == pytest.approx(error @ error)
