"""Writing of a finding into the text of a model file, MJCF or URDF.

It covers values of parameters, and effects as elements of MuJoCo (`pamid.simulators.mujoco_forms`).
Elements are identified by their name or by the line at which MuJoCo read them. Attributes are
changed. Elements are added for a body without <inertial>, a load behind its motor, and friction
with bristles. MuJoCo reads the new text again, and every value that it does not return is reported.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pamid.base.errors import FileError
from pamid.simulators.body_inertia import AXES, PAIRS, BodyShape, full_inertia, shapes_of
from pamid.simulators.mechanism import Body, Mechanism, MechanismJoint, ModelParameter
from pamid.simulators.mujoco_file import MujocoFile, open_mujoco
from pamid.simulators.mujoco_forms import (
    TINY_SPRING,
    CommandTerms,
    FlexibleLoad,
    Forms,
    IdentifiedEffect,
    JointTerms,
    ReadingTerms,
    forms_of,
)
from pamid.simulators.mujoco_mechanism import mechanism_of
from pamid.simulators.xml_text import Edits, Tag, tags_of

Array = NDArray[np.float64]

UNCHANGED = 1e-9  # share by which a value may differ and stay as it is written
SAME = 1e-6  # share to which the written file has to give a value back
FINER_STEPS = 8  # a delay and dry friction hold down to this part of the file's step
DELAY_ROUNDING = 1e-7  # of a delay
SOFT = 0.02  # impedance of a limit that acts as a spring: the share by which it also holds still
LEAST_ARMATURE = 1e-3  # of the load behind a motor, where the file has no inertia of the motor
MOSTLY_BEHIND = 0.97  # share of a load from which all of it is behind

_JOINT_PARENTS = ("body", "frame", "replicate")
_ORIENTATIONS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")
_PLURAL = {"actuator": "actuators", "body": "bodies", "joint": "joints", "tendon": "tendons"}
_URDF_WORDS = {"damping": "damping", "frictionloss": "friction"}


@dataclass(frozen=True)
class WrittenModel:
    """Changed model file.

    text             of the file
    changed          parameter -> (old value, new value), SI
    left             sentences on values that could not be written
    notes            sentences on effects in another form
    file, mechanism  the text as read by MuJoCo
    """

    text: bytes
    changed: dict[str, tuple[float, float]]
    left: tuple[str, ...]
    notes: tuple[str, ...]
    file: MujocoFile = field(repr=False)
    mechanism: Mechanism = field(repr=False)


def write_back(
    mechanism: Mechanism, values: Mapping[str, float], effects: Sequence[IdentifiedEffect] = ()
) -> WrittenModel:
    """Write values and effects into the mechanism's file.

    Parameters
    ----------
    mechanism
        Mechanism of the file.
    values
        Values (SI) by parameter. Those of a `BodyShape` change the whole inertia of its body.
    effects
        Effects to add.

    Raises
    ------
    FileError
        The file can no longer be read.
    """
    path = Path(mechanism.path)
    text, file = path.read_bytes(), open_mujoco(path)
    forms = forms_of(mechanism, effects)
    weights: dict[str, float] = {}
    # limits and soft friction are in units of the inverse inertia, which the other changes decide
    for _ in range(2 if any(_is_weighted(t) for t in forms.joints.values()) else 1):
        writer = _Writer(file, mechanism, text, forms, dict(values), weights)
        written = writer.write()
        file_again = read_text(path, written)
        m = file_again.model
        weights = {
            file_again.name("joint", j): float(m.dof_invweight0[m.jnt_dofadr[j]])
            for j in range(m.njnt)
        }
    reread = mechanism_of(file_again)
    left, changed = list(writer.left), dict(writer.changed)
    for name, why in _differences(reread, {n: now for n, (_, now) in changed.items()}):
        del changed[name]
        left.append(f"{name}: {why}")
    notes = (*forms.notes, *writer.notes)
    reread = _with_columns(reread, mechanism)
    return WrittenModel(written, changed, tuple(left), notes, file_again, reread)


def _with_columns(new: Mechanism, old: Mechanism) -> Mechanism:
    """New model with the columns of the old one, because a command of <general> has no unit."""
    columns = {a.name: a.column for a in old.actuators}
    return replace(
        new,
        actuators=tuple(replace(a, column=columns.get(a.name, a.column)) for a in new.actuators),
    )


def read_text(path: Path, text: bytes) -> MujocoFile:
    """Changed text of a model file, as read by MuJoCo."""
    with stored_text(path, text) as copy:
        try:
            return open_mujoco(copy)
        except FileError as error:
            raise FileError(f"{path}: the changed model cannot be read: {error}") from error


@contextmanager
def stored_text(path: Path, text: bytes) -> Iterator[Path]:
    """Temporary file with the text of a model, next to the model, where its meshes are.

    It is elsewhere if that folder is not writable.
    """
    folder = path.parent if os.access(path.parent, os.W_OK) else None
    with tempfile.NamedTemporaryFile(dir=folder, suffix=path.suffix) as copy:
        copy.write(text)
        copy.flush()
        yield Path(copy.name)


def _differences(reread: Mechanism, wanted: Mapping[str, float]) -> list[tuple[str, str]]:
    """Values that MuJoCo does not return as written."""
    read = {p.parameter.name: p.parameter.value * p.parameter.factor for p in reread.parameters}
    sizes: dict[str, float] = {}  # products of inertia and centres may be next to zero
    for shape in shapes_of(reread):
        read |= inertia_values(shape, shape.body)
        sizes |= dict.fromkeys(shape.centre_names, shape.radius_m)
        sizes |= dict.fromkeys(shape.inertia_names, max(shape.body.inertia))
    losses = []
    for name, value in wanted.items():
        got = read.get(name, 0.0)
        if abs(got - value) > SAME * max(abs(value), sizes.get(name, 1e-12)):
            losses.append(
                (name, f"MuJoCo makes {got:.6g} of {value:.6g} (a setting of <compiler>?)")
            )
    return losses


def number(value: float) -> str:
    """Shortest text of a number that keeps all significant digits."""
    return f"{value:.10g}"


def numbers(values: Sequence[float] | Array) -> str:
    return " ".join(map(number, values))


def _trimmed(values: Array) -> str:
    """Numbers without the zeros at the end; the first one stays."""
    last = int(np.max(np.flatnonzero(values), initial=0))
    return numbers(values[: last + 1])


def _is_weighted(terms: JointTerms) -> bool:
    gap = terms.behind is not None and terms.behind.half_gap > 0.0
    return bool(terms.stop or terms.onset or gap)


class _Writer:
    """One pass over a file's text.

    weights: inverse inertia at every joint of the changed model by name, empty in the first pass.
    """

    def __init__(
        self,
        file: MujocoFile,
        mechanism: Mechanism,
        text: bytes,
        forms: Forms,
        values: dict[str, float],
        weights: Mapping[str, float],
    ) -> None:
        self.file, self.mechanism, self.text = file, mechanism, text
        self.forms, self.values, self.weights = forms, values, weights
        self.tags = tags_of(text)
        self.edits = Edits(text)
        self.is_urdf = self.tags[0].name == "robot"
        self.vectors: dict[tuple[int, str], Array] = {}
        self.changed: dict[str, tuple[float, float]] = {}
        self.left: list[str] = []
        self.notes: list[str] = []
        self.passive: list[str] = []
        self.motors: set[str] = set()
        self.added_joints: list[tuple[int, int]] = []  # places of their position and velocity
        self.dynamics: dict[int, dict[str, float]] = {}
        angles = [t.attributes.get("angle") for t in self.tags if t.name == "compiler"]
        self.degrees = not self.is_urdf and "radian" not in angles
        self.names = {
            (p.element, p.number, p.attribute): p.parameter.name for p in mechanism.parameters
        }
        self.shapes = [s for s in shapes_of(mechanism) if s.centre_names[0] in values]
        self.bodies = list(mechanism.bodies)
        for i, body in enumerate(mechanism.bodies):
            self.bodies[i] = body.scaled(self._number_of("body", i, "mass", body.mass_kg))
        for shape in self.shapes:
            mass = self.bodies[shape.number].mass_kg
            self.bodies[shape.number] = shape.deformed(values, mass)

    def write(self) -> bytes:
        """The changed text."""
        special: set[str] = set()
        for j, joint_terms in self.forms.joints.items():
            special |= self._joint(j, joint_terms)
        reshaped = {
            self.names[key]
            for key in self.names
            if key[0] == "actuator" and self._is_reshaped(key[1])
        }
        for i, terms in self.forms.commands.items():
            self._command(i, terms)
        for s, reading in self.forms.readings.items():
            self._reading(s, reading)
        for shape in self.shapes:
            special |= self._whole_inertia(shape, special)
        for entry in self.mechanism.parameters:
            if entry.parameter.name not in special | reshaped:
                self._parameter(entry)
        self._add_passive()
        self._add_dynamics()
        self._extend_keyframes()
        return self.edits.made(self.tags)

    def _parameter(self, entry: ModelParameter) -> None:
        name = entry.parameter.name
        was, now = entry.parameter.value * entry.parameter.factor, self.values[name]
        if abs(now - was) <= UNCHANGED * max(abs(was), abs(now)):
            return
        if why := self.put(entry, now):
            self.left.append(f"{name} = {now:.6g}: {why}")
        else:
            self.changed[name] = (was, now)

    def put(self, parameter: ModelParameter, value: float) -> str:
        """Note a change; returns the reason why it is impossible, or ""."""
        tag, why = self._tag_of(parameter.element, parameter.number, parameter.of)
        if tag is None:
            return why
        if parameter.element == "body":
            return self._mass(tag, parameter, value)
        if self.is_urdf:
            return self._urdf_joint(tag, parameter.attribute, value)
        if parameter.element == "actuator":
            return self._actuator(tag, parameter, value)
        word = parameter.attribute.partition("_")[0]
        if word in ("damping", "stiffness"):
            self.edits.set(
                tag, word, _trimmed(self._polynomial(parameter.element, parameter.number, word))
            )
        elif parameter.attribute == "springyield":
            self.edits.set(tag, word, self._angle(self.mechanism.joints[parameter.number], value))
        else:
            self.edits.set(tag, word, number(value))
        return ""

    def _polynomial(self, element: str, i: int, word: str) -> Array:
        """Coefficients of the first to third power of a spring or damper, with the new values."""
        owner = (self.mechanism.joints if element == "joint" else self.mechanism.tendons)[i]
        stated = (getattr(owner, word), *getattr(owner, f"{word}_powers"))
        names = (word, f"{word}_quadratic", f"{word}_cubic")
        pairs = zip(names, stated, strict=True)
        return np.array([self._number_of(element, i, name, value) for name, value in pairs])

    # ---- elements of the text --------------------------------------------------------------------

    def _tag_of(self, kind: str, i: int, of: str) -> tuple[Tag | None, str]:
        """Start tag of an element; else the reason why there is none."""
        name = self.file.mujoco.mj_id2name(
            self.file.model, getattr(self.file.mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), i
        )
        kind_tags = [tag for tag in self.tags if self._is(tag, kind)]
        if name:
            matches = [tag for tag in kind_tags if tag.attributes.get("name") == name]
        else:
            line = self.file.line(kind, i)
            same = [
                k
                for k in range(len(getattr(self.mechanism, _PLURAL.get(kind, f"{kind}s"))))
                if self.file.line(kind, k) == line
            ]
            matches = [
                tag for tag in kind_tags if tag.line == line and "name" not in tag.attributes
            ]
            matches = (
                matches[same.index(i) : same.index(i) + 1] if len(matches) == len(same) else []
            )
        if len(matches) == 1:
            return matches[0], ""
        return None, f"the {kind} {of!r} does not stand by itself in the text of the file"

    def _is(self, tag: Tag, kind: str) -> bool:
        parent = self.tags[tag.parent].name if tag.parent >= 0 else ""
        if self.is_urdf:  # a <transmission> names joints, too
            return tag.name == {"body": "link"}.get(kind, kind) and parent == "robot"
        if kind == "body":
            return tag.name == "body"
        if kind == "joint":
            return tag.name == "joint" and parent in _JOINT_PARENTS
        return parent == kind

    def _inside(self, tag: Tag, name: str) -> Tag | None:
        number = self.tags.index(tag)
        return next((t for t in self.tags if t.parent == number and t.name == name), None)

    def _number_of(self, element: str, i: int, attribute: str, stated: float) -> float:
        """Value of a parameter; that of the file if it is not a parameter."""
        name = self.names.get((element, i, attribute))
        return stated if name is None else self.values[name]

    # ---- joints ----------------------------------------------------------------------------------

    def _joint(self, j: int, terms: JointTerms) -> set[str]:
        """Write the terms at a joint; returns the names of the parameters in them."""
        joint = self.mechanism.joints[j]
        friction = self._number_of("joint", j, "frictionloss", joint.friction_loss)
        damping = self._number_of("joint", j, "damping", joint.damping)
        if self.is_urdf:
            return self._urdf_terms(j, terms, friction, damping)
        tag, why = self._tag_of("joint", j, joint.name)
        if tag is None:
            self.left.append(f"effects at {joint.name}: {why}")
            return set()
        written = set()
        if terms.friction:
            written |= self._set_value(tag, j, "frictionloss", friction + terms.friction)
            self._write_onset(tag, joint, friction, terms)
        if terms.damping.any():
            total = self._polynomial("joint", j, "damping") + terms.damping
            written |= self._set_polynomial(tag, j, "damping", total)
        if terms.spring.any():
            written |= self._spring(tag, j, joint, terms)
        if terms.stop is not None:
            self._stop(tag, joint, terms)
        if terms.behind is not None:
            written |= self._behind(tag, j, joint, terms.behind)
        for b in terms.bristles:
            values = numbers([b.stiffness, b.damping, b.sliding, b.static, b.velocity])
            self._add_motor(tag, j, "friction", f'lugre="{values}"')
        for w in terms.waves:
            values = numbers([w.amplitude, w.poles, w.phase])
            self._add_motor(tag, j, "cogging", f'cogging="{values}"')
        return written

    def _set_value(
        self, tag: Tag, j: int, attribute: str, value: float, text: str = "", word: str = ""
    ) -> set[str]:
        name = self.names["joint", j, attribute]
        parameter = next(p.parameter for p in self.mechanism.parameters if p.parameter.name == name)
        self.edits.set(tag, word or attribute, text or number(value))
        self.changed[name] = (parameter.value * parameter.factor, value)
        return {name}

    def _set_polynomial(self, tag: Tag, j: int, word: str, total: Array) -> set[str]:
        """Write all coefficients of a joint's spring or damper."""
        written = self._set_value(tag, j, word, float(total[0]), _trimmed(total))
        for power, value in zip(("quadratic", "cubic"), total[1:], strict=True):
            if ("joint", j, f"{word}_{power}") in self.names:
                written |= self._set_value(
                    tag, j, f"{word}_{power}", float(value), _trimmed(total), word
                )
        return written

    def _write_onset(
        self, tag: Tag, joint: MechanismJoint, friction: float, terms: JointTerms
    ) -> None:
        """Write the onset of the friction.

        Friction of the file itself keeps its softness. Dry friction is as hard as the step allows.
        One with an onset has its slope b / R at rest (documentation, Computation, Constraint model,
        friction loss).
        """
        if friction:
            return
        m = self.file.model
        finest = 2.0 * float(m.opt.timestep) / (FINER_STEPS if self._is_safe() else 1)
        if not terms.onset:
            self.edits.set(tag, "solreffriction", numbers([finest, 1.0]))
            return
        weight = self._weight(joint)
        # b / R = 2 / (time constant * (1 - impedance) * weight)
        wanted = 2.0 * terms.onset / (weight * terms.friction)
        impedance, least = SOFT, 2.0 * float(m.opt.timestep)
        constant = wanted / (1.0 - impedance)
        if constant < least:
            constant, impedance = least, min(max(1.0 - wanted / least, SOFT), 0.9999)
        self.edits.set(tag, "solreffriction", numbers([constant, 1.0]))
        self.edits.set(tag, "solimpfriction", numbers([impedance, impedance, 0.001]))

    def _weight(self, joint: MechanismJoint) -> float:
        """Inverse inertia at a joint."""
        name = self.file.name("joint", self.mechanism.joints.index(joint))
        return self.weights.get(name, float(self.file.model.dof_invweight0[joint.dof]))

    def _is_safe(self) -> bool:
        """True if MuJoCo itself keeps time constants of constraints above two steps."""
        off = int(self.file.mujoco.mjtDisableBit.mjDSBL_REFSAFE)
        return not int(self.file.model.opt.disableflags) & off

    def _angle(self, joint: MechanismJoint, value: float) -> str:
        turned = self.degrees and joint.kind == "hinge"
        return number(float(np.degrees(value)) if turned else value)

    def _spring(self, tag: Tag, j: int, joint: MechanismJoint, terms: JointTerms) -> set[str]:
        """Polynomial about one of its zeros, which is the spring's reference."""
        old = JointTerms()
        first, square, cube = self._polynomial("joint", j, "stiffness")
        rest = joint.spring_reference
        old.add_spring(first, 0.0, rest)
        old.spring += square * np.array([rest**2, -2.0 * rest, 1.0, 0.0])
        old.add_spring(0.0, cube, rest)
        total = np.polynomial.Polynomial(old.spring + terms.spring)
        if not total.coef[1:].any():  # a constant: a weak spring, relaxed far away
            weak = TINY_SPRING * abs(float(total.coef[0]))
            total = np.polynomial.Polynomial([float(total.coef[0]), weak])
        roots = [complex(z) for z in total.trim().roots()]
        zeros = [z.real for z in roots if abs(z.imag) < 1e-9 * (1.0 + abs(z))]
        if not zeros:
            self.left.append(f"effects at {joint.name}: their spring has no point of rest")
            return set()
        zero = min(zeros, key=lambda z: abs(z - joint.reference))
        about = [float(total.deriv(k)(zero)) if k else 0.0 for k in (1, 2, 3)]
        coefficients = np.array([about[0], about[1] / 2.0, about[2] / 6.0])
        self.edits.set(tag, "springref", self._angle(joint, zero))
        return self._set_polynomial(tag, j, "stiffness", coefficients)

    def _stop(self, tag: Tag, joint: MechanismJoint, terms: JointTerms) -> None:
        """Range that both the file's limits and the buffers leave to the joint."""
        assert terms.stop is not None
        stop = terms.stop
        low, high = joint.range or (-np.inf, np.inf)
        if low > stop.low and high < stop.high:
            return  # never reached
        if joint.range is not None and (low > stop.low or high < stop.high):
            self.notes.append(f"{joint.name}: one of its limits keeps the softness of the file")
        ends = [max(low, stop.low), min(high, stop.high)]
        weight = self._weight(joint)
        self.edits.set(tag, "limited", "true")
        self.edits.set(tag, "range", " ".join(self._angle(joint, end) for end in ends))
        for attribute, value in _as_limit(stop.stiffness, stop.damping, weight).items():
            self.edits.set(tag, attribute, value)

    def _behind(self, tag: Tag, j: int, joint: MechanismJoint, behind: FlexibleLoad) -> set[str]:
        """A second joint on the same axis, with the motor's inertia on the first."""
        name = self.file.name("joint", j)
        load = max(joint.typical_inertia - joint.armature, 1e-12)
        share = 1.0 if behind.share >= MOSTLY_BEHIND else behind.share
        body = self._body_to_divide(tag, joint) if share < 1.0 else None
        if share < 1.0 and body is None:
            self.notes.append(
                f"{name}: all of the load is behind the second joint, not {share:.0%} of it; the "
                "rest is an armature"
            )
        w = 2.0 * np.pi * behind.frequency
        stiffness = behind.share * load * w * w
        damping = 2.0 * behind.damping_ratio * w * behind.share * load
        armature = self._number_of("joint", j, "armature", joint.armature)
        # with all other joints giving way, as the effect has it
        felt = 1.0 / max(float(self.file.model.dof_invweight0[joint.dof]), 1e-12)
        near = (1.0 - share) * max(felt - joint.armature, 1e-12)
        needed = max(armature + (near if body is None else 0.0), LEAST_ARMATURE * load)
        if body is not None:
            self.notes.append(
                f"{name}: {share:.0%} of its load is written as a body behind a second joint"
            )
        words = {
            "name": f"{name}_behind",
            "type": joint.kind,
            "pos": numbers(joint.anchor),
            "axis": numbers(joint.axis),
            "ref": "0",
            "springref": "0",
            "damping": "0",
            "stiffness": "0",
            "armature": "0",
            "frictionloss": "0",
            "limited": "false",
            "actuatorfrclimited": "false",
        }
        if behind.half_gap > 0.0:
            weight = self.weights.get(words["name"], 1.0 / load + 1.0 / (needed + near))
            gap = behind.half_gap
            words["limited"] = "true"
            words["range"] = " ".join(self._angle(joint, end) for end in (-gap, gap))
            words |= _as_limit(stiffness, damping, weight)
        else:
            words |= {"stiffness": number(stiffness), "damping": number(damping)}
        attributes = " ".join(f'{key}="{value}"' for key, value in words.items())
        self.added_joints.append((joint.qpos + 1, joint.dof + 1))
        written = set()
        if body is None:
            self.edits.add_after(tag, f"<joint {attributes}/>")
        else:
            written |= self._split_body(tag, body, joint, near, f"<joint {attributes}/>")
        if needed > armature:
            written |= self._set_value(tag, j, "armature", needed)
        return written

    def _body_to_divide(self, tag: Tag, joint: MechanismJoint) -> Tag | None:
        """The <body> of a joint, if it has no other joint."""
        alone = sum(other.body == joint.body for other in self.mechanism.joints) == 1
        parent = self.tags[tag.parent] if tag.parent >= 0 else tag
        has_mass = self.mechanism.bodies[joint.body].mass_kg > 0.0
        return parent if alone and has_mass and parent.name == "body" else None

    def _split_body(
        self, tag: Tag, outer: Tag, joint: MechanismJoint, near: float, second: str
    ) -> set[str]:
        """Divide a body at a joint.

        The part that turns with the motor has this inertia about the joint. The rest becomes a
        separate body behind the second joint, with all that follows the joint in the text.
        """
        body = self.bodies[joint.body]
        part = min(near / _inertia_about(body, joint), MOSTLY_BEHIND)
        place = {"pos": numbers(body.centre), "quat": numbers(body.inertia_quaternion)}

        def inertial(share: float) -> str:
            words = {
                **place,
                "mass": number(share * body.mass_kg),
                "diaginertia": numbers([share * v for v in body.inertia]),
            }
            attributes = " ".join(f'{k}="{v}"' for k, v in words.items())
            return f"<inertial {attributes}/>"

        stated = self._inside(outer, "inertial")
        if stated is not None:
            self.edits.remove(stated)
        name = f"{self.file.name('body', joint.body)}_behind"
        self.edits.add_after(
            tag, f'{inertial(part)}<body name="{name}">{second}{inertial(1.0 - part)}'
        )
        self.edits.add_last(outer, "</body>")
        return {self.names["body", joint.body, "mass"]}

    def _extend_keyframes(self) -> None:
        """Add positions and velocities of new joints to the keyframes: zero."""
        for key in (t for t in self.tags if t.name == "key"):
            for place, attribute in enumerate(("qpos", "qvel")):
                parts = key.attributes.get(attribute, "").split()
                if parts and self.added_joints:
                    for at in sorted((pair[place] for pair in self.added_joints), reverse=True):
                        parts.insert(at, "0")
                    self.edits.set(key, attribute, " ".join(parts))

    def _add_motor(self, tag: Tag, j: int, word: str, attribute: str) -> None:
        """Add a motor without a command that only has friction or a periodic torque."""
        joint = self.file.name("joint", j)
        self.edits.set(tag, "name", joint)
        used_names = {t.attributes.get("name") for t in self.tags} | self.motors
        name = next(
            name
            for name in (f"{joint}_{word}{k}" for k in ("", *map(str, range(2, 1000))))
            if name not in used_names
        )
        self.motors.add(name)
        self.passive.append(
            f'<dcmotor name="{name}" joint="{joint}" input="none" gear="1" armature="0" '
            f'damping="0" motorconst="0" resistance="1" {attribute}/>'
        )

    def _add_passive(self) -> None:
        """Add the motors without a command behind all others, so that commands keep their order."""
        if not self.passive:
            return
        sections = [t for t in self.tags if t.name == "actuator" and t.parent == 0]
        if sections and sections[-1].closing > sections[-1].begin:
            for text in self.passive:
                self.edits.add_last(sections[-1], text)
        else:
            self.edits.add_last(self.tags[0], f"<actuator>{' '.join(self.passive)}</actuator>")

    # ---- actuators and sensors -------------------------------------------------------------------

    def _is_reshaped(self, i: int) -> bool:
        """True if an actuator's law is written as one of <general>."""
        terms, actuator = self.forms.commands.get(i, CommandTerms()), self.mechanism.actuators[i]
        lagged = terms.lag > 0.0 and actuator.dynamics == "none"
        if actuator.motor is not None:
            return False
        return terms.gain != 1.0 or terms.offset != 0.0 or lagged

    def _command(self, i: int, terms: CommandTerms) -> None:
        actuator = self.mechanism.actuators[i]
        tag, why = self._tag_of("actuator", i, actuator.name)
        if actuator.adr < 0:
            tag, why = None, "the file has no actuators"
        if tag is None:
            self.left.append(f"effects at the command of {actuator.name}: {why}")
            return
        if terms.delay:
            delay = terms.delay + self._number_of("actuator", i, "delay", actuator.delay_s)
            self._delay(tag, delay)
        low, high = actuator.command_range or (-np.inf, np.inf)
        # the file limits what the effects make of the command
        ends = sorted((end - terms.offset) / terms.gain for end in (low, high))
        ends = [max(ends[0], terms.low), min(ends[1], terms.high)]
        if np.isfinite(ends).any() and ends != [low, high]:
            wide = 1e6
            self.edits.set(tag, "ctrllimited", "true")
            self.edits.set(tag, "ctrlrange", numbers(np.clip(ends, -wide, wide)))
            self.edits.set(tag, "inheritrange", None)
        if actuator.motor is not None and (terms.gain != 1.0 or terms.offset or terms.lag):
            self.left.append(
                f"effects at the command of {actuator.name}: a dcmotor has no gain, offset or lag "
                "of its command"
            )
        if not self._is_reshaped(i):
            return
        if actuator.dynamics == "integrator":
            self.left.append(
                f"effects at the command of {actuator.name}: it is integrated, and has no gain"
            )
            return
        arrays = self._actuator_arrays(i)
        gain, bias, dynamics = arrays["gainprm"], arrays["biasprm"], arrays["dynprm"]
        bias[:3] += terms.offset * gain[:3]
        gain[:3] *= terms.gain
        lag = {}
        if terms.lag and actuator.dynamics == "none":
            dynamics[0] = terms.lag
            lag = {"dyntype": "filterexact"}
        elif terms.lag:
            dynamics[0] += terms.lag
            self.notes.append(f"{actuator.name}: its lags are written as one")
        self._as_general(tag, i, arrays, lag)

    def _actuator_arrays(self, i: int) -> dict[str, Array]:
        """Gain, bias and dynamics of an actuator with the new values."""
        m = self.file.model
        arrays = {
            word: np.array(getattr(m, f"actuator_{word}")[i])
            for word in ("gainprm", "biasprm", "dynprm")
        }
        for p in self.mechanism.parameters:
            for w in p.writes if (p.element, p.number) == ("actuator", i) else ():
                if (word := w.array.removeprefix("actuator_")) in arrays:
                    arrays[word][w.column] = w.factor * self.values[p.parameter.name]
        return arrays

    def _as_general(
        self, tag: Tag, i: int, arrays: Mapping[str, Array], words: Mapping[str, str]
    ) -> None:
        """Write an actuator's law as <general>, without the attributes of a shortcut."""
        m, file = self.file.model, self.file
        types = {
            "dyntype": file.word("mjtDyn", m.actuator_dyntype[i]),
            "gaintype": file.word("mjtGain", m.actuator_gaintype[i]),
            "biastype": "affine",
            **words,
        }
        if tag.name != "general":
            self.edits.rename(tag, "general")
            for attribute in ("kp", "kv", "dampratio", "timeconst", "inheritrange"):
                self.edits.set(tag, attribute, None)
            if m.actuator_ctrllimited[i] and not {"ctrlrange"} & set(tag.attributes):
                self.edits.set(tag, "ctrlrange", numbers(m.actuator_ctrlrange[i]))
        for word, value in types.items():
            self.edits.set(tag, word, value)
        for word, values in arrays.items():
            self.edits.set(tag, word, _trimmed(values))

    def _delay(self, tag: Tag, delay: float) -> None:
        """Write a delay, with room for it at a finer step.

        It is slightly shorter, so that rounded times do not turn a number of whole steps into one
        more.
        """
        step = float(self.file.model.opt.timestep) / FINER_STEPS
        self.edits.set(tag, "delay", number(delay * (1.0 - DELAY_ROUNDING)))
        self.edits.set(tag, "nsample", str(int(np.ceil(delay / step)) + 2))

    def _reading(self, s: int, terms: ReadingTerms) -> None:
        sensor = self.mechanism.sensors[s]
        at = int(np.searchsorted(self.file.model.sensor_adr, sensor.adr, "right")) - 1
        name = self.file.mujoco.mj_id2name(
            self.file.model, self.file.mujoco.mjtObj.mjOBJ_SENSOR, at
        )
        tags = [t for t in self.tags if self._is(t, "sensor") and t.attributes.get("name") == name]
        if not name or len(tags) != 1:
            self.left.append(f"effects at the reading of {sensor.name}: the sensor has no name")
            return
        if terms.delay:
            stated = float(self.file.model.sensor_delay[at])
            self._delay(tags[0], terms.delay + stated)
        if np.isfinite(terms.cutoff):
            self.edits.set(tags[0], "cutoff", number(terms.cutoff))

    def _actuator(self, tag: Tag, parameter: ModelParameter, value: float) -> str:
        shortcut = {
            ("position", "kp"): "kp",
            ("position", "kv"): "kv",
            ("intvelocity", "kp"): "kp",
            ("intvelocity", "kv"): "kv",
            ("velocity", "kv"): "kv",
            ("position", "time_constant"): "timeconst",
        }.get((tag.name, parameter.attribute))
        if parameter.attribute == "delay":
            self._delay(tag, value)
            return ""
        if parameter.attribute == "gear":
            rest = list(self.file.model.actuator_gear[parameter.number])[1:]
            whole = len(tag.attributes.get("gear", "").split()) > 1
            self.edits.set(tag, "gear", numbers([value, *rest]) if whole else number(value))
            return ""
        if tag.name == "dcmotor":
            self._dc_motor(tag, parameter.number, parameter.attribute)
            return ""
        if shortcut:
            self.edits.set(tag, shortcut, number(value))
            if shortcut == "kv" and "dampratio" in tag.attributes:
                self.edits.set(tag, "dampratio", None)
            return ""
        if tag.name != "general":
            self._as_general(tag, parameter.number, self._actuator_arrays(parameter.number), {})
            return ""
        for write in parameter.writes:
            word = write.array.removeprefix("actuator_")
            vector = np.array(getattr(self.file.model, write.array)[write.row])
            vector = self.vectors.setdefault((parameter.number, word), vector)
            vector[write.column] = write.factor * value
            self.edits.set(tag, word, numbers(list(np.trim_zeros(vector, "b"))))
        return ""

    def _dc_motor(self, tag: Tag, i: int, attribute: str) -> None:
        """Write a parameter with its neighbours in the attributes of <dcmotor>."""
        m, actuator = self.file.model, self.mechanism.actuators[i]
        motor = actuator.motor
        assert motor is not None

        def values(*words: str, stated: Sequence[float]) -> list[float]:
            pairs = zip(words, stated, strict=True)
            return [self._number_of("actuator", i, word, value) for word, value in pairs]

        if attribute in ("resistance", "motorconst", "time_constant"):
            resistance, constant = values(
                "resistance", "motorconst", stated=(motor.resistance, motor.constant)
            )
            self.edits.set(tag, "nominal", None)
            self.edits.set(tag, "resistance", number(resistance))
            self.edits.set(tag, "motorconst", number(constant))
            if actuator.time_constant_s > 0.0:
                lag = values("time_constant", stated=(actuator.time_constant_s,))
                self.edits.set(tag, "inductance", numbers([0.0, *lag]))
            if actuator.force_range is not None:
                torque = actuator.force_range[1]
                self.edits.set(tag, "saturation", numbers([torque, 0.0, motor.current_rate]))
        elif attribute in ("kp", "ki", "kd"):
            gains = values("kp", "ki", "kd", stated=motor.controller)
            rest = [m.actuator_dynprm[i, 7], motor.integral_limit, motor.voltage_limit]
            self.edits.set(tag, "controller", numbers([*gains, *rest]))
        elif attribute == "cogging":
            amplitude = values("cogging", stated=motor.cogging[:1])
            self.edits.set(tag, "cogging", numbers([*amplitude, *motor.cogging[1:]]))
        elif attribute.startswith("thermal"):
            _, _, ambient, reference, coefficient = motor.heating
            heat = values("thermal_resistance", "thermal_capacitance", stated=motor.heating[:2])
            self.edits.set(tag, "thermal", numbers([*heat, 0.0, coefficient, reference, ambient]))
        else:
            words = [
                f"lugre_{w}" for w in ("stiffness", "damping", "coulomb", "static", "stribeck")
            ]
            self.edits.set(tag, "lugre", numbers(values(*words, stated=motor.bristles)))

    # ---- bodies ----------------------------------------------------------------------------------

    def _mass(self, tag: Tag, parameter: ModelParameter, value: float) -> str:
        body, inertial = self.bodies[parameter.number], self._inside(tag, "inertial")
        ratio = value / self.mechanism.bodies[parameter.number].mass_kg
        if self.is_urdf:
            return self._urdf_mass(inertial, value, ratio)
        if inertial is None:
            # the shape stays: principal axes and centre as MuJoCo makes them of the geoms
            words = {
                "pos": numbers(body.centre),
                "quat": numbers(body.inertia_quaternion),
                "mass": number(value),
                "diaginertia": numbers(body.inertia),
            }
            attributes = " ".join(f'{k}="{v}"' for k, v in words.items())
            self.edits.add_inside(tag, f"<inertial {attributes}/>")
            return ""
        self.edits.set(inertial, "mass", number(value))
        for attribute in ("diaginertia", "fullinertia"):
            if stated := inertial.attributes.get(attribute):
                self.edits.set(
                    inertial, attribute, numbers([ratio * float(v) for v in stated.split()])
                )
        return ""

    def _whole_inertia(self, shape: BodyShape, written: Collection[str]) -> set[str]:
        """Write a body's mass, centre and inertia about it along the body's axes.

        Returns the name of the mass, which is written with them. written: masses that are already
        in the text.
        """
        old, new = self.mechanism.bodies[shape.number], self.bodies[shape.number]
        mass = self.names["body", shape.number, "mass"]
        if mass in written:
            return set()
        tag, why = self._tag_of("body", shape.number, old.name)
        if tag is not None:
            why = (self._urdf_inertial if self.is_urdf else self._inertial)(tag, new)
        if why:
            self.left.append(f"inertia of {old.name}: {why}")
            return {mass}
        before, now = inertia_values(shape, old), inertia_values(shape, new)
        self.changed |= {name: (before[name], now[name]) for name in now}
        self.changed[mass] = (old.mass_kg, new.mass_kg)
        return {mass}

    def _inertial(self, tag: Tag, body: Body) -> str:
        words = {
            "pos": numbers(body.centre),
            "mass": number(body.mass_kg),
            "fullinertia": _exact_text(full_inertia(body)),
        }
        inertial = self._inside(tag, "inertial")
        if inertial is None:
            attributes = " ".join(f'{k}="{v}"' for k, v in words.items())
            self.edits.add_inside(tag, f"<inertial {attributes}/>")
            return ""
        for word in (*_ORIENTATIONS, "diaginertia"):
            self.edits.set(inertial, word, None)
        for word, value in words.items():
            self.edits.set(inertial, word, value)
        return ""

    # ---- URDF ------------------------------------------------------------------------------------

    def _urdf_inertial(self, tag: Tag, body: Body) -> str:
        full = full_inertia(body)
        inertia = {f"i{AXES[i]}{AXES[k]}": repr(float(full[i, k])) for i, k in PAIRS}
        parts = {
            "origin": {"xyz": numbers(body.centre), "rpy": "0 0 0"},
            "mass": {"value": number(body.mass_kg)},
            "inertia": inertia,
        }
        inertial = self._inside(tag, "inertial")
        if inertial is None:
            return "its <link> has no <inertial>"
        for name, words in parts.items():
            part = self._inside(inertial, name)
            if part is None:
                attributes = " ".join(f'{k}="{v}"' for k, v in words.items())
                self.edits.add_inside(inertial, f"<{name} {attributes}/>")
                continue
            for word, value in words.items():
                self.edits.set(part, word, value)
        return ""

    def _urdf_mass(self, inertial: Tag | None, value: float, ratio: float) -> str:
        mass = None if inertial is None else self._inside(inertial, "mass")
        if inertial is None or mass is None:
            return "its <link> has no <inertial>"
        self.edits.set(mass, "value", number(value))
        if about := self._inside(inertial, "inertia"):
            for name, key in about.attributes.items():
                self.edits.set(about, name, number(ratio * float(key)))
        return ""

    def _urdf_joint(self, tag: Tag, attribute: str, value: float) -> str:
        word = _URDF_WORDS.get(attribute)
        if word is None:
            return f"URDF has no {attribute}"
        dynamics = self._inside(tag, "dynamics")
        if dynamics is None:
            self.dynamics.setdefault(tag.begin, {})[word] = value
        else:
            self.edits.set(dynamics, word, number(value))
        return ""

    def _urdf_terms(self, j: int, terms: JointTerms, friction: float, damping: float) -> set[str]:
        """Write friction and linear damping of a joint; URDF has no more."""
        joint = self.mechanism.joints[j]
        tag, why = self._tag_of("joint", j, joint.name)
        others = {
            "its drag": terms.damping[1:].any(),
            "its spring or constant force": terms.spring.any(),
            "its periodic torque": bool(terms.waves),
            "its end stop": terms.stop is not None,
            "the load behind its motor": terms.behind is not None,
        }
        self.left += [
            f"{joint.name}: URDF has no attribute for {k}" for k, v in others.items() if v
        ]
        if tag is None:
            self.left.append(f"effects at {joint.name}: {why}")
            return set()
        sliding = sum(b.sliding for b in terms.bristles)
        if sliding:
            self.notes.append(f"{joint.name}: its friction is written at its sliding level")
        totals = {
            "frictionloss": (terms.friction + sliding, friction),
            "damping": (float(terms.damping[0]), damping),
        }
        written = set()
        for attribute, (more, stated) in totals.items():
            if more:
                self._urdf_joint(tag, attribute, stated + more)
                name = self.names["joint", j, attribute]
                self.changed[name] = (stated, stated + more)
                written.add(name)
        return written

    def _add_dynamics(self) -> None:
        """Write <dynamics> of the joints without one."""
        for tag in self.tags:
            if dynamics := self.dynamics.get(tag.begin):
                values = {"damping": 0.0, "friction": 0.0} | dynamics
                attributes = " ".join(f'{word}="{number(value)}"' for word, value in values.items())
                self.edits.add_inside(tag, f"<dynamics {attributes}/>")


def inertia_values(shape: BodyShape, body: Body) -> dict[str, float]:
    """Centre (m) and inertia about it along the body's axes (kg m2) by name."""
    full = full_inertia(body)
    return {
        **dict(zip(shape.centre_names, body.centre, strict=True)),
        **{n: float(full[i, k]) for n, (i, k) in zip(shape.inertia_names, PAIRS, strict=True)},
    }


def _exact_text(full: Array) -> str:
    """Full inertia with all digits, because a rounded one of a thin plate may be invalid."""
    return " ".join(repr(float(full[i, k])) for i, k in PAIRS)


def _inertia_about(body: Body, joint: MechanismJoint) -> float:
    """Inertia of a body about a hinge, kg m2; its mass at a slide."""
    if joint.kind == "slide":
        return body.mass_kg
    axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
    turn = Rotation.from_quat(body.inertia_quaternion, scalar_first=True)
    central = float((turn.inv().apply(axis) ** 2) @ body.inertia)
    arm = np.cross(axis, np.array(body.centre) - joint.anchor)
    return central + body.mass_kg * float(arm @ arm)


def _as_limit(stiffness: float, damping: float, weight: float) -> dict[str, str]:
    """Limit that acts as a spring and a damper (documentation, Computation, Constraint model).

    At impedance d it exerts d (-b v - k r - a) / weight, with k = -solref[0] / d and b = -solref[1]
    / d, r the distance beyond the limit and a the acceleration without it.
    """
    return {
        "solreflimit": numbers([-stiffness * weight, -damping * weight]),
        "solimplimit": numbers([SOFT, SOFT, 0.001]),
    }
