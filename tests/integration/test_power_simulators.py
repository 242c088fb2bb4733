"""What an experiment would show of somebody's simulation: a MuJoCo model as equations, the same
model stepped by MuJoCo, and a step in Python, through one interface."""

from pathlib import Path

import numpy as np
import pytest

import pamid
from pamid.model.rig import Rig
from pamid.recording.recording import Recording, recording_of

pytest.importorskip("mujoco", reason="the extra [mujoco] is not installed")

SWING = """<mujoco model="swing">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="RK4"/>
  <worldbody><body>
    <joint name="hinge" axis="0 1 0" damping="0.05" armature="0.01"/>
    <inertial pos="0 0 -0.2" mass="0.6" diaginertia="0.008 0.008 0.001"/>
  </body></worldbody>
  <actuator><motor name="push" joint="hinge"/></actuator>
  <sensor><jointpos name="angle" joint="hinge" noise="0.002"/></sensor>
</mujoco>
"""
PERIOD_S, SAMPLES = 0.02, 300
KINDS = ("coulomb-friction", "cubic-stiffness", "quantisation@angle")


def _excitation(column: str, most: float) -> Recording:
    levels = np.repeat(np.random.default_rng(3).uniform(-most, most, SAMPLES // 20), 20)
    meta = {"recording": {"sampling_period_s": PERIOD_S, "loop": "open"}}
    return recording_of(PERIOD_S * np.arange(SAMPLES), {column: levels}, meta, name="levels")


def _power(excitation: Recording, rig: Rig | str) -> dict[str, tuple[float, ...]]:
    """How visible every effect is at every size."""
    found = pamid.power(excitation, rig, progress=False)
    assert found.showing and found.to_dict()["effects"]
    return {e.effect: e.visible for e in found.effects}


def test_a_mujoco_model_shows_the_same_as_equations_and_stepped(tmp_path):
    from pamid.rigs.simulators.mujoco_mechanism import read_mechanism
    from pamid.rigs.simulators.stepped_mechanism import SteppedMechanism

    path = tmp_path / "swing.xml"
    path.write_text(SWING)
    excitation = _excitation("push_command", 0.8)
    equations = _power(excitation, str(path))
    stepped = _power(excitation, SteppedMechanism(read_mechanism(path)))
    # what lets a link move against its motor wants equations
    assert set(equations) - set(stepped) == {"two-mass", "backlash", "load-side-backlash"}
    assert set(stepped) <= set(equations)
    for name in KINDS:
        # there a force is held over a step, here it follows the motion within it
        assert equations[name][-1] > 1.5
        np.testing.assert_allclose(stepped[name], equations[name], rtol=0.08, err_msg=name)


@pytest.mark.parametrize("name", ["stepped_pendulum.py"])
def test_a_step_in_python(name):
    path = Path(__file__).parents[2] / "data" / "rigs" / name
    found = _power(_excitation("force_n", 6.0), str(path))
    assert {"coulomb-friction@rail", "quantisation@encoder"} <= set(found)
    assert found["coulomb-friction@rail"][-1] > 1.1
