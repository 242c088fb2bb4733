"""A mechanism as a rig of equations, which runs without a simulator.

    M(q) q'' + c(q, q') = drive + tendons - damping(q') - stiffness(q - relaxed) + friction
                          + couplings + gravity compensation

The couplings are those of `soft_constraints.py`, as is the friction at joints whose
file states a loss. If a fit frees the loss of another joint, its friction grows with the velocity
up to the loss, with the slope of a creeping joint. Joint, tendon and actuator laws are those of
MuJoCo (documentation, Computation). The motion is computed there, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import Any, TypeAlias

import numpy as np

from pamid.base.units import with_unit
from pamid.engine.symbolic.vocabulary import (
    ZERO,
    Expr,
    Number,
    absolute,
    clip,
    delay,
    expression,
    maximum,
    minimum,
    where,
)
from pamid.model.effect import State
from pamid.model.rig import Port, Rig
from pamid.rigs.simulators.body_inertia import BodyShape, shapes_of, tool_body
from pamid.rigs.simulators.mechanism import (
    Actuator,
    Coupling,
    Mechanism,
    MechanismSensor,
    Mount,
)
from pamid.rigs.simulators.mechanism_log_names import log_names_of, vector_sizes_of
from pamid.rigs.simulators.mechanism_pose import mechanism_pose
from pamid.rigs.simulators.motor_equations import motor_equations
from pamid.rigs.simulators.soft_constraints import (
    LEAST_SOFTNESS,
    MODELS_ALIKE,
    SoftCoupling,
    SoftFriction,
    accelerations,
    impedance,
)
from pamid.rigs.simulators.tree_dynamics import Tree

DELAY_ROOM = 5.0  # times the delay that the file states
RETURN_RATE = 200.0  # 1/s, decay of a spring's deflection beyond its largest value
LEAST_INERTIA = 1e-12  # of what a joint carries, kg m2 or kg
#: an angle (or length) and its rate
Turn: TypeAlias = tuple[Expr, Expr]


@dataclass(frozen=True)
class Load:
    """Load of a joint while all other joints give way; SI.

    It has the torque that accelerates the joint, its inertia, its inertia without the motor's
    (carried), the acceleration of this part with no spring at its joint, and its usual inertia, a
    number.
    """

    torque: Expr
    inertia: Expr
    carried: Expr
    free_fall: Expr
    usual: float

    def under(self, more: Expr) -> Load:
        """Add torque."""
        return replace(self, torque=self.torque + more)


class CompiledMechanism(Rig):
    """Rig made of a `Mechanism`, with the mechanism's inputs, outputs and parameters."""

    name = "mechanism"

    def __init__(self, mechanism: Mechanism) -> None:
        untyped: Any = self  # these tables usually are class attributes
        m = mechanism
        self.mechanism = m
        untyped.name = m.name
        untyped.inputs, untyped.outputs = m.inputs, m.outputs
        untyped.optional = {a.column: 0.0 for a in m.actuators if a.is_bare}
        untyped.ranges = {a.column: a.command_range for a in m.actuators if a.command_range}
        untyped.centre = {
            column: 0.5 * sum(ends) for column, ends in untyped.ranges.items() if sum(ends)
        }
        untyped.excited = {a.column: _amplitude(m, a) for a in m.actuators if a.column}
        untyped.ports = {
            p.name: Port(p.kind, p.unit, dict(p.signals), size=dict(p.size)) for p in m.ports
        }
        shapes = shapes_of(m)
        untyped.on_request = {shape.group: shape.parameters() for shape in shapes}
        # A stepped model pays a run for every parameter.
        tool = None if m.hindrances else tool_body(m, shapes)
        parameters = tuple(p.parameter for p in m.parameters)
        untyped.parameters = tool.as_tool(parameters) if tool else parameters
        untyped.states = tuple(_states(m))
        untyped.noise = {s.column: s.noise for s in m.sensors if s.noise > 0.0}
        untyped.remarks = _remarks(m)
        untyped.log_names, untyped.vector_sizes = log_names_of(m), vector_sizes_of(m)
        self._names = {(p.element, p.number, p.attribute): p.parameter.name for p in m.parameters}
        self._ports = {(p.element, p.number, p.kind): p.name for p in m.ports}

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return MechanismEquations(self, x, u, p, port).rates()

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        equations = MechanismEquations(self, x, u, p, port)
        return {s.column: equations.reading(i, s) for i, s in enumerate(self.mechanism.sensors)}

    def pose(self, y: Mapping[str, Any], p: Any) -> dict[str, Any]:
        return mechanism_pose(self.mechanism, y)

    @cached_property
    def shapes(self) -> tuple[BodyShape, ...]:
        """Bodies whose shape and centre are parameters."""
        names = {p.name for p in self.parameters}
        return tuple(s for s in shapes_of(self.mechanism) if s.centre_names[0] in names)

    def combinations(self, p: Any) -> dict[str, Number]:
        """Inertias of these bodies about their centres, kg m2."""
        inertias: dict[str, Number] = {}
        for shape in self.shapes:
            names = (with_unit(name, "kg m2") for name in shape.inertia_names)
            mass = self.value(p, "body", shape.number, "mass", shape.body.mass_kg)
            inertias |= zip(names, shape.inertia(p, mass), strict=True)
        return inertias

    def value(self, p: Any, element: str, number: int, attribute: str, stated: float) -> Expr:
        """Parameter of an element; the number in the file if it is not a parameter."""
        name = self._names.get((element, number, attribute))
        return expression(stated if name is None else getattr(p, name))

    def port_of(self, element: str, number: int, kind: str) -> str:
        """Name of an element's port of a kind; "" if it has none."""
        return self._ports.get((element, number, kind), "")


def _remarks(m: Mechanism) -> tuple[str, ...]:
    """Remarks on the form of the model, and on its omissions."""
    kinds = {"joint": m.joints, "tendon": m.tendons, "actuator": m.actuators, "sensor": m.sensors}
    counted = ", ".join(f"{len(v)} {k}{'' if len(v) == 1 else 's'}" for k, v in kinds.items() if v)
    fitted = sum(p.parameter.fitted for p in m.parameters)
    return (
        f"compiled into equations ({counted}, {fitted} parameters to fit): a tree of hinges and "
        "slides without contacts or closed loops",
        *map(str, m.findings),
    )


def _states(m: Mechanism) -> Iterator[State]:
    for joint in m.joints:
        yield State(joint.name, joint.unit, joint.reference)
    for joint in m.joints:
        yield State(f"{joint.name}_velocity", f"{joint.unit}/s")
    for actuator in m.actuators:
        yield from (State(name, unit) for name, unit in actuator.states)
    for joint in m.joints:
        if joint.spring_state:
            low, high = (joint.reference + s * joint.spring_yield for s in (-1.0, 1.0))
            # a larger deflection yields at once
            relaxed = min(max(joint.spring_reference, low), high)
            yield State(joint.spring_state, joint.unit, relaxed)


def _amplitude(m: Mechanism, actuator: Actuator) -> float:
    """Usual amplitude of a command: half its range.

    Without a range it is half a radian or a tenth of a metre for a position, twice that for a
    velocity, and for a force the force that accelerates its joint by 10 rad/s2.
    """
    if actuator.command_range is not None:
        low, high = actuator.command_range
        return 0.25 * (high - low)
    if actuator.kind in ("position", "velocity"):
        far = 0.5 if actuator.force_unit == "N m" else 0.1
        return far if actuator.kind == "position" else 2.0 * far
    driven: tuple[int, ...] = (actuator.joint,)
    if actuator.mount is not None:
        driven = m.chain(actuator.mount.body)
    elif actuator.tendon >= 0:
        driven = m.tendons[actuator.tendon].joints
    inertia = max((m.joints[j].typical_inertia for j in driven), default=1.0)
    return 10.0 * inertia / max(abs(actuator.gear * _gain(actuator)), 1e-9)


def _gain(actuator: Actuator) -> float:
    """Force per unit of the command."""
    motor = actuator.motor
    if motor is None:
        return actuator.gain[0]
    per_input = {"voltage": motor.constant / motor.resistance, "pos": motor.controller[0]}
    return {**per_input, "vel": motor.controller[2]}.get(motor.input, 1.0)


class MechanismEquations:
    """Equations of a mechanism on symbols, for a single evaluation."""

    def __init__(self, rig: CompiledMechanism, x: Any, u: Any, p: Any, port: Any) -> None:
        self.rig, self.m, self.x, self.u, self.p, self.port = rig, rig.mechanism, x, u, p, port
        self.q = [getattr(x, j.name) for j in self.m.joints]
        self.qd = [getattr(x, f"{j.name}_velocity") for j in self.m.joints]
        self._commands: dict[int, Expr] = {}

    def value(self, element: str, number: int, attribute: str, stated: float) -> Expr:
        """See `CompiledMechanism.value`."""
        return self.rig.value(self.p, element, number, attribute, stated)

    def gear(self, i: int) -> Expr:
        """Gear of an actuator."""
        return self.value("actuator", i, "gear", self.m.actuators[i].gear)

    # ---- actuators -------------------------------------------------------------------------------

    def command(self, i: int) -> Expr:
        """Command of an actuator: through its port, delayed, within its range."""
        a = self.m.actuators[i]
        if not a.column:
            return ZERO
        if i in self._commands:
            return self._commands[i]
        sent = self.port(self.rig.port_of("actuator", i, "command"), getattr(self.u, a.column))
        if a.delay_s > 0.0:
            late = self.value("actuator", i, "delay", a.delay_s)
            sent = delay(sent, late, DELAY_ROOM * a.delay_s)
        self._commands[i] = sent if a.command_range is None else clip(sent, *a.command_range)
        return self._commands[i]

    def actuator_rates(self, i: int) -> dict[str, Expr]:
        """Rates of the states of an actuator."""
        a = self.m.actuators[i]
        if a.motor is not None:
            return self.motor(i)[1]
        if not a.states:
            return {}
        rate, state = self.command(i), getattr(self.x, a.states[0][0])
        if a.dynamics == "filter":
            constant = self.value("actuator", i, "time_constant", a.time_constant_s)
            rate = (rate - state) / maximum(constant, 1e-12)
        if a.activation_range is not None:
            low, high = a.activation_range
            rate = where(state >= high, minimum(rate, 0.0), rate)
            rate = where(state <= low, maximum(rate, 0.0), rate)
        return {a.states[0][0]: rate}

    def motor(self, i: int) -> tuple[Expr, dict[str, Expr]]:
        """Torque of an actuator with a winding, and the rates of its states."""
        a = self.m.actuators[i]
        assert a.motor is not None
        return motor_equations(
            a,
            a.motor,
            partial(self.value, "actuator", i),
            {name: getattr(self.x, name) for name, _ in a.states},
            self.command(i),
            self.travel(i),
        )

    def travel(self, i: int) -> tuple[Expr, Expr]:
        """Length and velocity of an actuator."""
        a = self.m.actuators[i]
        gear = self.gear(i)
        if a.mount is not None:
            moments = self.rigid.moments(a.mount, a.wrench).items()
            return ZERO, sum((moment * self.qd[j] for j, moment in moments), ZERO)
        if a.tendon >= 0:
            length, rate = self.tendon(a.tendon)
            return gear * length, gear * rate
        return gear * self.q[a.joint], gear * self.qd[a.joint]

    def actuator_force(self, i: int) -> Expr:
        """Scalar force of an actuator, before its gear."""
        a = self.m.actuators[i]
        if a.motor is not None:
            return self.motor(i)[0]
        length, rate = self.travel(i)
        activation = getattr(self.x, a.states[0][0]) if a.states else self.command(i)
        gain, bias = [list(map(expression, row)) for row in (a.gain, a.bias)]
        first = {"position": "kp", "velocity": "kv"}.get(a.kind, "gain")
        gain[0] = self.value("actuator", i, first, a.gain[0])
        if a.kind == "position":
            bias[1] = -gain[0]
            bias[2] = -self.value("actuator", i, "kv", -a.bias[2])
        elif a.kind == "velocity":
            bias[2] = -gain[0]
        force = _affine(gain, length, rate) * activation + _affine(bias, length, rate)
        return force if a.force_range is None else clip(force, *a.force_range)

    # ---- joints and tendons ----------------------------------------------------------------------

    def tendon(self, i: int) -> tuple[Expr, Expr]:
        """Length and velocity of a tendon."""
        tendon = self.m.tendons[i]
        shares = list(zip(tendon.joints, tendon.coefficients, strict=True))
        length = sum((c * self.q[j] for j, c in shares), ZERO)
        return length, sum((c * self.qd[j] for j, c in shares), ZERO)

    def tendon_force(self, i: int) -> Expr:
        """Force of a tendon's spring and damper, against its length."""
        t = self.m.tendons[i]
        length, rate = self.tendon(i)
        passed = self.dampers(rate, tendon=i)
        if not (t.stiffness or t.damping or any((*t.stiffness_powers, *t.damping_powers))):
            return -passed
        low, high = t.rest
        beyond = length - clip(length, low, high) if high > low else length - low
        spring = self.polynomial("tendon", i, "stiffness", beyond)
        return -passed - spring - self.polynomial("tendon", i, "damping", rate)

    def dampers(self, velocity: Expr, *, joint: int = -1, tendon: int = -1) -> Expr:
        """Forces of the dampers of the actuators of a joint or a tendon against its velocity."""
        damping = ZERO
        for i, a in enumerate(self.m.actuators):
            if (a.joint, a.tendon) == (joint, tendon) and (a.damping or any(a.damping_powers)):
                gear = self.gear(i)
                damper = self.polynomial("actuator", i, "damping", velocity)
                damping = damping + gear * gear * damper
        return damping

    def polynomial(self, element: str, number: int, attribute: str, x: Expr) -> Expr:
        """a x + b x^2 + c x^3 for the stiffness of an element; a x + b x |x| + c x^3 for its
        damping."""
        stated: Any = getattr(self.m, f"{element}s")[number]
        powers = getattr(stated, f"{attribute}_powers")
        total = self.value(element, number, attribute, getattr(stated, attribute)) * x
        for word, coefficient, of in (
            ("quadratic", powers[0], absolute(x) * x if attribute == "damping" else x * x),
            ("cubic", powers[1], x * x * x),
        ):
            if coefficient:
                name = f"{attribute}_{word}"
                total = total + self.value(element, number, name, coefficient) * of
        return total

    def shares(self, a: Actuator) -> Iterable[tuple[int, Expr | float]]:
        """Force at every joint per unit of an actuator's force, without its gear."""
        if a.mount is not None:
            return self.rigid.moments(a.mount, a.wrench).items()
        if a.tendon < 0:
            return ((a.joint, 1.0),)
        tendon = self.m.tendons[a.tendon]
        return zip(tendon.joints, tendon.coefficients, strict=True)

    def drive(self, actuators: Iterable[int] | None = None) -> list[Expr]:
        """Forces of the actuators, or of some of them, at every joint."""
        forces = [ZERO] * len(self.m.joints)
        for i in range(len(self.m.actuators)) if actuators is None else actuators:
            a = self.m.actuators[i]
            force = self.actuator_force(i)
            if a.mount is None:
                force = self.gear(i) * force
            for j, share in self.shares(a):
                forces[j] = forces[j] + share * force
        if any(joint.compensated_by_actuator for joint in self.m.joints) and self._is_lifted():
            for j, joint in enumerate(self.m.joints):
                if joint.compensated_by_actuator:
                    forces[j] = forces[j] + self.rigid.lift[j]
        return [
            f if joint.force_range is None else clip(f, *joint.force_range)
            for f, joint in zip(forces, self.m.joints, strict=True)
        ]

    def _is_lifted(self) -> bool:
        return any(body.gravity_compensation for body in self.m.bodies)

    def passive(self, j: int) -> Expr:
        """Passive force at a joint.

        It is the sum of spring and damper, the dampers of its actuators, gravity compensation, and
        friction if the file states no loss.
        """
        joint, qd = self.m.joints[j], self.qd[j]
        spring = self.polynomial("joint", j, "stiffness", self.spring_deflection(j))
        damper = self.polynomial("joint", j, "damping", qd)
        held_back = -damper - spring - self.dampers(qd, joint=j)
        if self._is_lifted() and not joint.compensated_by_actuator:
            held_back = held_back + self.rigid.lift[j]
        if joint.friction_loss:
            return held_back  # its friction is solved with the accelerations
        loss = self.value("joint", j, "frictionloss", 0.0)
        slope = joint.friction_rate / self.softness(joint.friction_softness, {j: 1.0})
        return held_back - clip(slope * qd, -loss, loss)

    def spring_deflection(self, j: int) -> Expr:
        """Deflection of a joint's spring from its relaxed position."""
        joint = self.m.joints[j]
        if not joint.spring_state:
            return self.q[j] - joint.spring_reference
        most = self.value("joint", j, "springyield", joint.spring_yield)
        return clip(self.q[j] - getattr(self.x, joint.spring_state), -most, most)

    def plastic_rate(self, j: int) -> Expr:
        """Plastic rate of a joint's spring.

        At its largest deflection the spring moves with the joint. A deflection beyond that, after a
        step or at the start, decays.
        """
        joint, qd = self.m.joints[j], self.qd[j]
        most = self.value("joint", j, "springyield", joint.spring_yield)
        way = self.q[j] - getattr(self.x, joint.spring_state)
        forward = where(way >= most, maximum(qd, 0.0), ZERO)
        backward = where(way <= -most, minimum(qd, 0.0), ZERO)
        return forward + backward + RETURN_RATE * (way - clip(way, -most, most))

    def coupling(self, c: Coupling) -> SoftCoupling:
        """A coupling at the present positions."""
        ends = [self.shares_of(c, end) for end in (c.first, c.second) if end >= 0]
        places = [sum((share * self.q[j] for j, share in of.items()), ZERO) for of in ends]
        y = places[0] - c.references[0]
        x = places[1] - c.references[1] if len(ends) > 1 else ZERO
        value, slope = expression(c.coefficients[-1]), ZERO
        for coefficient in reversed(c.coefficients[:-1]):
            slope = slope * x + value
            value = value * x + coefficient
        slopes = {j: expression(share) for j, share in ends[0].items()}
        for of in ends[1:]:
            for j, share in of.items():
                slopes[j] = slopes.get(j, ZERO) - slope * share
        error, speed = y - value, sum((each * self.qd[j] for j, each in slopes.items()), ZERO)
        d = impedance(c.impedance, error)
        softness = self.softness((1.0 - d) / d, *ends)
        return SoftCoupling(slopes, -c.rate * speed - c.stiffness * d * error, softness)

    def shares_of(self, c: Coupling, number: int) -> dict[int, float]:
        """Shares of the joints in the motion of one end of a coupling."""
        if c.kind == "joint":
            return {number: 1.0}
        tendon, shares = self.m.tendons[number], dict[int, float]()
        for j, share in zip(tendon.joints, tendon.coefficients, strict=True):
            shares[j] = shares.get(j, 0.0) + share
        return shares

    def friction(self, j: int) -> SoftFriction | None:
        """Friction of a joint whose file states a loss."""
        joint = self.m.joints[j]
        if not joint.friction_loss:
            return None
        loss = self.value("joint", j, "frictionloss", joint.friction_loss)
        softness = self.softness(joint.friction_softness, {j: 1.0})
        return SoftFriction(loss, joint.friction_rate, softness, self.qd[j])

    def softness(self, relative: Expr | float, *ends: Mapping[int, float]) -> Expr:
        """Softness of a constraint from that relative to the inverse inertia at its ends.

        MuJoCo takes it in the pose of the file, so that it follows masses and armatures alone.
        ends: shares of the joints in their motion.
        """
        inverse = sum((self.at_reference.inverse_inertia(end) for end in ends), ZERO)
        return maximum(relative * inverse, LEAST_SOFTNESS)

    def known_forces(self, actuators: Iterable[int] | None = None) -> list[Expr]:
        """Force or torque at every joint, of all actuators or some of them."""
        forces = [f + self.passive(j) for j, f in enumerate(self.drive(actuators))]
        for i, t in enumerate(self.m.tendons):
            pull = self.tendon_force(i)
            for j, c in zip(t.joints, t.coefficients, strict=True):
                forces[j] = forces[j] + c * pull
        return forces

    def at_joint(self, j: int, force: Expr) -> Expr:
        """Force or torque at a joint, through its motion port."""
        name = self.rig.port_of("joint", j, "motion")
        passed: Expr = self.port(name, force, position=self.q[j], velocity=self.qd[j])
        return passed

    @cached_property
    def rigid(self) -> Tree:
        """Tree in which every link stands as its joint does."""
        return self.tree()

    @cached_property
    def at_reference(self) -> Tree:
        """Tree in the file's pose, at rest."""
        return self._tree([expression(j.reference) for j in self.m.joints], [ZERO] * len(self.q))

    def tree(self, turned: Mapping[int, Turn] | None = None) -> Tree:
        """Links and motors; turned: angles of the links beyond the motor of their joint."""
        q, qd = list(self.q), list(self.qd)
        for j, (angle, rate) in (turned or {}).items():
            q[j], qd[j] = q[j] + angle, qd[j] + rate
        return self._tree(q, qd)

    def _tree(self, q: list[Expr], qd: list[Expr]) -> Tree:
        value = self.value
        armature = []
        for j, joint in enumerate(self.m.joints):
            total = value("joint", j, "armature", joint.armature)
            for i, a in enumerate(self.m.actuators):
                if a.joint == j and a.armature:
                    gear = self.gear(i)
                    total = total + gear * gear * a.armature
            armature.append(total)
        masses = [value("body", i, "mass", body.mass_kg) for i, body in enumerate(self.m.bodies)]
        shapes = tuple(
            (s.number, (*s.centre(self.p), *s.second_moment(self.p).ravel()))
            for s in self.rig.shapes
        )
        return _shared_tree(self.m, tuple(q), tuple(qd), tuple(masses), tuple(armature), shapes)

    def rates(self) -> dict[str, Number]:
        applied = [self.at_joint(j, force) for j, force in enumerate(self.known_forces())]
        tree, passed = self.flexible_loads(applied)
        rubbing = [self.friction(j) for j in range(tree.n)]
        couplings = [self.coupling(c) for c in self.m.couplings]
        qdd = accelerations(tree, tuple(applied), tuple(passed), tuple(rubbing), tuple(couplings))
        rates: dict[str, Number] = {}
        for joint, qd, a in zip(self.m.joints, self.qd, qdd, strict=True):
            rates[joint.name] = qd
            rates[f"{joint.name}_velocity"] = a
        for i in range(len(self.m.actuators)):
            rates.update(self.actuator_rates(i))
        for j, joint in enumerate(self.m.joints):
            if joint.spring_state:
                rates[joint.spring_state] = self.plastic_rate(j)
        return rates

    def flexible_loads(self, applied: list[Expr]) -> tuple[Tree, list[Expr | None]]:
        """The tree, and the forces that reach its joints behind an elastic transmission.

        An effect may let the load of a joint move against its motor by an angle t. With M' the
        inertias without that motor's, at q + t,

            sum_k M_ik q_k'' = force_i - c_i - M'_ij t''

        A force is None if no such effect reaches the joint. All other joints give way, so that the
        effect sees a single inertia behind a single motor. This is exact for a single such joint.
        """
        turned: dict[int, Turn] = {}
        tree = rigid = self.rigid
        twisting: dict[int, Expr] = {}
        pushed: dict[int, Expr] = {}  # if the motor moves the joint itself
        moving = self.frictionless_accelerations(rigid, applied)
        for j in range(tree.n):
            port = self.rig.port_of("joint", j, "transmission")
            if not port:
                continue
            met = [self.load(rigid, applied, j, moving)]

            def behind(
                torque: Expr, angle: Expr, rate: Expr, j: int = j, met: list[Load] = met
            ) -> Load:
                if angle is ZERO:  # no deflection
                    return met[-1].under(torque - met[-1].torque)
                before = turned.get(j, (ZERO, ZERO))
                turned[j] = before[0] + angle, before[1] + rate
                beyond = self.tree(turned)
                near, moving = met[-1], self.frictionless_accelerations(beyond, applied)
                there = self.load(beyond, applied, j, moving)
                met.append(there)
                return there if torque is near.torque else there.under(torque - near.torque)

            reaching = self.port(
                port,
                met[0].torque,
                position=self.q[j],
                velocity=self.qd[j],
                inertia=met[0].inertia,
                free_fall=met[0].free_fall,
                behind=behind,
                driven=partial(self.drive_change, j),
            )
            if reaching is not met[0].torque and j in turned:
                twisting[j] = (met[-1].torque - reaching) / met[-1].carried
            elif reaching is not met[0].torque:
                pushed[j] = reaching - met[0].torque
        if turned:
            tree = self.tree(turned)
        passed: list[Expr | None] = [None] * tree.n
        for j, more in pushed.items():
            passed[j] = applied[j] - tree.holding[j] + more
        for j, acceleration in twisting.items():
            for i in range(tree.n):
                link = tree.link_inertia(i, j)
                if link is not None:
                    before = passed[i]
                    before = applied[i] - tree.holding[i] if before is None else before
                    passed[i] = before - link * acceleration
        return tree, passed

    def drive_change(self, j: int, angle: Expr, rate: Expr) -> Expr:
        """Change of the drive of joint j if the load lags behind it by an angle."""
        driving = [i for i, a in enumerate(self.m.actuators) if a.tendon < 0 and a.joint == j]

        def drive() -> Expr:
            force = ZERO
            for i in driving:
                gear = self.gear(i)
                force = force + gear * self.actuator_force(i)
            return force

        before = drive()
        q, qd = self.q[j], self.qd[j]
        self.q[j], self.qd[j] = q - angle, qd - rate
        more = drive() - before
        self.q[j], self.qd[j] = q, qd
        return more

    @staticmethod
    def frictionless_accelerations(tree: Tree, applied: list[Expr]) -> list[Expr]:
        """Accelerations of all joints without friction, with every load at its motor."""
        nothing = (None,) * tree.n
        return accelerations(tree, tuple(applied), nothing, nothing)

    def load(self, tree: Tree, applied: list[Expr], j: int, moving: list[Expr]) -> Load:
        """Load of joint j while all other joints give way.

        moving: result of `frictionless_accelerations`.
        """
        inertia = tree.effective_inertia(j)
        carried = maximum(inertia - tree.armature[j], LEAST_INERTIA)
        joint = self.m.joints[j]
        usual = max(joint.typical_inertia - joint.armature, LEAST_INERTIA)
        torque = inertia * moving[j]
        return Load(torque, inertia, carried, (torque - applied[j]) / carried, usual)

    # ---- readings --------------------------------------------------------------------------------

    def reading(self, i: int, sensor: MechanismSensor) -> Expr:
        rate: Expr | None = None
        if sensor.kind in ("jointpos", "jointvel"):
            value, rate = self.q[sensor.of], self.qd[sensor.of]
        elif sensor.kind in ("tendonpos", "tendonvel"):
            value, rate = self.tendon(sensor.of)
        elif sensor.kind in ("actuatorpos", "actuatorvel"):
            value, rate = self.travel(sensor.of)
        elif sensor.mount is not None:
            value = self.mounted(sensor, sensor.mount)
        elif sensor.kind == "actuatorfrc":
            value = self.actuator_force(sensor.of)
        else:
            value = self.drive()[sensor.of]
        if sensor.mount is None and sensor.kind.endswith("vel"):
            assert rate is not None
            value, rate = rate, None
        name = self.rig.port_of("sensor", i, "reading")
        read: Expr = self.port(name, value) if rate is None else self.port(name, value, rate=rate)
        return clip(read, -sensor.cutoff, sensor.cutoff) if sensor.cutoff > 0.0 else read

    def mounted(self, sensor: MechanismSensor, mount: Mount) -> Expr:
        """Reading of a sensor on a frame."""
        tree = self.rigid
        values: Any
        if sensor.kind == "framequat":
            values = tree.quaternion(mount)
        elif sensor.kind == "framepos":
            values = tree.mounted(mount).place
        else:
            motion = tree.motion(mount)
            values = motion.a if sensor.kind in ("gyro", "frameangvel") else motion.b
            if sensor.kind in ("gyro", "velocimeter"):
                values = tree.mounted(mount).local(values)
        value: Expr = values[sensor.component]
        return value


def _affine(law: list[Expr], length: Expr, rate: Expr) -> Expr:
    return law[0] + law[1] * length + law[2] * rate


@lru_cache(maxsize=MODELS_ALIKE)
def _shared_tree(
    mechanism: Mechanism,
    q: tuple[Expr, ...],
    qd: tuple[Expr, ...],
    masses: tuple[Expr, ...],
    armature: tuple[Expr, ...],
    shapes: tuple[tuple[int, tuple[Expr, ...]], ...],
) -> Tree:
    """The same tree for all models in which it is the same, so that each of its parts is built
    once.

    shapes: number of a body, its centre (3) and second moments (3 x 3, row by row).
    """
    parts = {k: (np.array(of[:3]), np.array(of[3:]).reshape(3, 3)) for k, of in shapes}
    return Tree(mechanism, q, qd, masses, armature, parts)
