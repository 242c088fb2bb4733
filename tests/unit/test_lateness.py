"""What a check takes for late."""

from __future__ import annotations

import dataclasses

import numpy as np
import one_cart
import pytest

from pamid.checks.recording_quality import examine


@pytest.mark.parametrize("time", [1.0, 200.0, 1.0 / 200.0])
def test_late_is_late_at_any_pace(time: float) -> None:
    """Neither what counts as late nor how far is looked is a matter of the unit of time."""
    written = one_cart.Written(time=time)
    recording, rig = one_cart.recorded(written), one_cart.cart(written)
    moved = {**recording.columns, "place": np.roll(recording.columns["place"], 4)}
    late = dataclasses.replace(recording, columns=moved)
    shifts = [
        issue.figures["delay_s"] / given.sampling_period_s
        for given in (recording, late)
        for issue in examine(given, rig)
        if issue.kind == "delay"
    ]
    # a cart heavier than its data sheet is late by itself
    assert shifts == pytest.approx([8.0, 12.0], abs=1.1)
