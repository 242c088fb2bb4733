"""Run of an excitation by MuJoCo, on the model of the data sheet, with a check of every limit.

The limits are the ranges of joints, speeds and forces. Bodies must not touch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import DataError, UsageError, nearest
from pamid.rigs.simulators.mechanism import Mechanism
from pamid.rigs.simulators.mujoco_file import MujocoFile, open_mujoco
from pamid.rigs.simulators.xml_text import tags_of

REST_S = 10.0  # length of the run with constant commands
WILD = 1e6  # rad, m or their rates: a run beyond is unstable
STANDING = 1e-3  # rad or m from an end of its range: the joint is at this end
ROUNDED = 1e-6  # rad or m: a smaller overshoot is rounding


@dataclass(frozen=True)
class LimitViolation:
    """Violation of a limit in a run.

    It has a text, the time (s), the actuators that may be the cause, and the joint whose range it
    is.
    """

    text: str
    at_s: float
    guilty: tuple[int, ...]
    joint: int = -1


class ExcitationBench:
    """MuJoCo with the model of the data sheet and the limits."""

    def __init__(self, m: Mechanism, period_s: float, speeds: dict[str, float]) -> None:
        file = open_mujoco(m.path)
        self.file, self.m, self.mujoco = file, m, file.mujoco
        self.model = file.model
        self.count = max(1, int(np.ceil(period_s / m.timestep_s - 1e-9)))
        self.period_s = period_s
        self.model.opt.timestep = period_s / self.count
        self.model.opt.disableflags |= int(self.mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self.forces = [i for i, a in enumerate(m.actuators) if not a.is_bare and a.force_range]
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
                    f"--speed-limit {name}: the model has no such joint.",
                    nearest(name, names) or f"Joints: {', '.join(names)}.",
                )
            if not speed > 0.0:
                raise UsageError(f"--speed-limit {name}={speed:g}: it must be above 0.")
        self.fast = [j for j, name in enumerate(names) if name in speeds]
        self.speeds = np.array([speeds[names[j]] for j in self.fast])
        self.usual: set[tuple[int, int]] = set()
        self.falls: dict[int, LimitViolation] = {}
        # a joint that starts at an end of its range rests on a stop on purpose
        for k, j in enumerate(self.ranged):
            away = np.abs(self.ends[k] - m.joints[j].reference)
            self.ends[k] = np.where(away < STANDING, [-np.inf, np.inf], self.ends[k])

    def limits(self) -> tuple[str, ...]:
        """Limits that were checked, as text."""
        joints = [joint.name for joint in self.m.joints]
        actuators = [self.m.actuators[i].name for i in self.forces]
        sentences = [
            f"{what} of {', '.join(names)}"
            for what, names in (
                ("range", [joints[j] for j in self.ranged]),
                ("speed", [joints[j] for j in self.fast]),
                ("force", actuators),
                ("force", [joints[j] for j in self.efforts]),
            )
            if names
        ]
        open_ends = ~np.isfinite(self.ends).all(axis=1)
        stops = [joints[j] for j, is_open in zip(self.ranged, open_ends, strict=True) if is_open]
        if stops:
            sentences.append(f"except the end of the range at which {', '.join(stops)} starts")
        return (*sentences, "bodies that touch")

    def require_held(self, trouble: LimitViolation) -> None:
        """Raise DataError if a joint moves to its end by itself.

        No smaller signal could hold it.
        """
        alone = self.falls.get(trouble.joint)
        if alone is not None:
            raise DataError(
                f"{self.m.path}: even with a command of zero, {alone.text}, at {alone.at_s:.4g} s. "
                "A smaller signal cannot prevent this.",
                "Hold the joint with a suitable --offset, or with a position actuator; or send the "
                "signal without limits (--no-limits).",
                code="no-room",
            )

    def rest(self, first: Mapping[int, Array]) -> None:
        """Note contacts at the start, and those with the surroundings under the first command.

        DataError if the model starts outside its ranges.
        """
        for joint in (self.m.joints[j] for j in self.ranged):
            low, high = joint.range or (0.0, 0.0)
            if not low - ROUNDED <= joint.reference <= high + ROUNDED:
                raise DataError(
                    f"{self.m.path}: joint {joint.name} starts at {joint.reference:.4g}, outside "
                    f"its range {low:.4g} .. {high:.4g}.",
                    "Give the joint a reference (ref) within the range, or use the signal "
                    "without limits (--no-limits).",
                    code="no-room",
                )
        data = self._begin()
        self.usual = {pair for pair, _ in self._pairs(data)}
        length = round(REST_S / self.period_s)
        resting = {i: np.full(length, values[0]) for i, values in first.items()}
        self.run(resting, learn=True)

    def run(
        self, sent: Mapping[int, Array], *, learn: bool = False
    ) -> tuple[LimitViolation | None, dict[str, tuple[float, float]]]:
        """Return the first violation of a run, None without a violation, and the range of the
        joints' positions."""
        data, m = self._begin(), self.m
        driven = [i for i in sent if m.actuators[i].adr >= 0]
        bare = [i for i in sent if m.actuators[i].adr < 0]
        samples = len(next(iter(sent.values())))
        controls = np.array([sent[i] for i in driven]).reshape(len(driven), samples)
        torques = np.array([sent[i] for i in bare]).reshape(len(bare), samples)
        places = [m.actuators[i].adr for i in driven]
        dofs = [m.joints[m.actuators[i].joint].dof for i in bare]
        qpos = [joint.qpos for joint in m.joints]
        low, high = data.qpos[qpos].copy(), data.qpos[qpos].copy()
        for k in range(samples):
            data.ctrl[places] = controls[:, k] if driven else []
            data.qfrc_applied[dofs] = torques[:, k] if bare else []
            self.mujoco.mj_step(self.model, data, self.count)
            q = data.qpos[qpos]
            np.minimum(low, q, out=low)
            np.maximum(high, q, out=high)
            trouble = self._trouble(data, k, learn)
            if trouble is not None and not learn:
                return trouble, {}
            if trouble is not None and trouble.joint >= 0:
                self.falls.setdefault(trouble.joint, trouble)
            if learn and not np.isfinite(q).all():
                break
        names = (joint.name for joint in m.joints)
        return None, {n: (float(a), float(b)) for n, a, b in zip(names, low, high, strict=True)}

    def _begin(self) -> Any:
        data = self.mujoco.MjData(self.model)
        self.mujoco.mj_forward(self.model, data)
        return data

    def _trouble(self, data: Any, sample: int, learn: bool) -> LimitViolation | None:
        """Violation at this sample. learn: note contacts with the surroundings instead."""
        m, at = self.m, sample * self.period_s
        everything = m.commanded
        wild = np.abs(data.qpos).max(initial=0.0), np.abs(data.qvel).max(initial=0.0)
        if not max(wild) < WILD:
            return LimitViolation("the run becomes unstable", at, everything)
        if data.ncon:
            for pair, (name, other) in self._pairs(data):
                bodies = [int(self.model.geom_bodyid[geom]) for geom in pair]
                if learn and any(self.model.body_weldid[body] == 0 for body in bodies):
                    self.usual.add(pair)
                elif pair not in self.usual:
                    first, second = (set(m.chain(body)) for body in bodies)
                    drivers = {i for j in first ^ second for i in self._drivers(j)}
                    guilty = tuple(sorted(drivers)) or everything
                    return LimitViolation(f"{name} would touch {other}", at, guilty)
        q = data.qpos[[m.joints[j].qpos for j in self.ranged]]
        beyond = (q < self.ends[:, 0] - ROUNDED) | (q > self.ends[:, 1] + ROUNDED)
        for k in np.flatnonzero(beyond)[:1]:
            j = self.ranged[int(k)]
            low, high = m.joints[j].range or (0.0, 0.0)
            message = f"joint {m.joints[j].name} would leave {low:.4g} .. {high:.4g}"
            return LimitViolation(message, at, self._drivers(j), j)
        v = np.abs(data.qvel[[m.joints[j].dof for j in self.fast]])
        for k in np.flatnonzero(v > self.speeds)[:1]:
            j = self.fast[int(k)]
            unit = f"{m.joints[j].unit}/s"
            message = f"joint {m.joints[j].name} would exceed {self.speeds[k]:.4g} {unit}"
            return LimitViolation(message, at, self._drivers(j))
        return self._overload(data, at)

    def _overload(self, data: Any, at: float) -> LimitViolation | None:
        m = self.m
        f = data.actuator_force[self.forces]
        for k in np.flatnonzero((f < self.force_ends[:, 0]) | (f > self.force_ends[:, 1]))[:1]:
            i = self.forces[int(k)]
            low, high = self.force_ends[k]
            message = f"{m.actuators[i].name} would have to exert more than {low:.4g} .. {high:.4g}"
            return LimitViolation(message, at, (i,))
        f = data.qfrc_actuator[[m.joints[j].dof for j in self.efforts]]
        for k in np.flatnonzero((f < self.effort_ends[:, 0]) | (f > self.effort_ends[:, 1]))[:1]:
            j = self.efforts[int(k)]
            low, high = self.effort_ends[k]
            message = f"joint {m.joints[j].name} would be sent more than {low:.4g} .. {high:.4g}"
            return LimitViolation(f"{message} {m.joints[j].force_unit}", at, self._drivers(j))
        return None

    # ---- who touches whom ------------------------------------------------------------------------

    def _pairs(self, data: Any) -> list[tuple[tuple[int, int], tuple[str, str]]]:
        """Pairs of geoms in contact, with their names."""
        contacts = []
        for c in range(data.ncon):
            contact = data.contact[c]
            geom, other = sorted(int(g) for g in contact.geom)
            if geom >= 0 and contact.exclude == 0 and contact.dist <= 0.0:
                contacts.append(((geom, other), (self._named(geom), self._named(other))))
        return contacts

    def _named(self, geom: int) -> str:
        body = self.m.bodies[int(self.model.geom_bodyid[geom])].name
        return self.file.stated_name("geom", geom) or f"a geom of {body}"

    def _drivers(self, joint: int) -> tuple[int, ...]:
        """Actuators of a joint; all actuators if it has none."""
        m, drivers = self.m, []
        for i in m.commanded:
            a = m.actuators[i]
            if a.joint == joint or (a.tendon >= 0 and joint in m.tendons[a.tendon].joints):
                drivers.append(i)
        return tuple(drivers) or m.commanded


def _stated_speeds(file: MujocoFile, joints: Sequence[str]) -> dict[str, float]:
    """Speed limits of the joints in a URDF, which MuJoCo ignores; MJCF has none."""
    if file.path.suffix.lower() != ".urdf":
        return {}
    tags = tags_of(file.path.read_bytes())
    column_names = {file.name("joint", i): name for i, name in enumerate(joints)}
    speeds = {}
    for tag in tags:
        if tag.name != "limit" or tag.parent < 0 or "velocity" not in tag.attributes:
            continue
        name = tags[tag.parent].attributes.get("name", "")
        try:
            speed = float(tag.attributes["velocity"])
        except ValueError:
            continue
        if name in column_names and speed > 0.0:  # tools write 0 for "unknown"
            speeds[column_names[name]] = speed
    return speeds
