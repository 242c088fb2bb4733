"""An excitation kept within what a model allows: MuJoCo runs it on the model of the data sheet, and
what reaches a joint's range, exceeds a speed or a force, or makes bodies touch is moved or made
smaller, command by command.

Bodies may touch as they do at the start, and the surroundings as they do with nothing sent (a robot
that stands on a floor). Forces are looked at without their limits: within these, no actuator is
ever asked for more than it has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import DataError, UsageError, nearest
from pamid.simulators.mechanism import Actuator, Mechanism
from pamid.simulators.mujoco_file import MujocoFile, open_mujoco
from pamid.simulators.xml_text import tags_of

Array = NDArray[np.float64]

SMALLER = 0.8  # an amplitude from one run to the next
LEAST = 0.02  # of what was asked for: less excites nothing
BESIDE = 0.3  # of the largest factor: commands this small are no longer the ones to blame alone
REST_S = 10.0  # of the run in which nothing is sent
WILD = 1e6  # rad, m or their rates: a run beyond is unstable
TOUCHING = 1e-6  # rad or m: an end that is met by rounding is not left
MARGIN = 0.02  # of a joint's range, kept free at either end when a signal is moved


@dataclass(frozen=True)
class KeptCommand:
    """What became of one command: sent = shift + factor * what was asked for, about its centre;
    why: what was in the way, in the order in which it was met."""

    column: str
    factor: float = 1.0
    shift: float = 0.0
    why: tuple[str, ...] = ()

    @property
    def changed(self) -> bool:
        return self.factor != 1.0 or self.shift != 0.0


@dataclass(frozen=True, eq=False)
class SafeExcitation:
    """columns (samples,) in their own units; kept: every command; limits: what was looked at, in
    words; reached: joint -> lowest and highest position of the run, rad or m."""

    columns: dict[str, Array]
    kept: tuple[KeptCommand, ...]
    limits: tuple[str, ...]
    reached: dict[str, tuple[float, float]]

    def sentences(self) -> list[str]:
        """What was done, and what the run then reaches."""
        said = [f"Run on the model: {'; '.join(self.limits)}."]
        for one in self.kept:
            if one.changed:
                moved = f"its centre moved by {one.shift:.4g}" if one.shift else ""
                scaled = f"made smaller, {one.factor:.3g} times" if one.factor != 1.0 else ""
                done = " and ".join(part for part in (moved, scaled) if part)
                said.append(f"{one.column}: {done}, because {'; '.join(one.why)}.")
        if not any(one.changed for one in self.kept):
            said.append("It stays within all of them as it is.")
        reach = ", ".join(
            f"{name} {low:.3g} .. {high:.3g}" for name, (low, high) in self.reached.items()
        )
        return [*said, f"Reached in that run: {reach}."]


@dataclass(frozen=True)
class _Trouble:
    """What a run met: in words, which actuators may be the cause, the joint whose range it is."""

    text: str
    guilty: tuple[int, ...]
    joint: int = -1


@dataclass
class _Course:
    """How one command is changed so far: sent = centre + shift + factor * (asked - centre). rest:
    samples before it sets out, which stay as they are unless the whole is moved."""

    asked: Array
    centre: float
    factor: float = 1.0
    shift: float = 0.0
    balance: float = 0.0
    why: list[str] = field(default_factory=list)

    @property
    def rest(self) -> int:
        return int(np.argmax(self.asked != self.asked[0]))

    @property
    def half(self) -> float:
        """The largest deviation from the centre that is asked for."""
        return float(np.abs(self.asked[self.rest :] + self.balance - self.centre).max())

    def sent(self) -> Array:
        if not self.changed:
            return self.asked
        moved = self.centre + self.shift + self.factor * (self.asked + self.balance - self.centre)
        if not self.shift:
            moved[: self.rest] = self.asked[0]
        return moved

    @property
    def changed(self) -> bool:
        return self.factor != 1.0 or bool(self.shift) or bool(self.balance)


def safe_excitation(
    mechanism: Mechanism,
    columns: Mapping[str, Array],
    period_s: float,
    centres: Mapping[str, float] | None = None,
    speeds: Mapping[str, float] | None = None,
) -> SafeExcitation:
    """The excitation within the limits of the model. columns: in their units, every period_s;
    centres: what they swing about where that is not 0; speeds: further limits, joint -> rad/s or
    m/s.

    UsageError for a joint that is not there; DataError (code "no-room") where nothing is left.
    """
    bench = _Bench(mechanism, period_s, dict(speeds or {}))
    courses = {
        i: _Course(np.asarray(columns[a.column], float), (centres or {}).get(a.column, 0.0))
        for i, a in enumerate(mechanism.actuators)
        if a.column in columns
    }
    if not courses:
        raise UsageError(
            f"None of {', '.join(columns)} is a command of {mechanism.path}.",
            nearest(next(iter(columns)), list(mechanism.inputs)),
        )
    for i, course in courses.items():
        _within_range(mechanism.actuators[i], course)
        _within_joint(mechanism, mechanism.actuators[i], course)
    bench.rest({i: course.sent()[:1] for i, course in courses.items()})
    moved: set[int] = set()
    while True:
        trouble, reached = bench.run({i: course.sent() for i, course in courses.items()})
        if trouble is None:
            break
        if trouble.joint >= 0 and trouble.joint not in moved:
            moved.add(trouble.joint)
            if _recentred(mechanism, courses, trouble):
                continue
        _shrink(mechanism, courses, trouble)
    kept = [
        KeptCommand(
            mechanism.actuators[i].column,
            c.factor,
            c.shift + c.factor * c.balance,
            tuple(dict.fromkeys(c.why)),
        )
        for i, c in courses.items()
    ]
    made = {mechanism.actuators[i].column: c.sent() for i, c in courses.items()}
    return SafeExcitation({**columns, **made}, tuple(kept), bench.limits(), reached)


# ---- what is changed -----------------------------------------------------------------------------


def _fit(course: _Course, low: float, high: float, why: str) -> None:
    """Move a signal as little as needed to lie within low .. high, smaller where it must be."""
    half = course.factor * course.half
    now = course.centre + course.shift
    if now - half >= low - 1e-9 and now + half <= high + 1e-9:
        return
    if 2.0 * half > high - low:
        course.factor *= (high - low) / (2.0 * half)
        half = 0.5 * (high - low)
    course.shift += min(max(now, low + half), high - half) - now
    course.why.append(why)


def _within_range(a: Actuator, course: _Course) -> None:
    if a.command_range is not None:
        low, high = a.command_range
        _fit(course, low, high, f"{a.column} lies within {low:.4g} .. {high:.4g}")


def _place_range(m: Mechanism, a: Actuator) -> tuple[float, float] | None:
    """What a position drive may be told, by the range of its joint; None where it says nothing."""
    joint = m.joints[a.joint] if a.joint >= 0 else None
    if a.kind != "position" or joint is None or joint.range is None or not a.gear:
        return None
    free = MARGIN * (joint.range[1] - joint.range[0])
    ends = sorted((a.gear * (joint.range[0] + free), a.gear * (joint.range[1] - free)))
    if a.command_range is not None:
        ends = [max(ends[0], a.command_range[0]), min(ends[1], a.command_range[1])]
    return (ends[0], ends[1]) if ends[1] > ends[0] else None


def _within_joint(m: Mechanism, a: Actuator, course: _Course) -> None:
    allowed = _place_range(m, a)
    if allowed is not None:
        low, high = m.joints[a.joint].range or (0.0, 0.0)
        _fit(
            course, *allowed, f"joint {m.joints[a.joint].name} lies within {low:.4g} .. {high:.4g}"
        )


def _recentred(m: Mechanism, courses: Mapping[int, _Course], trouble: _Trouble) -> bool:
    """Move the signals at a joint whose end was reached: a position to the middle of the range, a
    push so that it pushes as much either way. Was there anything to move?"""
    done = False
    for i in trouble.guilty:
        a, course = m.actuators[i], courses[i]
        allowed = _place_range(m, a) if a.joint == trouble.joint else None
        before = course.shift, course.balance
        if allowed is not None:
            course.shift += 0.5 * (allowed[0] + allowed[1]) - course.centre - course.shift
        elif a.kind == "motor":
            course.balance = course.centre - float(np.mean(course.asked[course.rest :]))
            _within_range(a, course)
        moved = abs(course.shift - before[0]) + abs(course.balance - before[1])
        if moved > 1e-3 * course.half:
            course.why.append(trouble.text)
            done = True
    return done


def _shrink(m: Mechanism, courses: Mapping[int, _Course], trouble: _Trouble) -> None:
    """Make the guilty commands smaller, all of them where the guilty are small already."""
    guilty = [i for i in trouble.guilty if i in courses] or list(courses)
    largest = max(course.factor for course in courses.values())
    if all(courses[i].factor < BESIDE * largest for i in guilty):
        guilty = list(courses)
    for i in guilty:
        courses[i].factor *= SMALLER
        courses[i].why.append(trouble.text)
    if all(courses[i].factor < LEAST for i in guilty):
        names = ", ".join(m.actuators[i].column for i in guilty)
        raise DataError(
            f"{m.path}: nothing is left of {names}: even {LEAST:.0%} of the signal is too much, "
            f"{trouble.text}.",
            "Shorter --hold or --duration let a joint drift less; an --offset can hold it against "
            "gravity; a joint that has to be held is better sent positions than torques.",
            code="no-room",
        )


# ---- the run -------------------------------------------------------------------------------------


class _Bench:
    """MuJoCo with the model of the data sheet, and everything that it is watched for."""

    def __init__(self, m: Mechanism, period_s: float, speeds: dict[str, float]) -> None:
        file = open_mujoco(m.path)
        self.file, self.m, self.mujoco = file, m, file.mujoco
        self.model = file.model
        self.count = max(1, int(np.ceil(period_s / m.timestep_s - 1e-9)))
        self.period_s = period_s
        self.model.opt.timestep = period_s / self.count
        self.model.opt.disableflags |= int(self.mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self.forces = [i for i, a in enumerate(m.actuators) if a.adr >= 0 and a.force_range]
        self.force_ends = np.array([m.actuators[i].force_range for i in self.forces]).reshape(-1, 2)
        self.efforts = [j for j, joint in enumerate(m.joints) if joint.force_range]
        self.effort_ends = np.array([m.joints[j].force_range for j in self.efforts]).reshape(-1, 2)
        self.model.actuator_forcelimited[:] = 0
        self.model.jnt_actfrclimited[:] = 0
        self.ranged = [j for j, joint in enumerate(m.joints) if joint.range is not None]
        self.ends = np.array([m.joints[j].range for j in self.ranged]).reshape(-1, 2)
        names = [joint.name for joint in m.joints]
        speeds = {**_stated_speeds(file, names), **speeds}
        for name, speed in speeds.items():
            if name not in names:
                raise UsageError(
                    f"--speed-limit {name}: there is no such joint.",
                    nearest(name, names) or f"Joints: {', '.join(names)}.",
                )
            if not speed > 0.0:
                raise UsageError(f"--speed-limit {name}={speed:g}: it must be above 0.")
        self.fast = [j for j, name in enumerate(names) if name in speeds]
        self.speeds = np.array([speeds[names[j]] for j in self.fast])
        self.usual: set[tuple[int, int]] = set()

    def limits(self) -> tuple[str, ...]:
        """What was looked at, in words."""
        said = []
        for what, found in (
            ("range", [self.m.joints[j].name for j in self.ranged]),
            ("speed", [self.m.joints[j].name for j in self.fast]),
            ("force", [self.m.actuators[i].name for i in self.forces]),
            ("force", [self.m.joints[j].name for j in self.efforts]),
        ):
            if found:
                said.append(f"{what} of {', '.join(found)}")
        return (*said, "bodies that touch")

    def _require_start(self) -> None:
        """DataError where the model stands outside its own ranges."""
        for joint in (self.m.joints[j] for j in self.ranged):
            low, high = joint.range or (0.0, 0.0)
            if not low - TOUCHING <= joint.reference <= high + TOUCHING:
                raise DataError(
                    f"{self.m.path}: joint {joint.name} stands at {joint.reference:.4g} at the "
                    f"start, outside its range {low:.4g} .. {high:.4g}.",
                    "Give it a reference within (ref), or send the signal as it is with "
                    "--no-limits.",
                    code="no-room",
                )

    def rest(self, first: Mapping[int, Array]) -> None:
        """Learn which bodies touch at the start, and which touch the surroundings with no more sent
        than at first."""
        self._require_start()
        data = self._begin()
        self.usual = {pair for pair, _ in self._pairs(data)}
        length = round(REST_S / self.period_s)
        resting = {i: np.full(length, values[0]) for i, values in first.items()}
        self.run(resting, learn=True)

    def run(
        self, sent: Mapping[int, Array], *, learn: bool = False
    ) -> tuple[_Trouble | None, dict[str, tuple[float, float]]]:
        """The first trouble of a run, None where there is none, and how far the joints went."""
        data, m = self._begin(), self.m
        own = [i for i in sent if m.actuators[i].adr >= 0]
        bare = [i for i in sent if m.actuators[i].adr < 0]
        controls = np.array([sent[i] for i in own]).reshape(len(own), -1)
        torques = np.array([sent[i] for i in bare]).reshape(len(bare), -1)
        places = [m.actuators[i].adr for i in own]
        dofs = [m.joints[m.actuators[i].joint].dof for i in bare]
        qpos = [joint.qpos for joint in m.joints]
        low, high = data.qpos[qpos].copy(), data.qpos[qpos].copy()
        self.mujoco.set_mju_user_warning(lambda _: None)
        try:
            for k in range(max(controls.shape[1] * bool(own), torques.shape[1] * bool(bare))):
                data.ctrl[places] = controls[:, k] if own else []
                data.qfrc_applied[dofs] = torques[:, k] if bare else []
                self.mujoco.mj_step(self.model, data, self.count)
                q = data.qpos[qpos]
                np.minimum(low, q, out=low)
                np.maximum(high, q, out=high)
                trouble = self._trouble(data, k, learn)
                if trouble is not None and not learn:
                    return trouble, {}
                if learn and not np.isfinite(q).all():
                    break
        finally:
            self.mujoco.set_mju_user_warning(None)
        names = (joint.name for joint in m.joints)
        return None, {n: (float(a), float(b)) for n, a, b in zip(names, low, high, strict=True)}

    def _begin(self) -> Any:
        data = self.mujoco.MjData(self.model)
        self.mujoco.mj_forward(self.model, data)
        return data

    def _trouble(self, data: Any, sample: int, learn: bool) -> _Trouble | None:
        """What is wrong at this sample. learn: touching the surroundings is noted instead."""
        m, at = self.m, f"at {sample * self.period_s:.4g} s"
        everything = tuple(range(len(m.actuators)))
        wild = np.abs(data.qpos).max(initial=0.0), np.abs(data.qvel).max(initial=0.0)
        if not max(wild) < WILD:
            return _Trouble(f"the run became unstable {at}", everything)
        if data.ncon:
            for pair, (one, other) in self._pairs(data):
                if learn and self._is_fixed(pair):
                    self.usual.add(pair)
                elif pair not in self.usual:
                    guilty = self._movers(pair)
                    return _Trouble(f"{one} would touch {other} {at}", guilty)
        q = data.qpos[[m.joints[j].qpos for j in self.ranged]]
        for k in np.flatnonzero(
            (q < self.ends[:, 0] - TOUCHING) | (q > self.ends[:, 1] + TOUCHING)
        )[:1]:
            j = self.ranged[int(k)]
            low, high = self.ends[k]
            said = f"joint {m.joints[j].name} would leave {low:.4g} .. {high:.4g} {at}"
            return _Trouble(said, self._drivers(j), j)
        v = np.abs(data.qvel[[m.joints[j].dof for j in self.fast]])
        for k in np.flatnonzero(v > self.speeds)[:1]:
            j = self.fast[int(k)]
            unit = f"{m.joints[j].unit}/s"
            said = f"joint {m.joints[j].name} would exceed {self.speeds[k]:.4g} {unit} {at}"
            return _Trouble(said, self._drivers(j))
        return self._overload(data, at)

    def _overload(self, data: Any, at: str) -> _Trouble | None:
        m = self.m
        f = data.actuator_force[[m.actuators[i].adr for i in self.forces]]
        for k in np.flatnonzero((f < self.force_ends[:, 0]) | (f > self.force_ends[:, 1]))[:1]:
            i = self.forces[int(k)]
            low, high = self.force_ends[k]
            said = (
                f"{m.actuators[i].name} would have to exert {f[k]:.4g} of {low:.4g} .. {high:.4g}"
            )
            return _Trouble(f"{said} {at}", (i,))
        f = data.qfrc_actuator[[m.joints[j].dof for j in self.efforts]]
        for k in np.flatnonzero((f < self.effort_ends[:, 0]) | (f > self.effort_ends[:, 1]))[:1]:
            j = self.efforts[int(k)]
            low, high = self.effort_ends[k]
            said = f"joint {m.joints[j].name} would be sent {f[k]:.4g} of {low:.4g} .. {high:.4g}"
            return _Trouble(f"{said} {m.joints[j].force_unit} {at}", self._drivers(j))
        return None

    # ---- who touches whom ------------------------------------------------------------------------

    def _pairs(self, data: Any) -> list[tuple[tuple[int, int], tuple[str, str]]]:
        """Pairs of geoms in contact, with their names."""
        found = []
        for c in range(data.ncon):
            contact = data.contact[c]
            one, other = sorted(int(g) for g in contact.geom)
            if one >= 0 and contact.exclude == 0 and contact.dist <= 0.0:
                found.append(((one, other), (self._named(one), self._named(other))))
        return found

    def _named(self, geom: int) -> str:
        own = self.mujoco.mj_id2name(self.model, self.mujoco.mjtObj.mjOBJ_GEOM, geom)
        body = self.m.bodies[int(self.model.geom_bodyid[geom])].name
        return str(own) if own else f"a geom of {body}"

    def _is_fixed(self, pair: tuple[int, int]) -> bool:
        """Is one of the two a part of the surroundings?"""
        return any(self.model.body_weldid[self.model.geom_bodyid[g]] == 0 for g in pair)

    def _chain(self, body: int) -> list[int]:
        """A body and those that carry it, without the world."""
        found = []
        while body > 0:
            found.append(body)
            body = self.m.bodies[body].parent
        return found

    def _movers(self, pair: tuple[int, int]) -> tuple[int, ...]:
        """The actuators of the joints between two geoms."""
        one, other = (set(self._chain(int(self.model.geom_bodyid[g]))) for g in pair)
        between = one ^ other
        joints = [j for j, joint in enumerate(self.m.joints) if joint.body in between]
        drivers = {i for j in joints for i in self._drivers(j)}
        return tuple(sorted(drivers)) or tuple(range(len(self.m.actuators)))

    def _drivers(self, joint: int) -> tuple[int, ...]:
        """The actuators of a joint, all where it has none of its own."""
        m = self.m
        found = [
            i
            for i, a in enumerate(m.actuators)
            if a.joint == joint or (a.tendon >= 0 and joint in m.tendons[a.tendon].joints)
        ]
        return tuple(found or range(len(m.actuators)))


def _stated_speeds(file: MujocoFile, joints: Sequence[str]) -> dict[str, float]:
    """What a URDF says of its joints' speeds, which MuJoCo does not read; MJCF says nothing of
    them."""
    if file.path.suffix.lower() != ".urdf":
        return {}
    tags = tags_of(file.path.read_bytes())
    own = {file.name("joint", i): name for i, name in enumerate(joints)}
    found = {}
    for tag in tags:
        if tag.name != "limit" or tag.parent < 0 or "velocity" not in tag.attributes:
            continue
        name = tags[tag.parent].attributes.get("name", "")
        try:
            speed = float(tag.attributes["velocity"])
        except ValueError:
            continue
        if name in own and speed > 0.0:  # 0 is written by tools for "not known"
            found[own[name]] = speed
    return found
