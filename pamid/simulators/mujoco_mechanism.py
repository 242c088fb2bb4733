"""From a loaded MuJoCo model to a `Mechanism`: elements, parameters, ports and what hinders."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from pamid.base.files import PathLike
from pamid.base.units import NONE, quotient, split_column, with_unit
from pamid.simulators.mechanism import (
    Actuator,
    Body,
    Mechanism,
    MechanismJoint,
    MechanismSensor,
    MechanismTendon,
    Range,
    Vector,
)
from pamid.simulators.mujoco_file import MujocoFile, open_mujoco
from pamid.simulators.mujoco_findings import can_collide, contact_share, findings_of
from pamid.simulators.mujoco_parameters import parameters_of
from pamid.simulators.mujoco_ports import numbered, ports_of

#: what a sensor reads: (element, place of its value's unit among position, velocity and force)
SENSORS = {
    "jointpos": ("joint", 0),
    "jointvel": ("joint", 1),
    "jointactfrc": ("joint", 2),
    "tendonpos": ("tendon", 0),
    "tendonvel": ("tendon", 1),
    "actuatorpos": ("actuator", 0),
    "actuatorvel": ("actuator", 1),
    "actuatorfrc": ("actuator", 2),
}
DYNAMICS = {"integrator": "integrator", "filter": "filter", "filterexact": "filter"}
_HINGE, _SLIDE = ("rad", "rad/s", "N m"), ("m", "m/s", "N")


def read_mechanism(path: PathLike) -> Mechanism:
    """The mechanism in an MJCF or URDF file. FileError: see `open_mujoco`; what cannot be carried
    over is told in its `findings`, and raises nothing."""
    return mechanism_of(open_mujoco(path))


def mechanism_of(file: MujocoFile) -> Mechanism:
    """The mechanism of a loaded file."""
    names = _Names(file)
    joints = _joints(file, names)
    tendons = _tendons(file, names, joints)
    actuators = _actuators(file, names, joints, tendons)
    taken = {a.column for a in actuators}
    sensors = _sensors(file, names, joints, tendons, actuators, taken)
    share, met = contact_share(file)
    bodies = _bodies(file, names)
    option = file.model.opt
    return Mechanism(
        str(file.path),
        _word(Path(file.path).stem),
        float(option.timestep),
        _vector(option.gravity),
        bodies,
        joints,
        tendons,
        actuators,
        sensors,
        parameters_of(file, bodies, joints, tendons, actuators),
        ports_of(joints, tendons, actuators, sensors),
        findings_of(file, share, met),
        share,
        int(file.model.nsensordata),
        can_collide(file),
    )


# ---- names and numbers ---------------------------------------------------------------------------


class _Names:
    """Names of a file's elements as plain words, each once among its like."""

    def __init__(self, file: MujocoFile) -> None:
        self.file = file
        self.used: dict[str, set[str]] = {}

    def of(self, kind: str, number: int) -> str:
        return numbered(_word(self.file.name(kind, number)), self.used.setdefault(kind, set()))


def _word(name: str) -> str:
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return plain if plain[:1].isalpha() else f"_{plain}"


def _vector(values: Iterable[Any]) -> Vector:
    return tuple(float(v) for v in values)


def _range(limited: Any, values: Any) -> Range | None:
    return (float(values[0]), float(values[1])) if limited else None


def softness(file: MujocoFile, dof: int) -> tuple[float, float]:
    """Rate (1/s) and softness of a joint's friction: MuJoCo's b and R (documentation, Computation,
    Constraint model), from solreffriction and solimpfriction."""
    m = file.model
    low, high = (min(max(float(v), 1e-4), 0.9999) for v in m.dof_solimp[dof, :2])
    first, second = map(float, m.dof_solref[dof])
    if first > 0.0:
        safe = not m.opt.disableflags & int(file.mujoco.mjtDisableBit.mjDSBL_REFSAFE)
        first = max(first, 2.0 * float(m.opt.timestep)) if safe else first
    rate = -second / high if first <= 0.0 else 2.0 / (high * first)
    return rate, max((1.0 - low) / low * float(m.dof_invweight0[dof]), 1e-15)


# ---- elements ------------------------------------------------------------------------------------


def _bodies(file: MujocoFile, names: _Names) -> tuple[Body, ...]:
    m = file.model
    return tuple(
        Body(
            names.of("body", i),
            int(m.body_parentid[i]) if i else -1,
            _vector(m.body_pos[i]),
            _vector(m.body_quat[i]),
            float(m.body_mass[i]),
            _vector(m.body_ipos[i]),
            _vector(m.body_iquat[i]),
            _vector(m.body_inertia[i]),
            file.line("body", i),
        )
        for i in range(m.nbody)
    )


def _joints(file: MujocoFile, names: _Names) -> tuple[MechanismJoint, ...]:
    m, found = file.model, []
    for i in range(m.njnt):
        q, v = m.jnt_qposadr[i], m.jnt_dofadr[i]
        found.append(
            MechanismJoint(
                names.of("joint", i),
                file.word("mjtJoint", m.jnt_type[i]),
                int(m.jnt_bodyid[i]),
                _vector(m.jnt_axis[i]),
                _vector(m.jnt_pos[i]),
                float(m.qpos0[q]),
                float(m.qpos_spring[q]),
                float(m.jnt_stiffness[i]),
                float(m.dof_damping[v]),
                float(m.dof_frictionloss[v]),
                *softness(file, int(v)),
                float(m.dof_armature[v]),
                float(m.dof_M0[v]),
                _range(m.jnt_limited[i], m.jnt_range[i]),
                _range(m.jnt_actfrclimited[i], m.jnt_actfrcrange[i]),
                file.line("joint", i),
                int(q),
                int(v),
            )
        )
    return tuple(found)


def _tendons(
    file: MujocoFile, names: _Names, joints: tuple[MechanismJoint, ...]
) -> tuple[MechanismTendon, ...]:
    m, found = file.model, []
    for i in range(m.ntendon):
        first, count = int(m.tendon_adr[i]), int(m.tendon_num[i])
        fixed = [
            (int(m.wrap_objid[k]), float(m.wrap_prm[k]))
            for k in range(first, first + count)
            if file.word("mjtWrap", m.wrap_type[k]) == "joint"
        ]
        found.append(
            MechanismTendon(
                names.of("tendon", i),
                tuple(j for j, _ in fixed),
                tuple(c for _, c in fixed),
                float(m.tendon_stiffness[i]),
                float(m.tendon_damping[i]),
                float(m.tendon_frictionloss[i]),
                (float(m.tendon_lengthspring[i, 0]), float(m.tendon_lengthspring[i, 1])),
                file.line("tendon", i),
            )
        )
    return tuple(found)


def _kind(gain: Vector, bias: Vector) -> str:
    """What these numbers make of an actuator: MuJoCo's shortcuts motor, position and velocity are
    nothing else."""
    if any(gain[1:]) or bias[0]:
        return "general"
    if not any(bias):
        return "motor"
    if bias[1] == -gain[0]:
        return "position"
    return "velocity" if not bias[1] and bias[2] == -gain[0] else "general"


def _actuators(
    file: MujocoFile,
    names: _Names,
    joints: tuple[MechanismJoint, ...],
    tendons: tuple[MechanismTendon, ...],
) -> tuple[Actuator, ...]:
    m, found = file.model, []
    for i in range(m.nactuator):
        if not m.actuator_ctrlnum[i]:  # a passive force at its joint
            continue
        name, target = names.of("actuator", i), int(m.actuator_trnid[i, 0])
        drives = file.word("mjtTrn", m.actuator_trntype[i])
        at_joint = target if drives in ("joint", "jointinparent") else -1
        at_tendon = target if drives == "tendon" else -1
        law = file.word("mjtGain", m.actuator_gaintype[i])
        affine = law == "affine"
        gain = _vector(m.actuator_gainprm[i, :3]) if affine else (m.actuator_gainprm[i, 0], 0, 0)
        biased = file.word("mjtBias", m.actuator_biastype[i]) == "affine"
        bias = _vector(m.actuator_biasprm[i, :3]) if biased else (0.0, 0.0, 0.0)
        kind = law if law == "dcmotor" else _kind(_vector(gain), bias)
        units = _units_of(joints, tendons, at_joint, at_tendon)
        unit = {"position": units[0], "velocity": units[1]}.get(kind, "")
        how = DYNAMICS.get(file.word("mjtDyn", m.actuator_dyntype[i]), "none")
        unit = quotient(unit, "s") if unit and how == "integrator" else unit
        found.append(
            Actuator(
                name,
                kind,
                at_joint,
                at_tendon,
                float(m.actuator_gear[i, 0]),
                how,
                float(m.actuator_dynprm[i, 0]) if how == "filter" else 0.0,
                _vector(gain),
                bias,
                with_unit(f"{name}_command", unit),
                f"{name}_activation" if how != "none" else "",
                unit,
                units[2],
                _range(m.actuator_ctrllimited[i], m.actuator_ctrlrange[i]),
                _range(m.actuator_forcelimited[i], m.actuator_forcerange[i]),
                _range(m.actuator_actlimited[i], m.actuator_actrange[i]),
                float(m.actuator_armature[i]),
                float(m.actuator_damping[i]),
                float(m.actuator_delay[i]),
                file.line("actuator", i),
                int(m.actuator_ctrladr[i]),
            )
        )
    return tuple(found) or tuple(_bare(joints))


def _bare(joints: tuple[MechanismJoint, ...]) -> Iterator[Actuator]:
    """A force or torque at every joint: of a file without actuators, such as any URDF."""
    for j, joint in enumerate(joints):
        if joint.kind not in ("hinge", "slide"):
            continue
        unit = joint.force_unit
        column = f"{joint.name}_{'torque_nm' if unit == 'N m' else 'force_n'}"
        none = (0.0, 0.0, 0.0)
        yield Actuator(
            joint.name,
            "motor",
            j,
            -1,
            1.0,
            "none",
            0.0,
            (1.0, 0.0, 0.0),
            none,
            column,
            command_unit=unit,
            force_unit=unit,
            command_range=joint.force_range,
        )


def _units_of(
    joints: tuple[MechanismJoint, ...],
    tendons: tuple[MechanismTendon, ...],
    joint: int,
    tendon: int,
) -> tuple[str, str, str]:
    """Units of position, velocity and force at a joint or a tendon: of a tendon those of its
    joints, where they are of one kind."""
    kinds = {joints[joint].kind} if joint >= 0 else set()
    if tendon >= 0:
        kinds = {joints[j].kind for j in tendons[tendon].joints}
    return _HINGE if kinds == {"hinge"} else _SLIDE


def _sensors(
    file: MujocoFile,
    names: _Names,
    joints: tuple[MechanismJoint, ...],
    tendons: tuple[MechanismTendon, ...],
    actuators: tuple[Actuator, ...],
    taken: set[str],
) -> tuple[MechanismSensor, ...]:
    """The sensors that pamid can read; of a file without any, position and velocity of every
    joint."""
    m, found = file.model, []
    for i in range(m.nsensor):
        name, kind = names.of("sensor", i), file.word("mjtSensor", m.sensor_type[i])
        of = int(m.sensor_objid[i])
        if kind not in SENSORS or _is_quaternion(kind, of, joints):
            continue
        element, place = SENSORS[kind]
        if element == "actuator":
            at = (actuators[of].joint, actuators[of].tendon)
        elif element == "joint":
            at = (of, -1)
        else:
            at = (-1, of)
        unit = _units_of(joints, tendons, *at)[place]
        column = _fresh(with_unit(_stem(name, unit), unit), taken)
        found.append(
            MechanismSensor(
                name,
                kind,
                of,
                unit,
                column,
                float(m.sensor_cutoff[i]),
                float(m.sensor_noise[i]),
                int(m.sensor_adr[i]),
                file.line("sensor", i),
            )
        )
    if m.nsensor:
        return tuple(found)
    for i, joint in enumerate(joints):
        if joint.kind not in ("hinge", "slide"):
            continue
        for kind, word, unit in (
            ("jointpos", "position", joint.unit),
            ("jointvel", "velocity", f"{joint.unit}/s"),
        ):
            name = f"{joint.name}_{word}"
            found.append(MechanismSensor(name, kind, i, unit, _fresh(with_unit(name, unit), taken)))
    return tuple(found)


def _stem(name: str, unit: str) -> str:
    """The name without a unit at its end, where that is the one which follows anyway."""
    stem, written = split_column(name)
    return stem if written != NONE and with_unit(stem, unit) == name.lower() else name


def _is_quaternion(kind: str, of: int, joints: tuple[MechanismJoint, ...]) -> bool:
    return kind.startswith("joint") and joints[of].kind not in ("hinge", "slide")


def _fresh(column: str, taken: set[str]) -> str:
    while column in taken:
        column = f"read_{column}"
    taken.add(column)
    return column
