"""A measured column that repeats an input is named; a machine that follows its input is not."""

from typing import Any

import numpy as np
import pytest
from small_cart import PERIOD_S, RIG

from pamid.base.arrays import Array
from pamid.engine.symbolic.vocabulary import Number, tanh
from pamid.intake.checks.findings import QualityIssue
from pamid.intake.checks.recording_quality import before_a_fit
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.registry import rig_named
from pamid.model.rig import Port, Rig
from pamid.recording.recording import Recording, recording_of, write_recording


class StiffServo(Rig):
    """A drive with its own position controller, which follows what it is sent."""

    inputs = {"target_mm": "m"}
    outputs = {"position_mm": "m"}
    ports = {"sensor": Port("reading", "m")}
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (
        Parameter("bandwidth_per_s", 30.0, low=5.0, high=200.0, log=True, source="manual"),
        Parameter("damping", 0.8, low=0.3, high=2.0, source="manual"),
    )

    def rates(self, x, u, p, port):
        w = p.bandwidth_per_s
        return {
            "position": x.velocity,
            "velocity": w * w * (u.target_mm - x.position) - 2.0 * p.damping * w * x.velocity,
        }

    def measure(self, x, u, p, port):
        return {"position_mm": port("sensor", x.position)}


class WeakServo(StiffServo):
    """One whose motor accelerates it by no more than a limit."""

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        w = p.bandwidth_per_s
        wanted = w * w * (u.target_mm - x.position) - 2.0 * p.damping * w * x.velocity
        return {"position": x.velocity, "velocity": 1.0 * tanh(wanted / 1.0)}


def levels(count: int = 1500, seed: int = 1) -> Array:
    random = np.random.default_rng(seed)
    return np.repeat(random.uniform(-3.0, 3.0, count // 25), 25)


def smoothed(u: Array, share: float) -> Array:
    y = np.zeros_like(u)
    for k in range(1, len(u)):
        y[k] = y[k - 1] + share * (u[k] - y[k - 1])
    return y


def servo(u: Array, bandwidth: float, period: float, fine: int = 50, start: float = 0.0) -> Array:
    """The machine's own integration; position (mm)."""
    x, v = start, 0.0
    y = np.empty_like(u)
    for k, target in enumerate(u):
        y[k] = x
        for _ in range(fine):
            v += (bandwidth**2 * (target - x) - 1.4 * bandwidth * v) * period / fine
            x += v * period / fine
    return y


def kinds(u: Array) -> dict[str, Array]:
    white = u.std() * np.random.default_rng(2).standard_normal(u.size)
    return {
        "itself": u,
        "turned and shifted": 5.0 - 57.3 * u,
        "noise": u + 0.01 * white,
        "much noise": u + 0.3 * white,
        "late": np.concatenate([np.full(3, u[0]), u[:-3]]),
        "filtered": smoothed(u, 0.3) + 1e-3 * white,
        "slowly filtered": smoothed(u, 0.1) + 1e-3 * white,
        "mean of five": np.convolve(u, np.full(5, 0.2))[: u.size],
    }


def issues(recording: Recording, rig: Rig) -> tuple[QualityIssue, ...]:
    return tuple(i for i in before_a_fit(recording, rig) if i.kind == "echo")


@pytest.mark.parametrize("kind", list(kinds(levels())))
@pytest.mark.parametrize("period", [0.01, 36.0])
def test_an_echo_of_the_input_is_named(kind, period):
    u = levels()
    columns = {"force_n": u, "position_m": kinds(u)[kind]}
    (issue,) = before_a_fit(recording_of(period * np.arange(u.size), columns, {}), rig_named(RIG))
    assert issue.kind == "echo" and issue.columns == ("position_m", "force_n")
    assert "position_m and force_n contain the same signal" in issue.text
    assert "Export the measured column as position_m" in issue.text
    assert "opposite" not in issue.text


@pytest.mark.parametrize("bandwidth", [20.0, 60.0, 150.0])
@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("count", [50, 1500])
def test_a_stiff_machine_that_follows_its_input_is_genuine(bandwidth, noise, count):
    u, random = levels(count), np.random.default_rng(3)
    y = servo(u, bandwidth, 0.02) + noise * random.standard_normal(u.size)
    recording = recording_of(0.02 * np.arange(u.size), {"target_mm": u, "position_mm": y}, {})
    assert not issues(recording, StiffServo())


def test_a_servo_far_from_the_zero_of_its_model_is_genuine():
    """From zero the motor would need the whole recording to get there."""
    t = 0.02 * np.arange(500)
    u = 500.0 + 2.0 * np.sin(3.0 * t) + np.sin(7.0 * t)
    recording = recording_of(t, {"target_mm": u, "position_mm": servo(u, 30.0, 0.02, start=500.0)})
    assert not issues(recording, WeakServo())


class LoadedServo(StiffServo):
    """One that a load moves by a compliance of the data sheet, in mm/N."""

    inputs = {"target_mm": "m", "load_n": "N"}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"position_mm": port("sensor", x.position) + 1e-3 * u.load_n}


def test_a_servo_stiffer_than_its_data_sheet_is_genuine():
    u, load = levels(), levels(seed=5)
    y = servo(u, 60.0, 0.02) + 0.05 * load
    columns = {"target_mm": u, "load_n": 0.3 * load, "position_mm": y}
    assert not issues(recording_of(0.02 * np.arange(u.size), columns, {}), LoadedServo())


class TippingServo(StiffServo):
    """One on a pole that a push holds upright; without it, the pole falls and takes it along."""

    inputs = {"target_mm": "m", "push_n": "N"}
    outputs = {"position_mm": "m", "tilt_rad": "rad"}
    states = (*StiffServo.states, State("tilt", "rad"), State("tilting", "rad/s"))

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        falls = {"tilt": x.tilting, "tilting": 1.0 * x.tilt + u.push_n}
        return {**super().rates(x, u, p, port), **falls}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"position_mm": port("sensor", x.position + 0.01 * x.tilt), "tilt_rad": x.tilt}


def test_a_servo_on_a_pole_that_falls_in_the_model_is_genuine():
    """A run on the recorded push falls whatever the parameters, as a robot arm does."""
    u, period, fine = levels(), 0.02, 50
    tilt, push = np.zeros_like(u), np.zeros_like(u)
    angle, rate = 0.0, 0.0
    disturbance = 0.3 * np.random.default_rng(4).standard_normal(u.size)
    for k in range(u.size):
        tilt[k] = angle
        push[k] = -20.0 * angle - 6.0 * rate + disturbance[k]
        for _ in range(fine):
            rate += (1.0 * angle + push[k]) * period / fine
            angle += rate * period / fine
    y = servo(u, 60.0, period) + 10.0 * tilt
    columns = {"target_mm": u, "push_n": push, "position_mm": y, "tilt_rad": tilt}
    assert not issues(recording_of(period * np.arange(u.size), columns, {}), TippingServo())


@pytest.mark.parametrize("command", ["check", "diagnose", "fit"])
def test_the_commands_refuse_an_echo(command, tmp_path, cli):
    u = levels()
    file = tmp_path / "rec.csv"
    write_recording(file, PERIOD_S * np.arange(u.size), {"force_n": u, "position_m": u})
    into = [] if command == "check" else ["--output", str(tmp_path / "run")]
    assert "contain the same signal" in cli(command, file, "--rig", RIG, *into, code=3)["message"]
    assert not (tmp_path / "run").exists()
