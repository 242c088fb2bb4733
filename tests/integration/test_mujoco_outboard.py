"""A link behind a spring or a gap, as MuJoCo has it with two joints on one axis, against the
effects at the transmission of the model that lacks it: the weight is borne by the link."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pamid.engine.program import Stepping
from pamid.model.assembly import Assembly
from pamid.model.attachment import attachments
from pamid.model.registry import effects
from pamid.simulators.compiled_rig import CompiledMechanism
from pamid.simulators.mujoco_mechanism import read_mechanism

mujoco = pytest.importorskip("mujoco", reason="pip install 'pamid[mujoco]'")

Array = NDArray[np.float64]
PERIOD, SAMPLES, ARMATURE, MASS, LENGTH = 0.004, 1000, 0.02, 1.0, 0.4
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
SHARE = INERTIA / (INERTIA + ARMATURE)
SENT = np.repeat(np.random.default_rng(1).uniform(-0.5, 0.5, SAMPLES // 100), 100)  # rad


def in_mujoco(behind: str) -> Array:
    """Angles of the motor (samples,), read before each command."""
    model = mujoco.MjModel.from_xml_string(MODEL.format(behind=behind))
    data, found = mujoco.MjData(model), []
    for angle in SENT:
        found.append(float(data.qpos[0]))
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
    y, _, bad = a.program.run(memory, SENT[:, None], p, period_s=PERIOD, stepping=Stepping(4))
    assert bad < 0
    return y[:, 0]


def test_a_link_behind_a_spring_bears_its_weight(tmp_path: Path) -> None:
    stiffness = INERTIA * (2.0 * math.pi * 5.0) ** 2
    damping = 2.0 * 0.05 * math.sqrt(stiffness * INERTIA)
    truth = in_mujoco(
        f'<joint name="link" axis="0 1 0" stiffness="{stiffness}" damping="{damping}"/>'
    )
    found = in_pamid(tmp_path, "two-mass", share=SHARE, frequency_hz=5.0, damping=0.05)
    rigid = in_pamid(tmp_path)
    # with the weight on the motor's side 0.15; what is left is that it hangs from q, not q + twist
    assert np.abs(found - truth).mean() < 0.12 * np.abs(rigid - truth).mean()


def test_a_link_behind_a_gap_lies_on_one_side_of_it(tmp_path: Path) -> None:
    truth = in_mujoco(
        '<joint name="link" axis="0 1 0" range="-0.015 0.015" limited="true" '
        'solreflimit="0.02 0.7"/>'
    )
    found = in_pamid(
        tmp_path, "backlash", share=SHARE, half_gap_rad=0.015, frequency_hz=15.0, damping=0.5
    )
    rigid = in_pamid(tmp_path)
    # with the weight on the motor's side 0.45: the link would float within the gap
    assert np.abs(found - truth).mean() < 0.3 * np.abs(rigid - truth).mean()


def test_without_an_outboard_part_nothing_changes(tmp_path: Path) -> None:
    found = in_pamid(tmp_path, "two-mass", share=0.0, frequency_hz=5.0, damping=0.05)
    assert np.array_equal(found, in_pamid(tmp_path))
