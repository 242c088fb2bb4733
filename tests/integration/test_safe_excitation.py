"""An excitation of a MuJoCo or URDF model keeps its joints' ranges, speeds and forces, and its
bodies apart: judged by MuJoCo itself, with its limits in force, on what was written."""

import json
from pathlib import Path
from typing import Any

import mechanisms
import numpy as np
import pytest
from pamid_cli import frame

from pamid.api.exciting import within_limits
from pamid.base.arrays import Array
from pamid.base.errors import DataError, UsageError
from pamid.recording.recording import read_recording
from pamid.simulation.excitation.aprbs import aprbs

mujoco: Any = mechanisms.needs_mujoco()

PERIOD_S = 0.005

ARM = """<mujoco model="arm">
  <compiler angle="radian"/>
  <option timestep="0.0025"/>
  <default><joint damping="0.4" armature="0.01"/></default>
  <worldbody>
    <geom name="post" type="box" size="0.02 0.05 0.05" pos="{post} 0 -0.35"/>
    <body name="upper">
      <joint name="shoulder" axis="0 1 0" range="-1.5 {high}" limited="true"/>
      <geom name="upper" type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03" mass="1.2"/>
      <body name="forearm" pos="0 0 -0.4">
        <joint name="elbow" axis="0 1 0" range="-0.2 2.4" limited="true"/>
        <geom name="forearm" type="capsule" fromto="0 0 -0.07 0 0 -0.35" size="0.02" mass="0.5"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="m1" joint="shoulder" gear="6" ctrlrange="-1 1"/>
    <position name="m2" joint="elbow" kp="12" kv="1" {force}/>
  </actuator>
</mujoco>
"""
COLUMNS = ("m1_command", "m2_command_rad")
LEVER = """<robot name="lever"><link name="base"/><link name="lever"><inertial>
  <origin xyz="0 0 -0.2"/><mass value="1.5"/>
  <inertia ixx="0.02" iyy="0.02" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="pivot-1" type="revolute"><parent link="base"/><child link="lever"/>
  <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="{speed}"/>
  <dynamics damping="0.3"/></joint></robot>"""


def arm(folder: Path, post: float = 9.0, high: float = 1.5, force: str = "") -> Path:
    path = folder / "arm.xml"
    path.write_text(ARM.format(post=post, high=high, force=force))
    return path


def drawn(seconds: float = 8.0, sizes: tuple[float, float] = (0.5, 0.5)) -> dict[str, Array]:
    return {
        column: aprbs(seconds, PERIOD_S, size, seed=[3, k])
        for k, (column, size) in enumerate(zip(COLUMNS, sizes, strict=True))
    }


def run(path: Path, sent: dict[str, Array]) -> tuple[Array, Array, set[str]]:
    """Positions and forces of the drives (samples, 2), and geoms that touch, in plain MuJoCo."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data, touched = mujoco.MjData(model), set()
    u = np.stack([sent[column] for column in COLUMNS], axis=1)
    q, f = np.empty_like(u), np.empty_like(u)
    for k, now in enumerate(u):
        data.ctrl[:] = now
        mujoco.mj_step(model, data, 2)
        q[k], f[k] = data.qpos, data.actuator_force
        touched |= {model.geom(int(g)).name for c in data.contact for g in c.geom}
    return q, f, touched


def test_what_keeps_all_limits_is_sent_as_it_is(tmp_path):
    sent = drawn(sizes=(0.1, 0.1))
    sent["m2_command_rad"] = sent["m2_command_rad"] + 0.5 * (sent["m2_command_rad"] != 0.0)
    made = within_limits(arm(tmp_path), sent, PERIOD_S, centres={"m2_command_rad": 0.5})
    assert made is not None and not any(one.changed for one in made.limits.commands)
    assert all(np.array_equal(made.columns[c], sent[c]) for c in COLUMNS)
    assert "It is within all limits without changes." in made.sentences()


def test_ranges_move_positions_and_shrink_torques(tmp_path):
    path, sent = arm(tmp_path, high=0.35), drawn()
    assert run(path, sent)[0][:, 0].max() > 0.35 and run(path, sent)[0][:, 1].min() < -0.2
    made = within_limits(path, sent, PERIOD_S)
    assert made is not None
    motor, servo = made.limits.commands
    assert motor.factor < 1.0 and "joint shoulder would leave -1.5 .. 0.35 at" in motor.why[-1]
    assert servo.shift > 0.1 and servo.factor == 1.0
    q = run(path, dict(made.columns))[0]
    assert q[:, 0].min() >= -1.5 and q[:, 0].max() <= 0.35
    assert q[:, 1].min() >= -0.2 and q[:, 1].max() <= 2.4
    np.testing.assert_allclose(
        made.limits.reached["elbow"], (q[:, 1].min(), q[:, 1].max()), atol=1e-9
    )
    # the signals are still each its own
    inner = [made.columns[c][200:] for c in COLUMNS]
    assert abs(np.corrcoef(inner)[0, 1]) < 0.6


def test_forces_are_never_asked_for_beyond_their_range(tmp_path):
    path, sent = arm(tmp_path, force='forcerange="-3 3"'), drawn()
    assert np.abs(run(path, sent)[1][:, 1]).max() == 3.0  # clipped
    made = within_limits(path, sent, PERIOD_S)
    assert made is not None and made.limits.commands[1].factor < 1.0
    assert any(
        "m2 would have to exert more than -3 .. 3" in why for why in made.limits.commands[1].why
    )
    assert np.abs(run(path, dict(made.columns))[1][:, 1]).max() < 3.0


def test_bodies_do_not_touch(tmp_path):
    path, sent = arm(tmp_path, post=0.42), drawn()
    assert run(path, sent)[2] >= {"post"}
    made = within_limits(path, sent, PERIOD_S)
    assert made is not None and run(path, dict(made.columns))[2] == set()
    assert any("post would touch" in why for one in made.limits.commands for why in one.why)


def test_bodies_that_touch_at_the_start_may_go_on(tmp_path):
    path = arm(tmp_path, post=0.04)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon
    made = within_limits(path, drawn(4.0, (0.05, 0.05)), PERIOD_S)
    assert made is not None and not any(
        "touch" in why for one in made.limits.commands for why in one.why
    )


@pytest.mark.parametrize("speed", [0.0, 1.2])
def test_a_urdfs_speed_and_effort(tmp_path, speed):
    path = tmp_path / "lever.urdf"
    path.write_text(LEVER.format(speed=speed))
    sent = {"pivot_1_torque_nm": aprbs(6.0, PERIOD_S, 2.0, seed=1)}
    made = within_limits(path, sent, PERIOD_S)
    assert made is not None
    limited = any("pivot_1 would exceed 1.2 rad/s" in why for why in made.limits.commands[0].why)
    assert limited == (speed > 0.0)  # 0 is what tools write for "not known"
    other = within_limits(path, sent, PERIOD_S, speed_limits={"pivot_1": 0.6})
    assert other is not None and other.limits.commands[0].factor < made.limits.commands[0].factor
    path.write_text(LEVER.format(speed=0))
    heavy = {"pivot_1_torque_nm": 12.0 * np.sign(sent["pivot_1_torque_nm"])}
    kept = within_limits(path, heavy, PERIOD_S)
    assert kept is not None and np.abs(kept.columns["pivot_1_torque_nm"]).max() <= 10.0


def test_where_nothing_is_left_it_is_said(tmp_path):
    path = arm(tmp_path)
    with pytest.raises(DataError, match="no signal is possible for m1_command") as caught:
        within_limits(path, drawn(4.0), PERIOD_S, speed_limits={"shoulder": 1e-4})
    assert caught.value.code == "no-room"
    path.write_text(path.read_text().replace('range="-1.5 1.5"', 'range="0.5 1.5"'))
    with pytest.raises(DataError, match="shoulder starts at 0, outside"):
        within_limits(path, drawn(4.0), PERIOD_S)
    # a horizontal arm falls by itself
    lying = ARM.replace("<option ", '<option gravity="-9.81 0 0" ')
    path.write_text(lying.format(post=9.0, high=1.5, force=""))
    with pytest.raises(DataError, match="with a command of zero, joint shoulder would leave"):
        within_limits(path, drawn(4.0), PERIOD_S)
    with pytest.raises(UsageError, match="Did you mean 'shoulder'"):
        within_limits(path, drawn(4.0), PERIOD_S, speed_limits={"sholder": 1.0})
    assert within_limits(path, {"other": np.zeros(9)}, PERIOD_S) is None
    assert within_limits("dc-motor", {"voltage_v": np.zeros(9)}, PERIOD_S) is None


def test_the_command_writes_and_says_what_was_done(tmp_path, capsys, cli):
    path, output = arm(tmp_path, post=0.42, high=0.35), tmp_path / "sent.csv"
    words = ["generate-aprbs", "--rig", str(path), "--duration", "6", "--seed", "3", "--period",
             str(PERIOD_S), "--output", str(output)]  # fmt: skip
    note = cli(*words)
    limits, sent = note["limits"], read_recording(output)
    assert [one["column"] for one in limits["commands"]] == list(COLUMNS)
    q, _, touched = run(path, {c: sent.columns[c] for c in COLUMNS})
    assert not touched and q[:, 0].max() <= 0.35
    for one in note["columns"]:
        values = sent.columns[one["column"]]
        assert one["range"][0] - 1e-9 <= values.min() and values.max() <= one["range"][1] + 1e-9
    assert frame.run([*words, "--no-limits", "--overwrite"]) == 0
    assert "Run on the model" not in capsys.readouterr().out
    assert run(path, {c: read_recording(output).columns[c] for c in COLUMNS})[2]
    assert frame.run([*words, "--overwrite", "--speed-limit", "fast"]) == 2
    assert "Write elbow=2." in capsys.readouterr().err


def test_a_urdf_is_excited_without_naming_a_column(tmp_path):
    path = tmp_path / "lever.urdf"
    path.write_text(LEVER.format(speed=0))
    output = tmp_path / "sent.csv"
    words = ["generate-aprbs", "--rig", str(path), "--duration", "6", "--output", str(output)]
    assert frame.run(words) == 0
    assert list(read_recording(output).columns) == ["pivot_1_torque_nm"]


@pytest.mark.slow
def test_power_works_on_a_model_and_its_excitation(tmp_path, capsys):
    path, output = tmp_path / "one.xml", tmp_path / "sent.csv"
    path.write_text(mechanisms.ONE)
    words = ["generate-aprbs", "--rig", str(path), "--duration", "8", "--period", "0.01"]
    assert frame.run([*words, "--seed", "1", "--output", str(output)]) == 0
    capsys.readouterr()
    asked = ["power", "--rig", str(path), "--excitation", str(output), "--json"]
    assert frame.run(asked) == 0
    found = json.loads(capsys.readouterr().out)
    friction = next(one for one in found["effects"] if one["effect"].startswith("coulomb-friction"))
    assert friction["port"] == "shoulder" and max(friction["visible"]) >= found["seen"]
