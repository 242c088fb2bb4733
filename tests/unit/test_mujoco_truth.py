"""The made arms: what is planted shows, and what needs no effect needs none."""

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


def drawn(truth: ModuleType, joints: int, kind: str, seed: int = 0):
    random = np.random.default_rng([joints, seed])
    machine = truth.arm(joints, random)
    return machine, truth.draw_planted(kind, machine, random)


def positions(truth: ModuleType, machine, planted) -> np.ndarray:
    columns, _ = truth.record(machine, planted, SECONDS, 3, torque_noise=0.0)
    return np.column_stack([v for name, v in columns.items() if name.endswith("pos_rad")])


@pytest.mark.parametrize("joints", [1, 2, 7])
@pytest.mark.parametrize("kind", ["frictionloss", "backlash", "delay", "armature"])
def test_what_is_planted_shows_and_stays_within_the_joints(truth, joints, kind):
    machine, planted = drawn(truth, joints, kind)
    with_it, without = positions(truth, machine, planted), positions(truth, machine, ())
    at = [link.joint for link in machine.links].index(planted[0].joint)
    assert np.abs(with_it - without)[:, at].max() > 5.0 * STEPS
    reach = [link.reach for link in machine.links]
    assert (np.abs(with_it) < reach).all()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_mass_and_armature_of_one_joint_are_a_link_with_its_load(truth, seed):
    machine, (load,) = drawn(truth, 1, "payload", seed)
    link = machine.links[0]
    factor = 1.0 + 2.0 * load.size / link.mass  # the same moment of gravity
    inertia = load.size * (link.length**2 + 1e-4)
    alike = replace(
        link,
        mass=factor * link.mass,
        inertia=tuple(factor * v for v in link.inertia),
        armature=link.armature + inertia - (factor - 1.0) * link.about_joint,
    )
    wanted = positions(truth, machine, (load,))
    found = positions(truth, replace(machine, links=(alike,)), ())
    assert np.abs(found - wanted).max() <= 1.5 * STEPS  # a rounding of the encoder apart
    assert np.abs(positions(truth, machine, ()) - wanted).max() > 5.0 * STEPS
