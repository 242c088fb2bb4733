"""Residual of a fitted model in a single channel, read from a run folder and laid out for a
network.

Where residual.csv holds the refitted model in its control loop, that is the model to be
corrected, as in the first paper: target = measured - angle_loop, inputs = reference, command_loop,
angle_loop, velocity_loop, acceleration_loop, a record per stretch of recording. Otherwise it is
the replay on recorded commands: inputs = inputs of the rig and every output of the model, a
record per window. The model with the causes of a diagnosis is always replayed. Inputs never
are measured outputs: what they would tell, a model cannot know.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import DataError, FileError, UsageError, nearest
from pamid.base.metrics import motion
from pamid.base.result_file import need_result
from pamid.base.run_files import (
    RESIDUAL_KEYS,
    equal_periods,
    read_columns,
    read_diagnosis,
    repeats_refit,
)
from pamid.base.run_folder import DIAGNOSIS_FILE, FIT_FILE, RESIDUAL_FILE
from pamid.base.schemas.fit_file import FitFile
from pamid.base.units import split_column, with_unit
from pamid.recording.file_checks import HUGE

RESIDUAL_RUNS = {"loop": "in its control loop", "replay": "on recorded commands"}
#: models whose residual a network may be trained on -> the kind of their columns in residual.csv
REFIT, CAUSES = "refit", "causes"
MODEL_COLUMNS = {REFIT: "refitted", CAUSES: "cause"}
REFIT_REMEDY = "Run `pamid fit` or `pamid diagnose` again."


@dataclass(frozen=True)
class Segment:
    """Successive rows of residual.csv that a network runs over from a zero state; part 0 is fitted,
    part 1 held out."""

    rows: slice
    part: int


@dataclass(frozen=True, eq=False)
class ResidualData:
    """channel: its column; model: a key of RESIDUAL_RUNS; columns: residual.csv by name; modelled:
    the model's column; inputs: the columns a network is given; washout: rows at the start of every
    segment that are not scored; causes: those of the model, in words, none for the refitted
    model."""

    channel: str
    model: str
    columns: dict[str, Array]
    modelled: str
    inputs: tuple[str, ...]
    stretches: tuple[Segment, ...]
    washout: int
    period_s: float
    notes: tuple[str, ...]
    causes: tuple[str, ...] = ()

    @property
    def on(self) -> str:
        """The model whose residual this is: REFIT or CAUSES."""
        return CAUSES if self.causes else REFIT

    @property
    def target(self) -> Array:
        """measured - model, in the channel's unit."""
        return self.columns[self.channel] - self.columns[self.modelled]

    @property
    def model_words(self) -> str:
        """The model whose residual this is, with its causes, or whether the run holds causes that
        it lacks."""
        run = RESIDUAL_RUNS[self.model]
        if self.causes:
            return f"the model with its causes {run}: {', '.join(self.causes)}"
        caused = derived(self.channel, MODEL_COLUMNS[CAUSES]) in self.columns
        lacks = ", without the causes of the diagnosis" if caused else ""
        return f"the refitted model {run}{lacks}"

    def models(self, channel: str) -> dict[str, Array]:
        """A channel by the models before the network, under the names of their errors."""
        refitted = "loop" if self.model == "loop" else MODEL_COLUMNS[REFIT]
        kinds = {"refitted": refitted}
        kinds |= {"with_cause": MODEL_COLUMNS[CAUSES]} if self.causes else {}
        return {name: self.columns[derived(channel, kind)] for name, kind in kinds.items()}

    def signals(self, stretch: Segment) -> dict[str, Array]:
        """The inputs over a stretch by name, in the order of `inputs`."""
        return {name: self.columns[name][stretch.rows] for name in self.inputs}

    def of_part(self, part: int) -> list[Segment]:
        return [s for s in self.stretches if s.part == part]


def read_residual_data(
    folder: Path,
    channel: str | None = None,
    inputs: Sequence[str] = (),
    *,
    on: str = REFIT,
    replay: bool = False,
) -> ResidualData:
    """`channel` (default angle_deg, else the first) of a run, for a network with these inputs.
    on: REFIT or CAUSES; replay: the refitted model on recorded commands, also where the run holds
    its loop.

    FileError where the run holds no residual or a damaged residual, UsageError for a channel or
    input it does not have and for causes where it names none, DataError where a part is missing or
    nothing varies.
    """
    fit = need_result(folder / FIT_FILE, FitFile, also=("cause",) if on == CAUSES else ())
    causes = causes_of(folder, fit) if on == CAUSES else ()
    if not fit.channels:
        raise FileError(f"{folder / FIT_FILE} has no channels.", REFIT_REMEDY, code="damaged")
    channels = list(fit.channels)
    columns = residual_columns(folder / RESIDUAL_FILE)
    if channel is None:
        channel = "angle_deg" if "angle_deg" in channels else channels[0]
    if channel not in channels:
        raise UsageError(
            f"--channel {channel!r}: this run has no such channel.",
            nearest(channel, channels) or f"Its channels: {', '.join(channels)}.",
        )
    kind = MODEL_COLUMNS[on]
    for name in (channel, derived(channel, "refitted"), derived(channel, kind)):
        if name not in columns:
            raise FileError(
                f"{folder / RESIDUAL_FILE} lacks the column {name!r}.", REFIT_REMEDY, code="damaged"
            )
    modelled, refitted = (columns[derived(channel, k)] for k in (kind, "refitted"))
    if causes and repeats_refit(columns["part"], modelled, refitted):
        raise FileError(
            f"{folder / RESIDUAL_FILE} does not hold the model with its causes over the fitted "
            "part: an earlier version wrote it.",
            REFIT_REMEDY,
            code="earlier-version",
        )
    spans = spans_of(columns)
    replay = replay or on == CAUSES
    model, usual, notes = _model_of(columns, channel, channels, spans, replay, kind, fit.inputs)
    if model == "loop":
        stretches, washout = spans, 0
    else:
        stretches, washout = _windows(columns, spans)
    # recorded there
    stretches = [s for s in stretches if not np.isnan(columns[channel][s.rows]).all()]
    for part, word in ((0, "to train on (part 0)"), (1, "held out to judge by (part 1)")):
        if not any(s.part == part for s in stretches):
            raise DataError(f"{folder / RESIDUAL_FILE}: nothing is {word}.", REFIT_REMEDY)
    if not inputs and not usual:
        raise FileError(
            f"{folder / FIT_FILE} does not list the rig's inputs: an earlier version wrote it.",
            f"Name the network's inputs with --inputs. {REFIT_REMEDY}",
            code="damaged",
        )
    chosen, dropped = _inputs(columns, channels, kind, tuple(inputs) or usual, stretches)
    # an input that a controller computed from a measured output carries the noise of that reading
    noisy = [
        f"A controller computed {command} from the measured output, so {command} contains its "
        "noise. The network can learn this noise and reach an error below the noise floor. This "
        "is not a gain in closed loop: `pamid score` on a new recording reports both errors."
        for *_, last in (_loop_blocks(list(columns)) if model == "replay" else ())
        if (command := last.removesuffix("_loop")) in chosen
    ]
    return ResidualData(
        channel,
        model,
        columns,
        derived(channel, "loop" if model == "loop" else kind),
        chosen,
        tuple(stretches),
        washout,
        _period(fit, columns),
        (*notes, *dropped, *noisy),
        causes,
    )


def causes_of(folder: Path, fit: FitFile) -> tuple[str, ...]:
    """The effects that the model with the causes adds to the refitted model, with their ports, as
    "coulomb-friction at joint"; UsageError where the run names none."""
    added = [label for label in fit.cause.effects if label not in fit.effects] if fit.cause else []
    if not added:
        raise UsageError(
            f"--on {CAUSES}: {folder} names no cause.",
            f"Train on the residual of the refitted model (--on {REFIT}), or give the run of a "
            "`pamid diagnose` that names an effect.",
            code="no-cause",
        )
    diagnosis = read_diagnosis(folder / DIAGNOSIS_FILE)
    ports = {cause.effect: cause.port for cause in diagnosis.causes} if diagnosis else {}
    return tuple(
        f"{label.partition('@')[0]} at {ports[label]}" if ports.get(label) else label
        for label in added
    )


def derived(channel: str, kind: str) -> str:
    """("angle_deg", "refitted") -> "angle_refitted_deg"."""
    stem, unit = split_column(channel)
    return with_unit(f"{stem}_{kind}", unit)


def residual_columns(path: Path) -> dict[str, Array]:
    """residual.csv by column; FileError where it is missing or damaged."""
    columns = read_columns(path)
    if columns is None:
        raise FileError(f"{path} does not exist.", REFIT_REMEDY, code="missing")
    fault = ""
    if tuple(columns)[: len(RESIDUAL_KEYS)] != RESIDUAL_KEYS:
        fault = f"its header does not begin with {', '.join(RESIDUAL_KEYS)}"
    elif any((np.abs(values) > HUGE).any() for values in columns.values()):
        fault = f"it holds a number beyond {HUGE:g}, which no sensor and no model shows"
    else:
        counts = np.array([columns[name] for name in RESIDUAL_KEYS[1:]])
        if not (np.isfinite(counts) & (counts == np.round(counts))).all():
            fault = f"{', '.join(RESIDUAL_KEYS[1:])} hold more than whole numbers"
    if fault:
        raise FileError(f"{path}: {fault}.", REFIT_REMEDY, code="damaged")
    return columns


def _period(fit: FitFile, columns: dict[str, Array]) -> float:
    """The common sampling period (s) of the recordings that the table uses."""
    known = dict(enumerate(recording.period_s for recording in fit.recordings))
    periods = [known.get(row) for row in np.unique(columns["recording"]).tolist()]
    used = sorted({period for period in periods if period is not None})
    if None in periods or not used:
        raise FileError(
            f"{FIT_FILE} does not give the period_s of every recording.",
            REFIT_REMEDY,
            code="damaged",
        )
    if not equal_periods(used):
        raise DataError(
            f"The recordings are sampled every {used[0]:g} to {used[-1]:g} s; a network needs a "
            "single period.",
            "Resample them, or fit them in separate runs.",
        )
    return used[0]


def spans_of(columns: dict[str, Array]) -> list[Segment]:
    """Rows of a recording and part in succession."""
    change = (
        (np.diff(columns["recording"]) != 0)
        | (np.diff(columns["part"]) != 0)
        | (np.diff(columns["time_s"]) <= 0)
    )
    edges = [0, *(np.flatnonzero(change) + 1).tolist(), len(columns["part"])]
    return [Segment(slice(a, b), int(columns["part"][a])) for a, b in pairwise(edges)]


def _windows(columns: dict[str, Array], spans: list[Segment]) -> tuple[list[Segment], int]:
    """The scored rows of every window, behind as many unscored ones as every window has; that
    number.

    The model's start-up lies there, and the network's may.
    """
    windows = [(span, *w) for span in spans for w in scored_windows(columns["window"][span.rows])]
    washout = min((first - free for _, free, first, _ in windows), default=0)
    return [
        Segment(slice(span.rows.start + first - washout, span.rows.start + end), span.part)
        for span, _, first, end in windows
    ], washout


def scored_windows(window: Array) -> list[tuple[int, int, int]]:
    """(end of the window before, first scored row, end) of every window of a span; window: its
    number by row, below 0 where nothing is scored."""
    edges = [0, *(np.flatnonzero(np.diff(window) != 0) + 1).tolist(), len(window)]
    windows, free = [], 0
    for first, end in pairwise(edges):
        if window[first] >= 0:
            windows.append((free, first, end))
            free = end
    return windows


# ---- model and inputs --------------------------------------------------------------------------


def _model_of(
    columns: dict[str, Array],
    channel: str,
    channels: list[str],
    spans: list[Segment],
    replay: bool,
    kind: str,
    rig_inputs: Sequence[str] | None,
) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    """Which model is to be corrected, its usual inputs (() where fit.json does not state the rig's)
    and notes on it."""
    notes: tuple[str, ...] = ()
    for block in () if replay else _loop_blocks(list(columns)):
        if block[1] != derived(channel, "loop"):
            continue
        if all(motion(columns[block[2]][s.rows]) > 0.0 for s in spans):
            return "loop", (block[0], block[4], block[1], block[2], block[3]), ()
        notes = (
            "The refitted model could not be simulated in closed loop; the network corrects the "
            "replay instead.",
        )
        break
    if rig_inputs is None:
        return "replay", (), notes
    usual = (*rig_inputs, *(derived(c, kind) for c in channels))
    return "replay", tuple(name for name in usual if name in columns), notes


def _loop_blocks(header: list[str]) -> list[tuple[str, ...]]:
    """(reference, reading, velocity, acceleration, command) of every controller's loop.

    residual.csv ends, but for networks, with the references and then four loop columns per
    controller.
    """
    first = next(
        (i for i, name in enumerate(header) if split_column(name)[0].endswith("_loop")), len(header)
    )
    count = len([name for name in header[first:] if split_column(name)[0].endswith("_loop")]) // 4
    return [
        (header[first - count + k], *header[first + 4 * k : first + 4 * k + 4])
        for k in range(count)
    ]


def _inputs(
    columns: dict[str, Array],
    channels: list[str],
    kind: str,
    wanted: tuple[str, ...],
    stretches: list[Segment],
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The inputs that vary where the network is trained, and a note on each that does not."""
    measured = {*channels, *(derived(c, "network") for c in channels)}
    offered = [name for name in columns if name not in measured and name not in RESIDUAL_KEYS]
    for name in wanted:
        if name in measured:
            raise UsageError(
                f"--inputs {name}: the inputs come from the model, {name} is measured or "
                "corrected.",
                f"Take {derived(name, kind)}." if name in channels else "",
            )
        if name not in offered:
            raise UsageError(
                f"--inputs {name}: {RESIDUAL_FILE} has no such signal.",
                nearest(name, offered) or f"It offers: {', '.join(offered)}.",
            )
    for name in sorted({n for n in wanted if wanted.count(n) > 1}):
        raise UsageError(f"--inputs {name} is given twice.")
    rows = np.concatenate([np.arange(s.rows.start, s.rows.stop) for s in stretches if s.part == 0])
    flat = [n for n in wanted if motion(columns[n][rows]) == 0.0]
    varying = tuple(n for n in wanted if n not in flat)
    if not varying:
        raise DataError(
            f"Every input is constant over the training part: {', '.join(wanted)}.",
            "Name --inputs.",
        )
    return varying, tuple(
        f"Input {n} is constant ({columns[n][rows[0]]:g}) over the training part and left out."
        for n in flat
    )
