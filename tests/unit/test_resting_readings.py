"""Rests, turning points and coarse gauges are not reported as faults; real faults are found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import pamid
from pamid import Parameter, Port, Rig, State
from pamid.checks.recording_quality import examine
from pamid.equations import Expr, sin
from pamid.model.registry import rig_named
from pamid.recording.recording import Recording, read_recording, recording_of

Array = NDArray[np.float64]

REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"
FALSE = {"dropped", "clipped", "frozen", "bridged", "sampled-slowly", "standstill"}


class Pendulum(Rig):
    """A rod that is let go."""

    inputs = {}
    outputs = {"angle_rad": "rad"}
    ports = {"hinge": Port("motion", "1/s2", {"position": "rad", "velocity": "rad/s"})}
    states = (State("angle", "rad", 1.0), State("speed", "rad/s"))
    parameters = (Parameter("stiffness", 29.0, 5.0, 60.0, spread=5.0, source="length"),)
    period_s = 0.0067

    def rates(self, x, u, p, port):  # type: ignore[no-untyped-def]
        pull: Expr = port("hinge", -p.stiffness * sin(x.angle), position=x.angle, velocity=x.speed)
        return {"angle": x.speed, "speed": pull}

    def measure(self, x, u, p, port):  # type: ignore[no-untyped-def]
        return {"angle_rad": x.angle}


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


def clinging(values: Array, step: float, seed: int) -> Array:
    """A gauge that stands until the quantity is half a step to one and a half steps away; six
    readings are averaged."""
    random = np.random.default_rng(seed)
    reading, shown, reach = np.empty_like(values), values[0], step
    for k, value in enumerate(values):
        if abs(value - shown) > reach:
            shown, reach = value, step * random.uniform(0.5, 1.5)
        reading[k] = shown
    return np.round(reading.reshape(-1, 6).mean(axis=1), 5)


def drain(seed: int = 0) -> tuple[Array, Array]:
    level = 22.5 * (1.0 - 0.85 * np.linspace(0.0, 1.0, 6 * 840)) ** 2
    return np.arange(840.0), clinging(level, 0.3, seed)


def test_turning_points_of_a_free_swing_are_no_fault() -> None:
    time, angle = swing()
    for count in (1e-3, 3e-3, 1e-2):
        reading = counted(angle, count)
        assert np.count_nonzero(np.diff(reading) == 0.0) > 10
        assert not kinds(time, {"angle_rad": reading}) & FALSE


def test_rows_that_are_lost_in_a_swing_are_found() -> None:
    time, angle = swing()
    for count in (1e-3, 3e-3):
        reading = counted(angle, count)
        fast = np.flatnonzero(np.abs(np.sin(4.9 * time)) > 0.8)
        for start in fast[200 :: fast.size // 5]:
            reading[start : start + 8] = reading[start]
        (issue,) = (
            i for i in examine(recording_of(time, {"angle_rad": reading})) if i.kind in FALSE
        )
        assert issue.kind == "dropped" and issue.figures["samples"] >= 4 * 7


def test_a_swing_that_is_clipped_again_and_again_is_found() -> None:
    time, angle = swing()
    clipped = np.clip(counted(angle, 1e-3), -0.7, None)
    assert kinds(time, {"angle_rad": clipped}) & FALSE == {"clipped"}


def test_a_free_swing_is_not_late() -> None:
    """A period that is a little off looks like a delay, but nothing was sent that it answers."""
    time, angle = swing()
    early = np.cos(5.0 * time) * np.abs(angle).max()
    found = kinds(time, {"angle_rad": counted(early, 1e-3)}, Pendulum())
    assert "delay" not in found


def with_rests(
    values: Array, noise: float, moves: NDArray[np.bool_], random: np.random.Generator
) -> Array:
    """Noise while the machine moves; at rest one value, which flickers now and then."""
    flicker = random.random(values.size) < 0.1
    added = np.where(moves, random.standard_normal(values.size), flicker)
    return np.round(values + noise * added, 6)


def test_a_swing_up_that_ends_upright_is_neither_clipped_nor_frozen() -> None:
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


def test_a_joint_that_turns_while_another_moves_is_not_frozen() -> None:
    time = 0.005 * np.arange(2000)
    columns = {
        "angle_1_rad": counted(0.5 * np.sin(2.0 * time), 3e-4),
        "angle_2_rad": counted(np.tanh(4.0 * np.sin(1.3 * time + 1.0)), 3e-4),
    }
    assert not kinds(time, columns) & FALSE
    # the second sensor hangs while the joint runs
    start = int(np.argmax(np.abs(np.diff(columns["angle_2_rad"])))) - 20
    columns["angle_2_rad"][start : start + 40] = columns["angle_2_rad"][start]
    assert kinds(time, columns) & FALSE == {"frozen"}


def test_a_gauge_that_clings_has_lost_nothing() -> None:
    for seed in range(5):
        time, level = drain(seed)
        assert np.mean(np.diff(level) == 0.0) > 0.3
        assert not kinds(time, {"level_cm": level}) & FALSE


@pytest.mark.parametrize("levels", [6, 12])
def test_a_staircase_that_the_machine_was_sent_to_is_no_coarse_gauge(levels: int) -> None:
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


def test_an_arm_that_rests_before_it_moves_has_lost_nothing() -> None:
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


def test_noise_that_is_weaker_at_rest_was_not_bridged() -> None:
    """A slow even ramp between two fast motions, where the noise of the sensor follows its speed;
    a gap that was filled by a line, among full noise, is found."""
    random, time = np.random.default_rng(3), 0.01 * np.arange(3000)
    quiet = np.abs(time - 15.0) < 2.0
    way = np.where(time < 13.0, np.sin(time), np.sin(13.0) + 0.2 * (time - 13.0))
    way = np.where(time > 17.0, way + np.sin(3.0 * (time - 17.0)), way)
    near = np.clip((np.abs(time - 15.0) - 2.0) / 0.5, 0.0, 1.0)
    noise = 0.01 * random.standard_normal(time.size) * np.where(quiet, 1e-4, near + 1e-4)
    other = 0.01 * random.standard_normal(time.size)
    columns = {"way_m": way + noise, "other_m": np.cos(time) + other}
    assert "bridged" not in kinds(time, columns)
    filled = np.cos(time) + other
    filled[1000:1040] = np.linspace(filled[1000], filled[1039], 40)
    assert "bridged" in kinds(time, {**columns, "other_m": filled})


def test_a_delay_is_told_in_the_unit_that_fits_it(tmp_path: Path) -> None:
    """An oven that answers minutes late."""
    (tmp_path / "oven.py").write_text(OVEN)
    rig = rig_named(str(tmp_path / "oven.py"))
    heater = np.repeat(np.random.default_rng(1).uniform(0.0, 10.0, 30), 60)
    temperature = np.zeros(heater.size)
    for k in range(heater.size - 1):
        late = heater[max(0, k - 40)]
        temperature[k + 1] = temperature[k] + 4.0 / 300.0 * (20.0 * late - temperature[k])
    time = 4.0 * np.arange(heater.size)
    reading = 20.0 + temperature + 0.2 * np.random.default_rng(2).standard_normal(time.size)
    columns = {"heater_v": heater, "temperature_degc": np.round(reading, 2)}
    said = pamid.check(recording_of(time, columns), rig=rig).summary()
    assert "answers 160 s after" in said and "ms" not in said.partition("answers")[2][:40]


OVEN = '''
from pamid import Parameter, Port, Rig, State


class Oven(Rig):
    """An oven, first order."""

    inputs = {"heater_v": "V"}
    outputs = {"temperature_degc": "K"}
    ports = {"wall": Port("rate", "K/s", {"stored": "K"})}
    states = (State("temperature", "K", 293.0),)
    parameters = (Parameter("gain", 20.0, 1.0, 200.0, "K/V", spread=2.0, log=True, source="guess"),)
    period_s = 4.0

    def rates(self, x, u, p, port):
        above = x.temperature - 293.0
        rate = port("wall", (p.gain * u.heater_v - above) / 300.0, stored=above)
        return {"temperature": rate}

    def measure(self, x, u, p, port):
        return {"temperature_degc": x.temperature}
'''


def real_recordings() -> list[Path]:
    return sorted(REAL.glob("*/*.csv")) if REAL.is_dir() else []


@pytest.mark.skipif(not REAL.is_dir(), reason="the recordings of real machines are not here")
@pytest.mark.parametrize("path", real_recordings(), ids=lambda p: f"{p.parent.name}/{p.stem}")
def test_no_false_alarm_on_a_real_machine(path: Path) -> None:
    """None of these recordings lost samples, was clipped or froze; one-rpm steps are coarse."""
    recording: Recording = read_recording(path)
    beside = path.parent / ("rig2.py" if path.stem.startswith("pend2") else "rig.py")
    for rig in (None, rig_named(str(beside)) if beside.exists() else None):
        found = {issue.kind for issue in examine(recording, rig)}
        assert not found & FALSE
        assert "coarse" not in found or path.parent.name == "rc_servo"
        # a hair dryer and an oven do have a dead time
        assert "delay" not in found or path.parent.name in ("dryer", "extruder_heater")
