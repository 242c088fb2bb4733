"""Slips of units, signs and columns: each is found in what a virtual machine records, right data
pass, and only what cannot be stops a fit."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from virtual_recordings import virtual_recording

from pamid.base.arrays import Array
from pamid.intake.checks.findings import QualityIssue
from pamid.intake.checks.recording_quality import before_a_fit, examine
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.registry import rig_named
from pamid.model.rig import Rig
from pamid.recording.recording import Recording, recording_of


def blocking(recording: Recording, rig: Rig) -> list[QualityIssue]:
    return [i for i in before_a_fit(recording, rig) if i.severity == "wrong"]


Columns = dict[str, Array]
SLIPS = ("unit", "sign", "exchanged", "clock", "offset", "gain", "far-off")


def record(
    rig: str, column: str, sent: Array, period: float, truth: dict[str, float], *effects: str
) -> Recording:
    return virtual_recording(rig, {column: sent}, period, *effects, true=truth)


@pytest.fixture(scope="module")
def motor() -> Recording:
    """A geared motor with dry friction, its inertia a third above the data sheet."""
    volts = np.repeat(np.random.default_rng(4).uniform(-12.0, 12.0, 20), 150)
    truth = {"inertia_kg_m2": 0.04}
    return record("dc-motor", "voltage_v", volts, 0.002, truth, "coulomb-friction")


@pytest.fixture(scope="module")
def drive() -> Recording:
    """A geared motor with an encoder on either side, which fix each other."""
    volts = np.repeat(np.random.default_rng(4).uniform(-12.0, 12.0, 12), 150)
    return record("geared-motor", "voltage_v", volts, 0.002, {}, "coulomb-friction@motor")


@pytest.fixture(scope="module")
def oven() -> Recording:
    watts = np.repeat(np.random.default_rng(3).uniform(10.0, 90.0, 20), 60)
    truth = {"capacity_j_per_k": 460.0, "loss_w_per_k": 0.95}
    return record("thermal-block", "power_w", watts, 10.0, truth)


def changed(recording: Recording, change: Callable[[Columns], Columns]) -> Recording:
    return replace(recording, columns={**recording.columns, **change(recording.columns)})


def slips_of(recording: Recording, rig: str | Rig) -> list[QualityIssue]:
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
def test_a_slip_of_a_motor_is_found_in_either_direction(case, motor):
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
def test_a_slip_of_an_oven_is_found(case, oven):
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
def test_any_usual_factor_is_found(other, carriage, shaft):
    rig, column, factor = FACTORS[other]
    recording = carriage if rig == "linear-axis" else shaft
    assert not slips_of(recording, rig)
    (issue,) = slips_of(changed(recording, lambda c: {column: factor * c[column]}), rig)
    assert (issue.kind, issue.columns, issue.severity) == ("unit", (column,), "wrong")
    assert f"look like {other}, not" in issue.message


def test_right_recordings_have_no_slip(motor, oven, drive):
    assert not slips_of(motor, "dc-motor") and not slips_of(oven, "thermal-block")
    assert not slips_of(drive, "geared-motor")
    assert not blocking(motor, rig_named("dc-motor"))


@pytest.mark.parametrize(
    ("column", "factor"),
    [
        ("motor_angle_deg", 4.0),
        ("load_angle_deg", 2.0),
        ("motor_angle_deg", 0.5),
        ("load_angle_deg", 0.25),
        ("motor_angle_deg", 5.56),
    ],
)
def test_any_factor_between_two_encoders_is_found(column, factor, drive):
    """The ratio of the gear fixes both scales exactly; no table holds what a counter may count."""
    recording = changed(drive, lambda c: {column: factor * c[column]})
    (issue,) = slips_of(recording, "geared-motor")
    assert (issue.kind, issue.columns, issue.severity) == ("gain", (column,), "advice")
    assert f"is {factor:.2g} times the value that rig 'geared-motor' predicts from" in issue.message
    edges = max(factor, 1.0 / factor)
    assert (f"Counts per turn x{edges:g}?" in issue.hint) == (edges in (2.0, 4.0))
    assert not blocking(recording, rig_named("geared-motor"))


@pytest.mark.parametrize("column", ["motor_angle_deg", "load_angle_deg"])
def test_a_channel_that_was_not_zeroed_is_found(column, drive):
    by = 3.0 * float(np.ptp(drive.columns[column]))
    (issue,) = slips_of(changed(drive, lambda c: {column: c[column] + by}), "geared-motor")
    assert (issue.kind, issue.columns, issue.severity) == ("offset", (column,), "advice")
    size = float(issue.message.partition(" is offset by ")[2].split()[0])
    assert size == pytest.approx(by, rel=0.02)
    other = ({"motor_angle_deg", "load_angle_deg"} - {column}).pop()
    assert f"Or {other} offset by -" in issue.hint


def test_two_slips_are_found_together(motor):
    """Neither explains anything without the other."""
    recording = changed(motor, lambda c: {ANGLE: np.radians(c[ANGLE]), CURRENT: 1e3 * c[CURRENT]})
    assert {i.columns for i in slips_of(recording, "dc-motor")} == {(ANGLE,), (CURRENT,)}


class LightWrist(Rig):
    """A hand on a geared motor whose rotor nobody has measured: its armature is zero."""

    name = "light-wrist"
    inputs = {"torque_nm": "N m"}
    outputs = {"angle_rad": "rad"}
    states = (State("angle", "rad"), State("speed", "rad/s"))
    parameters = (
        Parameter("inertia", 5e-6, 5e-7, 5e-5, "kg m2", source="drawing"),
        Parameter("damping", 1e-3, 1e-4, 1e-2, "N m s/rad", source="bench"),
        Parameter("armature", 0.0, 0.0, 1.0, "kg m2", spread=0.02, log=False, source="none"),
    )
    period_s = 0.005

    def rates(self, x, u, p, port):
        torque = u.torque_nm - p.damping * x.speed
        return {"angle": x.speed, "speed": torque / (p.inertia + p.armature)}

    def measure(self, x, u, p, port):
        return {"angle_rad": x.angle}


def test_a_missing_inertia_is_no_slip_of_units():
    """The rotor is 2000 times as heavy as the hand; no column is in another unit."""
    torque = 0.05 * np.repeat(np.random.default_rng(4).uniform(-1.0, 1.0, 60), 40)
    angle, speed, rows = 0.0, 0.0, []
    for u in torque:
        rows.append(angle)
        for _ in range(10):
            speed += 5e-4 * (u - 1e-3 * speed) / 0.01
            angle += 5e-4 * speed
    noise = 1e-4 * np.random.default_rng(5).standard_normal(len(rows))
    columns = {"torque_nm": torque, "angle_rad": np.array(rows) + noise}
    recording = recording_of(0.005 * np.arange(len(rows)), columns)
    assert not slips_of(recording, LightWrist())
    milli = changed(recording, lambda c: {"torque_nm": 1e3 * c["torque_nm"]})
    (issue,) = slips_of(milli, LightWrist())
    assert (issue.kind, issue.columns, issue.severity) == ("unit", ("torque_nm",), "wrong")
