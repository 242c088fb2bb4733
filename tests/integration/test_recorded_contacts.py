"""A model whose geoms can touch: as equations where they do not in the recordings, else stepped."""

from pathlib import Path
from typing import Any

import mechanisms
import numpy as np
import pandas as pd
import pytest
from pamid_cli import frame

import pamid
from pamid.base.arrays import Array
from pamid.base.errors import PamidError
from pamid.base.json_file import read_json, write_json
from pamid.model.between_samples import as_recorded
from pamid.model.registry import rig_named
from pamid.networks.correction.identified_model import load_identified
from pamid.recording.recording import read_recording
from pamid.rigs.simulators.compiled_rig import CompiledMechanism
from pamid.rigs.simulators.mechanism import Mechanism
from pamid.rigs.simulators.mujoco_mechanism import read_mechanism
from pamid.rigs.simulators.recorded_contacts import joint_positions, recorded_contacts
from pamid.rigs.simulators.stepped_mechanism import SteppedMechanism
from pamid.simulation.excitation.aprbs import aprbs

mujoco: Any = mechanisms.needs_mujoco()


ARM = """<mujoco model="arm">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <geom name="wall" type="box" pos="0.55 0 -0.4" size="0.05 0.5 0.5"/>
    <body name="upper" pos="0 0 0">
      <joint name="shoulder" axis="0 -1 0" damping="0.3" range="-3 3" limited="true"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="{mass}"/>
      <body name="fore" pos="0 0 -0.3">
        <joint name="elbow" axis="0 -1 0" damping="0.1"/>
        <geom name="tip" type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.5"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="push" joint="shoulder" gear="4" ctrllimited="true" ctrlrange="-1 1"/>
    <motor name="bend" joint="elbow" gear="1" ctrllimited="true" ctrlrange="-1 1"/>
  </actuator>
  <sensor>
    <jointpos name="shoulder_angle" joint="shoulder"/><jointpos name="elbow_angle" joint="elbow"/>
  </sensor>
</mujoco>
"""
PERIOD_S, SAMPLES = 0.004, 2500
ANGLES = "shoulder_angle_rad", "elbow_angle_rad"


def written(folder: Path, text: str = ARM.format(mass=1.0), name: str = "arm.xml") -> Path:
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(text)
    return folder / name


def recorded(
    folder: Path, name: str, push: float, seed: int = 0, mass: float = 1.2
) -> tuple[Path, int]:
    """A recording of plain MuJoCo, and in how many samples geoms touched."""
    model = mujoco.MjModel.from_xml_string(ARM.format(mass=mass))
    data, touched = mujoco.MjData(model), 0
    seconds = SAMPLES * PERIOD_S
    sent = np.stack(
        [push * aprbs(seconds, PERIOD_S, 1.0, (0.1, 0.5), seed=10 * seed + k) for k in range(2)],
        axis=1,
    )
    read = np.empty((SAMPLES, 2))
    for k, command in enumerate(sent):
        read[k], data.ctrl[:] = data.qpos, command
        touched += data.ncon > 0
        for _ in range(2):
            mujoco.mj_step(model, data)
    read += 1e-4 * np.random.default_rng(seed).standard_normal(read.shape)
    columns = {"time_s": PERIOD_S * np.arange(SAMPLES)}
    columns |= {f"{n}_command": sent[:, k] for k, n in enumerate(("push", "bend"))}
    columns |= {n: read[:, k] for k, n in enumerate(ANGLES)}
    path = folder / name
    pd.DataFrame(columns).to_csv(path, index=False)
    return path, touched


def of_angles(shoulder: Array, elbow: Array) -> pamid.Recording:
    """A recording of given angles."""
    columns = {"time_s": PERIOD_S * np.arange(len(shoulder)), ANGLES[0]: shoulder, ANGLES[1]: elbow}
    columns |= {"push_command": np.zeros(len(shoulder)), "bend_command": np.zeros(len(shoulder))}
    return pamid.Recording.from_pandas(pd.DataFrame(columns), "angles")


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """The arm, a recording in which it stays clear of the wall, and one in which it hits it."""
    folder = tmp_path_factory.mktemp("contacts")
    written(folder)
    assert recorded(folder, "clear.csv", 0.15)[1] == 0
    assert recorded(folder, "hits.csv", 0.8, seed=1)[1] > 10
    return folder


@pytest.fixture(scope="module")
def run(place) -> Path:
    """A fit of the clear recording."""
    done = pamid.fit(place / "clear.csv", place / "arm.xml", output=place / "run", progress=False)
    return done.folder


def test_the_recordings_decide_the_form(place):
    rig = rig_named(str(place / "arm.xml"))
    clear, hits = (read_recording(place / f"{name}.csv") for name in ("clear", "hits"))
    free = as_recorded(rig, [clear])
    assert isinstance(free, CompiledMechanism) and not isinstance(free, SteppedMechanism)
    assert free.form == "equations" and "shoulder_transmission" in free.ports
    assert "tip of fore" in free.form_note and "wall of world" in free.form_note
    for recordings in ([hits], [clear, hits]):
        held = as_recorded(rig, recordings)
        assert isinstance(held, SteppedMechanism) and held.form == "stepped"
        assert "hits.csv" in held.form_note
        assert '<exclude body1="fore" body2="world"/>' in held.form_note
    # what is decided stays, whatever comes later
    assert as_recorded(free, [hits]) is free


def test_the_nearest_pair_is_that_of_all_poses(place):
    mechanism = read_mechanism(place / "arm.xml")
    t = np.arange(800) * PERIOD_S
    angles = of_angles(0.5 * np.sin(3.0 * t), 0.4 * np.sin(5.0 * t + 1.0))
    found = recorded_contacts(mechanism, [angles]).nearest
    assert found is not None and found.geoms == ("tip", "wall") and not found.touch
    model = mujoco.MjModel.from_xml_path(str(place / "arm.xml"))
    data, distances = mujoco.MjData(model), []
    ids = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, n) for n in found.geoms]
    for shoulder, elbow in zip(*(angles.si(n) for n in ANGLES), strict=True):
        data.qpos[:] = shoulder, elbow
        mujoco.mj_kinematics(model, data)
        distances.append(mujoco.mj_geomDistance(model, data, *ids, 5.0, None))
    assert found.distance_m == pytest.approx(min(distances), rel=0.06)


def test_a_touch_of_one_sample_is_seen(place):
    """Poses are skipped, but none in which geoms can have met."""
    mechanism = read_mechanism(place / "arm.xml")
    shoulder = np.zeros(5000)
    for at in (1, 2345, 4999):
        touching = shoulder.copy()
        touching[at] = 1.4
        found = recorded_contacts(mechanism, [of_angles(touching, np.zeros(5000))]).touching
        assert found is not None and found.time_s == pytest.approx(at * PERIOD_S)
    assert recorded_contacts(mechanism, [of_angles(shoulder, shoulder)]).free


def test_an_end_of_a_range_counts_as_a_contact(place):
    mechanism = read_mechanism(place / "arm.xml")
    rest = np.zeros(100)
    found = recorded_contacts(mechanism, [of_angles(np.linspace(0.0, -3.01, 100), rest)])
    assert not found.free and "'shoulder' is at an end of its range, -3 .. 3 rad" in found.limit


def test_positions_follow_from_readings_of_actuators_and_tendons(tmp_path):
    text = ARM.format(mass=1.0).replace(
        '<jointpos name="elbow_angle" joint="elbow"/>', '<tendonpos name="elbow_angle" tendon="t"/>'
    )
    text = text.replace(
        '<jointpos name="shoulder_angle" joint="shoulder"/>',
        '<actuatorpos name="shoulder_angle" actuator="push"/>',
    ).replace(
        "<actuator>",
        '<tendon><fixed name="t"><joint joint="shoulder" coef="1"/>'
        '<joint joint="elbow" coef="-2"/></fixed></tendon><actuator>',
        1,
    )
    mechanism = read_mechanism(written(tmp_path, text))
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 2))
    read = of_angles(4.0 * q[:, 0], q[:, 0] - 2.0 * q[:, 1])
    found, unread = joint_positions(mechanism, read)
    assert not unread and np.abs(found - q).max() < 1e-12


def test_without_a_position_contacts_stay_possible(place):
    rig = rig_named(str(place / "arm.xml"))
    clear = read_recording(place / "clear.csv")
    columns = {n: v for n, v in clear.columns.items() if n != ANGLES[1]}
    blind = pamid.Recording.from_pandas(pd.DataFrame({"time_s": clear.time, **columns}))
    found = as_recorded(rig, [blind])
    assert isinstance(found, SteppedMechanism) and "'elbow'" in found.form_note
    # an excitation decides nothing
    sent = {n: v for n, v in columns.items() if n not in ANGLES}
    excitation = pamid.Recording.from_pandas(pd.DataFrame({"time_s": clear.time, **sent}))
    assert as_recorded(rig, [excitation]) is rig


def test_a_model_without_pairs_has_one_form(tmp_path):
    alone = ARM.format(mass=1.0).replace(
        "<compiler", '<option><flag contact="disable"/></option><compiler'
    )
    assert rig_named(str(written(tmp_path, alone))).forms is None


def test_a_run_keeps_the_form_and_says_so(place, run, capsys, undrawn):
    found = read_json(run / "fit.json")
    assert found["model"]["form"] == "equations"
    assert found["notes"][0].startswith("Written as equations: no geoms touch")
    assert found["parameters"]["upper_mass_kg"]["value"] == pytest.approx(1.2, rel=0.02)
    model = load_identified(run, rig=str(place / "arm.xml"))
    assert not isinstance(model.assembly.rig, SteppedMechanism)
    page = run / "report.html"
    assert frame.run(["report", str(run), "--rig", str(place / "arm.xml")]) == 0
    assert "no geoms touch in these recordings" in page.read_text()
    capsys.readouterr()


def test_a_recording_that_touches_is_named(place, run, cli):
    arm = place / "arm.xml"
    found = cli("score", run, place / "hits.csv", "--rig", arm)
    assert any("hits.csv" in text and "without contacts" in text for text in found["notes"])
    # likewise the motion that a run simulates
    sent = pd.read_csv(place / "hits.csv")[["time_s", "push_command", "bend_command"]]
    sent.to_csv(place / "sent.csv", index=False)
    made = pamid.simulate(place / "sent.csv", model=run, rig=arm)
    assert any("touch" in text and "simulated motion" in text for text in made.warnings)
    checked = cli("check", place / "hits.csv", "--rig", arm)
    forms = [f for f in checked["findings"] if f["check"] == "form"]
    assert len(forms) == 1 and forms[0]["advice"] and "Stepped by MuJoCo" in forms[0]["detail"]


def test_a_run_of_an_unknown_form_is_refused(place, run, tmp_path):
    found = read_json(run / "fit.json")
    before = (run / "fit.json").read_bytes()
    try:
        write_json(run / "fit.json", found | {"model": found["model"] | {"form": "clay"}})
        with pytest.raises(PamidError, match="cannot be run as 'clay'"):
            load_identified(run, rig=str(place / "arm.xml"))
    finally:
        (run / "fit.json").write_bytes(before)


def test_check_without_a_log_says_that_recordings_decide(place, cli):
    mechanism: Mechanism = read_mechanism(place / "arm.xml")
    assert mechanism.collides
    found = cli("check", place / "arm.xml")
    assert any("recordings decide" in f["detail"] for f in found["findings"])


def test_the_base_of_a_urdf_does_not_touch_the_link_on_it(tmp_path):
    """MuJoCo makes the base a part of the world, which it lets collide with its neighbours."""
    inertial = (
        '<inertial><mass value="1"/><origin xyz="0 0 0.2"/>'
        '<inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    shape = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
    path = written(
        tmp_path,
        f"""<robot name="arm"><link name="base">{shape}</link>
        <link name="upper">{inertial}{shape}</link>
        <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/>
        <axis xyz="0 1 0"/></joint></robot>""",
        "arm.urdf",
    )
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon == 1, "plain MuJoCo lets them collide"
    time = 0.01 * np.arange(200)
    columns = {"shoulder_torque_nm": np.sin(time), "shoulder_position_rad": 0.1 * np.sin(time)}
    pd.DataFrame({"time_s": time, **columns}).to_csv(tmp_path / "log.csv", index=False)
    contacts = recorded_contacts(read_mechanism(path), [read_recording(tmp_path / "log.csv")])
    assert contacts.free, contacts.touching
