"""An experiment that a diagnosis proposes, as figures and as the recordings to be sent to the
rig."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.recording.recording import write_recording
from pamid.schemas.diagnosis_file import NextExperiment

Array = NDArray[np.float64]

# of an experiment that is made in several settings
NEXT_FILES = ("next-experiment.csv", "next-experiment-2.csv")
FILE = NEXT_FILES[0]


@dataclass(frozen=True)
class Proposal:
    """The experiment to make.

    separates            effects in question
    expected_separation  smallest rms difference of two of their models on it over all channels, in
                         noise standard deviations
    minutes              at the rig
    columns, meta        the excitation as `write_recording` takes it
    settings             [known] values of each repetition, where they change; () where it is made
                         once, as it is
    cautions             what whoever sends it should know: what is sent beside it, and where it
                         leads as predicted
    """

    name: str
    why: str
    separates: tuple[str, ...]
    expected_separation: float
    minutes: float
    columns: dict[str, Array] = field(repr=False)
    meta: dict[str, Any] = field(repr=False)
    settings: tuple[dict[str, float], ...] = ()
    cautions: tuple[str, ...] = ()

    @property
    def time(self) -> Array:
        """Sampling instants, s."""
        samples = len(next(iter(self.columns.values())))
        return float(self.meta["recording"]["sampling_period_s"]) * np.arange(
            samples, dtype=np.float64
        )

    @property
    def files(self) -> dict[str, dict[str, Any]]:
        """A file per repetition, for a recording states one setting: its name, and the tables of
        the TOML beside it."""
        every = self.settings or ({},)
        return {
            name: self._stating(one)
            for name, one in zip(NEXT_FILES[: len(every)], every, strict=True)
        }

    def _stating(self, setting: dict[str, float]) -> dict[str, Any]:
        known = {**self.meta.get("known", {}), **setting}
        return {**self.meta, "known": known} if known else self.meta

    def write(self, claim: Callable[..., list[Path]]) -> None:
        """Write all its files, each with the TOML beside it; claim: where those of these names go
        (`Run.claim`)."""
        for name, meta in self.files.items():
            write_recording(
                claim(name, str(Path(name).with_suffix(".toml")))[0], self.time, self.columns, meta
            )


@dataclass(frozen=True)
class WithheldExperiment:
    """No experiment, although models are in question. why: a note for the reader."""

    why: str


def proposal_result(p: Proposal | WithheldExperiment | None) -> NextExperiment | None:
    """`next_experiment` of diagnosis.json."""
    if not isinstance(p, Proposal):
        return None
    return NextExperiment(
        name=p.name,
        why=p.why,
        separates=p.separates,
        expected_separation=p.expected_separation,
        minutes=p.minutes,
        excitation=FILE,
        excitations=tuple(p.files),
        settings=p.settings,
        cautions=p.cautions,
    )
