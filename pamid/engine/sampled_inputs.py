"""Sampled inputs of a simulation."""

from __future__ import annotations

from dataclasses import dataclass

from pamid.base.arrays import Array


@dataclass(frozen=True, eq=False)
class SampledInputs:
    """Inputs at every sampling time.

    u: samples x inputs; of lanes, samples x inputs x lanes where these differ. Additional columns,
    if any, hold the rise of each linear input over the sample. period_s: sampling period; time_s:
    time of the first sample; after: inputs of the sample after the last row, where linear inputs
    end. Without it the last row is held.
    """

    u: Array
    period_s: float
    time_s: float = 0.0
    after: Array | None = None

    def __len__(self) -> int:
        return len(self.u)

    def part(self, start: int, stop: int) -> SampledInputs:
        """The rows from start to stop - 1."""
        after = self.u[stop] if stop < len(self.u) else self.after
        time_s = self.time_s + start * self.period_s
        return SampledInputs(self.u[start:stop], self.period_s, time_s, after)
