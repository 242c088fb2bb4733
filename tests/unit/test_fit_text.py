"""What `pamid fit` prints of its parameters, and spans of time in words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pamid_cli.fit import fit_text

from pamid.base.share_words import minutes_text


def line_of(**parameter: Any) -> str:
    one = {"value": 0.4, "low": 0.0, "high": 0.9, "word": "settled", "strain": 0.2}
    found = {
        "parameters": {"play:half_gap_rad": one | {"at_bound": None} | parameter},
        "recordings": [{"period_s": 0.01}],
        "tied": [],
        "mae": {},
        "converged": True,
    }
    lines = fit_text(found, Path("run")).splitlines()
    return next(line for line in lines if line.startswith("play:half_gap_rad"))


def test_an_effect_whose_interval_holds_its_null_is_not_just_settled() -> None:
    assert line_of(null=0.0).endswith("settled, not told from 0, at which the effect vanishes")
    assert line_of(null=0.0, low=0.1).endswith("settled")
    assert line_of().endswith("settled")


@pytest.mark.parametrize(
    ("minutes", "text"), [(8.0, "8 min"), (1.0, "1 min"), (0.67, "40 s"), (0.0017, "0.1 s")]
)
def test_short_experiments_are_told_in_seconds(minutes: float, text: str) -> None:
    assert minutes_text(minutes) == text
