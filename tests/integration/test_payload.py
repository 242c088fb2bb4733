"""A payload on an arm: mass, centre and inertia of the last link are found within their intervals,
and the written file is the machine in plain MuJoCo."""

import json
from functools import cache
from pathlib import Path

import mechanisms
import numpy as np
import pytest
from pamid_cli import frame
from posed_arms import FOUR_HINGES, arm_text, record_about

from pamid.base.arrays import Array
from pamid.rigs.simulators.body_inertia import full_inertia, shapes_of
from pamid.rigs.simulators.mechanism import Body
from pamid.rigs.simulators.mujoco_mechanism import read_mechanism

mechanisms.needs_mujoco()


# yaw, shoulder, elbow; the payload has half of the last link's mass and hangs off its axis
ARM = FOUR_HINGES[:3]
LINK = ARM[-1]
PAYLOAD_KG, AT, EACH = 0.7, np.array([0.3, -0.06, 0.03]), 0.001
ZEROS = [
    f"{link.joint}_{word} = 0"
    for link in ARM
    for word in ("damping_n_m_s_per_rad", "armature_kg_m2")
]
GROUP = f"{LINK.joint}_link_inertia"


def steiner(mass: float, arm: Array) -> Array:
    """Inertia of a point mass (parallel axis theorem), kg m2."""
    return mass * ((arm @ arm) * np.eye(3) - np.outer(arm, arm))


@cache
def truth() -> tuple[float, Array, Array]:
    """Mass, centre and inertia about it of the last link with its payload."""
    mass, centre = LINK.mass + PAYLOAD_KG, np.array(LINK.centre)
    common = (LINK.mass * centre + PAYLOAD_KG * AT) / mass
    inertia = np.diag(LINK.inertia) + EACH * np.eye(3)
    inertia = inertia + steiner(LINK.mass, centre - common) + steiner(PAYLOAD_KG, AT - common)
    return mass, common, inertia


def machine_text() -> str:
    mass, centre, inertia = truth()
    alone = arm_text(ARM)
    place = " ".join(map(str, LINK.centre))
    start = alone.index(f'<inertial pos="{place}" mass="{LINK.mass:.9g}"')
    stop = alone.index("/>", start)
    full = " ".join(map(str, [*inertia.diagonal(), inertia[0, 1], inertia[0, 2], inertia[1, 2]]))
    return (
        f'{alone[:start]}<inertial pos="{centre[0]} {centre[1]} {centre[2]}" mass="{mass}" '
        f'fullinertia="{full}"{alone[stop:]}'
    )


def recorded(folder: Path, *free: str) -> Path:
    """The log of the arm with its payload, next to the model file of the arm alone."""
    pose, log = np.array([0.4, -0.6, 0.7]), folder / "log.csv"
    record_about(ARM, pose, 8.0, 2, log, 1.0, text=machine_text())
    (folder / "arm.xml").write_text(arm_text(ARM))
    log.with_suffix(".toml").write_text("\n".join(["[known]", *ZEROS, "[free]", *free]) + "\n")
    return log


def test_a_payload_is_found_within_the_intervals_and_written(tmp_path, cli):
    log, model, new = recorded(tmp_path), tmp_path / "arm.xml", tmp_path / "new.xml"
    found = cli("fit", log, "--rig", model, "--output", tmp_path / "run")
    assert found["converged"]
    mass, centre, inertia = truth()
    shape = shapes_of(read_mechanism(model))[-1]
    true = {f"{shape.body.name}_mass_kg": mass}
    true |= {f"{n}_m": c for n, c in zip(shape.centre_names, centre, strict=True)}
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    true |= {
        f"{n}_kg_m2": inertia[i, k] for n, (i, k) in zip(shape.inertia_names, pairs, strict=True)
    }
    # what is shown is what a drawing states: neither stretches nor shears
    assert set(found["parameters"]) == {*true, "yaw_link_mass_kg", "shoulder_link_mass_kg"}
    for name, value in true.items():
        one = found["parameters"][name]
        assert one["low"] <= value <= one["high"], (name, one, value)
    settled = {n for n, one in found["parameters"].items() if one["word"] == "settled"}
    assert {f"{shape.body.name}_mass_kg", *(f"{n}_m" for n in shape.centre_names)} <= settled
    for name, errors in found["mae"].items():
        assert errors["refitted"] < 2.5 * errors["noise_floor"] < errors["data_sheet"], name
    for _, names in ((t, t["parameters"]) for t in found["tied"]):
        assert not any("stretch" in n or "shear" in n for n in names)

    ranges = tmp_path / "ranges.yaml"
    export = ("export", tmp_path / "run", "--rig", model, "--to", "mjcf", "--output", new)
    written = cli(*export, "--randomise", ranges)
    assert "stretch" not in ranges.read_text() and f"{GROUP}_xx" in ranges.read_text()
    for errors in written["plain_mujoco"]["channels"].values():
        assert errors["now"] < 1.2 * errors["stated"] < 0.1 * errors["before"]
    body = _last_body(new)
    assert body.mass_kg == pytest.approx(mass, rel=0.02)
    assert body.centre == pytest.approx(tuple(centre), abs=0.003)
    np.testing.assert_allclose(full_inertia(body), inertia, atol=0.1 * inertia.max())


def _last_body(path: Path) -> Body:
    return read_mechanism(path).bodies[-1]


@pytest.mark.slow
def test_a_mass_of_known_shape_does_not_explain_the_payload(tmp_path, capsys):
    log = recorded(tmp_path, f"{GROUP} = 1e-3")
    words = ("fit", log, "--rig", tmp_path / "arm.xml", "--output", tmp_path / "run")
    assert frame.run([*map(str, words), "--json"]) in (0, 5)
    found = json.loads(capsys.readouterr().out)
    assert max(e["refitted"] / e["noise_floor"] for e in found["mae"].values()) > 10.0
