"""Runs of a model file in plain MuJoCo on recorded stretches."""

from typing import Any

import mechanisms
import numpy as np
import pytest

from pamid.rigs.simulators.mujoco_file import open_mujoco
from pamid.rigs.simulators.mujoco_mechanism import read_mechanism
from pamid.rigs.simulators.plain_mujoco import PlainModel, RecordedStretch

mujoco: Any = mechanisms.needs_mujoco()

WHIP = """<mujoco model="whip">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="RK4"/>
  <worldbody>
    <body>
      <joint name="a" axis="0 1 0"/>
      <inertial pos="0 0 -0.3" mass="1" diaginertia="0.02 0.02 0.001"/>
      <body pos="0 0 -0.5">
        <joint name="b" axis="0 1 0"/>
        <inertial pos="0 0 -0.2" mass="0.5" diaginertia="0.005 0.005 0.001"/>
        <body pos="0 0 -0.4">
          <joint name="c" axis="0 1 0"/>
          <inertial pos="0 0 -0.1" mass="0.2" diaginertia="0.001 0.001 0.001"/>
        </body>
      </body>
    </body>
  </worldbody>
  <sensor>
    <jointpos name="qa" joint="a"/><jointpos name="qb" joint="b"/><jointpos name="qc" joint="c"/>
  </sensor>
</mujoco>
"""
PERIOD_S, SAMPLES, NOISE = 0.01, 100, 1e-4


@pytest.mark.parametrize("seed", range(3))
def test_start_of_a_fast_undamped_arm_is_estimated_over_a_long_opening(seed, tmp_path):
    """Over the whole opening the arm of the first guess swings another way."""
    file = tmp_path / "whip.xml"
    file.write_text(WHIP)
    model, random = mujoco.MjModel.from_xml_string(WHIP), np.random.default_rng(seed)
    data, rows = mujoco.MjData(model), []
    data.qpos[:], data.qvel[:] = random.uniform(-2.0, 2.0, 3), random.uniform(-15.0, 15.0, 3)
    for _ in range(SAMPLES):
        rows.append(data.qpos.copy())
        mujoco.mj_step(model, data, round(PERIOD_S / model.opt.timestep))
    y = np.array(rows) + NOISE * random.standard_normal((SAMPLES, 3))
    mechanism = read_mechanism(file)
    readings = {s.column: y[:, i] for i, s in enumerate(mechanism.sensors)}
    times, scored = PERIOD_S * np.arange(SAMPLES), np.ones(SAMPLES, bool)
    stretch = RecordedStretch(times, {}, {}, readings, scored, 90)
    noise = dict.fromkeys(readings, NOISE)
    errors = PlainModel(open_mujoco(file), mechanism).errors([stretch], noise)
    assert max(errors.values()) < 1.2 * NOISE
