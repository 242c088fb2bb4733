"""Arms that MuJoCo simulates, against models that lack what their joints have: friction is found in
the joints that have it and in no other, what a file states as zero is fitted, and play in a servo
is found by an encoder behind it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

import mechanisms
import numpy as np
import pytest
from scripts import load_script

from pamid.base.arrays import Array
from pamid.base.json_file import write_json
from pamid.base.run_folder import FIT_FILE, RESIDUAL_FILE, Run
from pamid.diagnosis import pipeline
from pamid.diagnosis.pipeline import Diagnosis, diagnose
from pamid.diagnosis.verdict.added_variables import added_variables
from pamid.diagnosis.verdict.diagnosis_run import models_json, with_causes
from pamid.estimation.fit_files import residual_csv
from pamid.exports.exporting import export_model
from pamid.model.registry import effects, rig_named
from pamid.networks.correction.identified_model import load_identified
from pamid.recording.recording import Recording, recording_of
from pamid.simulation.data_split import split_recordings

mujoco: Any = mechanisms.needs_mujoco()

PERIOD_S, STEP_S, SECONDS = 0.004, 0.0005, 12.0
ENCODER_RAD = 2.0 * np.pi / 2**14
REAL = Path(__file__).parents[3] / "shared" / "data" / "real" / "dfki_double"
CANDIDATES = (
    "coulomb-friction",
    "yielding-friction",
    "linear-stiffness",
    "dead-time",
    "gain-error",
    "dead-zone",
)
LENGTHS, MASSES = (0.35, 0.3, 0.25), (1.2, 0.9, 0.5)
DAMPING, ARMATURE = 0.3, 0.02  # of the first joint, N m s and kg m2
TORQUES = (3.0, 1.0, 0.25)  # N m, largest that are sent


def arm_text(joints: int, losses: Sequence[float] = (), mass: float = 1.0) -> str:
    """MJCF of a hanging arm of rods. losses: friction by joint, N m; mass: a factor."""
    head = ""
    for k in range(joints):
        length, m = LENGTHS[k], mass * MASSES[k]
        across = m * length**2 / 12.0
        own = f'damping="{DAMPING / (k + 1)}" armature="{ARMATURE / (k + 1)}"'
        loss = f'frictionloss="{losses[k]}"' if k < len(losses) and losses[k] else ""
        head += (
            f'<body pos="0 0 {-LENGTHS[k - 1] if k else 0}"><joint name="j{k + 1}" axis="0 1 0" '
            f'{own} {loss}/><inertial pos="0 0 {-0.5 * length}" mass="{m}" '
            f'diaginertia="{across} {across} {0.02 * across}"/>'
        )
    motors = "".join(f'<motor name="m{k + 1}" joint="j{k + 1}"/>' for k in range(joints))
    sensors = "".join(f'<jointpos name="a{k + 1}" joint="j{k + 1}"/>' for k in range(joints))
    return (
        f'<mujoco model="arm"><compiler angle="radian"/><option timestep="{STEP_S}" '
        f'integrator="RK4"/><worldbody>{head}{"</body>" * joints}</worldbody>'
        f"<actuator>{motors}</actuator><sensor>{sensors}</sensor></mujoco>"
    )


@lru_cache
def arm_log(joints: int, losses: tuple[float, ...] = ()) -> Recording:
    """What an arm with these friction losses would log."""
    random = np.random.default_rng(joints)
    model = mujoco.MjModel.from_xml_string(arm_text(joints, losses))
    data = mujoco.MjData(model)
    sent = np.array([_steps(random, TORQUES[k]) for k in range(joints)]).T
    angles = np.empty_like(sent)
    for row, torques in enumerate(sent):
        angles[row] = data.qpos
        data.ctrl[:] = torques
        mujoco.mj_step(model, data, round(PERIOD_S / STEP_S))
    columns = {f"m{k + 1}_command": sent[:, k] for k in range(joints)}
    columns |= {
        f"a{k + 1}_rad": ENCODER_RAD * np.round(angles[:, k] / ENCODER_RAD) for k in range(joints)
    }
    return recording_of(PERIOD_S * np.arange(len(sent)), columns)


def _steps(random: np.random.Generator, size: float) -> Array:
    held = [np.full(random.integers(60, 250), random.uniform(-size, size)) for _ in range(60)]
    return np.concatenate(held)[: round(SECONDS / PERIOD_S)]


def found(folder: Path, text: str, log: Recording, names: Sequence[str] = CANDIDATES) -> Diagnosis:
    path = folder / "model.xml"
    path.write_text(text)
    rig = rig_named(str(path))
    return diagnose(split_recordings(rig, [log], []), {name: effects()[name] for name in names})


def levels(d: Diagnosis) -> Mapping[str, float]:
    """Friction in the answer by joint, N m."""
    assert d.cause is not None and d.answer is not None, d.verdict
    assert {c.effect.family(d.evidence.rig) for c in d.answer.causes} == {"friction"}
    return {
        a.ports[0]: float(d.cause.fit.p[d.cause.assembly.keys[f"{a.label}:level"]])
        for a in d.cause.attached
    }


@pytest.mark.parametrize(
    ("joints", "losses"),
    [(2, (0.0, 0.15)), pytest.param(3, (0.5, 0.0, 0.06), marks=pytest.mark.slow)],
    ids=["one of two", "two of three"],
)
def test_friction_is_named_at_the_joints_that_have_it(joints, losses, tmp_path):
    d = found(tmp_path, arm_text(joints, mass=1.1), arm_log(joints, losses))
    planted = {f"j{k + 1}": loss for k, loss in enumerate(losses) if loss}
    assert levels(d) == pytest.approx(planted, rel=0.15)
    # all joints were one candidate
    assert sum("coulomb-friction" in c.label for c in d.ranking) == 1


def test_a_joint_that_no_model_without_friction_follows_is_searched(tmp_path, monkeypatch):
    explained, lagged = pipeline.explained_channels, pipeline.lagged_response
    judged: list[Any] = []

    def first_not(*given):
        judged.append(explained(*given))
        return judged[-1] & np.array([True, len(judged) > 1])

    def nothing_linear(*given):
        response = lagged(*given)
        assert response is not None
        return replace(response, forward=np.array([response.forward[0], np.inf]))

    monkeypatch.setattr(pipeline, "explained_channels", first_not)
    monkeypatch.setattr(pipeline, "lagged_response", nothing_linear)
    d = found(tmp_path, arm_text(2, mass=1.1), arm_log(2, (0.0, 0.15)), ("coulomb-friction",))
    assert levels(d) == pytest.approx({"j2": 0.15}, rel=0.15)
    assert not d.silent


@pytest.fixture(scope="module")
def truth() -> ModuleType:
    return load_script("mujoco_truth.py")


def bare_case(truth: ModuleType, folder: Path, shares: Sequence[float]) -> tuple[Any, Diagnosis]:
    """An arm, and the diagnosis with a model whose armatures and dampings are zero.

    shares: friction by joint, of its torque limit.
    """
    machine = replace(truth.arm(2, np.random.default_rng(4)), velocities=False)
    planted = tuple(
        truth.Planted("frictionloss", link.joint, share * link.limit)
        for link, share in zip(machine.links, shares, strict=False)
    )
    columns, _ = truth.record(machine, planted, SECONDS, 4)
    log = recording_of(columns.pop("time_s"), columns)
    links = tuple(replace(link, armature=0.0, damping=0.0) for link in machine.links)
    return machine, found(folder, truth.model_text(replace(machine, links=links)), log)


def test_what_the_file_states_as_zero_is_fitted(truth, tmp_path):
    """A missing armature is no gain of a sensor."""
    machine, d = bare_case(truth, tmp_path, ())
    base = d.budget.baseline
    values = {b.key: float(v) for b, v in zip(base.assembly.parameters, base.fit.p, strict=True)}
    for link in machine.links:
        assert values[f"{link.joint}_armature"] == pytest.approx(link.armature, rel=0.1)
        assert values[f"{link.joint}_damping"] == pytest.approx(link.damping, rel=0.1)
    causes = d.answer.causes if d.answer is not None else ()
    families = {c.effect.family(d.evidence.rig) for c in causes}
    assert not families & {"friction", "sensor-gain", "stiffness"}


def test_a_bare_model_of_an_arm_that_rubs_lacks_friction(truth, tmp_path):
    machine, d = bare_case(truth, tmp_path, (0.05, 0.06))
    first, second = machine.links
    planted = {first.joint: 0.05 * first.limit, second.joint: 0.06 * second.limit}
    assert levels(d) == pytest.approx(planted, rel=0.15)
    # what both add together is drawn as one
    joints = " + ".join(f"coulomb-friction@{link.joint}" for link in machine.links)
    assert joints in {plot.effect for plot in added_variables(d).plots}


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason=f"{REAL} is not there")
def test_both_joints_of_a_real_double_pendulum_rub(tmp_path):
    """Published: 0.16 and 0.12 N m; plain MuJoCo follows a third recording with the new file."""
    from pamid.recording.recording import read_recording

    file = REAL / "dfki_double.xml"
    rig = rig_named(str(file))
    names = {f"torque_{k}_nm": f"torque_{k}_command" for k in (1, 2)}
    logs = []
    for run in range(3):
        log = read_recording(REAL / f"run_{run}.csv")
        columns = {names.get(name, name): values for name, values in log.columns.items()}
        logs.append(recording_of(log.time, columns, name=f"run_{run}"))
    named = {name: effects()[name] for name in (*CANDIDATES, "maxwell-slip-hysteresis")}
    d = diagnose(split_recordings(rig, logs[:2], logs[2:]), named)
    assert levels(d) == pytest.approx({"shoulder": 0.16, "elbow": 0.12}, rel=0.5)
    identified = load_identified(run_of(d, tmp_path / "run", file), which="cause", rig=str(file))
    made = export_model(identified, "mjcf", tmp_path / "new.xml")
    assert made.check is not None and set(made.check.errors.channels) == set(d.evidence.channels)
    for name, channel in made.check.errors.channels.items():
        assert name.endswith("_rad") and channel.now <= 0.055 < channel.before


def run_of(d: Diagnosis, folder: Path, file: Path) -> Path:
    """What an export reads of the run of a diagnosis."""
    run = Run.create(folder, command="diagnose", seed=0, inputs=[file], options={"rig": str(file)})
    write_json(run.path(FIT_FILE), models_json(d))
    run.path(RESIDUAL_FILE).write_bytes(residual_csv(d.budget.model, with_causes(d)))
    run.finish()
    return folder


# ---- play in a servo ---------------------------------------------------------------------------

HALF_GAP_RAD = 0.02
SERVO = """<mujoco model="servo"><compiler angle="radian"/>
  <option timestep="0.0005" integrator="RK4"/>
  <worldbody><body>
    <joint name="hinge" axis="0 1 0" damping="0.02" armature="0.004"/>{play}
    <inertial pos="0 0 -0.1" mass="{mass}" diaginertia="{across} {across} 0.00005"/>
  </body></worldbody>
  <actuator>
    <position name="drive" joint="hinge" kp="8" kv="0.25" forcerange="-3 3"/>
  </actuator>
  <sensor><jointpos name="encoder" joint="hinge"/></sensor>
</mujoco>
"""


def servo_text(mass: float, play: str = "") -> str:
    return SERVO.format(mass=mass, across=mass * 0.2**2 / 12.0, play=play)


def servo_log() -> Recording:
    """A servo whose motor has a loop of its own, and an encoder behind the play of its gear."""
    play = (
        f'<joint name="play" axis="0 1 0" range="{-HALF_GAP_RAD} {HALF_GAP_RAD}" limited="true" '
        'solreflimit="0.01 0.7"/>'
    )
    model = mujoco.MjModel.from_xml_string(servo_text(0.25, play))
    data, random = mujoco.MjData(model), np.random.default_rng(1)
    targets = _steps(random, 1.2)
    sent = np.zeros(len(targets))
    for k in range(1, len(sent)):
        sent[k] = sent[k - 1] + np.clip(targets[k] - sent[k - 1], -0.016, 0.016)
    angles = np.empty(len(sent))
    for k, target in enumerate(sent):
        angles[k] = data.qpos.sum()
        data.ctrl[0] = target
        mujoco.mj_step(model, data, round(PERIOD_S / STEP_S))
    step = 2.0 * np.pi / 4096
    columns = {"drive_command_rad": sent, "encoder_rad": step * np.round(angles / step)}
    return recording_of(PERIOD_S * np.arange(len(sent)), columns)


def test_play_is_found_by_an_encoder_behind_it(tmp_path):
    names = ("load-side-backlash", "backlash", "play", "dead-zone", "coulomb-friction", "dead-time")
    d = found(tmp_path, servo_text(0.28), servo_log(), names)
    assert d.cause is not None and [a.effect.name for a in d.cause.attached] == [names[0]]
    place = d.cause.assembly.keys["load-side-backlash:half_gap"]
    assert float(d.cause.fit.p[place]) == pytest.approx(HALF_GAP_RAD, rel=0.2)
