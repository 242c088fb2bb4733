"""A link behind a spring or a gap, as MuJoCo has it with two joints on one axis, against the
effects at the transmission of the model that lacks it: the weight is borne by the link."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pamid.base.arrays import Array
from pamid.engine.program import Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.model.assembly import Assembly
from pamid.model.attachment import attachments
from pamid.model.registry import effects
from pamid.rigs.simulators.compiled_rig import CompiledMechanism
from pamid.rigs.simulators.mujoco_mechanism import read_mechanism

mujoco = pytest.importorskip("mujoco", reason="pip install 'pamid[mujoco]'")

PERIOD, SAMPLES, MASS, LENGTH = 0.004, 1000, 1.0, 0.4
INERTIA = MASS * LENGTH**2 / 3.0
MODEL = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.0005" integrator="RK4"/>
  <worldbody><body>
    <joint name="motor" axis="0 1 0" damping="0.1" armature="0.02"/>
    {behind}
    <inertial pos="0 0 -0.2" mass="1" diaginertia="0.0133333333 0.0133333333 0.001"/>
  </body></worldbody>
  <actuator><position name="drive" joint="motor" kp="30" kv="1.8"/></actuator>
  <sensor><jointpos name="angle" joint="motor"/></sensor>
</mujoco>
"""
SENT = np.repeat(np.random.default_rng(1).uniform(-0.5, 0.5, SAMPLES // 100), 100)  # rad


def in_mujoco(behind: str, *, far: bool = False) -> Array:
    """Angles of the motor, or of the link on its far side (samples,), read before each command."""
    model = mujoco.MjModel.from_xml_string(MODEL.format(behind=behind))
    data, found = mujoco.MjData(model), []
    for angle in SENT:
        found.append(float(data.qpos.sum() if far else data.qpos[0]))
        data.ctrl[0] = angle
        mujoco.mj_step(model, data, round(PERIOD / model.opt.timestep))
    return np.array(found)


def in_pamid(folder: Path, name: str = "", **values: float) -> Array:
    """The same by the model without it, with an effect at the transmission."""
    path = folder / "model.xml"
    path.write_text(MODEL.format(behind=""))
    rig = CompiledMechanism(read_mechanism(path))
    named: Any = [effects()[name]] if name else []
    a = Assembly(rig, tuple(attachments(rig, named)), sizes={("", "timescale"): 1.0})
    p = a.values()
    for k, b in enumerate(a.parameters):
        if name and b.owner == name:
            p[k] = values[b.name]
    memory = a.program.memory(a.start(p), stepping=Stepping(4), period_s=PERIOD)
    y, _, bad = a.program.run(memory, SampledInputs(SENT[:, None], PERIOD), p, stepping=Stepping(4))
    assert bad < 0
    return y[:, 0]


def test_a_link_behind_a_spring_bears_its_weight(tmp_path):
    stiffness = INERTIA * (2.0 * math.pi * 5.0) ** 2
    damping = 2.0 * 0.05 * math.sqrt(stiffness * INERTIA)
    truth = in_mujoco(
        f'<joint name="link" axis="0 1 0" stiffness="{stiffness}" damping="{damping}"/>'
    )
    found = in_pamid(tmp_path, "two-mass", share=1.0, frequency_hz=5.0, damping=0.05)
    rigid = in_pamid(tmp_path)
    # what is left is the step of the integrators
    assert np.abs(found - truth).mean() < 1e-6 * np.abs(rigid - truth).mean()


def test_a_link_behind_a_gap_lies_on_one_side_of_it(tmp_path):
    truth = in_mujoco(
        '<joint name="link" axis="0 1 0" range="-0.015 0.015" limited="true" '
        'solreflimit="0.02 0.7"/>'
    )
    found = in_pamid(
        tmp_path, "backlash", share=1.0, half_gap_rad=0.015, frequency_hz=15.0, damping=0.5
    )
    rigid = in_pamid(tmp_path)
    # MuJoCo's stop is another one; with the weight on the motor's side 0.45: the link would float
    assert np.abs(found - truth).mean() < 0.3 * np.abs(rigid - truth).mean()


def test_an_encoder_behind_a_gap_reads_the_link(tmp_path):
    """The servo's own loop sees its motor."""
    truth = in_mujoco(
        '<joint name="link" axis="0 1 0" range="-0.015 0.015" limited="true" '
        'solreflimit="0.02 0.7"/>',
        far=True,
    )
    contact = {"share": 1.0, "half_gap_rad": 0.015, "frequency_hz": 15.0, "damping": 0.5}
    found = in_pamid(tmp_path, "load-side-backlash", **contact, motor_feedback=1.0)
    rigid = in_pamid(tmp_path)
    assert np.abs(found - truth).mean() < 0.3 * np.abs(rigid - truth).mean()
    # a loop over the encoder behind the gap would lift the link by what the gap lets it hang
    closed = in_pamid(tmp_path, "load-side-backlash", **contact, motor_feedback=0.0)
    assert np.abs(closed - truth).mean() > 2.0 * np.abs(found - truth).mean()


def test_without_an_outboard_part_nothing_changes(tmp_path):
    found = in_pamid(tmp_path, "two-mass", share=0.0, frequency_hz=5.0, damping=0.05)
    assert np.array_equal(found, in_pamid(tmp_path))


# ---- two joints ----------------------------------------------------------------------------------

ARM = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.0005" integrator="RK4"/>
  <worldbody><body>
    <joint name="shoulder" axis="0 1 0" damping="0.2" armature="0.04"/>
    {shoulder}
    <inertial pos="0 0 -0.25" mass="1.6" diaginertia="0.033 0.033 0.001"/>
    <body pos="0 0 -0.5">
      <joint name="elbow" axis="0 1 0" damping="0.05" armature="0.015"/>
      {elbow}
      <inertial pos="0 0 -0.2" mass="0.8" diaginertia="0.01 0.01 0.001"/>
    </body>
  </body></worldbody>
  <actuator><motor name="lift" joint="shoulder"/><motor name="bend" joint="elbow"/></actuator>
  <sensor>
    <jointpos name="shoulder_angle" joint="shoulder"/><jointpos name="elbow_angle" joint="elbow"/>
    <jointvel name="shoulder_speed" joint="shoulder"/><jointvel name="elbow_speed" joint="elbow"/>
  </sensor>
</mujoco>
"""


@pytest.mark.parametrize(("joint", "stiffness"), [("shoulder", 200.0), ("elbow", 15.0)])
def test_what_is_behind_a_spring_takes_the_other_joint_along(joint, stiffness, tmp_path):
    joints = ("shoulder", "elbow")
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(shoulder="", elbow=""))
    damping = 0.01 * stiffness
    spring = f'<joint name="link" axis="0 1 0" stiffness="{stiffness}" damping="{damping}"/>'
    model = mujoco.MjModel.from_xml_string(
        ARM.format(**{"shoulder": "", "elbow": "", joint: spring})
    )
    data, rigid = mujoco.MjData(model), mujoco.MjModel.from_xml_path(str(path))
    pose, twist = {"shoulder": (0.3, 0.7), "elbow": (0.5, -1.1)}, (0.1, 0.6)
    for name, (angle, speed) in (pose | {"link": twist}).items():
        data.joint(name).qpos[0], data.joint(name).qvel[0] = angle, speed
    data.ctrl[:] = torques = np.array([2.0, -0.4])
    mujoco.mj_forward(model, data)
    truth = [float(data.joint(name).qacc[0]) for name in (*joints, "link")]

    of = joints.index(joint)
    usual = float(rigid.dof_M0[of]) - {"shoulder": 0.04, "elbow": 0.015}[joint]
    values = {
        "share": 1.0,
        "frequency_hz": math.sqrt(stiffness / usual) / (2.0 * math.pi),
        "damping": damping / (2.0 * math.sqrt(stiffness * usual)),
    }
    rig = CompiledMechanism(read_mechanism(path))
    at = f"{joint}_transmission"
    (effect,) = (a for a in attachments(rig, [effects()["two-mass"]]) if a.ports == (at,))
    a = Assembly(rig, (effect,), sizes={("", "timescale"): 1.0})
    p = a.values()
    for k, b in enumerate(a.parameters):
        p[k] = values[b.name] if b.owner else p[k]
    start = np.array([pose[n][k] for k in (0, 1) for n in joints] + list(twist))
    memory = a.program.memory(start, stepping=Stepping(1), period_s=(h := 1e-6))
    y, _, bad = a.program.run(
        memory, SampledInputs(np.array([torques, torques]), h), p, stepping=Stepping(1)
    )
    assert bad < 0
    found = (y[1, 2:4] - y[0, 2:4]) / h
    np.testing.assert_allclose(found, truth[:2], rtol=1e-4)


@pytest.mark.parametrize("name", ["two-mass", "backlash"])
def test_sensitivities_in_a_twisted_arm(name, tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(shoulder="", elbow=""))
    rig = CompiledMechanism(read_mechanism(path))
    (effect,) = (
        a for a in attachments(rig, [effects()[name]]) if a.ports == ("shoulder_transmission",)
    )
    a = Assembly(rig, (effect,), sizes={("", "timescale"): 1.0})
    p, width = a.values(), len(a.parameters)
    p[a.keys[f"{effect.label}:share"]] = 0.8
    random = np.random.default_rng(2)
    u = np.repeat(random.uniform(-1.0, 1.0, (20, 2)) * [4.0, 1.0], 20, axis=0)

    def run(p, width=0):
        memory = a.program.memory(a.start(p), width, stepping=Stepping(2), period_s=PERIOD)
        columns = np.arange(width) if width else None
        y, s, bad = a.program.run(
            memory, SampledInputs(u, PERIOD), p, stepping=Stepping(2), columns=columns
        )
        assert bad < 0
        return y, s

    slopes = run(p, width)[1]
    for k, b in enumerate(a.parameters):
        h = 1e-6 * max(abs(p[k]), 1e-3 * (b.high - b.low))
        if p[k] - h < b.low:  # friction that is none has no slope to the left
            continue
        up, down = p.copy(), p.copy()
        up[k], down[k] = p[k] + h, p[k] - h
        rough = (run(up)[0] - run(down)[0]) / (2.0 * h)
        size = float(np.abs(rough).max())
        if size:
            assert np.abs(slopes[:, :, k] - rough).max() < 2e-4 * size, b.key
