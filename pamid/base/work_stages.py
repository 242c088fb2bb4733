"""The stages of long work and their usual shares of its time, by the label of its progress line.

A stage is known by how its texts begin. Shares are those of a virtual joint on one core; work that
goes otherwise makes the time left wrong, never what is done.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Stage:
    """begins: of its texts; share: of the whole, 0 to 1; called: what people read, where that is
    something else."""

    begins: str
    share: float
    called: str = ""

    @property
    def title(self) -> str:
        return self.called or self.begins


def _within(stages: Iterable[Stage], share: float) -> tuple[Stage, ...]:
    """The same stages as a part of other work."""
    return tuple(Stage(one.begins, share * one.share, one.called) for one in stages)


_DIAGNOSE = (
    Stage("fitting", 0.10),
    Stage("noise floor", 0.01),
    Stage("black box", 0.07),
    Stage("looking where", 0.08, "where something is missing"),
    Stage("screening", 0.33),
    Stage("refitting", 0.28),
    Stage("looking for the family", 0.03, "unknown effects"),
    Stage("looking for the next experiment", 0.10, "next experiment"),
)
_RECORDING = "recording"
#: label of the progress line -> its stages, in order
STAGES: dict[str, tuple[Stage, ...]] = {
    "diagnose": _DIAGNOSE,
    "fit": (Stage("fitting", 0.8), Stage("noise floor", 0.2)),
    "fit --bootstrap": (
        Stage("fitting", 0.14),
        Stage("noise floor", 0.02),
        Stage("bootstrap", 0.84),
    ),
    "power": (
        Stage("fitting", 0.15, "fitting without effects"),
        Stage("response to", 0.8, "response to every effect"),
        Stage("comparing", 0.05),
    ),
    "demo": (
        Stage(_RECORDING, 0.06),
        *_within(_DIAGNOSE, 0.7),
        Stage("training a network", 0.14),
        Stage("writing", 0.1, "writing the page"),
    ),
    "reproduce-paper": (
        Stage(_RECORDING, 0.01),
        Stage("training", 0.89, "training the network"),
        *_within(_DIAGNOSE, 0.1),
    ),
    "reproduce-paper --paper arm": (
        Stage(_RECORDING, 0.05),
        Stage("gravity-without-payload:", 0.1, "gravity tests without payload"),
        Stage("gravity:", 0.1, "gravity tests"),
        Stage("force map", 0.05, "force map of a muscle"),
        Stage("pulses-analytic-alone:", 0.15, "valve pulses, analytic law"),
        Stage("pulses-anfis-alone:", 0.15, "valve pulses, ANFIS"),
        Stage("pulses-analytic:", 0.15, "both with corrections"),
        Stage("pulses-anfis:", 0.15, "ANFIS with corrections"),
        Stage("free runs", 0.1),
    ),
}
