"""Motors with windings, springs that yield, couplings, free joints: trajectories of plain MuJoCo at
small steps as the judge, and what is said of such models."""

import re
from pathlib import Path
from typing import Any

import mechanisms
import numpy as np
import pytest
from mechanisms import written

from pamid.base.arrays import Array
from pamid.engine.sampled_inputs import SampledInputs
from pamid.model.assembly import Assembly
from pamid.model.registry import rig_named
from pamid.rigs.simulators.compiled_rig import CompiledMechanism
from pamid.rigs.simulators.mujoco_file import open_mujoco
from pamid.rigs.simulators.mujoco_mechanism import read_mechanism
from pamid.rigs.simulators.plain_mujoco import PlainModel
from pamid.rigs.simulators.stepped_mechanism import SteppedMechanism

mujoco: Any = mechanisms.needs_mujoco()

PERIOD = 0.002
MOVING = mechanisms.TERMS.replace(
    "<sensor>", '<sensor><jointpos joint="shoulder"/><jointpos joint="elbow"/>'
    '<jointpos joint="driver"/><jointpos joint="follower"/>'
).replace('range="-1 1" limited="true"', "").replace('yield="0.2"', 'yield="0.05"')  # fmt: skip
MIMIC = """<robot name="gripper">
  <link name="base"/>
  <link name="left"><inertial><origin xyz="0.05 0 0"/><mass value="0.1"/>
    <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="right"><inertial><origin xyz="0.05 0 0"/><mass value="0.1"/>
    <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="driver" type="continuous">
    <parent link="base"/><child link="left"/><axis xyz="0 1 0"/></joint>
  <joint name="follower" type="continuous">
    <parent link="base"/><child link="right"/><axis xyz="0 1 0"/>
    <mimic joint="driver" multiplier="-2" offset="0.1"/></joint>
</robot>
"""


def run(file: Path, u: Array, substeps: int = 1) -> tuple[Assembly, Array]:
    """The readings of the equations under these commands, from the start of the file."""
    a = Assembly(rig_named(str(file)))
    assert isinstance(a.rig, CompiledMechanism) and not a.rig.mechanism.hindrances
    p, step = a.values(), PERIOD / substeps
    memory = a.program.memory(a.start(p), period_s=step)
    y, _, bad = a.program.run(memory, SampledInputs(np.repeat(u, substeps, axis=0), step), p)
    assert bad < 0
    return a, y[::substeps]


def plain(text: str, u: Array, substeps: int) -> Array:
    """The same of MuJoCo alone."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep, model.opt.tolerance = PERIOD / substeps, 1e-14
    data, found = mujoco.MjData(model), []
    for row in u:
        data.ctrl[:] = row
        mujoco.mj_forward(model, data)
        found.append(data.sensordata.copy())
        mujoco.mj_step(model, data, substeps)
    return np.array(found)


def test_motors_springs_and_couplings_move_as_in_mujoco_at_small_steps(tmp_path):
    """Of first order in its step: a quarter of the step leaves a quarter of the difference."""
    t = PERIOD * np.arange(400)
    u = np.column_stack(
        [0.6 * np.sin(3 * t), np.sin(4 * t), 5 * np.sin(5 * t), 0.3 * np.sin(6 * t)]
    )
    a, y = run(written(tmp_path, MOVING), u, 10)
    assert np.ptp(y[:, 0]) > 0.15  # far beyond what the spring of the shoulder bears
    coarse, fine = (np.abs(plain(MOVING, u, n) - y).max(axis=0) for n in (10, 40))
    size = np.abs(y).max(axis=0)
    assert (fine < 4e-3 * size).all()
    assert (fine < 0.3 * coarse + 1e-7 * size).all()
    assert {s.name for s in a.rig.states} >= {"shoulder_spring_reference", "servo_current"}


def test_a_motor_has_its_resistance_in_ohm(tmp_path):
    rig = mechanisms.rig_from(mechanisms.TERMS, tmp_path)
    units = {p.name: (p.unit, p.fitted) for p in rig.parameters}
    assert units["servo_resistance"] == ("Ohm", False)
    assert units["volts_motorconst"] == ("N/A", True)  # it drives a slide
    assert units["servo_kd"] == ("N m s/rad", True)
    assert units["rub_lugre_coulomb"] == ("N m", True)
    assert "rub_resistance" not in units  # no current flows without a motor constant


def test_a_mimic_joint_follows(tmp_path):
    file = written(tmp_path, MIMIC, "gripper.urdf")
    mechanism = read_mechanism(file)
    assert [c.coefficients[:2] for c in mechanism.couplings] == [(0.1, -2.0)]
    assert not [p for p in mechanism.ports if p.kind == "transmission"]
    u = np.zeros((500, 2))
    u[:, 0] = 0.02
    _, y = run(file, u)
    columns = list(mechanism.outputs)
    driver, follower = (y[:, columns.index(f"{n}_position_rad")] for n in ("driver", "follower"))
    assert np.ptp(driver) > 0.1
    assert np.abs(follower - (0.1 - 2.0 * driver))[200:].max() < 0.02


def test_a_floating_base_moves_as_its_free_joint(tmp_path):
    t = PERIOD * np.arange(300)
    u = np.column_stack([6 + np.sin(9 * t), 6 + np.cos(8 * t), 0.3 * np.sin(20 * t)])
    a, y = run(written(tmp_path, mechanisms.DRONE), u)
    columns = list(a.rig.outputs)
    assert columns[:4] == ["place_x_m", "place_y_m", "place_z_m", "attitude_qw"]
    expected = plain(mechanisms.DRONE, u, 4)
    assert np.ptp(expected[:, columns.index("attitude_qy")]) > 0.3
    size = np.abs(expected).max(axis=0)
    assert (np.abs(y - expected).max(axis=0) < 1e-5 * np.maximum(size, 1.0)).all()


def test_free_joints_are_noted_and_hinder_nothing(tmp_path):
    mechanism = read_mechanism(written(tmp_path, mechanisms.DRONE))
    said = [str(f) for f in mechanism.findings]
    line = 1 + mechanisms.DRONE[: mechanisms.DRONE.index('name="drone" pos')].count("\n")
    assert any(f"joint 'fly', line {line}: a free joint: three slides" in text for text in said)
    assert any("joint 'loose'" in text and "is held where it stands" in text for text in said)
    assert [j.name for j in mechanism.joints if j.is_base][3:] == [
        "fly_yaw",
        "fly_pitch",
        "fly_roll",
    ]
    fitted = {p.parameter.name for p in mechanism.parameters}
    assert not any(name.startswith("fly_") for name in fitted)
    assert {p.name for p in mechanism.ports if p.kind == "transmission"} == {"gimbal_transmission"}


def test_an_unread_base_is_said(tmp_path):
    text = re.sub("<framequat .*?/>", "", mechanisms.DRONE)
    said = [str(f) for f in read_mechanism(written(tmp_path, text)).findings]
    assert any("no sensor reads where the floating base is: add <framepos>" in s for s in said)
    whole = read_mechanism(written(tmp_path, mechanisms.DRONE)).findings
    assert not any("floating base" in str(f) for f in whole)


def test_a_base_without_sensors_is_read_by_place_and_quaternion(tmp_path):
    text = mechanisms.DRONE[: mechanisms.DRONE.index("  <sensor>")] + "</mujoco>"
    file = written(tmp_path, text)
    a, y = run(file, np.tile([6.0, 7.0, 0.1], (100, 1)))
    columns = list(a.rig.outputs)
    assert {"fly_x_position_m", "fly_qw", "fly_qz", "fly_yaw_position_rad"} <= set(columns)
    model = PlainModel(open_mujoco(file), read_mechanism(file))
    states = np.zeros((1, 1 + model.states))
    hinges = [f"fly_{word}_position_rad" for word in ("yaw", "pitch", "roll")]
    for name, joint in zip(hinges, model.mechanism.joints[3:6], strict=True):
        states[0, 1 + joint.qpos] = y[-1, columns.index(name)]
    found = model._read(states[None], np.zeros((1, 1, 0)), [f"fly_q{word}" for word in "wxyz"])
    expected = [y[-1, columns.index(f"fly_q{word}")] for word in "wxyz"]
    assert found[0, 0] == pytest.approx(expected, abs=1e-12) and abs(expected[2]) > 0.01


def test_a_touched_object_is_held_while_mujoco_steps(tmp_path):
    """The arm rests on a box that would fall: what stays where it is must be what is stepped."""
    text = """<mujoco><option timestep="0.001"/><worldbody>
      <body name="arm"><joint name="hinge" axis="0 1 0" damping="0.1"/>
        <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.02" mass="0.5"/></body>
      <body name="box" pos="0.35 0 -0.1"><freejoint/>
        <geom type="box" size="0.05 0.05 0.05" mass="1"/></body></worldbody>
      <actuator><motor name="motor" joint="hinge"/></actuator></mujoco>"""
    rig = rig_named(str(written(tmp_path, text)))
    assert isinstance(rig, SteppedMechanism)
    assert any("'of box'" in r and "held where it stands" in r for r in rig.remarks)
    a = Assembly(rig)
    p = a.values()
    memory = a.program.memory(a.start(p), period_s=0.005)
    y, _, bad = a.program.run(memory, SampledInputs(np.zeros((200, 1)), 0.005), p)
    assert bad < 0
    held = mujoco.MjModel.from_xml_string(text.replace("<freejoint/>", ""))
    data = mujoco.MjData(held)
    mujoco.mj_step(held, data, 995)
    assert y[-1, 0] == pytest.approx(data.qpos[0], abs=1e-3) and y[-1, 0] > 0.05


def test_all_states_are_carried_from_step_to_step(tmp_path):
    rig = SteppedMechanism(read_mechanism(written(tmp_path, MOVING)))
    model = mujoco.MjModel.from_xml_string(MOVING)
    model.opt.tolerance, data = 1e-13, mujoco.MjData(model)
    p, x = Assembly(rig).values()[None], np.zeros((1, len(rig.states)))
    x[0] = [*data.qpos, *data.qvel, *data.act, *data.plastic]
    for k in range(100):
        u = np.array([0.6, 1.0, 5.0, 0.3]) * np.sin(0.02 * k)
        data.ctrl[:] = u
        mujoco.mj_step(model, data)
        x, _ = rig.steps(x, np.array([[*u, *np.zeros(5)]]), p, 0.001, ())
    after = np.array([*data.qpos, *data.qvel, *data.act, *data.plastic])
    assert abs(data.plastic[0] - 0.2) > 0.04
    assert np.abs(x[0] - after).max() < 1e-7
