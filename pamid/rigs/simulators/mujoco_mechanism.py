"""Conversion of a loaded MuJoCo model to a `Mechanism`: elements, parameters, ports, hindrances."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from pamid.base.files import PathLike
from pamid.base.units import NONE, quotient, split_column, with_unit
from pamid.rigs.simulators.mechanism import (
    Actuator,
    Body,
    Coupling,
    Mechanism,
    MechanismJoint,
    MechanismSensor,
    MechanismTendon,
    Mount,
    Range,
    Vector,
    WindingMotor,
)
from pamid.rigs.simulators.mujoco_file import MujocoFile, open_mujoco
from pamid.rigs.simulators.mujoco_findings import (
    FRAMES,
    SENSORS,
    can_collide,
    contact_share,
    findings_of,
    reads_frame,
)
from pamid.rigs.simulators.mujoco_parameters import parameters_of
from pamid.rigs.simulators.mujoco_ports import numbered, ports_of

DYNAMICS = {
    "integrator": "integrator",
    "filter": "filter",
    "filterexact": "filter",
    "dcmotor": "dcmotor",
}
#: meaning of a winding motor's command, by MuJoCo's bits
INPUTS = {1: "pos", 2: "vel", 4: "ff", 8: "voltage", 16: "none"}
_HINGE, _SLIDE = ("rad", "rad/s", "N m"), ("m", "m/s", "N")


def read_mechanism(path: PathLike) -> Mechanism:
    """Mechanism in an MJCF or URDF file.

    Parts that cannot be carried over are listed in its `findings` and raise nothing. FileError: see
    `open_mujoco`.
    """
    return mechanism_of(open_mujoco(path))


def mechanism_of(file: MujocoFile) -> Mechanism:
    """Mechanism of a loaded file."""
    names = _Names(file)
    joints = _joints(file, names)
    tendons = _tendons(file, names, joints)
    couplings = _couplings(file)
    followers = {c.first for c in couplings if c.kind == "joint" and c.second >= 0}
    actuators = _actuators(file, names, joints, tendons, followers)
    used_names = {a.column for a in actuators}
    sensors = _sensors(file, names, joints, tendons, actuators, used_names)
    share, met = contact_share(file)
    bodies = _bodies(file, names)
    option = file.model.opt
    mechanism = Mechanism(
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
        (),
        findings_of(file, share, met),
        share,
        int(file.model.nsensordata),
        couplings,
        can_collide(file),
    )
    mounts = [a.mount.body for a in actuators if a.mount is not None]
    moved = frozenset(j for body in mounts for j in mechanism.chain(body))
    return replace(mechanism, ports=ports_of(joints, tendons, actuators, sensors, couplings, moved))


# ---- names and numbers ---------------------------------------------------------------------------


class _Names:
    """Names of a file's elements as plain words, unique among elements of a kind."""

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
    """Rate (1/s) and relative softness of a joint's friction, from solreffriction and
    solimpfriction: MuJoCo's b, and R without its inverse inertia (documentation, Computation,
    Constraint model)."""
    m = file.model
    low = _impedance(m.dof_solimp[dof, 0])
    rate, _ = reference_law(file, m.dof_solref[dof], m.dof_solimp[dof, 1])
    return rate, (1.0 - low) / low


def _impedance(value: Any) -> float:
    return min(max(float(value), 1e-4), 0.9999)


def reference_law(file: MujocoFile, solref: Any, impedance_at_width: Any) -> tuple[float, float]:
    """MuJoCo's b (1/s) and k (1/s2) of a constraint: its reference acceleration is -b v - k d r
    (documentation, Modeling, Solver parameters, Reference)."""
    m, high = file.model, _impedance(impedance_at_width)
    first, second = map(float, solref)
    if first <= 0.0:
        return -second / high, -first / high**2
    if not file.disables("REFSAFE"):
        first = max(first, 2.0 * float(m.opt.timestep))
    stiffness = 1.0 / (high * first * second) ** 2 if second > 0.0 else 0.0
    return 2.0 / (high * first), stiffness


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
            float(m.body_gravcomp[i]),
        )
        for i in range(m.nbody)
    )


def _joints(file: MujocoFile, names: _Names) -> tuple[MechanismJoint, ...]:
    m, joints = file.model, []
    for i in range(m.njnt):
        q, v = m.jnt_qposadr[i], m.jnt_dofadr[i]
        joints.append(
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
                _vector(m.dof_dampingpoly[v]),
                _vector(m.jnt_stiffnesspoly[i]),
                float(m.jnt_springyield[i]),
                bool(m.jnt_actgravcomp[i]),
                file.name("joint", i) in file.free.floating,
            )
        )
    return tuple(joints)


def _tendons(
    file: MujocoFile, names: _Names, joints: tuple[MechanismJoint, ...]
) -> tuple[MechanismTendon, ...]:
    m, tendons = file.model, []
    for i in range(m.ntendon):
        first, count = int(m.tendon_adr[i]), int(m.tendon_num[i])
        fixed = [
            (int(m.wrap_objid[k]), float(m.wrap_prm[k]))
            for k in range(first, first + count)
            if file.word("mjtWrap", m.wrap_type[k]) == "joint"
        ]
        tendons.append(
            MechanismTendon(
                names.of("tendon", i),
                tuple(j for j, _ in fixed),
                tuple(c for _, c in fixed),
                float(m.tendon_stiffness[i]),
                float(m.tendon_damping[i]),
                float(m.tendon_frictionloss[i]),
                (float(m.tendon_lengthspring[i, 0]), float(m.tendon_lengthspring[i, 1])),
                _vector(m.tendon_dampingpoly[i]),
                _vector(m.tendon_stiffnesspoly[i]),
            )
        )
    return tuple(tendons)


def _couplings(file: MujocoFile) -> tuple[Coupling, ...]:
    """Equalities between joints or fixed tendons."""
    m, couplings = file.model, []
    if file.disables("EQUALITY"):
        return ()
    for i in range(m.neq):
        kind = file.word("mjtEq", m.eq_type[i])
        if kind not in ("joint", "tendon") or not m.eq_active0[i]:
            continue
        first, second = int(m.eq_obj1id[i]), int(m.eq_obj2id[i])
        ends = [end for end in (first, second) if end >= 0]
        if kind == "joint":
            references = [float(m.qpos0[m.jnt_qposadr[j]]) for j in ends]
        else:
            references = [float(m.tendon_length0[t]) for t in ends]
        couplings.append(
            Coupling(
                kind,
                first,
                second,
                (references[0], references[-1]),
                _vector(m.eq_data[i, :5]),
                *reference_law(file, m.eq_solref[i], m.eq_solimp[i, 1]),
                _vector(m.eq_solimp[i]),
            )
        )
    return tuple(couplings)


def _kind(gain: Vector, bias: Vector) -> str:
    """Kind of an actuator according to its numbers.

    MuJoCo's shortcuts motor, position and velocity are nothing but such numbers.
    """
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
    followers: set[int],
) -> tuple[Actuator, ...]:
    m, actuators = file.model, []
    for i in range(m.nactuator):
        name, target = names.of("actuator", i), int(m.actuator_trnid[i, 0])
        drives = file.word("mjtTrn", m.actuator_trntype[i])
        at_joint = target if drives in ("joint", "jointinparent") else -1
        at_tendon = target if drives == "tendon" else -1
        mount, wrench = None, _vector(m.actuator_gear[m.actuator_outadr[i]])
        if drives == "site":
            mount = _mount(file, int(file.mujoco.mjtObj.mjOBJ_SITE), target)
        law = file.word("mjtGain", m.actuator_gaintype[i])
        affine = law == "affine"
        gain = _vector(m.actuator_gainprm[i, :3]) if affine else (m.actuator_gainprm[i, 0], 0, 0)
        biased = file.word("mjtBias", m.actuator_biastype[i]) == "affine"
        bias = _vector(m.actuator_biasprm[i, :3]) if biased else (0.0, 0.0, 0.0)
        kind = law if law == "dcmotor" else _kind(_vector(gain), bias)
        units = _units_of(joints, tendons, at_joint, at_tendon)
        if mount is not None:
            units = _SLIDE if any(wrench[:3]) else _HINGE
        unit = {"position": units[0], "velocity": units[1]}.get(kind, "")
        how = DYNAMICS.get(file.word("mjtDyn", m.actuator_dyntype[i]), "none")
        unit = quotient(unit, "s") if unit and how == "integrator" else unit
        column = with_unit(f"{name}_command", unit) if m.actuator_ctrlnum[i] else ""
        states: tuple[tuple[str, str], ...] = ()
        motor = winding_motor(m, i) if law == "dcmotor" else None
        if motor is not None:
            gains, dynamics = m.actuator_gainprm[i], m.actuator_dynprm[i]
            states = tuple(
                (f"{name}_{word}", si)
                for word, si, size in (  # in the order of MuJoCo's activations
                    ("slew", "", dynamics[7]),
                    ("integral", f"{units[0]} s", gains[5]),
                    ("temperature", "K", dynamics[2]),
                    ("bristle", units[0], dynamics[5]),
                    ("current", "A", dynamics[0]),
                )
                if size > 0.0
            )
        elif how != "none":
            states = ((f"{name}_activation", ""),)
        commanded = int(m.actuator_ctrladr[i]) if column else -1
        commands = slice(commanded, commanded + 1)
        actuators.append(
            Actuator(
                name,
                kind,
                at_joint,
                at_tendon,
                1.0 if mount is not None else wrench[0],
                how,
                float(m.actuator_dynprm[i, 0]) if how in ("filter", "dcmotor") else 0.0,
                _vector(gain),
                bias,
                column,
                states,
                unit,
                units[2],
                _range(m.actuator_ctrllimited[commands].any(), m.actuator_ctrlrange[commanded])
                if column
                else None,
                _range(m.actuator_forcelimited[i], m.actuator_forcerange[i]),
                _range(m.actuator_actlimited[i], m.actuator_actrange[i]),
                float(m.actuator_armature[i]),
                float(m.actuator_damping[i]),
                float(m.actuator_delay[i]),
                commanded,
                _vector(m.actuator_dampingpoly[i]),
                motor,
                mount,
                wrench if mount is not None else (),
            )
        )
    # motors for passive forces leave the joints without commands
    bare = () if any(a.column for a in actuators) else _bare(joints, followers)
    return (*actuators, *bare)


def winding_motor(model: Any, i: int) -> WindingMotor:
    """Winding motor from MuJoCo's arrays, with the indices of mjs_setToDCMotor."""
    gain, dynamics, bias = (
        _vector(array[i])
        for array in (model.actuator_gainprm, model.actuator_dynprm, model.actuator_biasprm)
    )
    return WindingMotor(
        INPUTS.get(int(model.actuator_ctrlspec[i]), ""),
        gain[0],
        gain[1],
        dynamics[1],
        (dynamics[2], dynamics[3], dynamics[4], gain[3], gain[2]),
        bias[:3],
        (*dynamics[5:7], *bias[3:6]),
        gain[4:7],
        dynamics[8],
        gain[7],
    )


def _bare(joints: tuple[MechanismJoint, ...], followers: set[int]) -> Iterator[Actuator]:
    """Force or torque at every joint without a drive, for a file without actuators, such as any
    URDF. Followers: joints that a coupling leads, such as a URDF's mimic joints."""
    for j, joint in enumerate(joints):
        if joint.kind not in ("hinge", "slide") or joint.is_base or j in followers:
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
    """Units of position, velocity and force at a joint or a tendon.

    A tendon has those of its joints, if they are of the same kind.
    """
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
    used_names: set[str],
) -> tuple[MechanismSensor, ...]:
    """Sensors that pamid can read.

    A file without such a sensor gets position and velocity of every joint, and the quaternion of a
    floating base.
    """
    m, sensors = file.model, list[MechanismSensor]()

    def add(name: str, kind: str, of: int, unit: str, stem: str, **more: Any) -> None:
        column = with_unit(stem, unit) if unit else stem
        while column in used_names:
            column = f"read_{column}"
        used_names.add(column)
        sensors.append(MechanismSensor(name, kind, of, unit, column, **more))

    for i in range(m.nsensor):
        name, kind = names.of("sensor", i), file.word("mjtSensor", m.sensor_type[i])
        of, adr = int(m.sensor_objid[i]), int(m.sensor_adr[i])
        more: dict[str, Any] = {"noise": float(m.sensor_noise[i])}
        cutoff = float(m.sensor_cutoff[i])
        if kind in FRAMES and reads_frame(file, i):
            unit, words = FRAMES[kind]
            more["mount"] = _mount(file, int(m.sensor_objtype[i]), of)
            more["cutoff"] = cutoff if unit else 0.0  # MuJoCo limits no quaternions
            for k, word in enumerate(words):
                stem = f"{_stem(name, unit)}_{word}"
                add(f"{name}_{word}", kind, of, unit, stem, adr=adr + k, component=k, **more)
        elif kind in SENSORS and not (
            kind.startswith("joint") and joints[of].kind not in ("hinge", "slide")
        ):
            element, place = SENSORS[kind]
            at = {"joint": (of, -1), "tendon": (-1, of)}.get(element, (-1, -1))
            if element == "actuator":
                at = actuators[of].joint, actuators[of].tendon
            unit = _units_of(joints, tendons, *at)[place]
            add(name, kind, of, unit, _stem(name, unit), adr=adr, cutoff=cutoff, **more)
    if sensors:
        return tuple(sensors)
    for i, joint in enumerate(joints):
        if joint.kind in ("hinge", "slide"):
            for kind, word, unit in (
                ("jointpos", "position", joint.unit),
                ("jointvel", "velocity", f"{joint.unit}/s"),
            ):
                add(f"{joint.name}_{word}", kind, i, unit, f"{joint.name}_{word}")
    for joint in joints:
        if joint.is_base and joint.name.endswith("_x"):
            base, mount = joint.name.removesuffix("_x"), Mount(joint.body)
            for k, word in enumerate(FRAMES["framequat"][1]):
                stem = f"{base}_{word}"
                add(stem, "framequat", joint.body, "", stem, mount=mount, component=k)
    return tuple(sensors)


def _mount(file: MujocoFile, kind: int, number: int) -> Mount:
    """Frame of a site, of a body, or of its principal axes."""
    m, kinds = file.model, file.mujoco.mjtObj
    if kind == kinds.mjOBJ_SITE:
        places = (m.site_pos[number], m.site_quat[number])
        return Mount(int(m.site_bodyid[number]), *map(_vector, places))
    if kind == kinds.mjOBJ_BODY:
        return Mount(number, _vector(m.body_ipos[number]), _vector(m.body_iquat[number]))
    return Mount(number)


def _stem(name: str, unit: str) -> str:
    """Name without a unit at its end, if that is the unit to be appended."""
    stem, written = split_column(name)
    return stem if written != NONE and with_unit(stem, unit) == name.lower() else name
