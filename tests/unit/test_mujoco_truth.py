"""The machines of the blind cases: what is planted shows, what needs no effect needs none, and
nothing of it reaches the model that is given away."""

from __future__ import annotations

import json
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
from scripts import load_script

pytest.importorskip("mujoco", reason="pip install 'pamid[mujoco]'")

SECONDS = 4.0
STEPS = 2.0 * np.pi / 2**13  # of the coarsest encoder


@pytest.fixture(scope="module")
def truth() -> ModuleType:
    return load_script("mujoco_truth.py")


@pytest.fixture(scope="module")
def cases() -> ModuleType:
    return load_script("mujoco_cases.py")


def drawn(truth: ModuleType, joints: int, kind: str, seed: int = 0):
    random = np.random.default_rng([joints, seed])
    machine = truth.arm(joints, random)
    return machine, truth.draw_planted(kind, machine, random)


def positions(truth: ModuleType, machine, planted) -> np.ndarray:
    columns, _ = truth.record(machine, planted, SECONDS, 3, torque_noise=0.0)
    return np.column_stack([v for name, v in columns.items() if name.endswith("pos_rad")])


@pytest.mark.parametrize("joints", [1, 2, 7])
@pytest.mark.parametrize("kind", ["frictionloss", "backlash", "delay", "armature", "spring"])
def test_what_is_planted_shows_and_stays_within_the_joints(truth, joints, kind) -> None:
    machine, planted = drawn(truth, joints, kind)
    with_it, without = positions(truth, machine, planted), positions(truth, machine, None)
    at = planted.link
    assert np.abs(with_it - without)[:, at].max() > 5.0 * STEPS
    reach = [link.reach for link in machine.links]
    assert (np.abs(with_it) < reach).all()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_mass_and_armature_of_one_joint_are_a_link_with_its_load(truth, cases, seed) -> None:
    machine, planted = drawn(truth, 1, "payload", seed)
    known = cases.true_parameters(machine, planted)
    link = machine.links[0]
    factor = known["upper_mass_kg"] / link.mass
    alike = replace(
        link,
        mass=factor * link.mass,
        inertia=tuple(factor * v for v in link.inertia),
        armature=known["shoulder_armature_kg_m2"],
    )
    wanted = positions(truth, machine, planted)
    found = positions(truth, replace(machine, links=(alike,)), None)
    assert np.abs(found - wanted).max() <= 1.5 * STEPS  # a rounding of the encoder apart
    assert np.abs(positions(truth, machine, None) - wanted).max() > 5.0 * STEPS


def test_a_case_gives_nothing_away(truth, cases, tmp_path) -> None:
    for number in range(len(truth.KINDS)):
        cases.make_case(tmp_path, 5, number)
    labels = json.loads((tmp_path / "labels.json").read_text())
    assert {label["kind"] for label in labels.values()} == set(truth.KINDS)
    for number in range(len(truth.KINDS)):
        folder = cases.folder_of(tmp_path, number)
        assert {p.name for p in folder.iterdir()} == {"model.xml", "rec.csv"}
        text = (folder / "model.xml").read_text()
        assert not any(word in text for word in ("frictionloss", "behind", "load", "stiffness"))
        rows = (folder / "rec.csv").read_text().splitlines()
        assert len(rows) == 1 + round(cases.SECONDS[1] / truth.PERIOD_S)


@pytest.mark.parametrize(
    ("port", "joint", "expected"),
    [
        ("joint1", "joint1", True),
        ("joint1_transmission", "joint1", True),
        ("joint2_drive_command", "joint1", False),
        ("joint10", "joint1", False),
        ("shoulder", "", False),
    ],
)
def test_ports_of_a_joint(cases, port, joint, expected) -> None:
    assert cases.belongs(port, joint) == expected
