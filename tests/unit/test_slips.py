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


@pytest.fixture(scope="module")
def carriage() -> Recording:
    newtons = 30.0 * np.repeat(np.random.default_rng(4).uniform(-1.0, 1.0, 20), 150)
    return record("linear-axis", "force_n", newtons, 0.002, {})


@pytest.fixture(scope="module")
def shaft() -> Recording:
    torque = 0.5 * np.repeat(np.random.default_rng(4).uniform(-1.0, 1.0, 20), 150)
    return record("servo-axis", "torque_nm", torque, 0.002, {})


ANGLE, CURRENT, VOLTAGE = "angle_deg", "current_a", "voltage_v"
TEMPERATURE, TURNING, DRIVEN = "temperature_degc", "velocity_deg_per_s", "velocity_mm_per_s"
RIGS = {
    "motor": "dc-motor",
    "oven": "thermal-block",
    "carriage": "linear-axis",
    "shaft": "servo-axis",
}
#: recording, column, what is recorded of it (or the column that it is exchanged with), key words
SLIPPED: list[tuple[str, str, Callable[[Array], Array] | str, str]] = [
    ("motor", CURRENT, lambda x: 1e3 * x, "look like mA, not A"),
    ("motor", CURRENT, lambda x: 1e-3 * x, "look like kA, not A"),
    ("motor", VOLTAGE, lambda x: 1e3 * x, "look like mV, not V"),
    ("motor", ANGLE, np.radians, "look like rad, not deg"),
    ("motor", ANGLE, lambda x: x / 360.0, "look like revolutions"),
    ("motor", CURRENT, lambda x: -x, "opposite sign"),
    ("motor", CURRENT, VOLTAGE, "are exchanged"),
    # the bounds of its parameters are so wide that a fit would take up each of them
    ("oven", TEMPERATURE, lambda x: x + 273.15, "look like K, not degC"),
    ("oven", TEMPERATURE, lambda x: 1.8 * x + 32.0, "look like degF, not degC"),
    ("oven", "power_w", lambda x: x / 1e3, "look like kW, not W"),
    ("oven", "power_w", lambda x: 1e3 * x, "look like mW, not W"),
    ("carriage", DRIVEN, lambda x: 3.6e-3 * x, "look like km/h, not"),
    ("carriage", DRIVEN, lambda x: 60.0 * x, "look like mm/min, not"),
    ("carriage", "position_mm", lambda x: 1e3 * x, "look like um, not"),
    ("carriage", "force_n", lambda x: 1e-3 * x, "look like kN, not"),
    ("shaft", TURNING, np.radians, "look like rad/s, not"),
    ("shaft", TURNING, lambda x: x / 6.0, "look like rpm, not"),
    ("shaft", TURNING, lambda x: x / 360.0, "look like rev/s, not"),
]


@pytest.mark.parametrize(("machine", "column", "slip", "words"), SLIPPED)
def test_a_slip_is_found(machine, column, slip, words, request):
    recording, rig = request.getfixturevalue(machine), RIGS[machine]
    columns, kind = {column}, "sign" if "sign" in words else "unit"
    if isinstance(slip, str):
        columns, kind = {column, slip}, "exchanged"
        other = recording.columns[slip]
        recording = changed(recording, lambda c: {column: other, slip: c[column]})
    else:
        recording = changed(recording, lambda c: {column: slip(c[column])})
    (issue,) = slips_of(recording, rig)
    assert (issue.kind, set(issue.columns), issue.severity) == (kind, columns, "wrong")
    assert words in issue.message
    if machine == "motor":
        assert [i.kind for i in blocking(recording, rig_named(rig))] == [kind]


def test_right_recordings_have_no_slip(motor, oven, drive, carriage, shaft):
    for machine, rig in zip((motor, oven, carriage, shaft), RIGS.values(), strict=True):
        assert not slips_of(machine, rig)
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
