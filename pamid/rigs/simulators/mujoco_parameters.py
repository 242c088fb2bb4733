"""Fittable numbers of a MuJoCo file, with their priors.

A number in the file is correct within 20 %, a standard deviation of the logarithm. A zero means
that the term was not measured: a URDF has no armature at all. Armature and damping are still
fitted, with an absolute prior of the size of the joint's actuator, because nothing else can replace
them. Dry friction and springs are fixed at zero. They are effects of the catalogue, which a
diagnosis tries at all joints together, and locates.
"""

from __future__ import annotations

import math

from pamid.base.units import quotient
from pamid.model.parameter import Parameter
from pamid.rigs.simulators.mechanism import (
    Actuator,
    Body,
    MechanismJoint,
    MechanismTendon,
    ModelParameter,
    WindingMotor,
    Write,
)
from pamid.rigs.simulators.mujoco_file import MujocoFile

STATED_FACTOR = 1.2  # factor, a standard deviation, around the file's value
BOUND_FACTOR = 10.0  # factor from the file's value to the bounds
ABSENT_SHARE = 0.2  # standard deviation of a value that is zero in the file, over its typical size
TYPICAL_RATE = 1.0  # 1/s, of a typical damping over the inertia
TYPICAL_ACCELERATION = 10.0  # rad/s2 or m/s2, of a typical friction over the inertia
RELEASED = ("armature", "damping")  # of a joint, fitted although the file states zero


def parameters_of(
    file: MujocoFile,
    bodies: tuple[Body, ...],
    joints: tuple[MechanismJoint, ...],
    tendons: tuple[MechanismTendon, ...],
    actuators: tuple[Actuator, ...],
) -> tuple[ModelParameter, ...]:
    """All parameters, bodies first, then joints, tendons and actuators."""
    parameters = [
        _mass(i, body)
        for i, body in enumerate(bodies)
        if body.mass_kg and file.model.body_weldid[i]  # a joint between it and the world
    ]
    for i, joint in enumerate(joints):
        if joint.kind in ("hinge", "slide") and not joint.is_base:
            parameters += _of_joint(i, joint, [a for a in actuators if a.joint == i])
    for i, tendon in enumerate(tendons):
        parameters += _of_tendon(i, tendon, joints)
    for i, actuator in enumerate(actuators):
        parameters += [] if actuator.is_bare else _of_actuator(i, actuator)
    return tuple(parameters)


def stated_parameter(name: str, value: float, unit: str, *, fitted: bool = True) -> Parameter:
    """Parameter for a number in the file, known within 20 %."""
    size, positive = abs(value), bool(value > 0.0)
    near, far = size / BOUND_FACTOR, BOUND_FACTOR * size
    low, high = (near, far) if positive else (-far, -near)
    return Parameter(
        name,
        value,
        low,
        high,
        unit,
        spread=STATED_FACTOR if positive else (STATED_FACTOR - 1.0) * size,
        log=positive,
        fitted=fitted,
        source="the model file, correct within 20 %",
    )


def _number(
    element: str,
    of: str,
    number: int,
    attribute: str,
    value: float,
    unit: str,
    *writes: Write,
    typical: float = 1.0,
) -> ModelParameter:
    name = f"{of}_{attribute}" if element != "tendon" else f"{of}_tendon_{attribute}"
    if value:
        parameter = stated_parameter(name, value, unit)
    else:
        spread = ABSENT_SHARE * typical
        parameter = Parameter(
            name,
            0.0,
            0.0,
            5.0 * BOUND_FACTOR * spread,
            unit,
            spread=spread,
            fitted=attribute in RELEASED,
            source=f"0 in the model file; prior of the actuator's size, {spread:.3g}",
        )
    return ModelParameter(parameter, element, of, number, attribute, writes)


def _mass(i: int, body: Body) -> ModelParameter:
    """Mass of a body. The inertia scales with it: the same shape, of another density."""
    inertia = (Write("body_inertia", i, k, body.inertia[k] / body.mass_kg) for k in range(3))
    mass = Write("body_mass", i, -1, 1.0)
    return _number("body", body.name, i, "mass", body.mass_kg, "kg", mass, *inertia)


def _of_joint(i: int, joint: MechanismJoint, actuators: list[Actuator]) -> list[ModelParameter]:
    strength = 0.0  # largest force or torque of the actuators, 0 without limits
    for a in actuators:
        limits = a.force_range
        if limits is None and a.kind == "motor" and a.command_range:
            limits = a.gain[0] * a.command_range[0], a.gain[0] * a.command_range[1]
        strength += abs(a.gear) * max(map(abs, limits or (0.0, 0.0)))
    # inertia for the actuator: that of its largest load
    inertia = max(joint.typical_inertia, strength / TYPICAL_ACCELERATION, 1e-9)
    force, length, dof = joint.force_unit, joint.unit, joint.dof
    damping, stiffness = quotient(force, f"{length}/s"), quotient(force, length)
    mass = "kg m2" if joint.kind == "hinge" else "kg"
    weak = inertia * TYPICAL_RATE
    rows = [
        ("damping", joint.damping, damping, "dof_damping", dof, weak),
        ("frictionloss", joint.friction_loss, force, "dof_frictionloss", dof,
         inertia * TYPICAL_ACCELERATION),
        ("armature", joint.armature, mass, "dof_armature", dof, inertia),
        ("stiffness", joint.stiffness, stiffness, "jnt_stiffness", i, weak * TYPICAL_RATE),
    ]  # fmt: skip

    def of(
        word: str, value: float, unit: str, array: str, row: int, typical: float
    ) -> ModelParameter:
        write = Write(array, row, -1, 1.0)
        return _number("joint", joint.name, i, word, value, unit, write, typical=typical)

    parameters = [of(*row) for row in rows]
    parameters += _powers("joint", joint.name, i, joint, (force, length), ("dof", dof), ("jnt", i))
    if joint.spring_yield:
        parameters.append(of("springyield", joint.spring_yield, length, "jnt_springyield", i, 1.0))
    return parameters


def _powers(
    element: str,
    of: str,
    number: int,
    owner: MechanismJoint | MechanismTendon,
    units: tuple[str, str],
    damping: tuple[str, int],
    stiffness: tuple[str, int],
) -> list[ModelParameter]:
    """Coefficients of the second and third power in the file.

    units: of force and length; damping, stiffness: prefix of their array, and row in it.
    """
    force, length = units
    parameters = []
    for word, stated, (prefix, row), x in (
        ("damping", owner.damping_powers, damping, f"{length}/s"),
        ("stiffness", owner.stiffness_powers, stiffness, length),
    ):
        for k, power in enumerate(("quadratic", "cubic")):
            if stated[k]:
                unit, name = quotient(force, *([x] * (k + 2))), f"{word}_{power}"
                write = Write(f"{prefix}_{word}poly", row, k, 1.0)
                parameters.append(_number(element, of, number, name, stated[k], unit, write))
    return parameters


def _of_tendon(
    i: int, tendon: MechanismTendon, joints: tuple[MechanismJoint, ...]
) -> list[ModelParameter]:
    """Parameters in the file only, because a tendon is rarely more than a coupling of joints."""
    hinges = all(joints[j].kind == "hinge" for j in tendon.joints)
    force, length = ("N m", "rad") if hinges else ("N", "m")
    rows = (
        ("damping", tendon.damping, quotient(force, f"{length}/s")),
        ("frictionloss", tendon.friction_loss, force),
        ("stiffness", tendon.stiffness, quotient(force, length)),
    )
    parameters = [
        _number("tendon", tendon.name, i, word, value, unit, Write(f"tendon_{word}", i, -1, 1.0))
        for word, value, unit in rows
        if value and tendon.joints
    ]
    places = ("tendon", i), ("tendon", i)
    return parameters + _powers("tendon", tendon.name, i, tendon, (force, length), *places)


def _of_actuator(i: int, actuator: Actuator) -> list[ModelParameter]:
    """Gains and the time constant.

    A motor's gain is fixed. A free gain would allow a common factor on every mass, damping and gain
    that no reading reveals.
    """
    parameters: list[ModelParameter] = []

    def add(word: str, value: float, unit: str, *writes: Write, fitted: bool = True) -> None:
        parameter = stated_parameter(f"{actuator.name}_{word}", value, unit, fitted=fitted)
        parameters.append(ModelParameter(parameter, "actuator", actuator.name, i, word, writes))

    def place(array: str, column: int, factor: float = 1.0) -> Write:
        return Write(f"actuator_{array}", i, column, factor)

    gain, bias = actuator.gain, actuator.bias
    if actuator.kind == "position":
        kp = place("gainprm", 0), place("biasprm", 1, -1.0)
        add("kp", gain[0], _gain_unit(actuator, "kp"), *kp)
        if bias[2]:
            add("kv", -bias[2], _gain_unit(actuator, "kv"), place("biasprm", 2, -1.0))
    elif actuator.kind == "velocity":
        kv = place("gainprm", 0), place("biasprm", 2, -1.0)
        add("kv", gain[0], _gain_unit(actuator, "kv"), *kv)
    elif actuator.motor is not None:
        for word, value, unit, fitted, array, column in _motor_rows(actuator, actuator.motor):
            if value:
                add(word, value, unit, place(array, column), fitted=fitted)
    elif gain[0]:
        # the unit of a gain follows from those of command and force
        unit, general = quotient(actuator.force_unit, actuator.command_unit or "1"), "general"
        add("gain", gain[0], unit, place("gainprm", 0), fitted=actuator.kind == general)
    if actuator.time_constant_s > 0.0:
        add("time_constant", actuator.time_constant_s, "s", place("dynprm", 0))
    if math.isfinite(actuator.gear) and actuator.gear and actuator.mount is None:
        add("gear", actuator.gear, "", place("gear", 0), fitted=False)
    if actuator.delay_s > 0.0:
        add("delay", actuator.delay_s, "s", place("delay", -1))
    return parameters


def _motor_rows(
    actuator: Actuator, motor: WindingMotor
) -> list[tuple[str, float, str, bool, str, int]]:
    """Parameters of a winding, its controller, its cogging and its bristles.

    The resistance is fixed, because a motor of twice the resistance drives half of all masses,
    dampings and frictions in the same way. A controller commands torque, and without a limit the
    winding does not show in it.
    """
    force, length = actuator.force_unit, "rad" if actuator.force_unit == "N m" else "m"
    rate = f"{length}/s"
    shows = motor.input in ("voltage", "none")
    kp, ki, kd = motor.controller
    resistance, capacitance = motor.heating[:2] if motor.heating[0] else (0.0, 0.0)
    stiffness, damping, sliding, static, speed = motor.bristles if motor.bristles[0] else [0.0] * 5
    return [
        ("resistance", motor.constant and motor.resistance, "Ohm", False, "gainprm", 0),
        ("motorconst", motor.constant, quotient(force, "A"), shows, "gainprm", 1),
        ("kp", kp, quotient(force, length), True, "gainprm", 4),
        ("ki", ki, quotient(force, length, "s"), True, "gainprm", 5),
        ("kd", kd, quotient(force, rate), True, "gainprm", 6),
        ("cogging", motor.cogging[0], force, True, "biasprm", 0),
        ("thermal_resistance", resistance, "K/W", False, "dynprm", 2),
        ("thermal_capacitance", capacitance, "J/K", False, "dynprm", 3),
        ("lugre_stiffness", stiffness, quotient(force, length), True, "dynprm", 5),
        ("lugre_damping", damping, quotient(force, rate), True, "dynprm", 6),
        ("lugre_coulomb", sliding, force, True, "biasprm", 3),
        ("lugre_static", static, force, True, "biasprm", 4),
        ("lugre_stribeck", speed, rate, True, "biasprm", 5),
    ]


def _gain_unit(actuator: Actuator, word: str) -> str:
    length = "rad" if actuator.force_unit == "N m" else "m"
    return quotient(actuator.force_unit, length if word == "kp" else f"{length}/s")
