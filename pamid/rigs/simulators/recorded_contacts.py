"""Contacts of a model along recordings, by MuJoCo's collision detection.

Joint positions q(t) follow from the readings, which are linear in them. A pose is only checked if
geoms may have met since the last pose. With d the smallest free distance there, nothing touches as
long as

    sum_k reach_k |q_k(t) - q_k(t0)| < d

where reach_k is the largest distance of any point that joint k moves from its axis, in any pose; 1
for a slide. That is the bound of conservative advancement. For the nearest pair, d less the
smallest distance so far replaces d; then no closer pose is skipped.

References: Mirtich (1996), Impulse-based Dynamic Simulation of Rigid Body Systems, ch. 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.recording.recording import Recording
from pamid.rigs.simulators.mechanism import Mechanism
from pamid.rigs.simulators.mujoco_file import MujocoFile, open_mujoco
from pamid.rigs.simulators.mujoco_findings import widen_margins

SHARE_POSES = 500  # poses that estimate the share of the time with contacts
NEARER_SHARE, NEARER_M = 0.05, 1e-3  # a pair must be nearer by this to replace another pair
PENDING = 256  # samples that are compared with a pose at a time
RANK_TOLERANCE = 1e-9  # of the largest singular value: smaller ones are rounding errors


@dataclass(frozen=True)
class GeomPair:
    """Two geoms and their bodies by name.

    distance_m: negative for an overlap; touch: True if MuJoCo has a contact force; recording,
    time_s: place of the event.
    """

    geoms: tuple[str, str]
    bodies: tuple[str, str]
    distance_m: float
    touch: bool
    recording: str
    time_s: float


@dataclass(frozen=True)
class RecordedContacts:
    """Active constraints of a model along recordings.

    touching  the first pair that touches, None for no contact
    share     approximate share of the samples of its recording in which geoms touch
    nearest   the closest pair, None after a contact or if no pair can meet
    limit     text on a joint that reaches an end of its range; "" for none
    unread    joints without a position in the readings: then nothing else is known
    """

    touching: GeomPair | None = None
    share: float = 0.0
    nearest: GeomPair | None = None
    limit: str = ""
    unread: tuple[str, ...] = ()

    @property
    def free(self) -> bool:
        """True if neither a contact nor the end of a range is active."""
        return self.touching is None and not self.limit and not self.unread


def recorded_contacts(mechanism: Mechanism, recordings: Sequence[Recording]) -> RecordedContacts:
    """Contacts and ends of ranges along recordings, in their order, up to the first.

    The readings must be linear in the joint positions: of joints, actuators and tendons. The file
    is opened again. FileError if that is no longer possible.
    """
    paths: list[tuple[Recording, Array]] = []
    for recording in recordings:
        q, unread = joint_positions(mechanism, recording)
        if unread:
            return RecordedContacts(unread=unread)
        paths.append((recording, q))
    travel = np.max(
        [np.abs(q - [j.reference for j in mechanism.joints]).max(axis=0) for _, q in paths], axis=0
    )
    poses = _Poses(open_mujoco(mechanism.path), mechanism, travel)
    nearest: GeomPair | None = None
    for recording, q in paths:
        for j, joint in enumerate(mechanism.joints):
            low, high = joint.range or (-np.inf, np.inf)
            beyond = (q[:, j] < low) | (q[:, j] > high)
            if beyond.any():
                time = float(recording.time[int(beyond.argmax())])
                return RecordedContacts(
                    limit=f"joint {joint.name!r} is at an end of its range, {low:.4g} .. "
                    f"{high:.4g} {joint.unit}, in {recording.path}, first at {time:.3g} s"
                )
        contacts = poses.along(recording, q)
        if contacts is not None and contacts.touch:
            return RecordedContacts(touching=contacts, share=poses.share(q))
        if contacts is not None and (nearest is None or contacts.distance_m < nearest.distance_m):
            nearest = contacts
    return RecordedContacts(nearest=nearest)


def joint_positions(mechanism: Mechanism, recording: Recording) -> tuple[Array, tuple[str, ...]]:
    """Positions (samples, joints) from the readings, and the joints without a position."""
    rows, read = [], []
    for sensor in mechanism.sensors:
        if not recording.has(sensor.column):
            continue
        row, factor, tendon, joint = np.zeros(len(mechanism.joints)), 1.0, -1, -1
        if sensor.kind == "tendonpos":
            tendon = sensor.of
        elif sensor.kind == "jointpos":
            joint = sensor.of
        elif sensor.kind == "actuatorpos":
            a = mechanism.actuators[sensor.of]
            tendon, joint, factor = a.tendon, a.joint, a.gear
        if joint >= 0:
            row[joint] = factor
        elif tendon >= 0:
            t = mechanism.tendons[tendon]
            row[list(t.joints)] = factor * np.array(t.coefficients)
        if row.any():
            rows.append(row)
            read.append(recording.si(sensor.column))
    names = [j.name for j in mechanism.joints]
    if not rows:
        return np.empty((len(recording), 0)), tuple(names)
    matrix = np.array(rows)
    _, sizes, directions = np.linalg.svd(matrix)
    rank = int((sizes > RANK_TOLERANCE * sizes.max(initial=0.0)).sum())
    loose = np.abs(directions[rank:]).max(axis=0, initial=0.0) > RANK_TOLERANCE
    if loose.any():
        return np.empty((len(recording), 0)), tuple(np.array(names)[loose].tolist())
    q, *_ = np.linalg.lstsq(matrix, np.stack(read), rcond=None)
    return np.ascontiguousarray(q.T), ()


class _Poses:
    """Collision detection of a model in given poses.

    travel: largest displacement of every joint from its reference. Points that a slide carries can
    be farther by this much from a joint below the slide.
    """

    def __init__(self, file: MujocoFile, mechanism: Mechanism, travel: Array) -> None:
        self.file, self.mujoco, self.exact = file, file.mujoco, file.model
        # MuJoCo reports distances up to the margin of a pair, so the margin is widened
        self.near = m = file.copy()
        margins = np.concatenate([m.geom_margin, m.pair_margin])
        self.margin = 2.0 * float(margins.max(initial=0.0))  # of any pair, at most
        widen_margins(m, float(m.stat.extent))
        self.data = self.mujoco.MjData(m)
        self.exact_data = self.mujoco.MjData(self.exact)
        self.places = np.array([j.qpos for j in mechanism.joints])
        self.reach = _reach(file, mechanism, travel)
        self.extent = float(m.stat.extent)

    def along(self, recording: Recording, q: Array) -> GeomPair | None:
        """Pair that touches first, else the closest pair; q (samples, joints).

        None if no pair comes within the model's extent.
        """
        nearest: GeomPair | None = None
        row = 0
        while row < len(q):
            pair = self._pair(recording, q, row)
            if pair is not None and (nearest is None or pair.distance_m < nearest.distance_m):
                nearest = pair
            if pair is not None and pair.touch:
                return pair
            free = self.extent if pair is None else pair.distance_m
            least = 0.0 if nearest is None else nearest.distance_m
            least = max(0.0, least - max(NEARER_SHARE * least, NEARER_M))
            row = self._next(q, row, free - self.margin - least)
        return nearest

    def share(self, q: Array) -> float:
        """Share of the poses in which geoms touch."""
        rows = np.unique(np.linspace(0, len(q) - 1, SHARE_POSES).astype(int))
        return float(np.mean([self._touches(q[row]) for row in rows]))

    def _next(self, q: Array, row: int, free: float) -> int:
        """Next row in which geoms may touch."""
        for first in range(row + 1, len(q), PENDING):
            moved = np.abs(q[first : first + PENDING] - q[row]) @ self.reach
            if (moved >= free).any():
                return first + int((moved >= free).argmax())
        return len(q)

    def _pair(self, recording: Recording, q: Array, row: int) -> GeomPair | None:
        """Nearest pair in a pose."""
        d = self._detected(self.near, self.data, q[row])
        contacts, m = d.contact, self.exact
        seen = np.flatnonzero(contacts.exclude <= 1)
        if not len(seen):
            return None
        at = seen[int(contacts.dist[seen].argmin())]
        distance = float(contacts.dist[at])
        g = [int(k) for k in contacts.geom[at]]
        name = self.file.name
        return GeomPair(
            (name("geom", g[0]), name("geom", g[1])),
            (name("body", int(m.geom_bodyid[g[0]])), name("body", int(m.geom_bodyid[g[1]]))),
            distance,
            distance <= self.margin and self._touches(q[row]),
            str(recording.path),
            float(recording.time[row]),
        )

    def _touches(self, pose: Array) -> bool:
        d = self._detected(self.exact, self.exact_data, pose)
        return bool((d.contact.exclude == 0).any())

    def _detected(self, model: Any, data: Any, pose: Array) -> Any:
        data.qpos[:] = model.qpos0
        data.qpos[self.places] = pose
        self.mujoco.mj_kinematics(model, data)
        self.mujoco.mj_comPos(model, data)
        self.mujoco.mj_collision(model, data)
        return data


def _reach(file: MujocoFile, mechanism: Mechanism, travel: Array) -> Array:
    """Largest distance (m) of any point that a joint moves from its axis, in any pose.

    It is infinite if a joint moves a plane.
    """
    m, mujoco = file.model, file.mujoco
    plane = int(mujoco.mjtGeom.mjGEOM_PLANE)
    reach = np.zeros(m.nbody)  # of a body and all that it carries, from the body's frame
    for g in range(m.ngeom):
        moved_plane = m.geom_type[g] == plane and m.body_weldid[m.geom_bodyid[g]]
        size = np.inf if moved_plane else float(m.geom_rbound[g])
        body = int(m.geom_bodyid[g])
        reach[body] = max(reach[body], float(np.linalg.norm(m.geom_pos[g])) + size)
    shifts = np.zeros(m.nbody)  # of a body's frame by the body's joints
    for j, joint in enumerate(mechanism.joints):
        slide = joint.kind == "slide"
        shifts[joint.body] += travel[j] if slide else 2.0 * float(np.linalg.norm(joint.anchor))
    for body in range(m.nbody - 1, 0, -1):  # a parent stands before its children
        whole = reach[body] + shifts[body] + float(np.linalg.norm(m.body_pos[body]))
        parent = int(m.body_parentid[body])
        reach[parent] = max(reach[parent], whole)
    return np.array(
        [
            1.0
            if j.kind == "slide"
            else reach[j.body] + shifts[j.body] + float(np.linalg.norm(j.anchor))
            for j in mechanism.joints
        ]
    )
