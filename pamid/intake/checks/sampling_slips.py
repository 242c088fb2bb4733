"""Slips of sampling: an input between its samples, and a reading in another row.

Each alternative is judged by a short refit (`short_fit`) that starts where the fit as recorded
ended.

    held, linear   zero-order or first-order hold of an input. The two differ by a delay of half a
                   sample, and by the course between samples. If the rig answers within a few
                   samples, no parameter can make up for this difference. An unmodelled delay of
                   half a sample looks the same. Better: an error at most BETTER times the other's,
                   smaller in SURE of the windows.
    before         the reading of an output was taken before the command of its row was sent
    late, early    the row holds the reading of the row before, or of the next row. These orders
                   show in outputs that depend on an input of the same instant, for example a
                   current on the voltage: a delay of a sampling period there comes from the log.
                   Reported if the error of the channel falls to MENDED of the error as recorded.

Another order is only refitted if the residual correlates with the change of the reading from row to
row; other refits do not reduce the error. A linear machine under a held input reads the same before
and late, with slightly other parameters: then both are reported.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import PamidError
from pamid.base.metrics import motion
from pamid.base.schemas.check_file import BetweenSamples
from pamid.base.units import size_from_si, split_column
from pamid.engine.symbolic.expression import symbols
from pamid.intake.checks.findings import unit_after
from pamid.intake.checks.short_fit import FitData, FittedWindows, ShortFit, fit_data_of
from pamid.model.assembly import Assembly
from pamid.model.between_samples import HELD, LINEAR, between_of, other, stated
from pamid.model.rig import Rig
from pamid.model.step_rig import StepRig
from pamid.recording.file_checks import BEFORE
from pamid.recording.recording import Recording, match_column

ROW_LATE, ROW_EARLY = "late", "early"
OF_THE_LOG = "the log is the cause, not the machine"
MEANINGS = {
    HELD: "held between samples",
    LINEAR: "linear between samples",
    BEFORE: "was read before the command of its row was sent",
    ROW_LATE: "is a row late (each row contains the reading of the row before)",
    ROW_EARLY: "is a row early (each row contains the reading of the next row)",
}
BETTER, SURE = 0.9, 0.7
# share of the error as recorded, below which another order explains it
MENDED = 0.3
AS_GOOD = 1.1  # times the smallest error: an equal explanation
SHARED_SHARE = 0.5  # share of the squared residual that correlates with the change from row to row


class InputHold(BetweenSamples):
    """An input with both holds; taken: the hold that the rig or the recording states."""

    @property
    def wrong(self) -> bool:
        """True if the hold that is not in use fits clearly better."""
        return self.better not in ("", self.taken)

    def text(self, recording: Recording) -> str:
        by = {HELD: self.rms_held, LINEAR: self.rms_linear}
        way, rest = (self.better or self.taken), other(self.better or self.taken)
        figures = (
            f"{self.channel} {by[way]:.3g}{unit_after(self.channel)} RMS against {by[rest]:.3g} "
            f"{rest}, over {self.windows} windows"
        )
        taken = f"{self.column} is taken as {MEANINGS[self.taken]}"
        if not self.better:
            return f"{taken}; this recording cannot decide ({figures})"
        if not self.wrong:
            return f"{self.column} is {MEANINGS[self.taken]}, which fits better ({figures})"
        return (
            f"{taken}, but {self.better} fits clearly better: {figures}. Write "
            f'between = {{"{self.column}": "{self.better}"}} into the rig file, or [between] '
            f'{match_column(recording.columns, self.column)} = "{self.better}" into '
            f"{recording.path.with_suffix('.toml').name}"
        )


@dataclass(frozen=True)
class RowOrder:
    """Output in another order than that of its rows.

    column              as recorded
    orders              "before", "late" or "early"; of several equal explanations, first that with
                        the smallest changes of the data sheet
    as_recorded, corrected root mean square error of the short fit, in the unit of the column
    """

    column: str
    orders: tuple[str, ...]
    as_recorded: float
    corrected: float

    def text(self, recording: Recording) -> str:
        where = " or ".join(MEANINGS[order] for order in self.orders)
        rows = f"below [signals.{self.column}] in the mapping of `pamid ingest`"
        remedies = {
            BEFORE: (
                f'[between] {self.column} = "before" in '
                f"{recording.path.with_suffix('.toml').name}, or between = "
                f'{{"{self.column}": "before"}} in the rig file'
            ),
            ROW_LATE: f"rows = 1 {rows}",
            ROW_EARLY: f"rows = -1 {rows}",
        }
        return (
            f"{self.column} {where}. With corrected rows the error of the rig is "
            f"{self.corrected:.3g}{unit_after(self.column)} RMS instead of {self.as_recorded:.3g}: "
            f"{OF_THE_LOG}. Remedy: {'; or '.join(remedies[order] for order in self.orders)}."
        )


def compare_holds(
    recording: Recording, rig: Rig, columns: Iterable[str] | None = None
) -> list[InputHold]:
    """Compare both holds of the recording's inputs.

    The list is empty if the rig cannot run on the recording, and for a rig that steps by itself
    once a sample. A command of a controller is held, and is not tried.

    rig: with the values that the recording states (`as_recorded`). columns: inputs to try, by
    default all.
    """
    held = {loop.command for loop in rig.loops}
    try:
        data = fit_data_of(recording, rig)
        names = [
            c
            for c in (rig.inputs if columns is None else columns)
            if c not in held and recording.has(c) and motion(recording.signal(c)) > 0.0
        ]
        if data is None or not names:
            return []
        problem = ShortFit.of(data, data.rig)
        # a rig that steps by itself gets its inputs at the beginning of a step, so that with a
        # single step a sample both holds are the same
        if isinstance(rig, StepRig) and problem.runner.stepping.substeps == 1:
            return []
        outcomes: dict[str, InputHold] = {}
        base = data.fitted(data.rig, problem=problem)
        if not np.isfinite(base.error):
            return []  # the model runs away with both holds
        # if several fit better with the other hold, the best is corrected first, and the remaining
        # inputs are compared with this correction in place
        while True:
            tried = [_compare_hold(data, base, c) for c in names if c not in outcomes]
            # a run that diverges with the other hold leaves nothing to compare
            tried = [t for t in tried if np.isfinite([t[0].rms_held, t[0].rms_linear]).all()]
            wrong = [t for t in tried if t[0].wrong]
            if len(wrong) < 2:
                outcomes |= {hold.column: hold for hold, _ in tried}
                return [outcomes[c] for c in names if c in outcomes]
            hold, base = min(wrong, key=lambda t: t[1].error)
            outcomes[hold.column] = hold
    except (PamidError, FloatingPointError, np.linalg.LinAlgError):
        return []


def misstated_holds(recording: Recording, rig: Rig) -> list[InputHold]:
    """Inputs whose hold neither the rig nor the recording states, and that fit clearly better with
    the other hold."""
    unstated = [column for column in rig.inputs if column not in rig.between]
    return [hold for hold in compare_holds(recording, rig, unstated) if hold.wrong]


def misplaced_readings(recording: Recording, rig: Rig) -> list[RowOrder]:
    """Outputs that depend on an input of the same row and only fit in another order of rows.

    The list is empty if the rig cannot run on the recording, which has a single sampling period.
    The rig has what the recording states (`as_recorded`).
    """
    if isinstance(rig, StepRig):
        return []
    try:
        data = fit_data_of(recording, rig)
        if data is None:
            return []
        # outputs that depend on an input of the same instant
        direct = {
            name
            for name, y in Assembly(rig).traced.outputs.items()
            if any(space == "input" for space, _ in symbols([y]))
        }
        if direct.isdisjoint(data.names):
            return []
        base = data.fitted(rig)
        orders = [
            _best_order(recording, data, base, k)
            for k, name in enumerate(data.names)
            if name in direct and _correlates_with_step(data, base, k)
        ]
        return [order for order in orders if order is not None]
    except (PamidError, FloatingPointError, np.linalg.LinAlgError):
        return []


def _refit(data: FitData, base: FittedWindows, column: str, way: str) -> FittedWindows:
    if way in (ROW_LATE, ROW_EARLY):
        data = data.shifted([column], -1 if way == ROW_LATE else 1)
        rig = base.rig
    else:
        rig = stated(base.rig, {column: way})
    return data.fitted(rig, base.point, stepping=base.problem.runner.stepping)


# ---- holds ---------------------------------------------------------------------------------------


def _compare_hold(
    data: FitData, base: FittedWindows, column: str
) -> tuple[InputHold, FittedWindows]:
    """Both holds of an input, each also fitted from the end point of the other, and the fit with
    the hold that is not in use; base: the fit with the hold in use."""
    assumed = between_of(base.rig, column)
    turned = _refit(data, base, column, other(assumed))
    refit = data.fitted(base.rig, turned.point, base.problem)
    best_fit = refit if refit.error < base.error else base
    # an exact fit and a fit that runs away have no logarithm
    logs = [
        np.log(np.clip(fit.point.errors.mean(axis=0), 1e-300, 1e300)) for fit in (turned, best_fit)
    ]
    shows = int(np.argmax(np.abs(logs[0] - logs[1])))
    both = {assumed: best_fit, other(assumed): turned}
    better = ""
    for way, fit in both.items():
        rest = both[other(way)]
        smaller = fit.point.errors.sum(axis=1) < rest.point.errors.sum(axis=1)
        clear = np.isfinite(fit.error) and not fit.error > BETTER * rest.error
        if clear and float(smaller.mean()) >= SURE:
            better = way
            break
    symbol = split_column(data.names[shows])[1]
    rms = {
        way: float(np.sqrt(fit.point.errors[:, shows].mean()) / data.weight[shows])
        for way, fit in both.items()
    }
    hold = InputHold(
        column=column,
        taken="held" if assumed == HELD else "linear",
        stated=column in base.rig.between,
        better=better,
        channel=data.names[shows],
        rms_held=float(size_from_si(rms[HELD], symbol)),
        rms_linear=float(size_from_si(rms[LINEAR], symbol)),
        windows=len(data.windows),
    )
    return hold, turned


# ---- order of rows -------------------------------------------------------------------------------


def _correlates_with_step(data: FitData, base: FittedWindows, channel: int) -> bool:
    """True if the residual of the channel correlates with its change to the next or from the last
    row."""
    lefts, changes = [], []
    for window, left in zip(data.windows, _left(base, channel), strict=True):
        change = np.diff(data.track.y[window.start : window.stop, channel])
        lefts.append(left[1:-1])
        changes.append(np.column_stack([change[:-1], change[1:]]))
    left, change = np.concatenate(lefts), np.concatenate(changes)
    shares = (left @ change) ** 2 / np.maximum((change**2).sum(axis=0) * (left @ left), 1e-300)
    return bool(shares.max() > SHARED_SHARE)


def _best_order(
    recording: Recording, data: FitData, base: FittedWindows, channel: int
) -> RowOrder | None:
    """Orders that explain the channel; None if none does."""
    name = data.names[channel]
    ways = (ROW_LATE, ROW_EARLY) if between_of(base.rig, name) == BEFORE else ()
    fits = {way: _refit(data, base, name, way) for way in ways or (BEFORE, ROW_LATE, ROW_EARLY)}
    errors = {order: _rms(fit, channel) for order, fit in fits.items()}
    baseline, least = _rms(base, channel), min(errors.values())
    if least >= MENDED * baseline:
        return None
    orders = [order for order in fits if errors[order] <= AS_GOOD * least]
    orders.sort(key=lambda order: fits[order].judgement.strain)
    column = match_column(recording.columns, name) or name
    symbol = split_column(column)[1]
    recorded, corrected = (float(size_from_si(e, symbol)) for e in (baseline, errors[orders[0]]))
    return RowOrder(column, tuple(orders), recorded, corrected)


def _left(fit: FittedWindows, channel: int) -> Array:
    """Residuals of the channel, windows x samples, SI; infinite if the model diverges."""
    return np.asarray(fit.point.left[:, :, channel] / fit.problem.trial.weight[channel])


def _rms(fit: FittedWindows, channel: int) -> float:
    """Root mean square error of the channel, SI.

    The first row of each window is left out, because the row before it is unknown.
    """
    return float(np.sqrt(np.mean(_left(fit, channel)[:, 1:] ** 2)))
