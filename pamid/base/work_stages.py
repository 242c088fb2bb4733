"""The stages of long work and their usual shares of its time, by the label of its progress line.

A stage is known by how its texts begin. Shares are those of a virtual joint on a single core; work
that goes otherwise makes the time left wrong, never what is done.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class WorkStage:
    """begins: of its texts; share: of the whole, 0 to 1; called: what people read, where that is
    something else."""

    begins: str
    share: float
    called: str = ""

    @property
    def title(self) -> str:
        return self.called or self.begins


def _within(stages: Iterable[WorkStage], share: float) -> tuple[WorkStage, ...]:
    """The same stages as a part of other work."""
    return tuple(WorkStage(stage.begins, share * stage.share, stage.called) for stage in stages)


_DIAGNOSE = (
    WorkStage("fitting", 0.10),
    WorkStage("noise floor", 0.01),
    WorkStage("looking where", 0.08, "where something is missing"),
    WorkStage("screening", 0.33),
    WorkStage("refitting", 0.35),
    WorkStage("looking for the family", 0.03, "unknown effects"),
    WorkStage("looking for the next experiment", 0.10, "next experiment"),
)
_RECORDING = "recording"
#: label of the progress line -> its stages, in order
WORK_STAGES: dict[str, tuple[WorkStage, ...]] = {
    "diagnose": _DIAGNOSE,
    "fit": (WorkStage("fitting", 0.8), WorkStage("noise floor", 0.2)),
    "fit --bootstrap": (
        WorkStage("fitting", 0.14),
        WorkStage("noise floor", 0.02),
        WorkStage("bootstrap", 0.84),
    ),
    "simulate": (
        WorkStage("equations", 0.6, "building the equations"),
        WorkStage("running", 0.3, "running them"),
        WorkStage("writing", 0.1),
    ),
    "export": (
        WorkStage("reading", 0.5, "reading the run"),
        WorkStage("translating", 0.3, "translating the equations"),
        WorkStage("compiling", 0.2, "compiling, where the form is compiled"),
    ),
    "check": (
        WorkStage("reading", 0.05),
        WorkStage("columns", 0.15, "columns against the rig"),
        WorkStage("quality", 0.4, "quality of every channel"),
        WorkStage("held or linear", 0.4, "inputs held or linear"),
    ),
    "check a rig": (
        WorkStage("equations", 0.3, "building the equations"),
        WorkStage("bounds", 0.3, "random points of the bounds"),
        WorkStage("sensitivities", 0.3),
        WorkStage("effects", 0.1, "effects that fit"),
    ),
    "check a model": (
        WorkStage("equations", 0.45, "building the equations"),
        WorkStage("bounds", 0.45, "random points of the bounds"),
        WorkStage("effects", 0.1, "effects that fit"),
    ),
    "power": (
        WorkStage("fitting", 0.15, "fitting without effects"),
        WorkStage("response to", 0.8, "response to every effect"),
        WorkStage("comparing", 0.05),
    ),
    "demo": (
        WorkStage(_RECORDING, 0.06),
        *_within(_DIAGNOSE, 0.7),
        WorkStage("training a network", 0.14),
        WorkStage("writing", 0.1, "writing the page"),
    ),
    "reproduce-paper": (
        WorkStage(_RECORDING, 0.01),
        WorkStage("training", 0.89, "training the network"),
        *_within(_DIAGNOSE, 0.1),
    ),
    "reproduce-paper --quick": (
        WorkStage(_RECORDING, 0.02),
        WorkStage("training", 0.1, "training the network"),
        *_within(_DIAGNOSE, 0.88),
    ),
    "reproduce-paper --paper arm": (
        WorkStage(_RECORDING, 0.05),
        WorkStage("gravity-without-payload:", 0.1, "gravity tests without payload"),
        WorkStage("gravity:", 0.1, "gravity tests"),
        WorkStage("force map", 0.05, "force map of a muscle"),
        WorkStage("pulses-analytic-alone:", 0.15, "valve pulses, analytic law"),
        WorkStage("pulses-anfis-alone:", 0.15, "valve pulses, ANFIS"),
        WorkStage("pulses-analytic:", 0.15, "both with corrections"),
        WorkStage("pulses-anfis:", 0.15, "ANFIS with corrections"),
        WorkStage("free runs", 0.1),
    ),
}
