"""What a check takes for late."""

from __future__ import annotations

import dataclasses

import numpy as np
import one_cart
import pytest

from pamid.checks.recording_quality import examine
from pamid.model.assembly import Assembly
from pamid.model.attachment import attach
from pamid.model.registry import effects, rig_named


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


def test_a_reading_that_is_early_is_led_by_its_slope_where_the_rig_offers_none() -> None:
    """The damper bench offers no rate of its force, which rises ever faster here: one that
    is read two samples early is two rises ahead."""
    rig = rig_named("damper-bench")
    assembly = Assembly(rig, (attach(rig, "clock-skew", effects()),))
    assert "rate" not in rig.ports["load_cell"].signals
    place = {n: i for i, n in enumerate(assembly.traced.inputs)}
    u = np.zeros((200, len(place)))
    u[:, place["position_mm"]] = 1e-7 * np.arange(200) ** 2
    force = []
    for early in (0.0, 2.0):
        given = {"clock-skew:start_s": -early * rig.period_s, "clock-skew:skew_ppm": 0.0}
        p = assembly.values(given)
        memory = assembly.program.memory(assembly.start(p), period_s=rig.period_s)
        force.append(assembly.program.run(memory, u, p, period_s=rig.period_s)[0][100:, 0])
    ahead, rise = force[1] - force[0], np.diff(force[0], append=np.nan)
    assert ahead[:-1] == pytest.approx(2.0 * rise[:-1], rel=0.05)
