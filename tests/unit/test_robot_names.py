"""Joints and motors of a model, found in logs by name and by order; and what is said where they are
not there."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mechanisms import TWO

from pamid.base.errors import FileError
from pamid.intake.logs.channels import Channel, Log, RobotValue
from pamid.intake.logs.guessed_mapping import Answers, GuessedMapping, guess_of
from pamid.intake.logs.mapping import load_mapping
from pamid.intake.logs.matcher import with_stand_ins
from pamid.model.rig import Rig
from pamid.recording.recording import recording_of
from pamid.rigs.simulators.kinds.mujoco import rig_of
from pamid.rigs.simulators.mujoco_mechanism import read_mechanism

pytest.importorskip("mujoco", reason="pip install 'pamid[mujoco]'")

SERVOS = TWO.replace(
    '<motor name="m1" joint="shoulder" gear="4" ctrlrange="-1 1"/>',
    '<position name="m1" joint="shoulder" kp="4"/>',
)
STAMPS = 0.01 * np.arange(200)


def model(folder: Path, text: str = TWO) -> Rig:
    path = folder / "arm.xml"
    path.write_text(text)
    return rig_of(read_mechanism(path))


def plain(*names: str) -> Log:
    """A table with these columns and a time."""
    rng = np.random.default_rng(0)
    columns = [Channel(name, rng.normal(size=200)) for name in names]
    return Log(Path("log.csv"), "csv", (Channel("time_s", STAMPS), *columns))


def of_robot(*values: tuple[str, str, str, bool], si: bool = True) -> Log:
    """(group, joint, quantity, sent) of every channel."""
    channels = [
        Channel(
            f"{group}/{quantity}/{joint}",
            np.sin(STAMPS + k),
            STAMPS,
            robot=RobotValue(group, joint, k, len(values), quantity, sent, si),
        )
        for k, (group, joint, quantity, sent) in enumerate(values)
    ]
    return Log(Path("bag"), "ros", tuple(channels))


def sources(found: GuessedMapping, folder: Path) -> dict[str, str]:
    """Column -> channel, as the mapping says."""
    file = folder / "map.toml"
    file.write_text(found.text)
    return {column: one.source for column, one in load_mapping(file, "gauge").signals.items()}


@pytest.mark.parametrize(
    ("shoulder", "elbow"),
    [
        ("shoulder", "elbow"),
        ("Shoulder", "ELBOW"),
        ("shoulder_joint", "joint_elbow"),
        ("arm_shoulder", "arm_elbow"),
        ("panda_shoulder_joint", "panda_elbow_joint"),
    ],
)
def test_joints_are_known_by_their_names(tmp_path, shoulder, elbow):
    states = [("/joint_states", joint, "position", False) for joint in (elbow, shoulder)]
    sent = [("/commands", joint, "effort", True) for joint in (elbow, shoulder)]
    found = guess_of(of_robot(*states, *sent), model(tmp_path), "arm.xml")
    assert not found.open and not found.notes
    assert sources(found, tmp_path) == {
        "m1_command": f"/commands/effort/{shoulder}",
        "m2_command": f"/commands/effort/{elbow}",
        "shoulder_angle_rad": f"/joint_states/position/{shoulder}",
        "elbow_angle_rad": f"/joint_states/position/{elbow}",
    }
    scales = load_mapping(tmp_path / "map.toml").signals
    assert scales["m1_command"].scale == 0.25  # the motor's gear is 4


@pytest.mark.parametrize(
    "names",
    [
        ("qpos/1", "qpos/2", "ctrl/1", "ctrl/2"),
        ("qpos_0", "qpos_1", "ctrl_0", "ctrl_1"),
        ("mjData.qpos[0]", "mjData.qpos[1]", "mjData.ctrl[0]", "mjData.ctrl[1]"),
        ("sensordata/1", "sensordata/2", "ctrl/1", "ctrl/2"),
    ],
)
def test_the_order_of_mujocos_own_vectors(tmp_path, names):
    found = guess_of(plain(*names[::-1]), model(tmp_path), "arm.xml")
    columns = ("shoulder_angle_rad", "elbow_angle_rad", "m1_command", "m2_command")
    assert sources(found, tmp_path) == dict(zip(columns, names, strict=True))
    assert not found.open  # MuJoCo counts in rad


def test_plain_columns_say_joint_and_quantity(tmp_path):
    log = plain("elbow_pos", "shoulder_pos", "elbow_cmd", "m1", "gripper_pos")
    found = guess_of(log, model(tmp_path), "arm.xml", Answers(angles="deg"))
    assert sources(found, tmp_path) == {
        "m1_command": "m1",
        "m2_command": "elbow_cmd",
        "shoulder_angle_rad": "shoulder_pos",
        "elbow_angle_rad": "elbow_pos",
    }
    assert 'unit = "deg"  # by --angles' in found.text
    assert found.open == ("signals.m1_command.unit", "signals.m2_command.unit")


def test_strangers_are_refused_with_the_nearest_names(tmp_path):
    log = of_robot(
        ("/joint_states", "shoulder_lift", "position", False),
        ("/joint_states", "elbw", "position", False),
    )
    with pytest.raises(FileError) as caught:
        guess_of(log, model(tmp_path), "arm.xml")
    assert caught.value.code == "joints"
    assert "the log has shoulder_lift, elbw, the model shoulder, elbow" in caught.value.message
    assert "'shoulder_lift' for 'shoulder', 'elbw' for 'elbow'" in caught.value.hint
    with pytest.raises(FileError, match="the log has hip, knee"):
        guess_of(plain("hip_pos", "knee_pos"), model(tmp_path), "arm.xml")


def test_a_measured_effort_stands_for_a_motors_command_alone(tmp_path):
    values = [
        ("/joint_states", joint, quantity, False)
        for joint in ("shoulder", "elbow")
        for quantity in ("position", "effort")
    ]
    found = guess_of(of_robot(*values), model(tmp_path, SERVOS), "arm.xml")
    made = sources(found, tmp_path)
    assert made["m2_command"] == "/joint_states/effort/elbow"
    assert "m1_command_rad" not in made
    assert any(note.startswith("no channel found for m1_command_rad") for note in found.notes)


NUMBERED = TWO.replace('name="m1"', 'name="torque_1"').replace('name="m2"', 'name="torque_2"')


@pytest.mark.parametrize(
    ("ending", "unit", "factor"), [("", "", 1.0), ("_nm", "", 1.0), ("", "kN*m", 1000.0)]
)
def test_a_numbered_torque_stands_for_the_command_of_its_motor(tmp_path, ending, unit, factor):
    log = plain("shoulder_angle_rad", "elbow_angle_rad", f"torque_2{ending}", f"torque_1{ending}")
    log = replace(
        log, channels=(*log.channels[:3], *(replace(c, unit=unit) for c in log.channels[3:]))
    )
    guess = guess_of(log, model(tmp_path, NUMBERED), "arm.xml")
    assert sources(guess, tmp_path)["torque_1_command"] == f"torque_1{ending}"
    signals = load_mapping(tmp_path / "map.toml").signals
    assert signals["torque_1_command"].scale == pytest.approx(0.25 * factor)  # its gear is 4
    volts = plain("shoulder_angle_rad", "elbow_angle_rad", "torque_1_v", "torque_2_v")
    assert "signals.torque_1_command" not in guess_of(volts, model(tmp_path, NUMBERED), "").text


def test_a_recorded_torque_is_taken_as_the_command_that_is_missing(tmp_path):
    columns = {name: np.sin(STAMPS) for name in ("torque_1_nm", "torque_2_nm", "elbow_angle_rad")}
    rig = model(tmp_path, NUMBERED)
    recording, notes = with_stand_ins(recording_of(STAMPS, columns), rig)
    assert list(recording.columns) == ["torque_1_command", "torque_2_command", "elbow_angle_rad"]
    assert recording.columns["torque_1_command"] == pytest.approx(0.25 * np.sin(STAMPS))
    assert notes[0].startswith("torque_1_nm is taken as torque_1_command: 4 of effort per unit")
    assert with_stand_ins(recording, rig) == (recording, [])
