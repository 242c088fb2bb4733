"""The two-link arm: MuJoCo as an independent judge of its mechanics, and what has to hold by
physics."""

from typing import Any

import numpy as np
import pytest

from pamid.base.arrays import Array
from pamid.engine.program import Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.model.assembly import Assembly
from pamid.model.registry import rig_named
from pamid.rigs.two_link import MUSCLES

mujoco = pytest.importorskip(
    "mujoco", reason="MuJoCo, the judge of the mechanics, is not installed"
)


ARM = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 -9.81" timestep="0.001" integrator="RK4"><flag contact="disable"/></option>
  <worldbody>
    <body name="link_1">
      <joint name="one" type="hinge" axis="0 1 0" damping="{b1}"/>
      <inertial pos="0 0 -{c1}" mass="{m1}" diaginertia="{i1} {i1} {i1}"/>
      <body name="link_2" pos="0 0 -{l1}">
        <joint name="two" type="hinge" axis="0 1 0" damping="{b2}"/>
        <inertial pos="0 0 -{c2}" mass="{m2}" diaginertia="{i2} {i2} {i2}"/>
        <body name="payload" pos="0 0 -{l2}">
          <inertial pos="0 0 0" mass="{mp}" diaginertia="2e-15 2e-15 2e-15"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
OWN = {
    "link_1_mass": "m1",
    "link_1_centre": "c1",
    "link_1_inertia": "i1",
    "link_1_length": "l1",
    "link_2_mass": "m2",
    "link_2_centre": "c2",
    "link_2_inertia": "i2",
    "link_2_length": "l2",
    "payload": "mp",
    "viscous_1": "b1",
    "viscous_2": "b2",
}


def arm() -> Assembly:
    return Assembly(rig_named("two-link"), outputs=("angle_1_deg", "angle_2_deg"))


def parameters(a: Assembly, **changed: float) -> Array:
    """The data sheet's with some changed (SI, by key)."""
    p = a.values()
    for key, value in changed.items():
        p[a.keys[key]] = value
    return p


def judge(a: Assembly, p: Array) -> tuple[Any, Any]:
    """MuJoCo's arm with the same links."""
    numbers = {short: repr(float(p[a.keys[key]])) for key, short in OWN.items()}
    model = mujoco.MjModel.from_xml_string(ARM.format(**numbers))
    return model, mujoco.MjData(model)


def rates(a: Assembly, p: Array, x: Array, u: Array) -> Array:
    """dx/dt at a state: outputs of a program that has the state's rates among them."""
    program = a.program_with({f"rate.{s.name}": a.traced.rates[s.name] for s in a.rig.states})
    memory = program.memory(x, stepping=Stepping(), period_s=1e-9)
    out, _, bad = program.run(memory, SampledInputs(u[None, :], 1e-9), p, stepping=Stepping())
    assert bad < 0
    return out[0, -len(a.rig.states) :]


def test_accelerations_are_those_of_mujoco():
    """At random states, relative to the larger of the two joints'."""
    a, random = arm(), np.random.default_rng(0)
    p = parameters(a, attached=0.0, payload=0.35)
    model, data = judge(a, p)
    for _ in range(1000):
        q, w = random.uniform(-3.1, 3.1, 2), random.uniform(-8.0, 8.0, 2)
        torque = random.uniform(-20.0, 20.0, 2)
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, w, torque
        mujoco.mj_forward(model, data)
        state = np.concatenate([q, w, np.full(4, 6e5)])
        mine = rates(a, p, state, np.array([0.0, 0.0, *torque]))[2:4]
        assert np.abs(mine - data.qacc).max() < 1e-12 * np.abs(data.qacc).max()


@pytest.mark.parametrize("how", ["clamped", "nothing there"])
def test_without_its_second_link_it_is_the_joint_of_the_first_paper(how):
    a, joint = arm(), Assembly(rig_named("one-dof"), outputs=("angle_deg", "pressure_1_kpa"))
    gone = {"link_2_mass": 0.0, "link_2_inertia": 1e-9, "radius_2": 0.0, "viscous_2": 0.0}
    p = parameters(
        a,
        plane=0.0,
        radius_1=0.03,
        viscous_1=0.02,
        link_1_mass=0.0,
        link_1_inertia=0.0896,
        **({"clamped_2": 1.0} if how == "clamped" else {}),
        **gone,
    )
    other = joint.values({"inertia_kg_m2": 0.0896})
    random, worst = np.random.default_rng(1), 0.0
    for _ in range(200):
        angle, speed = random.uniform(-0.6, 0.6), random.uniform(-4.0, 4.0)
        first, second = random.uniform(1.2e5, 6.4e5, 2)
        command, torque = random.uniform(-1.0, 1.0), random.uniform(-3.0, 3.0)
        mine = rates(
            a,
            p,
            np.array([angle, 0.0, speed, 0.0, first, second, 3e5, 3e5]),
            np.array([command, 0.0, torque, 0.0]),
        )
        theirs = rates(
            joint, other, np.array([angle, speed, first, second]), np.array([command, torque])
        )
        # a link of 1e-9 kg m2 at joint 2 adds as much to the 0.0896 kg m2 where the joint is
        # clamped
        worst = max(worst, float(np.abs(mine[[0, 2, 4, 5]] / theirs - 1.0).max()))
    assert worst < 2e-8


def test_a_chain_over_joint_1_pulls_there_what_it_winds():
    """Virtual work: the torques of the muscles are the slopes of their lengths, times their
    forces."""
    a = Assembly(rig_named("two-link"))
    x, u = np.array([0.2, 0.3, 0.0, 0.0, *4 * (5e5,)]), np.zeros(4)
    plain, wrapped = parameters(a, plane=0.0), parameters(a, plane=0.0, wrap_radius=0.02)
    program = a.program
    outputs = {}
    for name, p, angle in (("wrapped", wrapped, 0.2), ("moved", wrapped, 0.2 + 1e-5)):
        state = x.copy()
        state[0] = angle
        memory = program.memory(state, stepping=Stepping(), period_s=1e-9)
        y = program.run(memory, SampledInputs(u[None, :], 1e-9), p, stepping=Stepping())[0][0]
        outputs[name] = dict(zip(program.outputs, y, strict=True))
    slope = {
        i: (outputs["moved"][f"contraction_{i}"] - outputs["wrapped"][f"contraction_{i}"]) / 1e-5
        for i in MUSCLES
    }
    length = plain[a.keys["length"]]
    assert slope["21"] == pytest.approx(0.02 / length, rel=1e-6)
    pulls = sum(outputs["wrapped"][f"force_{i}_n"] * slope[i] * length for i in MUSCLES)
    shift = [rates(a, wrapped, x, np.array([0.0, 0.0, t, 0.0]))[2:4] for t in (0.0, -pulls)]
    assert np.abs(rates(a, wrapped, x, u)[2:4] - shift[0]).max() == 0.0
    # with that torque taken away at joint 1 only joint 2's own muscles are left
    own = (
        sum(outputs["wrapped"][f"force_2{k}_n"] * s for k, s in (("1", 1.0), ("2", -1.0)))
        * plain[a.keys["radius_2"]]
    )
    m = np.linalg.inv(
        np.stack(
            [
                rates(a, plain, x, np.array([0.0, 0.0, *e]))[2:4] - rates(a, plain, x, u)[2:4]
                for e in np.eye(2)
            ],
            axis=1,
        )
    )
    assert m @ shift[1] == pytest.approx([0.0, own], abs=1e-6)
