"""Slips of units, signs and columns: each is found in what a virtual machine records, right data
pass, and only what cannot be stops a fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pamid.checks.inspection import inspect, require_sound
from pamid.checks.inspection_words import inspection_text
from pamid.checks.recording_quality import QualityIssue, blocking, examine
from pamid.checks.slips import CLEAR_GAIN, SURE_GAIN, Explanation, Judgement, Slip
from pamid.model.registry import rig_named
from pamid.recording.recording import Recording, recording_of
from pamid.simulation.virtual_rig import simulate_virtual_rig

Array = NDArray[np.float64]
Columns = dict[str, Array]
SLIPS = ("unit", "sign", "exchanged", "clock", "offset", "gain", "far-off")


def record(
    rig: str, column: str, sent: Array, period: float, truth: dict[str, float], *effects: str
) -> Recording:
    time = period * np.arange(sent.size)
    excitation = recording_of(time, {column: sent})
    made = simulate_virtual_rig(rig, excitation, effects, {}, truth, 1.0, 1)
    return recording_of(time, made.columns)


@pytest.fixture(scope="module")
def motor() -> Recording:
    """A geared motor with dry friction, its inertia a third above the data sheet."""
    volts = np.repeat(np.random.default_rng(4).uniform(-12.0, 12.0, 20), 150)
    truth = {"inertia_kg_m2": 0.04}
    return record("dc-motor", "voltage_v", volts, 0.002, truth, "coulomb-friction")


@pytest.fixture(scope="module")
def drive() -> Recording:
    """A geared motor with an encoder on either side, which fix each other."""
    volts = np.repeat(np.random.default_rng(4).uniform(-12.0, 12.0, 20), 150)
    return record("geared-motor", "voltage_v", volts, 0.002, {}, "coulomb-friction@motor")


@pytest.fixture(scope="module")
def oven() -> Recording:
    watts = np.repeat(np.random.default_rng(3).uniform(10.0, 90.0, 20), 60)
    truth = {"capacity_j_per_k": 460.0, "loss_w_per_k": 0.95}
    return record("thermal-block", "power_w", watts, 10.0, truth)


def changed(recording: Recording, change: Callable[[Columns], Columns]) -> Recording:
    return replace(recording, columns={**recording.columns, **change(recording.columns)})


def slips_of(recording: Recording, rig: str) -> list[QualityIssue]:
    return [issue for issue in examine(recording, rig_named(rig)) if issue.kind in SLIPS]


ANGLE, CURRENT, VOLTAGE = "angle_deg", "current_a", "voltage_v"
MOTOR: dict[str, tuple[Callable[[Columns], Columns], str, set[str], str]] = {
    "mA": (lambda c: {CURRENT: 1e3 * c[CURRENT]}, "unit", {CURRENT}, "look like mA, not A"),
    "kA": (lambda c: {CURRENT: 1e-3 * c[CURRENT]}, "unit", {CURRENT}, "look like kA, not A"),
    "mV": (lambda c: {VOLTAGE: 1e3 * c[VOLTAGE]}, "unit", {VOLTAGE}, "look like mV, not V"),
    "rad": (lambda c: {ANGLE: np.radians(c[ANGLE])}, "unit", {ANGLE}, "look like rad, not deg"),
    "turns": (lambda c: {ANGLE: c[ANGLE] / 360.0}, "unit", {ANGLE}, "look like revolutions"),
    "sign": (lambda c: {CURRENT: -c[CURRENT]}, "sign", {CURRENT}, "opposite sign"),
    "exchanged": (
        lambda c: {CURRENT: c[VOLTAGE], VOLTAGE: c[CURRENT]},
        "exchanged",
        {CURRENT, VOLTAGE},
        "are exchanged",
    ),
}


@pytest.mark.parametrize("case", MOTOR)
def test_a_slip_of_a_motor_is_found_in_either_direction(case: str, motor: Recording) -> None:
    change, kind, columns, words = MOTOR[case]
    recording = changed(motor, change)
    (issue,) = slips_of(recording, "dc-motor")
    assert (issue.kind, set(issue.columns), issue.severity) == (kind, columns, "wrong")
    assert words in issue.message
    assert [i.kind for i in blocking(recording, rig_named("dc-motor"))] == [kind]


OVEN: dict[str, tuple[Callable[[Columns], Columns], str, str]] = {
    "kelvin": (
        lambda c: {"temperature_degc": c["temperature_degc"] + 273.15},
        "temperature_degc",
        "look like K, not degC",
    ),
    "fahrenheit": (
        lambda c: {"temperature_degc": 1.8 * c["temperature_degc"] + 32.0},
        "temperature_degc",
        "look like degF, not degC",
    ),
    "kW": (lambda c: {"power_w": c["power_w"] / 1e3}, "power_w", "look like kW, not W"),
    "mW": (lambda c: {"power_w": 1e3 * c["power_w"]}, "power_w", "look like mW, not W"),
}


@pytest.mark.parametrize("case", OVEN)
def test_a_slip_of_an_oven_is_found(case: str, oven: Recording) -> None:
    """The bounds of its parameters are so wide that a fit would take up each of them."""
    change, column, words = OVEN[case]
    (issue,) = slips_of(changed(oven, change), "thermal-block")
    assert (issue.kind, issue.columns, issue.severity) == ("unit", (column,), "wrong")
    assert words in issue.message


@pytest.fixture(scope="module")
def carriage() -> Recording:
    newtons = 30.0 * np.repeat(np.random.default_rng(4).uniform(-1.0, 1.0, 20), 150)
    return record("linear-axis", "force_n", newtons, 0.002, {})


@pytest.fixture(scope="module")
def shaft() -> Recording:
    torque = 0.5 * np.repeat(np.random.default_rng(4).uniform(-1.0, 1.0, 20), 150)
    return record("servo-axis", "torque_nm", torque, 0.002, {})


#: unit -> rig, column, factor from the column's unit
FACTORS = {
    "km/h": ("linear-axis", "velocity_mm_per_s", 3.6e-3),
    "mm/min": ("linear-axis", "velocity_mm_per_s", 60.0),
    "um": ("linear-axis", "position_mm", 1e3),
    "kN": ("linear-axis", "force_n", 1e-3),
    "rad/s": ("servo-axis", "velocity_deg_per_s", np.pi / 180.0),
    "rpm": ("servo-axis", "velocity_deg_per_s", 1.0 / 6.0),
    "rev/s": ("servo-axis", "velocity_deg_per_s", 1.0 / 360.0),
}


@pytest.mark.parametrize("other", FACTORS)
def test_any_usual_factor_is_found(other: str, carriage: Recording, shaft: Recording) -> None:
    rig, column, factor = FACTORS[other]
    recording = carriage if rig == "linear-axis" else shaft
    assert not slips_of(recording, rig)
    (issue,) = slips_of(changed(recording, lambda c: {column: factor * c[column]}), rig)
    assert (issue.kind, issue.columns, issue.severity) == ("unit", (column,), "wrong")
    assert f"look like {other}, not" in issue.message


@pytest.mark.parametrize("factor", [2.0, 3.0])
def test_what_a_data_sheet_may_be_off_by_is_not_refused(factor: float, motor: Recording) -> None:
    recording = changed(motor, lambda c: {CURRENT: factor * c[CURRENT]})
    assert all(issue.severity == "advice" for issue in slips_of(recording, "dc-motor"))
    assert not blocking(recording, rig_named("dc-motor"))


@pytest.mark.parametrize("shift", [273.15, -273.15])
def test_kelvin_and_degrees_are_as_wrong_either_way(shift: float) -> None:
    """However little a fit gains where it bends its losses."""
    slip = Slip("unit", ("temperature_degc",), 1.0, shift)
    before, after = Judgement({"t": 1.0}, 0.0), Judgement({"t": 0.2}, 0.0)
    one = Explanation(slip, before, after)
    assert CLEAR_GAIN < one.gain < SURE_GAIN and one.wrong
    assert not replace(one, slip=replace(slip, factor=2.0)).wrong


def test_kelvin_that_no_room_has_is_noted_without_a_rig(oven: Recording) -> None:
    cold = {"block_k": oven.columns["temperature_degc"]}
    (issue,) = [i for i in examine(replace(oven, columns=cold)) if i.kind == "unit"]
    assert "stays below 200 K" in issue.message and issue.severity == "advice"
    warm = {"block_k": cold["block_k"] + 273.15}
    assert not [i for i in examine(replace(oven, columns=warm)) if i.kind == "unit"]


def test_right_recordings_have_no_slip(motor: Recording, oven: Recording) -> None:
    assert not slips_of(motor, "dc-motor") and not slips_of(oven, "thermal-block")
    assert not blocking(motor, rig_named("dc-motor"))


@pytest.mark.parametrize("column", ["motor_angle_deg", "load_angle_deg"])
@pytest.mark.parametrize("factor", [4.0, 2.0, 0.5, 0.25, 5.56])
def test_any_factor_between_two_encoders_is_found(
    column: str, factor: float, drive: Recording
) -> None:
    """The ratio of the gear fixes both scales exactly; no table holds what a counter may count."""
    recording = changed(drive, lambda c: {column: factor * c[column]})
    (issue,) = slips_of(recording, "geared-motor")
    assert (issue.kind, issue.columns, issue.severity) == ("gain", (column,), "advice")
    assert f"reads {factor:.2g} times what rig 'geared-motor' predicts from" in issue.message
    edges = max(factor, 1.0 / factor)
    assert (f"Counts per turn x{edges:g}?" in issue.hint) == (edges in (2.0, 4.0))
    assert not blocking(recording, rig_named("geared-motor"))


@pytest.mark.parametrize("column", ["motor_angle_deg", "load_angle_deg"])
def test_a_channel_that_was_not_zeroed_is_found(column: str, drive: Recording) -> None:
    by = 3.0 * float(np.ptp(drive.columns[column]))
    (issue,) = slips_of(changed(drive, lambda c: {column: c[column] + by}), "geared-motor")
    assert (issue.kind, issue.columns, issue.severity) == ("offset", (column,), "advice")
    size = float(issue.message.partition(" is offset by ")[2].split()[0])
    assert size == pytest.approx(by, rel=0.02)
    other = ({"motor_angle_deg", "load_angle_deg"} - {column}).pop()
    assert f"Or {other} offset by -" in issue.hint


@pytest.mark.parametrize("column", ["motor_angle_deg", "load_angle_deg"])
def test_an_opposite_sign_is_found_with_an_offset(column: str, drive: Recording) -> None:
    """A draw wire counts down from where it hangs."""
    by = 3.0 * float(np.ptp(drive.columns[column]))
    recording = changed(drive, lambda c: {column: by - c[column]})
    (issue,) = slips_of(recording, "geared-motor")
    assert (issue.kind, issue.columns, issue.severity) == ("sign", (column,), "wrong")
    assert "has the opposite sign and is then offset by -" in issue.message
    assert "sign = -1 and offset = " in issue.hint


def test_right_encoders_have_no_slip(drive: Recording) -> None:
    assert not slips_of(drive, "geared-motor")


def test_a_doubt_does_not_stop_a_fit_and_is_stated(drive: Recording) -> None:
    recording = changed(drive, lambda c: {"load_angle_deg": c["load_angle_deg"] + 9e3})
    rig = rig_named("geared-motor")
    (doubt,) = require_sound(recording, rig)
    assert doubt.startswith("load_angle_deg is offset by ") and doubt.endswith("'geared-motor'.")
    text = inspection_text(inspect(recording, rig).said)
    assert text.endswith("the rig does not explain the recording as it is")


def test_an_encoder_before_the_gear_is_offered_as_such(motor: Recording) -> None:
    """The ratio of 20 is near to that of degrees and milliradians, so that both are named."""
    recording = changed(motor, lambda c: {ANGLE: 20.0 * c[ANGLE]})
    (issue,) = slips_of(recording, "dc-motor")
    assert issue.kind == "unit" and issue.columns == (ANGLE,)
    assert "other side of the gear" in issue.message and "ratio = 20" in issue.message
    assert "mrad" in issue.hint


def test_two_slips_are_found_together(motor: Recording) -> None:
    """Neither explains anything without the other."""
    recording = changed(motor, lambda c: {ANGLE: np.radians(c[ANGLE]), CURRENT: 1e3 * c[CURRENT]})
    assert {i.columns for i in slips_of(recording, "dc-motor")} == {(ANGLE,), (CURRENT,)}


MECHANISM = """<mujoco model="arm">
  <worldbody>
    <body name="link">
      <joint name="pivot" type="hinge" axis="0 1 0" damping="0.4"/>
      <inertial pos="0.2 0 0" mass="0.5" diaginertia="0.01 0.01 0.01"/>
    </body>
  </worldbody>
  <actuator><motor name="drive" joint="pivot" gear="1"/></actuator>
  <sensor><jointpos name="angle" joint="pivot"/></sensor>
</mujoco>
"""


@pytest.mark.parametrize("torque", [0.7, 6.0])
def test_a_motor_of_a_mechanism_may_be_driven_as_far_as_one_likes(
    torque: float, tmp_path: Path
) -> None:
    """A range that nobody states is no reason to take newton metres for percent."""
    path = tmp_path / "arm.xml"
    path.write_text(MECHANISM)
    rig = rig_named(str(path))
    (command,) = rig.inputs
    sent = torque * np.repeat(np.random.default_rng(2).uniform(-1.0, 1.0, 15), 100)
    recording = record(str(path), command, sent, 0.005, {})
    assert not [i for i in blocking(recording, rig)]
    assert not slips_of(recording, str(path))


def test_an_input_in_percent_is_told(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(MECHANISM)
    (command,) = rig_named(str(path)).inputs
    sent = np.repeat(np.random.default_rng(2).uniform(-1.0, 1.0, 15), 100)
    recording = record(str(path), command, sent, 0.005, {})
    (issue,) = slips_of(changed(recording, lambda c: {command: 100.0 * c[command]}), str(path))
    assert issue.columns == (command,) and "percent" in issue.message + issue.hint


def test_a_slip_is_set_right_in_the_unit_of_its_column() -> None:
    time = np.arange(60.0)
    recording = recording_of(time, {"warm_degc": 300.0 + time, "gauge_bar": 1.0 + time})
    kelvin = Slip("unit", ("warm_degc",), 1.0, -273.15, "K").corrected(recording)
    assert kelvin.columns["warm_degc"] == pytest.approx(26.85 + time)
    swapped = Slip("exchanged", ("warm_degc", "gauge_bar")).corrected(recording)
    assert np.array_equal(swapped.columns["gauge_bar"], recording.columns["warm_degc"])
    late = Slip("clock", ("time_s",), 1e-3).corrected(recording)
    assert late.sampling_period_s == pytest.approx(1e-3)
