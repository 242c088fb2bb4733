"""Equations run for several hypotheses side by side: other parameters or start states in each lane,
the same inputs.

Eight lanes take little longer than a single run of `pamid.engine.program.Program` without
sensitivities (`benchmarks/lanes.py`). Any number of lanes may be given; they run in groups of
eight, the last of which is filled up.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.llvm_ir import LANES, extract_derived, with_partials
from pamid.engine.program import (
    EquationSteps,
    Layout,
    Stepping,
    cell_phases,
    line_length,
    with_rises,
)
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.symbolic.expression import plain
from pamid.engine.symbolic.memory_cells import StateEquations

if TYPE_CHECKING:  # numba is loaded when a model is compiled, not with the package
    from pamid.engine.lane_sweep import LaneArrays, LaneEquations, LaneScratch


@dataclass
class LaneMemory:
    """Everything that the lanes carry between runs.

    Arrays stand in groups of LANES lanes: states (groups, states, LANES), cells and past (groups,
    cells, LANES), buffers (groups, delays, length, LANES), heads (groups, delays); lanes: how many
    are in use; begin until the first run; join: the state was set anew since the last run.
    """

    states: Array
    cells: Array
    past: Array
    buffers: Array
    heads: NDArray[np.int64]
    lanes: int
    begin: bool = True
    join: bool = False

    @property
    def x(self) -> Array:
        """The states (states, lanes), a copy."""
        return _joined_lanes(self.states.transpose(1, 0, 2), self.lanes)

    def enter(self, x: Array) -> None:
        """Set the first states anew: x (n, lanes), or (n,) for all lanes."""
        self.states[:, : len(x)] = _grouped(_per_lane(x, self.lanes)).transpose(1, 0, 2)
        self.join = True

    def arrays(self) -> LaneArrays:
        from pamid.engine.lane_sweep import LaneArrays

        return LaneArrays(self.states, self.cells, self.past, self.buffers, self.heads)

    def copy(self) -> LaneMemory:
        states, cells, past, buffers, heads = (array.copy() for array in self.arrays())
        return LaneMemory(states, cells, past, buffers, heads, self.lanes, self.begin, self.join)


@dataclass(frozen=True, eq=False)
class LaneProgram(EquationSteps):
    """Equations without sensitivities, compiled when they are first run. `states`, `inputs`,
    `parameters`, `outputs` give the order of every array, as in `Program`; linear: names of the
    inputs that are linear over a sample."""

    equations: StateEquations
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    linear: tuple[str, ...]

    @property
    def states(self) -> tuple[str, ...]:
        return self.equations.states

    @cached_property
    def delays(self) -> tuple[float, ...]:
        return tuple(cell_phases(self.equations)[4])

    def memory(
        self, x: Array, *, stepping: Stepping | None = None, period_s: float = 1.0
    ) -> LaneMemory:
        """Fresh memory at states x (states, lanes)."""
        states = np.ascontiguousarray(_grouped(np.asarray(x, float)).transpose(1, 0, 2))
        groups, nc, nd = len(states), len(self.equations.cells), len(self.delays)
        size = line_length(self.delays, stepping, period_s)
        return LaneMemory(
            states,
            np.zeros((groups, nc, LANES)),
            np.zeros((groups, nc, LANES)),
            np.zeros((groups, nd, size, LANES)),
            np.zeros((groups, nd), np.int64),
            x.shape[1],
        )

    def run(
        self,
        memory: LaneMemory,
        inputs: SampledInputs,
        p: Array,
        *,
        stepping: Stepping | None = None,
    ) -> tuple[Array, NDArray[np.int64]]:
        """Simulate over the rows of the inputs in all lanes, carrying `memory` on.

        inputs: (samples, inputs), shared by the lanes, or (samples, inputs, lanes); p: (parameters,
        lanes), or (parameters,) for all lanes. Returns outputs (samples, outputs, lanes), NaN in a
        lane behind the sample at which its state blew up, and these samples (lanes,), -1 where none
        is.
        """
        nothing = np.empty((1, 0, memory.lanes))
        edges = np.array([0, len(inputs)])
        Y, _, bad = self._run(memory, inputs, p, edges, nothing, stepping)
        return Y, bad

    def run_windows(
        self,
        memory: LaneMemory,
        inputs: SampledInputs,
        p: Array,
        edges: NDArray[np.int64],
        entered: Array,
        *,
        stepping: Stepping | None = None,
        dependent: int | None = None,
    ) -> tuple[Array, Array, NDArray[np.int64]]:
        """Simulate window after window, setting the first states anew at the start of each.

        Parameters
        ----------
        inputs : (samples, inputs) or (samples, inputs, lanes) of the whole track
        p : (parameters, lanes), or (parameters,) for all lanes
        edges : (windows + 1,) rows at which windows start, and the end of the last window
        entered : (windows, n, lanes) values of the first n states at the start of each window
        dependent : first lane that differs from lane 0 by the start of a single window: what lies
            behind the first n states (other states, cells, delay lines) is taken over from lane 0
            at each start. None: every lane carries its memory from window to window.

        Returns
        -------
        outputs (rows between the first and the last edge, outputs, lanes) and the state at the end
        of each window (windows, states, lanes), NaN in a lane that has blown up; for each lane the
        row at which it did, -1 where none is. Where lane 0 blows up and others depend on it, all
        end with its window.
        """
        memory.join = True
        edges = np.asarray(edges)
        return self._run(memory, inputs, p, edges, entered, stepping, dependent)

    def exchange_matrices(
        self, memory: LaneMemory, u: Array, p: Array, *, period_s: float, time_s: float = 0.0
    ) -> Array:
        """df/dx (lanes, states, states) where `memory` stands, at the inputs u (inputs,) or
        (inputs, lanes), by which the length of a step is chosen."""
        from pamid.engine.lane_sweep import LaneInputs, LaneTimes, rate_matrices

        code = _compiled(self, True, u.ndim == 1)
        matrices = rate_matrices(
            code.equations,
            memory.arrays(),
            LaneInputs(self._by_group(u[None], None, 0), self._prepared(code, p, memory)),
            LaneTimes(float(time_s), float(period_s), 1, True, False, False),
            self._scratch(code),
        )
        return _joined_lanes(matrices, memory.lanes).transpose(2, 0, 1)

    def _scratch(self, code: _LaneCode) -> LaneScratch:
        from pamid.engine.lane_sweep import lane_scratch

        cells = len(self.equations.cells)
        return lane_scratch(code.equations, len(self.states), len(self.outputs), cells)

    def _run(
        self,
        memory: LaneMemory,
        inputs: SampledInputs,
        p: Array,
        edges: NDArray[np.int64],
        entered: Array,
        stepping: Stepping | None,
        dependent: int | None = None,
    ) -> tuple[Array, Array, NDArray[np.int64]]:
        from pamid.engine.lane_sweep import (
            LaneInputs,
            LaneResults,
            LaneTimes,
            LaneWindows,
            sweep_lanes,
        )

        step = stepping or Stepping()
        groups, windows, first = len(memory.states), len(edges) - 1, int(edges[0])
        all_lanes = groups * LANES
        code = _compiled(self, step.implicit, inputs.u.ndim == 2)
        results = LaneResults(
            np.empty((int(edges[-1]) - first, len(self.outputs), groups, LANES)),
            np.empty((windows, len(self.states), groups, LANES)),
            np.full((groups, LANES), -1),
        )
        sweep_lanes(
            code.equations,
            memory.arrays(),
            LaneInputs(
                self._by_group(inputs.u, inputs.after, first), self._prepared(code, p, memory)
            ),
            LaneTimes(
                float(inputs.time_s) + first * float(inputs.period_s),
                float(inputs.period_s),
                step.substeps,
                step.implicit,
                memory.begin,
                memory.join,
            ),
            LaneWindows(
                edges - first,
                _grouped(entered),
                all_lanes if dependent is None or dependent >= memory.lanes else dependent,
            ),
            results,
            self._scratch(code),
        )
        memory.begin = memory.join = False
        # Filling lanes run as copies of lane 0, so that they can neither blow up alone nor be
        # read.
        Y, ends, bad = (_joined_lanes(array, memory.lanes) for array in results)
        return Y, ends, np.where(bad < 0, bad, bad + first)

    def _by_group(self, u: Array, after: Array | None, first: int) -> Array:
        """The inputs as `LaneInputs` has them, from a row on, followed by the rises of the linear
        ones."""
        linear = tuple(self.inputs.index(n) for n in self.linear)
        rising = with_rises(u, after, linear, len(self.inputs))[first:]
        if u.ndim == 2:
            return np.ascontiguousarray(rising[None])
        groups = _grouped(rising).transpose(2, 0, 1, 3)
        return np.ascontiguousarray(groups.reshape(*groups.shape[:2], -1))

    def _prepared(self, code: _LaneCode, p: Array, memory: LaneMemory) -> Array:
        """Parameters (groups, parameters, LANES), followed by the values that depend on them
        alone."""
        from pamid.engine.lane_sweep import prepare_lanes

        known = len(self.parameters)
        values = np.empty((len(memory.states), known + code.derived, LANES))
        values[:, :known] = _grouped(_per_lane(p, memory.lanes)).transpose(1, 0, 2)
        prepare_lanes(code.prepare, values, known)
        return values


def _per_lane(values: Array, lanes: int) -> Array:
    """values (n, lanes), where they are not given by lane the same in each."""
    values = np.asarray(values, float)
    return values if values.ndim > 1 else np.repeat(values[:, None], lanes, axis=1)


def _grouped(values: Array) -> Array:
    """values (..., lanes) as (..., groups, LANES), the last group filled up with copies of lane
    0."""
    lanes = values.shape[-1]
    filling = np.repeat(values[..., :1], -lanes % LANES, axis=-1)
    groups = -(-lanes // LANES)
    return np.concatenate([values, filling], axis=-1).reshape(*values.shape[:-1], groups, LANES)


def _joined_lanes(values: NDArray[Any], lanes: int) -> NDArray[Any]:
    """values (..., groups, LANES) as (..., lanes)."""
    groups, width = values.shape[-2:]
    return values.reshape(*values.shape[:-2], groups * width)[..., :lanes]


@dataclass(frozen=True)
class _LaneCode:
    """Compiled equations, the address of the function that fills the derived parameters, and their
    number."""

    equations: LaneEquations
    prepare: int
    derived: int


@lru_cache(maxsize=256)
def _compiled(program: LaneProgram, implicit: bool, shared: bool) -> _LaneCode:
    """implicit: with the partials that implicit steps want; shared: all lanes have the same
    inputs."""
    # LLVM is loaded when a model is compiled, not with the package
    from pamid.engine.jit_cache import addresses
    from pamid.engine.lane_ir import lane_module_text
    from pamid.engine.lane_sweep import LaneEquations

    equations, nx = program.equations, len(program.states)
    phases, phase_n, phase_first, phase_delay, _ = cell_phases(equations)
    layout = Layout.of(equations, program.inputs, program.parameters, program.linear)
    groups = [plain(group) for group in ([*equations.rates], [*equations.outputs], *phases)]
    pointer, columns = [0] * (nx + 1), list[int]()
    if implicit:
        values, pointer, columns = with_partials(
            [*equations.rates], layout.column, frozenset(), spaces=("state",)
        )
        groups.append(values)
    # Expressions of parameters alone are computed once per run, not at every stage of every step.
    groups, derived = extract_derived(groups)
    layout = layout.with_derived(len(derived))
    functions = {f"v{i}": group for i, group in enumerate(groups)} | {"prepare": derived}
    *address, prepare = addresses(
        lane_module_text(
            functions, layout.index, ("input", "rise", "tick") if shared else ("tick",)
        ),
        list(functions),
    )
    tables = (address, phase_n, phase_first, phase_delay, pointer, columns)
    return _LaneCode(
        LaneEquations(*(np.array(table, np.int64) for table in tables)), prepare, len(derived)
    )


@lru_cache(maxsize=256)
def build_lane_program(
    equations: StateEquations,
    inputs: tuple[str, ...],
    parameters: tuple[str, ...],
    outputs: tuple[str, ...],
    linear: tuple[str, ...] = (),
) -> LaneProgram:
    """The program of these equations, only once in each process; the arguments are those of
    `pamid.engine.program.build_program`."""
    return LaneProgram(equations, inputs, parameters, outputs, linear)
