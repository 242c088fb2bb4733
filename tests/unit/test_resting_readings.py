"""Rests, turning points and coarse gauges are not reported as faults; real faults are found."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pamid import Rig
from pamid.base.arrays import Array
from pamid.intake.checks.recording_quality import examine
from pamid.model.registry import rig_named
from pamid.recording.recording import Recording, read_recording, recording_of

REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"
FALSE = {"dropped", "clipped", "frozen", "bridged", "sampled-slowly", "standstill"}


def counted(values: Array, count: float) -> Array:
    """Readings of an encoder with uneven counts, to six decimals. Its error depends on the position
    alone, so that it repeats at turning points and at rest."""
    cell = np.round(values / count)
    return np.round(count * cell + 0.3 * count * np.sin(37.0 * cell), 6)


def swing(seconds: float = 14.0) -> tuple[Array, Array]:
    time = 0.0067 * np.arange(round(seconds / 0.0067))
    return time, 1.3 * np.exp(-0.05 * time) * np.cos(4.9 * time)


def kinds(time: Array, columns: dict[str, Array], rig: Rig | None = None) -> set[str]:
    return {issue.kind for issue in examine(recording_of(time, columns), rig)}


def test_turning_points_of_a_free_swing_are_no_fault():
    time, angle = swing()
    for count in (1e-3, 3e-3, 1e-2):
        reading = counted(angle, count)
        assert np.count_nonzero(np.diff(reading) == 0.0) > 10
        assert not kinds(time, {"angle_rad": reading}) & FALSE


def with_rests(
    values: Array, noise: float, moves: NDArray[np.bool_], random: np.random.Generator
) -> Array:
    """Noise while the machine moves; at rest one value, which flickers now and then."""
    flicker = random.random(values.size) < 0.1
    added = np.where(moves, random.standard_normal(values.size), flicker)
    return np.round(values + noise * added, 6)


def test_a_swing_up_that_ends_upright_is_neither_clipped_nor_frozen():
    """At the top both encoders rest at their highest values, and flicker."""
    time = 0.005 * np.arange(2000)
    done = np.clip((time - 3.0) / 4.0, 0.0, 1.0)
    rise = done * done * (3.0 - 2.0 * done)
    for seed in range(3):
        random = np.random.default_rng(seed)
        swing_1 = np.pi * rise + 0.3 * np.sin(2.0 * time) * (1.0 - rise)
        swing_2 = 0.8 * np.sin(3.1 * time) * (1.0 - rise) + 0.006 * rise
        top = 1e-3 * (time > 8.5)
        columns = {
            "torque_nm": 0.3 * np.sin(9.0 * time) + 0.01 * random.standard_normal(time.size),
            "angle_1_rad": with_rests(swing_1 + top, 2e-4, time < 8.5, random),
            "angle_2_rad": with_rests(swing_2 + top, 2e-4, time < 8.5, random),
        }
        assert not kinds(time, columns) & FALSE


@pytest.mark.parametrize("levels", [6, 12])
def test_a_staircase_that_the_machine_was_sent_to_is_no_coarse_gauge(levels):
    """Long rests at levels of the reference, where the position creeps by the last digits."""
    reference = np.repeat(1.3 * np.arange(levels), 1000)
    time, position = 0.02 * np.arange(reference.size), np.zeros(reference.size)
    for k in range(reference.size - 1):
        position[k + 1] = position[k] + 0.1 * (reference[k] - position[k])
    random = np.random.default_rng(1)
    creep = random.standard_normal(time.size) * (random.random(time.size) < 0.02)
    creeping = np.round(position + 5e-3 * np.cumsum(creep), 5)
    found = kinds(time, {"reference_v": reference, "position_v": creeping})
    assert not found & (FALSE | {"coarse"})
    # a gauge that rounds shows plateaus wherever the machine goes
    slow = np.round(np.linspace(0.0, 9.0, time.size) / 0.25) * 0.25
    noisy = slow + 0.01 * random.standard_normal(time.size)
    assert "coarse" in kinds(time, {"reference_v": reference, "position_v": noisy})


def test_an_arm_that_rests_before_it_moves_has_lost_nothing():
    time = 0.05 * np.arange(512)
    position = np.where(time < 1.4, 0.0, 1.1 - 1.1 * np.cos(0.5 * (time - 1.4)))
    pressure = 3.0 * np.sin(0.5 * np.maximum(time - 1.0, 0.0))
    for seed in range(4):
        random = np.random.default_rng(seed)
        columns = {
            "command_valve_v": np.sin(0.5 * time) + 2e-3 * random.standard_normal(time.size),
            "pressure_v": with_rests(pressure, 8e-3, time > 1.0, random),
            "arm_v": with_rests(position, 1e-3, time > 1.4, random),
        }
        assert not kinds(time, columns) & FALSE


def real_recordings() -> list[Path]:
    return sorted(REAL.glob("*/*.csv")) if REAL.is_dir() else []


@pytest.mark.skipif(not REAL.is_dir(), reason="the recordings of real machines are not here")
@pytest.mark.parametrize("path", real_recordings(), ids=lambda p: f"{p.parent.name}/{p.stem}")
def test_no_false_alarm_on_a_real_machine(path):
    """None of these recordings lost samples, was clipped or froze; one-rpm steps are coarse."""
    recording: Recording = read_recording(path)
    beside = path.parent / ("rig2.py" if path.stem.startswith("pend2") else "rig.py")
    for rig in (None, rig_named(str(beside)) if beside.exists() else None):
        found = {issue.kind for issue in examine(recording, rig)}
        assert not found & FALSE
        assert "coarse" not in found or path.parent.name == "rc_servo"
        # a hair dryer and an oven do have a dead time
        assert "delay" not in found or path.parent.name in ("dryer", "extruder_heater")
