"""Effects are candidates only where the recordings determine what they act on."""

from typing import Any, ClassVar

import numpy as np
import pytest

from pamid.model.attachment import attachments
from pamid.model.determined_signals import determined
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.registry import effects
from pamid.model.rig import Port, Rig
from pamid.recording.recording import read_recording, write_recording
from pamid.simulation.data_split import split_recordings

ON_THE_ANGLE = {"linear-stiffness", "cubic-stiffness", "gravity", "cogging"}
ON_INCREMENTS = {"coulomb-friction", "dahl-friction", "maxwell-slip-hysteresis"}


class Shaft(Rig):
    """A shaft with a torque and a current that nobody has to record; speed and angle read."""

    inputs: ClassVar = {"torque_n_m": "N m", "current_a": "A"}
    optional: ClassVar = {"current_a": 0.0}
    outputs: ClassVar = {"speed_rad_per_s": "rad/s", "angle_rad": "rad"}
    states = (State("angle", "rad"), State("speed", "rad/s"))
    parameters = (Parameter("inertia_kg_m2", 0.01, 0.001, 0.1, source="catalogue"),)
    ports: ClassVar = {
        "amplifier": Port("command", "A"),
        "shaft": Port("motion", "N m", {"position": "rad", "velocity": "rad/s", "current": "A"}),
        "encoder": Port("reading", "rad"),
    }

    def rates(self, x, u, p, port):
        current = port("amplifier", u.current_a)
        torque = port(
            "shaft", u.torque_n_m + current, position=x.angle, velocity=x.speed, current=current
        )
        return {"angle": x.speed, "speed": torque / p.inertia_kg_m2}

    def measure(self, x, u, p, port):
        return {"speed_rad_per_s": x.speed, "angle_rad": port("encoder", x.angle)}


def kept_and_left(rig: Rig, *outputs: str, still: tuple[str, ...] = ()) -> Any:
    kept, reasons = determined(rig, outputs, still, attachments(rig, effects().values()))
    return {a.effect.name for a in kept}, {a.label for a in kept}, reasons


def test_an_angle_that_is_measured_may_act():
    names, _, reasons = kept_and_left(Shaft(), "speed_rad_per_s", "angle_rad")
    assert names >= ON_THE_ANGLE | {"coulomb-friction"} and not reasons


def test_an_angle_that_nobody_records_does_not_act_but_friction_does():
    names, labels, reasons = kept_and_left(Shaft(), "speed_rad_per_s")
    assert not names & ON_THE_ANGLE
    assert names >= ON_INCREMENTS | {"viscous-friction", "constant-offset"}
    assert {reasons[name] for name in ON_THE_ANGLE} == {"no measured output determines angle"}
    assert reasons["offset@encoder"] == "it changes nothing that was measured"
    assert not any(label.endswith("@encoder") for label in labels)


def test_an_input_at_rest_drives_nothing():
    sensors = "speed_rad_per_s", "angle_rad"
    _, driven, none = kept_and_left(Shaft(), *sensors)
    _, labels, reasons = kept_and_left(Shaft(), *sensors, still=("current_a",))
    assert not none
    assert {label for label in driven if label.endswith("@amplifier")} <= set(reasons)
    assert set(reasons.values()) == {"current_a is 0 in all recordings"}
    assert "coulomb-friction" in labels
    # its level is the current, for want of another
    assert "signal-dependent-friction" in driven and "signal-dependent-friction" not in labels


@pytest.mark.parametrize("recorded", [False, True])
def test_inputs_that_are_0_in_all_recordings(recorded, tmp_path):
    random = np.random.default_rng(1)
    time = 0.01 * np.arange(600)
    torque = np.repeat(random.uniform(-1.0, 1.0, 20), 30)
    columns = {"torque_n_m": torque, "speed_rad_per_s": np.cumsum(torque)}
    if recorded:
        columns["current_a"] = np.where(time > 3.0, 0.1, 0.0)
    write_recording(tmp_path / "rec.csv", time, columns)
    evidence = split_recordings(Shaft(), [read_recording(tmp_path / "rec.csv")], [])
    assert evidence.still_inputs == (set() if recorded else {"current_a"})
