"""Ports of a mechanism: motion and transmission at joints, command at actuators, reading at
sensors.

Recordings and free runs determine the typical size of a port's signal. A joint's inertia does not
contain the gravity that its motor holds, and a command's range does not show how much of it was
used. Only a joint without a drive has a stated size, because nothing but its friction passes there.
"""

from __future__ import annotations

from collections.abc import Sequence

from pamid.rigs.simulators.mechanism import (
    Actuator,
    Coupling,
    MechanismJoint,
    MechanismSensor,
    MechanismTendon,
    ModelPort,
    coupled_joints,
)
from pamid.rigs.simulators.mujoco_parameters import TYPICAL_ACCELERATION


def ports_of(
    joints: Sequence[MechanismJoint],
    tendons: Sequence[MechanismTendon],
    actuators: Sequence[Actuator],
    sensors: Sequence[MechanismSensor],
    couplings: Sequence[Coupling] = (),
    mounted: frozenset[int] = frozenset(),
) -> tuple[ModelPort, ...]:
    """Ports of a mechanism, in the order of the arguments; the port of a joint has the joint's
    name.

    A coupled joint has no transmission, because its load does not give way by itself. The base has
    no motor.

    mounted: numbers of the joints that actuators at bodies move.
    """
    ports: list[ModelPort] = []
    coupled = coupled_joints(couplings, tendons)
    drives = [a for a in actuators if a.column]
    driven = {a.joint for a in drives} | mounted
    driven.update(j for a in drives if a.tendon >= 0 for j in tendons[a.tendon].joints)
    for i, joint in enumerate(joints):
        if joint.kind not in ("hinge", "slide"):
            continue
        force = joint.force_unit
        motion = (("position", joint.unit), ("velocity", f"{joint.unit}/s"))
        # a joint that only gravity moves has no drive force
        usual = max(joint.typical_inertia, 1e-9) * TYPICAL_ACCELERATION
        size = () if i in driven else (("value", usual),)
        ports.append(ModelPort(joint.name, "motion", force, motion, "joint", i, size))
        if i not in coupled and not joint.is_base:
            name = f"{joint.name}_transmission"
            signals = (
                *motion,
                ("inertia", "kg m2" if joint.kind == "hinge" else "kg"),
                ("free_fall", f"{joint.unit}/s2"),
                ("behind", ""),
                ("driven", ""),
            )
            ports.append(ModelPort(name, "transmission", force, signals, "joint", i))
    used_names = {port.name for port in ports}
    for i, actuator in enumerate(actuators):
        if not actuator.column:
            continue
        name = numbered(f"{actuator.name}_command", used_names)
        ports.append(ModelPort(name, "command", actuator.command_unit, (), "actuator", i))
    for i, sensor in enumerate(sensors):
        name = numbered(sensor.name, used_names)
        rates = {"rad": "rad/s", "m": "m/s", "rad/s": "rad/s2", "m/s": "m/s2"}
        place = sensor.mount is None and sensor.kind.endswith("pos")
        offered = (("rate", rates[sensor.unit]),) if place else ()
        ports.append(ModelPort(name, "reading", sensor.unit, offered, "sensor", i))
    return tuple(ports)


def numbered(name: str, used_names: set[str], mark: str = "_") -> str:
    """Name with a mark and a number behind it if it is in use; the result is then in use."""
    stem, count = name, 2
    while name in used_names:
        name, count = f"{stem}{mark}{count}", count + 1
    used_names.add(name)
    return name
