"""What is sent may stand still; a sensor that does so is told of."""

import numpy as np

from pamid.base.arrays import Array
from pamid.intake.checks.recording_quality import examine, sent_columns
from pamid.model.registry import rig_named
from pamid.recording.held_signal import held_by_jumps
from pamid.recording.recording import Recording, recording_of

COUNT = 6000


def held(seed: int, least: int = 3, most: int = 30) -> Array:
    """Levels that are held for 3 to 30 samples."""
    random = np.random.default_rng(seed)
    lengths = random.integers(least, most, COUNT)
    return np.repeat(random.uniform(-1.0, 1.0, COUNT), lengths)[:COUNT]


def moving(seed: int) -> Array:
    random = np.random.default_rng(seed)
    return np.cumsum(np.cumsum(random.normal(size=COUNT))) / COUNT + 1e-3 * random.normal(
        size=COUNT
    )


def recorded(**columns: Array) -> Recording:
    return recording_of(0.002 * np.arange(COUNT), columns, name="log")


def frozen_columns(recording: Recording, rig: str | None) -> set[str]:
    issues = examine(recording, None if rig is None else rig_named(rig))
    return {
        name
        for one in issues
        if one.kind in ("frozen", "clipped", "dropped")
        for name in one.columns
    }


def test_held_set_points_are_not_frozen():
    """Neither by their name nor by their values, with a rig that does not know them or without."""
    log = recorded(
        voltage_v=held(1), angle_deg=moving(2), target_deg=held(3), wanted_rpm=100.0 * held(4)
    )
    for rig in ("servo-pendulum", None):
        sent = sent_columns(log, None if rig is None else rig_named(rig))
        assert sent == {"voltage_v", "target_deg", "wanted_rpm"}
        assert frozen_columns(log, rig) == set()


def test_a_sensor_that_froze_is_still_told_of():
    angle = moving(2)
    angle[2000:2400] = angle[2000]
    log = recorded(voltage_v=held(1), angle_deg=angle, speed_rpm=moving(5))
    for rig in ("servo-pendulum", None):
        assert "angle_deg" in frozen_columns(log, rig)


def test_a_slow_sensor_and_a_coarse_one_are_measured():
    slow = np.repeat(moving(6), 5)[:COUNT]
    coarse = np.round(np.sin(np.arange(COUNT) / 900.0) * 60.0) / 60.0
    assert not held_by_jumps(slow) and not held_by_jumps(coarse)
    assert held_by_jumps(held(7))
