"""Equations of motion of a tree of hinges and slides, on symbols: M(q) q'' + c(q, q') = force.

Everything is held about the world's origin, link by link. The mass matrix comes from composite
inertias, the bias c from the recursive Newton-Euler algorithm, and q'' from the factors L' D L of
M, which has no fill-in for a tree (Featherstone 2008, Rigid Body Dynamics Algorithms, ch. 5, 6, 8).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.symbolic.vocabulary import (
    ZERO,
    Expr,
    Number,
    cos,
    expression,
    held,
    sin,
    tangent,
)
from pamid.rigs.simulators.body_inertia import full_inertia, inertia_per_mass
from pamid.rigs.simulators.mechanism import Body, Mechanism, MechanismJoint, Mount
from pamid.rigs.simulators.spatial import (
    AT_REST,
    IDENTITY,
    MASSLESS,
    NOUGHT,
    UNMOVED,
    Inertia,
    Mat,
    Spatial,
    Vec,
    clean,
    constant,
    coriolis,
    cross,
    rotation,
    times,
)


@dataclass(frozen=True)
class _Frame:
    """A body's frame in the world: rotated by symbols and then by numbers, at a place."""

    turn: Mat
    fixed: Array
    place: Vec

    def local(self, vector: Vec) -> Vec:
        """Vector along the axes of the frame."""
        return constant(self.fixed.T) @ (self.turn.T @ vector)

    def vector(self, local_vector: Array) -> Vec:
        return self.turn @ constant(self.fixed @ local_vector)

    def point(self, local_point: Array) -> Vec:
        return self.place + self.vector(local_point)


@dataclass(frozen=True)
class _Mass:
    """A body on its link: mass (a parameter) and inertia per unit mass.

    The inertia is given in the frame's `turn` (local) and in the world (each). lifted: share of the
    weight that an upward force carries.
    """

    mass: Expr
    local: Inertia
    frame: _Frame
    is_deformed: bool
    lifted: float

    @cached_property
    def each(self) -> Inertia:
        return self.local.moved(self.frame.turn, self.frame.place)

    def at_rest(self) -> Inertia:
        """Inertia in the world, which only changes with the body's mass and shape."""
        frame = self.frame
        return self.local.by(self.mass).moved(_held(frame.turn), _held(frame.place))


#: (w, x, y, z)
Quaternion = tuple[Expr, Expr, Expr, Expr]
#: of M = L' D L: L below its diagonal by (row, column), and 1 / D
Factors = tuple[dict[tuple[int, int], Expr], list[Expr]]


class Tree:
    """A mechanism's joints in a row of links, a joint each; `up` is the joint below a link, or -1.

    q, qd: positions and velocities (n,); masses: an expression per body; armature (n,); shapes:
    centre of mass (m) and second moments about it over the mass (m2), both in the body's frame, of
    the bodies whose shape is not that of the file.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        q: Sequence[Expr],
        qd: Sequence[Expr],
        masses: Sequence[Expr],
        armature: Sequence[Expr],
        shapes: Mapping[int, tuple[Vec, Mat]],
    ) -> None:
        self.q, self.qd, self.armature, self.mechanism = q, qd, armature, mechanism
        self.n = len(mechanism.joints)
        self.gravity = Spatial(NOUGHT, constant(-np.array(mechanism.gravity)))
        self.up: list[int] = []
        self.axis: list[Spatial] = []
        self.bodies: list[list[_Mass]] = [[] for _ in mechanism.joints]
        self.frames = [_Frame(IDENTITY, np.eye(3), NOUGHT)]
        self.links = [-1]  # of every body, the joint that moves it; -1: none
        for number, body in enumerate(mechanism.bodies[1:], 1):
            above, link = self.frames[body.parent], self.links[body.parent]
            frame = _Frame(
                above.turn,
                above.fixed @ rotation(body.quaternion),
                above.point(np.array(body.position)),
            )
            for j, joint in enumerate(mechanism.joints):
                if joint.body == number:
                    self.up.append(link)
                    frame, link = self._join(frame, joint, j), j
            self.frames.append(frame)
            self.links.append(link)
            if link >= 0 and body.mass_kg:
                shape = shapes.get(number)
                local = _local_inertia(body, shape, frame)
                deformed = shape is not None
                self.bodies[link].append(
                    _Mass(masses[number], local, frame, deformed, body.gravity_compensation)
                )

    # ---- where everything is ---------------------------------------------------------------------

    def _join(self, frame: _Frame, joint: MechanismJoint, j: int) -> _Frame:
        """Frame behind a joint; stores the joint's motion vector."""
        axis, anchor = np.array(joint.axis), np.array(joint.anchor)
        moved = self.q[j] - joint.reference
        if joint.kind == "slide":
            along = frame.vector(axis)
            self.axis.append(Spatial(NOUGHT, along))
            return _Frame(frame.turn, frame.fixed, frame.place + times(moved, along))
        aligned = _aligned(clean(frame.fixed @ axis))
        x, y, along = (frame.turn @ constant(aligned)).T
        point = frame.point(anchor)
        c, s = cos(moved), sin(moved)
        turn = np.stack([times(c, x) + times(s, y), times(c, y) - times(s, x), along], axis=1)
        self.axis.append(Spatial(along, cross(point, along)))
        behind = _Frame(turn, aligned.T @ frame.fixed, NOUGHT)
        return _Frame(behind.turn, behind.fixed, point - behind.vector(anchor))

    # ---- frames on bodies -----------------------------------------------------------------------

    def mounted(self, mount: Mount) -> _Frame:
        """Frame of a mount in the world."""
        frame, mount_rotation = self.frames[mount.body], rotation(mount.quaternion)
        place = frame.point(np.array(mount.position))
        return _Frame(frame.turn, frame.fixed @ mount_rotation, place)

    def quaternion(self, mount: Mount) -> Quaternion:
        """Attitude of the frame, continuous in the positions of the joints."""
        quaternion: Quaternion = (expression(1.0), ZERO, ZERO, ZERO)
        for number in self.mechanism.lineage(mount.body):
            quaternion = _turned(quaternion, _unit(self.mechanism.bodies[number].quaternion))
            for j, joint in enumerate(self.mechanism.joints):
                if joint.body == number and joint.kind == "hinge":
                    half = 0.5 * (self.q[j] - joint.reference)
                    x, y, z = (sin(half) * float(a) for a in joint.axis)
                    quaternion = _turned(quaternion, (cos(half), x, y, z))
        return _turned(quaternion, _unit(mount.quaternion))

    def motion(self, mount: Mount) -> Spatial:
        """Angular velocity of the frame and velocity of its origin, along the world's axes."""
        link = self.links[mount.body]
        moved = self.velocity[link] if link >= 0 else AT_REST
        return Spatial(moved.a, moved.b + cross(moved.a, self.mounted(mount).place))

    def moments(self, mount: Mount, wrench: Sequence[float]) -> dict[int, Expr]:
        """Joint forces of a (force, torque) along the axes of a frame, at its origin."""
        frame = self.mounted(mount)
        force, torque = frame.vector(np.array(wrench[:3])), frame.vector(np.array(wrench[3:]))
        whole = Spatial(torque + cross(frame.place, force), force)
        return {j: self.axis[j].dot(whole) for j in self.path(self.links[mount.body])}

    # ---- inertia and motion ----------------------------------------------------------------------

    @cached_property
    def inertia(self) -> list[Inertia]:
        """Inertia of each link by itself."""
        inertias = []
        for bodies in self.bodies:
            total = MASSLESS
            for body in bodies:
                total = total + body.each.by(body.mass)
            inertias.append(total)
        return inertias

    @cached_property
    def composite(self) -> list[Inertia]:
        """Inertia of each link with all that it carries."""
        return self._gathered(self.inertia)

    def _gathered(self, of: list) -> list:  # type: ignore[type-arg]
        total = list(of)
        for i in reversed(range(self.n)):
            if self.up[i] >= 0:
                total[self.up[i]] = total[self.up[i]] + total[i]
        return total

    @cached_property
    def velocity(self) -> list[Spatial]:
        velocities: list[Spatial] = []
        for i in range(self.n):
            velocities.append(self._below(velocities, i, AT_REST) + self.axis[i].by(self.qd[i]))
        return velocities

    def _below(self, of: list[Spatial], i: int, ground: Spatial) -> Spatial:
        return of[self.up[i]] if self.up[i] >= 0 else ground

    @cached_property
    def turning(self) -> list[Spatial]:
        """Rate of change of each joint's motion vector."""
        return [self._below(self.velocity, i, AT_REST).cross(self.axis[i]) for i in range(self.n)]

    @cached_property
    def momentum(self) -> list[Spatial]:
        return [inertia.momentum(v) for inertia, v in zip(self.inertia, self.velocity, strict=True)]

    def acceleration(self, qdd: Sequence[Number]) -> list[Spatial]:
        """Acceleration of each link, with gravity as an acceleration of the ground."""
        accelerations: list[Spatial] = []
        for i in range(self.n):
            joint_acceleration = self.axis[i].by(qdd[i]) + self.turning[i].by(self.qd[i])
            accelerations.append(self._below(accelerations, i, self.gravity) + joint_acceleration)
        return accelerations

    def forces(self, acceleration: list[Spatial]) -> list[Spatial]:
        """Forces on each link by itself."""
        return [
            inertia.momentum(a) + v.cross_force(h)
            for inertia, a, v, h in zip(
                self.inertia, acceleration, self.velocity, self.momentum, strict=True
            )
        ]

    @cached_property
    def reach(self) -> list[Spatial]:
        """Composite inertia times the joint's motion vector."""
        return [inertia.momentum(s) for inertia, s in zip(self.composite, self.axis, strict=True)]

    def path(self, i: int) -> list[int]:
        """The joint and those below it, down to the ground."""
        joints = []
        while i >= 0:
            joints.append(i)
            i = self.up[i]
        return joints

    # ---- equations -------------------------------------------------------------------------------

    @cached_property
    def mass_matrix(self) -> dict[tuple[int, int], Expr]:
        """M (i, j) for j on the path of i, armature included."""
        matrix = {}
        for i in range(self.n):
            for j in self.path(i):
                value = self.axis[j].dot(self.reach[i])
                matrix[i, j] = value + self.armature[i] if i == j else value
        return matrix

    @cached_property
    def bias(self) -> list[Expr]:
        """c(q, q'): forces of the joints at zero acceleration."""
        total = self._gathered(self.forces(self.acceleration([ZERO] * self.n)))
        return [s.dot(f) for s, f in zip(self.axis, total, strict=True)]

    @cached_property
    def lift(self) -> list[Expr]:
        """Joint forces of the gravity compensation at the bodies' centres."""
        lift = []
        for bodies in self.bodies:
            total = MASSLESS
            for body in bodies:
                if body.lifted:
                    total = total + body.each.by(body.lifted * body.mass)
            lift.append(total.momentum(self.gravity))
        total_force = self._gathered(lift)
        return [s.dot(f) for s, f in zip(self.axis, total_force, strict=True)]

    def factored(self, added: Sequence[Expr] | None = None) -> Factors:
        """M, with an addition to its diagonal, as L' D L of the tree."""
        m = dict(self.mass_matrix)
        for i, more in enumerate(added or ()):
            m[i, i] = m[i, i] + more
        inverse: list[Expr] = [ZERO] * self.n
        for k in reversed(range(self.n)):
            inverse[k] = 1.0 / m[k, k]
            for i in self.path(k)[1:]:
                a = m[k, i] * inverse[k]
                for j in self.path(i):
                    m[i, j] = m[i, j] - a * m[k, j]
                m[k, i] = a
        return m, inverse

    @cached_property
    def factors(self) -> Factors:
        """Factors of M."""
        return self.factored()

    def solve(self, factors: Factors, force: Sequence[Expr]) -> list[Expr]:
        """M^-1 force"""
        low, inverse = factors
        x = list(force)
        for i in reversed(range(self.n)):
            for j in self.path(i)[1:]:
                x[j] = x[j] - low[i, j] * x[i]
        x = [a * b for a, b in zip(x, inverse, strict=True)]
        for i in range(self.n):
            for j in self.path(i)[1:]:
                x[i] = x[i] - low[i, j] * x[j]
        return x

    # ---- what the equations depend on ------------------------------------------------------------

    def inverse_dynamics(self, qdd: Sequence[Expr]) -> list[Expr]:
        """For each joint an expression with the derivatives of ID - armature q'' at q'' held.

        They are those by q, q' and the masses. Its value is not that of ID.
        """
        acceleration = self.acceleration(qdd)
        forces = self.forces(acceleration)
        total = self._gathered(forces)
        b = self._gathered(
            [
                coriolis(inertia, v, h)
                for inertia, v, h in zip(self.inertia, self.velocity, self.momentum, strict=True)
            ]
            or [UNMOVED]
        )
        change: list[Expr] = [ZERO] * self.n

        def by(i: int, slope: Expr, of: Expr) -> None:
            change[i] = change[i] + held(slope) * of

        for i in range(self.n):
            s, turning, composite = self.axis[i], self.turning[i], self.composite[i]
            drag = b[i].against(s)  # s' 2 B
            second = self._second(i, acceleration)
            pushed = b[i].along(turning) + composite.momentum(second) + s.cross_force(total[i])
            dragged = b[i].along(s) + composite.momentum(turning.by(2.0))
            for j in self.path(i):
                sj, tj = self.axis[j], self.turning[j]
                along = drag @ tj.a + self._second(j, acceleration).dot(self.reach[i])
                by(i, along, self.q[j])
                by(i, drag @ sj.a + 2.0 * tj.dot(self.reach[i]), self.qd[j])
                if j != i:
                    by(j, sj.dot(pushed), self.q[i])
                    by(j, sj.dot(dragged), self.qd[i])
            for mass, force in self._forces_per_mass(i, acceleration, forces[i]):
                for j in self.path(i):
                    by(j, self.axis[j].dot(force), mass)
            # the force on a deformed body only changes with its inertia
            a, v = acceleration[i].mapped(held), self.velocity[i].mapped(held)
            for body in self.bodies[i]:
                if body.is_deformed:
                    inertia = body.at_rest()
                    force = inertia.momentum(a) + v.cross_force(inertia.momentum(v))
                    for j in self.path(i):
                        change[j] = change[j] + self.axis[j].mapped(held).dot(force)
        return change

    def _second(self, i: int, acceleration: list[Spatial]) -> Spatial:
        below = self._below(self.velocity, i, AT_REST)
        pushed = self._below(acceleration, i, self.gravity)
        return pushed.cross(self.axis[i]) + below.cross(self.turning[i])

    def _forces_per_mass(
        self, i: int, acceleration: list[Spatial], force: Spatial
    ) -> list[tuple[Expr, Spatial]]:
        bodies = [body for body in self.bodies[i] if not body.is_deformed]
        if bodies == self.bodies[i] and len(bodies) == 1:
            per = 1.0 / bodies[0].mass
            return [(bodies[0].mass, force.by(per))]
        forces = []
        for part in bodies:
            h = part.each.momentum(self.velocity[i])
            alone = part.each.momentum(acceleration[i]) + self.velocity[i].cross_force(h)
            forces.append((part.mass, alone))
        return forces

    @cached_property
    def bias_change(self) -> list[Expr]:
        """Change of the bias, as `inverse_dynamics`."""
        return self.inverse_dynamics([ZERO] * self.n)

    @cached_property
    def holding(self) -> list[Expr]:
        """The bias c with its exact derivatives."""
        pairs = zip(self.bias, self.bias_change, strict=True)
        return [tangent(value, change) for value, change in pairs]

    def effective_inertia(self, j: int) -> Expr:
        """Inertia at a joint of its motor and its load while the other joints give way."""
        return 1.0 / self.inverse_inertia({j: 1.0})

    def inverse_inertia(self, along: Mapping[int, float]) -> Expr:
        """J M^-1 J' of a motion with the shares J by joint.

        Its derivative is -u' dM u with u = M^-1 J'.
        """
        force = [expression(along.get(i, 0.0)) for i in range(self.n)]
        moved = self.solve(self.factors, force)
        still = [held(u) for u in moved]
        change = ZERO
        for (i, k), m in self.mass_matrix.items():
            change = change - (1.0 if i == k else 2.0) * still[i] * still[k] * m
        return tangent(sum((share * moved[j] for j, share in along.items()), ZERO), change)

    def link_inertia(self, i: int, j: int) -> Expr | None:
        """M_ij without the motors; None if neither joint carries the other."""
        inertia = self.mass_matrix.get((i, j), self.mass_matrix.get((j, i)))
        return inertia - self.armature[i] if inertia is not None and i == j else inertia


# ---- numbers -------------------------------------------------------------------------------------


def _unit(quaternion: Sequence[float]) -> Quaternion:
    w, x, y, z = np.array(quaternion) / np.linalg.norm(quaternion)
    return expression(float(w)), expression(float(x)), expression(float(y)), expression(float(z))


def _turned(a: Quaternion, b: Quaternion) -> Quaternion:
    """Product of two quaternions."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


def _held(values: NDArray[np.object_]) -> NDArray[np.object_]:
    """Expressions without their derivatives."""
    return np.array([held(v) for v in values.ravel().tolist()]).reshape(values.shape)


def _aligned(axis: Array) -> Array:
    """Rotation with this z axis; a permutation if possible."""
    z = axis / np.linalg.norm(axis)
    x = np.zeros(3)
    x[(int(np.argmax(np.abs(z))) + 1) % 3] = 1.0
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _local_inertia(body: Body, shape: tuple[Vec, Mat] | None, frame: _Frame) -> Inertia:
    """Inertia of a body in the frame's `turn` per unit of its mass, as in the file without a shape.

    shape: centre, and second moments about it, in the body's frame.
    """
    if shape is None:
        about = frame.fixed @ full_inertia(body) @ frame.fixed.T / body.mass_kg
        centre = frame.fixed @ np.array(body.centre)
        about = about + (centre @ centre) * np.eye(3) - np.outer(centre, centre)
        about = np.where(np.abs(about) < 1e-15 * np.abs(about).max(), 0.0, about)
        first, second = constant(centre), constant(about)
    else:
        turn = constant(frame.fixed)
        first, moments = turn @ shape[0], turn @ shape[1] @ turn.T
        second = inertia_per_mass(moments + np.stack([times(c, first) for c in first]))
    # the lower half equals the upper half, up to rounding
    lower = np.tri(3, k=-1) > 0
    return Inertia(expression(1.0), first, np.where(lower, second.T, second))
