"""What of a MuJoCo model cannot be written as equations, and what is left out either way.

A mechanism can be written as equations where it is a tree of hinges and slides: no contacts in
reach, no closed loops, no forces but those of joints, fixed tendons and plain actuators.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from pamid.simulators.mechanism import ModelFinding
from pamid.simulators.mujoco_file import MujocoFile

CONFIGURATIONS = 300  # configurations looked at for contacts
RARE = 0.02  # share of them with contacts up to which these are taken for avoidable
CONTACT = "contact"  # the element of the finding that geoms can touch
EVERY_PAIR = 10.0  # times the model's extent: pairs within it are looked for
NOT_ENFORCED = "is not enforced by the equations"  # where there are equations
# sum of squared depths of the joints up to which equations are written, a chain of 16: it is built
# and checked within 15 s of CPU, one of 24 takes over a minute
LARGEST_TREE = 1500
WIDE = 1.0  # rad or m to either side of the reference, for a joint without range

_READ = "jointpos jointvel jointactfrc tendonpos tendonvel actuatorpos actuatorvel actuatorfrc"

# switched off, these change nothing of what is written as equations
_HARMLESS_FLAGS = (
    "CONTACT WARMSTART EQUALITY LIMIT FILTERPARENT REFSAFE SENSOR MIDPHASE EULERDAMP AUTORESET "
    "NATIVECCD ISLAND MULTICCD"
)


def findings_of(file: MujocoFile, share: float, met: str) -> tuple[ModelFinding, ...]:
    """Everything there is to say about a file, hindrances first. share, met: of `contact_share`."""
    found = [
        *_warnings(file),
        *_joints(file),
        *_bodies(file),
        *_tendons(file),
        *_actuators(file),
        *_options(file, share, met),
        *_sensors(file),
    ]
    return tuple(sorted(found, key=lambda f: not f.hinders))


def contact_share(file: MujocoFile) -> tuple[float, str]:
    """In which share of configurations within the joints' ranges geoms touch, and the first two
    that do, "" where none."""
    m, mujoco = file.model, file.mujoco
    if m.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT) or not m.nq:
        return 0.0, ""
    data, random = mujoco.MjData(m), np.random.default_rng(0)
    touching, first = 0, ""
    for draw in range(CONFIGURATIONS):
        data.qpos[:] = m.qpos0
        if draw:
            _place(file, data.qpos, random)
        mujoco.mj_fwdPosition(m, data)
        count = sum(int(data.contact[c].exclude == 0) for c in range(data.ncon))
        if count and not first:
            names = [file.name("geom", int(g)) for g in data.contact[0].geom]
            first = f"{names[0]} and {names[1]}{' at the reference itself' if not draw else ''}"
        touching += count > 0
        if not draw and count:
            return 1.0, first
    return touching / CONFIGURATIONS, first


def can_collide(file: MujocoFile) -> bool:
    """Whether MuJoCo looks for contacts between any two geoms, however far apart."""
    m, mujoco = mujoco_copy(file), file.mujoco
    if m.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CONTACT) or not m.nq:
        return False
    widen_margins(m, EVERY_PAIR * float(m.stat.extent))
    data = mujoco.MjData(m)
    mujoco.mj_fwdPosition(m, data)
    return bool((data.contact.exclude <= 1).any())


def mujoco_copy(file: MujocoFile) -> Any:
    """A model of its own."""
    return file.mujoco.MjModel.__copy__(file.model)


def widen_margins(model: Any, by: float) -> None:
    """Let MuJoCo report pairs of geoms up to such a distance (m)."""
    for name in ("geom_margin", "body_margin", "pair_margin"):
        getattr(model, name)[:] += by


def _place(file: MujocoFile, qpos: Any, random: np.random.Generator) -> None:
    m = file.model
    for i in range(m.njnt):
        if file.word("mjtJoint", m.jnt_type[i]) in ("hinge", "slide"):
            at = int(m.jnt_qposadr[i])
            low, high = m.jnt_range[i] if m.jnt_limited[i] else m.qpos0[at] + [-WIDE, WIDE]
            qpos[at] = random.uniform(low, high)


def _finding(
    file: MujocoFile, kind: str, number: int, text: str, *, hinders: bool = True
) -> ModelFinding:
    return ModelFinding(text, kind, file.name(kind, number), file.line(kind, number), hinders)


def _joints(file: MujocoFile) -> Iterator[ModelFinding]:
    m = file.model
    depth = np.zeros(m.nv, np.int64)  # joints from the ground to this one
    for dof in range(m.nv):  # a parent stands before its children
        parent = int(m.dof_parentid[dof])
        depth[dof] = 1 + (depth[parent] if parent >= 0 else 0)
    if int((depth**2).sum()) > LARGEST_TREE:
        last = int(m.dof_jntid[int(depth.argmax())])
        text = f"it is the end of a chain of {depth.max()} joints, whose equations are too large"
        yield _finding(file, "joint", last, text)
    for i in range(m.njnt):
        kind = file.word("mjtJoint", m.jnt_type[i])
        if kind not in ("hinge", "slide"):
            yield _finding(file, "joint", i, f"a {kind} joint turns by a quaternion")
            continue
        dof = int(m.jnt_dofadr[i])
        if m.dof_dampingpoly[dof].any() or m.jnt_stiffnesspoly[i].any() or m.jnt_springyield[i]:
            yield _finding(file, "joint", i, "a spring or damper that is not linear")
        if m.jnt_limited[i]:
            low, high = m.jnt_range[i]
            text = f"the range {low:.4g} .. {high:.4g} {NOT_ENFORCED}"
            yield _finding(file, "joint", i, text, hinders=False)


def _bodies(file: MujocoFile) -> Iterator[ModelFinding]:
    m = file.model
    for i in range(m.nbody):
        if m.body_gravcomp[i]:
            yield _finding(file, "body", i, "gravity compensation")
        if m.body_mocapid[i] >= 0:
            yield _finding(file, "body", i, "a mocap body is moved from outside")


def _tendons(file: MujocoFile) -> Iterator[ModelFinding]:
    m = file.model
    for i in range(m.ntendon):
        first, count = int(m.tendon_adr[i]), int(m.tendon_num[i])
        wraps = {file.word("mjtWrap", m.wrap_type[k]) for k in range(first, first + count)}
        if wraps != {"joint"}:
            yield _finding(file, "tendon", i, "a spatial tendon runs over sites")
        if m.tendon_limited[i]:
            yield _finding(file, "tendon", i, "a limit of its length")
        poly = m.tendon_dampingpoly[i].any() or m.tendon_stiffnesspoly[i].any()
        if poly or m.tendon_springyield[i]:
            yield _finding(file, "tendon", i, "a spring or damper that is not linear")
        if m.tendon_frictionloss[i]:
            yield _finding(file, "tendon", i, "a friction loss")
        if m.tendon_armature[i] or m.tendon_actfrclimited[i]:
            yield _finding(file, "tendon", i, "an armature or a limit of its actuators' force")


def _actuators(file: MujocoFile) -> Iterator[ModelFinding]:
    m = file.model
    for i in range(m.nactuator):
        if not m.actuator_ctrlnum[i]:
            yield _finding(file, "actuator", i, "a motor without a command, for passive forces")
            continue
        drives = file.word("mjtTrn", m.actuator_trntype[i])
        if drives not in ("joint", "jointinparent", "tendon"):
            yield _finding(file, "actuator", i, f"it acts on a {drives}, not a joint or tendon")
        dynamics = file.word("mjtDyn", m.actuator_dyntype[i])
        if dynamics not in ("none", "integrator", "filter", "filterexact"):
            yield _finding(file, "actuator", i, f"dynamics of the kind {dynamics}")
        for part, enum, kind, plain in (
            ("gain", "mjtGain", m.actuator_gaintype[i], ("fixed", "affine")),
            ("bias", "mjtBias", m.actuator_biastype[i], ("none", "affine")),
        ):
            if file.word(enum, kind) not in plain:
                yield _finding(file, "actuator", i, f"a {part} of the kind {file.word(enum, kind)}")
        if m.actuator_ctrlnum[i] != 1 or m.actuator_plugin[i] >= 0:
            yield _finding(file, "actuator", i, "several commands, or a plugin")
        if m.actuator_actearly[i]:
            yield _finding(file, "actuator", i, "actearly, which is a matter of the time step")
        if m.actuator_dampingpoly[i].any():
            yield _finding(file, "actuator", i, "a damper that is not linear")
        if drives == "tendon" and (m.actuator_armature[i] or m.actuator_damping[i]):
            yield _finding(file, "actuator", i, "armature or damping at a tendon")


def _options(file: MujocoFile, share: float, met: str) -> Iterator[ModelFinding]:
    m, mujoco = file.model, file.mujoco
    for i in range(m.neq):
        if m.eq_active0[i]:
            yield _finding(file, "equality", i, "a constraint that closes a loop")
    if m.opt.density or m.opt.viscosity:
        yield ModelFinding(
            "a medium (density, viscosity) drags at the bodies", "option", "", 0, True
        )
    if m.nflex or m.nplugin:
        yield ModelFinding("flexible bodies or plugins", "model", "", 0, True)
    known = 0
    for word in _HARMLESS_FLAGS.split():
        known |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{word}"))
    if m.opt.disableflags & ~known or m.opt.disableactuator:
        yield ModelFinding("forces are switched off by flags", "option", "", 0, True)
    if share:
        rare = share <= RARE
        text = (
            f"geoms touch ({met}) in {100 * share:.0f} % of the configurations within the joints' "
            f"ranges; recordings decide: as equations where none touch, else stepped by MuJoCo"
        )
        yield ModelFinding(text, CONTACT, "", 0, not rare)


def _sensors(file: MujocoFile) -> Iterator[ModelFinding]:
    m = file.model
    for i in range(m.nsensor):
        word = file.word("mjtSensor", m.sensor_type[i])
        if word not in _READ.split():
            text = f"a sensor of the kind {word} is left out"
            yield _finding(file, "sensor", i, text, hinders=False)
        elif m.sensor_delay[i]:
            yield _finding(file, "sensor", i, "its delay is left out", hinders=False)


def _warnings(file: MujocoFile) -> Iterator[ModelFinding]:
    for text in file.warnings:
        yield ModelFinding(f"MuJoCo warns: {text}", "model", "", 0, False)
