"""Parts of a MuJoCo model that have no form as equations, or that are left out either way.

A mechanism can be written as equations if it is a tree of hinges and slides. It then has no
contacts in reach, and no closed loops but couplings of joints. Its forces are those of joints,
fixed tendons and actuators with known laws.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from pamid.rigs.simulators.mechanism import ModelFinding
from pamid.rigs.simulators.mujoco_file import MujocoFile

CONFIGURATIONS = 300  # random configurations that are checked for contacts
RARE = 0.02  # largest share of them with contacts for which these count as avoidable
CONTACT = "contact"  # the element of the finding that geoms can touch
EVERY_PAIR = 10.0  # search distance for pairs, in extents of the model
NOT_ENFORCED = "is not enforced by the equations"  # only in the equations' form
# largest sum of squared depths of the joints for equations, that of a chain of 16. It is built
# and checked within 15 s of CPU, a chain of 24 takes over a minute
LARGEST_TREE = 1500
WIDE = 1.0  # rad or m to either side of the reference, for a joint without range

#: kind of sensor -> (element, index of its unit among position, velocity and force)
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
#: sensor on a frame -> unit and endings of its values
_XYZ = ("x", "y", "z")
FRAMES = {
    "framepos": ("m", _XYZ),
    "framequat": ("", ("qw", "qx", "qy", "qz")),
    "framelinvel": ("m/s", _XYZ),
    "frameangvel": ("rad/s", _XYZ),
    "gyro": ("rad/s", _XYZ),
    "velocimeter": ("m/s", _XYZ),
}

# disabling these does not change the equations
_HARMLESS_FLAGS = (
    "CONTACT WARMSTART EQUALITY LIMIT FILTERPARENT REFSAFE SENSOR MIDPHASE EULERDAMP AUTORESET "
    "NATIVECCD ISLAND MULTICCD"
)


def findings_of(file: MujocoFile, share: float, met: str) -> tuple[ModelFinding, ...]:
    """All findings on a file, hindrances first; share, met: result of `contact_share`."""
    findings = [
        *_notes(file),
        *_joints(file),
        *_bodies(file),
        *_tendons(file),
        *_actuators(file),
        *_options(file, share, met),
        *_sensors(file),
    ]
    return tuple(sorted(findings, key=lambda f: not f.hinders))


def contact_share(file: MujocoFile) -> tuple[float, str]:
    """Share of configurations within the joints' ranges in which geoms touch.

    Also the first two geoms that do, "" if none.
    """
    m, mujoco = file.model, file.mujoco
    if file.disables("CONTACT") or not m.nq:
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
    """True if MuJoCo looks for contacts between any two geoms, at any distance."""
    m, mujoco = file.copy(), file.mujoco
    if file.disables("CONTACT") or not m.nq:
        return False
    widen_margins(m, EVERY_PAIR * float(m.stat.extent))
    data = mujoco.MjData(m)
    mujoco.mj_fwdPosition(m, data)
    return bool((data.contact.exclude <= 1).any())


def widen_margins(model: Any, by: float) -> None:
    """Let MuJoCo report pairs of geoms up to this distance (m)."""
    for name in ("geom_margin", "body_margin", "pair_margin"):
        getattr(model, name)[:] += by


def _place(file: MujocoFile, qpos: Any, random: np.random.Generator) -> None:
    m = file.model
    for i in range(m.njnt):
        if file.word("mjtJoint", m.jnt_type[i]) in ("hinge", "slide"):
            at = int(m.jnt_qposadr[i])
            low, high = m.jnt_range[i] if m.jnt_limited[i] else m.qpos0[at] + [-WIDE, WIDE]
            qpos[at] = random.uniform(low, high)
    follow(file, qpos)


def follow(file: MujocoFile, qpos: Any) -> None:
    """Set the positions of joints that follow another joint through a coupling.

    A chain of couplings is followed in the order of the file.
    """
    m = file.model
    joint = int(file.mujoco.mjtEq.mjEQ_JOINT)
    for i in range(m.neq):
        if int(m.eq_type[i]) != joint or not m.eq_active0[i]:
            continue
        first = m.jnt_qposadr[m.eq_obj1id[i]]
        second, way = m.eq_obj2id[i], 0.0
        if second >= 0:
            at = m.jnt_qposadr[second]
            way = float(qpos[at] - m.qpos0[at])
        qpos[first] = m.qpos0[first] + np.polynomial.polynomial.polyval(way, m.eq_data[i, :5])


def _finding(
    file: MujocoFile, kind: str, number: int, text: str, *, hinders: bool = True
) -> ModelFinding:
    return ModelFinding(text, kind, file.name(kind, number), file.line(kind, number), hinders)


def _joints(file: MujocoFile) -> Iterator[ModelFinding]:
    m = file.model
    depth = np.zeros(m.nv, np.int64)  # joints from the ground to this joint
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
        if m.jnt_limited[i]:
            low, high = m.jnt_range[i]
            text = f"the range {low:.4g} .. {high:.4g} {NOT_ENFORCED}"
            yield _finding(file, "joint", i, text, hinders=False)


def _bodies(file: MujocoFile) -> Iterator[ModelFinding]:
    m = file.model
    for i in range(m.nbody):
        if m.body_mocapid[i] >= 0:
            text = "a mocap body is held where it stands"
            yield _finding(file, "body", i, text, hinders=False)


def _tendons(file: MujocoFile) -> Iterator[ModelFinding]:
    m = file.model
    for i in range(m.ntendon):
        first, count = int(m.tendon_adr[i]), int(m.tendon_num[i])
        wraps = {file.word("mjtWrap", m.wrap_type[k]) for k in range(first, first + count)}
        if wraps != {"joint"}:
            yield _finding(file, "tendon", i, "a spatial tendon runs over sites")
        if m.tendon_limited[i]:
            low, high = m.tendon_range[i]
            text = f"the range {low:.4g} .. {high:.4g} {NOT_ENFORCED}"
            yield _finding(file, "tendon", i, text, hinders=False)
        if m.tendon_springyield[i]:
            yield _finding(file, "tendon", i, "a spring that yields")
        if m.tendon_frictionloss[i]:
            yield _finding(file, "tendon", i, "a friction loss")
        if m.tendon_armature[i] or m.tendon_actfrclimited[i]:
            yield _finding(file, "tendon", i, "an armature or a limit of its actuators' force")


def _actuators(file: MujocoFile) -> Iterator[ModelFinding]:
    m = file.model
    for i in range(m.nactuator):
        drives = file.word("mjtTrn", m.actuator_trntype[i])
        if drives not in ("joint", "jointinparent", "tendon", "site"):
            yield _finding(file, "actuator", i, f"it acts on a {drives}, not a joint or tendon")
        if drives == "site" and m.actuator_trnid[i, 1] >= 0:
            yield _finding(file, "actuator", i, "it acts between two sites")
        dynamics = file.word("mjtDyn", m.actuator_dyntype[i])
        winding = file.word("mjtGain", m.actuator_gaintype[i]) == "dcmotor"
        if dynamics not in ("none", "integrator", "filter", "filterexact", "dcmotor"):
            yield _finding(file, "actuator", i, f"dynamics of the kind {dynamics}")
        for part, enum, kind, plain in (
            ("gain", "mjtGain", m.actuator_gaintype[i], ("fixed", "affine", "dcmotor")),
            ("bias", "mjtBias", m.actuator_biastype[i], ("none", "affine", "dcmotor")),
        ):
            if file.word(enum, kind) not in plain:
                yield _finding(file, "actuator", i, f"a {part} of the kind {file.word(enum, kind)}")
        if winding and m.actuator_dynprm[i, 7] > 0.0:
            text = "a limit of its command's rate, which is a matter of the time step"
            yield _finding(file, "actuator", i, text)
        if m.actuator_ctrlnum[i] > 1 or m.actuator_plugin[i] >= 0:
            yield _finding(file, "actuator", i, "several commands, or a plugin")
        if m.actuator_actearly[i] and not winding:
            yield _finding(file, "actuator", i, "actearly, which is a matter of the time step")
        if drives in ("tendon", "site") and m.actuator_armature[i]:
            yield _finding(file, "actuator", i, f"armature at a {drives}")


def _options(file: MujocoFile, share: float, met: str) -> Iterator[ModelFinding]:
    m, mujoco = file.model, file.mujoco
    for i in range(m.neq):
        # joints can be coupled, and tendons, which are sums of joint positions
        if m.eq_active0[i] and file.word("mjtEq", m.eq_type[i]) not in ("joint", "tendon"):
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


def reads_frame(file: MujocoFile, sensor: int) -> bool:
    """True if a sensor on a frame is read.

    It must be on a floating base, relative to the world, because frames of a fixed robot repeat its
    joint readings.
    """
    m, kinds = file.model, file.mujoco.mjtObj
    if file.word("mjtSensor", m.sensor_type[sensor]) not in FRAMES or m.sensor_refid[sensor] >= 0:
        return False
    kind, number = int(m.sensor_objtype[sensor]), int(m.sensor_objid[sensor])
    if kind == kinds.mjOBJ_SITE:
        number = int(m.site_bodyid[number])
    elif kind not in (int(kinds.mjOBJ_BODY), int(kinds.mjOBJ_XBODY)):
        return False
    floating = set(file.free.floating)
    bases = {m.jnt_bodyid[j] for j in range(m.njnt) if file.name("joint", j) in floating}
    return m.body_rootid[number] in bases


def _sensors(file: MujocoFile) -> Iterator[ModelFinding]:
    m = file.model
    for i in range(m.nsensor):
        word = file.word("mjtSensor", m.sensor_type[i])
        if word not in SENSORS and not reads_frame(file, i):
            text = f"a sensor of the kind {word} is left out"
            yield _finding(file, "sensor", i, text, hinders=False)
        elif m.sensor_delay[i]:
            yield _finding(file, "sensor", i, "its delay is left out", hinders=False)


def _notes(file: MujocoFile) -> Iterator[ModelFinding]:
    """Findings of reading the file, none of which hinders."""
    if file.left_out:
        yield ModelFinding(file.left_out, "model", "", 0, False)
    for text in file.warnings:
        yield ModelFinding(f"MuJoCo warns: {text}", "model", "", 0, False)
    for name, line, text in file.free.notes:
        yield ModelFinding(text, "joint", name, line, False)
    read = {
        file.word("mjtSensor", file.model.sensor_type[i])
        for i in range(file.model.nsensor)
        if reads_frame(file, i)
    }
    if file.free.floating and file.model.nsensor and not read >= {"framepos", "framequat"}:
        text = (
            "no sensor reads where the floating base is: add <framepos> and <framequat> of its "
            "body, and record them"
        )
        yield ModelFinding(text, "sensor", "", 0, False)
    if file.first_link is not None:
        text = (
            "it stands still, as MuJoCo holds the first link of a URDF; a base that floats hangs "
            'on a massless first link by <joint type="floating">'
        )
        yield ModelFinding(text, "link", *file.first_link, False)
