"""Content of a run folder as frozen objects: the run itself, fit, diagnosis, network, residual,
trace, and the points of a missing term."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.base.network_folders import TRACE_FILE, channel_networks
from pamid.base.result_file import REMEDY, read_result
from pamid.base.run_files import RESIDUAL_KEYS, read_columns, read_diagnosis, read_steps
from pamid.base.run_folder import (
    ADDED_VARIABLES_FILE,
    DIAGNOSIS_FILE,
    FIT_FILE,
    FREE_RUN_FILE,
    MISSING_FILE,
    NETWORK_FILE,
    RESIDUAL_FILE,
    RUN_FILE,
    Run,
)
from pamid.base.schemas.added_variables_file import AddedVariablesFile
from pamid.base.schemas.diagnosis_file import DiagnosisFile
from pamid.base.schemas.fit_file import FitFile, RecordingUsed
from pamid.base.schemas.network_file import NetworkFile
from pamid.base.schemas.run_file import Step
from pamid.base.units import split_column


@dataclass(frozen=True)
class Residual:
    """residual.csv with the free runs: every column (n,) in the unit of its name."""

    columns: dict[str, Array]

    def of(self, channel: str, kind: str) -> Array | None:
        """A model's trace of a channel; kind: "data_sheet", "refitted", "cause", "network", "loop",
        "loop_network"."""
        stem = split_column(channel)[0]
        return self.columns.get(f"{stem}_{kind}{channel[len(stem) :]}")


@dataclass(frozen=True)
class RunData:
    """Content of a run; None for missing parts. network: the last trained; other_networks: those of
    other channels."""

    steps: tuple[Step, ...]
    fit: FitFile | None
    diagnosis: DiagnosisFile | None
    network: NetworkFile | None
    residual: Residual | None
    trace: dict[str, Array] | None
    missing: dict[str, Array] | None
    other_networks: tuple[NetworkFile, ...] = ()
    added: AddedVariablesFile | None = None

    def network_errors(self, *, in_loop: bool) -> dict[str, dict[str, float]]:
        """Errors with the networks of the run, by channel: networks that correct the replayed
        model, or networks that correct the model in closed loop."""
        errors: dict[str, dict[str, float]] = {}
        for network in (*self.other_networks, self.network):
            if network is not None and network.in_loop == in_loop:
                errors |= network.errors
        return errors

    def network_on_causes(self, channel: str) -> bool:
        """Does the network that corrects a channel correct the model with the causes?"""
        networks = (*self.other_networks, self.network)
        return any(n is not None and n.on_causes and channel in n.errors for n in networks)

    @property
    def recordings(self) -> tuple[RecordingUsed, ...]:
        """The recordings in the order of their numbers in residual.csv; none without a fit."""
        return self.fit.recordings if self.fit is not None else ()

    @property
    def rig(self) -> str:
        """Name of the rig, "" if no file states it."""
        return self.named_rig if self.fit is None else self.fit.rig

    @property
    def named_rig(self) -> str:
        """The rig as it was named to the command, by name or by file; else as the fit names it."""
        first, of_fit = self.steps[0], self.fit.rig if self.fit is not None else ""
        command = first.command
        words = " ".join(command).split() if len(command) == 1 else command
        named = (following for word, following in pairwise(words) if word == "--rig")
        return first.rig or next(named, "") or of_fit

    def recording_name(self, number: int) -> str:
        """Name of a recording by its number in residual.csv; "" if the fit does not state it."""
        return self.recordings[number].name if 0 <= number < len(self.recordings) else ""

    def recording_words(self, number: int) -> str:
        """ " in recording NAME" where there are several, else ""."""
        name = self.recording_name(number)
        return f" in recording {name}" if name and len(self.recordings) > 1 else ""


def load_run(folder: Path) -> RunData:
    """Read a run folder; FileError if it is no run folder, has no result, or has a damaged file."""
    Run.open(folder)
    fit = read_result(folder / FIT_FILE, FitFile, also=("posterior",))
    diagnosis = read_diagnosis(folder / DIAGNOSIS_FILE)
    if fit is None and diagnosis is None:
        raise FileError(
            f"{folder} has no result yet: neither fit.json nor diagnosis.json.",
            "`pamid fit` or `pamid diagnose` with --output writes a result.",
            code="no-result",
        )
    network = read_result(folder / NETWORK_FILE, NetworkFile, any_schema=True)
    # the networks of other channels than that of network.json
    places = [] if network is None else channel_networks(folder).values()
    read = [read_result(p / NETWORK_FILE, NetworkFile, any_schema=True) for p in places]
    others = tuple(other for other in read if other is not None)
    residual = read_columns(folder / RESIDUAL_FILE)
    if residual is not None:
        _require(folder / RESIDUAL_FILE, residual, RESIDUAL_KEYS)
        # the columns of free-run.csv that residual.csv has not; none where it is of other rows
        free, keys = read_columns(folder / FREE_RUN_FILE) or {}, ("time_s", "recording")
        if all(k in free and np.array_equal(free[k], residual[k]) for k in keys):
            residual |= {name: x for name, x in free.items() if name not in residual}
        for corrected in (network, *others):
            # a network that corrects the model in closed loop belongs to another comparison
            if corrected is not None and corrected.in_loop:
                stem = "" if corrected.output is None else split_column(corrected.output.name)[0]
                residual = {
                    name.replace("_network", "_loop_network")
                    if name.startswith(f"{stem}_network" if stem else "")
                    else name: values
                    for name, values in residual.items()
                }
    trace = read_columns(folder / TRACE_FILE)
    if trace is not None:
        _require(folder / TRACE_FILE, trace, ("iteration", "mse"))
    missing = read_columns(folder / MISSING_FILE)
    if missing is not None:
        _require(folder / MISSING_FILE, [split_column(name)[0] for name in missing], ("missing",))
    return RunData(
        steps=read_steps(folder / RUN_FILE),
        fit=fit,
        diagnosis=diagnosis,
        network=network,
        other_networks=others,
        residual=None if residual is None else Residual(residual),
        trace=trace,
        missing=missing,
        added=read_result(folder / ADDED_VARIABLES_FILE, AddedVariablesFile),
    )


def _require(path: Path, columns: Collection[str], needed: tuple[str, ...]) -> None:
    missing = [name for name in needed if name not in columns]
    if missing:
        raise FileError(f"{path} lacks the column {missing[0]!r}.", REMEDY, code="damaged")
