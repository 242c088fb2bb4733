"""Ports of a mechanism: a motion and a transmission at every joint, a command at every actuator, a
reading at every sensor."""

from __future__ import annotations

from collections.abc import Sequence

from pamid.simulators.mechanism import Actuator, MechanismJoint, MechanismSensor, ModelPort
from pamid.simulators.mujoco_parameters import TYPICAL_ACCELERATION


def ports_of(
    joints: Sequence[MechanismJoint],
    actuators: Sequence[Actuator],
    sensors: Sequence[MechanismSensor],
) -> tuple[ModelPort, ...]:
    """All of them, in this order; the port of a joint has the joint's own name."""
    found: list[ModelPort] = []
    for i, joint in enumerate(joints):
        if joint.kind in ("hinge", "slide"):
            found += _at_joint(i, joint)
    taken = {port.name for port in found}
    for i, actuator in enumerate(actuators):
        size = _command_size(actuator)
        name = _fresh(f"{actuator.name}_command", taken)
        found.append(ModelPort(name, "command", actuator.command_unit, (), "actuator", i, size))
    for i, sensor in enumerate(sensors):
        name = _fresh(sensor.name, taken)
        rates = {"rad": "rad/s", "m": "m/s", "rad/s": "rad/s2", "m/s": "m/s2"}
        offered = (("rate", rates[sensor.unit]),) if sensor.kind.endswith("pos") else ()
        found.append(ModelPort(name, "reading", sensor.unit, offered, "sensor", i))
    return tuple(found)


def _at_joint(i: int, joint: MechanismJoint) -> list[ModelPort]:
    inertia = "kg m2" if joint.kind == "hinge" else "kg"
    motion = (("position", joint.unit), ("velocity", f"{joint.unit}/s"))
    # a joint that only gravity moves passes no force of its own
    size = (("value", max(joint.typical_inertia, 1e-9) * TYPICAL_ACCELERATION),)
    return [
        ModelPort(joint.name, "motion", joint.force_unit, motion, "joint", i, size),
        ModelPort(
            f"{joint.name}_transmission",
            "transmission",
            joint.force_unit,
            (*motion, ("inertia", inertia)),
            "joint",
            i,
            size,
        ),
    ]


def _command_size(actuator: Actuator) -> tuple[tuple[str, float], ...]:
    if actuator.command_range is None:
        return ()
    low, high = actuator.command_range
    return (("value", 0.5 * (high - low)),)


def _fresh(name: str, taken: set[str]) -> str:
    stem, count = name, 2
    while name in taken:
        name, count = f"{stem}_{count}", count + 1
    taken.add(name)
    return name
