"""Fittable numbers of a MuJoCo file, with their priors.

A number in the file is correct within 20 %, one standard deviation of the logarithm. A zero means
that the term was not measured: a URDF has no armature at all. Armature and damping are still
fitted, with an absolute prior of the size of the joint's actuator, because nothing else can replace
them. Dry friction and springs are fixed at zero. They are effects of the catalogue, which a
diagnosis tries at all joints together, and locates.
"""

from __future__ import annotations

import math

from pamid.base.units import quotient
from pamid.model.parameter import Parameter
from pamid.simulators.mechanism import (
    Actuator,
    Body,
    MechanismJoint,
    MechanismTendon,
    ModelParameter,
    Vector,
    WindingMotor,
    Write,
)
from pamid.simulators.mujoco_file import MujocoFile

STATED_FACTOR = 1.2  # factor, one standard deviation, around the file's value
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
        _mass(i, body) for i, body in enumerate(bodies) if body.mass_kg and _moves(file, i)
    ]
    for i, joint in enumerate(joints):
        if joint.kind in ("hinge", "slide") and not joint.is_base:
            parameters += _of_joint(i, joint, _strength(i, actuators))
    for i, tendon in enumerate(tendons):
        parameters += _of_tendon(i, tendon, joints)
    for i, actuator in enumerate(actuators):
        parameters += [] if actuator.is_bare else _of_actuator(i, actuator)
    return tuple(parameters)


def _moves(file: MujocoFile, body: int) -> bool:
    """True if there is a joint between this body and the world."""
    return bool(file.model.body_weldid[body])


def stated_parameter(name: str, value: float, unit: str, *, fitted: bool = True) -> Parameter:
    """Parameter for a number in the file, known within 20 %."""
    size = abs(value)
    if value > 0.0:
        return Parameter(
            name,
            value,
            value / BOUND_FACTOR,
            value * BOUND_FACTOR,
            unit,
            spread=STATED_FACTOR,
            log=True,
            fitted=fitted,
            source="the model file, correct within 20 %",
        )
    return Parameter(
        name,
        value,
        -BOUND_FACTOR * size,
        -size / BOUND_FACTOR,
        unit,
        spread=(STATED_FACTOR - 1.0) * size,
        fitted=fitted,
        source="the model file, correct within 20 %",
    )


def _absent(name: str, size: float, unit: str, fitted: bool) -> Parameter:
    """Parameter for a number that is zero in the file."""
    spread = ABSENT_SHARE * size
    return Parameter(
        name,
        0.0,
        0.0,
        5.0 * BOUND_FACTOR * spread,
        unit,
        spread=spread,
        fitted=fitted,
        source=f"0 in the model file; prior of the actuator's size, {spread:.3g}",
    )


def _number(
    element: str,
    of: str,
    number: int,
    attribute: str,
    value: float,
    typical: float,
    unit: str,
    *writes: Write,
) -> ModelParameter:
    name = f"{of}_{attribute}" if element != "tendon" else f"{of}_tendon_{attribute}"
    released = attribute in RELEASED
    parameter = (
        stated_parameter(name, value, unit) if value else _absent(name, typical, unit, released)
    )
    return ModelParameter(parameter, element, of, number, attribute, writes, assumed=not value)


def _mass(i: int, body: Body) -> ModelParameter:
    """Mass of a body. The inertia scales with it: the same shape, of another density."""
    inertia = (Write("body_inertia", i, k, body.inertia[k] / body.mass_kg) for k in range(3))
    return _number(
        "body", body.name, i, "mass", body.mass_kg, 1.0, "kg", Write("body_mass", i, -1, 1.0),
        *inertia,
    )  # fmt: skip


def _strength(joint: int, actuators: tuple[Actuator, ...]) -> float:
    """Largest force or torque of a joint's actuators; 0 without limits."""
    return sum(abs(a.gear) * max(map(abs, _limits(a))) for a in actuators if a.joint == joint)


def _limits(a: Actuator) -> tuple[float, ...]:
    if a.force_range is not None:
        return a.force_range
    commanded = a.command_range if a.kind == "motor" and a.command_range else (0.0, 0.0)
    return tuple(a.gain[0] * command for command in commanded)


def _of_joint(i: int, joint: MechanismJoint, strength: float) -> list[ModelParameter]:
    # inertia for the actuator: that of its largest load
    inertia = max(joint.typical_inertia, strength / TYPICAL_ACCELERATION, 1e-9)
    force, velocity = joint.force_unit, f"{joint.unit}/s"

    def of(attribute: str, value: float, typical: float, unit: str, array: str, row: int):  # type: ignore[no-untyped-def]
        return _number(
            "joint", joint.name, i, attribute, value, typical, unit, Write(array, row, -1, 1.0)
        )

    parameters = [
        of("damping", joint.damping, inertia * TYPICAL_RATE, quotient(force, velocity),
           "dof_damping", joint.dof),
        of("frictionloss", joint.friction_loss, inertia * TYPICAL_ACCELERATION, force,
           "dof_frictionloss", joint.dof),
        of("armature", joint.armature, inertia, "kg m2" if joint.kind == "hinge" else "kg",
           "dof_armature", joint.dof),
        of("stiffness", joint.stiffness, inertia * TYPICAL_RATE**2, quotient(force, joint.unit),
           "jnt_stiffness", i),
    ]  # fmt: skip
    parameters += _powers(
        "joint", joint.name, i, force, joint.unit, joint.damping_powers, joint.stiffness_powers,
        ("dof_dampingpoly", joint.dof), ("jnt_stiffnesspoly", i),
    )  # fmt: skip
    if joint.spring_yield:
        parameters.append(
            of("springyield", joint.spring_yield, 1.0, joint.unit, "jnt_springyield", i)
        )
    return parameters


def _powers(
    element: str,
    of: str,
    number: int,
    force: str,
    length: str,
    damping: Vector,
    stiffness: Vector,
    damping_place: tuple[str, int],
    stiffness_place: tuple[str, int],
) -> list[ModelParameter]:
    """Coefficients of the second and third power in the file."""
    parameters = []
    for word, stated, (array, row), x in (
        ("damping", damping, damping_place, f"{length}/s"),
        ("stiffness", stiffness, stiffness_place, length),
    ):
        for k, power in enumerate(("quadratic", "cubic")):
            if stated[k]:
                unit = quotient(force, *([x] * (k + 2)))
                parameters.append(
                    _number(element, of, number, f"{word}_{power}", stated[k], 1.0, unit,
                            Write(array, row, k, 1.0))
                )  # fmt: skip
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
        _number("tendon", tendon.name, i, attribute, value, 1.0, unit,
                Write(f"tendon_{attribute}", i, -1, 1.0))
        for attribute, value, unit in rows
        if value and tendon.joints
    ]  # fmt: skip
    return parameters + _powers(
        "tendon", tendon.name, i, force, length, tendon.damping_powers, tendon.stiffness_powers,
        ("tendon_dampingpoly", i), ("tendon_stiffnesspoly", i),
    )  # fmt: skip


def _of_actuator(i: int, actuator: Actuator) -> list[ModelParameter]:
    """Gains and the time constant.

    A motor's gain is fixed. A free gain would allow a common factor on every mass, damping and gain
    that no reading reveals.
    """
    name, parameters = actuator.name, []

    def of(attribute: str, parameter: Parameter, *writes: Write) -> ModelParameter:
        return ModelParameter(parameter, "actuator", name, i, attribute, writes)

    # the unit of a gain follows from those of command and force
    per_command = quotient(actuator.force_unit, actuator.command_unit or "1")
    gain, bias = actuator.gain, actuator.bias
    if actuator.kind in ("position", "velocity"):
        place = 1 if actuator.kind == "position" else 2
        word = "kp" if actuator.kind == "position" else "kv"
        parameters.append(
            of(
                word,
                stated_parameter(f"{name}_{word}", gain[0], _gain_unit(actuator, word)),
                Write("actuator_gainprm", i, 0, 1.0),
                Write("actuator_biasprm", i, place, -1.0),
            )
        )
        if actuator.kind == "position" and bias[2]:
            parameters.append(
                of(
                    "kv",
                    stated_parameter(f"{name}_kv", -bias[2], _gain_unit(actuator, "kv")),
                    Write("actuator_biasprm", i, 2, -1.0),
                )
            )
    elif actuator.motor is not None:
        parameters += _of_motor(i, actuator, actuator.motor)
    elif gain[0]:
        held = stated_parameter(
            f"{name}_gain", gain[0], per_command, fitted=actuator.kind == "general"
        )
        parameters.append(of("gain", held, Write("actuator_gainprm", i, 0, 1.0)))
    if actuator.time_constant_s > 0.0:
        constant = stated_parameter(f"{name}_time_constant", actuator.time_constant_s, "s")
        parameters.append(of("time_constant", constant, Write("actuator_dynprm", i, 0, 1.0)))
    if math.isfinite(actuator.gear) and actuator.gear and actuator.mount is None:
        held = stated_parameter(f"{name}_gear", actuator.gear, "", fitted=False)
        parameters.append(of("gear", held, Write("actuator_gear", i, 0, 1.0)))
    if actuator.delay_s > 0.0:
        delay = stated_parameter(f"{name}_delay", actuator.delay_s, "s")
        parameters.append(of("delay", delay, Write("actuator_delay", i, -1, 1.0)))
    return parameters


def _of_motor(i: int, actuator: Actuator, motor: WindingMotor) -> list[ModelParameter]:
    """Parameters of a winding, its controller, its cogging and its bristles.

    The resistance is fixed, because a motor of twice the resistance drives half of all masses,
    dampings and frictions in the same way. A controller commands torque, and without a limit the
    winding does not show in it.
    """
    force, length = actuator.force_unit, "rad" if actuator.force_unit == "N m" else "m"
    rate, parameters = f"{length}/s", []
    shows = motor.input in ("voltage", "none")
    kp, ki, kd = motor.controller
    stiffness, damping, sliding, static, speed = motor.bristles
    rows = [
        ("resistance", motor.constant and motor.resistance, "Ohm", False, "gainprm", 0),
        ("motorconst", motor.constant, quotient(force, "A"), shows, "gainprm", 1),
        ("kp", kp, quotient(force, length), True, "gainprm", 4),
        ("ki", ki, quotient(force, length, "s"), True, "gainprm", 5),
        ("kd", kd, quotient(force, rate), True, "gainprm", 6),
        ("cogging", motor.cogging[0], force, True, "biasprm", 0),
    ]
    if motor.heating[0]:
        rows += [
            ("thermal_resistance", motor.heating[0], "K/W", False, "dynprm", 2),
            ("thermal_capacitance", motor.heating[1], "J/K", False, "dynprm", 3),
        ]
    if stiffness:
        rows += [
            ("lugre_stiffness", stiffness, quotient(force, length), True, "dynprm", 5),
            ("lugre_damping", damping, quotient(force, rate), True, "dynprm", 6),
            ("lugre_coulomb", sliding, force, True, "biasprm", 3),
            ("lugre_static", static, force, True, "biasprm", 4),
            ("lugre_stribeck", speed, rate, True, "biasprm", 5),
        ]
    for word, value, unit, fitted, array, place in rows:
        if value:
            parameter = stated_parameter(f"{actuator.name}_{word}", value, unit, fitted=fitted)
            write = Write(f"actuator_{array}", i, place, 1.0)
            parameters.append(
                ModelParameter(parameter, "actuator", actuator.name, i, word, (write,))
            )
    return parameters


def _gain_unit(actuator: Actuator, word: str) -> str:
    length = "rad" if actuator.force_unit == "N m" else "m"
    return quotient(actuator.force_unit, length if word == "kp" else f"{length}/s")
