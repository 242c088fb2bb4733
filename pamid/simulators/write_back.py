"""Identified values put into a model file's own text, MJCF or URDF.

Elements are found by their name or by the line at which MuJoCo has read them; only attributes are
changed, and of a body without <inertial> one is added. What was written is read by MuJoCo again,
and every value that it does not find as it should be is told instead.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import FileError
from pamid.simulators.mechanism import Mechanism, ModelParameter
from pamid.simulators.mujoco_file import MujocoFile, open_mujoco
from pamid.simulators.mujoco_mechanism import mechanism_of
from pamid.simulators.xml_text import Edits, Tag, tags_of

Array = NDArray[np.float64]

UNCHANGED = 1e-9  # share by which a value may differ and stay as it is written
SAME = 1e-6  # share to which the written file has to give a value back

_JOINT_PARENTS = ("body", "frame", "replicate")
_PLURAL = {"actuator": "actuators", "body": "bodies", "joint": "joints", "tendon": "tendons"}


@dataclass(frozen=True)
class WrittenModel:
    """text: of the file; changed: parameter -> (value in the file, value now), SI; left: what could
    not be written, in sentences."""

    text: bytes
    changed: dict[str, tuple[float, float]]
    left: tuple[str, ...]


def write_back(mechanism: Mechanism, values: Mapping[str, float]) -> WrittenModel:
    """The mechanism's file with these values (SI) by parameter in the place of its own.

    FileError where the file cannot be read any more.
    """
    path = Path(mechanism.path)
    text = path.read_bytes()
    file = open_mujoco(path)
    writer = _Writer(file, mechanism, text)
    changed: dict[str, tuple[float, float]] = {}
    left: list[str] = []
    for one in mechanism.parameters:
        name = one.parameter.name
        was, now = one.parameter.value * one.parameter.factor, values[name]
        if abs(now - was) <= UNCHANGED * max(abs(was), abs(now)):
            continue
        if why := writer.put(one, now):
            left.append(f"{name} = {now:.6g}: {why}")
        else:
            changed[name] = (was, now)
    made = writer.edits.made(writer.tags)
    for name, why in _not_found_again(path, made, {n: now for n, (_, now) in changed.items()}):
        del changed[name]
        left.append(f"{name}: {why}")
    return WrittenModel(made, changed, tuple(left))


def _not_found_again(path: Path, text: bytes, wanted: Mapping[str, float]) -> list[tuple[str, str]]:
    """The values that MuJoCo reads otherwise from the text than they were to be. The text stands
    beside the file for a moment, where it finds the meshes that it names; elsewhere where that
    folder cannot be written."""
    folder = path.parent if os.access(path.parent, os.W_OK) else None
    with tempfile.NamedTemporaryFile(dir=folder, suffix=path.suffix) as beside:
        beside.write(text)
        beside.flush()
        try:
            again = mechanism_of(open_mujoco(beside.name))
        except FileError as error:
            raise FileError(f"{path}: the changed model cannot be read: {error}") from error
    read = {p.parameter.name: p.parameter for p in again.parameters}
    found = []
    for name, value in wanted.items():
        got = read[name].value * read[name].factor if name in read else 0.0
        if abs(got - value) > SAME * max(abs(value), 1e-12):
            found.append(
                (name, f"MuJoCo makes {got:.6g} of {value:.6g} (a setting of <compiler>?)")
            )
    return found


def number(value: float) -> str:
    """As short as it can be written without losing a digit that matters."""
    return f"{value:.10g}"


def numbers(values: Sequence[float]) -> str:
    return " ".join(map(number, values))


class _Writer:
    def __init__(self, file: MujocoFile, mechanism: Mechanism, text: bytes) -> None:
        self.file, self.mechanism, self.text = file, mechanism, text
        self.tags = tags_of(text)
        self.edits = Edits(text)
        self.is_urdf = self.tags[0].name == "robot"
        self.vectors: dict[tuple[int, str], Array] = {}

    def put(self, one: ModelParameter, value: float) -> str:
        """Note a change; why it cannot be made, or ""."""
        tag, why = self._tag_of(one)
        if tag is None:
            return why
        if one.element == "body":
            return self._mass(tag, one, value)
        if self.is_urdf:
            return self._urdf_joint(tag, one, value)
        if one.element == "actuator":
            return self._actuator(tag, one, value)
        self.edits.set(tag, one.attribute, number(value))
        return ""

    # ---- finding ---------------------------------------------------------------------------------

    def _tag_of(self, one: ModelParameter) -> tuple[Tag | None, str]:
        """The start tag of an element; else why there is none."""
        kind, i = one.element, one.number
        name = self.file.mujoco.mj_id2name(
            self.file.model, getattr(self.file.mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), i
        )
        own = [tag for tag in self.tags if self._is(tag, kind)]
        if name:
            found = [tag for tag in own if tag.attributes.get("name") == name]
        else:
            line = self.file.line(kind, i)
            same = [
                k
                for k in range(len(getattr(self.mechanism, _PLURAL[kind])))
                if self.file.line(kind, k) == line
            ]
            found = [tag for tag in own if tag.line == line and "name" not in tag.attributes]
            found = found[same.index(i) : same.index(i) + 1] if len(found) == len(same) else []
        if len(found) == 1:
            return found[0], ""
        return None, f"the {kind} {one.of!r} does not stand by itself in the text of the file"

    def _is(self, tag: Tag, kind: str) -> bool:
        parent = self.tags[tag.parent].name if tag.parent >= 0 else ""
        if self.is_urdf:
            return tag.name == {"body": "link"}.get(kind, kind)
        if kind == "body":
            return tag.name == "body"
        if kind == "joint":
            return tag.name == "joint" and parent in _JOINT_PARENTS
        return parent == kind

    def _inside(self, tag: Tag, name: str) -> Tag | None:
        number = self.tags.index(tag)
        return next((t for t in self.tags if t.parent == number and t.name == name), None)

    # ---- writing ---------------------------------------------------------------------------------

    def _mass(self, tag: Tag, one: ModelParameter, value: float) -> str:
        body = self.mechanism.bodies[one.number]
        ratio, inertial = value / body.mass_kg, self._inside(tag, "inertial")
        if self.is_urdf:
            return self._urdf_mass(inertial, value, ratio)
        if inertial is None:
            # the shape stays: principal axes and centre as MuJoCo makes them of the geoms
            words = {
                "pos": numbers(body.centre),
                "quat": numbers(body.inertia_quaternion),
                "mass": number(value),
                "diaginertia": numbers([ratio * v for v in body.inertia]),
            }
            told = " ".join(f'{k}="{v}"' for k, v in words.items())
            self.edits.add_behind(tag, f"<inertial {told}/>")
            return ""
        self.edits.set(inertial, "mass", number(value))
        for attribute in ("diaginertia", "fullinertia"):
            if said := inertial.attributes.get(attribute):
                self.edits.set(
                    inertial, attribute, numbers([ratio * float(v) for v in said.split()])
                )
        return ""

    def _actuator(self, tag: Tag, one: ModelParameter, value: float) -> str:
        shortcut = {
            ("position", "kp"): "kp",
            ("position", "kv"): "kv",
            ("velocity", "kv"): "kv",
            ("position", "time_constant"): "timeconst",
        }.get((tag.name, one.attribute))
        if one.attribute in ("gear", "delay"):
            rest = list(self.file.model.actuator_gear[one.number])[1:]
            whole = one.attribute == "gear" and len(tag.attributes.get("gear", "").split()) > 1
            self.edits.set(tag, one.attribute, numbers([value, *rest]) if whole else number(value))
            return ""
        if shortcut:
            self.edits.set(tag, shortcut, number(value))
            if shortcut == "kv" and "dampratio" in tag.attributes:
                self.edits.set(tag, "dampratio", None)
            return ""
        if tag.name != "general":
            return f"<{tag.name}> has no attribute for it; write the actuator as <general>"
        for write in one.writes:
            word = write.array.removeprefix("actuator_")
            said = np.array(getattr(self.file.model, write.array)[write.row])
            said = self.vectors.setdefault((one.number, word), said)
            said[write.column] = write.factor * value
            self.edits.set(tag, word, numbers(list(np.trim_zeros(said, "b"))))
        return ""

    def _urdf_mass(self, inertial: Tag | None, value: float, ratio: float) -> str:
        mass = None if inertial is None else self._inside(inertial, "mass")
        if inertial is None or mass is None:
            return "its <link> has no <inertial>"
        self.edits.set(mass, "value", number(value))
        if about := self._inside(inertial, "inertia"):
            for name, said in about.attributes.items():
                self.edits.set(about, name, number(ratio * float(said)))
        return ""

    def _urdf_joint(self, tag: Tag, one: ModelParameter, value: float) -> str:
        word = {"damping": "damping", "frictionloss": "friction"}.get(one.attribute)
        if word is None:
            return f"URDF has no {one.attribute}"
        dynamics = self._inside(tag, "dynamics")
        if dynamics is None:
            return 'its <joint> has no <dynamics>; add <dynamics damping="0" friction="0"/>'
        self.edits.set(dynamics, word, number(value))
        return ""
