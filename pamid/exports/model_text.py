"""Model file of a rig, MJCF or URDF, with the result of a run."""

from __future__ import annotations

from pathlib import Path

from pamid.base.errors import FileError, quoted
from pamid.base.progress import tell
from pamid.exports.form import Written
from pamid.exports.plain_check import plain_check
from pamid.networks.correction.identified_model import Identified
from pamid.rigs.simulators.mechanism import Mechanism
from pamid.rigs.simulators.mujoco_file import mjcf_of
from pamid.rigs.simulators.mujoco_forms import IdentifiedEffect
from pamid.rigs.simulators.mujoco_mechanism import read_mechanism
from pamid.rigs.simulators.mujoco_sources import relocated_text
from pamid.rigs.simulators.write_back import WrittenModel, stored_text, write_back

LANGUAGES = {".urdf": "urdf", ".xml": "mjcf", ".mjcf": "mjcf"}


def write_model_text(
    model: Identified, step: None, files: tuple[Path, ...], *, language: str
) -> Written:
    """Text for the file, with its errors in MuJoCo.

    A URDF is also written as MJCF, which holds more.

    Parameters
    ----------
    model
        Identified model.
    step
        None: a model file has no sample step.
    files
        Files to be written.
    language
        "mjcf" or "urdf".

    Raises
    ------
    FileError
        The rig does not come from a model file, or an MJCF should become a URDF.
    """
    mechanism = getattr(model.assembly.rig, "mechanism", None)
    if not isinstance(mechanism, Mechanism):
        raise FileError(
            f"The rig {model.name!r} does not come from a model file: there is none to change.",
            "fmu, c, onnx and matlab write any model.",
        )
    path = Path(mechanism.path)
    language_of_rig = LANGUAGES.get(path.suffix.lower(), "mjcf")
    if language_of_rig == language:
        written = _written(model, mechanism)
    elif language == "mjcf":
        with stored_text(path.with_suffix(".xml"), mjcf_of(path)) as translation:
            written = _written(model, read_mechanism(translation))
    else:
        raise FileError(f"{path} is not {language.upper()}.", f"Take --to {language_of_rig}.")
    tell("running the file in MuJoCo")
    check = plain_check(model, mechanism, written.file, written.mechanism)
    notes = [*written.notes, *written.left]
    if model.network is not None:
        notes.append("the network is not in the file: model files have no networks")
    if check is None:
        notes.append("it was not run, because the run has no held-out data")
    # effects that the recordings cannot separate from the written effect
    label = model.effects[0].label if model.effects else ""
    others = {name: chance for name, chance in model.rivals.items() if name != label}
    if others:
        named = ", ".join(f"{name} (P {chance:.2f})" for name, chance in others.items())
        notes.insert(
            0,
            f"{label} (P {model.rivals.get(label, 0.0):.2f}) is in the file; these recordings "
            f"cannot separate it from {named}; --choose {quoted(next(iter(others)))} writes that "
            "effect",
        )
    text, unmoved = relocated_text(written.text, path, files[0].parent)
    notes += [unmoved] if unmoved else []
    return Written({files[0]: text}, notes=tuple(notes), check=check)


def _written(model: Identified, mechanism: Mechanism) -> WrittenModel:
    """File of a mechanism with the model's parameters and effects."""
    keys, values = model.assembly.keys, model.values
    parameters = {
        p.name: float(values[keys[p.name]]) for p in model.assembly.rig.parameters if p.name in keys
    }
    effects = [
        IdentifiedEffect(
            a.label,
            a.effect.name,
            {p.name: float(values[keys[f"{a.label}:{p.name}"]]) for p in a.effect.parameters},
            tuple(port for port in mechanism.ports if port.name in a.ports),
        )
        for a in model.effects
    ]
    return write_back(mechanism, parameters, effects)
