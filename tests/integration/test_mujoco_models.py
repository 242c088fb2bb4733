"""MuJoCo and URDF models as rigs: what `pamid check` says of them, what is refused and how, and the
way from a recording to a model file that plain MuJoCo runs."""

import sys
from typing import Any

import mechanisms
import numpy as np
import pytest
from mechanisms import written

from pamid.base.errors import FileError, PamidError
from pamid.base.trust import MODEL_ENDINGS
from pamid.model.registry import model_readers, rig_named, rig_of
from pamid.recording.recording import read_recording
from pamid.rigs.simulators.mujoco_mechanism import read_mechanism
from pamid.rigs.simulators.write_back import write_back

mujoco: Any = mechanisms.needs_mujoco()

URDF = """<robot name="lever">
  <link name="base"/>
  <!-- cast iron -->
  <link name="lever">
    <inertial>
      <origin xyz="0 0 -0.2"/><mass value="1.5"/>
      <inertia ixx="0.02" iyy="0.02" izz="0.001" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="pivot" type="revolute">
    <parent link="base"/><child link="lever"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="10" velocity="5"/>
    <dynamics damping="0.3" friction="0.1"/>
  </joint>
</robot>
"""
PERIOD_S, STEPS, SAMPLES = 0.004, 4, 3000


def body(inside: str, beside: str = "", head: str = "") -> str:
    """A model of one body with a ball's mass."""
    return (
        f'<mujoco>{head}<worldbody><body name="b" pos="0 0 1">\n{inside}\n'
        f'<geom name="ball" size="0.1" mass="1"/></body>{beside}</worldbody></mujoco>'
    )


def test_every_ending_of_a_model_file_is_known_to_be_one():
    assert set(model_readers()) == set(MODEL_ENDINGS)


def test_check_says_how_it_goes_and_what_is_left_out(tmp_path, cli):
    text = mechanisms.TWO.replace(
        'name="elbow"   axis', 'name="elbow" range="-1 2" limited="true" axis'
    ).replace("</sensor>", '<framepos name="tip" objtype="body" objname="forearm"/></sensor>')
    said = cli("check", written(tmp_path, text))
    assert (said["kind"], said["ok"], said["rigs"]) == ("rig", True, ["model"])
    remarks = [f["detail"] for f in said["findings"] if f["check"] == "remark"]
    assert "compiled into equations (2 joints, 2 actuators, 2 sensors" in remarks[0]
    line = 1 + text[: text.index('name="elbow"')].count("\n")
    assert any(f"joint 'elbow', line {line}: the range -1 .. 2" in r for r in remarks)
    assert any("sensor 'tip'" in r and "framepos is left out" in r for r in remarks)
    assert [p["port"] for p in said["ports"] if p["kind"] == "motion"] == ["shoulder", "elbow"]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (body('<joint name="j"/><jiont/>'), ("unrecognized element", "'jiont', line 2")),
        (body('<geom type="mesh" mesh="hull"/><joint/>',
              head='<asset><mesh name="hull" file="hull.stl"/></asset>'),
         ("hull.stl", "meshdir")),
        (body(""), ("no joints",)),
        (body('<joint name="j" type="ball"/>'), ("no sensor that pamid can read", "ball joint")),
        ("not xml at all", ("MuJoCo cannot read it",)),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_named(text, told, tmp_path, cli):
    file = written(tmp_path, text)
    with pytest.raises(FileError) as raised:
        rig_named(str(file))
    for words in told:
        assert words in str(raised.value)
    assert str(file) in str(raised.value)
    assert not cli("check", file, code=3)["ok"]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (body('<joint name="fly" type="free" damping="1"/><site name="s"/>').replace("</mujoco>",
              '<actuator><motor site="s" gear="0 0 1 0 0 0"/></actuator></mujoco>'),
         "joint 'fly', line 2: a free joint"),
        (body('<joint name="eye" type="ball"/><site name="s"/>').replace("</mujoco>",
              '<actuator><motor site="s" gear="0 0 1 0 0 0"/></actuator></mujoco>'),
         "joint 'eye', line 2: a ball joint"),
        (body('<joint name="j" type="slide" axis="0 0 1"/>',
              '<geom name="floor" type="plane" size="1 1 1" pos="0 0 0.95"/>'),
         "geoms touch (floor and ball at the reference itself)"),
        (body('<joint name="j"/>', head='<option density="1.2"/>'), "a medium"),
        (body('<joint name="j"/>').replace("</mujoco>",
              '<tendon><fixed name="t" stiffness="1" springyield="0.1"><joint joint="j" coef="1"/>'
              "</fixed></tendon></mujoco>"), "a spring that yields"),
    ],
)  # fmt: skip
def test_why_a_model_is_not_compiled_is_said(text, told, tmp_path):
    """It is stepped by MuJoCo, or refused where that cannot be done either."""
    file = written(tmp_path, text)
    try:
        said = " ".join(rig_named(str(file)).remarks)
    except FileError as error:
        said = str(error)
    assert told in said


def test_a_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(PamidError, match="no such file"):
        rig_named(str(tmp_path / "arm.xml"))


def test_without_the_extra_one_sentence_names_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(FileError, match=r"pip install 'pamid\[mujoco\]'") as raised:
        rig_named(str(written(tmp_path, mechanisms.ONE)))
    assert raised.value.code == "missing-extra"


def test_a_recording_that_names_a_model_file_does_not_open_it(tmp_path):
    rows = "\n".join(f"{0.01 * k:.2f},{k % 3}" for k in range(50))
    written(tmp_path, f"time_s,angle_rad\n{rows}\n", "rec.csv")
    written(tmp_path, '[recording]\nrig = "arm.xml"\n', "rec.toml")
    with pytest.raises(FileError, match="arm.xml"):
        rig_of([read_recording(tmp_path / "rec.csv")])


@pytest.mark.parametrize("text", [mechanisms.TREE, mechanisms.TERMS], ids=["tree", "terms"])
def test_every_value_goes_back_or_is_told(text, tmp_path):
    before = read_mechanism(written(tmp_path, text))
    wanted = {p.parameter.name: 1.1 * p.parameter.value * p.parameter.factor
              for p in before.parameters}  # fmt: skip
    done = write_back(before, wanted)
    after = read_mechanism(written(tmp_path, done.text.decode(), "after.xml"))
    now = {p.parameter.name: p.parameter.value * p.parameter.factor for p in after.parameters}
    told = {text.partition(" ")[0] for text in done.left}
    assert set(done.changed) | told == {k for k, v in wanted.items() if v}
    assert not told  # a <motor> with another gain is written as <general>
    for name in done.changed:
        assert now[name] == pytest.approx(wanted[name], rel=1e-6), name
    old = {p.parameter.name: p.parameter.value * p.parameter.factor for p in before.parameters}
    for name in told:
        assert now[name] == old[name]


def test_what_is_not_fitted_stays_as_it_is_written(tmp_path):
    file = written(tmp_path, mechanisms.TWO)
    mechanism = read_mechanism(file)
    values = {p.parameter.name: p.parameter.value for p in mechanism.parameters}
    assert write_back(mechanism, values).text == file.read_bytes()
    done = write_back(mechanism, {**values, "elbow_damping": 0.1, "shoulder_damping": 0.2})
    expected = mechanisms.TWO.replace("damping='0.08'", 'damping="0.1"').replace(
        '<joint name="shoulder" axis="0 1 0"/>',
        '<joint name="shoulder" axis="0 1 0" damping="0.2"/>',
    )
    assert done.text.decode() == expected


def test_urdf_is_read_and_written(tmp_path):
    mechanism = read_mechanism(written(tmp_path, URDF, "lever.urdf"))
    assert mechanism.inputs == {"pivot_torque_nm": "N m"}
    values = {p.parameter.name: p.parameter.value for p in mechanism.parameters}
    changed = {"lever_mass": 1.8, "pivot_damping": 0.25, "pivot_frictionloss": 0.2}
    done = write_back(mechanism, {**values, **changed, "pivot_armature": 0.01})
    assert done.text.decode() == (
        URDF.replace('mass value="1.5"', 'mass value="1.8"')
        .replace('"0.02"', '"0.024"')
        .replace('"0.001"', '"0.0012"')
        .replace('damping="0.3" friction="0.1"', 'damping="0.25" friction="0.2"')
    )
    assert done.left == ("pivot_armature = 0.01: URDF has no armature",)


def _recorded(model: Any, commands: np.ndarray) -> np.ndarray:
    """Joint positions under the commands, by plain MuJoCo."""
    data, found = mujoco.MjData(model), []
    for row in commands:
        data.ctrl[:] = row
        found.append(data.qpos.copy())
        mujoco.mj_step(model, data, STEPS)
    return np.array(found)


def test_from_a_recording_to_a_model_that_plain_mujoco_runs(tmp_path, cli):
    text = mechanisms.TWO.replace("damping='0.08'", "damping='0.08' frictionloss='0.1'")
    file, random = written(tmp_path, text, "arm.xml"), np.random.default_rng(5)
    truth = mujoco.MjModel.from_xml_path(str(file))
    factors = np.array([1.15, 0.87])
    truth.body_mass[1:] *= factors
    truth.body_inertia[1:] *= factors[:, None]
    truth.dof_frictionloss[1], truth.dof_damping[0] = 0.13, 0.18
    mujoco.mj_setConst(truth, mujoco.MjData(truth))
    levels = random.uniform(-1.0, 1.0, (SAMPLES // 60, 2)) * [0.8, 0.6]
    commands = np.repeat(levels, 60, axis=0)
    noise = 1e-3
    measured = _recorded(truth, commands) + noise * random.normal(size=commands.shape)
    table = np.column_stack([PERIOD_S * np.arange(SAMPLES), commands, measured])
    header = "time_s,m1_command,m2_command,shoulder_angle_rad,elbow_angle_rad"
    np.savetxt(tmp_path / "rec.csv", table, "%.9g", ",", header=header, comments="")

    said = cli("fit", tmp_path / "rec.csv", "--rig", file, "--output", tmp_path / "run")
    wanted = {
        "upper_mass_kg": 1.2 * 1.15,
        "forearm_mass_kg": 0.7 * 0.87,
        "elbow_frictionloss_n_m": 0.13,
        "shoulder_damping_n_m_s_per_rad": 0.18,
    }
    for name, value in wanted.items():
        assert said["parameters"][name]["value"] == pytest.approx(value, rel=0.02), name

    new = tmp_path / "new.xml"
    made = cli("export", tmp_path / "run", "--rig", file, "--to", "mjcf", "--output", new)
    assert made["notes"] == []
    assert "<!-- the one that squeaks -->" in new.read_text()
    found = _recorded(mujoco.MjModel.from_xml_path(str(new)), commands)
    last = slice(int(0.7 * SAMPLES), None)
    errors = np.abs(found - measured)[last].mean(axis=0)
    stated = [said["mae"][f"{j}_angle_rad"]["refitted"] for j in ("shoulder", "elbow")]
    # pamid's windows begin at estimated starts, MuJoCo's run at the true one
    assert np.all(errors < 1.1 * np.array(stated)) and np.all(errors > 0.5 * np.array(stated))
    assert np.all(np.abs(_recorded(mujoco.MjModel.from_xml_path(str(file)), commands) - measured)[
        last].mean(axis=0) > 5.0 * errors)  # fmt: skip
