"""Whether a reading stands in the row to which it belongs.

A log that reads before it sends, or that writes a value one loop later, moves a reading by a row.
It shows in an output that depends on an input of the same instant, as a current on the voltage: a
delay of one sampling period there is the log, not the machine.

    before      the row's reading was taken before its command was sent
    late        the row holds the reading of the row before
    early       the row holds the reading of the next row

Each of them is judged by a short fit (`short_fit`): it is named where the error of the channel
falls to MENDED of the error as recorded. The fits are only done where what the fit as recorded
leaves goes along with the change of the reading from row to row. A linear machine under a held
input reads alike before and late, with slightly other parameters: then both are named.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import PamidError
from pamid.base.units import NONE, size_from_si, split_column
from pamid.checks.short_fit import FitData, FittedWindows, fit_data_of
from pamid.model.assembly import Assembly
from pamid.model.between_samples import between_of, stated
from pamid.model.rig import Rig
from pamid.model.step_rig import StepRig
from pamid.recording.file_checks import BEFORE
from pamid.recording.recording import Recording, match_column
from pamid.symbolic.expression import symbols

Array = NDArray[np.float64]

ROW_LATE, ROW_EARLY = "late", "early"
OF_THE_LOG = "this is the log, not the machine"
WHERE = {
    BEFORE: "was read before the command of its row was sent",
    ROW_LATE: "stands one row late (each row holds the reading of the row before)",
    ROW_EARLY: "stands one row early (each row holds the reading of the next one)",
}
# of the error as recorded: an order that explains it
MENDED = 0.3
AS_GOOD = 1.1  # times the least error: explains it as well
SHARED_SHARE = 0.5  # share of the squared residual that goes along with the change from row to row


@dataclass(frozen=True)
class RowOrder:
    """An output in another order than that of its rows.

    column              as recorded
    orders              "before", "late" or "early"; of several that explain it alike, first the one
                        that bends the data sheet least
    as_recorded, mended root mean square error of the short fit, in the unit of the column
    """

    column: str
    orders: tuple[str, ...]
    as_recorded: float
    mended: float

    def text(self, recording: Recording) -> str:
        """The order, its evidence and the cure."""
        symbol = split_column(self.column)[1]
        unit = "" if symbol == NONE else f" {symbol}"
        where = " or ".join(WHERE[order] for order in self.orders)
        cures = "; or ".join(self._cure(order, recording) for order in self.orders)
        return (
            f"{self.column} {where}. So read, the rig explains it to {self.mended:.3g}{unit} RMS, "
            f"as recorded to {self.as_recorded:.3g}: {OF_THE_LOG}. Cure: {cures}."
        )

    def _cure(self, order: str, recording: Recording) -> str:
        if order == BEFORE:
            return (
                f'[between] {self.column} = "before" in '
                f"{recording.path.with_suffix('.toml').name}, or between = "
                f'{{"{self.column}": "before"}} in the rig file'
            )
        rows = 1 if order == ROW_LATE else -1
        return f"rows = {rows} below [signals.{self.column}] in the mapping of `pamid ingest`"


def misplaced_readings(recording: Recording, rig: Rig) -> list[RowOrder]:
    """The outputs that depend on an input of the same row and are explained in another order of
    rows alone; none where the rig cannot be run on the recording.

    Parameters
    ----------
    recording
        Recording, of one sampling period.
    rig
        Rig, with what the recording states (`as_recorded`).
    """
    if isinstance(rig, StepRig):
        return []
    try:
        data = fit_data_of(recording, rig)
        direct = set() if data is None else direct_outputs(rig)
        if data is None or not direct & set(data.names):
            return []
        base = data.fitted(rig)
        return [
            order
            for k, name in enumerate(data.names)
            if name in direct and _goes_along(data, base, k)
            for order in _best_order(recording, data, base, k)
        ]
    except (PamidError, FloatingPointError, np.linalg.LinAlgError):
        return []


def direct_outputs(rig: Rig) -> set[str]:
    """Outputs that depend on an input of the same instant."""
    outputs = Assembly(rig).traced.outputs
    return {
        name
        for name, value in outputs.items()
        if any(space == "input" for space, _ in symbols([value]))
    }


def _goes_along(data: FitData, base: FittedWindows, channel: int) -> bool:
    """Does what is left of the channel go along with its change to the next row, or from the one
    before?"""
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
) -> Iterator[RowOrder]:
    """The orders that explain the channel, if one does."""
    fits = dict(_orders(data, base, channel))
    errors = {order: _rms(fit, channel) for order, fit in fits.items()}
    baseline, least = _rms(base, channel), min(errors.values())
    if least >= MENDED * baseline:
        return
    alike = [order for order in fits if errors[order] <= AS_GOOD * least]
    alike.sort(key=lambda order: fits[order].strain)
    column = match_column(recording.columns, data.names[channel]) or data.names[channel]
    symbol = split_column(column)[1]
    recorded, mended = (float(size_from_si(e, symbol)) for e in (baseline, errors[alike[0]]))
    yield RowOrder(column, tuple(alike), recorded, mended)


def _orders(
    data: FitData, base: FittedWindows, channel: int
) -> Iterator[tuple[str, FittedWindows]]:
    """A fit with the channel in every other order."""
    rig, stepping, y = base.rig, base.problem.runner.stepping, data.track.y[:, channel]
    name = data.names[channel]
    if between_of(rig, name) != BEFORE:
        turned = stated(rig, {name: BEFORE})
        yield BEFORE, data.fitted(turned, base.point, stepping=stepping)
    for order, values in ((ROW_LATE, [*y[1:], y[-1]]), (ROW_EARLY, [y[0], *y[:-1]])):
        table = data.track.y.copy()
        table[:, channel] = values
        moved = replace(data, track=replace(data.track, y=table))
        yield order, moved.fitted(rig, base.point, stepping=stepping)


def _left(fit: FittedWindows, channel: int) -> Array:
    """Residuals of the channel, windows x samples, SI; infinite where the model runs away."""
    left = fit.problem.residuals(fit.point)[:, :, channel]
    return np.where(np.isnan(left), np.inf, left)


def _rms(fit: FittedWindows, channel: int) -> float:
    """Root mean square error of the channel, SI, without the first row of each window: there the
    row before is not known."""
    return float(np.sqrt(np.mean(_left(fit, channel)[:, 1:] ** 2)))
