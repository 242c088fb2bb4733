"""Blind cases with stock robots: does `pamid diagnose` name what the model file lacks, and does the
file that it writes follow the machine?

    python benchmarks/stock_cases.py --models DIR --output FOLDER [--planted 60 --nothing 20] \\
        [--seed 1] [--from 0 --to 80] [--jobs 1]

DIR has the unpacked packages robosuite, airo-models (`pip download --no-deps`, unzipped). A case is
a whole robot of them: 5 to 8 s at 100 to 200 Hz about a random pose within the joints' ranges, away
from contact, and a second log that is held out. Plain MuJoCo makes them at 0.5 ms: every mass of
the machine is up to 10 % off the file, and something is planted (`mujoco_truth.py`), in half of the
planted cases two things. A computed-torque controller that knows the file's masses and the friction
leads a robot of motors. In four of ten MJCF cases, and where kp is planted, position servos take
the place of the motors. The machine has no contacts: geoms that touch in three of four random poses
are a fault of the file, which its user leaves out of an MJCF as pamid advises.

`pamid diagnose` and `pamid export` get the file and the logs, with nothing planted said. What was
planted stands in FOLDER/labels, scores in FOLDER/scores: a case that has one is not run again.

Right was decided before the first run:

    planted       right answer
    friction      family friction at joints that have it; at all joints: at half of them or more.
                  Or, where the file has friction there, no effect: the joint's frictionloss is
                  within 20 % or in its interval, and the file's value was not (added after case
                  26: a file with friction at every joint, refitted)
    delay         family command-timing at the joint's actuator
    play          family flexible-transmission at the joint
    armature      no effect: the joint's armature within 20 % or in its interval
    payload       no effect: the mass of the last body with its load, within 20 % or in its interval
    kp            no effect: the actuator's kp within 20 % or in its interval
    nothing       no effect

Several planted: all of them right, and no further effect. Then:
    right         as above
    in a set      the verdict leaves two families open, and the right one is one of them
    lesser        of two planted one is right, the other is missed, and nothing else is named
    open          nothing is named, and something planted is missed
    wrong         an effect that is not there, at a joint or of a family
A written file is compared with the error that the run states, in plain MuJoCo at the file's own
step and at the step that pamid recommends. A URDF can hold friction and masses.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mujoco_truth import Planted, plant

from pamid.base.arrays import Array
from pamid.base.units import with_unit

MODELS = {
    "kinova3": "robosuite/models/assets/robots/kinova3/robot.xml",
    "airo-ur5e": "airo_models/arms/ur5e/ur5e.urdf",
    "panda": "robosuite/models/assets/robots/panda/robot.xml",
    "iiwa": "robosuite/models/assets/robots/iiwa/robot.xml",
    "ur5e": "robosuite/models/assets/robots/ur5e/robot.xml",
    "jaco": "robosuite/models/assets/robots/jaco/robot.xml",
    "airo-ur3e": "airo_models/arms/ur3e/ur3e.urdf",
    "xarm7": "robosuite/models/assets/robots/xarm7/robot.xml",
    "spot-arm": "robosuite/models/assets/robots/spot_arm/robot.xml",
    "sawyer": "robosuite/models/assets/robots/sawyer/robot.xml",
    "sawyer-urdf": "robosuite/models/assets/bullet_data/sawyer_description/urdf/sawyer_arm.urdf",
}
#: folder of the package that a model's meshes are in, above the file
LEVELS = {"sawyer-urdf": 1}
KINDS = ("friction", "friction-all", "delay", "play", "armature", "payload", "kp")
FAMILIES = {
    "friction": "friction",
    "friction-all": "friction",
    "delay": "command-timing",
    "play": "flexible-transmission",
}
CAUSED = ("explained", "partly-explained", "ambiguous")  # verdicts that name a cause
OUTCOMES = ("right", "in a set", "lesser", "open", "wrong")
NEAR = 0.2  # relative error of a parameter that is right
IN_FILE = {"urdf": ("friction", "friction-all", "payload"), "mjcf": KINDS}  # what a file can hold

STEP_S = 0.0005
FASTEST = 30.0  # rad/s: several times any reference
STEADY = 0.3  # largest change of a velocity in a step by the damping of a servo, as a share of it
SETTLE_S = 1.0  # before the log begins
STEERED_HZ, SERVO_HZ, DAMPED = 2.0, 4.0, 0.7
SWING_RAD = 0.5
CREEP = 0.05  # rad/s
MASS_OFF = 0.1
TRIES = 60  # of poses
PAMID = Path(sys.executable).with_name("pamid")


@dataclass(frozen=True)
class Case:
    """A robot, what is planted in it, and how it is recorded.

    effects  (kind, number of the joint; -1: all) of each thing planted
    """

    number: int
    model: str
    servo: bool
    effects: tuple[tuple[str, int], ...]
    velocities: bool
    period_s: float
    seconds: float
    sines: bool


def main() -> int:
    """Make, diagnose, export and score the cases, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", type=Path, required=True)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--planted", type=int, default=60)
    parser.add_argument("--nothing", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--from", type=int, default=0, dest="first")
    parser.add_argument("--to", type=int)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--score-only", action="store_true")
    options = parser.parse_args()
    cases = all_cases(options.seed, options.planted, options.nothing)
    cases = cases[options.first : options.to]
    if not options.score_only:
        with ThreadPoolExecutor(options.jobs) as pool:
            list(
                pool.map(lambda c: run_case(c, options.models, options.output, options.seed), cases)
            )
    rows = [score(case, options.output) for case in cases]
    print("\n".join(table([row for row in rows if row])))
    return 0


def all_cases(seed: int, planted: int, nothing: int) -> list[Case]:
    """The cases of a seed, those with nothing planted spread among the others.

    Models, kinds and pairs of kinds come in turn, so that any stretch of cases is a fair share.
    """
    random = np.random.default_rng([seed, 47])
    pairs = [list(p) for p in itertools.combinations(KINDS, 2) if p != ("friction", "friction-all")]
    singles = [[kind] for kind in KINDS]
    order: dict[int, list[list[str]]] = {1: [], 2: []}
    names: list[str] = []
    blanks = {round(k * (planted + nothing) / nothing) for k in range(nothing)} if nothing else ()
    cases, done = [], 0
    for number in range(planted + nothing):
        names = names or random.permutation(list(MODELS)).tolist()
        model = names.pop()
        kinds: list[str] = []
        if number not in blanks:
            size = 1 + done % 2
            pool = singles if size == 1 else pairs
            order[size] = order[size] or [pool[i] for i in random.permutation(len(pool))]
            kinds = order[size].pop()
            done += 1
        mjcf = MODELS[model].endswith(".xml")
        if "kp" in kinds and not mjcf:  # a URDF has no servos
            model = str(random.choice([m for m, path in MODELS.items() if path.endswith(".xml")]))
            mjcf = True
        servo = mjcf and ("kp" in kinds or bool(random.random() < 0.4))
        cases.append(
            Case(
                number,
                model,
                servo,
                tuple(
                    (kind, -1 if kind == "friction-all" else int(random.integers(100)))
                    for kind in kinds
                ),
                bool(random.random() < 0.5),
                float(random.choice([0.005, 0.008, 0.01])),
                float(random.uniform(5.0, 8.0)),
                bool(random.random() < 0.5),
            )
        )
    return cases


def run_case(case: Case, models: Path, output: Path, seed: int) -> None:
    """Make, diagnose and export a case, unless its score is there."""
    if (output / "scores" / f"{case.number:03d}.json").exists():
        return
    folder = output / "cases" / f"{case.number:03d}"
    file = model_copy(case, models, output)
    labelled = (output / "labels" / f"{case.number:03d}.json").exists()
    if not (labelled or make_case(case, file, output, seed)):
        return
    diagnose_case(case, file, folder)
    row = score(case, output)
    assert row is not None
    (output / "scores").mkdir(exist_ok=True)
    (output / "scores" / f"{case.number:03d}.json").write_text(json.dumps(row, indent=1) + "\n")
    print(line(row), flush=True)


def model_copy(case: Case, models: Path, output: Path) -> Path:
    """The model file of a case in a copy of its folder, next to its meshes."""
    at = models / MODELS[case.model]
    top = at.parents[LEVELS.get(case.model, 0)]
    folder = output / "models" / case.model
    if not folder.exists():
        draft = folder.with_name(f".{case.model}-{os.getpid()}")
        shutil.copytree(top, draft)
        draft.rename(folder)
    stock = folder / at.relative_to(top)
    mjcf = stock.suffix == ".xml"
    return stock.with_name(f"{stock.stem}-{case.number:03d}.xml") if mjcf else stock


# ---- making --------------------------------------------------------------------------------------


class Robot:
    """A model file as plain MuJoCo loads it, at the fine step and without contacts.

    masses  factors of the bodies' masses, in turn
    """

    def __init__(
        self,
        text: str,
        file: Path,
        planted: Sequence[Planted] = (),
        masses: Sequence[float] = (1.0,),
    ) -> None:
        import mujoco

        scratch = file.with_name(f".{file.stem}-{os.getpid()}-{id(self)}{file.suffix}")
        scratch.write_text(text)  # next to its meshes
        try:
            spec = mujoco.MjSpec.from_file(str(scratch))
            self.joints = [joint.name for joint in spec.joints]
            for name in [] if spec.actuators else self.joints:
                drive = spec.add_actuator(name=name, target=name)
                drive.trntype, drive.gainprm[0] = mujoco.mjtTrn.mjTRN_JOINT, 1.0
            plant(spec, planted)
            self.model = m = spec.compile()
        finally:
            scratch.unlink()
        m.opt.timestep, m.opt.integrator = STEP_S, mujoco.mjtIntegrator.mjINT_RK4
        self.contact = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        m.opt.disableflags |= self.contact
        for body in range(1, m.nbody):
            factor = masses[body % len(masses)]
            if m.body(body).name != "planted_load":
                m.body_mass[body] *= factor
                m.body_inertia[body] *= factor
        self.data = mujoco.MjData(m)
        mujoco.mj_setConst(m, self.data)
        self.mujoco = mujoco
        found = [m.joint(name) for name in self.joints]
        self.q = np.array([int(joint.qposadr[0]) for joint in found])
        self.v = np.array([int(joint.dofadr[0]) for joint in found])
        at = {int(m.actuator_trnid[a, 0]): a for a in range(m.nu)}
        self.drives = np.array([at[joint.id] for joint in found])
        limited = [bool(m.jnt_limited[joint.id]) for joint in found]
        self.low = np.where(limited, [m.jnt_range[j.id, 0] for j in found], -math.pi)
        self.high = np.where(limited, [m.jnt_range[j.id, 1] for j in found], math.pi)
        limits = np.full(len(found), np.inf)
        for i, (joint, a) in enumerate(zip(found, self.drives, strict=True)):
            if m.actuator_ctrllimited[a]:
                limits[i] = m.actuator_ctrlrange[a, 1]
            if m.jnt_actfrclimited[joint.id]:
                limits[i] = min(limits[i], m.jnt_actfrcrange[joint.id, 1])
        self.limits = limits

    def mass_matrix(self, pose: Array) -> Array:
        """Inertia matrix of the joints in a pose, kg m2."""
        self.data.qpos[self.q] = pose
        self.mujoco.mj_forward(self.model, self.data)
        columns = np.zeros((len(self.v), self.model.nv))
        for column, unit in zip(columns, np.eye(self.model.nv)[self.v], strict=True):
            self.mujoco.mj_mulM(self.model, self.data, column, unit)
        return columns[:, self.v]

    def touching(self, pose: Array) -> set[tuple[int, int]]:
        """Pairs of geoms that touch in a pose."""
        m, d = self.model, self.data
        m.opt.disableflags &= ~self.contact
        d.qpos[self.q] = pose
        self.mujoco.mj_fwdPosition(m, d)
        m.opt.disableflags |= self.contact
        return {tuple(sorted(map(int, d.contact[i].geom))) for i in range(d.ncon)}

    def steered(self, q: Array, qd: Array, wanted: Array, rubbing: Array) -> Array:
        """Torques that lead the joints to an acceleration, within the limits of the motors.

        rubbing: friction that the controller makes up for, N m.
        """
        d, torque = self.data, np.zeros(self.model.nv)
        d.qpos[self.q], d.qvel[self.v] = q, qd
        self.mujoco.mj_forward(self.model, d)
        self.mujoco.mj_mulM(self.model, d, torque, wanted)
        torque += d.qfrc_bias - d.qfrc_passive
        return np.clip(torque[self.v] + rubbing, -self.limits, self.limits)


def ways(case: Case, pose: Array, swing: Array, seconds: float, seed: list[int]) -> Array:
    """Reference of every joint with its first two derivatives, (samples, 3, joints): sums of
    sines, or random steps through a filter of the second order."""
    random, n = np.random.default_rng(seed), len(pose)
    time = case.period_s * np.arange(round((SETTLE_S + seconds) / case.period_s))
    if case.sines:
        w = 2.0 * math.pi * random.uniform(0.2, 1.2, (n, 3))
        phase = random.uniform(0.0, 2.0 * math.pi, (n, 3))
        size = swing[:, None] / 3.0 * random.uniform(0.6, 1.0, (n, 3))
        turns = w * time[:, None, None] + phase
        parts = (size * np.sin(turns), size * w * np.cos(turns), -size * w**2 * np.sin(turns))
        found = np.stack([part.sum(axis=2) for part in parts], axis=1)
        found[:, 0] += pose
        return found
    found, w0 = np.zeros((len(time), 3, n)), 2.0 * math.pi * 1.2
    x, v, target, until = pose.copy(), np.zeros(n), pose.copy(), np.zeros(n)
    for k, t in enumerate(time):
        due = t >= until
        target = np.where(due, pose + swing * random.uniform(-1.0, 1.0, n), target)
        until = np.where(due, t + random.uniform(0.3, 1.2, n), until)
        a = w0**2 * (target - x) - 2.0 * w0 * v
        found[k] = x, v, a
        v = v + case.period_s * a
        x = x + case.period_s * v
    return found


def simulated(
    case: Case, truth: Robot, nominal: Robot, path: Array, delays: dict[str, float]
) -> dict[str, Array]:
    """Commands, angles, velocities and drive torques at every sample after the settling."""
    mujoco, m, d = truth.mujoco, truth.model, truth.data
    mujoco.mj_resetData(m, d)
    d.qpos[truth.q], d.qvel[truth.v] = path[0, 0], path[0, 1]
    every, n = round(case.period_s / STEP_S), len(truth.joints)
    late = np.array([round(delays.get(name, 0.0) / STEP_S) for name in truth.joints])
    rows: dict[str, list[Array]] = {"sent": [], "q": [], "qd": [], "torque": []}
    w = 2.0 * math.pi * STEERED_HZ
    cuts = sorted({0, every, *(int(k) % every for k in late)})
    for k, (way, rate, acceleration) in enumerate(path):
        q, qd = d.qpos[truth.q].copy(), d.qvel[truth.v].copy()
        pulled = acceleration + w * w * (way - q) + 2.0 * DAMPED * w * (rate - qd)
        rubbing = m.dof_frictionloss[truth.v] * np.tanh(rate / CREEP)
        sent = way if case.servo else nominal.steered(q, qd, pulled, rubbing)
        rows["sent"].append(sent)
        rows["q"].append(q)
        rows["qd"].append(qd)
        for begin, end in itertools.pairwise(cuts):
            held = np.maximum((k * every + begin - late) // every, 0)
            d.ctrl[truth.drives] = [rows["sent"][h][i] for i, h in enumerate(held)]
            mujoco.mj_step(m, d, end - begin)
        rows["torque"].append(d.qfrc_actuator[truth.v].copy())
        if not np.isfinite(d.qpos).all():
            break
    settled = round(SETTLE_S / case.period_s)
    return {key: np.array(values).reshape(-1, n)[settled:] for key, values in rows.items()}


def servo_text(text: str, nominal: Robot, pose: Array) -> str:
    """The model with a position servo in the place of every motor."""
    w, matrix = 2.0 * math.pi * SERVO_HZ, nominal.mass_matrix(pose)
    inertias = dict(zip(nominal.joints, matrix.diagonal(), strict=True))
    # a servo made for a rotor that the file lacks would be unstable at the step of the machine
    most = STEADY / STEP_S / np.linalg.inv(matrix).diagonal()
    dampings = dict(zip(nominal.joints, most, strict=True))
    strength = dict(zip(nominal.joints, nominal.limits, strict=True))

    def replaced(tag: re.Match[str]) -> str:
        joint = re.search(r'joint="([^"]*)"', tag[0])
        name = re.search(r'name="([^"]*)"', tag[0])
        if not (joint and name):  # of a <default>
            return tag[0]
        inertia = max(inertias[joint[1]], 1e-3)
        kv = min(2.0 * DAMPED * inertia * w, dampings[joint[1]])
        force = f'forcerange="{-strength[joint[1]]:g} {strength[joint[1]]:g}"'
        return (
            f'<position name="{name[1]}" joint="{joint[1]}" kp="{inertia * w * w:.6g}" '
            f'kv="{kv:.6g}" {force}/>'
        )

    return re.sub(r"<motor\b[^>]*/>", replaced, text)


def make_case(case: Case, file: Path, output: Path, seed: int) -> bool:
    """The logs of a case and its label; also the model file, if it is MJCF. False, with a message,
    where no pose of the robot is away from contact."""
    random = np.random.default_rng([seed, case.number, 11])
    stock = file.with_name(file.name.replace(f"-{case.number:03d}.xml", ".xml"))
    text = stock.read_text()
    bare = Robot(text, stock)
    often = permanent(bare, random)
    masses = random.uniform(1.0 - MASS_OFF, 1.0 + MASS_OFF, 64).tolist()
    for attempt in range(TRIES):
        pose, swing = drawn_pose(bare, random, often)
        model = servo_text(text, bare, pose) if case.servo else text
        nominal = Robot(model, stock)
        path = ways(case, pose, swing, case.seconds, [seed, case.number, attempt, 1])
        usual = simulated(case, Robot(model, stock, (), masses), nominal, path, {})
        if not is_free(bare, usual, often):
            continue
        planted = drawn_effects(case, bare, pose, usual["torque"].std(axis=0), random)
        delays = {p.joint: p.size for p in planted if p.kind == "delay"}
        truth = Robot(model, stock, planted, masses)
        logs = [simulated(case, truth, nominal, path, delays)]
        path = ways(case, pose, swing, 0.6 * case.seconds, [seed, case.number, attempt, 2])
        logs.append(simulated(case, truth, nominal, path, delays))
        if all(is_free(bare, log, often) for log in logs):
            break
    else:
        print(f"case {case.number}: no pose of {case.model} is away from contact", flush=True)
        return False
    if file != stock:
        file.write_text(without_contacts(model, bare, often))
    folder = output / "cases" / f"{case.number:03d}"
    folder.mkdir(parents=True, exist_ok=True)
    step = 2.0 * math.pi / 2 ** int(random.integers(13, 17))
    for name, log in zip(("rec", "held"), logs, strict=True):
        columns = {"time_s": case.period_s * np.arange(len(log["q"]))}
        for i, joint in enumerate(truth.joints):
            columns[command_column(case, truth, i, joint)] = log["sent"][:, i]
        for i, joint in enumerate(truth.joints):
            columns[with_unit(f"{word(joint)}_position", "rad")] = step * np.round(
                log["q"][:, i] / step
            )
        noise = 0.005 * log["qd"].std(axis=0) * random.standard_normal(log["qd"].shape)
        for i, joint in enumerate(truth.joints if case.velocities else []):
            columns[with_unit(f"{word(joint)}_velocity", "rad/s")] = log["qd"][:, i] + noise[:, i]
        rows = np.column_stack(list(columns.values()))
        np.savetxt(folder / f"{name}.csv", rows, "%.9g", ",", header=",".join(columns), comments="")
    label = {
        **asdict(case),
        "pose": pose.tolist(),
        "planted": [asdict(p) for p in planted],
        "effects": [
            {"kind": kind, "joints": truth.joints if at < 0 else [joint_of(bare, kind, at)]}
            for kind, at in case.effects
        ],
        "parameters": true_parameters(truth, planted),
        "drives": {
            j: truth.model.actuator(int(a)).name
            for j, a in zip(truth.joints, truth.drives, strict=True)
        },
    }
    (output / "labels").mkdir(exist_ok=True)
    (output / "labels" / f"{case.number:03d}.json").write_text(json.dumps(label, indent=1) + "\n")
    return True


def word(name: str) -> str:
    """A name as pamid writes it in columns."""
    return re.sub(r"\W", "_", name, flags=re.ASCII)


def command_column(case: Case, robot: Robot, i: int, joint: str) -> str:
    """The column of a joint's command."""
    if MODELS[case.model].endswith(".urdf"):
        return f"{word(joint)}_torque_nm"
    name = word(robot.model.actuator(int(robot.drives[i])).name)
    return with_unit(f"{name}_command", "rad" if case.servo else "")


def permanent(robot: Robot, random: np.random.Generator) -> set[tuple[int, int]]:
    """Pairs of geoms that touch in three of four random poses."""
    counts: dict[tuple[int, int], int] = {}
    for _ in range(60):
        for pair in robot.touching(random.uniform(robot.low, robot.high)):
            counts[pair] = counts.get(pair, 0) + 1
    return {pair for pair, count in counts.items() if count >= 45}


def without_contacts(text: str, robot: Robot, pairs: Iterable[tuple[int, int]]) -> str:
    """The model without contacts between the bodies of these pairs of geoms."""
    m = robot.model
    names = {tuple(m.body(int(m.geom_bodyid[g])).name for g in pair) for pair in pairs}
    excluded = "".join(
        f'<exclude body1="{first}" body2="{second}"/>' for first, second in sorted(names)
    )
    head, tail = text.rsplit("</mujoco>", 1)
    return f"{head}<contact>{excluded}</contact></mujoco>{tail}" if excluded else text


def drawn_pose(
    robot: Robot, random: np.random.Generator, often: set[tuple[int, int]]
) -> tuple[Array, Array]:
    """A pose away from contact with 0.3 rad or a tenth of the range to its ends, and the swing of
    every joint, rad."""
    margin = np.minimum(0.3, 0.1 * (robot.high - robot.low))
    low, high = (
        np.maximum(robot.low, -math.pi) + margin,
        np.minimum(robot.high, 2.0 * math.pi) - margin,
    )
    while True:
        pose = random.uniform(low, high)
        if robot.touching(pose) <= often:
            near = np.minimum(pose - robot.low, robot.high - pose)
            return pose, np.minimum(SWING_RAD, 0.8 * near)


def is_free(robot: Robot, log: dict[str, Array], often: set[tuple[int, int]]) -> bool:
    """Whether a log stays within the ranges, away from contact, and slower than a loose joint."""
    angles = log["q"]
    if not np.isfinite(angles).all() or len(angles) < 100 or np.abs(log["qd"]).max() > FASTEST:
        return False
    if (angles <= robot.low + 0.01).any() or (angles >= robot.high - 0.01).any():
        return False
    return all(robot.touching(q) <= often for q in angles[::10])


def joint_of(robot: Robot, kind: str, drawn: int) -> str:
    """The joint of an effect; a payload is at the last joint with a body of more than 50 g."""
    if kind != "payload":
        return robot.joints[drawn % len(robot.joints)]
    m = robot.model
    heavy = [j for j in robot.joints if m.body_mass[m.joint(j).bodyid[0]] > 0.05]
    return str(heavy[-1])


def drawn_effects(
    case: Case, robot: Robot, pose: Array, torques: Array, random: np.random.Generator
) -> tuple[Planted, ...]:
    """Sizes of what a case plants; torques: standard deviation at every joint as recorded."""
    inertias, m = robot.mass_matrix(pose).diagonal(), robot.model
    planted = []
    for kind, at in case.effects:
        if kind == "friction-all":
            shares = random.uniform(0.15, 0.4, len(robot.joints))
            planted += [
                Planted("frictionloss", j, float(share * t))
                for j, share, t in zip(robot.joints, shares, torques, strict=True)
            ]
            continue
        joint = joint_of(robot, kind, at)
        i = robot.joints.index(joint)
        if kind == "friction":
            planted.append(
                Planted("frictionloss", joint, float(random.uniform(0.15, 0.4) * torques[i]))
            )
        elif kind == "delay":
            planted.append(Planted("delay", joint, float(random.uniform(0.008, 0.025))))
        elif kind == "play":
            gap, motor = random.uniform(0.006, 0.02), random.uniform(0.3, 1.0) * inertias[i]
            planted.append(Planted("backlash", joint, gap, float(motor), random.uniform(0.3, 1.0)))
        elif kind == "armature":
            planted.append(
                Planted("armature", joint, float(random.uniform(0.4, 1.2) * inertias[i]))
            )
        elif kind == "payload":
            axis = np.asarray(m.jnt_axis[m.joint(joint).id])
            aside = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0])
            place = tuple(map(float, 0.06 * axis + 0.03 * aside))
            mass = random.uniform(0.03, 0.08) * float(m.body_mass.sum())
            planted.append(Planted("payload", joint, mass, place=place))
        else:
            low, high = ((0.6, 0.75), (1.35, 1.6))[int(random.integers(2))]
            planted.append(Planted("kp", joint, float(random.uniform(low, high))))
    return tuple(planted)


def true_parameters(truth: Robot, planted: Sequence[Planted]) -> dict[str, float]:
    """Value that a parameter has to take, by the beginning of its name."""
    m, found = truth.model, {}
    for p in planted:
        joint = m.joint(p.joint)
        if p.kind == "armature":
            found[f"{word(p.joint)}_armature"] = float(m.dof_armature[joint.dofadr[0]])
        elif p.kind == "payload":
            body = m.body(int(joint.bodyid[0]))
            found[f"{word(body.name)}_mass"] = float(body.mass[0]) + p.size
        elif p.kind == "kp":
            drive = m.actuator(int(truth.drives[truth.joints.index(p.joint)]))
            found[f"{word(drive.name)}_kp"] = float(drive.gainprm[0])
    return found


# ---- diagnosing ----------------------------------------------------------------------------------


def run_pamid(folder: Path, name: str, words: Sequence[str]) -> int:
    """Run a command of pamid in a folder; output and CPU seconds stand in NAME.txt and .cpu."""
    single = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with (folder / f"{name}.txt").open("w") as out, (folder / f"{name}.err").open("w") as err:
        process = subprocess.Popen(
            [str(PAMID), *words], cwd=folder, env={**os.environ, **single}, stdout=out, stderr=err
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    with (folder / f"{name}.cpu").open("a") as cost:  # a line for every part of an interrupted run
        cost.write(f"{usage.ru_utime + usage.ru_stime:.1f}\n")
    return process.returncode


def diagnose_case(case: Case, file: Path, folder: Path) -> None:
    """Diagnose and export; file: the model as its user has it."""
    rig = str(file.absolute())
    if not (folder / "run" / "diagnosis.json").exists():
        resumed = ["--resume"] if (folder / "run").exists() else []
        logs = ["rec.csv", "--held-out", "held.csv", "--rig", rig, "--output", "run", "--jobs", "1"]
        if run_pamid(folder, "diagnose", ["diagnose", *logs, *resumed]):
            return
    form = "urdf" if file.suffix == ".urdf" else "mjcf"
    written = file.with_name(f"written-{case.number:03d}{file.suffix}")
    words = ["export", "run", "--rig", rig, "--to", form, "--output", str(written)]
    run_pamid(folder, "export", [*words, "--anyway", "--overwrite", "--json"])


# ---- scoring -------------------------------------------------------------------------------------


def score(case: Case, output: Path) -> dict[str, Any] | None:
    """The row of a case; None where it is not made yet."""
    folder, label_at = (
        output / "cases" / f"{case.number:03d}",
        output / "labels" / f"{case.number:03d}.json",
    )
    if not label_at.exists():
        return None
    label = json.loads(label_at.read_text())
    at = folder / "run" / "diagnosis.json"
    row: dict[str, Any] = {
        "case": case.number,
        "model": case.model,
        "servo": case.servo,
        "kinds": [e["kind"] for e in label["effects"]],
        "sizes": {f"{p['kind']} {p['joint']}": p["size"] for p in label["planted"]},
        "cpu_s": cpu_seconds(folder / "diagnose.cpu"),
        "outcome": "failed",
    }
    if not at.exists():
        return row if (folder / "diagnose.txt").exists() else None
    found = json.loads(at.read_text())
    reached = {
        name: near(found["parameters"], name, true) for name, true in label["parameters"].items()
    }
    floors = [
        c["mae_with_cause"] / c["noise_floor"]
        for c in found["how_far"].values()
        if c["noise_floor"]
    ]
    return {
        **row,
        "outcome": outcome(found, label, all(reached.values())),
        "verdict": found["verdict"],
        "causes": [f"{c['effect']} ({c['port']})" for c in named(found)],
        "parameters": reached,
        "floors": max(floors, default=None),
        **written_errors(folder / "export.txt", row["kinds"]),
    }


def cpu_seconds(path: Path) -> float:
    return sum(map(float, path.read_text().split())) if path.exists() else 0.0


def named(found: dict[str, Any]) -> list[dict[str, Any]]:
    """Causes that the verdict names."""
    return found["causes"] if found["verdict"] in CAUSED else []


def near(parameters: dict[str, Any], name: str, true: float) -> bool:
    """Whether a parameter is within 20 % of its true value, or has it in its interval."""
    estimate = next((e for key, e in parameters.items() if key.startswith(name)), None)
    if estimate is None:
        return False
    inside = (estimate["low"] or true + 1.0) <= true <= (estimate["high"] or true - 1.0)
    return inside or abs(estimate["value"] / true - 1.0) <= NEAR


def outcome(found: dict[str, Any], label: dict[str, Any], parameters_right: bool) -> str:
    """One of OUTCOMES, as the table in the head of this file has it."""
    causes = named(found)
    effects = [e for e in label["effects"] if e["kind"] in FAMILIES]
    hits = [[c for c in causes if is_at(c, e, label["drives"])] for e in effects]
    members = {id(c) for several in hits for c in several}
    if found["verdict"] == "ambiguous":
        families = {c["family"] for c in causes}
        if not members:
            return "wrong" if causes else "open"
        whole = len(effects) == 1 and parameters_right and len(families) <= 2
        return "in a set" if whole else "open"
    if any(id(c) not in members for c in causes):
        return "wrong"
    refitted = [refitted_joints(found["parameters"], label, e) for e in effects]
    enough = [
        (several or joints)
        and (
            e["kind"] != "friction-all"
            or 2 * len(joints_of(several, e) | joints) >= len(e["joints"])
        )
        for e, several, joints in zip(effects, hits, refitted, strict=True)
    ]
    if all(enough) and parameters_right:
        exact = all(
            joints or any(c["family"] == FAMILIES[e["kind"]] for c in h)
            for e, h, joints in zip(effects, hits, refitted, strict=True)
        )
        return "right" if exact else "in a set"
    return (
        "lesser"
        if len(label["effects"]) > 1 and (any(enough) or (label["parameters"] and parameters_right))
        else "open"
    )


def refitted_joints(
    parameters: dict[str, Any], label: dict[str, Any], effect: dict[str, Any]
) -> set[str]:
    """Joints whose planted friction is in the refitted frictionloss of the file."""
    joints = set()
    for p in label["planted"]:
        name = f"{word(p['joint'])}_frictionloss"
        estimate = next((e for key, e in parameters.items() if key.startswith(name)), None)
        if p["kind"] == "frictionloss" and p["joint"] in effect["joints"] and estimate:
            true = estimate["prior"] + p["size"]
            before = abs(estimate["prior"] / true - 1.0) <= NEAR
            if near(parameters, name, true) and not before:
                joints.add(p["joint"])
    return joints


def joints_of(causes: Sequence[dict[str, Any]], effect: dict[str, Any]) -> set[str]:
    """Joints of a planted effect at which one of the causes acts."""
    return {
        j for j in effect["joints"] for c in causes if any(_at(part, word(j)) for part in _ports(c))
    }


def is_at(cause: dict[str, Any], effect: dict[str, Any], drives: dict[str, str]) -> bool:
    """Whether a cause is of a planted effect's family, or open between it and another, and at its
    joints only."""
    family = FAMILIES[effect["kind"]]
    if family != cause["family"] and family not in cause["instead"]:
        return False
    names = {word(j) for j in effect["joints"]} | {word(drives[j]) for j in effect["joints"]}
    return all(any(_at(part, name) for name in names) for part in _ports(cause))


def _ports(cause: dict[str, Any]) -> list[str]:
    return [part for part in re.split(r"[\s,+]+", cause["port"]) if part]


def _at(port: str, name: str) -> bool:
    """A port of a joint, its actuator or its sensors has the joint's name or begins with it."""
    return port == name or port.startswith(f"{name}_")


def written_errors(path: Path, kinds: Sequence[str]) -> dict[str, Any]:
    """Error of the written file over the stated one, in the worst channel: at the file's own step,
    and at the recommended one."""
    try:
        check = json.loads(path.read_text())["plain_mujoco"]
    except (OSError, ValueError, KeyError):
        return {}
    form = IN_FILE["urdf" if json.loads(path.read_text())["to"] == "urdf" else "mjcf"]
    channels = [c for c in check["channels"].values() if c["stated"]]
    return {
        "held": all(kind in form for kind in kinds),
        "ratio": max((c["now"] / c["stated"] for c in channels), default=None),
        "ratio_best": max((c["best"] / c["stated"] for c in channels), default=None),
    }


def table(rows: Sequence[dict[str, Any]]) -> Iterable[str]:
    """Shares by model, by what is planted and over all, as markdown."""
    yield f"| | cases | {' | '.join(OUTCOMES)} | failed | written file within 1.2 | CPU s, median |"
    yield "|---" * (len(OUTCOMES) + 5) + "|"
    for model in MODELS:
        yield from _line(model, [r for r in rows if r["model"] == model])
    for kind in KINDS:
        yield from _line(kind, [r for r in rows if r["kinds"] == [kind]])
        yield from _line(
            f"{kind} and another", [r for r in rows if kind in r["kinds"] and len(r["kinds"]) > 1]
        )
    yield from _line("one planted", [r for r in rows if len(r["kinds"]) == 1])
    yield from _line("two planted", [r for r in rows if len(r["kinds"]) == 2])
    yield from _line("all planted", [r for r in rows if r["kinds"]])
    yield from _line("nothing planted", [r for r in rows if not r["kinds"]])


def _line(name: str, rows: Sequence[dict[str, Any]]) -> Iterable[str]:
    if not rows:
        return
    counts = [str(sum(r["outcome"] == o for r in rows)) for o in (*OUTCOMES, "failed")]
    judged = [r for r in rows if r.get("held") and r.get("ratio") is not None]
    good = sum(min(r["ratio"], r["ratio_best"]) <= 1.2 for r in judged)
    cells = (name, str(len(rows)), *counts, f"{good} of {len(judged)}")
    yield f"| {' | '.join(cells)} | {np.median([r['cpu_s'] for r in rows]):.0f} |"


def line(row: dict[str, Any]) -> str:
    """A case in one line."""
    sizes = ", ".join(f"{name} {size:.3g}" for name, size in row["sizes"].items()) or "nothing"
    ratio = (
        "" if row.get("ratio") is None else f", file {row['ratio']:.2f} ({row['ratio_best']:.2f})"
    )
    return (
        f"{row['case']:3d} {row['model']}{' servo' if row['servo'] else ''}: {sizes} | "
        f"{row['outcome']}: {row.get('verdict')} {'; '.join(row.get('causes', []))} "
        f"{row.get('parameters') or ''}{ratio}, {row['cpu_s']:.0f} s"
    )


if __name__ == "__main__":
    sys.exit(main())
