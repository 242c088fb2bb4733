"""Log names of a mechanism's columns: joints, motors, sensors, indices in MuJoCo's vectors."""

from __future__ import annotations

from pamid.model.rig import LogName
from pamid.rigs.simulators.mechanism import Actuator, Mechanism, MechanismSensor

_COMMANDS = {"position": "position", "velocity": "velocity", "motor": "effort"}
_READINGS = {"pos": "position", "vel": "velocity", "frc": "effort"}


def log_names_of(m: Mechanism) -> dict[str, LogName]:
    """Log names by column of a recording."""
    return {
        **{m.actuators[i].column: _command(m, m.actuators[i]) for i in m.commanded},
        **{s.column: _reading(m, s) for s in m.sensors},
    }


def vector_sizes_of(m: Mechanism) -> dict[str, int]:
    """Lengths of MuJoCo's vectors for this model."""
    activations = sum(not m.actuators[i].is_bare for i in m.commanded)
    forces = 0 if any(a.is_bare for a in m.actuators) else len(m.actuators)
    joints = len(m.joints)
    return {
        "qpos": joints,
        "qvel": joints,
        "qfrc_actuator": joints,
        "ctrl": activations or joints,
        "actuator_force": forces,
        "sensordata": m.sensor_values,
    }


def _command(m: Mechanism, a: Actuator) -> LogName:
    joint = (m.joints[a.joint].name,) if a.joint >= 0 else ()
    plain = a.kind == "motor" and a.dynamics == "none" and a.joint >= 0
    strength = a.gear * a.gain[0]
    return LogName(
        (a.name, *joint),
        _COMMANDS.get(a.kind, ""),
        sent=True,
        places={"ctrl": a.adr if a.adr >= 0 else a.joint},
        per_effort=1.0 / strength if plain and strength else None,
    )


def _reading(m: Mechanism, s: MechanismSensor) -> LogName:
    places = {"sensordata": s.adr} if s.adr >= 0 else {}
    of: tuple[str, ...]
    if s.kind.startswith("joint"):
        joint = m.joints[s.of]
        of = (joint.name,)
        array = {"pos": "qpos", "vel": "qvel", "frc": "qfrc_actuator"}[s.kind[-3:]]
        places[array] = joint.qpos if array == "qpos" else joint.dof
    elif s.mount is not None:
        of = (m.bodies[s.mount.body].name,)
        return LogName((s.name, *of), "", places=places)
    elif s.kind.startswith("actuator"):
        of = (m.actuators[s.of].name,)
        if s.kind.endswith("frc"):
            places["actuator_force"] = s.of
    else:
        of = (m.tendons[s.of].name,)
    return LogName((s.name, *of), _READINGS[s.kind[-3:]], places=places)
