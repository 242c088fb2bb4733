"""Replacement of quaternion joints of a MuJoCo model, before its mechanism is built.

An object in the scene stands where the file places it. No actuator, tendon, coupling or sensor of a
joint may touch it. A floating base gets three slides along the axes of the world and three hinges,
which is the same motion, with yaw, pitch and roll instead of the quaternion. It is singular if the
base points straight up or down.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

#: replacement of a free joint: (ending of the name, True for a hinge, axis)
BASE_JOINTS = (
    ("x", False, (1.0, 0.0, 0.0)),
    ("y", False, (0.0, 1.0, 0.0)),
    ("z", False, (0.0, 0.0, 1.0)),
    ("yaw", True, (0.0, 0.0, 1.0)),
    ("pitch", True, (0.0, 1.0, 0.0)),
    ("roll", True, (1.0, 0.0, 0.0)),
)
OBJECT_HELD = "a free joint of an object that nothing drives or reads: it is held where it stands"
BASE_FREED = "a free joint: three slides and yaw, pitch and roll stand for it"


@dataclass(frozen=True)
class FreeJoints:
    """floating: names of the joints that replace free ones; notes: (name, line, text)."""

    floating: tuple[str, ...] = ()
    notes: tuple[tuple[str, int, str], ...] = ()


def settle_free_joints(mujoco: Any, spec: Any, line_of: Callable[[Any], int]) -> FreeJoints:
    """Replace the free joints of a model in MuJoCo (spec, changed), and ball joints of objects.

    line_of: function that returns the line of an element in the file, 0 if unknown.
    """
    loose = [
        joint
        for joint in spec.joints
        if joint.type in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL)
    ]
    if not loose:
        return FreeJoints()
    model = spec.compile()
    touched = set(_touched(mujoco, model)) or {int(t) for t in model.body_treeid}
    # read before a joint is replaced: the numbers of the others change with it
    trees = [int(model.body_treeid[joint.parent.id]) for joint in loose]
    forced = [
        joint.type != mujoco.mjtJoint.mjJNT_FREE or _has_forces(model, joint.id) for joint in loose
    ]
    floating: list[str] = []
    notes: list[tuple[str, int, str]] = []
    for joint, tree, has_forces in zip(loose, trees, forced, strict=True):
        body = joint.parent
        line = line_of(joint) or line_of(body)  # <freejoint> has none
        name = joint.name or f"of {body.name or f'body_{body.id}'}"
        if tree not in touched:
            notes.append((name, line, OBJECT_HELD))
        elif not has_forces:
            notes.append((name, line, BASE_FREED))
            floating += _as_base(mujoco, spec, body, joint.name or body.name or "base")
        else:
            continue
        spec.delete(joint)
    if notes:
        for key in list(spec.keys):
            spec.delete(key)
    return FreeJoints(tuple(floating), tuple(notes))


def _has_forces(model: Any, joint: int) -> bool:
    """True if a free joint has a spring, a damper, friction or an armature."""
    dofs = slice(int(model.jnt_dofadr[joint]), int(model.jnt_dofadr[joint]) + 6)
    arrays = (model.dof_damping, model.dof_armature, model.dof_frictionloss)
    return bool(model.jnt_stiffness[joint]) or any(array[dofs].any() for array in arrays)


def _as_base(mujoco: Any, spec: Any, body: Any, name: str) -> list[str]:
    """Give a body the joints of a floating base, and return their names."""
    joint_names = {joint.name for joint in spec.joints}
    while any(f"{name}_{word}" in joint_names for word, _, _ in BASE_JOINTS):
        name = f"{name}_base"
    place = np.array(body.pos)
    body.quat = [1.0, 0.0, 0.0, 0.0]
    for word, turns, axis in BASE_JOINTS:
        body.add_joint(
            name=f"{name}_{word}",
            type=mujoco.mjtJoint.mjJNT_HINGE if turns else mujoco.mjtJoint.mjJNT_SLIDE,
            axis=axis,
            pos=[0.0, 0.0, 0.0],
            ref=0.0 if turns else float(place @ axis),
            springref=0.0,
            damping=[0.0, 0.0, 0.0],
            stiffness=[0.0, 0.0, 0.0],
            armature=0.0,
            frictionloss=0.0,
            limited=mujoco.mjtLimited.mjLIMITED_FALSE,
            actfrclimited=mujoco.mjtLimited.mjLIMITED_FALSE,
        )
    return [f"{name}_{word}" for word, _, _ in BASE_JOINTS]


def _touched(mujoco: Any, m: Any) -> Iterator[int]:
    """Numbers of the trees that an actuator, a tendon, an equality or a joint sensor touches.

    A number may occur several times.
    """
    kinds, wrap, drive = mujoco.mjtObj, mujoco.mjtWrap, mujoco.mjtTrn
    bodies = {  # kind of an element -> its body, by the element's number
        kinds.mjOBJ_BODY: range(m.nbody),
        kinds.mjOBJ_XBODY: range(m.nbody),
        kinds.mjOBJ_JOINT: m.jnt_bodyid,
        kinds.mjOBJ_SITE: m.site_bodyid,
        kinds.mjOBJ_GEOM: m.geom_bodyid,
    }
    wraps = {
        wrap.mjWRAP_JOINT: kinds.mjOBJ_JOINT,
        wrap.mjWRAP_SITE: kinds.mjOBJ_SITE,
        wrap.mjWRAP_SPHERE: kinds.mjOBJ_GEOM,
        wrap.mjWRAP_CYLINDER: kinds.mjOBJ_GEOM,
    }
    drives = {
        drive.mjTRN_JOINT: kinds.mjOBJ_JOINT,
        drive.mjTRN_JOINTINPARENT: kinds.mjOBJ_JOINT,
        drive.mjTRN_TENDON: kinds.mjOBJ_TENDON,
        drive.mjTRN_BODY: kinds.mjOBJ_BODY,
    }

    def trees(kind: int, number: int) -> Iterator[int]:
        if kind in bodies and number >= 0:
            yield int(m.body_treeid[bodies[kind][number]])
        elif kind == kinds.mjOBJ_TENDON and number >= 0:
            for k in range(m.tendon_adr[number], m.tendon_adr[number] + m.tendon_num[number]):
                yield from trees(wraps.get(int(m.wrap_type[k]), -1), int(m.wrap_objid[k]))

    for i in range(m.nactuator):
        kind = drives.get(int(m.actuator_trntype[i]), kinds.mjOBJ_SITE)
        for end in (0, 1) if kind == kinds.mjOBJ_SITE else (0,):
            yield from trees(kind, int(m.actuator_trnid[i, end]))
    if not m.nactuator:  # a force acts on every hinge and slide
        for i in range(m.njnt):
            if int(m.jnt_type[i]) in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
                yield from trees(kinds.mjOBJ_JOINT, i)
    for i in range(m.ntendon):
        yield from trees(kinds.mjOBJ_TENDON, i)
    of = {mujoco.mjtEq.mjEQ_JOINT: kinds.mjOBJ_JOINT, mujoco.mjtEq.mjEQ_TENDON: kinds.mjOBJ_TENDON}
    for i in range(m.neq):
        kind = of.get(int(m.eq_type[i]), int(m.eq_objtype[i]))
        if m.eq_active0[i]:
            yield from trees(kind, int(m.eq_obj1id[i]))
            yield from trees(kind, int(m.eq_obj2id[i]))
    for i in range(m.nsensor):
        kind = int(m.sensor_objtype[i])
        if kind == kinds.mjOBJ_JOINT:
            yield from trees(kind, int(m.sensor_objid[i]))
