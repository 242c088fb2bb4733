"""What is drawn of a robot model stands where MuJoCo puts it."""

import numpy as np
import pytest

from pamid.base.errors import DataError
from pamid.rigs.simulators.mechanism_pose import mechanism_pose
from pamid.rigs.simulators.mujoco_mechanism import read_mechanism

mujoco = pytest.importorskip("mujoco")
SAMPLES = 5
ARM = """
<mujoco model="crane">
  <worldbody>
    <body name="rail" pos="0.1 0 1" euler="0 20 0">
      <joint name="way" type="slide" axis="1 0 0"/>
      <geom type="box" size="0.1 0.1 0.1"/>
      <body name="boom" pos="0.2 0 0.1">
        <joint name="lift" type="hinge" axis="0 1 0" pos="0 0 0.05" ref="10"/>
        <geom type="capsule" fromto="0 0 0 0.4 0 0.1" size="0.02"/>
        <body name="hook" pos="0.4 0 0.1" quat="0.9 0.1 0.3 0.2">
          <joint name="swing" type="hinge" axis="0 1 0.1"/>
          <geom type="sphere" pos="0 0 -0.2" size="0.03"/>
        </body>
      </body>
    </body>
  </worldbody>
  <sensor>
    <jointpos name="way" joint="way"/><jointpos name="lift" joint="lift"/>
    <jointpos name="swing" joint="swing"/>
  </sensor>
</mujoco>
"""


def test_chains_pass_through_the_joints_and_end_at_the_last_mass(tmp_path):
    path = tmp_path / "crane.xml"
    path.write_text(ARM, encoding="utf-8")
    m = read_mechanism(path)
    random = np.random.default_rng(4)
    y = {s.column: random.uniform(-1.0, 1.0, SAMPLES) for s in m.sensors}
    pose = mechanism_pose(m, y)
    assert list(pose) == ["hook"] and pose["hook"].shape == (SAMPLES, 4, 2)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    for k in range(SAMPLES):
        data.qpos[:] = [y[s.column][k] for s in m.sensors]
        mujoco.mj_forward(model, data)
        # a carriage is drawn where it is, not where it stood
        places = [data.xpos[1], *data.xanchor[1:], data.xipos[3]]
        # seen along y: x to the right, z up
        np.testing.assert_allclose(pose["hook"][k], [p[[0, 2]] for p in places], atol=1e-9)


def test_a_joint_that_nothing_reads_is_named(tmp_path):
    path = tmp_path / "crane.xml"
    path.write_text(ARM.replace('<jointpos name="swing" joint="swing"/>', ""), encoding="utf-8")
    m = read_mechanism(path)
    with pytest.raises(DataError, match="'swing'"):
        mechanism_pose(m, {s.column: np.zeros(2) for s in m.sensors})
