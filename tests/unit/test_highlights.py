"""What a page's traces point at is found at any pace."""

from __future__ import annotations

import numpy as np
import pytest

from pamid.report.highlights import signal_along
from pamid.report.load import Residual


@pytest.mark.parametrize("period_s", [0.003, 0.003 / 200.0, 0.6])
def test_the_rate_of_a_signal_is_taken_as_well_at_any_pace(period_s: float) -> None:
    """A swing of forty samples: smoothed over a few of them, neither over none nor over all."""
    samples = np.arange(4000)
    turn = 2.0 * np.pi / 40.0
    measured = np.sin(turn * samples) + 0.01 * np.random.default_rng(0).standard_normal(4000)
    columns = {
        "time_s": period_s * samples,
        "place_m": measured,
        "place_data_sheet_m": measured,
        "place_refitted_m": measured,
    }
    found = signal_along(Residual(columns), "place_rate", samples)
    assert found is not None
    true = turn / period_s * np.cos(turn * samples)
    assert np.abs(found - true)[10:-10].mean() < 0.1 * turn / period_s
