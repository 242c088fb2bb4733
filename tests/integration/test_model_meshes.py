"""Meshes of a model file: where they are looked for, and what becomes of a model without them."""

import os
import struct
from pathlib import Path

import pytest
from pamid_cli import frame
from pamid_cli.table import every_command

pytest.importorskip("mujoco")

from pamid.base.errors import FileError, UsageError
from pamid.rigs.simulators.model_packages import PACKAGES_VARIABLE, model_packages, split_package
from pamid.rigs.simulators.mujoco_file import MujocoFile, open_mujoco
from pamid.rigs.simulators.mujoco_mechanism import mechanism_of, read_mechanism
from pamid.rigs.simulators.mujoco_sources import relocated_text
from pamid.rigs.simulators.stepped_mechanism import SteppedMechanism

INERTIAL = (
    '<inertial><mass value="0.7"/>'
    '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
)
URDF = """<robot name="lever">
{more}
<link name="base"/>
<link name="lever">
{inertial}
<visual><geometry><mesh filename="{visual}"/></geometry></visual>
<collision><geometry><mesh filename="{collision}"/></geometry></collision>
</link>
<joint name="hinge" type="revolute">
<parent link="base"/><child link="lever"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="3" velocity="4"/>
</joint>
</robot>
"""


def tetrahedron(path: Path, size: float = 0.2) -> Path:
    """A mesh as a binary STL file; its folder is created."""
    points = [(0, 0, 0), (size, 0, 0), (0, size, 0), (0, 0, size)]
    text = bytearray(80) + struct.pack("<I", 4)
    for face in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)):
        text += struct.pack("<3f", 0, 0, 0)
        text += b"".join(struct.pack("<3f", *points[k]) for k in face) + b"\0\0"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text)
    return path


def urdf(
    path: Path,
    collision: str,
    *,
    inertial: str = INERTIAL,
    visual: str = "package://nowhere/lever.dae",
    more: str = "",
) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    text = URDF.format(collision=collision, inertial=inertial, visual=visual, more=more)
    path.write_text(text, encoding="utf-8")
    return path


def notes(file: MujocoFile) -> str:
    return "; ".join(f.text for f in mechanism_of(file).findings if "left out" in f.text)


def refusal(path: Path) -> FileError:
    with pytest.raises(FileError) as caught:
        open_mujoco(path)
    return caught.value


@pytest.fixture(autouse=True)
def no_packages(monkeypatch) -> None:
    for variable in (PACKAGES_VARIABLE, "ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(variable, raising=False)


# ---- where a mesh is looked for ------------------------------------------------------------------


def _package_xml(folder: Path, name: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "package.xml").write_text(f"<package><name>{name}</name></package>")


def _renamed(root: Path, _: pytest.MonkeyPatch) -> None:
    tetrahedron(root / "checkout-main" / "meshes" / "lever.stl")
    _package_xml(root / "checkout-main", "lever_description")


def _on_ros_path(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tetrahedron(root / "ws" / "src" / "robots" / "lever_description" / "meshes" / "lever.stl")
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{root / 'absent'}{os.pathsep}{root / 'ws'}")


def _in_ros_2(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tetrahedron(root / "install" / "share" / "lever_description" / "meshes" / "lever.stl")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(root / "install"))


def _stated(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tetrahedron(root / "somewhere else" / "meshes" / "lever.stl")
    monkeypatch.setenv(PACKAGES_VARIABLE, f"lever_description={root / 'somewhere else'}")


@pytest.mark.parametrize(
    ("model", "place"),
    [
        ("lever.urdf", lambda r, _: tetrahedron(r / "lever_description/meshes/lever.stl")),
        (
            "lever_description/urdf/lever.urdf",
            lambda r, _: tetrahedron(r / "lever_description/meshes/lever.stl"),
        ),
        (
            "other_description/robots/lever.urdf",
            lambda r, _: tetrahedron(r / "lever_description/meshes/lever.stl"),
        ),
        ("checkout-main/urdf/lever.urdf", _renamed),
        ("lever.urdf", _renamed),
        ("archive/urdf/lever.urdf", lambda r, _: tetrahedron(r / "archive/meshes/lever.stl")),
        ("lever.urdf", lambda r, _: tetrahedron(r / "lever.stl")),
        ("robots/lever.urdf", _on_ros_path),
        ("robots/lever.urdf", _in_ros_2),
        ("robots/lever.urdf", _stated),
    ],
    ids=[
        "next to the file",
        "package of the file",
        "package next to that of the file",
        "package.xml above the file",
        "package.xml below the folder of the file",
        "folder of another name without package.xml",
        "same folder",
        "ROS_PACKAGE_PATH",
        "AMENT_PREFIX_PATH",
        "stated",
    ],
)
def test_packages_are_found(tmp_path, monkeypatch, model, place):
    place(tmp_path, monkeypatch)
    scheme = "model" if model.startswith("archive") else "package"
    name = f"{scheme}://lever_description/meshes/lever.stl"
    file = open_mujoco(urdf(tmp_path / model, name))
    assert file.model.ngeom == 1 and not notes(file)


def test_a_stated_package_goes_before_one_that_lies_near(tmp_path, monkeypatch):
    tetrahedron(tmp_path / "lever_description" / "lever.stl", 0.2)
    tetrahedron(tmp_path / "mine" / "lever.stl", 0.4)
    path = urdf(tmp_path / "lever.urdf", "package://lever_description/lever.stl", inertial="")
    near = open_mujoco(path).model.body_mass[-1]
    monkeypatch.setenv(PACKAGES_VARIABLE, f"lever_description={tmp_path / 'mine'}")
    assert open_mujoco(path).model.body_mass[-1] == pytest.approx(8.0 * near)


@pytest.mark.parametrize(
    "name",
    [
        "file://{root}/parts/my lever.stl",
        "file://localhost{root}/parts/my%20lever.stl",
        "file:///{root}/parts/my lever.stl",
        "file://parts/my lever.stl",
        "{root}/parts/my lever.stl",
        "parts/my lever.stl",
        "parts/my%20lever.stl",
        "parts\\my lever.stl",
        "../{folder}/parts/my lever.stl",
    ],
)
def test_paths_of_files_are_found(tmp_path, name):
    tetrahedron(tmp_path / "parts" / "my lever.stl")
    path = urdf(tmp_path / "lever.urdf", name.format(root=tmp_path, folder=tmp_path.name))
    file = open_mujoco(path)
    assert file.model.ngeom == 1 and not notes(file)


def test_a_path_of_another_machine_is_sought_by_its_last_part(tmp_path):
    tetrahedron(tmp_path / "lever.stl")
    for name in (r"C:\robots\lever.stl", "/home/nobody/ws/lever.stl", "file:///C:/x/lever.stl"):
        file = open_mujoco(urdf(tmp_path / "lever.urdf", name))
        assert file.model.ngeom == 1, name


def test_meshes_of_the_same_name_stay_apart(tmp_path):
    tetrahedron(tmp_path / "a" / "lever.stl", 0.1)
    tetrahedron(tmp_path / "b" / "lever.stl", 0.3)
    text = URDF.format(
        collision="package://b/lever.stl", inertial="", visual="package://b/lever.dae", more=""
    ).replace("</collision>", "</collision>{}")
    more = '<collision><geometry><mesh filename="package://a/lever.stl"/></geometry></collision>'
    (tmp_path / "lever.urdf").write_text(text.format(more))
    model = open_mujoco(tmp_path / "lever.urdf").model
    assert model.body_mass[-1] == pytest.approx(1000.0 * (0.1**3 + 0.3**3) / 6.0)


def test_the_working_folder_does_not_matter(tmp_path, monkeypatch):
    tetrahedron(tmp_path / "ws" / "lever_description" / "lever.stl")
    urdf(tmp_path / "robots" / "lever.urdf", "package://lever_description/lever.stl")
    monkeypatch.chdir(tmp_path / "ws")
    monkeypatch.setenv("ROS_PACKAGE_PATH", ".")
    assert open_mujoco("../robots/lever.urdf").model.ngeom == 1


def test_a_pipe_in_a_package_is_refused(tmp_path):
    (tmp_path / "lever_description").mkdir()
    os.mkfifo(tmp_path / "lever_description" / "lever.stl")
    error = refusal(urdf(tmp_path / "lever.urdf", "package://lever_description/lever.stl"))
    assert error.code == "not-a-file" and "is a pipe" in error.message


def test_a_package_is_a_name_and_a_folder(tmp_path):
    assert split_package("a_b=x=y") == ("a_b", "x=y")
    for pair in ("a_b", "=x", "a_b=", "a/b=x"):
        with pytest.raises(UsageError, match="NAME=DIR"):
            split_package(pair)
    with (
        pytest.raises(UsageError, match="is not a folder"),
        model_packages(a_b=tmp_path / "absent"),
    ):
        pass


def test_packages_hold_within_their_block(tmp_path, monkeypatch):
    tetrahedron(tmp_path / "ws" / "a" / "lever.stl")
    path = urdf(tmp_path / "robots" / "lever.urdf", "package://lever/lever.stl", inertial="")
    monkeypatch.chdir(tmp_path / "ws")
    with model_packages(other="."):
        with model_packages(lever="a"):
            assert open_mujoco(path).model.ngeom == 1
        assert os.environ[PACKAGES_VARIABLE] == f"other={tmp_path / 'ws'}"
    assert PACKAGES_VARIABLE not in os.environ and "'lever' is not found" in refusal(path).message


def test_commands_take_packages(tmp_path, monkeypatch, capsys):
    tetrahedron(tmp_path / "parts" / "lever.stl")
    urdf(tmp_path / "robots" / "lever.urdf", "package://lever/lever.stl", inertial="")
    monkeypatch.chdir(tmp_path)
    words = ["check", "robots/lever.urdf"]
    assert frame.run(words) == 3 and "--package lever=DIR" in capsys.readouterr().out
    assert frame.run([*words, "--package", "lever=parts"]) == 0
    said = capsys.readouterr().out
    assert (
        "--rig robots/lever.urdf --package lever=" in said and PACKAGES_VARIABLE not in os.environ
    )
    assert frame.run([*words, "--package", "lever"]) == 2
    assert "NAME=DIR" in capsys.readouterr().err


def test_every_command_that_takes_a_model_takes_packages():
    for command in every_command():
        takes_rig = any("--rig" in p.opts for p in command.params)
        takes_packages = any("--package" in p.opts for p in command.params)
        assert takes_packages == (takes_rig and command.name != "force-law"), command.name


# ---- meshes that are not needed, and those that are ----------------------------------------------


def test_a_collision_mesh_that_nothing_depends_on_is_left_out(tmp_path):
    whole = urdf(tmp_path / "whole.urdf", str(tetrahedron(tmp_path / "whole.stl")))
    path = urdf(tmp_path / "lever.urdf", "package://lost/lever.stl")
    file = open_mujoco(path)
    assert file.model.ngeom == 0 and file.model.body_mass[-1] == 0.7
    (note,) = [f for f in mechanism_of(file).findings if "left out" in f.text]
    assert "package://lost/lever.stl (package 'lost' is not found)" in note.text
    assert "contacts of these shapes of lever are not seen" in note.text and not note.hinders
    assert read_mechanism(path).bodies[-1].inertia == read_mechanism(whole).bodies[-1].inertia


def test_one_note_names_the_meshes(tmp_path):
    shape = '<collision><geometry><mesh filename="part_{}.stl"/></geometry></collision>'
    shapes = "".join(map(shape.format, range(9)))
    path = urdf(tmp_path / "lever.urdf", "part_9.stl", inertial=INERTIAL + shapes)
    note = notes(open_mujoco(path))
    assert note.count("left out") == 1
    assert "part_0.stl, part_1.stl" in note and "and 4 more (no such file)" in note


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("lever.stl", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "MuJoCo: "),
        ("lever.dae", b"<COLLADA/>", "no decoder found for mesh file 'lever.dae'"),
        ("lever.glb", b"glTF", "no decoder found for mesh file 'lever.glb'"),
    ],
)
def test_a_mesh_that_cannot_be_read_is_left_out(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    file = open_mujoco(urdf(tmp_path / "lever.urdf", name))
    assert file.model.ngeom == 0 and name in notes(file) and words in notes(file)
    error = refusal(urdf(tmp_path / "lever.urdf", name, inertial=""))
    assert "'lever' has no <inertial>" in error.message and words in error.message


def test_visual_meshes_that_are_kept_do_not_block(tmp_path):
    tetrahedron(tmp_path / "lever.stl")
    more = '<mujoco><compiler discardvisual="false"/></mujoco>'
    file = open_mujoco(urdf(tmp_path / "lever.urdf", "lever.stl", more=more))
    assert file.model.ngeom == 1
    assert "package://nowhere/lever.dae" in notes(file) and "contacts" not in notes(file)


def test_a_mesh_that_gives_the_mass_is_needed(tmp_path):
    error = refusal(urdf(tmp_path / "lever.urdf", "package://lost/lever.stl", inertial=""))
    assert "'lever' has no <inertial>, so its mass comes from the mesh" in error.message
    assert "package 'lost' is not found" in error.message
    assert "--package lost=DIR" in error.hint and "<inertial>" in error.hint
    error = refusal(urdf(tmp_path / "lever.urdf", "lever.stl", inertial=""))
    assert "no such file" in error.message and "Put the file in its place" in error.hint


def test_a_mesh_of_what_stands_still_is_not_needed(tmp_path):
    tetrahedron(tmp_path / "lever.stl")
    table = '<link name="table"><collision><geometry><mesh filename="table.stl"/></geometry>'
    table += '</collision></link><joint name="feet" type="fixed"><parent link="base"/>'
    table += '<child link="table"/></joint>'
    file = open_mujoco(urdf(tmp_path / "lever.urdf", "lever.stl", more=table))
    assert file.model.ngeom == 1 and "table.stl (no such file)" in notes(file)


MJCF = """<mujoco>
<compiler meshdir="parts" {compiler}/>
<asset><mesh file="{mesh}"/><texture name="skin" type="2d" file="skin.png"/>
<material name="paint" texture="skin"/></asset>
<worldbody><body><joint name="hinge" axis="0 1 0"/>
<inertial pos="0 0 -0.1" mass="0.7" diaginertia="0.01 0.01 0.01"/>
<geom type="mesh" mesh="lever" material="paint"/></body></worldbody></mujoco>"""


def test_an_mjcf_goes_without_what_it_only_shows(tmp_path):
    path = tmp_path / "lever.xml"
    path.write_text(MJCF.format(mesh="lever.stl", compiler=""))
    file = open_mujoco(path)
    assert file.model.ngeom == 0
    assert "lever.stl, skin.png (no such file)" in notes(file)
    tetrahedron(tmp_path / "parts" / "lever.stl")
    file = open_mujoco(path)
    assert file.model.ngeom == 1 and "lever.stl" not in notes(file)
    path.write_text(MJCF.format(mesh="package://parts/lever.stl", compiler=""))
    assert open_mujoco(path).model.ngeom == 1
    path.write_text(MJCF.format(mesh="elsewhere/lever.stl", compiler='strippath="true"'))
    assert open_mujoco(path).model.ngeom == 1


def test_inertia_from_shapes_needs_them(tmp_path):
    (tmp_path / "lever.xml").write_text(
        MJCF.format(mesh="lever.stl", compiler='inertiafromgeom="true"')
    )
    assert "its mass comes from the mesh lever.stl" in refusal(tmp_path / "lever.xml").message


# ---- URDFs that are not ready --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "plain"), [("lever.urdf.xacro", "lever.urdf"), ("lever.xacro", "lever.plain.urdf"),
                        ("lever.urdf", "lever.plain.urdf")],
)  # fmt: skip
def test_a_text_for_xacro_is_refused_with_the_command(tmp_path, name, plain):
    path = urdf(tmp_path / name, "x.stl", more='<xacro:include filename="$(find x)/y.xacro"/>')
    path.write_text(path.read_text().replace("<robot", '<robot xmlns:xacro="http://ros.org"'))
    error = refusal(path)
    assert "line 2: <xacro:include> needs xacro" in error.message
    assert f"xacro {path} > {tmp_path / plain}" in error.hint


def test_a_urdf_that_xacro_wrote_is_read(tmp_path):
    path = urdf(tmp_path / "lever.urdf", "x.stl")
    path.write_text(path.read_text().replace("<robot", '<robot xmlns:xacro="http://ros.org"'))
    assert open_mujoco(path).model.njnt == 1


@pytest.mark.parametrize(
    ("inertial", "hint"),
    [
        ("", 'boundmass="1e-4"'),
        (INERTIAL.replace('izz="0.01"', 'izz="0.5"'), 'balanceinertia="true"'),
        ('<inertial><mass value="1"/></inertial>', "Add <inertia>"),
    ],
)
def test_inertias_that_mujoco_refuses_have_a_cure(tmp_path, inertial, hint):
    path = urdf(tmp_path / "lever.urdf", "x.stl", inertial=inertial)
    shape = '<collision><geometry><mesh filename="x.stl"/></geometry></collision>'
    path.write_text(path.read_text().replace(shape, ""))
    assert hint in refusal(path).hint


# ---- joints without a motor ----------------------------------------------------------------------

FINGER = """<link name="finger">{inertial}</link>
<joint name="finger" type="prismatic"><parent link="lever"/><child link="finger"/>
<axis xyz="1 0 0"/><limit lower="0" upper="1" effort="3" velocity="4"/>
<mimic joint="hinge" multiplier="0.5" offset="0"/></joint>"""


def test_a_joint_that_mimics_another_has_no_drive(tmp_path):
    more = FINGER.format(inertial=INERTIAL)
    mechanism = read_mechanism(urdf(tmp_path / "lever.urdf", "lever.stl", more=more))
    assert list(mechanism.inputs) == ["hinge_torque_nm"]
    assert "finger_position_m" in mechanism.outputs
    ports = {port.name: port for port in mechanism.ports}
    assert ports["hinge"].kind == ports["finger"].kind == "motion"


@pytest.mark.parametrize(
    ("first", "held"), [('<link name="base"/>', False),
                        (f'<link name="base">{INERTIAL}</link>', True)],
)  # fmt: skip
def test_a_first_link_with_a_mass_is_said_to_stand(tmp_path, first, held):
    path = urdf(tmp_path / "lever.urdf", "lever.stl")
    path.write_text(path.read_text().replace('<link name="base"/>', first))
    found = [str(f) for f in read_mechanism(path).findings if "stands still" in f.text]
    assert len(found) == held and all("link 'base', line 3" in text for text in found)


def test_sensors_that_cannot_be_read_leave_those_of_the_joints(tmp_path):
    (tmp_path / "lever.xml").write_text(
        '<mujoco><worldbody><body><joint name="hinge" axis="0 1 0"/>'
        '<geom size="0.1" mass="1"/></body></worldbody><sensor><clock name="c"/></sensor></mujoco>'
    )
    mechanism = read_mechanism(tmp_path / "lever.xml")
    assert list(mechanism.outputs) == ["hinge_position_rad", "hinge_velocity_rad_per_s"]
    assert any("a sensor of the kind clock is left out" in f.text for f in mechanism.findings)


# ---- a model in another folder, and its copies ---------------------------------------------------

SHAPED = """<mujoco>
  {compiler}
  <asset><mesh name="lever" file="{mesh}"/></asset>
  {include}
  <worldbody><body name="lever"><joint name="hinge" axis="0 1 0"/>
    <geom type="mesh" mesh="lever" mass="0.3"/>
    <geom name="cover" type="mesh" mesh="lever" contype="0" conaffinity="0" mass="0.4"/>
  </body></worldbody>
</mujoco>
"""


@pytest.mark.parametrize(
    ("compiler", "mesh", "place"),
    [
        ('<compiler angle="radian"/>', "meshes/lever.stl", "meshes/lever.stl"),
        ("", "lever.stl", "lever.stl"),
        ('<compiler meshdir="meshes/"/>', "lever.stl", "meshes/lever.stl"),
        ('<compiler assetdir="../shared"/>', "lever.stl", "../shared/lever.stl"),
    ],
)
def test_relative_paths_lead_from_the_folder_of_an_exported_model(tmp_path, compiler, mesh, place):
    file, new = tmp_path / "robot" / "arm.xml", tmp_path / "out" / "deep" / "arm.xml"
    tetrahedron(tmp_path / "robot" / place)
    more = tmp_path / "robot" / "more" / "sensors.xml"
    for folder in (file.parent, new.parent, more.parent):
        folder.mkdir(parents=True, exist_ok=True)
    more.write_text('<mujoco><sensor><jointpos joint="hinge"/></sensor></mujoco>')
    include = '<include file="more/sensors.xml"/>'
    file.write_text(SHAPED.format(compiler=compiler, mesh=mesh, include=include))
    assert relocated_text(file.read_bytes(), file, file.parent) == (file.read_bytes(), "")
    text, note = relocated_text(file.read_bytes(), file, new.parent)
    new.write_bytes(text)
    assert not note
    model = open_mujoco(new)
    assert model.model.nmesh == 1 and model.model.nsensor == 1 and not model.left_out


def test_meshes_of_a_urdf_lead_from_the_folder_of_an_exported_model(tmp_path):
    tetrahedron(tmp_path / "robot" / "meshes" / "lever.stl")
    file = urdf(tmp_path / "robot" / "lever.urdf", "meshes/lever.stl", visual="meshes/lever.stl")
    new = tmp_path / "out" / "lever.urdf"
    new.parent.mkdir()
    new.write_bytes(relocated_text(file.read_bytes(), file, new.parent)[0])
    assert open_mujoco(new).model.nmesh == 1 and not open_mujoco(new).left_out


def test_an_included_file_that_states_folders_is_named(tmp_path):
    (tmp_path / "more.xml").write_text('<mujoco><compiler meshdir="meshes"/></mujoco>')
    text = b'<mujoco><include file="more.xml"/></mujoco>'
    assert "more.xml" in relocated_text(text, tmp_path / "arm.xml", tmp_path / "out")[1]


def test_copies_of_a_stepped_model_are_without_shapes_for_pictures(tmp_path):
    """Their meshes take megabytes; the motion is the same to the last bit."""
    tetrahedron(tmp_path / "lever.stl")
    file = tmp_path / "arm.xml"
    file.write_text(SHAPED.format(compiler="", mesh="lever.stl", include=""))
    whole, plain = open_mujoco(file).model, open_mujoco(file, visual=False).model
    assert (whole.ngeom, plain.ngeom) == (2, 1)
    for name in ("body_mass", "body_inertia", "body_ipos", "dof_M0"):
        assert (getattr(whole, name) == getattr(plain, name)).all()
    rig = SteppedMechanism(read_mechanism(file))
    assert rig._stepper.model.ngeom == 1
