"""The ways to run an experiment that leave a rig about where it was recorded, as its models
predict, and what is sent with the excitation.

Without a loop a push adds up: a mass that is pushed by what a controller sent drifts off, and so
does the way of a speed that is imposed. An excitation that would lead away is therefore made
smaller or faster, or its slow part is taken off
(`pamid.simulation.excitation.waveforms.washed_out`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from pamid.base.arrays import Array
from pamid.base.metrics import independent_samples, motion
from pamid.base.units import split_column, to_si
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.recording.held_signal import held_by_jumps, stands
from pamid.recording.recording import Recording
from pamid.simulation.data_split import DataSplit
from pamid.simulation.excitation.experiments import EXTERNAL, Bench, Experiment
from pamid.simulation.free_runs import known_values, noiseless_recordings
from pamid.simulation.rig_data import Data

# in which an experiment without a loop is tried: share of the recorded range, times faster
WAYS = ((1.0, 1), (1.0, 2), (1.0, 4), (0.5, 1), (0.5, 2), (0.25, 1))
WASHOUTS = (0.3, 0.1, 0.03)  # shares of the length, whose mean is taken off a signal that leaves it
# independent samples of a recorded input, four in a cycle of a sine: what has fewer in every
# recording passes through less than three cycles
SLOWEST = 12.0
LEEWAY = 0.05  # of the recorded span, by which a rig without a loop may leave it

# of an experiment that is made in several settings
NEXT_FILES = ("next-experiment.csv", "next-experiment-2.csv")

Models = Sequence[CandidateModel]


# ---- what is predicted next to what was recorded ------------------------------------------------


@dataclass(frozen=True)
class PredictedReach:
    """From where to where a channel goes in an experiment as predicted, and as recorded, in its
    unit; or the way of an imposed speed (`way`), of which only the span is known, in m or rad."""

    name: str
    start: float
    low: float
    high: float
    recorded: tuple[float, float]
    way: str = ""

    def leaves(self, share: float) -> bool:
        """Does it leave what was recorded, widened by this share of its span? A model begins where
        its rig states, which counts as recorded; how far it swings counts from anywhere."""
        low, high = self.recorded
        room = share * (high - low)
        if self.high - self.low > high - low + 2.0 * room:
            return True
        begins = min(low, self.start), max(high, self.start)
        return not self.way and (self.low < begins[0] - room or self.high > begins[1] + room)

    @property
    def text(self) -> str:
        """ "position_mm from 0 to -98 .. 92, recorded were -105 .. 105"."""
        low, high = self.recorded
        if self.way:
            return (
                f"the path of {self.name} over {self.high - self.low:.3g} {self.way}; recorded: "
                f"{high - low:.3g} {self.way}"
            )
        return (
            f"{self.name} from {self.start:.3g} to {self.low:.3g} .. {self.high:.3g}; recorded: "
            f"{low:.3g} .. {high:.3g}"
        )


def reaches(evidence: DataSplit, predicted_run: Recording) -> list[PredictedReach]:
    """Of every channel and of every imposed speed that went there and back, in an experiment."""
    predicted = []
    for channel in evidence.channels:
        before = np.concatenate(
            [r.shown(channel) for r in evidence.recordings if channel in r.values]
        )
        now = predicted_run.columns[channel]
        seen = float(before.min()), float(before.max())
        predicted.append(
            PredictedReach(channel, float(now[0]), float(now.min()), float(now.max()), seen)
        )
    return predicted + [
        r for name in evidence.rig.inputs for r in _way(evidence, predicted_run, name)
    ]


def _way(evidence: DataSplit, predicted_run: Recording, speed: str) -> Iterator[PredictedReach]:
    """Of an input that is a speed: where it leads from 0."""
    symbol = {"m/s": "m", "rad/s": "rad"}.get(evidence.rig.inputs[speed])
    recordings = [r for r in evidence.recordings if speed in r.values]
    if symbol is None or not recordings or speed not in predicted_run.columns:
        return
    if not any(r.values[speed].min() < 0.0 < r.values[speed].max() for r in recordings):
        return  # it turns, or feeds on: there is no end to reach
    before = max((_added_up(r.values[speed], r) for r in recordings), key=np.ptp)
    sent = to_si(predicted_run.columns[speed], split_column(speed)[1])
    now, seen = _added_up(sent, predicted_run), (float(before.min()), float(before.max()))
    yield PredictedReach(speed, 0.0, float(now.min()), float(now.max()), seen, symbol)


def _added_up(speed: Array, r: Recording) -> Array:
    """The way of a speed, SI, from 0."""
    return np.concatenate([[0.0], np.cumsum(speed) * r.sampling_period_s])


# ---- what is sent in addition --------------------------------------------------------------------


def drifts(evidence: DataSplit, column: str) -> bool:
    """Whether an input only drifts: in no recording it moves in steps or through a few cycles, as
    a command does and the temperature of a room does not."""
    recorded = [r.values[column] for r in evidence.recordings if column in r.values]
    return not any(
        held_by_jumps(values) or stands(values) or independent_samples(values, values) >= SLOWEST
        for values in recorded
    )


def carried(evidence: DataSplit, bench: Bench) -> dict[str, Array]:
    """Recorded inputs that are not driven, as in the first recording that has them: without them
    the rig would run at their defaults. Not what a loop sends, nor what pushes from outside."""
    rig = evidence.rig
    loops = {name for q in rig.loops for name in (q.reference, q.reading, q.command)}
    columns = {}
    for name in rig.inputs:
        having = [r for r in evidence.recordings if name in r.values]
        if not having or name in loops or name in bench.driven or name.startswith(EXTERNAL):
            continue
        r = having[0]
        samples = max(round(len(r) * r.sampling_period_s / bench.period_s), 1)
        at = np.floor(np.arange(samples) * bench.period_s / r.sampling_period_s + 1e-9).astype(int)
        columns[name] = np.asarray(r.shown(name)[np.minimum(at, len(r) - 1)], dtype=np.float64)
    return columns


def carried_texts(bench: Bench) -> list[str]:
    """Which inputs are sent, and how the others go on."""
    if not bench.carried:
        return []
    return [
        f"sent: {', '.join(bench.driven)}",
        *(
            f"{name} stays at {values[0]:.4g}, as recorded"
            if motion(values) == 0.0
            else f"{name} varies as recorded ({values.min():.4g} .. {values.max():.4g}); "
            "send it only if an actuator sets it"
            for name, values in bench.carried.items()
        ),
    ]


# ---- the ways -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Way:
    """An experiment as it is run on a bench."""

    bench: Bench
    experiment: Experiment

    @cached_property
    def columns(self) -> dict[str, Array]:
        return self.experiment.columns(self.bench)

    @cached_property
    def settings(self) -> tuple[dict[str, float], ...]:
        return self.experiment.settings(self.bench)

    @cached_property
    def minutes(self) -> float:
        return self.experiment.minutes_on(self.bench)


@dataclass(frozen=True, eq=False)
class Predictions:
    """Noise-free recordings that models predict for experiments: the variants of an experiment are
    simulated side by side, once per model."""

    evidence: DataSplit
    _made: dict[tuple[CandidateModel, Way], list[Recording | None]] = field(default_factory=dict)

    def of(self, model: CandidateModel, way: Way) -> list[Recording | None]:
        """Setting after setting; None where the model blows up."""
        return self.of_all(model, [way])[0]

    def of_all(self, model: CandidateModel, ways: Sequence[Way]) -> list[list[Recording | None]]:
        """The same of each of these ways."""
        new = [way for way in ways if (model, way) not in self._made]
        self._made.update({(model, way): [] for way in new})
        alike: dict[tuple[bool, int], list[tuple[Way, Recording]]] = {}
        for way in new:
            bench, columns = way.bench, way.columns
            closed = any(q.reference in columns for q in bench.rig.loops)
            time = bench.period_s * np.arange(len(next(iter(columns.values()))), dtype=np.float64)
            for setting in way.settings:
                excitation = Recording(
                    "experiment",
                    Path(NEXT_FILES[0]),
                    "",
                    time,
                    columns,
                    bench.period_s,
                    "closed" if closed else "open",
                    known={**bench.known, **setting},
                    controller=controller_of(self.evidence) if closed else {},
                )
                alike.setdefault((closed, len(excitation)), []).append((way, excitation))
        for pairs in alike.values():
            recordings = _recorded(model, [excitation for _, excitation in pairs])
            for (way, _), recording in zip(pairs, recordings, strict=True):
                self._made[model, way].append(recording)
        return [self._made[model, way] for way in ways]


def ways_to_run(
    predictions: Predictions,
    bench: Bench,
    entries: Sequence[Experiment],
    models: Models,
) -> list[Way]:
    """The ways to run these experiments: as they are where a loop holds the rig, else those of
    several amplitudes and rates that leave it about where it was recorded, as each of these models
    predicts; with no more of the slow part taken off than that needs."""
    if bench.command:
        return [Way(bench, e) for e in entries]
    evidence = predictions.evidence
    rows = [[Way(w, e) for w in ways] for e in entries for ways in _ways(evidence, bench)]
    chosen: dict[int, Way] = {}
    for tamed in range(max(map(len, rows), default=0)):
        left = {k: row[tamed] for k, row in enumerate(rows) if k not in chosen and tamed < len(row)}
        for model in models:
            made = predictions.of_all(model, list(left.values()))
            left = {
                k: way
                for (k, way), recordings in zip(left.items(), made, strict=True)
                if not _leaving(evidence, recordings)
            }
        chosen |= left
    return [chosen[k] for k in sorted(chosen)]


def _ways(evidence: DataSplit, bench: Bench) -> Iterator[list[Bench]]:
    """Of every amplitude and rate: whole, then with ever more of its slow part taken off."""
    # about the recorded mean, where the rig stayed in its recorded range, and no larger than before
    balanced = {}
    for name, (centre, half) in bench.driven.items():
        mean = float(np.concatenate([r.shown(name) for r in evidence.recordings]).mean())
        balanced[name] = mean, max(half - abs(mean - centre), 0.0)
    for share, passes in WAYS:
        whole = {k: (c, share * h) for k, (c, h) in bench.driven.items()}
        level = {k: (c, share * h) for k, (c, h) in balanced.items()}
        yield [
            replace(bench, driven=whole, passes=passes),
            *(replace(bench, driven=level, passes=passes, washed=w) for w in WASHOUTS),
        ]


def _leaving(evidence: DataSplit, recordings: list[Recording | None]) -> list[PredictedReach]:
    """Channels that a prediction takes beyond the recordings; all of them where the model blows
    up."""
    stable = [r for r in recordings if r is not None]
    if len(stable) < len(recordings):
        return [PredictedReach(c, 0.0, -np.inf, np.inf, (0.0, 0.0)) for c in evidence.channels]
    return [x for r in stable for x in reaches(evidence, r) if x.leaves(LEEWAY)]


def predicted_text(predictions: Predictions, way: Way, models: Models) -> str:
    """Where an experiment without a loop leads as the models predict, the widest of them per
    name."""
    every = [
        x
        for model in models
        for r in predictions.of(model, way)
        if r
        for x in reaches(predictions.evidence, r)
    ]
    widest = {x.name: x for x in sorted(every, key=lambda x: x.high - x.low)}
    return f"predicted: {'; '.join(x.text for x in widest.values())}" if widest else ""


def led_away(predictions: Predictions, bench: Bench, e: Experiment, models: Models) -> str:
    """Where even the mildest way of an experiment leads beyond what was recorded."""
    evidence = predictions.evidence
    mildest = Way(list(_ways(evidence, bench))[-1][-1], e)
    leaving = (_leaving(evidence, predictions.of(model, mildest)) for model in models)
    return " and ".join(x.text for x in next(filter(None, leaving), []))


# ---- what a model would record ------------------------------------------------------------------


def reference_recording(evidence: DataSplit) -> Data:
    """The recording after which an experiment is set up: the first that was commanded, if
    any."""
    commands = [q.command for q in evidence.rig.loops]
    return next(
        (r for r in evidence.recordings if all(c in r.values for c in commands)),
        evidence.recordings[0],
    )


def _recorded(c: CandidateModel, excitations: list[Recording]) -> list[Recording | None]:
    """Noise-free recordings of excitations of equal length in the same loop; None where the model
    blows up."""
    controller = tuple(sorted(excitations[0].controller.items()))
    model = replace(c.assembly, controller=controller) if controller else c.assembly
    p = np.repeat(c.fit.p[:, None], len(excitations), axis=1)
    for k, excitation in enumerate(excitations):
        values, places = known_values(model, excitation.known)
        p[places, k] = values[places]
    return [
        None if columns is None else replace(excitation, columns=columns)
        for excitation, columns in zip(
            excitations, noiseless_recordings(model, excitations, p), strict=True
        )
    ]


def controller_of(evidence: DataSplit) -> dict[str, float]:
    return {**evidence.rig.controller, **reference_recording(evidence).controller}
