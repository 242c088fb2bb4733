"""`pamid export --to mjcf`: the model file (MJCF or URDF) of the rig, with what was found."""

from __future__ import annotations

from pathlib import Path

from pamid.base.errors import FileError
from pamid.correction.identified_model import Identified
from pamid.export.form import Form, Written
from pamid.export.step import SampleStep
from pamid.model.attachment import Attachment
from pamid.simulators.mechanism import Mechanism, ModelParameter
from pamid.simulators.write_back import write_back

#: effect at a joint's motion port -> its parameter, and what the joint has for it in the file
_AT_A_JOINT = {
    "coulomb-friction": ("level", "frictionloss"),
    "viscous-friction": ("damping", "damping"),
}

_SOFT = "solreffriction and solimpfriction of the joint say how"


def write(model: Identified, step: SampleStep, files: tuple[Path, ...]) -> Written:
    """FileError for a rig that is not made of a model file."""
    mechanism = getattr(model.assembly.rig, "mechanism", None)
    if not isinstance(mechanism, Mechanism):
        raise FileError(
            f"The rig {model.name!r} was not made of a model file, so there is none to write into.",
            "fmu, c, onnx and matlab write any model.",
        )
    assembly, values = model.assembly, model.values
    found = {p.parameter.name: float(values[assembly.keys[p.parameter.name]])
             for p in mechanism.parameters}  # fmt: skip
    notes = []
    for attachment in model.effects:
        said = _effect(mechanism, found, model, attachment)
        notes += [said] if said else []
    if model.network is not None:
        notes.append("the network is not in the file: no model file can hold one")
    made = write_back(mechanism, found)
    return Written({files[0]: made.text}, notes=(*notes, *made.left))


def _effect(
    mechanism: Mechanism, found: dict[str, float], model: Identified, attachment: Attachment
) -> str:
    """Add an effect to the values where the file has a number for it; else what to say of it."""
    label, effect = attachment.label, attachment.effect.name
    keys, values = model.assembly.keys, model.values
    own = {p.name: float(values[keys[f"{label}:{p.name}"]]) for p in attachment.effect.parameters}
    ports = [p for p in mechanism.ports if p.kind == "motion" and p.name in attachment.ports]
    if effect in _AT_A_JOINT:
        parameter, attribute = _AT_A_JOINT[effect]
        for port in ports:
            name = _parameter(mechanism, port.number, attribute).parameter.name
            found[name] += own[parameter]
        soft = effect == "coulomb-friction"
        return f"{label} is a frictionloss there, which sets in softly: {_SOFT}" if soft else ""
    told = ", ".join(f"{k} = {v:.5g}" for k, v in own.items())
    return (
        f"{label} ({told}, SI) is not in the file: no attribute says it; "
        "`pamid export --to c` writes the whole model for a callback"
    )


def _parameter(mechanism: Mechanism, joint: int, attribute: str) -> ModelParameter:
    return next(
        p
        for p in mechanism.parameters
        if (p.element, p.number, p.attribute) == ("joint", joint, attribute)
    )


FORM = Form(".xml", write)
