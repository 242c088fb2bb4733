"""The time stamps of a recording: are they uniform, and what is the sampling period?"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pamid.errors import FileError

UNIFORM_TO = 0.01
_INGEST = "Record with a fixed sampling period, or repair the time base before using the file."


def sampling_period(
    path: Path, time: NDArray[np.float64], stated_s: float | None, line_of: Callable[[int], int]
) -> float:
    """Return the sampling period in s of stamps of shape (samples,).

    `stated_s` is the period the TOML file states, None if it does not; `line_of` gives the line of the file that holds
    a sample, for messages. FileError where stamps repeat, go back, leave a gap, are not uniform to 1 % or contradict
    the stated period.
    """
    steps = np.diff(time)
    period = float(np.median(steps))
    _refuse_order(path, time, steps, line_of)
    _refuse_uneven(path, steps, period, line_of)
    mean = float((time[-1] - time[0]) / steps.size)
    if stated_s is None:
        return float(f"{mean:.6g}")
    if abs(mean / stated_s - 1.0) > UNIFORM_TO:
        message = f"{path}: the stamps are {mean:.6g} s apart, but the TOML file says sampling_period_s = {stated_s:g}."
        raise FileError(message, "Correct one of them.")
    # The stated period carries no rounding of the stamps; a clock that really differs is read from the stamps.
    return stated_s if abs(mean / stated_s - 1.0) < 1e-4 else float(f"{mean:.6g}")


def _refuse_order(
    path: Path, time: NDArray[np.float64], steps: NDArray[np.float64], line_of: Callable[[int], int]
) -> None:
    wrong = np.flatnonzero(steps <= 0.0)
    if not wrong.size:
        return
    index = int(wrong[0]) + 1
    where = f"{path}: line {line_of(index)}, column 'time_s'"
    if steps[index - 1] == 0.0:
        raise FileError(f"{where}: the stamp {time[index]:.9g} s is repeated.", "Remove the doubled sample. " + _INGEST)
    message = f"{where}: the stamp {time[index]:.9g} s is earlier than the one before, {time[index - 1]:.9g} s."
    raise FileError(message, "Sort the samples by time. " + _INGEST)


def _refuse_uneven(path: Path, steps: NDArray[np.float64], period: float, line_of: Callable[[int], int]) -> None:
    wrong = np.flatnonzero(np.abs(steps - period) > UNIFORM_TO * period)
    if not wrong.size:
        return
    index = int(wrong[0])
    where = f"{path}: line {line_of(index + 1)}, column 'time_s'"
    if steps[index] > 1.5 * period:
        message = f"{where}: a gap of {steps[index]:.6g} s where samples are {period:.6g} s apart."
        raise FileError(message, "Cut the recording there into two. " + _INGEST)
    share = 100.0 * wrong.size / steps.size
    message = f"{where}: the stamps are not uniform to 1 %: a step of {steps[index]:.6g} s, usually {period:.6g} s"
    raise FileError(f"{message} ({share:.2g} % of the steps).", _INGEST)
