"""A signal that is made of measured outputs alone is known from these."""

from __future__ import annotations

import numpy as np

from pamid.simulation.measured_signals import measured_signals


def test_a_difference_of_two_readings_is_measured() -> None:
    random = np.random.default_rng(0)
    outputs = random.standard_normal((400, 2))
    stretch, speed = outputs[:, 0] - outputs[:, 1], random.standard_normal(400)
    measured = 3.0 * random.standard_normal((50, 2))
    measured[7, 1] = np.nan
    found = measured_signals(outputs, np.column_stack([stretch, speed, 0.0 * speed]), measured)
    expected = measured[:, 0] - measured[:, 1]
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-9)
    assert np.isnan(found[:, 1:]).all() and np.isnan(found[7, 0])


def test_a_bent_reading_tells_nothing() -> None:
    x = np.linspace(-1.0, 1.0, 200)[:, None]
    assert np.isnan(measured_signals(x**3, x, x)).all()
