"""Which parameters of a model are fitted, and how a user holds or releases one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mechanisms import ONE, TWO, written
from pamid_cli import frame

from pamid.model.between_samples import as_recorded
from pamid.model.registry import rig_named
from pamid.recording.recording import Recording, recording_of
from pamid.rigs.simulators.mechanism import ModelParameter
from pamid.rigs.simulators.mujoco_mechanism import read_mechanism

pytest.importorskip("mujoco", reason="pip install 'pamid[mujoco]'")

BARE = ONE.replace('damping="0.08" armature="0.004"', "")
LEVER = """<robot name="lever">
  <link name="base"/>
  <link name="lever"><inertial>
    <origin xyz="0 0 -0.2"/><mass value="1.5"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.001" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
  <joint name="pivot" type="continuous">
    <parent link="base"/><child link="lever"/><axis xyz="0 1 0"/>
  </joint>
</robot>
"""


def parameters(text: str, folder: Path) -> dict[str, ModelParameter]:
    path = folder / "model.xml"
    path.write_text(text)
    return {p.parameter.name: p for p in read_mechanism(path).parameters}


def log(**tables: dict[str, float]) -> Recording:
    t = 0.01 * np.arange(50)
    return recording_of(t, {"force_n": np.sin(t), "position_m": np.cos(t)}, tables)


def test_armature_and_damping_of_zero_are_fitted_and_friction_is_an_effect(tmp_path):
    found = parameters(BARE, tmp_path)
    fitted = {name for name, p in found.items() if not p.stated and p.parameter.fitted}
    assert fitted == {"shoulder_armature", "shoulder_damping"}
    assert not found["shoulder_frictionloss"].parameter.fitted
    assert not found["shoulder_stiffness"].parameter.fitted


def test_the_prior_of_a_zero_has_the_size_of_the_actuator(tmp_path):
    """A motor of 2 N m accelerates 0.2 kg m2 by 10 rad/s2; the rod alone has 0.05."""
    weak = parameters(BARE, tmp_path)["shoulder_armature"].parameter
    strong = parameters(BARE.replace('gear="2"', 'gear="40"'), tmp_path)
    spread = strong["shoulder_armature"].parameter.spread
    assert weak.value == 0.0 and weak.spread == pytest.approx(0.2 * 2.0 / 10.0)
    assert spread == pytest.approx(20.0 * weak.spread)
    unlimited = parameters(BARE.replace('ctrlrange="-1 1"', ""), tmp_path)["shoulder_armature"]
    inertia = read_mechanism(tmp_path / "model.xml").joints[0].typical_inertia
    assert unlimited.parameter.spread == pytest.approx(0.2 * inertia)


def test_what_the_file_states_keeps_its_tolerance(tmp_path):
    found = parameters(TWO, tmp_path)
    assert found["elbow_armature"].parameter.log and found["elbow_armature"].parameter.value == 0.01


def test_a_urdf_has_no_armature_and_no_damping_so_that_both_are_fitted(tmp_path):
    """Its <dynamics> has no armature, and few files have a <dynamics>."""
    path = written(tmp_path, LEVER, "lever.urdf")
    found = {p.name: p for p in rig_named(str(path)).parameters}
    for name in ("pivot_armature", "pivot_damping"):
        assert found[name].value == 0.0 and found[name].fitted and found[name].spread > 0.0
    damped = LEVER.replace("</joint>", '<dynamics damping="0.3"/></joint>', 1)
    (stated,) = (
        p.parameter
        for p in read_mechanism(written(tmp_path, damped, "damped.urdf")).parameters
        if p.parameter.name == "pivot_damping"
    )
    assert stated.value == 0.3 and stated.log


# ---- [free] ------------------------------------------------------------------------------------


def test_a_recording_releases_what_its_rig_holds(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(BARE)
    rig = rig_named(str(path))
    released = as_recorded(rig, [log(free={"shoulder_frictionloss_n_m": 0.05})])
    (one,) = (p for p in released.parameters if p.name == "shoulder_frictionloss")
    (before,) = (p for p in rig.parameters if p.name == "shoulder_frictionloss")
    assert one == replace(before, fitted=True, spread=0.05)
    assert as_recorded(rig, [log()]) is rig


def test_the_rig_says_how_to_hold_and_release(capsys):
    assert frame.run(["rigs", "dc-motor"]) == 0
    said = capsys.readouterr().out.partition("Hold or release: ")[2]
    assert "under [known] holds it" in said and "[free] fits a held" in " ".join(said.split())
