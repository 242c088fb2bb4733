"""A network whose value is added where a value passes through a port of the rig: inside the
equations, not behind them.

The first paper's equation has its network's output among the torques; what it trains on is a
difference of angles. Here the target is what is missing at the port over the fitted part: the
latent value that the smoother finds there, and with it the parameters of the model, which had bent
to what is missing. The network sees what the uncorrected model has (a correction that is fed
forward) and its value enters as a further input of the rig, held over a sample.

Why the parameters move with it: Elman 6-10-1, 4 starts, 60 steps, seeds 0 and 10; held-out MAE with
the parameters held and moved, on 60 s of a twin with a dead band of its valves, at its command:
angle 0.74, 0.85 and 0.41, 0.43 deg (1.8 uncorrected), forces 10, 12 and 5.6, 6.4 N; with dry
friction, at its joint: 0.10, 0.15 and 0.11, 0.11 deg (0.13), forces 3.5, 3.7 and 3.1, 2.9 N.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from pamid.base.arrays import Array
from pamid.base.errors import ConvergenceError, DataError, FileError, UsageError, nearest
from pamid.base.files import sha256_of
from pamid.base.progress import Progress, silent
from pamid.base.result_file import need_result
from pamid.base.run_folder import FIT_FILE, RESIDUAL_FILE, Run
from pamid.base.schemas.fit_file import FitFile
from pamid.base.units import display_unit, from_si, split_column, to_si, unit_label, with_unit
from pamid.diagnosis.candidate_model import candidate_from, transferred
from pamid.engine.program import Stepping
from pamid.engine.symbolic.expression import symbol
from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.estimation.fit_files import span_rows
from pamid.estimation.grey_box import GreyBox, model_with
from pamid.estimation.observed_sizes import observed_sizes
from pamid.estimation.posterior import read_posterior
from pamid.estimation.problem import Problem, free_parameters
from pamid.estimation.robust_fit import fit_robustly
from pamid.estimation.smoother import SMOOTHER_STEPS, Latent, Smoother, size_at
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment
from pamid.model.effect import Effect
from pamid.model.registry import all_effects, noted_rig
from pamid.model.rig import Rig, with_declared
from pamid.networks.correction.output_network import (
    Correction,
    NetworkChoice,
    held_out_mae,
    train_correction,
    train_network,
)
from pamid.networks.correction.residual_data import CAUSES, REFIT, ResidualData
from pamid.networks.correction.stored_model import in_form, stored_model
from pamid.networks.training_problem import TrainingOptions
from pamid.recording.recording import read_recording
from pamid.simulation.data_split import DataSplit, split_recordings
from pamid.simulation.replay import Replay, replay_track

ADDED = "value_of_the_network"  # the rig's further input
AGAIN = 1e-3  # of a model's error: what its replays may differ by from those of residual.csv


@dataclass(frozen=True)
class Entry:
    """Where a network's value enters: a port, and its place where it has several."""

    port: str
    place: str

    @property
    def name(self) -> str:
        return f"{self.port}_{self.place}" if self.place else self.port

    def attachment(self, effect: Effect) -> Attachment:
        # same label: both act in the same order
        return Attachment(effect, (self.port,), "latent", self.place)


def entry_of(rig: Rig, name: str) -> Entry:
    """The entry named `port`, or `port_place` where a port has several; else UsageError."""
    entries = {
        e.name: e
        for n, port in rig.ports.items()
        for e in (Entry(n, place) for place in port.places or ("",))
    }
    if name in entries:
        return entries[name]
    several = [e.name for e in entries.values() if e.port == name]
    hint = f"Choose {' or '.join(several)}." if several else nearest(name, [*entries, "output"])
    raise UsageError(
        f"--port {name!r}: the rig {rig.name!r} has "
        f"{'several such ports' if several else 'no such port'}.",
        hint or f"Give output or any of {', '.join(entries)}.",
    )


# ---- the model of a run ------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Origin:
    """A run's recordings, divided, the model that its fit.json stores, with its values (SI) and
    steps, and fit.json."""

    evidence: DataSplit
    assembly: Assembly
    p: Array
    stepping: Stepping
    fit: FitFile

    def model(self) -> GreyBox:
        """The stored model with its held-out replays and the posterior of its parameters there."""
        e, a = self.evidence, self.assembly
        tracks = e.tracks(a)
        problem = Problem(a, tracks, free_parameters(a, tracks))
        if self.fit.from_ is not None:
            earlier = read_posterior(Path(self.fit.from_.path))
            problem = replace(problem, prior=earlier.prior(problem))
        with threadpool_limits(limits=1, user_api="blas"):
            refitted = fit_robustly(problem, p=self.p, stepping=self.stepping)
        fitted = replace(refitted, p=self.p)
        held_out = tuple(
            replay_track(a, self.p, t, self.stepping, e.noise) for t in e.tracks(a, held_out=True)
        )
        return GreyBox(e, a, fitted, 0.0, held_out, (), ())


def origin_of(folder: Path, rig: str | Rig | None = None, on: str = REFIT) -> Origin:
    """Read a run's recordings again, and its refitted model or the model with the causes (on: REFIT
    or CAUSES). FileError where a recording has moved or changed, where the model is not stored, or
    where the rig is a file that nobody names here: it is code, and is run."""
    record = Run.open(folder).record
    stored = "cause" if on == CAUSES else "model"
    fit = need_result(folder / FIT_FILE, FitFile, also=("from", stored))
    saved = fit.cause if on == CAUSES else fit.model
    try:
        known = {
            str(input_["path"]): str(input_["sha256"])
            for part in (record, *record["steps"])
            for input_ in part["inputs"]
        }
        name = str(record["options"].get("rig") or fit.rig)
        roles = {recording.path: recording.role for recording in fit.recordings}
        known |= {recording.path: recording.sha256 for recording in fit.recordings}
        if not roles or saved is None:
            raise KeyError("recordings, model")
    except (KeyError, TypeError, AttributeError):
        raise FileError(
            f"{folder} does not list its recordings, rig and model.",
            "Run `pamid fit` or `pamid diagnose` again.",
            code="damaged",
        ) from None
    for path in roles:
        for file in (path, str(Path(path).with_suffix(".toml"))):
            if file not in known:
                continue
            place = _place(folder, file)
            if not place.is_file():
                raise FileError(
                    f"{place}, to which {folder} was fitted, is not there.",
                    "Restore it. A relative path starts at the folder in which the run was "
                    "created.",
                    code="missing",
                )
            if sha256_of(place) != known[file]:
                raise FileError(
                    f"{place} was changed since {folder} was fitted to it (its SHA-256 differs).",
                    "Restore the old file, or fit again.",
                    code="changed",
                )
    rig_object = in_form(noted_rig(name, rig, known), saved, folder / FIT_FILE)
    recordings = {path: read_recording(_place(folder, path)) for path in roles}
    evidence = split_recordings(
        rig_object,
        [r for path, r in recordings.items() if roles[path] != "held-out"],
        [r for path, r in recordings.items() if roles[path] == "held-out"],
    )
    model, p, stepping = stored_model(
        rig_object, saved, fit.recordings, all_effects(), folder / FIT_FILE
    )
    evidence = replace(evidence, rig=model.rig)
    assembly = model_with(evidence, model.attachments, observed_sizes(evidence))
    # a diagnosis widens ranges where a fit ends at them
    ranges = {
        b.key: (min(b.low, value), max(b.high, value))
        for b, value in zip(assembly.parameters, p.tolist(), strict=True)
        if not b.low <= value <= b.high
    }
    return Origin(evidence, replace(assembly, ranges=ranges), p, stepping, fit)


def _place(folder: Path, path: str) -> Path:
    """Where a recording lies: a run keeps those that came to it in no file in its folder."""
    copy = folder / path
    return copy if not Path(path).is_file() and copy.is_file() else Path(path)


# ---- what is missing there ---------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _AtEntry(Smoother):
    """A smoother with its latent value at a place of a port."""

    place: str = ""

    @cached_property
    def assembly(self) -> Assembly:
        b, (port,) = self.base.assembly, self.ports
        added = Entry(port, self.place).attachment(Latent(size_at(b, port)))
        return replace(b, attachments=(*b.attachments, added)).for_fitting()


def missing_at(model: GreyBox, replays: tuple[Replay, ...], entry: Entry) -> tuple[Array, Array]:
    """Missing input at an entry over these replays, in sequence (samples, SI), and all of
    the model's parameters (SI); ConvergenceError where no path follows the data."""
    smoother = _AtEntry(
        model.evidence,
        candidate_from(model.assembly, model.fit, replays),
        (entry.port,),
        place=entry.place,
    )
    smoothed = smoother.best
    if np.isfinite(smoothed.log_evidence):
        smoothed = smoother.smoothed(smoothed, smoothed.size, smoothed.time_s, SMOOTHER_STEPS)
    if not np.isfinite(smoothed.log_evidence):
        raise ConvergenceError(
            f"The missing input at {entry.name} cannot be estimated: the model does not follow "
            "its data.",
            "Try another port.",
        )
    missing = []
    for sliced, states in zip(smoother.tracks, smoothed.x, strict=True):
        middle = np.array([0.5 * (w.start + w.stop - 1) for w in sliced.slices])
        values = size_at(model.assembly, entry.port) * states[:, smoother.missing[0]]
        missing.append(np.interp(np.arange(len(sliced.runner.track)), middle, values))
    p = transferred(model.assembly, (smoother.assembly, smoother.parameters(smoothed.s)))
    return np.concatenate(missing), p


# ---- the corrected model -----------------------------------------------------------------------


class _Added(Effect):
    """The network's value, read from an input of the rig."""

    name = "network"
    family = "network"

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value + symbol("input", ADDED)


def entered(a: Assembly, entry: Entry) -> Assembly:
    """The assembly with a further input ADDED (SI), that is added at an entry."""
    rig = with_declared(
        a.rig, inputs={**a.rig.inputs, ADDED: ""}, optional={**a.rig.optional, ADDED: 0.0}
    )
    return replace(a, rig=rig, attachments=(*a.attachments, entry.attachment(_Added())))


def replayed_with(model: GreyBox, entry: Entry, p: Array, values: Array) -> list[Replay]:
    """Replays of all tracks by the model with these values (SI; tracks in sequence) added at an
    entry. p: the model's parameters (SI)."""
    a, e, first, replays = entered(model.assembly, entry), model.evidence, 0, []
    p, column = transferred(a, (model.assembly, p)), a.traced.inputs.index(ADDED)
    for t in (*e.tracks(a), *e.tracks(a, held_out=True)):
        u, last = t.u.copy(), first + len(t) - t.lead
        u[t.lead :, column] = values[first:last]
        replays.append(replay_track(a, p, replace(t, u=u), model.fit.stepping, e.noise))
        first = last
    return replays


def train_at_port(
    residual: ResidualData,
    model: GreyBox,
    entry: Entry,
    wanted: NetworkChoice = NetworkChoice(),  # noqa: B008 (frozen)
    options: TrainingOptions = TrainingOptions(),  # noqa: B008 (frozen)
    stage: Progress = silent,
) -> Correction:
    """Train on what is missing at the entry over the fitted part, judge on the held-out windows;
    for comparison the same network, trained alike, on the residual of the channel. Errors as in
    `train_network`; FileError where residual.csv is not of this model."""
    e = model.evidence
    unit = unit_label(display_unit(e.rig.ports[entry.port].unit))
    stage(f"looking for what is missing at {entry.name}")
    with threadpool_limits(limits=1, user_api="blas"):
        fitted = tuple(
            replay_track(model.assembly, model.fit.p, t, model.fit.stepping, e.noise)
            for t in e.tracks(model.assembly)
        )
        missing, p = missing_at(model, fitted, entry)
    rows = np.concatenate([np.r_[places] for places in span_rows(e)])  # of all tracks
    target = np.zeros(len(residual.target))
    if len(rows) != len(target):
        raise FileError(
            f"{RESIDUAL_FILE} has {len(target)} rows, but the recordings have {len(rows)}.",
            "Repeat the fit.",
        )
    _require_stored(residual, model, rows[len(missing) :])
    target[rows[: len(missing)]] = from_si(missing, unit)
    trained, training, values = train_network(
        residual, with_unit("missing", unit), target, wanted, options
    )
    at_output = None
    if training.why != "interrupted":
        # The same network for what is left of the channel, from its beginning.
        with suppress(KeyboardInterrupt):
            alone = train_correction(
                residual, wanted, replace(options, checkpoint=None, resume=False)
            )
            at_output = None if alone.interrupted else alone
    stage("simulating with the network")
    runs = replayed_with(model, entry, p, to_si(values[rows], unit))
    corrected = np.empty((len(rows), len(e.channels)))
    corrected[rows] = np.concatenate([r.model for r in runs])
    outputs = {
        c: from_si(y, split_column(c)[1]) for c, y in zip(e.channels, corrected.T, strict=True)
    }
    notes = (
        ()
        if all(r.finite for r in runs)
        else (
            f"With the network's value at {entry.name} the model became unstable in some windows; "
            "they count as zero.",
        )
    )
    errors = {}
    for channel, replayed in outputs.items():
        models = residual.models(channel) | {"with_network": replayed}
        if at_output is not None and channel == residual.channel:
            models["with_output_network"] = at_output.outputs[channel]
        errors[channel] = held_out_mae(residual, channel, **models)
    return Correction(
        residual,
        trained,
        training,
        {"port": entry.name},
        f"what is missing at {entry.name} of {residual.model_words}",
        outputs,
        errors,
        (*residual.notes, *notes),
        interrupted=at_output is None,
        parameters=named_values(model, p),
    )


def _require_stored(residual: ResidualData, model: GreyBox, held_out: NDArray[np.intp]) -> None:
    """DataError where the replays of a model are not those of residual.csv over these rows."""
    replayed = np.concatenate([r.model for r in model.held_out])
    for channel, now in zip(model.evidence.channels, replayed.T, strict=True):
        written = list(residual.models(channel).values())[-1][held_out]
        now = from_si(now, split_column(channel)[1])
        gap = residual.columns[channel][held_out] - written
        if not np.mean(np.abs(now - written)) <= AGAIN * np.nanmean(np.abs(gap)):
            raise DataError(
                f"The models of {FIT_FILE} and {RESIDUAL_FILE} differ in {channel}.",
                "Repeat the fit: another version of pamid wrote the run.",
            )


def named_values(model: GreyBox, p: Array) -> dict[str, float]:
    """Parameters that were fitted, by the name that `Assembly.values` takes, in the name's unit."""
    bounds = [(i, model.assembly.parameters[i]) for i in model.fit.problem.free]
    return {b.full_name: float(p[i] / b.factor) for i, b in bounds}
