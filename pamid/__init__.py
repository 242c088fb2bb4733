"""pamid: where a grey-box model departs from its rig, which effect causes it, and how far the gap
shrinks.

    import pamid

    recording = pamid.read_recording("joint.csv")
    found = pamid.diagnose(recording, rig="one-dof")
    found.verdict, found.causes, found.plot_worst_window()

The face: verbs, their results, and the nouns that a rig file or an effect file needs. Each is
loaded when it is first used, so that `import pamid` costs nothing. Nothing inside the package
imports the face.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import os

    from pamid.api.carried_runs import open_run
    from pamid.api.checking import CheckResult, check
    from pamid.api.diagnosing import diagnose
    from pamid.api.exciting import pulse_excitation, release_excitation
    from pamid.api.exporting import ExportResult, export
    from pamid.api.fitting import fit
    from pamid.api.force_laws import ForceLawResult, force_law
    from pamid.api.ingesting import IngestResult, guess_mapping, ingest
    from pamid.api.new_rigs import NewRig, new_rig
    from pamid.api.planning import PowerResult, power
    from pamid.api.results import (
        DiagnosisResult,
        FitResult,
        IdentifiedCause,
        ParameterEstimate,
        ParameterTable,
    )
    from pamid.api.scoring import ScoreResult, score
    from pamid.api.simulating import simulate
    from pamid.api.training import NetworkResult, train_residual
    from pamid.base.errors import PamidError
    from pamid.intake.logs.guessed_mapping import GuessedMapping
    from pamid.model.assembly import Assembly
    from pamid.model.background import Gain, RoughMap, SmoothGain, SplitGain
    from pamid.model.effect import Effect, State
    from pamid.model.parameter import Parameter
    from pamid.model.rig import Loop, Port, Rig
    from pamid.model.step_rig import StepRig
    from pamid.networks.correction.trained_force_law import force_law_of
    from pamid.recording.recording import Recording, read_recording, write_recording
    from pamid.report.writing import Report
    from pamid.rigs.simulators.model_packages import model_packages
    from pamid.simulation.excitation.aprbs import aprbs, coverage

    def report(
        run: FitResult | NetworkResult | str | os.PathLike[str],
        output: str | os.PathLike[str] | None = None,
        *,
        pdf: str | os.PathLike[str] | None = None,
    ) -> Report: ...


__version__ = "0.2.0"

_HOME = {
    "Assembly": "pamid.model.assembly",
    "CheckResult": "pamid.api.checking",
    "DiagnosisResult": "pamid.api.results",
    "Effect": "pamid.model.effect",
    "ExportResult": "pamid.api.exporting",
    "FitResult": "pamid.api.results",
    "ForceLawResult": "pamid.api.force_laws",
    "Gain": "pamid.model.background",
    "GuessedMapping": "pamid.intake.logs.guessed_mapping",
    "IdentifiedCause": "pamid.api.results",
    "IngestResult": "pamid.api.ingesting",
    "Loop": "pamid.model.rig",
    "NetworkResult": "pamid.api.training",
    "PamidError": "pamid.base.errors",
    "NewRig": "pamid.api.new_rigs",
    "Parameter": "pamid.model.parameter",
    "ParameterEstimate": "pamid.api.results",
    "ParameterTable": "pamid.api.results",
    "Port": "pamid.model.rig",
    "PowerResult": "pamid.api.planning",
    "Recording": "pamid.recording.recording",
    "Rig": "pamid.model.rig",
    "RoughMap": "pamid.model.background",
    "ScoreResult": "pamid.api.scoring",
    "SmoothGain": "pamid.model.background",
    "SplitGain": "pamid.model.background",
    "State": "pamid.model.effect",
    "StepRig": "pamid.model.step_rig",
    "aprbs": "pamid.simulation.excitation.aprbs",
    "check": "pamid.api.checking",
    "coverage": "pamid.simulation.excitation.aprbs",
    "diagnose": "pamid.api.diagnosing",
    "export": "pamid.api.exporting",
    "fit": "pamid.api.fitting",
    "force_law": "pamid.api.force_laws",
    "force_law_of": "pamid.networks.correction.trained_force_law",
    "guess_mapping": "pamid.api.ingesting",
    "ingest": "pamid.api.ingesting",
    "model_packages": "pamid.rigs.simulators.model_packages",
    "new_rig": "pamid.api.new_rigs",
    "open_run": "pamid.api.carried_runs",
    "power": "pamid.api.planning",
    "pulse_excitation": "pamid.api.exciting",
    "read_recording": "pamid.recording.recording",
    "release_excitation": "pamid.api.exciting",
    "score": "pamid.api.scoring",
    "simulate": "pamid.api.simulating",
    "train_residual": "pamid.api.training",
    "write_recording": "pamid.recording.recording",
}
__all__ = [
    "Assembly",
    "CheckResult",
    "DiagnosisResult",
    "Effect",
    "ExportResult",
    "FitResult",
    "ForceLawResult",
    "Gain",
    "GuessedMapping",
    "IdentifiedCause",
    "IngestResult",
    "Loop",
    "NetworkResult",
    "PamidError",
    "NewRig",
    "Parameter",
    "ParameterEstimate",
    "ParameterTable",
    "Port",
    "PowerResult",
    "Recording",
    "Rig",
    "RoughMap",
    "ScoreResult",
    "SmoothGain",
    "SplitGain",
    "State",
    "StepRig",
    "__version__",
    "aprbs",
    "check",
    "coverage",
    "diagnose",
    "export",
    "fit",
    "force_law",
    "force_law_of",
    "guess_mapping",
    "ingest",
    "model_packages",
    "new_rig",
    "open_run",
    "power",
    "pulse_excitation",
    "read_recording",
    "release_excitation",
    "report",
    "score",
    "simulate",
    "train_residual",
    "write_recording",
]


def __getattr__(name: str) -> Any:
    if name == "report":  # a package, which can be called
        return importlib.import_module("pamid.report")
    if name not in _HOME:
        raise AttributeError(f"module 'pamid' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
