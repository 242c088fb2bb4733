"""The logger of the trial's open cases: coloured noise, a jittering clock, a coarse gauge."""

import numpy as np
import pytest

from pamid.trial.logger import (
    PLAIN_LOGGER,
    Logger,
)

SAMPLES = 40_000


@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.95])
def test_noise_has_unit_variance_and_the_intended_autocorrelation(correlation):
    """r(k) = a^k; standard error of r about sqrt((1 + a^2) / (1 - a^2) / n) = 0.02 at most."""
    noise = np.asarray(
        Logger(correlation=correlation).noise(np.random.default_rng(1), (SAMPLES, 2))
    )
    for x in noise.T:
        assert np.std(x) == pytest.approx(1.0, abs=0.08)
        for lag in (1, 2, 5):
            r = np.corrcoef(x[:-lag], x[lag:])[0, 1]
            assert r == pytest.approx(correlation**lag, abs=0.06)
    assert abs(np.corrcoef(noise.T)[0, 1]) < 0.1, "each reading has noise of its own"


def test_a_plain_logger_changes_no_draw():
    """Recordings of closed cases must stay the same to the last bit."""
    one, other = np.random.default_rng(2), np.random.default_rng(2)
    assert np.array_equal(PLAIN_LOGGER.noise(one, (9, 3)), other.standard_normal((9, 3)))
    assert not PLAIN_LOGGER.delays(one, 9).any()
    assert one.random() == other.random(), "no number is drawn for a clock that does not jitter"
    assert PLAIN_LOGGER.gauged(["angle_deg"]) == ""


@pytest.mark.parametrize("bend", [-0.6, 0.0, 0.6])
def test_a_gauge_has_uneven_steps_and_no_error_of_its_own(bend):
    """Steps are finer where the calibration curve is steeper; readings stay within one step."""
    logger, low, high = Logger(gauge=0.9, gauge_steps=50.0, gauge_bend=bend), -2.0, 8.0
    x = np.linspace(low - 3.0, high + 3.0, 20_001)
    shown = logger.read_by_gauge(x, low, high)
    steps = np.diff(np.unique(np.round(shown, 9)))
    assert len(steps) < 200
    mean = (high - low) / 50.0
    first, last = mean / (1.0 - 0.5 * bend), mean / (1.0 + 0.5 * bend)
    assert steps[0] == pytest.approx(first, rel=1e-6)
    assert steps[-1] == pytest.approx(last, rel=1e-6)
    assert np.max(np.abs(shown - x)) <= 0.51 * max(first, last)
    assert logger.gauged(["level_cm", "upper_level_cm"]) == "upper_level_cm"
