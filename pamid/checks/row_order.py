"""Readings that stand in another row than their command.

A log that reads before it sends moves a reading by a row; so does one that writes a value one loop
later. It shows in an output that depends on an input of the same instant, for example a current on
the voltage. A delay of one sampling period there comes from the log, not from the machine.

    before      the row's reading was taken before its command was sent
    late        the row holds the reading of the row before
    early       the row holds the reading of the next row

Each of them is judged by a short fit (`short_fit`). It is reported if the error of the channel
falls to MENDED of the error as recorded. The fits are only done if the residual of the fit as
recorded correlates with the change of the reading from row to row. A linear machine under a held
input reads the same before and late, with slightly other parameters: then both are reported.
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
# share of the error as recorded, below which another order explains it
MENDED = 0.3
AS_GOOD = 1.1  # times the smallest error: an equal explanation
SHARED_SHARE = 0.5  # share of the squared residual that correlates with the change from row to row


@dataclass(frozen=True)
class RowOrder:
    """Output in another order than that of its rows.

    column              as recorded
    orders              "before", "late" or "early"; of several equal explanations, first the one
                        with the smallest changes of the data sheet
    as_recorded, corrected root mean square error of the short fit, in the unit of the column
    """

    column: str
    orders: tuple[str, ...]
    as_recorded: float
    corrected: float

    def text(self, recording: Recording) -> str:
        """Order, evidence and remedy."""
        symbol = split_column(self.column)[1]
        unit = "" if symbol == NONE else f" {symbol}"
        where = " or ".join(WHERE[order] for order in self.orders)
        cures = "; or ".join(self._cure(order, recording) for order in self.orders)
        return (
            f"{self.column} {where}. In that order the error of the rig is "
            f"{self.corrected:.3g}{unit} RMS, as recorded "
            f"{self.as_recorded:.3g}: {OF_THE_LOG}. Remedy: {cures}."
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
    """Outputs that depend on an input of the same row and only fit in another order of rows.

    The list is empty if the rig cannot run on the recording.

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
            if name in direct and _correlates_with_step(data, base, k)
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
) -> Iterator[RowOrder]:
    """Orders that explain the channel; empty if none does."""
    fits = dict(_orders(data, base, channel))
    errors = {order: _rms(fit, channel) for order, fit in fits.items()}
    baseline, least = _rms(base, channel), min(errors.values())
    if least >= MENDED * baseline:
        return
    orders = [order for order in fits if errors[order] <= AS_GOOD * least]
    orders.sort(key=lambda order: fits[order].strain)
    column = match_column(recording.columns, data.names[channel]) or data.names[channel]
    symbol = split_column(column)[1]
    recorded, corrected = (float(size_from_si(e, symbol)) for e in (baseline, errors[orders[0]]))
    yield RowOrder(column, tuple(orders), recorded, corrected)


def _orders(
    data: FitData, base: FittedWindows, channel: int
) -> Iterator[tuple[str, FittedWindows]]:
    """Fit the channel in every other order."""
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
    """Residuals of the channel, windows x samples, SI; infinite if the model diverges."""
    left = fit.problem.residuals(fit.point)[:, :, channel]
    return np.where(np.isnan(left), np.inf, left)


def _rms(fit: FittedWindows, channel: int) -> float:
    """Root mean square error of the channel, SI.

    The first row of each window is left out, because the row before it is unknown.
    """
    return float(np.sqrt(np.mean(_left(fit, channel)[:, 1:] ** 2)))
