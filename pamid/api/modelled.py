"""Simulation of a run's model on an excitation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from pamid.base.files import make_folder
from pamid.base.progress import tell
from pamid.model.effect import Effect
from pamid.model.rig import Rig
from pamid.recording.recording import Recording, recording_of, write_recording
from pamid.simulation.virtual_rig import VirtualRecording

MODEL_DIGITS = 12  # what is exported is held against this to 1e-9 of every channel's span


def modelled(
    folder: Path,
    excitation: Recording,
    *,
    which: str,
    rig: str | Rig | None,
    effects: tuple[str | type[Effect], ...],
    known: Mapping[str, float],
    parameters: Mapping[str, float],
    noise: float,
    seed: int,
) -> VirtualRecording:
    """The sensors of the model that a run found; errors as of `load_identified` and
    `record_identified`."""
    # networks and what they need take a second to load, and few runs have one
    from pamid.correction.identified_model import load_identified, record_identified

    tell("equations")
    model = load_identified(folder, which=which, rig=rig, effects=effects).knowing(parameters)
    tell("running")
    return record_identified(model, excitation, known, noise=noise, seed=seed)


def recorded(
    excitation: Recording, virtual: VirtualRecording, digits: int, output: Path | None = None
) -> Recording:
    """A simulation as its file holds it, whether one is written or not.

    Raises
    ------
    FileError
        The file could not be read as a recording: its stamps would coincide, or a value is too
        large. Nothing is written then.
    """
    tell("writing")
    name = f"{excitation.name}-simulated" if output is None else output.stem
    recording = recording_of(
        excitation.time, virtual.columns, virtual.meta, name=name, digits=digits
    )
    if output is not None:
        make_folder(output.parent)
        write_recording(output, excitation.time, virtual.columns, virtual.meta, digits=digits)
        recording = replace(recording, path=output)
    warnings = (*recording.warnings, *virtual.remarks)
    return replace(recording, effects=tuple(virtual.effects), warnings=warnings)
