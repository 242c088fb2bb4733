"""Hypotheses run in sequence, where a simulator steps the rig; used as
`pamid.engine.lane_program.LaneProgram` is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.program import Memory, Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.stepped import SteppedProgram


@dataclass
class SerialMemory:
    """The memory of each lane."""

    memories: list[Memory]

    @property
    def x(self) -> Array:
        """The states (states, lanes), a copy."""
        return np.stack([memory.x for memory in self.memories], axis=1)

    def enter(self, x: Array) -> None:
        """See `LaneMemory.enter`."""
        for lane, memory in enumerate(self.memories):
            memory.x[: len(x)] = _of_lane(x, lane, 1)
            memory.join = True

    def copy(self) -> SerialMemory:
        return SerialMemory([memory.copy() for memory in self.memories])


@dataclass(frozen=True, eq=False)
class SerialLanes:
    """The lanes of a program in sequence; methods as those of `LaneProgram`."""

    program: SteppedProgram

    @property
    def states(self) -> tuple[str, ...]:
        return self.program.states

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.program.outputs

    def least_substeps(self, period_s: float) -> int:
        return self.program.least_substeps(period_s)

    def careful(self, substeps: int) -> Stepping:
        return self.program.careful(substeps)

    def exchange_matrices(
        self, memory: SerialMemory, u: Array, p: Array, *, period_s: float, time_s: float = 0.0
    ) -> Array:
        times = {"period_s": period_s, "time_s": time_s}
        return np.stack(
            [
                self.program.exchange_matrix(
                    lane_memory, _of_lane(u, lane, 1), _of_lane(p, lane, 1), **times
                )
                for lane, lane_memory in enumerate(memory.memories)
            ]
        )

    def memory(
        self, x: Array, *, stepping: Stepping | None = None, period_s: float = 1.0
    ) -> SerialMemory:
        return SerialMemory(
            [self.program.memory(start, stepping=stepping, period_s=period_s) for start in x.T]
        )

    def run(
        self,
        memory: SerialMemory,
        inputs: SampledInputs,
        p: Array,
        *,
        stepping: Stepping | None = None,
    ) -> tuple[Array, NDArray[np.int64]]:
        runs = []
        for lane, lane_memory in enumerate(memory.memories):
            after = None if inputs.after is None else _of_lane(inputs.after, lane, 1)
            given = replace(inputs, u=_of_lane(inputs.u, lane, 2), after=after)
            runs.append(
                self.program.run(lane_memory, given, _of_lane(p, lane, 1), stepping=stepping)
            )
        return np.stack([Y for Y, _, _ in runs], axis=2), np.array([bad for _, _, bad in runs])

    def run_windows(
        self,
        memory: SerialMemory,
        inputs: SampledInputs,
        p: Array,
        edges: NDArray[np.int64],
        entered: Array,
        *,
        stepping: Stepping | None = None,
        dependent: int | None = None,
    ) -> tuple[Array, Array, NDArray[np.int64]]:
        lanes = len(memory.memories)
        shared = lanes if dependent is None else dependent
        rows = int(edges[-1] - edges[0])
        Y = np.full((rows, len(self.outputs), lanes), np.nan)
        ends = np.full((len(edges) - 1, len(self.states), lanes), np.nan)
        bad = np.full(lanes, -1)
        for w, (start, stop) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
            if w:
                for lane in range(shared, lanes):
                    # A dependent lane differs by the start of a single window, so that it must not
                    # carry the difference into the next.
                    memory.memories[lane] = memory.memories[0].copy()
            memory.enter(entered[w])
            values, lost = self.run(memory, inputs.part(start, stop), p, stepping=stepping)
            well = bad < 0
            Y[start - edges[0] : stop - edges[0], :, well] = values[:, :, well]
            bad = np.where(well & (lost >= 0), start + lost, bad)
            ends[w][:, bad < 0] = memory.x[:, bad < 0]
            if (bad >= 0).all() or (bad[0] >= 0 and shared < lanes):
                break
        return Y, ends, bad


def _of_lane(values: Array, lane: int, axes: int) -> Array:
    """The values of a lane, of those with so many axes where all lanes share them."""
    return values if values.ndim == axes else values[..., lane]
