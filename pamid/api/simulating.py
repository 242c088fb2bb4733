"""`pamid.simulate`: a virtual rig, or the model of a run, on an excitation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pamid.api.given import effects_given, recording_given
from pamid.api.options.record import verb
from pamid.api.options.simulating import SimulationArguments
from pamid.api.workers import OpenedRun
from pamid.base.errors import UsageError
from pamid.base.files import make_folder, require_new
from pamid.base.progress import tell
from pamid.model.registry import resolved_rig, rig_of
from pamid.recording.recording import SIGNIFICANT_DIGITS, Recording, recording_of, write_recording
from pamid.simulation.virtual_rig import VirtualRecording, simulate_virtual_rig

MODEL_DIGITS = 12  # what is exported is held against this to 1e-9 of every channel's span


@verb(SimulationArguments)
def simulate(arguments: SimulationArguments) -> Recording:
    """Simulate the recording of a virtual rig.

    Returns
    -------
    Recording
        As the file holds it; its `effects` state what was simulated.

    Raises
    ------
    FileError
        The output exists (without overwrite).
    PamidError
        Files, data or arguments are wrong.
    """
    a = arguments
    target = None if a.output is None else Path(a.output)
    require_new([target] if target else [], a.overwrite)
    if not a.noise >= 0.0:
        raise UsageError(f"noise={a.noise!r} is not a factor of 0 or more.")
    source = recording_given(a.excitation, "excitation")
    known, hidden = dict(a.known or {}), dict(a.parameters or {})
    rig, effects = resolved_rig(a.rig), effects_given(a.effects)
    if a.model is None:
        if a.which != "best":
            raise UsageError("--which belongs to --model RUN.")
        rig = rig or rig_of([source])
        simulated = simulate_virtual_rig(rig, source, effects, known, hidden, a.noise, a.seed)
        return recorded(source, simulated, SIGNIFICANT_DIGITS, target)
    for effect in effects:
        if isinstance(effect, str) and not effect.endswith(".py"):
            raise UsageError(
                f"--effect {effect!r}: the model already contains the effects of the run.",
                "With --model, name only the effect files of the run.",
            )
    # networks and what they need take a second to load, and few runs have a network
    from pamid.networks.correction.identified_model import load_identified, record_identified

    run = OpenedRun.of(a.model)
    tell("equations")
    model = load_identified(
        run.folder, which=a.which, rig=rig or run.code[0], effects=effects or run.code[1]
    )
    tell("running")
    simulated = record_identified(model.knowing(hidden), source, known, noise=a.noise, seed=a.seed)
    return recorded(source, simulated, MODEL_DIGITS, target)


def recorded(
    excitation: Recording, virtual: VirtualRecording, digits: int, output: Path | None = None
) -> Recording:
    """A simulation as its file holds it, whether a file is written or not.

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
