"""Differences planted into MuJoCo models; made arms of one, two and seven joints, and their logs.

Lengths in m, angles in rad, torques in N m. The machine and the model of it that its user has
differ in their numbers, and in what is planted (`plant`):
    frictionloss  N m added to the frictionloss of a joint
    backlash      half a gap, rad: two joints about one axis, the motor with its inertia on the
                  first and a small range on the second (MuJoCo documentation, Modeling, "Backlash")
    delay         s by which the commands of a joint arrive late
    armature      kg m2 added to that of a joint
    payload       kg at a place of the joint's body
    kp            factor of the gain of a joint's position servo
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.simulation.excitation.aprbs import aprbs

KINDS = ("nothing", "frictionloss", "backlash", "delay", "armature", "payload")
GRAVITY = 9.81
PERIOD_S = 0.004  # of the log and of the commands
STEP_S = 0.0005  # of the truth, RK4
TORQUE_NOISE = 0.002  # of the torque limit, one standard deviation, new in every sample


@dataclass(frozen=True)
class Link:
    """A joint and the body that it moves. offset: of the joint in the frame of the link before;
    length: to the end of the link along `along`, its centre half way; inertia: (3,), about the
    centre; limit: torque of the actuator; kp, kv: of a position servo, 0 for a torque motor."""

    joint: str
    body: str
    axis: tuple[float, float, float]
    offset: tuple[float, float, float]
    along: tuple[float, float, float]
    length: float
    mass: float
    inertia: tuple[float, float, float]
    damping: float
    armature: float
    reach: float
    limit: float
    kp: float = 0.0
    kv: float = 0.0

    @property
    def about_joint(self) -> float:
        """Inertia of the body about its own joint, kg m2, where the axis is across the link."""
        return max(self.inertia) + self.mass * (0.5 * self.length) ** 2


@dataclass(frozen=True)
class Planted:
    """A difference of a machine from its model, at a joint.

    size     in the unit of its kind (see above)
    inertia  backlash: on the motor's side, kg m2, added to the armature
    ratio    backlash: damping ratio of the ends of the gap
    place    payload: in the frame of the joint's body, m
    """

    kind: str
    joint: str
    size: float
    inertia: float = 0.0
    ratio: float = 1.0
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)


def plant(spec: Any, planted: Sequence[Planted]) -> None:
    """Change a model (mjSpec) so that it has what is planted, apart from delays."""
    for p in planted:
        joint = spec.joint(p.joint)
        if p.kind == "frictionloss":
            joint.frictionloss += p.size
        elif p.kind == "armature":
            joint.armature += p.size
        elif p.kind == "payload":
            load = joint.parent.add_body(name="planted_load", pos=p.place, explicitinertial=True)
            load.mass, load.inertia = p.size, [1e-4 * p.size] * 3
            load.ipos, load.iquat = [0.0] * 3, [1.0, 0.0, 0.0, 0.0]
        elif p.kind == "kp":
            drive = next(a for a in spec.actuators if a.target == p.joint)
            drive.gainprm[0] *= p.size
            drive.biasprm[1] *= p.size
        elif p.kind == "backlash":
            joint.armature += p.inertia
            behind = joint.parent.add_joint(
                name=f"behind_{p.joint}", axis=joint.axis, pos=joint.pos, range=[-p.size, p.size]
            )
            behind.solref_limit = [0.02, p.ratio]


@dataclass(frozen=True)
class Machine:
    """An arm; velocities: whether they are recorded beside the positions."""

    links: tuple[Link, ...]
    velocities: bool


# ---- arms ----------------------------------------------------------------------------------------


def _rod(
    joint: str, body: str, offset: float, length: float, mass: float, armature: float, servo: bool
) -> Link:
    """A slender link that turns about y and hangs along -z; armature: share of its inertia."""
    across = mass * length**2 / 12.0
    inertia = mass * length**2 / 3.0
    holding = mass * GRAVITY * 0.5 * length
    link = Link(
        joint,
        body,
        (0.0, 1.0, 0.0),
        (0.0, 0.0, -offset),
        (0.0, 0.0, -1.0),
        length,
        mass,
        (across, across, 0.02 * across),
        0.15 * math.sqrt(inertia * holding),
        armature * inertia,
        2.6,
        1.2 * holding,
    )
    return _servo(link, inertia * (1.0 + armature)) if servo else link


def _servo(link: Link, inertia: float, hz: float = 3.0) -> Link:
    """With a position servo of so many Hz."""
    w = 2.0 * math.pi * hz
    return replace(link, kp=inertia * w * w, kv=1.2 * inertia * w, limit=2.5 * link.limit)


def arm(joints: int, random: np.random.Generator) -> Machine:
    """An arm of 1, 2 or 7 joints with drawn sizes."""
    servo = bool(random.random() < 0.5) or joints == 7
    if joints == 7:
        return Machine(_seven(random), bool(random.random() < 0.5))
    lengths, masses = random.uniform(0.25, 0.5, joints), random.uniform(0.6, 2.0, joints)
    names = (("shoulder", "upper"), ("elbow", "fore"))[:joints]
    links = [
        _rod(joint, body, before, length, mass, random.uniform(0.2, 0.5), servo)
        for (joint, body), before, length, mass in zip(
            names, (0.0, *lengths), lengths, masses, strict=False
        )
    ]
    if joints == 2:  # what the shoulder holds and swings includes the forearm
        first, last = links
        held = first.limit + 1.2 * last.mass * GRAVITY * (first.length + 0.5 * last.length)
        swung = first.about_joint + last.about_joint + last.mass * first.length**2
        first = replace(
            first, limit=held, damping=2.0 * first.damping, armature=0.3 * first.about_joint
        )
        links[0] = _servo(first, swung) if servo else first
    return Machine(tuple(links), bool(random.random() < 0.5))


def _seven(random: np.random.Generator) -> tuple[Link, ...]:
    """Seven joints about z and y in turn, upright, with the sizes of a collaborative robot."""
    lengths = (0.16, 0.17, 0.2, 0.2, 0.2, 0.1, 0.08)
    masses = np.array((3.0, 3.0, 2.6, 2.4, 1.6, 1.4, 0.6)) * random.uniform(0.85, 1.15, 7)
    found, before = [], 0.0
    for i, (length, mass) in enumerate(zip(lengths, masses, strict=True)):
        across = mass * (length**2 + 0.08**2) / 12.0
        beyond = float(np.sum(masses[i:] * (np.cumsum(lengths[i:]) - 0.5 * length) ** 2))
        swung = max(across, 0.6 * beyond if i % 2 else 0.15 * beyond)
        limit = 6.0 + 0.8 * GRAVITY * float(
            np.sum(masses[i:] * (np.cumsum(lengths[i:]) - 0.5 * length))
        )
        found.append(
            _servo(
                Link(
                    f"joint{i + 1}",
                    f"link{i + 1}",
                    (0.0, 1.0, 0.0) if i % 2 else (0.0, 0.0, 1.0),
                    (0.0, 0.0, before),
                    (0.05, 0.0, 1.0),  # a little aside: so gravity and swing reach every joint
                    length,
                    float(mass),
                    (across, across, 0.5 * across),
                    0.4 * swung,
                    0.25 * swung + 0.004,
                    2.4,
                    limit,
                ),
                1.2 * swung + 0.004,
                2.5,
            )
        )
        before = length
    return tuple(found)


# ---- text ----------------------------------------------------------------------------------------


def _numbers(values: Any) -> str:
    return " ".join(f"{v:.9g}" for v in np.atleast_1d(values))


def model_text(machine: Machine, step_s: float = 0.002) -> str:
    """MJCF of a machine."""
    lines = ['<mujoco model="arm">', '  <compiler angle="radian" autolimits="true"/>']
    lines.append(f'  <option timestep="{step_s:g}" integrator="RK4"/>')
    lines.append('  <default><geom contype="0" conaffinity="0"/></default>')
    lines.append("  <worldbody>")
    for link in machine.links:
        lines += _body(link)
    lines.append("</body>" * len(machine.links))
    lines += ["  </worldbody>", "  <actuator>"]
    for link in machine.links:
        name = f'name="{link.joint}_drive" joint="{link.joint}"'
        if link.kp:
            lines.append(
                f'    <position {name} kp="{link.kp:.9g}" kv="{link.kv:.9g}" '
                f'ctrlrange="{-link.reach:.9g} {link.reach:.9g}" '
                f'forcerange="{-link.limit:.9g} {link.limit:.9g}"/>'
            )
        else:
            lines.append(f'    <motor {name} gear="{link.limit:.9g}" ctrlrange="-1 1"/>')
    lines += ["  </actuator>", "  <sensor>"]
    for word in ("pos", "vel") if machine.velocities else ("pos",):
        for link in machine.links:
            lines.append(f'    <joint{word} name="{link.joint}_{word}" joint="{link.joint}"/>')
    lines += ["  </sensor>", "</mujoco>"]
    return "\n".join(lines) + "\n"


def _body(link: Link) -> list[str]:
    return [
        f'    <body name="{link.body}" pos="{_numbers(link.offset)}">',
        f'      <joint name="{link.joint}" axis="{_numbers(link.axis)}" '
        f'damping="{link.damping:.9g}" armature="{link.armature:.9g}" '
        f'range="{-link.reach:.9g} {link.reach:.9g}"/>',
        f'      <inertial pos="{_numbers(0.5 * link.length * np.array(link.along))}" '
        f'mass="{link.mass:.9g}" diaginertia="{_numbers(link.inertia)}"/>',
    ]


# ---- what is planted, and what the user's model says ---------------------------------------------


def draw_planted(kind: str, machine: Machine, random: np.random.Generator) -> tuple[Planted, ...]:
    """A difference of a kind at a drawn link; none for nothing.

    Friction is 4 to 10 % of a motor's torque limit, 1.6 to 4 % of a servo's, which is 2.5 times as
    high. The armature is 2.2 to 3.5 times the one that the model states."""
    if kind == "nothing":
        return ()
    link = machine.links[int(random.integers(len(machine.links)))]
    if kind == "frictionloss":
        share = random.uniform(0.04, 0.1) * (0.4 if link.kp else 1.0)
        return (Planted(kind, link.joint, float(link.limit * share)),)
    if kind == "backlash":
        gap, ratio = random.uniform(0.008, 0.03), random.uniform(0.3, 1.0)
        return (Planted(kind, link.joint, gap, ratio=ratio),)
    if kind == "delay":
        return (Planted(kind, link.joint, PERIOD_S * float(random.integers(3, 11))),)
    if kind == "armature":
        return (Planted(kind, link.joint, link.armature * random.uniform(1.2, 2.5)),)
    last = machine.links[-1]
    end = tuple(float(v) for v in last.length * np.array(last.along))
    return (Planted(kind, last.joint, float(last.mass * random.uniform(0.3, 0.6)), place=end),)


def misjudged(machine: Machine, random: np.random.Generator) -> Machine:
    """The same machine as its user's model has it: every mass 10 to 20 % off."""
    links = []
    for link in machine.links:
        factor = 1.0 + float(random.choice((-1.0, 1.0)) * random.uniform(0.1, 0.2))
        inertia = tuple(factor * v for v in link.inertia)
        links.append(replace(link, mass=factor * link.mass, inertia=inertia))
    return replace(machine, links=tuple(links))


# ---- recordings ----------------------------------------------------------------------------------


def commands(machine: Machine, seconds: float, amplitude: float, seed: int) -> Array:
    """Random steps on every command together, shape (samples, joints); amplitude: share of the
    torque limit of a motor; of a servo, a quarter of it is a share of its range."""
    columns = []
    for i, link in enumerate(machine.links):
        high = 0.25 * amplitude * link.reach if link.kp else amplitude
        rate = 6.0 * high if link.kp else None
        columns.append(
            aprbs(seconds, PERIOD_S, high, (0.25, 1.2), seed=100 * seed + i, rate_limit=rate)
        )
    return np.column_stack(columns)


def record(
    machine: Machine,
    planted: Sequence[Planted],
    seconds: float,
    seed: int,
    torque_noise: float = TORQUE_NOISE,
    pose: Array | None = None,
) -> tuple[dict[str, Array], float]:
    """A log's columns, and the amplitude at which every joint kept within its range (at most 95 %).
    pose: angles from which it starts at rest, and about which servos move; zero by default.

    Positions by an encoder of 2^13 to 2^15 steps per turn, velocities with noise of half a percent
    of their usual size."""
    import mujoco
    from mujoco import rollout

    random = np.random.default_rng(seed)
    spec = mujoco.MjSpec.from_string(model_text(machine, STEP_S))
    plant(spec, planted)
    model = spec.compile()
    own = [model.joint(link.joint) for link in machine.links]
    positions = np.array([int(j.qposadr[0]) for j in own])
    dofs = np.array([int(j.dofadr[0]) for j in own])
    delays = {p.joint: round(p.size / PERIOD_S) for p in planted if p.kind == "delay"}
    late = [delays.get(link.joint, 0) for link in machine.links]
    every, count = round(PERIOD_S / STEP_S), round(seconds / PERIOD_S)
    ripple = torque_noise * random.normal(size=(count, len(own)))
    driving = int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED)
    start = np.zeros(mujoco.mj_stateSize(model, int(mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    pose = np.zeros(len(own)) if pose is None else pose
    start[1 + positions] = pose
    about = pose * [link.kp > 0.0 for link in machine.links]
    amplitude = 0.8
    while True:
        sent = about + commands(machine, seconds, amplitude, seed)[:count]
        reached = np.array(sent)
        for i, samples in enumerate(late):
            reached[samples:, i] = sent[: len(sent) - samples, i]
            reached[:samples, i] = 0.0
        force = np.zeros((count, model.nv))
        force[:, dofs] = ripple * [link.limit for link in machine.links]
        driven = np.repeat(np.hstack([reached, force]), every, axis=0)
        states, _ = rollout.rollout(
            model, mujoco.MjData(model), start, driven, control_spec=driving, persistent_pool=False
        )
        sampled = np.vstack([start, states[0][every - 1 : -1 : every]])[:count]
        q, qd = sampled[:, 1 + positions], sampled[:, 1 + model.nq + dofs]
        reach = np.array([link.reach for link in machine.links])
        if np.isfinite(q).all() and (np.abs(q) < 0.95 * reach).all():
            break
        amplitude *= 0.8
    step = 2.0 * math.pi / 2 ** random.integers(13, 16)
    columns = {"time_s": PERIOD_S * np.arange(count)}
    unit = "_rad" if machine.links[0].kp else ""
    for i, link in enumerate(machine.links):
        columns[f"{link.joint}_drive_command{unit}"] = sent[:, i]
    for i, link in enumerate(machine.links):
        columns[f"{link.joint}_pos_rad"] = step * np.round(q[:, i] / step)
    if machine.velocities:
        noise = 0.005 * np.std(qd, axis=0) * random.normal(size=qd.shape)
        for i, link in enumerate(machine.links):
            columns[f"{link.joint}_vel_rad_per_s"] = qd[:, i] + noise[:, i]
    return columns, amplitude
