"""Slip that explains a recording best.

The slips are another unit, an opposite sign, exchanged columns, a clock that does not count
seconds, and a number of the data sheet that is off by powers of ten. Each slip of a list is
corrected, and a short fit of the rig (`short_fit`) judges the corrected recording. The criteria are
the share of the motion left over and the necessary change of the data sheet.

    gain     score of the fit as recorded - score with the slip corrected

A slip is reported if its gain is CLEAR_GAIN and the errors fall, or stay small; so are others
within TIED_GAIN of it. It is wrong, and stops a fit, if its gain is SURE_GAIN and it is gross: a
sign, an exchange, another unit by a factor of GROSS. All else is advice.

Fits are only done if the recording is far from the data sheet's run, and for the slips that bring
it nearer. Two of them are tried together if no single slip explains it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import PamidError
from pamid.base.metrics import motion
from pamid.base.units import (
    NONE,
    from_si,
    kindred_units,
    quantity_of,
    split_column,
    to_si,
    unit,
)
from pamid.intake.checks.findings import unit_after
from pamid.intake.checks.sheet_comparison import (
    SheetComparison,
    recorded_columns,
    same_quantity_columns,
    shapes,
)
from pamid.intake.checks.short_fit import (
    EXACT,
    FEWEST_WINDOWS,
    RUNAWAY,
    Judgement,
    ShortFit,
    fit_data_of,
)
from pamid.model.sampling import stated_period
from pamid.model.step_rig import StepRig
from pamid.recording.recording import Recording
from pamid.simulation.rig_data import data_of

# ratios of units that are often confused -> these units; and powers of ten: prefixes
UNIT_RATIOS = {
    60.0: "minutes and seconds",
    180.0 / math.pi: "degrees and radians",
    2.0 * math.pi: "revolutions and radians",
}
# edges per line of an encoder that may be counted
QUADRATURE = (2.0, 4.0)
COUNTED = ("angle", "angular velocity", "length", "velocity")
NEAR_COUNT = 0.1  # tolerance of a free gain to be named after an integer factor
LARGE_FACTORS = sorted((*(10.0**p for p in range(1, 7)), *UNIT_RATIOS))
FACTORS = (*(1.0 / f for f in reversed(LARGE_FACTORS)), *LARGE_FACTORS)
CLOCKS = {
    1e-3: "milliseconds: divide them by 1000",
    1e-6: "microseconds: divide them by 1e6",
    1e-9: "nanoseconds: divide them by 1e9",
    60.0: "minutes: multiply them by 60",
    3600.0: "hours: multiply them by 3600",
}
ATMOSPHERE_PA = 101325.0
ORDER = (
    "clock",
    "sign",
    "exchanged",
    "absolute-pressure",
    "unit",
    "offset",
    "gain",
    "scale",
    "parameter",
)
UNNAMED = ORDER[-2:]  # kinds of slips without a unit
INVENTED = 3.0  # a free factor must be this much nearer to the data sheet's run to tie with a unit
HARMLESS = (*UNNAMED, "absolute-pressure", "offset", "gain")  # kinds that do not stop a fit
# weight of a predicted channel: its residuals are computed, but it does not affect the fit
UNSEEN_WEIGHT = 1e-6
# for a fit: smallest offset as a share of the channel's motion, and smallest log of a free gain
LEAST_OFFSET, LEAST_GAIN = 0.3, math.log(1.3)
# smallest share of the variance within windows that a copy has in common with its prediction
LEAST_SHARED = 0.25
OTHER_SIDE = "measured on the other side of the gear"
GEARED = ("angle", "angular velocity", "angular acceleration", "torque")
PREFIXED = ("A", "V", "W", "N", "Pa", "J", "m", "Hz", "Ohm")
PREFIXES = {"k": 1e3, "M": 1e6, "m": 1e-3, "u": 1e-6}
ALIKE = 1.5  # ratio of two factors below which they count as the same
GEAR_WORDS = {"gear", "gearing", "gearbox", "ratio", "reduction", "transmission"}

# natural logarithms of odds: a slip is named, and stops a fit; others are named with it
CLEAR_GAIN, SURE_GAIN, TIED_GAIN = 12.0, 40.0, 5.0
# largest ratio of the errors to those as recorded: of a slip that corrects them, and of any slip
MENDED, NO_WORSE = 0.3, 1.1
GROSS = 6.0  # a factor beyond any error of a data sheet
WINDOW_TIMESCALES = 1.0  # length of a window, in correlation times of the recording
# largest number of steps: of the fit as recorded, of a slip, and of the first fit of a slip
RECORDED_STEPS, JUDGING_STEPS, FIRST_STEPS = 30, 12, 4
# largest error after a fit as a share of the channel's motion; the second if it was much larger
UNEXPLAINED_MOTION, HARDLY_EXPLAINED = 0.5, 0.75
FAR = 0.3  # smallest distance to the data sheet's run for a search of slips
NEARER = 0.4  # smallest decrease of the log distance to the data sheet's run for a fit
NEAR_SIZE = 6.0  # largest ratio to the data sheet's size after a correction of the unit
MOST_FITTED, MOST_SET_RIGHT = 10, 4  # slips per round of fits; slips per recording
MOST_PAIRED = 2  # slips that are combined with every other slip
MOST_NAMED_SLIPS = 3  # columns and parameters named in a finding
LEAST_CLOCKED_SAMPLES = 50  # samples of a stepped rig for a test of the clock
# samples of a run; of a stepped rig, a sample of which costs many times as much
MOST_TRIED_SAMPLES, MOST_STEPPED_SAMPLES = 2000, 500


@dataclass(frozen=True)
class Slip:
    """A possible fault of a recording, or of the data sheet of its rig.

    kind            "unit", "sign", "exchanged", "absolute-pressure", "clock"; "offset" and "gain":
                    those of an output against the other outputs; "scale": a factor of the table
                    that is not a unit of the column; "parameter"
    names           columns as recorded, or a parameter
    factor, offset  correction: factor * value + offset, SI
    meaning         apparent unit of the values, or the way a motion is measured
    """

    kind: str
    names: tuple[str, ...]
    factor: float = 1.0
    offset: float = 0.0
    meaning: str = ""

    @property
    def gross(self) -> bool:
        """True if it is larger than a plausible error of a data sheet."""
        size = abs(math.log(abs(self.factor)))
        return self.kind in ("sign", "exchanged") or bool(self.offset) or size >= math.log(GROSS)

    @property
    def geared(self) -> bool:
        """True if its meaning is the side of a gear, and not a unit."""
        return self.meaning.startswith(OTHER_SIDE)

    @property
    def words(self) -> str:
        if self.kind == "offset":
            (column,) = self.names
            shown = f"{-self.offset / unit(split_column(column)[1]).factor:.4g}"
            return f"{column} offset by {shown}{unit_after(column)}"
        what = "parameter" if self.kind == "parameter" else "column"
        return f"the {what} {' and '.join(self.names)} times {self.factor_words}"

    @property
    def factor_words(self) -> str:
        """Factor, and the units that have this ratio."""
        text, ratio = f"{self.factor:g}", max(abs(self.factor), 1.0 / abs(self.factor))
        if self.meaning:
            meaning = self.meaning if self.geared else f"as if written in {self.meaning}"
            return f"{text} ({meaning})"
        symbol = split_column(self.names[0])[1]
        for other in kindred_units(symbol):
            if math.isclose(unit(other).factor / unit(symbol).factor, abs(self.factor)):
                return f"{text} (as if written in {other})"
        return f"{text} (as between {UNIT_RATIOS[ratio]})" if ratio in UNIT_RATIOS else text

    @property
    def cause_words(self) -> str:
        """Usual cause of a free gain, as a question after a space; "" if none is near."""
        ratio = max(self.factor, 1.0 / self.factor)
        counted = quantity_of(split_column(self.names[0])[1]) in COUNTED
        for edges in QUADRATURE if counted else ():
            if abs(ratio / edges - 1.0) < NEAR_COUNT:
                return f" Counts per turn x{edges:g}?"
        return ""

    def corrected(self, recording: Recording) -> Recording:
        """Recording after the correction; a slip of the data sheet leaves it unchanged."""
        if self.kind == "parameter":
            return recording
        if self.kind == "clock":
            return replace(
                recording,
                time=recording.time * self.factor,
                sampling_period_s=recording.sampling_period_s * self.factor,
            )
        columns = dict(recording.columns)
        if self.kind == "exchanged":
            first, other = self.names
            columns[first], columns[other] = columns[other], columns[first]
        else:
            for name in self.names:
                symbol = split_column(name)[1]
                si = to_si(columns[name], symbol) * self.factor + self.offset
                columns[name] = np.asarray(from_si(si, symbol))
        return replace(recording, columns=columns)

    def compared(self, e: SheetComparison, recording: Recording) -> SheetComparison | None:
        """Comparison after the correction; None if the rig does not run then."""
        if self.kind == "parameter":
            p = e.p.copy()
            p[[b.full_name for b in e.assembly.parameters].index(self.names[0])] *= self.factor
            model = e.simulate(e.u, p)
            return None if model is None else replace(e, p=p, model=model)
        if self.kind == "clock":
            n = len(e.u)
            if isinstance(e.assembly.rig, StepRig):
                # simulated time is limited to the recorded time, because a sample of an hour would
                # be a million steps
                n = n if self.factor < 1.0 else int(n / self.factor)
            model = e.simulate(e.u[:n], clock=self.factor) if n >= LEAST_CLOCKED_SAMPLES else None
            return None if model is None else replace(e, y=e.y[:n], u=e.u[:n], model=model)
        fixed, n = data_of(e.assembly.rig, self.corrected(recording)), len(e.u)
        y, u = fixed.outputs(e.names)[:n], fixed.inputs(e.assembly)[:n]
        model = e.model if np.array_equal(u, e.u) else e.simulate(u)
        return None if model is None else replace(e, y=y, u=u, model=model)


@dataclass(frozen=True)
class Explanation:
    """A slip with its fits as recorded and corrected; others: slips that explain as much."""

    slip: Slip
    before: Judgement
    after: Judgement
    away: float = 0.0  # mean log distance to the data sheet's run
    others: tuple[Slip, ...] = ()

    @property
    def gain(self) -> float:
        return self.before.score - self.after.score

    @property
    def implausibility(self) -> float:
        """Rank among slips that explain a recording equally well: the distance to the data sheet's
        run."""
        return self.away + (math.log(INVENTED) if self.slip.kind in UNNAMED else 0.0)

    @property
    def wrong(self) -> bool:
        """True if the recording cannot be right."""
        slip = self.slip
        # an exchange of kelvin and degrees Celsius: 273 K are beyond any fault of a machine, and in
        # either direction: below absolute zero the error is infinite, but far above room
        # temperature a fit adapts its losses
        celsius = slip.kind == "unit" and slip.factor == 1.0 and slip.offset
        sure = CLEAR_GAIN if celsius else SURE_GAIN
        return slip.gross and slip.kind not in HARMLESS and self.gain >= sure

    @property
    def figures(self) -> dict[str, float]:
        shows = max(
            self.before.errors,
            key=lambda c: self.before.errors[c] / max(self.after.errors[c], EXACT),
        )
        return {
            "error_as_recorded": self.before.errors[shows],
            "error_mended": self.after.errors[shows],
            "tolerances_as_recorded": math.sqrt(self.before.strain),
            "tolerances_mended": math.sqrt(self.after.strain),
        }


# ---- judging -------------------------------------------------------------------------------------


def judge(
    recording: Recording,
    e: SheetComparison,
    like: ShortFit | None = None,
    steps: int = JUDGING_STEPS,
) -> Judgement:
    """Quality of a short fit of the rig from the values of `e`, or of its run if the fit fails.

    like: fit to another version of the recording, whose model is reused if the inputs are the same.
    steps: largest number of steps.
    """
    rig = e.assembly.rig
    try:
        data = fit_data_of(recording, rig, WINDOW_TIMESCALES)
        if data is not None:
            data = replace(data, track=replace(data.track, p=e.p))
            problem = like if like and like.matches_data(data) else None
            # what every slip has to beat is the best fit of the recording as it is
            fit = data.fitted(rig, problem=problem, steps=steps, restart=like is None)
            return fit.judgement
    except (PamidError, FloatingPointError, np.linalg.LinAlgError):
        pass
    return _judged_by_sheet(e)


def _judged_by_sheet(e: SheetComparison) -> Judgement:
    moves = [k for k, y in enumerate(e.y.T) if motion(y) > 0.0]
    away = np.exp(sheet_distances(e).mean(axis=0))
    return Judgement({e.names[k]: float(away[k]) for k in moves})


def sheet_distances(e: SheetComparison) -> Array:
    """Log ratio of the distance to the data sheet's run and the smaller of the two motions.

    It covers shapes and values; per output, then per pair of similar outputs.
    """
    pairs = same_quantity_columns(e.names)
    if not e.ran:
        return np.full((2, len(e.names) + len(pairs)), math.log(RUNAWAY))
    shown = e.shown
    ours, theirs = shapes(e.y), shapes(shown)
    mine = [*ours, *(ours[i] - ours[j] for i, j in pairs)]
    its = [*theirs, *(theirs[i] - theirs[j] for i, j in pairs)]
    shape = [_apart(a, b) for a, b in zip(mine, its, strict=True)]
    plain = [_apart(a - a.mean(), b - a.mean()) for a, b in zip(e.y.T, shown.T, strict=True)]
    plain += shape[len(e.names) :]
    return np.log(np.array([shape, plain]))


def _apart(a: Array, b: Array) -> float:
    with np.errstate(over="ignore"):
        sizes = math.sqrt(float((a * a).sum())), math.sqrt(float((b * b).sum()))
        off = math.sqrt(float(((a - b) ** 2).sum()))
    return min(max(off / max(min(sizes), off / RUNAWAY, 1e-300), EXACT), RUNAWAY)


# ---- the list of slips ---------------------------------------------------------------------------


def slips_of_sheet(e: SheetComparison) -> Iterator[Slip]:
    """Numbers of the data sheet, each off by a factor of the table."""
    for b, value in zip(e.assembly.parameters, e.p, strict=True):
        factors = (*FACTORS, -1.0) if b.low < 0.0 else FACTORS
        yield from (Slip("parameter", (b.full_name,), f) for f in factors if value)


def slips_of_recording(e: SheetComparison, recording: Recording) -> Iterator[Slip]:
    """Candidate slips of the columns and of the clock."""
    gears = {
        b.full_name: float(value)
        for b, value in zip(e.assembly.parameters, e.p, strict=True)
        if unit(b.unit or NONE).quantity == "dimensionless"
        and set(b.full_name.lower().split("_")) & GEAR_WORDS
        and "damping" not in b.full_name.lower()
        and value > 0.0
        and abs(math.log(value)) > math.log(1.5)
    }
    outputs, inputs = recorded_columns(e.names, recording), recorded_columns(e.inputs, recording)
    inputs = tuple(c for c in inputs if c in recording.columns and motion(recording.columns[c]))
    sizes = [math.sqrt(float((a * a).sum())) for a in shapes(e.y)]
    modelled = [math.sqrt(float((a * a).sum())) for a in shapes(e.model)]
    likes: dict[str, list[str]] = {}
    for column, ours, theirs in zip(outputs, sizes, modelled, strict=True):
        likes.setdefault(split_column(column)[1], []).append(column)
        for slip in _of_column(column, gears):
            near = theirs == 0.0 or abs(math.log(max(ours * slip.factor / theirs, 1e-300)))
            if slip.offset or near < math.log(NEAR_SIZE):
                yield slip
    for symbol, columns in likes.items():
        if len(columns) > 1 and symbol != NONE:
            yield from (replace(s, names=tuple(columns)) for s in _of_column(columns[0], gears))
    for column in inputs:
        yield from _of_column(column, gears)
    # inputs first, because an input explains several outputs at once; a sign is not tried if the
    # column and its model stay above zero
    for column in inputs:
        values = recording.columns[column]
        if values.min() < 0.0 < values.max():
            yield Slip("sign", (column,), -1.0)
    for column, y, model in zip(outputs, e.y.T, e.model.T, strict=True):
        if min(y.min(), model.min()) < -0.02 * np.ptp(model):
            yield Slip("sign", (column,), -1.0)
    # an input with any other column, and similar outputs
    for k, column in enumerate(inputs):
        for other in (*inputs[k + 1 :], *outputs):
            yield Slip("exchanged", (column, other))
    for i, j in same_quantity_columns(outputs):
        yield Slip("exchanged", (outputs[i], outputs[j]))
    if stated_period(e.assembly.rig) is None:
        yield from (Slip("clock", ("time_s",), factor) for factor in CLOCKS)


def _of_column(column: str, gears: dict[str, float]) -> Iterator[Slip]:
    """Other units of a column, and the motor's side of a gear; then factors of another kind."""
    symbol = split_column(column)[1]
    column_unit, quantity = unit(symbol), quantity_of(symbol)
    conversions = {u: (unit(u).factor, unit(u).offset) for u in kindred_units(symbol)}
    if symbol in PREFIXED:
        conversions |= {
            f"{prefix}{symbol}": (by * column_unit.factor, 0.0) for prefix, by in PREFIXES.items()
        }
    if quantity in ("angle", "angular velocity"):
        conversions["revolutions" if quantity == "angle" else "rev/s"] = (2.0 * math.pi, 0.0)
    if quantity == "velocity":
        conversions["km/h"] = (1.0 / 3.6, 0.0)
    named = []
    for name, (factor, offset) in conversions.items():
        factor /= column_unit.factor
        offset -= column_unit.offset * factor
        named.append(Slip("unit", (column,), factor, offset, name))
    if quantity == "pressure":
        named.append(Slip("absolute-pressure", (column,), 1.0, -ATMOSPHERE_PA))
    if quantity in GEARED:
        for name, ratio in gears.items():
            words = f"{OTHER_SIDE}, {name} = {ratio:g}"
            named += [Slip("unit", (column,), f, 0.0, words) for f in (ratio, 1.0 / ratio)]
    yield from named
    if quantity != "temperature":
        sizes = [math.log(slip.factor) for slip in named]
        for factor in FACTORS:
            if all(abs(math.log(factor) - size) > math.log(ALIKE) for size in sizes):
                yield Slip("scale", (column,), factor)


# ---- which slip it is ----------------------------------------------------------------------------


def find_slips(
    recording: Recording, e: SheetComparison, *, thorough: bool = True
) -> tuple[list[Explanation], Recording, SheetComparison, Judgement]:
    """Slips of a recording in sequence, the corrected recording, its comparison with the data sheet
    and the quality of its fit.

    thorough: also try slips of the data sheet.
    """
    explanations: list[Explanation] = []
    if float(sheet_distances(e).max()) < math.log(FAR):
        return explanations, recording, e, _judged_by_sheet(e)
    before = judge(recording, e, steps=RECORDED_STEPS)
    while before.suspicious and len(explanations) < MOST_SET_RIGHT:
        slips = _next(recording, e, before, thorough)
        for explanation in slips:
            explanations.append(explanation)
            after = explanation.slip.compared(e, recording)
            if explanation.slip.kind in UNNAMED or after is None:
                return explanations, recording, e, before
            recording, e, before = explanation.slip.corrected(recording), after, explanation.after
        if not slips:
            break
    return explanations, recording, e, before


def _next(
    recording: Recording, e: SheetComparison, before: Judgement, thorough: bool
) -> list[Explanation]:
    """Slip that explains the recording best, or two that do together.

    Empty for a recording without a fault.
    """
    nearest = _nearest_slips(recording, e, slips_of_recording(e, recording))
    ranked = _best(recording, before, nearest)
    first = _first(ranked)
    if first is None or first.slip.kind in UNNAMED:
        ranked = _best(recording, before, _predicted_slips(recording, e, before), ranked)
        first = _first(ranked)
    if first is not None and first.slip.kind not in UNNAMED:
        return [first]
    if float(sheet_distances(e).min(axis=0).max()) <= 0.0:
        return [] if first is None else [first]
    pairs = [] if first else [*_pairs(recording, before, nearest)]
    if pairs:
        return max(pairs, key=lambda pair: pair[1].gain)
    if thorough:
        sheet = _nearest_slips(recording, e, slips_of_sheet(e))
        first = _first(_best(recording, before, sheet, ranked))
    return [] if first is None else [first]


def _pairs(
    recording: Recording, before: Judgement, nearest: Sequence[tuple[Slip, SheetComparison]]
) -> Iterator[list[Explanation]]:
    """Pairs of slips of which neither explains the recording alone; nearest: as of
    `_nearest_slips`."""
    named = [(slip, after) for slip, after in nearest if slip.kind not in UNNAMED]
    for slip, after in named[:MOST_PAIRED]:
        fixed = slip.corrected(recording)
        further = _nearest_slips(fixed, after, slips_of_recording(after, fixed))
        second = _first(_best(fixed, before, further))
        if second is not None and second.slip.kind not in UNNAMED:
            yield [replace(second, slip=slip, others=()), second]


def _best(
    recording: Recording,
    before: Judgement,
    slips: Sequence[tuple[Slip, SheetComparison]],
    rivals: Sequence[Explanation] = (),
) -> list[Explanation]:
    """Slips that explain the recording clearly, best first, including earlier ones.

    slips: each with the comparison after its correction.
    """
    scored = list(rivals)
    for slip, after in slips:
        tried = slip.corrected(recording), after, before.problem
        # most slips are worse from the first steps on
        judgement = judge(*tried, steps=FIRST_STEPS)
        if judgement.errors.keys() != before.errors.keys() or judgement.error_ratio(before) > 1.0:
            continue
        judgement = judge(*tried)
        recorded = zip(after.names, recorded_columns(after.names, recording), strict=True)
        named, left = [n for n, c in recorded if c in slip.names], judgement.error_ratio(before)
        least = HARDLY_EXPLAINED if left <= MENDED else UNEXPLAINED_MOTION
        if left <= NO_WORSE and judgement.smallest_error(named) <= least:
            away = float(sheet_distances(after).mean())
            scored.append(Explanation(slip, before, judgement, away))
    return sorted((e for e in scored if e.gain >= CLEAR_GAIN), key=lambda e: -e.gain)


def _first(ranked: Sequence[Explanation]) -> Explanation | None:
    """Most plausible of the explanations that tie with the best, with the others."""
    ties = [explanation for explanation in ranked if explanation.gain >= ranked[0].gain - TIED_GAIN]
    if not ties:
        return None
    first = min(ties, key=lambda tie: (round(tie.implausibility, 1), ORDER.index(tie.slip.kind)))
    others = sorted((tie for tie in ties if tie is not first), key=lambda tie: tie.implausibility)
    return replace(first, others=tuple(other.slip for other in others))


def _predicted_slips(
    recording: Recording, e: SheetComparison, before: Judgement
) -> list[tuple[Slip, SheetComparison]]:
    """Offset, opposite sign and factor of every output, predicted by the other outputs.

    The rig is fitted without the channel, which is then regressed on its prediction,

        y = gain * model + offset

    the gain from the motion within the windows, the offset from the median of their levels. A table
    of factors contains neither the counts of an encoder nor the zero of a gauge.
    """
    slips = []
    try:
        data = fit_data_of(recording, e.assembly.rig, WINDOW_TIMESCALES)
        if data is None:
            return []
        like = before.problem
        problem = like if like and like.matches_data(data) else ShortFit.of(data, data.rig)
        for k, (name, motion_) in enumerate(zip(data.names, data.motions, strict=True)):
            weight = data.weight.copy()
            weight[k] *= UNSEEN_WEIGHT
            fit = replace(data, weight=weight).fitted(
                data.rig, problem=problem, steps=JUDGING_STEPS
            )
            # the channel as measured and as predicted: windows x samples
            y = np.array([data.track.y[w.start : w.stop, k] for w in data.windows])
            model = y + fit.point.left[:, :, k] / weight[k]
            ran = np.isfinite(model).all(axis=1)
            (column,) = recorded_columns((name,), recording)
            of_column = _regressed(column, y[ran], model[ran], float(motion_))
            # only the data sheet predicts the size of a lone output: use the table of factors
            slips += [slip for slip in of_column if slip.kind != "gain" or len(data.names) > 1]
    except (PamidError, FloatingPointError, np.linalg.LinAlgError):
        return []
    compared = [(slip, slip.compared(e, recording)) for slip in slips]
    return [(slip, after) for slip, after in compared if after is not None]


def _regressed(column: str, y: Array, model: Array, moves: float) -> Iterator[Slip]:
    """Corrections of a column whose prediction is `model`; moves: its motion."""
    if len(y) < FEWEST_WINDOWS:
        return
    ours, theirs = (a - a.mean(axis=1, keepdims=True) for a in (y, model))
    common, power = float((ours * theirs).sum()), float((theirs * theirs).sum())
    if common**2 < LEAST_SHARED * power * float((ours * ours).sum()):
        return  # a dead channel does not follow any prediction, whatever its scale
    gain = common / max(power, 1e-300)
    for sign in (1.0, -1.0):
        offset = float(np.median((model - sign * y).mean(axis=1)))
        if abs(offset) > LEAST_OFFSET * moves:
            yield Slip("offset" if sign > 0.0 else "sign", (column,), sign, offset)
    listed = gain > 0.0 and any(abs(gain * factor - 1.0) < NEAR_COUNT for factor in FACTORS)
    if gain > 0.0 and abs(math.log(gain)) > LEAST_GAIN and not listed:
        yield Slip("gain", (column,), 1.0 / gain)


def _nearest_slips(
    recording: Recording, e: SheetComparison, slips: Iterable[Slip]
) -> list[tuple[Slip, SheetComparison]]:
    """Slips that bring the recording nearest to the data sheet's run, nearest first."""
    stepped = isinstance(e.assembly.rig, StepRig)
    most = MOST_STEPPED_SAMPLES if stepped else MOST_TRIED_SAMPLES
    e = replace(e, y=e.y[:most], u=e.u[:most], model=e.model[:most])
    away, nearer = float(sheet_distances(e).sum()), []
    for slip in slips:
        after = slip.compared(e, recording)
        by = 0.0 if after is None else away - float(sheet_distances(after).sum())
        if after is not None and by > NEARER:
            nearer.append((by, slip, after))
    nearer.sort(key=lambda item: -item[0])
    return [(slip, after) for _, slip, after in nearer[:MOST_FITTED]]
