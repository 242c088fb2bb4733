"""The whole inertia of a body as parameters: consistent for every value, the same in the equations,
in MuJoCo's steps and in the written file."""

from typing import Any

import mechanisms
import numpy as np
import pytest
from posed_arms import FOUR_HINGES, arm_text

from pamid.base.errors import FileError
from pamid.engine.symbolic.derivative import gradients
from pamid.engine.symbolic.expression import ZERO, plain, symbol
from pamid.model.between_samples import as_fitted, released
from pamid.rigs.simulators.body_inertia import BodyShape, full_inertia, shapes_of, with_full_inertia
from pamid.rigs.simulators.compiled_rig import CompiledMechanism
from pamid.rigs.simulators.mechanism import Body
from pamid.rigs.simulators.mujoco_mechanism import read_mechanism
from pamid.rigs.simulators.stepped_mechanism import SteppedMechanism
from pamid.rigs.simulators.write_back import write_back

mujoco: Any = mechanisms.needs_mujoco()

# a link with two bodies, one of them welded to it, and a link behind both
IN_TREE = ("hip_1_inertia", "plate_inertia", "shin_inertia")
URDF = """<robot name="arm">
  <link name="base"/>
  <link name="upper">
    <inertial>
      <origin xyz="0.1 0 0.02" rpy="0.3 0.1 -0.2"/>
      <mass value="1.5"/>
      <inertia ixx="0.004" ixy="0.0005" ixz="0" iyy="0.02" iyz="-0.001" izz="0.021"/>
    </inertial>
  </link>
  <link name="fore">
    <inertial>
      <mass value="0.8"/>
      <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.006" iyz="0" izz="0.006"/>
    </inertial>
  </link>
  <joint name="a" type="continuous">
    <parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
  </joint>
  <joint name="b" type="continuous">
    <origin xyz="0.4 0 0"/><parent link="upper"/><child link="fore"/><axis xyz="0 0 1"/>
  </joint>
</robot>
"""


def drawn(rig: Any, seed: int, size: float = 1.0) -> dict[str, float]:
    """Values of all parameters; those of shapes drawn with their spreads times a size."""
    random, values = np.random.default_rng(seed), mechanisms.parameters(rig)
    for group in rig.on_request.values():
        for p in group:
            if p.name in values:
                step = size * p.spread * float(random.standard_normal())
                values[p.name] = float(np.clip(p.value + step, p.low, p.high))
    return values


def point(rig: CompiledMechanism, seed: int) -> tuple[dict[str, float], dict[str, float]]:
    """States and inputs."""
    random = np.random.default_rng(seed)
    x = {s.name: float(random.choice([-1, 1]) * random.uniform(0.4, 1.5)) for s in rig.states}
    x |= {n: 0.2 * x[n] for a in rig.mechanism.actuators for n, _ in a.states}
    return x, {column: float(random.normal()) for column in rig.inputs}


def consistent(body: Body, factor: float = 1e-12) -> bool:
    """Do the principal inertias obey the triangle inequalities?"""
    second = 0.5 * sum(body.inertia) - np.array(body.inertia)
    return bool((second > -factor * max(body.inertia)).all()) and min(body.inertia) > 0.0


# ---- one body ------------------------------------------------------------------------------------


def test_the_file_s_body_is_where_the_parameters_begin(tmp_path):
    rig = mechanisms.rig_from(mechanisms.TREE, tmp_path)
    for shape in shapes_of(rig.mechanism):
        values = {p.name: p.value for p in shape.parameters()}
        same = shape.deformed(values, shape.body.mass_kg)
        np.testing.assert_allclose(full_inertia(same), full_inertia(shape.body), atol=1e-12)
        assert same.centre == pytest.approx(shape.body.centre)


def test_every_value_is_a_body_that_can_be(tmp_path):
    """At random up to ten spreads, and with every parameter at a bound."""
    rig = mechanisms.rig_from(mechanisms.TREE, tmp_path)
    random = np.random.default_rng(4)
    for shape in shapes_of(rig.mechanism):
        parameters = shape.parameters()
        for k in range(40):
            ends = {p.name: (p.low, p.high)[int(random.integers(2))] for p in parameters}
            far = {p.name: p.value + 10.0 * p.spread * float(random.normal()) for p in parameters}
            mass = float(10.0 ** random.uniform(-6, 6))
            body = shape.deformed(ends if k % 2 else far, mass)
            assert consistent(body), (shape.group, k, body.inertia)
    plate = Body("plate", 0, (0, 0, 0), (1, 0, 0, 0), 2.0, (0, 0, 0), (1, 0, 0, 0), (0.3, 0.2, 0.1))
    thin = BodyShape(1, plate)  # without thickness
    assert consistent(thin.deformed({p.name: p.high for p in thin.parameters()}, 2.0))


def test_two_points_make_the_inertia_that_mechanics_states():
    """A payload on a body: centre and inertia by the parallel axis theorem are within reach."""
    link = Body(
        "link", 0, (0, 0, 0), (1, 0, 0, 0), 1.0, (0, 0, 0.1), (1, 0, 0, 0), (0.02, 0.02, 0.004)
    )
    shape = BodyShape(1, link)
    # a stretch by 2 along the longest axis, z, makes four times of its second moment, 0.018
    values = {p.name: p.value for p in shape.parameters()} | {"link_stretch3": np.log(2.0)}
    assert full_inertia(shape.deformed(values, 1.0)) == pytest.approx(
        np.diag([0.002 + 0.072, 0.002 + 0.072, 0.004])
    )
    # sheared towards the first axis by s: P = L diag L', of which P_13 = s * 0.018
    values["link_shear13"], values["link_stretch3"] = 0.1, 0.0
    full = full_inertia(shape.deformed(values, 1.0))
    assert sorted(np.abs(full[2, :2])) == pytest.approx([0.0, 0.0018])


# ---- in equations, in steps, in the file ---------------------------------------------------------


def test_released_inertias_are_equations_that_mujoco_agrees_with(tmp_path):
    rig = mechanisms.rig_from(mechanisms.TREE, tmp_path)
    rig = released(rig, dict.fromkeys(IN_TREE, 0.5))
    assert isinstance(rig, CompiledMechanism)
    values = drawn(rig, 2) | {"hip_1_mass": 1.7}
    written = write_back(rig.mechanism, values)
    assert not written.left and "shin_inertia_xy" in written.changed
    (tmp_path / "new.xml").write_bytes(written.text)
    new = CompiledMechanism(read_mechanism(tmp_path / "new.xml"))
    here = mechanisms.AtStates(rig)
    for seed in range(3):
        x, u = point(rig, seed)
        rates, _ = here(x, u, values)
        judged, _ = mechanisms.mujoco_at(new, x, u)
        for key, value in judged.items():
            assert rates[key] == pytest.approx(value, rel=1e-6, abs=1e-6), key


def test_derivatives_by_released_inertias_equal_finite_differences(tmp_path):
    rig = mechanisms.rig_from(mechanisms.TREE, tmp_path)
    rig = released(rig, dict.fromkeys(IN_TREE, 0.5))
    names = [mechanisms._Names(space) for space in ("state", "input", "parameter")]
    rates = rig.rates(*names, mechanisms._through)
    roots = [rates[f"{j.name}_velocity"] for j in rig.mechanism.joints]  # type: ignore[attr-defined]
    values, slopes = plain(roots), gradients(roots)
    x, u = point(rig, 3)  # type: ignore[arg-type]
    at = {("state", k): v for k, v in x.items()} | {("input", k): v for k, v in u.items()}
    at |= {("parameter", k): v or 0.02 for k, v in drawn(rig, 5).items()}
    masses = ("hip_1_mass", "plate_mass", "shin_mass", "cart_mass")
    keys = [("parameter", p.name) for g in IN_TREE for p in rig.on_request[g]]
    keys += [("parameter", name) for name in masses] + [("state", j) for j in ("knee", "tilt")]
    flat = [g.get(symbol(*key), ZERO) for g in slopes for key in keys]
    exact = mechanisms.numbers(plain(flat), at).reshape(len(roots), len(keys)).T
    for key, column in zip(keys, exact, strict=True):
        h = 1e-6 * max(abs(at[key]), 0.1)
        up, down = (mechanisms.numbers(values, {**at, key: at[key] + s * h}) for s in (1, -1))
        size = np.abs(up).max() + np.abs(column).max()
        np.testing.assert_allclose(
            column, (up - down) / (2.0 * h), rtol=2e-6, atol=1e-7 * size, err_msg=str(key)
        )


# of a diagonal mass matrix as long as the centre stands where the frame does
GANTRY = """<mujoco model="gantry"><option timestep="0.001" integrator="RK4"/><worldbody>
  <body name="car">
    <joint name="way" type="slide" axis="0 1 0"/><joint name="roll" axis="1 0 0"/>
    <inertial pos="0 0 0" mass="2" diaginertia="0.03 0.02 0.015"/>
  </body>
</worldbody><actuator><motor joint="way"/><motor joint="roll"/></actuator></mujoco>"""
CENTRED = mechanisms.TWO.replace('pos="0 0 -0.15" mass="0.7"', 'pos="0 0 0" mass="0.7"')


@pytest.mark.parametrize("text", [CENTRED, mechanisms.ONE, GANTRY], ids=["two", "one", "gantry"])
def test_mujoco_steps_the_same_body(text, tmp_path):
    """Also a body whose frame is at its centre, which MuJoCo treats as a special case."""
    mechanism = mechanisms.rig_from(text, tmp_path).mechanism
    group = shapes_of(mechanism)[-1].group
    rig = released(SteppedMechanism(mechanism), {group: 0.5})
    assert isinstance(rig, SteppedMechanism)
    values = drawn(rig, 6)
    row = np.array([values[p.name] for p in rig.parameters])
    random, n = np.random.default_rng(1), len(rig.states)
    x = random.uniform(-1.0, 1.0, (1, n))
    forces = np.zeros((1, len(mechanism.actuators) + len(mechanism.joints)))
    stepped = rig.steps(x, forces, row[None], 0.02, ())[0][0]
    (tmp_path / "new.xml").write_bytes(write_back(mechanism, values).text)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "new.xml"))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = x[0, : n // 2], x[0, n // 2 :]
    mujoco.mj_step(model, data, 20)
    np.testing.assert_allclose(stepped, [*data.qpos, *data.qvel], rtol=1e-6, atol=1e-9)


def test_inertias_survive_the_way_through_a_urdf(tmp_path):
    file = tmp_path / "arm.urdf"
    file.write_text(URDF)
    rig = released(CompiledMechanism(read_mechanism(file)), {"upper_inertia": 1, "fore_inertia": 1})
    values = drawn(rig, 7) | {"fore_mass": 1.1}
    written = write_back(rig.mechanism, values)  # type: ignore[attr-defined]
    assert not written.left
    for shape in shapes_of(written.mechanism):
        old = next(s for s in shapes_of(rig.mechanism) if s.group == shape.group)  # type: ignore[attr-defined]
        wanted = old.deformed(values, values[f"{shape.body.name}_mass"])
        np.testing.assert_allclose(
            full_inertia(shape.body), full_inertia(wanted), rtol=1e-7, atol=1e-12
        )
        assert shape.body.centre == pytest.approx(wanted.centre, rel=1e-8)
        assert shape.body.mass_kg == pytest.approx(wanted.mass_kg)


def test_the_extremes_can_be_written_and_read(tmp_path):
    rig = released(mechanisms.rig_from(mechanisms.TREE, tmp_path), {"shin_inertia": 1.0})
    for end in ("low", "high"):
        values = mechanisms.parameters(rig)
        values |= {p.name: getattr(p, end) for p in rig.on_request["shin_inertia"]}
        assert not write_back(rig.mechanism, values).left  # type: ignore[attr-defined]


# ---- released, and reported ----------------------------------------------------------------------


def test_only_masses_are_parameters_unless_a_recording_releases_more(tmp_path):
    rig = mechanisms.rig_from(mechanisms.TWO, tmp_path)
    assert set(rig.on_request) == {"upper_inertia", "forearm_inertia"}
    assert not any("stretch" in p.name or "centre" in p.name for p in rig.parameters)
    more = released(rig, {"forearm_inertia": 0.1})
    added = more.parameters[len(rig.parameters) :]
    assert [p.name for p in added] == [p.name for p in rig.on_request["forearm_inertia"]]
    assert all(p.fitted for p in added)
    shape = shapes_of(rig.mechanism)[1]
    assert added[0].spread == pytest.approx(0.1 * shape.radius_m) and added[3].spread == 0.05
    assert as_fitted(rig, [p.name for p in more.parameters]).parameters[-1].name == added[-1].name
    assert as_fitted(rig, [p.name for p in rig.parameters]) is rig


def test_the_end_of_an_arm_is_fitted_whole(tmp_path):
    """Of one chain with three joints or more; a request sets its spread."""
    (tmp_path / "arm.xml").write_text(arm_text(FOUR_HINGES))
    rig = CompiledMechanism(read_mechanism(tmp_path / "arm.xml"))
    last = shapes_of(rig.mechanism)[-1]
    names = [p.name for p in rig.on_request[last.group]]
    fitted = {p.name: p for p in rig.parameters if p.fitted}
    assert set(names) <= set(fitted) and fitted[f"{last.body.name}_mass"].spread == 2.0
    assert [n for n in fitted if "centre" in n] == list(last.centre_names)
    narrow = {p.name: p.spread for p in released(rig, {last.group: 0.1}).parameters}
    assert len(narrow) == len(rig.parameters)
    assert all(narrow[n] == pytest.approx(0.1 * fitted[n].spread) for n in names)
    # a tree of two chains has no end where a tool would be mounted
    tree = mechanisms.rig_from(mechanisms.TREE, tmp_path)
    assert not any("centre" in p.name for p in tree.parameters)


def test_an_inertia_without_a_name_is_refused_with_the_nearest(tmp_path):
    rig = mechanisms.rig_from(mechanisms.TWO, tmp_path)
    with pytest.raises(FileError, match="no such parameter") as caught:
        released(rig, {"forarm_inertia": 0.1})
    assert "forearm_inertia" in caught.value.hint


def test_a_full_inertia_has_its_principal_axes_in_a_right_handed_frame():
    full = np.array([[0.03, 0.002, -0.001], [0.002, 0.02, 0.004], [-0.001, 0.004, 0.025]])
    body = Body("b", 0, (0, 0, 0), (1, 0, 0, 0), 1.0, (0, 0, 0), (1, 0, 0, 0), (1, 1, 1))
    turned = with_full_inertia(body, full)
    np.testing.assert_allclose(full_inertia(turned), full, atol=1e-15)
    assert list(turned.inertia) == sorted(turned.inertia, reverse=True)
