"""Stamps with few digits come from an even clock, or they do not."""

import math
from pathlib import Path

import numpy as np
import pytest

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.recording.file_checks import check_stamps, even_but_rounded
from pamid.recording.recording import read_recording


def clock(period: float, count: int = 3000, start: float = 0.0) -> Array:
    return start + period * np.arange(count, dtype=np.float64)


@pytest.mark.parametrize(
    ("period", "decimals"), [(1 / 300, 4), (1 / 3000, 4), (1 / 30, 2), (1 / 128, 3), (0.0125, 3)]
)
def test_a_rounded_even_clock_is_even(period, decimals, tmp_path):
    for start in (0.0, 17.23, -3.0):
        for stamps in (
            np.round(clock(period, start=start), decimals),
            np.floor(clock(period, start=start) * 10**decimals + 1e-6) / 10**decimals,
        ):
            assert even_but_rounded(stamps)
            check_stamps(tmp_path / "rec.csv", stamps)


@pytest.mark.parametrize(
    ("period", "decimals", "stray"), [(1 / 300, 4, 2e-4), (1 / 300, 6, 5e-5), (0.003, 4, 1e-4)]
)
def test_real_jitter_is_none_of_rounding(period, decimals, stray, tmp_path):
    """More than the last digit explains, in one stamp alone."""
    stamps = np.round(clock(period), decimals)
    stamps[1234] += stray
    assert not even_but_rounded(stamps)
    with pytest.raises(FileError) as caught:
        check_stamps(tmp_path / "rec.csv", _written(tmp_path, stamps))
    assert caught.value.code == "stamps-uneven"


def test_a_clock_that_changes_its_rate_is_not_even(tmp_path):
    stamps = np.concatenate([clock(1 / 300), clock(1 / 290, 1000, start=10.0)])
    assert not even_but_rounded(np.round(stamps, 4))


def test_the_recording_has_the_period_of_the_clock(tmp_path):
    path = tmp_path / "rec.csv"
    _written(tmp_path, np.round(clock(1 / 300), 4))
    assert read_recording(path).sampling_period_s == pytest.approx(1 / 300, rel=1e-5)


def _written(folder: Path, stamps: Array) -> Array:
    """The stamps, after a file was made of them: an error names its line."""
    rows = "".join(f"{t!r},{math.sin(t)!r}\n" for t in stamps.tolist())
    (folder / "rec.csv").write_text(f"time_s,angle_deg\n{rows}", encoding="utf-8")
    return stamps
