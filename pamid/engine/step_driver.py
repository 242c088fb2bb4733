"""A run of compiled equations in single steps, between which states may be set from outside."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pamid.engine.integrator import CompiledEquations, Inputs, MemoryArrays, Results

Array = NDArray[np.float64]


class Division(Protocol):
    """Division of a sample into steps: `pamid.engine.program.Stepping`."""

    @property
    def substeps(self) -> int: ...
    @property
    def implicit(self) -> bool: ...


@dataclass(frozen=True, eq=False)
class StepDriver:
    """A run in single steps. What it works on stands in `arrays`: states may be set between two
    steps, and their rows of S with them."""

    equations: CompiledEquations = field(repr=False)
    arrays: MemoryArrays
    inputs: Inputs
    results: Results

    def step(
        self, k: int, sub: int, times: tuple[float, float, Division], begin: bool, join: bool
    ) -> tuple[Array, Array]:
        """Step `sub` of sample k; the outputs at its start (outputs,) and their sensitivities
        (outputs, columns). times: of the first sample, s; of a sample, s; how it is divided."""
        from pamid.engine.integrator import Times, sweep

        time_s, period_s, step = times
        sweep(
            self.equations,
            self.arrays,
            self.inputs._replace(u=self.inputs.u[k : k + 1]),
            Times(
                float(time_s + k * period_s),
                float(period_s),
                step.substeps,
                step.implicit,
                begin,
                join,
                sub,
            ),
            self.results,
        )
        return self.results.Y[0], self.results.JY[0]
