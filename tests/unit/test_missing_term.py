"""missing.csv, and the words of a missing term's formula."""

import numpy as np

from pamid.base.run_files import read_columns
from pamid.diagnosis.verdict.remainder import MISSING_ROWS, Missing, missing_csv


def missing(count: int) -> Missing:
    """A force against the direction of motion."""
    random = np.random.default_rng(2)
    velocity = random.normal(0.0, 30.0, count)
    signals = {"velocity": velocity, "contraction": random.uniform(0.03, 0.17, count)}
    units = {"value": "N", "velocity": "deg/s", "contraction": ""}
    return Missing(
        "muscle",
        np.repeat([0, 1], [count - count // 3, count // 3]),
        28.0 + 0.05 * np.arange(count),
        -0.4 * np.sign(velocity),
        signals,
        units,
        [],
        np.zeros(0),
        np.zeros(0),
        1.0,
        0.3,
        8.0,
    )


def test_the_points_come_with_their_units(tmp_path):
    m = missing(300)
    (tmp_path / "missing.csv").write_bytes(missing_csv(m))
    found = read_columns(tmp_path / "missing.csv")
    assert found is not None
    assert list(found) == ["time_s", "recording", "velocity_deg_per_s", "contraction", "missing_n"]
    np.testing.assert_allclose(found["missing_n"], m.values)
    np.testing.assert_allclose(found["velocity_deg_per_s"], m.signals["velocity"], rtol=1e-8)
    assert found["recording"].tolist() == m.recording.tolist()


def test_long_recordings_are_thinned_evenly(tmp_path):
    (tmp_path / "missing.csv").write_bytes(missing_csv(missing(9001)))
    found = read_columns(tmp_path / "missing.csv")
    assert found is not None and 0.5 < len(found["time_s"]) / MISSING_ROWS <= 1.0
    np.testing.assert_allclose(np.diff(found["time_s"]), 3 * 0.05)
