"""Scaling of signals into [-1, 1], the range tanh networks are trained in."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pamid.base.arrays import Array
from pamid.base.errors import DataError


@dataclass(frozen=True)
class Scaling:
    """Columns mapped linearly so that `low` becomes -1 and `high` becomes 1; values outside go
    beyond, unclipped.

    `low` and `high` hold a number per column, in the column's unit.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.low) != len(self.high) or not self.low:
            raise DataError(
                f"A scaling needs as many lows as highs, and not none: {self.low} and {self.high}."
            )
        ordered = all(a < b for a, b in zip(self.low, self.high, strict=True))
        if not ordered or not all(np.isfinite([*self.low, *self.high])):
            raise DataError(
                f"A scaling needs finite lows below its highs, not {self.low} and {self.high}."
            )

    def forward(self, values: ArrayLike) -> Array:
        """(N, columns), or (N,) for a single column, in its units -> the same shape in [-1, 1]."""
        low, high = np.array(self.low), np.array(self.high)
        return 2.0 * (np.asarray(values, dtype=np.float64) - low) / (high - low) - 1.0

    def backward(self, scaled: ArrayLike) -> Array:
        """The inverse of `forward`."""
        low, high = np.array(self.low), np.array(self.high)
        return low + 0.5 * (np.asarray(scaled, dtype=np.float64) + 1.0) * (high - low)


def scaling_of(values: ArrayLike, names: Sequence[str]) -> Scaling:
    """The scaling that just spans the data, (N, len(names)) or (N,) with a single name.

    DataError names the column that is constant, or the row and column of a value that is not
    finite.
    """
    table = np.asarray(values, dtype=np.float64).reshape(-1, len(names))
    check_finite(table, names)
    low, high = table.min(axis=0), table.max(axis=0)
    for name, a, b in zip(names, low, high, strict=True):
        # A span of rounding errors would be blown up to the full range and trained on.
        if b - a <= 1e-12 * max(abs(a), abs(b)):
            raise DataError(
                f"Column {name!r} is constant ({a:g}) and cannot be scaled into [-1, 1].",
                "Leave it out, or excite it in the recording.",
            )
    return Scaling(tuple(low.tolist()), tuple(high.tolist()))


def check_finite(table: Array, names: Sequence[str]) -> None:
    """DataError with row (counted from 0) and column of the first NaN or infinity in `table` (N,
    len(names))."""
    bad = np.argwhere(~np.isfinite(table))
    if len(bad):
        row, column = bad[0]
        more = f" ({len(bad)} such values in all)" if len(bad) > 1 else ""
        raise DataError(
            f"Row {row}, column {names[column]!r} is {table[row, column]}{more}.",
            "Repair or leave out that stretch first.",
        )
