"""The arm of the rig `two-link` without its muscles, written as MJCF: the same accelerations, and
the same diagnosis of a friction that MuJoCo was given at one joint."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import pamid
from pamid.api.results import DiagnosisResult
from pamid.base.arrays import Array
from pamid.engine.sampled_inputs import SampledInputs
from pamid.model.assembly import Assembly
from pamid.model.registry import effects, rig_named
from pamid.simulation.excitation.aprbs import aprbs

mujoco = pytest.importorskip("mujoco", reason="the extra [mujoco] is not installed")


FILE = Path(__file__).resolve().parents[2] / "data/rigs/two_link_arm.xml"
PERIOD, SAMPLES, PARTS = 0.004, 2500, 8
HIGHEST = np.array([2.5, 0.6])  # N m
FRICTION = 0.1  # N m, at joint 2; gravity exerts up to 0.9 there
HEAVIER = (1.12, 0.9)  # the machine's links
# named like one another in the two rigs, by kind
TRIED = (
    "coulomb-friction",
    "stribeck-friction",
    "viscous-friction",
    "gain-error",
    "first-order-lag",
)


def _accelerations(a: Assembly, states: Array) -> Array:
    """Of both joints, at states (n, 4) of angles and velocities."""
    names = a.program.states
    velocities = [n for n in names if "velocity" in n]
    program = a.program_with({f"rate.{n}": a.traced.rates[n] for n in velocities})
    found = []
    for row in states:
        x = a.start(a.values())
        x[: len(row)] = row
        memory = program.memory(x, period_s=PERIOD)
        p = a.values(KNOWN) if "attached" in a.keys else a.values()
        y = program.run(memory, SampledInputs(np.zeros((1, len(program.inputs))), PERIOD), p)[0]
        found.append(y[0, -2:])
    return np.array(found)


KNOWN = {"attached": 0.0}


def test_the_file_is_the_rigs_arm():
    random = np.random.default_rng(0)
    states = random.standard_normal((20, 4)) * (1.0, 1.0, 3.0, 3.0)
    ours, theirs = (
        _accelerations(Assembly(rig), states)
        for rig in (rig_named("two-link"), rig_named(str(FILE)))
    )
    assert np.abs(ours - theirs).max() < 1e-10 * np.abs(ours).max()


def _recorded() -> tuple[Array, Array]:
    """Torques and angles (samples, 2) of MuJoCo's arm with friction at the second joint."""
    model = mujoco.MjModel.from_xml_path(str(FILE))
    for body, factor in zip((1, 2), HEAVIER, strict=True):
        model.body_mass[body] *= factor
        model.body_inertia[body] *= factor
    model.dof_frictionloss[1] = FRICTION
    model.opt.timestep = PERIOD / PARTS
    # as hard as the step allows: by default it creeps while it sticks, which Coulomb's does not
    model.dof_solref[1] = 2.0 * model.opt.timestep, 1.0
    mujoco.mj_setConst(model, mujoco.MjData(model))
    data = mujoco.MjData(model)
    torques = np.stack(
        [
            aprbs(SAMPLES * PERIOD, PERIOD, high, (0.1, 0.7), seed=seed)[:SAMPLES]
            for seed, high in enumerate(HIGHEST)
        ],
        axis=1,
    )
    angles = np.empty((SAMPLES, 2))
    for k, torque in enumerate(torques):
        angles[k], data.ctrl[:] = data.qpos, torque
        for _ in range(PARTS):
            mujoco.mj_step(model, data)
    assert np.abs(angles).max() < 2.5
    return torques, angles + 5e-4 * np.random.default_rng(5).standard_normal(angles.shape)


def _diagnosed(rig: str, columns: dict[str, Array], **known: float) -> DiagnosisResult:
    table = pd.DataFrame({"time_s": PERIOD * np.arange(SAMPLES), **columns})
    return pamid.diagnose(
        pamid.Recording.from_pandas(table, known=known),
        rig,
        without=[name for name in effects() if name not in TRIED],
        jobs=1,
    )


@pytest.mark.slow
def test_both_name_the_same_cause():
    torques, angles = _recorded()
    ours = _diagnosed(
        "two-link",
        {f"external_torque_{j}_nm": torques[:, j - 1] for j in (1, 2)}
        | {f"angle_{j}_deg": np.degrees(angles[:, j - 1]) for j in (1, 2)},
        **KNOWN,
    )
    theirs = _diagnosed(
        str(FILE),
        {f"torque_{j}_command": torques[:, j - 1] for j in (1, 2)}
        | {f"angle_{j}_rad": angles[:, j - 1] for j in (1, 2)},
    )
    print(ours, theirs)
    levels = []
    for found in (ours, theirs):
        assert found.verdict in ("explained", "partly-explained")
        assert [(c.family, c.port) for c in found.causes] == [("friction", "joint_2")]
        levels.append(found.causes[0].parameters["torque_n_m"])
        assert abs(levels[-1].value - FRICTION) < 0.05 * FRICTION
    one, other = levels
    assert one.low is not None and one.high is not None
    assert other.low is not None and other.high is not None
    assert max(one.low, other.low) <= min(one.high, other.high)
