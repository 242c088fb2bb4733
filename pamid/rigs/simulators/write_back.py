"""Writing of a finding into the text of a model file, MJCF or URDF.

It covers values of parameters, and effects as elements of MuJoCo (`mujoco_forms.py`).
Elements are identified by their name or by the line at which MuJoCo read them. Attributes are
changed. Elements are added for a body without <inertial>, a load behind its motor, and friction
with bristles. MuJoCo reads the new text again, and every value that it does not return is reported.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.rigs.simulators.body_inertia import AXES, PAIRS, BodyShape, full_inertia, shapes_of
from pamid.rigs.simulators.mechanism import (
    Body,
    Mechanism,
    MechanismJoint,
    ModelParameter,
    write_values,
)
from pamid.rigs.simulators.mujoco_file import MujocoFile, open_mujoco
from pamid.rigs.simulators.mujoco_forms import (
    TINY_SPRING,
    CommandTerms,
    FlexibleLoad,
    Forms,
    IdentifiedEffect,
    JointTerms,
    ReadingTerms,
    Stop,
    forms_of,
)
from pamid.rigs.simulators.mujoco_mechanism import mechanism_of, winding_motor
from pamid.rigs.simulators.mujoco_ports import numbered
from pamid.rigs.simulators.xml_text import Edits, Tag, tags_of

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
    """Write values (SI, by parameter) and effects into the mechanism's file.

    Values of a `BodyShape` change the whole inertia of its body. FileError if the file can no
    longer be read.
    """
    path = Path(mechanism.path)
    text, file = path.read_bytes(), open_mujoco(path)
    forms = forms_of(mechanism, effects)
    weights: dict[str, float] = {}
    # limits and soft friction are in units of the inverse inertia, which the other changes decide
    weighted = any(
        t.stop or t.onset or (t.behind is not None and t.behind.half_gap > 0.0)
        for t in forms.joints.values()
    )
    for _ in range(2 if weighted else 1):
        writer = _Writer(file, mechanism, text, forms, dict(values), weights)
        written = writer.write()
        file_again = read_text(path, written)
        m = file_again.model
        weights = {
            file_again.name("joint", j): float(m.dof_invweight0[m.jnt_dofadr[j]])
            for j in range(m.njnt)
        }
    reread = mechanism_of(file_again)
    read = {p.parameter.name: p.parameter.value * p.parameter.factor for p in reread.parameters}
    sizes: dict[str, float] = {}  # products of inertia and centres may be next to zero
    for shape in shapes_of(reread):
        read |= inertia_values(shape, shape.body)
        sizes |= dict.fromkeys(shape.centre_names, shape.radius_m)
        sizes |= dict.fromkeys(shape.inertia_names, max(shape.body.inertia))
    left, changed = list(writer.left), dict(writer.changed)
    for name, (_, value) in writer.changed.items():
        got = read.get(name, 0.0)
        if abs(got - value) > SAME * max(abs(value), sizes.get(name, 1e-12)):
            del changed[name]
            left.append(f"{name}: MuJoCo makes {got:.6g} of {value:.6g} (a setting of <compiler>?)")

    # a command of <general> has no unit
    columns = {a.name: a.column for a in mechanism.actuators}
    actuators = tuple(replace(a, column=columns.get(a.name, a.column)) for a in reread.actuators)
    notes = (*forms.notes, *writer.notes)
    reread = replace(reread, actuators=actuators)
    return WrittenModel(written, changed, tuple(left), notes, file_again, reread)


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


def number(value: float) -> str:
    """Shortest text of a number that keeps all significant digits."""
    return f"{value:.10g}"


def numbers(values: Sequence[float] | Array) -> str:
    return " ".join(map(number, values))


def element_text(name: str, words: Mapping[str, str]) -> str:
    """Element without content."""
    attributes = " ".join(f'{key}="{value}"' for key, value in words.items())
    return f"<{name} {attributes}/>"


def _trimmed(values: Array) -> str:
    """Numbers without the zeros at the end; the first digit stays."""
    last = int(np.max(np.flatnonzero(values), initial=0))
    return numbers(values[: last + 1])


class _Writer:
    """A pass over a file's text.

    weights: inverse inertia at every joint of the changed model by name, empty in the first pass.

    The new values stand in a copy of the compiled model, those of effects included. What differs
    there from the file is written.
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
        self.forms, self.weights = forms, weights
        self.new = file.copy()
        write_values(self.new, mechanism, values)
        self.tags = tags_of(text)
        self.edits = Edits(text)
        self.is_urdf = self.tags[0].name == "robot"
        self.changed: dict[str, tuple[float, float]] = {}
        self.done: set[str] = set()  # parameters that are in the text, or cannot be
        self.left: list[str] = []
        self.notes: list[str] = []
        self.passive: list[str] = []
        self.motors: set[str] = set()
        self.added_joints: list[tuple[int, int]] = []  # places of their position and velocity
        self.with_dynamics: set[int] = set()  # joints of a URDF that have got <dynamics>
        angles = [t.attributes.get("angle") for t in self.tags if t.name == "compiler"]
        self.degrees = not self.is_urdf and "radian" not in angles
        self.parameters = {(p.element, p.number, p.attribute): p for p in mechanism.parameters}
        self.shapes = [s for s in shapes_of(mechanism) if s.centre_names[0] in values]
        self.bodies = [
            body.scaled(float(self.new.body_mass[i])) for i, body in enumerate(mechanism.bodies)
        ]
        for shape in self.shapes:
            mass = self.bodies[shape.number].mass_kg
            self.bodies[shape.number] = shape.deformed(values, mass)

    def write(self) -> bytes:
        """The changed text."""
        for j, joint_terms in self.forms.joints.items():
            self._joint(j, joint_terms)
        for i, terms in self.forms.commands.items():
            self._command(i, terms)
        for s, reading in self.forms.readings.items():
            self._reading(s, reading)
        for shape in self.shapes:
            self._whole_inertia(shape)
        for parameter in self.mechanism.parameters:
            self._write(parameter)
        # motors without a command stand behind all others, so that commands keep their order
        sections = [t for t in self.tags if t.name == "actuator" and t.parent == 0]
        if sections and sections[-1].closing > sections[-1].begin:
            for text in self.passive:
                self.edits.add_last(sections[-1], text)
        elif self.passive:
            self.edits.add_last(self.tags[0], f"<actuator>{' '.join(self.passive)}</actuator>")

        for key in (t for t in self.tags if t.name == "key"):
            for place, attribute in enumerate(("qpos", "qvel")):
                parts = key.attributes.get(attribute, "").split()
                if parts and self.added_joints:
                    for at in sorted((pair[place] for pair in self.added_joints), reverse=True):
                        parts.insert(at, "0")
                    self.edits.set(key, attribute, " ".join(parts))
        return self.edits.made(self.tags)

    def _write_all(self, j: int, word: str) -> None:
        """Write an attribute of a joint with all its coefficients."""
        for name in (word, f"{word}_quadratic", f"{word}_cubic"):
            if (p := self.parameters.get(("joint", j, name))) is not None:
                self._write(p, forced=True)

    def _write(self, p: ModelParameter, *, forced: bool = False) -> None:
        """Write a parameter that has changed, or any by force."""
        name, was, now = p.parameter.name, p.stated, p.value_in(self.new)
        same = not forced and abs(now - was) <= UNCHANGED * max(abs(was), abs(now))
        if same or name in self.done:
            return
        self.done.add(name)
        tag, why = self._tag_of(p.element, p.number, p.of)
        why = why if tag is None else self._put(tag, p)
        if why:
            self.left.append(f"{name} = {now:.6g}: {why}")
        else:
            self.changed[name] = (was, now)

    def _put(self, tag: Tag, p: ModelParameter) -> str:
        """Note a change; returns the reason why it is impossible, or ""."""
        if p.element == "body":
            return self._mass(tag, p)
        if self.is_urdf:
            return self._urdf_joint(tag, p)
        if p.element == "actuator":
            self._actuator(tag, p)
            return ""
        word, write = p.attribute.partition("_")[0], p.writes[0]
        values = self._polynomial(write.array.removesuffix("poly"), write.row)
        if word == "springyield":
            self.edits.set(tag, word, self._angle(self.mechanism.joints[p.number], values[0]))
        else:
            self.edits.set(tag, word, _trimmed(values))
        return ""

    def _polynomial(self, array: str, row: int) -> Array:
        """New value of the model, with the coefficients of its second and third power if it has
        them."""
        powers = getattr(self.new, f"{array}poly", None)
        return np.array([getattr(self.new, array)[row], *([] if powers is None else powers[row])])

    def _set_polynomial(self, array: str, row: int, values: Array) -> None:
        getattr(self.new, array)[row] = values[0]
        getattr(self.new, f"{array}poly")[row] = values[1:]

    # ---- elements of the text --------------------------------------------------------------------

    def _tag_of(self, kind: str, i: int, of: str) -> tuple[Tag | None, str]:
        """Start tag of an element; else the reason why there is none."""
        name = self.file.stated_name(kind, i)
        kind_tags = [tag for tag in self.tags if self._is(tag, kind)]
        if name:
            matches = [tag for tag in kind_tags if tag.attributes.get("name") == name]
        else:
            line = self.file.line(kind, i)
            count = len(getattr(self.mechanism, _PLURAL.get(kind, f"{kind}s")))
            same = [k for k in range(count) if self.file.line(kind, k) == line]
            matches = [t for t in kind_tags if t.line == line and "name" not in t.attributes]
            # elements of a line stand in the order of their numbers
            matches = [matches[same.index(i)]] if len(matches) == len(same) else []
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

    # ---- joints ----------------------------------------------------------------------------------

    def _joint(self, j: int, terms: JointTerms) -> None:
        """Write the terms at a joint."""
        joint, new = self.mechanism.joints[j], self.new
        tag, why = self._tag_of("joint", j, joint.name)
        terms = self._in_urdf(joint, terms) if self.is_urdf else terms
        if tag is None:
            self.left.append(f"effects at {joint.name}: {why}")
            return
        dry = not new.dof_frictionloss[joint.dof]
        # both before either is written: a single element of a URDF holds them
        new.dof_frictionloss[joint.dof] += terms.friction
        total = self._polynomial("dof_damping", joint.dof)
        self._set_polynomial("dof_damping", joint.dof, total + terms.damping)
        if terms.friction:
            self._write_all(j, "frictionloss")
            if dry and not self.is_urdf:
                self._write_onset(tag, joint, terms)
        if terms.damping.any():
            self._write_all(j, "damping")
        if terms.spring.any():
            self._spring(tag, j, joint, terms)
        if terms.stop is not None:
            self._stop(tag, joint, terms.stop)
        if terms.behind is not None:
            self._behind(tag, j, joint, terms.behind)
        for attribute, values in terms.motors:
            # a motor without a command only has friction or a periodic torque
            name = self.file.name("joint", j)
            self.edits.set(tag, "name", name)
            stem = f"{name}_{'friction' if attribute == 'lugre' else attribute}"
            used_names = {t.attributes.get("name", "") for t in self.tags} | self.motors
            motor = numbered(stem, used_names, "")
            self.motors.add(motor)
            words = {
                "name": motor,
                "joint": name,
                "input": "none",
                "gear": "1",
                "armature": "0",
                "damping": "0",
                "motorconst": "0",
                "resistance": "1",
                attribute: numbers(values),
            }
            self.passive.append(element_text("dcmotor", words))

    def _write_onset(self, tag: Tag, joint: MechanismJoint, terms: JointTerms) -> None:
        """Write the onset of the friction of a joint without a loss in the file.

        Dry friction is as hard as the step allows. Friction with an onset has its slope b / R at
        rest (documentation, Computation, Constraint model, friction loss).
        """
        option = self.file.model.opt
        # MuJoCo itself keeps time constants of constraints above two steps
        finest = (
            2.0 * float(option.timestep) / (1 if self.file.disables("REFSAFE") else FINER_STEPS)
        )
        if not terms.onset:
            self.edits.set(tag, "solreffriction", numbers([finest, 1.0]))
            return
        weight = self._weight(joint)
        # b / R = 2 / (time constant * (1 - impedance) * weight)
        wanted = 2.0 * terms.onset / (weight * terms.friction)
        impedance, least = SOFT, 2.0 * float(option.timestep)
        constant = wanted / (1.0 - impedance)
        if constant < least:
            constant, impedance = least, min(max(1.0 - wanted / least, SOFT), 0.9999)
        self.edits.set(tag, "solreffriction", numbers([constant, 1.0]))
        self.edits.set(tag, "solimpfriction", numbers([impedance, impedance, 0.001]))

    def _weight(self, joint: MechanismJoint) -> float:
        """Inverse inertia at a joint."""
        name = self.file.name("joint", self.mechanism.joints.index(joint))
        return self.weights.get(name, float(self.file.model.dof_invweight0[joint.dof]))

    def _angle(self, joint: MechanismJoint, value: float) -> str:
        turned = self.degrees and joint.kind == "hinge"
        return number(float(np.degrees(value)) if turned else value)

    def _spring(self, tag: Tag, j: int, joint: MechanismJoint, terms: JointTerms) -> None:
        """Polynomial about that of its zeros which is the spring's reference."""
        old = JointTerms()
        first, square, cube = self._polynomial("jnt_stiffness", j)
        rest = joint.spring_reference
        old.add_spring(first, cube, rest)
        old.spring += square * np.array([rest**2, -2.0 * rest, 1.0, 0.0])
        total = np.polynomial.Polynomial(old.spring + terms.spring)
        if not total.coef[1:].any():  # a constant: a weak spring, relaxed far away
            weak = TINY_SPRING * abs(float(total.coef[0]))
            total = np.polynomial.Polynomial([float(total.coef[0]), weak])
        roots = [complex(z) for z in total.trim().roots()]
        zeros = [z.real for z in roots if abs(z.imag) < 1e-9 * (1.0 + abs(z))]
        if not zeros:
            self.left.append(f"effects at {joint.name}: their spring has no point of rest")
            return
        zero = min(zeros, key=lambda z: abs(z - joint.reference))
        about = np.array([float(total.deriv(k)(zero)) if k else 0.0 for k in (1, 2, 3)])
        self._set_polynomial("jnt_stiffness", j, about / [1.0, 2.0, 6.0])
        self.edits.set(tag, "springref", self._angle(joint, zero))
        self._write_all(j, "stiffness")

    def _stop(self, tag: Tag, joint: MechanismJoint, stop: Stop) -> None:
        """Range that both the file's limits and the buffers leave to the joint."""
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

    def _behind(self, tag: Tag, j: int, joint: MechanismJoint, behind: FlexibleLoad) -> None:
        """A second joint on the same axis, with the motor's inertia on the first."""
        name = self.file.name("joint", j)
        load = max(joint.typical_inertia - joint.armature, 1e-12)
        share = 1.0 if behind.share >= MOSTLY_BEHIND else behind.share
        body = None  # to divide: that of the joint, if it has no other joint
        if share < 1.0:
            parent = self.tags[tag.parent] if tag.parent >= 0 else tag
            alone = sum(other.body == joint.body for other in self.mechanism.joints) == 1
            if alone and parent.name == "body" and self.mechanism.bodies[joint.body].mass_kg > 0.0:
                body = parent
                self.notes.append(
                    f"{name}: {share:.0%} of its load is written as a body behind a second joint"
                )
            else:
                self.notes.append(
                    f"{name}: all of the load is behind the second joint, not {share:.0%} of it; "
                    "the rest is an armature"
                )
        w = 2.0 * np.pi * behind.frequency
        stiffness = behind.share * load * w * w
        damping = 2.0 * behind.damping_ratio * w * behind.share * load
        armature = float(self.new.dof_armature[joint.dof])
        # with all other joints giving way, as the effect has it
        felt = 1.0 / max(float(self.file.model.dof_invweight0[joint.dof]), 1e-12)
        near = (1.0 - share) * max(felt - joint.armature, 1e-12)
        needed = max(armature + (near if body is None else 0.0), LEAST_ARMATURE * load)
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
        self.added_joints.append((joint.qpos + 1, joint.dof + 1))
        if body is None:
            self.edits.add_after(tag, element_text("joint", words))
        else:
            self._split_body(tag, body, joint, near, element_text("joint", words))
        if needed > armature:
            self.new.dof_armature[joint.dof] = needed
            self._write_all(j, "armature")
        if behind.is_read:
            self._read_both(tag, name)

    def _read_both(self, tag: Tag, name: str) -> None:
        """Let the sensors of a joint read its sum with the joint behind it."""
        self.edits.set(tag, "name", name)
        readers = [
            t
            for t in self.tags
            if t.name in ("jointpos", "jointvel") and t.attributes.get("joint") == name
        ]
        if not readers:
            self.left.append(f"encoder of {name} behind its play: the file has no sensor of it")
            return
        output = f"{name}_output"
        parts = "".join(
            element_text("joint", {"joint": part, "coef": "1"}) for part in (name, f"{name}_behind")
        )
        self.edits.add_last(
            self.tags[0], f'<tendon><fixed name="{output}">{parts}</fixed></tendon>'
        )
        for reader in readers:
            self.edits.rename(reader, reader.name.replace("joint", "tendon"))
            self.edits.set(reader, "joint", None)
            self.edits.set(reader, "tendon", output)

    def _split_body(
        self, tag: Tag, outer: Tag, joint: MechanismJoint, near: float, second: str
    ) -> None:
        """Divide a body at a joint.

        The part that turns with the motor has this inertia about the joint. The rest becomes a
        separate body behind the second joint, with all that follows the joint in the text.
        """
        body = self.bodies[joint.body]
        whole = body.mass_kg  # at a slide; at a hinge, the inertia about its axis, kg m2
        if joint.kind != "slide":
            axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
            turn = Rotation.from_quat(body.inertia_quaternion, scalar_first=True)
            arm = np.cross(axis, np.array(body.centre) - joint.anchor)
            central = float((turn.inv().apply(axis) ** 2) @ body.inertia)
            whole = central + body.mass_kg * float(arm @ arm)
        part = min(near / whole, MOSTLY_BEHIND)
        place = {"pos": numbers(body.centre), "quat": numbers(body.inertia_quaternion)}

        def inertial(share: float) -> str:
            words = {
                **place,
                "mass": number(share * body.mass_kg),
                "diaginertia": numbers([share * v for v in body.inertia]),
            }
            return element_text("inertial", words)

        stated = self._inside(outer, "inertial")
        if stated is not None:
            self.edits.remove(stated)
        name = f"{self.file.name('body', joint.body)}_behind"
        self.edits.add_after(
            tag, f'{inertial(part)}<body name="{name}">{second}{inertial(1.0 - part)}'
        )
        self.edits.add_last(outer, "</body>")
        self.done.add(self.parameters["body", joint.body, "mass"].parameter.name)

    # ---- actuators and sensors -------------------------------------------------------------------

    def _command(self, i: int, terms: CommandTerms) -> None:
        actuator = self.mechanism.actuators[i]
        tag, why = self._tag_of("actuator", i, actuator.name)
        if actuator.adr < 0:
            tag, why = None, "the file has no actuators"
        if tag is None:
            self.left.append(f"effects at the command of {actuator.name}: {why}")
            return
        if terms.delay:
            self.new.actuator_delay[i] += terms.delay
            self._delay(tag, float(self.new.actuator_delay[i]))
        low, high = actuator.command_range or (-np.inf, np.inf)
        # the file limits what the effects make of the command
        ends = sorted((end - terms.offset) / terms.gain for end in (low, high))
        ends = [max(ends[0], terms.low), min(ends[1], terms.high)]
        if np.isfinite(ends).any() and ends != [low, high]:
            wide = 1e6
            self.edits.set(tag, "ctrllimited", "true")
            self.edits.set(tag, "ctrlrange", numbers(np.clip(ends, -wide, wide)))
            self.edits.set(tag, "inheritrange", None)

        if not (terms.gain != 1.0 or terms.offset or terms.lag):
            return
        if actuator.motor is not None:
            self.left.append(
                f"effects at the command of {actuator.name}: a dcmotor has no gain, offset or lag "
                "of its command"
            )
            return
        self.done |= {
            p.parameter.name
            for p in self.mechanism.parameters
            if (p.element, p.number) == ("actuator", i)
        }
        if actuator.dynamics == "integrator":
            self.left.append(
                f"effects at the command of {actuator.name}: it is integrated, and has no gain"
            )
            return
        new = self.new
        new.actuator_biasprm[i, :3] += terms.offset * new.actuator_gainprm[i, :3]
        new.actuator_gainprm[i, :3] *= terms.gain
        lag = {}
        if terms.lag and actuator.dynamics == "none":
            new.actuator_dynprm[i, 0] = terms.lag
            # RK4 averages the rate over its stages, which an exact step would correct once more
            is_averaged = self.file.word("mjtIntegrator", self.file.model.opt.integrator) == "rk4"
            lag = {"dyntype": "filter" if is_averaged else "filterexact"}
        elif terms.lag:
            new.actuator_dynprm[i, 0] += terms.lag
            self.notes.append(f"{actuator.name}: its lags are written as one")
        self._as_general(tag, i, lag)

    def _as_general(self, tag: Tag, i: int, words: Mapping[str, str]) -> None:
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
            if m.actuator_ctrllimited[i] and "ctrlrange" not in tag.attributes:
                self.edits.set(tag, "ctrlrange", numbers(m.actuator_ctrlrange[i]))
        for word, value in types.items():
            self.edits.set(tag, word, value)
        for word in ("gainprm", "biasprm", "dynprm"):
            self.edits.set(tag, word, _trimmed(getattr(self.new, f"actuator_{word}")[i]))

    def _delay(self, tag: Tag, delay: float) -> None:
        """Write a delay, with room for it at a finer step.

        It is slightly shorter, so that rounded times do not turn a number of whole steps into a
        larger number.
        """
        step = float(self.file.model.opt.timestep) / FINER_STEPS
        self.edits.set(tag, "delay", number(delay * (1.0 - DELAY_ROUNDING)))
        self.edits.set(tag, "nsample", str(int(np.ceil(delay / step)) + 2))

    def _reading(self, s: int, terms: ReadingTerms) -> None:
        sensor = self.mechanism.sensors[s]
        at = int(np.searchsorted(self.file.model.sensor_adr, sensor.adr, "right")) - 1
        name = self.file.stated_name("sensor", at)
        tags = [t for t in self.tags if self._is(t, "sensor") and t.attributes.get("name") == name]
        if not name or len(tags) != 1:
            self.left.append(f"effects at the reading of {sensor.name}: the sensor has no name")
            return
        if terms.delay:
            stated = float(self.file.model.sensor_delay[at])
            self._delay(tags[0], terms.delay + stated)
        if np.isfinite(terms.cutoff):
            self.edits.set(tags[0], "cutoff", number(terms.cutoff))

    def _actuator(self, tag: Tag, p: ModelParameter) -> None:
        i, value = p.number, p.value_in(self.new)
        shortcut = {
            ("position", "kp"): "kp",
            ("position", "kv"): "kv",
            ("intvelocity", "kp"): "kp",
            ("intvelocity", "kv"): "kv",
            ("velocity", "kv"): "kv",
            ("position", "time_constant"): "timeconst",
        }.get((tag.name, p.attribute))
        if p.attribute == "delay":
            self._delay(tag, value)
        elif p.attribute == "gear":
            whole = len(tag.attributes.get("gear", "").split()) > 1
            gears = self.new.actuator_gear[i]
            self.edits.set(tag, "gear", numbers(gears if whole else gears[:1]))
        elif tag.name == "dcmotor":
            for word, text in self._dc_motor(i, p.attribute).items():
                self.edits.set(tag, word, text)
        elif shortcut:
            self.edits.set(tag, shortcut, number(value))
            if shortcut == "kv" and "dampratio" in tag.attributes:
                self.edits.set(tag, "dampratio", None)
        elif tag.name != "general":
            self._as_general(tag, i, {})
        else:
            for write in p.writes:
                word = write.array.removeprefix("actuator_")
                self.edits.set(tag, word, _trimmed(getattr(self.new, write.array)[write.row]))

    def _dc_motor(self, i: int, attribute: str) -> dict[str, str | None]:
        """Attributes of <dcmotor> with a parameter and its neighbours."""
        motor, dynamics = winding_motor(self.new, i), self.new.actuator_dynprm[i]
        if attribute in ("resistance", "motorconst", "time_constant"):
            words: dict[str, str | None] = {
                "nominal": None,
                "resistance": number(motor.resistance),
                "motorconst": number(motor.constant),
            }
            if dynamics[0] > 0.0:
                words["inductance"] = numbers([0.0, dynamics[0]])
            if (limits := self.mechanism.actuators[i].force_range) is not None:
                words["saturation"] = numbers([limits[1], 0.0, motor.current_rate])
            return words
        if attribute in ("kp", "ki", "kd"):
            rest = dynamics[7], motor.integral_limit, motor.voltage_limit
            return {"controller": numbers([*motor.controller, *rest])}
        if attribute == "cogging":
            return {"cogging": numbers(motor.cogging)}
        if attribute.startswith("thermal"):
            resistance, capacitance, ambient, reference, coefficient = motor.heating
            heat = resistance, capacitance, 0.0, coefficient, reference, ambient
            return {"thermal": numbers(heat)}
        return {"lugre": numbers(motor.bristles)}

    # ---- bodies ----------------------------------------------------------------------------------

    def _mass(self, tag: Tag, p: ModelParameter) -> str:
        body, inertial = self.bodies[p.number], self._inside(tag, "inertial")
        value = body.mass_kg
        ratio = value / self.mechanism.bodies[p.number].mass_kg
        if self.is_urdf:
            mass = None if inertial is None else self._inside(inertial, "mass")
            if inertial is None or mass is None:
                return "its <link> has no <inertial>"
            self.edits.set(mass, "value", number(value))
            if about := self._inside(inertial, "inertia"):
                for name, key in about.attributes.items():
                    self.edits.set(about, name, number(ratio * float(key)))
            return ""
        if inertial is None:
            # the shape stays: principal axes and centre as MuJoCo makes them of the geoms
            words = {
                "pos": numbers(body.centre),
                "quat": numbers(body.inertia_quaternion),
                "mass": number(value),
                "diaginertia": numbers(body.inertia),
            }
            self.edits.add_inside(tag, element_text("inertial", words))
            return ""
        self.edits.set(inertial, "mass", number(value))
        for attribute in ("diaginertia", "fullinertia"):
            if stated := inertial.attributes.get(attribute):
                scaled = [ratio * float(v) for v in stated.split()]
                self.edits.set(inertial, attribute, numbers(scaled))
        return ""

    def _whole_inertia(self, shape: BodyShape) -> None:
        """Write a body's mass, centre and inertia about it along the body's axes."""
        old, new = self.mechanism.bodies[shape.number], self.bodies[shape.number]
        mass = self.parameters["body", shape.number, "mass"].parameter.name
        if mass in self.done:  # the body is divided
            return
        self.done.add(mass)
        tag, why = self._tag_of("body", shape.number, old.name)
        if tag is not None:
            why = (self._urdf_inertial if self.is_urdf else self._inertial)(tag, new)
        if why:
            self.left.append(f"inertia of {old.name}: {why}")
            return
        before, now = inertia_values(shape, old), inertia_values(shape, new)
        self.changed |= {name: (before[name], now[name]) for name in now}
        self.changed[mass] = (old.mass_kg, new.mass_kg)

    def _inertial(self, tag: Tag, body: Body) -> str:
        # all digits, because a rounded inertia of a thin plate may be invalid
        full = full_inertia(body)
        words = {
            "pos": numbers(body.centre),
            "mass": number(body.mass_kg),
            "fullinertia": " ".join(repr(float(full[i, k])) for i, k in PAIRS),
        }
        inertial = self._inside(tag, "inertial")
        if inertial is None:
            self.edits.add_inside(tag, element_text("inertial", words))
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
                self.edits.add_inside(inertial, element_text(name, words))
                continue
            for word, value in words.items():
                self.edits.set(part, word, value)
        return ""

    def _urdf_joint(self, tag: Tag, p: ModelParameter) -> str:
        if p.attribute not in _URDF_WORDS:
            return f"URDF has no {p.attribute}"
        dof, dynamics = self.mechanism.joints[p.number].dof, self._inside(tag, "dynamics")
        values = {
            word: number(float(getattr(self.new, f"dof_{attribute}")[dof]))
            for attribute, word in _URDF_WORDS.items()
        }
        if dynamics is not None:
            word = _URDF_WORDS[p.attribute]
            self.edits.set(dynamics, word, values[word])
        elif tag.begin not in self.with_dynamics:
            self.with_dynamics.add(tag.begin)
            self.edits.add_inside(tag, element_text("dynamics", values))
        return ""

    def _in_urdf(self, joint: MechanismJoint, terms: JointTerms) -> JointTerms:
        """Friction and linear damping of the terms at a joint; URDF has no more."""
        others = {
            "its drag": terms.damping[1:].any(),
            "its spring or constant force": terms.spring.any(),
            "its periodic torque": any(word == "cogging" for word, _ in terms.motors),
            "its end stop": terms.stop is not None,
            "the load behind its motor": terms.behind is not None,
        }
        self.left += [
            f"{joint.name}: URDF has no attribute for {k}" for k, v in others.items() if v
        ]
        if sliding := sum(values[2] for word, values in terms.motors if word == "lugre"):
            self.notes.append(f"{joint.name}: its friction is written at its sliding level")
        return JointTerms(terms.friction + sliding, damping=terms.damping * [1.0, 0.0, 0.0])


def inertia_values(shape: BodyShape, body: Body) -> dict[str, float]:
    """Centre (m) and inertia about it along the body's axes (kg m2) by name."""
    full = full_inertia(body)
    return {
        **dict(zip(shape.centre_names, body.centre, strict=True)),
        **{n: float(full[i, k]) for n, (i, k) in zip(shape.inertia_names, PAIRS, strict=True)},
    }


def _as_limit(stiffness: float, damping: float, weight: float) -> dict[str, str]:
    """Limit that acts as a spring and a damper (documentation, Computation, Constraint model).

    At impedance d it exerts d (-b v - k r - a) / weight, with k = -solref[0] / d and b = -solref[1]
    / d, r the distance beyond the limit and a the acceleration without it.
    """
    return {
        "solreflimit": numbers([-stiffness * weight, -damping * weight]),
        "solimplimit": numbers([SOFT, SOFT, 0.001]),
    }
