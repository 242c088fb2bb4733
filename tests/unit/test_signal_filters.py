"""Local parabolas and Welch's periodogram, against scipy's."""

import numpy as np
import pytest
from scipy.signal import savgol_filter, welch

from pamid.recording.signal_filters import local_parabola, welch_power


@pytest.mark.parametrize("length", [5, 21])
@pytest.mark.parametrize("derivative", [0, 1])
def test_local_parabolas_are_those_of_savitzky_and_golay(length, derivative):
    y = np.random.default_rng(1).standard_normal(60)
    expected = savgol_filter(y, length, 2, deriv=derivative, delta=0.01)
    found = local_parabola(y, length, 0.01, derivative)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("segment", [64, 65, 300])
def test_power_is_that_of_welch(segment):
    y = np.random.default_rng(2).standard_normal((300, 2)) + 3.0
    _, expected = welch(y, 1.0, nperseg=segment, axis=0, detrend="constant")
    found = welch_power(y, segment)
    np.testing.assert_allclose(
        found / found.sum(), expected / expected.sum(), rtol=1e-9, atol=1e-12
    )
