"""Kinds of logs, and channels from the arrays of a reader: numbers become float64, times become
seconds, and notes list everything else."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.errors import FileError, listed
from pamid.base.files import size_words
from pamid.intake.logs.channels import Channel, Log, RobotValue
from pamid.intake.logs.memory_budget import FLOAT, MemoryBudget
from pamid.intake.logs.stated_period import StatedPeriod

#: larger integers have no exact float64
EXACT_INTEGERS = 2**53
#: most columns of a group of signals; a wider array is an image or a Jacobian
MAX_COLUMNS = 64
EXAMINED = 24  # temporary bytes per value while its channel is examined: differences, a sorted copy
#: integers in this span count ns since 1970, from 2001 to 2100
SINCE_1970_NS = (10**18, 41 * 10**17)
#: names that a note lists
MOST_NAMED = 100


class ChannelBuilder:
    """Collector for the channels of the file at `path`; `log` builds the result.

    budget: memory for the channels, which readers charge before they allocate. stated: sampling
    period that the text around the numbers states.
    """

    def __init__(self, path: Path, budget: MemoryBudget | None = None) -> None:
        self.path, self.budget = path, budget or MemoryBudget(path)
        self.stated: StatedPeriod | None = None
        self.channels: list[Channel] = []
        self.notes: list[str] = []
        self.left_out: dict[str, list[str]] = {}

    def add(
        self,
        name: str,
        values: Any,
        stamps: Array | None = None,
        unit: str = "",
        robot: RobotValue | None = None,
    ) -> None:
        """Add an array of numbers, booleans, dates or durations.

        An array (n,) is a channel. An array (n, m) or (m, n), with n samples along the longer
        axis (that of the stamps), becomes name/1 ... name/m. Other arrays are listed as left out.
        robot: role of the channel in a robot's log.
        """
        array = np.asarray(values)
        if array.ndim > 1:
            array = array.squeeze()
        if array.ndim == 2 and array.shape[0] != (
            max(array.shape) if stamps is None else stamps.size
        ):
            array = array.T
        if array.ndim == 2 and 1 < array.shape[1] <= MAX_COLUMNS:
            self.note(f"{name}: {array.shape[1]} columns, {name}/1 to {name}/{array.shape[1]}")
            for column in range(array.shape[1]):
                self.add(f"{name}/{column + 1}", array[:, column], stamps, unit)
            return
        if array.ndim != 1:
            if array.size == 1 and array.dtype.kind in "biuf":  # a setting, perhaps the period
                self.leave_out(f"{name} = {float(array):.6g}", "a single number")
            else:
                self.leave_out(name, f"of shape {array.shape}")
            return
        if array.size < 2:
            self.leave_out(name, "fewer than two values")
            return
        if stamps is not None and stamps.size != array.size:
            self.leave_out(name, "different numbers of values and stamps")
            return
        parsed = as_numbers(array)
        if parsed is None:
            self.leave_out(name, "not numbers")
            return
        numbers, seconds, note = parsed
        if note:
            self.note(f"{name}: {note}")
        if (
            not unit
            and array.dtype.kind in "iu"
            and SINCE_1970_NS[0] <= int(array[0]) <= SINCE_1970_NS[1]
        ):
            unit = "ns"
        self.channels.append(Channel(name, numbers, stamps, "s" if seconds else unit, robot))

    def reserve(self, name: str, shape: Sequence[int], item_bytes: int) -> bool:
        """Charge the budget for an array of this shape before it is read.

        Returns False, and leaves the array out, if it is too wide for a group of signals (an image
        then costs no memory) or exceeds the whole budget alone. item_bytes: of a value in the
        file. FileError if the sum of all arrays exceeds the budget.
        """
        lengths = [int(length) for length in shape if length != 1]
        if len(lengths) > 2 or len(lengths) == 2 and min(lengths) > MAX_COLUMNS:
            self.leave_out(name, f"of shape {tuple(lengths)}")
            return False
        values = math.prod(lengths)
        raw = values * (item_bytes + EXAMINED)
        if FLOAT * values + raw > self.budget.limit:
            limit = size_words(self.budget.limit)
            self.leave_out(name, f"larger than the memory limit of {limit} (--memory-limit)")
            return False
        self.budget.charge(name, values, raw=raw)
        return True

    def note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    def leave_out(self, name: str, why: str) -> None:
        """Record that `name` is in the file but not in the log."""
        names = self.left_out.setdefault(why, [])
        if name not in names:
            names.append(name)

    def log(self, kind: str) -> Log:
        """Log of the gathered channels, with unique names. FileError if there is no channel."""
        left = [
            f"left out, {why}: {listed(names, MOST_NAMED)}" for why, names in self.left_out.items()
        ]
        if not self.channels:
            contents = "; ".join([*left, *self.notes]) or "it is empty"
            message = f"{self.path}: there are no signals in it ({contents})."
            raise FileError(message, code="no-signals")
        seen, channels = Counter[str](), []
        for channel in self.channels:
            seen[channel.name] += 1
            if (count := seen[channel.name]) > 1:
                channel = replace(channel, name=f"{channel.name} ({count})")
            channels.append(channel)
        details = (*self.notes, *left)
        return Log(self.path, kind, tuple(channels), details, stated=self.stated)


@dataclass(frozen=True)
class Kind:
    """A kind of log.

    read       enters the channels of the builder's file
    marks      first bytes of such a file, none for plain text
    extra      extra of pamid to install for it, "" if none
    packages   packages of the extra, which `read` imports when it is called
    """

    name: str
    suffixes: tuple[str, ...]
    read: Callable[[ChannelBuilder], None]
    marks: tuple[bytes, ...] = ()
    extra: str = ""
    packages: tuple[str, ...] = ()


def as_numbers(array: NDArray[Any]) -> tuple[Array, bool, str] | None:
    """(n,) values as float64, whether they are now seconds, and a note; None unless they are
    numbers.

    Dates become s since the first date, durations become s. Integers that float64 cannot represent
    (counters of ns) are counted from the first value, so that their differences stay exact.
    """
    if array.dtype.kind == "M":
        ticks = array.astype("datetime64[ns]")
        missing = np.isnat(ticks)
        if missing.all():
            return None
        first = ticks[~missing][0]
        seconds = (ticks - first).astype(np.int64) / 1e9
        return (
            np.where(missing, np.nan, seconds),
            True,
            f"dates, in s since {np.datetime_as_string(first)}",
        )
    if array.dtype.kind == "m":
        spans = array.astype("timedelta64[ns]")
        return np.where(np.isnat(spans), np.nan, spans.astype(np.int64) / 1e9), True, ""
    if array.dtype.kind not in "biuf":
        return None
    if array.dtype.kind in "iu" and (
        int(array.max()) > EXACT_INTEGERS or int(array.min()) < -EXACT_INTEGERS
    ):
        first = int(array[0])
        numbers = np.array([int(value) - first for value in array.tolist()], dtype=np.float64)
        return numbers, False, f"whole numbers beyond float64, counted from the first, {first}"
    return np.ascontiguousarray(array, dtype=np.float64), False, ""
