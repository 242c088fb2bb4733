"""`pamid.simulate`: a virtual rig, or what a run has found, on an excitation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from pamid.api.given import EffectLike, RecordingLike, effects_given, recording_given
from pamid.api.modelled import MODEL_DIGITS, modelled, recorded
from pamid.api.results import FitResult
from pamid.base.errors import UsageError
from pamid.base.files import PathLike, require_new
from pamid.model.registry import RigLike, resolved_rig, rig_of
from pamid.recording.recording import SIGNIFICANT_DIGITS, Recording
from pamid.simulation.virtual_rig import simulate_virtual_rig


def simulate(
    excitation: RecordingLike,
    rig: RigLike | None = None,
    *,
    effects: EffectLike | Iterable[EffectLike] = (),
    model: FitResult | PathLike | None = None,
    which: str = "best",
    known: Mapping[str, float] | None = None,
    parameters: Mapping[str, float] | None = None,
    noise: float = 1.0,
    seed: int = 0,
    output: PathLike | None = None,
    overwrite: bool = False,
) -> Recording:
    """Simulate the recording of a virtual rig.

    Parameters
    ----------
    excitation
        A reference column runs the rig's controller (closed loop), a command column is replayed
        (open loop).
    rig
        As in `pamid.fit`. Default: the one that the excitation names, else one-dof.
    effects
        NAME, NAME@PORT, with :parameter=value,...; paths of effect files (they are run); or
        Effects, at their typical size.
    model
        Result or run folder whose model is simulated, by its own steps, instead of a rig from its
        data sheet. A run with a rig or effect file needs these again.
    which
        Part of `model`: "cause", "network" (with the model that it was trained on), "refitted", or
        "best": causes and network together where possible, else the first of these.
    known
        Parameters that the recording states as known, by name, in their unit.
    parameters
        Hidden parameters of the virtual rig.
    noise
        Factor on the sensors' noise; 0: none. Same seed, same noise.
    output
        CSV file to write, with its TOML file.

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
    target = None if output is None else Path(output)
    require_new([target] if target else [], overwrite)
    if not noise >= 0.0:
        raise UsageError(f"noise={noise!r} is no factor of at least 0.")
    source = recording_given(excitation, "excitation")
    stated, hidden, named = dict(known or {}), dict(parameters or {}), effects_given(effects)
    if model is None:
        if which != "best":
            raise UsageError("--which belongs to --model RUN.")
        virtual = resolved_rig(rig) or rig_of([source])
        simulated = simulate_virtual_rig(virtual, source, named, stated, hidden, noise, seed)
        return recorded(source, simulated, SIGNIFICANT_DIGITS, target)
    for effect in named:
        if isinstance(effect, str) and not effect.endswith(".py"):
            raise UsageError(
                f"--effect {effect!r}: the model has the effects that the run found; with --model "
                "only its effect files are named again."
            )
    own = model.code if isinstance(model, FitResult) else (None, ())
    simulated = modelled(
        model.folder if isinstance(model, FitResult) else Path(model),
        source,
        which=which,
        rig=resolved_rig(rig) or own[0],
        effects=named or own[1],
        known=stated,
        parameters=hidden,
        noise=noise,
        seed=seed,
    )
    return recorded(source, simulated, MODEL_DIGITS, target)
