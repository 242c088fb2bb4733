"""What is off by orders of magnitude between a recording and its rig: the clock, a parameter, a
column, a sign; and sensors that show nothing.

A data sheet is off by tens of per cent, a slip of the pen by powers of ten or the ratio of two
units. A slip is looked for where the sizes of the data sheet's run and of the recording are far
apart, in either direction, and believed where setting it right brings the run, or a refit, and the
recording together. Shapes are compared, block by block without level and trend: what integrates
drifts away with the best of data sheets.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from pamid.base.metrics import motion
from pamid.base.units import NONE, from_si, split_column, suffixes_for, unit
from pamid.checks.channel_quality import PLUGGED, QualityIssue
from pamid.checks.hold_or_line import short_fit_errors
from pamid.checks.likeness import blind_sides, correlation, shapes
from pamid.checks.rig_consistency import SheetComparison, recorded_as
from pamid.model.rig import Rig
from pamid.model.sampling import stated_period
from pamid.model.step_rig import StepRig
from pamid.recording.noise import noise_level
from pamid.recording.recording import Recording

Array = NDArray[np.float64]

FAR_CLOCK = 20.0  # times the period that a rig states: not its clock
CLOCKS = {
    1e-3: "milliseconds: divide them by 1000",
    1e-6: "microseconds: divide them by 1e6",
    1e-9: "nanoseconds: divide them by 1e9",
    60.0: "minutes: multiply them by 60",
    # what sets the stamps right -> what they look like
    3600.0: "hours: multiply them by 3600",
}
# factor to which a clock is recognised by the period alone: prefixes, other units
NEAR_CLOCK = {True: 20.0, False: 3.0}
# error with a slip set right: of that of a run that rests, and of the error before
MENDED_OF_REST, MENDED_OF_BEFORE = 0.9, 0.3
LIVELY = 20.0  # times its noise and print: what moves so much in the model is no rest
# ratios of units that are mistaken for each other -> these units; and powers of ten: prefixes
UNIT_RATIOS = {
    60.0: "minutes and seconds",
    3.6: "km/h and m/s",
    180.0 / math.pi: "degrees and radians",
    2.0 * math.pi: "revolutions and radians",
}
LARGE_FACTORS = sorted((*(10.0**p for p in range(1, 7)), *UNIT_RATIOS))
FACTORS = (*(1.0 / f for f in reversed(LARGE_FACTORS)), *LARGE_FACTORS)
# recording over data sheet: a ratio of sizes that is looked at, how near to it a factor has to be,
# and how much nearer than another
FAR_SIZE, NEAR_SIZE, AS_NEAR = 3.0, 2.0, 1.1
LIKE_SHEET = 0.5  # correlation with the data sheet's run from which sizes are compared
SMALLEST_ERROR, LARGEST_ERROR = (
    1e-3,
    1e12,
)  # errors, as shares of the signal's motion, are held within these
MOST_SLIPS = 3  # columns and parameters named in one finding
LEAST_MOTION = 2.0  # times its noise: a channel that shows something
LEAST_CLOCKED_SAMPLES = 50  # of a stepped rig, to doubt the clock
# samples on which they are looked for; of a stepped rig, a sample of which costs many times as much
MOST_TRIED_SAMPLES, MOST_STEPPED_SAMPLES = 4000, 500


@dataclass(frozen=True)
class ScaleSlip:
    """One thing multiplied by `factor` brings model and recording together.

    kind "parameter" or "column"; left: share of the error that stays
    """

    kind: str
    name: str
    factor: float
    left: float

    @property
    def words(self) -> str:
        return f"the {self.kind} {self.name} times {self.factor_words}"

    @property
    def factor_words(self) -> str:
        """The factor, and the units that have this ratio."""
        text = f"{self.factor:g}"
        symbol = split_column(self.name)[1]
        for other in (split_column(f"signal_{s}")[1] for s in suffixes_for(symbol)):
            factor = unit(other).factor / unit(symbol).factor
            if math.isclose(factor, abs(self.factor), rel_tol=1e-9):
                return f"{text} (as if written in {other})"
        ratio = max(abs(self.factor), 1.0 / abs(self.factor))
        return f"{text} (as between {UNIT_RATIOS[ratio]})" if ratio in UNIT_RATIOS else text


def errors(y: Array, model: Array | None) -> Array:
    """Per channel: how far the model is off, over how much the signal moves (both without level and
    trend)."""
    if model is None or not np.isfinite(model).all():
        return np.full(y.shape[1], LARGEST_ERROR)
    ours, theirs = shapes(y), shapes(model)
    with np.errstate(over="ignore"):  # of a model that runs away: the most, all the same
        size, off = (np.sqrt((z * z).sum(axis=(1, 2))) for z in (ours, ours - theirs))
    return np.clip(_share(off, size), SMALLEST_ERROR, LARGEST_ERROR)


def _share(error: Array, size: Array) -> Array:
    """Errors over the sizes of what they are of, at most LARGEST_ERROR: something that stands still
    has no size."""
    return np.asarray(error / np.maximum(np.maximum(size, error / LARGEST_ERROR), 1e-300))


def size_of(error: Array) -> float:
    """One figure for all channels, in which each counts by its order of magnitude."""
    return float(np.exp(np.log(error).mean()))


# ---- the clock ---------------------------------------------------------------------------------


def clock(recording: Recording, rig: Rig, evidence: SheetComparison | None) -> list[QualityIssue]:
    """Stamps that are no seconds: their period is far from the one that the rig states. Where it
    states none, they are doubted if the data sheet's run fits far better with a clock in
    milliseconds, minutes and so on."""
    period, usual = recording.sampling_period_s, stated_period(rig)
    counted = period == 1.0 and bool(np.all(recording.time == np.round(recording.time)))
    if usual is not None:
        ratio = period / usual
        if 1.0 / FAR_CLOCK < ratio < FAR_CLOCK:
            return []
        said = f"where rig {rig.name!r} is sampled every {usual:g} s"
        near = min(CLOCKS, key=lambda c: abs(np.log(ratio * c)))
        wide = NEAR_CLOCK[near < 1.0]
        looks = CLOCKS[near] if 1.0 / wide < ratio * near < wide else ""
        if counted and not 0.5 < ratio * near < 2.0:
            looks = "a count of samples: multiply them by the period"
    else:
        found = _better_clock(evidence) if evidence is not None else None
        if found is None:
            return []
        said = f"at which rig {rig.name!r} would behave quite differently"
        looks, ratio = CLOCKS[found], 1.0 / found
    hint = f"The stamps look like {looks}." if looks else "Are the stamps seconds?"
    return [
        QualityIssue(
            "clock",
            ("time_s",),
            "wrong",
            f"samples are {period:g} s apart, {said}",
            hint,
            (),
            {"period_s": period, "ratio": ratio},
        )
    ]


def _better_clock(e: SheetComparison) -> float | None:
    """What the stamps are to be multiplied by; None where they may well be seconds."""
    before = size_of(errors(e.y, e.model))
    if before < MENDED_OF_REST:
        return None
    # no more time is simulated than was recorded: a simulation has a step of its own, and a sample
    # of an hour would be a million of them
    samples = {c: len(e.u) if c < 1.0 else int(len(e.u) / c) for c in CLOCKS}
    if not isinstance(e.assembly.rig, StepRig):
        samples = dict.fromkeys(CLOCKS, len(e.u))
    after = {
        c: size_of(errors(e.y[:n], e.simulate(e.u[:n], clock=c)))
        for c, n in samples.items()
        if n >= LEAST_CLOCKED_SAMPLES
    }
    if not after:
        return None
    best = min(after, key=lambda c: after[c])
    return best if after[best] < min(MENDED_OF_REST, MENDED_OF_BEFORE * before) else None


# ---- sensors -----------------------------------------------------------------------------------


def unplugged(recording: Recording, rig: Rig, e: SheetComparison) -> list[QualityIssue]:
    """Sensors that show one number throughout while another one moves, and should move
    themselves."""
    still = np.array([motion(y) == 0.0 for y in e.y.T])
    if not e.ran or still.all():
        return []
    found = []
    for k, (name, column) in enumerate(zip(e.names, recorded_as(e.names, recording), strict=True)):
        moves = float(np.ptp(from_si(e.model[:, k], split_column(name)[1])))
        if (
            still[k]
            and motion(recording.columns[column]) == 0.0
            and moves > LIVELY * rig.noise.get(name, 0.0)
        ):
            value, symbol = float(recording.columns[column][0]), split_column(column)[1]
            shown = f"{value:g}" if symbol == NONE else f"{value:g} {symbol}"
            found.append(
                QualityIssue(
                    "dead",
                    (column,),
                    "wrong",
                    f"{column} is constant ({shown}) throughout, where the "
                    f"model of rig {rig.name!r} moves",
                    f"{PLUGGED} Leave the column out if it was not measured.",
                    (),
                    {"value": value},
                )
            )
    return found


# ---- parameters and columns --------------------------------------------------------------------


def slips(e: SheetComparison, recording: Recording) -> list[ScaleSlip]:
    """Slips that explain a recording whose size is far from the data sheet's run, in either
    direction; the best first. Empty where nothing does, or nothing is so far off."""
    return sheet_slips(e, recording) or refitted_slips(e, recording)


def refitted_slips(e: SheetComparison, recording: Recording) -> list[ScaleSlip]:
    """Columns that a factor of the table brings to the size of the data sheet's run, and without
    which a short refit leaves most of the error."""
    tries = _near_factors(e, recording) if e.ran else []
    before = short_fit_errors(recording, e.assembly.rig) if tries else None
    if before is None:
        return []
    found = []
    for column, factor in tries:
        scaled = {**recording.columns, column: recording.columns[column] * factor}
        after = short_fit_errors(replace(recording, columns=scaled), e.assembly.rig)
        if after is None or not np.isfinite(after).all():
            continue
        left = size_of(after) / size_of(np.minimum(before, LARGEST_ERROR))
        if left ** len(after) < MENDED_OF_BEFORE:  # of one channel, if the others stay as they are
            found.append(ScaleSlip("column", column, factor, left))
    return _best(found)


def _near_factors(e: SheetComparison, recording: Recording) -> list[tuple[str, float]]:
    """Columns and the factors of the table nearest to what makes an output as large as the data
    sheet's run: the output's, and its inverse for every input."""
    found = []
    inputs = [
        c
        for c, moves in zip(
            recorded_as(e.inputs, recording), np.ptp(e.u, axis=0) > 0.0, strict=True
        )
        if moves and c in recording.columns
    ]
    columns = recorded_as(e.names, recording)
    for column, ours, theirs in zip(columns, shapes(e.y), shapes(e.model), strict=True):
        if correlation(ours, theirs) < LIKE_SHEET:
            continue
        ratio = math.sqrt(float((ours * ours).sum() / (theirs * theirs).sum()))
        off = {f: abs(math.log(ratio * f)) for f in FACTORS}
        nearest = min(off.values())
        if abs(math.log(ratio)) >= math.log(FAR_SIZE) and nearest <= math.log(NEAR_SIZE):
            near = [f for f in FACTORS if off[f] <= nearest + math.log(AS_NEAR)]
            found += [(column, f) for f in near]
            found += [(name, 1.0 / f) for name in inputs for f in near]
    return list(dict.fromkeys(found))


def sheet_slips(e: SheetComparison, recording: Recording) -> list[ScaleSlip]:
    """What, multiplied by a factor of the table, of either sign, takes away most of the error where
    the data sheet's run misses by more than the signal moves.

    A model at rest misses by just as much as the signal moves. A factor that only brings the model
    to rest explains nothing, so a slip has to come nearer than that.
    """
    stepped = isinstance(e.assembly.rig, StepRig)
    most = MOST_STEPPED_SAMPLES if stepped else MOST_TRIED_SAMPLES
    e = replace(e, y=e.y[:most], u=e.u[:most], model=e.model[:most])
    bad = _missed(e)
    if not bad.any():
        return []
    before, silent = _misses(e.y, e.model)[:, bad], _misses(e.y, np.zeros_like(e.y))[:, bad]
    found = []
    for kind, name, factor, y, model in _tries(e, recording):
        after = _misses(y, model)[:, bad]
        share = float((after / np.minimum(before, silent)).max(axis=1).min())
        small = bool((after < MENDED_OF_BEFORE * before).all(axis=1).any())
        if share < MENDED_OF_REST and small:
            found.append(ScaleSlip(kind, name, factor, share))
    return _best(found)


def _best(found: Iterable[ScaleSlip]) -> list[ScaleSlip]:
    """The best first, and those that are as good."""
    ranked = sorted(found, key=lambda s: s.left)
    as_good = [s for s in ranked if s.left < 1.5 * ranked[0].left]
    named = list(dict.fromkeys((s.kind, s.name) for s in as_good))[:MOST_SLIPS]
    return [s for name in named for s in as_good if (s.kind, s.name) == name]


def _missed(e: SheetComparison) -> NDArray[np.bool_]:
    """Channels that the data sheet's run misses by more than they move, with level and trend and
    without, where they move beyond their noise."""
    return np.asarray(
        (_misses(e.y, e.model) > 1.0).all(axis=0)
        & (e.y.std(axis=0) > LEAST_MOTION * noise_level(e.y))
    )


def _misses(y: Array, model: Array | None) -> Array:
    """Errors of every channel (measures x channels), over how much it moves: of the shapes, and of
    the values."""
    if model is None or not np.isfinite(model).all():
        return np.full((2, y.shape[1]), LARGEST_ERROR)
    with np.errstate(over="ignore"):
        error = np.sqrt(((y - model) ** 2).mean(axis=0))
    plain = _share(error, y.std(axis=0))
    return np.stack([errors(y, model), np.clip(plain, SMALLEST_ERROR, LARGEST_ERROR)])


def _tries(
    e: SheetComparison, recording: Recording
) -> Iterator[tuple[str, str, float, Array, Array | None]]:
    # smaller ones a data sheet may be off by: they have to prove themselves in a refit
    far = [f for f in FACTORS if abs(math.log(f)) > math.log(2.0 * math.pi) + 1e-9]
    either = [-1.0, *far, *(-f for f in far)]
    for k, b in enumerate(e.assembly.parameters):
        for factor in (either if b.low < 0.0 else far) if e.p[k] else ():
            changed = e.p.copy()
            changed[k] *= factor
            yield "parameter", b.full_name, factor, e.y, e.simulate(e.u, changed)
    for j, column in enumerate(recorded_as(e.inputs, recording)):
        for factor in either if motion(e.u[:, j]) > 0.0 else ():
            changed = e.u.copy()
            changed[:, j] *= factor
            yield "column", column, factor, e.y, e.simulate(changed)
    for j, column in enumerate(recorded_as(e.names, recording)):
        for factor in either:
            changed = e.y.copy()
            changed[:, j] *= factor
            yield "column", column, factor, changed, e.model


def far_off(recording: Recording, rig: Rig, e: SheetComparison) -> list[QualityIssue]:
    """Where the size of the data sheet's run is far from what was recorded, and what may be the
    slip: it misses by more than the signal moves, or another unit explains why it moves so little.
    """
    error = _misses(e.y, e.model).min(axis=0)
    columns = recorded_as(e.names, recording)
    missed = _missed(e)
    found = slips(e, recording)
    bad = [int(i) for i in np.argsort(-error) if missed[i]]
    if not bad and not found:
        return []
    if not bad:  # the slip may be an input's: the output that is the furthest off shows it
        with np.errstate(divide="ignore"):
            ratio = np.abs(np.log(e.model.std(axis=0) / e.y.std(axis=0)))
        bad = [int(np.argmax(ratio))]
    most = float(error[bad[0]])
    miss = (
        "runs away"
        if most == LARGEST_ERROR
        else f"misses by {most:.2g} times what the signal moves"
        if missed[bad[0]]
        else f"is {np.std(e.model[:, bad[0]]) / np.std(e.y[:, bad[0]]):.2g} times as large"
    )
    return [
        QualityIssue(
            "far-off",
            tuple(columns[i] for i in bad),
            "advice",
            f"{columns[bad[0]]}: the data sheet of rig {rig.name!r} {miss}",
            advice(found) + _blind(columns[bad[0]], e, bad[0]),
            (),
            {"error": most},
        )
    ]


def _blind(column: str, e: SheetComparison, k: int) -> str:
    """The question, after a space, whether the sensor shows a size only; nothing where it does
    not."""
    y, model = e.y[:, k : k + 1], e.model[:, k : k + 1]
    way = float(blind_sides(y, model)[0]) if np.isfinite(model).all() else 0.0
    if not way:
        return ""
    side = "below" if way > 0.0 else "above"
    return f" {column} never goes {side} 0, where the model does: is its sensor blind to the sign?"


def advice(found: list[ScaleSlip]) -> str:
    """The sentence that sends a reader to units and signs."""
    parts = [
        " or ".join([first.words, *(s.factor_words for s in more)])
        for _, (first, *more) in groupby(found, key=lambda s: (s.kind, s.name))
    ]
    named = f": {', or '.join(parts)} would bring them together" if found else ""
    return f"Check units and signs{named}."
