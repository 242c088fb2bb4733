"""Compiled equations of a model: machine code, sparsity, and simulation over recorded inputs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.known_slopes import KnownSlopes
from pamid.engine.llvm_ir import (
    LANES,
    declarations,
    extract_derived,
    function_text,
    part_of,
    product_text,
    with_partials,
)
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.symbolic.expression import plain
from pamid.engine.symbolic.memory_cells import TICKS, StateEquations, cell_update
from pamid.engine.symbolic.vocabulary import Expr, expression

if TYPE_CHECKING:  # numba is loaded when a model is compiled, not with the package
    from pamid.engine.integrator import CompiledEquations, Inputs, MemoryArrays, Results


# floats in the sensitivities of a block of windows: 1 MiB, which stays in the cache
BLOCK_NUMBERS = 2**17


@dataclass
class Memory:
    """State of a simulation between two calls: states, cells, delay lines and their sensitivities.

    x (nx): states; cells, past (nc): values of the cells now and a step before; S (nx + 2 nc,
    columns): sensitivities of x, cells and past; buffers (delays, length), buffer_S (delays,
    length, columns), heads (delays): delay lines, their sensitivities and their newest entries.
    """

    x: Array
    cells: Array
    past: Array
    S: Array
    buffers: Array
    buffer_S: Array
    heads: NDArray[np.int64]
    begin: bool = True  # before the first run
    join: bool = False  # the state was reset after the last run
    # snapshots of a simulator that hides its states: of the nominal run, and by column of each
    # perturbed copy
    saved: tuple[Any, dict[int, Any]] | None = None

    def arrays(self, *, sensitive: bool = True) -> MemoryArrays:
        """Return the arrays of this memory; without sensitivity columns if `sensitive` is False."""
        from pamid.engine.integrator import MemoryArrays

        S, buffer_S = self.S, self.buffer_S
        if not sensitive:
            S, buffer_S = S[:, :0].copy(), buffer_S[:, :, :0].copy()
        return MemoryArrays(self.x, self.cells, self.past, S, self.buffers, buffer_S, self.heads)

    def copy(self) -> Memory:
        x, cells, past, S, buffers, buffer_S, heads = (array.copy() for array in self.arrays())
        snapshots = self.saved and (self.saved[0], dict(self.saved[1]))
        return Memory(x, cells, past, S, buffers, buffer_S, heads, self.begin, self.join, snapshots)

    def enter(self, x: Array, first: int) -> None:
        """Set the first n states to x (n,) and restart their sensitivities.

        These are the identity in the columns from `first` on. Cells and delay lines keep their
        sensitivities to the parameters.
        """
        n = len(x)
        self.x[:n] = x
        self.join = True
        if not self.S.size:
            return
        self.S[:n] = 0.0
        self.forget(first)
        self.S[:n, first : first + n] = np.eye(n)

    def forget(self, first: int) -> None:
        """Reset the sensitivities from column `first` on to zero."""
        self.S[:, first:] = 0.0
        self.buffer_S[:, :, first:] = 0.0
        if self.saved:
            nominal, copies = self.saved
            self.saved = (nominal, {k: copy for k, copy in copies.items() if k < first})


@dataclass(frozen=True)
class Stepping:
    """Integration of a sample: steps per sample, and whether the L-stable implicit step is used."""

    substeps: int = 1
    implicit: bool = False

    def doubled(self) -> Stepping:
        return Stepping(2 * self.substeps, self.implicit)


@dataclass(frozen=True, eq=False)
class WindowStarts:
    """Windows of a recording in time order, each with its initial states.

    edges (windows, 2): first sample, and the sample after the last; states (windows, n): the first
    n states at the start of each window; column: sensitivity column of the first of these states.
    """

    edges: NDArray[np.int64]
    states: Array
    column: int

    def __len__(self) -> int:
        return len(self.edges)


class RunParts(NamedTuple):
    """Arguments of a run in single steps. Between two steps the caller may set the states in
    `arrays`, together with their rows of S."""

    equations: CompiledEquations
    arrays: MemoryArrays
    inputs: Inputs
    results: Results

    def step(
        self, k: int, sub: int, times: tuple[float, float, Stepping], first: tuple[bool, bool]
    ) -> tuple[Array, Array]:
        """Make step `sub` of sample k.

        Returns the outputs at its start (outputs,) and their sensitivities (outputs, columns).
        times: time of the first sample (s), sampling period (s) and stepping; first: `begin` and
        `join` of the memory.
        """
        from pamid.engine.integrator import Times, sweep

        time_s, period_s, step = times
        timing = Times(
            float(time_s + k * period_s),
            float(period_s),
            step.substeps,
            step.implicit,
            *first,
            sub,
        )
        inputs = self.inputs._replace(u=self.inputs.u[k : k + 1])
        sweep(self.equations, self.arrays, inputs, timing, self.results)
        return self.results.Y[0], self.results.JY[0]


class SimulatedWindow(NamedTuple):
    """Result of a window's simulation.

    Y (samples, outputs): outputs; JY (samples, outputs, columns): their sensitivities, empty if not
    computed; end (nx,): states after the last sample; S (start states, columns): sensitivities of
    the first of these states; fine: whether all values stayed finite.
    """

    Y: Array
    JY: Array
    end: Array
    S: Array
    fine: bool

    @property
    def J(self) -> Array:
        """Sensitivities as a Jacobian (samples x outputs, columns), sample by sample."""
        samples, outputs, columns = self.JY.shape
        return self.JY.reshape(samples * outputs, columns)


class EquationSteps:
    """Choice of integration steps for compiled equations."""

    def least_substeps(self, period_s: float) -> int:
        """Minimum number of integration steps per sample."""
        return 1

    def careful(self, substeps: int) -> Stepping:
        """Return the stepping for a sample that would need `substeps` explicit steps."""
        return Stepping(1, implicit=True)


@dataclass(frozen=True)
class Program(EquationSteps):
    """Compiled equations. `states`, `inputs`, `parameters`, `outputs` give the order of every
    array.

    ordered: whether results converge regularly with finer steps; keeps_slopes: whether steps are
    so expensive that their Jacobians are reused.
    """

    ordered: ClassVar[bool] = True
    keeps_slopes: ClassVar[bool] = False

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    cells: tuple[str, ...]
    delays: tuple[float, ...]
    sensitive: frozenset[str]
    linear: tuple[int, ...]  # indices of inputs that are linear over a sample; others are held
    code: ProgramCode = field(repr=False)

    def memory(
        self, x: Array, columns: int = 0, *, stepping: Stepping | None = None, period_s: float = 1.0
    ) -> Memory:
        """Return a new memory at state x with `columns` sensitivities (all zero), padded to full
        SIMD lanes."""
        columns = -(-columns // LANES) * LANES
        nx, nc = len(self.states), len(self.cells)
        lines, length = len(self.delays), line_length(self.delays, stepping, period_s)
        return Memory(
            np.array(x, float),
            np.zeros(nc),
            np.zeros(nc),
            np.zeros((nx + 2 * nc, columns)),
            np.zeros((lines, length)),
            np.zeros((lines, length, columns)),
            np.zeros(lines, np.int64),
        )

    def run(
        self,
        memory: Memory,
        inputs: SampledInputs,
        p: Array,
        *,
        stepping: Stepping | None = None,
        columns: NDArray[np.int64] | None = None,
        weights: Array | None = None,
    ) -> tuple[Array, Array, int]:
        """Simulate over the rows of the inputs and advance `memory`.

        Parameters
        ----------
        memory
            State at the first sample; after the run, the state after the last sample.
        inputs
            Inputs (samples x inputs), held or linear in between.
        p
            Parameters (SI).
        stepping
            Integration steps per sample; default: an explicit step.
        columns
            Sensitivity column of each parameter, or -1. None runs without sensitivities.
        weights
            Factor per output on its sensitivities.

        Returns
        -------
        Outputs (samples x outputs), their sensitivities (samples x outputs x columns, as wide as
        the padded ones of `memory`; empty without `columns`), and the first sample at which the
        state diverged (-1: none).
        """
        from pamid.engine.integrator import Results, Times, WindowTable, sweep_windows

        step = stepping or Stepping()
        equations, prepared = self._prepared(memory, inputs, p, columns, partials=step.implicit)
        width = memory.S.shape[1]
        shape = len(inputs), len(self.outputs)
        Y, JY = np.empty(shape), np.empty((1, 1, 0) if columns is None else (*shape, width))
        times = float(inputs.time_s), float(inputs.period_s), step.substeps, step.implicit
        arrays = memory.arrays(sensitive=prepared.sensitive)
        _, diverged_at = sweep_windows(
            equations,
            arrays,
            prepared,
            Times(*times, memory.begin, memory.join, -1),
            Results(Y, JY, np.ones(len(self.outputs)) if weights is None else weights),
            WindowTable(
                np.array([[0, len(inputs)]], np.int64),
                np.array([times[0]]),
                np.empty((1, 0)),
                width,
                np.empty((1, len(memory.x))),
                np.empty((1, 0, arrays.S.shape[1])),
            ),
        )
        memory.begin = memory.join = False
        return Y, JY, int(diverged_at)

    def run_windows(
        self,
        memory: Memory,
        inputs: SampledInputs,
        p: Array,
        windows: WindowStarts,
        *,
        stepping: Stepping | None = None,
        columns: NDArray[np.int64] | None = None,
        weights: Array | None = None,
    ) -> Iterator[SimulatedWindow]:
        """Simulate windows of a recording with these inputs. See `run` for other arguments.

        Cells, delay lines and states that a window does not set continue from the window before.
        A block of windows is simulated before its first window is yielded. `memory` therefore
        belongs to the last window only after the iteration has ended. A window that diverges ends
        its block; the next block is simulated on demand.
        """
        from pamid.engine.integrator import Results, Times, WindowTable, sweep_windows

        if not len(windows):
            return
        step, edges, n = stepping or Stepping(), windows.edges, windows.states.shape[1]
        first_sample, stop_sample = edges[0, 0], edges[-1, 1]
        simulated = inputs.part(first_sample, stop_sample)
        equations, prepared = self._prepared(memory, simulated, p, columns, partials=step.implicit)
        arrays, output_count = memory.arrays(sensitive=prepared.sensitive), len(self.outputs)
        width = arrays.S.shape[1]
        weights = np.ones(output_count) if weights is None else weights
        time_s = inputs.time_s + edges[:, 0] * inputs.period_s
        rows, starts = edges - first_sample, np.ascontiguousarray(windows.states, float)
        # Blocks bound the memory of the Jacobian, and each is read while it is still in the cache.
        block_samples, window = BLOCK_NUMBERS // max(1, output_count * width), 0
        while window < len(rows):
            block_end = max(
                window + 1,
                int(np.searchsorted(rows[:, 1], rows[window, 0] + block_samples, side="right")),
            )
            block_start = rows[window, 0]
            shape = int(rows[block_end - 1, 1] - block_start), output_count
            Y, JY = np.empty(shape), np.empty((1, 1, 0) if columns is None else (*shape, width))
            end_states, S = (
                np.empty((block_end - window, len(memory.x))),
                np.empty((block_end - window, n, width)),
            )
            times = float(inputs.period_s), step.substeps, step.implicit, memory.begin, True, -1
            diverged_window, _ = sweep_windows(
                equations,
                arrays,
                prepared,
                Times(0.0, *times),
                Results(Y, JY, weights),
                WindowTable(
                    rows[window:block_end],
                    time_s[window:block_end],
                    starts[window:block_end],
                    windows.column,
                    end_states,
                    S,
                ),
            )
            memory.begin = memory.join = False
            count = block_end - window if diverged_window < 0 else diverged_window + 1
            for k, (a, b) in enumerate((rows[window : window + count] - block_start).tolist()):
                slopes = JY if columns is None else JY[a:b]
                yield SimulatedWindow(Y[a:b], slopes, end_states[k], S[k], k != diverged_window)
            window += count

    def driver(
        self,
        memory: Memory,
        inputs: SampledInputs,
        p: Array,
        columns: NDArray[np.int64] | None,
        first: int,
    ) -> RunParts:
        """Prepare a run in single steps; other arguments as of `run`.

        Between two steps the caller sets the leading `first` states, which are not in `memory`.
        """
        from pamid.engine.integrator import Results

        arrays = memory.arrays(sensitive=columns is not None)
        states = len(memory.x)
        x, S = np.zeros(first + states), np.zeros((first + len(memory.S), arrays.S.shape[1]))
        x[first:], S[first:] = memory.x, arrays.S
        shape = (1, len(self.outputs), S.shape[1])
        # The caller may choose an implicit step at any time, so the partials are always compiled.
        equations, prepared = self._prepared(memory, inputs, p, columns, partials=True)
        results = Results(
            np.empty(shape[:2]),
            np.empty((1, 1, 0) if columns is None else shape),
            np.ones(len(self.outputs)),
        )
        return RunParts(equations, arrays._replace(x=x, S=S), prepared, results)

    def room(self, samples: int, substeps: int, columns: NDArray[np.int64]) -> KnownSlopes | None:
        """Allocate the Jacobians of a recording for `with_slopes`; None if steps are cheap."""
        return None

    def with_slopes(self, known: KnownSlopes | None) -> Program:
        """Return a program whose next run with sensitivities begins with these slopes."""
        return self

    def rate_matrix(
        self, memory: Memory, u: Array, p: Array, *, period_s: float, time_s: float = 0.0
    ) -> Array:
        """State Jacobian df/dx (nx x nx) at the state of `memory` and the input u (inputs,)."""
        from pamid.engine.integrator import rate_matrix

        equations, values = self.code.at(p, partials=True)
        u = with_rises(u[None, :], None, self.linear, len(self.inputs))[0]
        return rate_matrix(equations, memory.arrays(), u, values, time_s, period_s, period_s)

    exchange_matrix = rate_matrix  # matrix from which the step length is chosen

    def _prepared(
        self,
        memory: Memory,
        inputs: SampledInputs,
        p: Array,
        columns: NDArray[np.int64] | None,
        *,
        partials: bool,
    ) -> tuple[CompiledEquations, Inputs]:
        """Return the compiled functions and the inputs of a run; arguments as of `run`. partials:
        compile partial derivatives even for a run without sensitivities."""
        from pamid.engine.integrator import Inputs

        # the vectorised loop needs at least one sensitivity column
        sensitive = columns is not None and memory.S.shape[1] > 0
        if columns is None or not sensitive:
            columns = np.full(len(self.parameters), -1, np.int64)
        elif not self.sensitive.issuperset(
            name for name, k in zip(self.parameters, columns, strict=True) if k >= 0
        ):
            raise ValueError("the model was not compiled for sensitivities by these parameters")
        equations, values = self.code.at(p, partials=sensitive or partials)
        u = with_rises(inputs.u, inputs.after, self.linear, len(self.inputs))
        return equations, Inputs(u, values, columns, sensitive)


def with_rises(u: Array, after: Array | None, linear: tuple[int, ...], inputs: int) -> Array:
    """Append the rise of every linear input over each sample to the columns of u (samples, inputs,
    ...), unless u already contains the rises."""
    recorded = np.ascontiguousarray(u, float)
    if not linear or recorded.shape[1] > inputs:
        return recorded
    # The last sample has no successor in the recording. Its input is held, unless the caller
    # passes the next input.
    linear_inputs = recorded[:, linear]
    end_point = (
        linear_inputs[-1:] if after is None else np.asarray(after, float)[None, list(linear)]
    )
    return np.ascontiguousarray(
        np.concatenate([recorded, np.diff(linear_inputs, axis=0, append=end_point)], axis=1)
    )


def line_length(delays: tuple[float, ...], stepping: Stepping | None, period_s: float) -> int:
    """Entries of a delay line for the longest of these delays (s), with a margin to interpolate."""
    step_s = period_s / (stepping or Stepping()).substeps
    return max([int(np.ceil(d / step_s)) + 3 for d in delays], default=1)


@lru_cache(maxsize=256)
def build_program(
    equations: StateEquations,
    inputs: tuple[str, ...],
    parameters: tuple[str, ...],
    outputs: tuple[str, ...],
    sensitive: frozenset[str] | None = None,
    linear: tuple[str, ...] = (),
) -> Program:
    """Compile equations, or load their code from the cache on disk.

    inputs, parameters, outputs: names in the order of the arrays. sensitive: parameters with
    sensitivities (default: all); fewer are cheaper. linear: inputs that `expand_memory` has treated
    as linear over a sample.
    """
    text = ProgramText(equations, inputs, parameters, sensitive, linear)
    return Program(
        equations.states,
        inputs,
        parameters,
        outputs,
        tuple(c.name for c in equations.cells),
        tuple(text.phases[4]),
        frozenset(parameters) if sensitive is None else sensitive,
        tuple(inputs.index(n) for n in linear),
        ProgramCode(text),
    )


@dataclass(frozen=True, eq=False)
class ProgramCode:
    """Machine code of a program, compiled on first use.

    Functions with partial derivatives take four fifths of the compile time. They are compiled
    separately, because a model that is only simulated does not need them.
    """

    text: ProgramText | ModuleTexts

    def at(self, p: Array, *, partials: bool) -> tuple[CompiledEquations, Array]:
        """Return the compiled functions, and the parameters p (SI) followed by values derived from
        them. partials: needed for sensitivities, implicit steps and `rate_matrix`."""
        from pamid.engine.integrator import prepare

        equations = self._complete if partials else self._plain
        count = self.text.partials.derived if partials else self.text.plain.derived
        values = np.concatenate([np.asarray(p, float), np.empty(count)])
        prepare(equations.address[-1], values, values[len(p) :])
        return equations, values

    @cached_property
    def _plain(self) -> CompiledEquations:
        # LLVM is loaded when a model is compiled, not with the package
        from pamid.engine.integrator import CompiledEquations
        from pamid.engine.jit_cache import addresses

        plain = self.text.plain
        *values, prepare = addresses("\n".join(plain.parts), plain.names)
        _, phase_n, phase_first, phase_delay, _ = self.text.phases
        # Empty tables of the right shape let a single compiled driver serve both kinds of code.
        zeros = [0] * (len(values) + 1)
        return CompiledEquations(
            _int_array([*(name for f in values for name in (f, 0, 0)), prepare]),
            _int_array(phase_n),
            _int_array(phase_first),
            _int_array(phase_delay),
            _int_array([]),
            _int_array([]),
            _int_array(zeros),
            _int_array([]).reshape(-1, 3),
        )

    @cached_property
    def _complete(self) -> CompiledEquations:
        from pamid.engine.jit_cache import addresses

        module = self.text.partials
        *partials, prepare = addresses("\n".join(module.parts), module.names)
        address = self._plain.address.copy()
        address[1:-1:3], address[2:-1:3], address[-1] = partials[::2], partials[1::2], prepare
        # The driver sizes its scratch by len(columns): pad them to the widest function.
        columns = _int_array(module.columns + [-1] * (module.widest - len(module.columns)))
        return self._plain._replace(
            address=address,
            pointer=_int_array(module.pointer),
            columns=columns,
            direct_at=_int_array(module.direct_at),
            direct=_int_array(module.direct).reshape(-1, 3),
        )


def _int_array(values: object) -> NDArray[np.int64]:
    return np.array(values, np.int64)


@dataclass(frozen=True)
class Layout:
    """Positions of symbols. place: index in the array of a symbol's space; base: first column of
    each space among the partials. The columns before `first_parameter` are the rows of S."""

    place: dict[tuple[str, str], int]
    base: dict[str, int]

    @classmethod
    def of(
        cls,
        equations: StateEquations,
        inputs: tuple[str, ...],
        parameters: tuple[str, ...],
        linear: tuple[str, ...],
    ) -> Layout:
        nx, nc = len(equations.states), len(equations.cells)
        place = {("state", n): i for i, n in enumerate(equations.states)}
        place |= {
            (space, c.name): i for i, c in enumerate(equations.cells) for space in ("cell", "past")
        }
        place |= {("input", n): i for i, n in enumerate(inputs)}
        place |= {("rise", n): len(inputs) + i for i, n in enumerate(linear)}
        place |= {("parameter", n): i for i, n in enumerate(parameters)}
        place |= {("tick", n): i for i, n in enumerate(TICKS)}
        return cls(place, {"state": 0, "cell": nx, "past": nx + nc, "parameter": nx + 2 * nc})

    def with_derived(self, count: int) -> Layout:
        """Return a layout with `count` derived values after the parameters."""
        first = sum(space == "parameter" for space, _ in self.place)
        return Layout(
            self.place | {("derived", str(i)): first + i for i in range(count)}, self.base
        )

    def index(self, space: str, name: str) -> int:
        return self.place[space, name]

    def column(self, space: str, name: str) -> int:
        return self.base[space] + self.place[space, name]

    @property
    def first_parameter(self) -> int:
        return self.base["parameter"]


class PlainModule(NamedTuple):
    """LLVM IR of the functions without partials.

    parts: declarations, a function per group of equations (f0: rates, f1: outputs, others:
    cells), and `prepare`; names: names of the functions; derived: number of values that `prepare`
    computes.
    """

    parts: list[str]
    names: list[str]
    derived: int


class PartialsModule(NamedTuple):
    """LLVM IR of the functions with partials.

    Each group of equations has two functions: d computes values and partials, s the product of the
    partials with S. The last function, `prepare`, computes the derived values for these and for the
    plain functions. As in `CompiledEquations`, pointer and columns are the sparsity of the rates,
    direct_at and direct the entries by parameters of all groups. widest: largest number of partials
    of a function.
    """

    parts: list[str]
    names: list[str]
    derived: int
    pointer: list[int]
    columns: list[int]
    direct_at: list[int]
    direct: list[tuple[int, int, int]]
    widest: int


class ModuleTexts(NamedTuple):
    """LLVM IR modules of a program, generated in another process."""

    phases: tuple[Any, list[int], list[int], list[int], list[float]]
    plain: PlainModule
    partials: PartialsModule


@dataclass(frozen=True, eq=False)
class ProgramText:
    """LLVM IR modules of a program, generated on first use; fields as the arguments of
    `build_program`."""

    equations: StateEquations
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    sensitive: frozenset[str] | None
    linear: tuple[str, ...]

    @cached_property
    def phases(
        self,
    ) -> tuple[list[list[Expr]], list[int], list[int], list[int], list[float]]:
        return cell_phases(self.equations)

    @cached_property
    def _layout(self) -> Layout:
        return Layout.of(self.equations, self.inputs, self.parameters, self.linear)

    @cached_property
    def _groups(self) -> list[list[Expr]]:
        """Rates, outputs, cells."""
        return [[*self.equations.rates], [*self.equations.outputs], *self.phases[0]]

    @cached_property
    def _plain_values(self) -> tuple[list[list[Expr]], list[Expr]]:
        return extract_derived([plain(roots) for roots in self._groups])

    @cached_property
    def plain(self) -> PlainModule:
        values, derived = self._plain_values
        index, part = self._layout.with_derived(len(derived)).index, part_of(values)
        parts = [declarations(part)]
        parts += [function_text(f"f{i}", roots, index, part) for i, roots in enumerate(values)]
        parts.append(function_text("prepare", derived, index, part))
        return PlainModule(parts, [*(f"f{i}" for i in range(len(values))), "prepare"], len(derived))

    @cached_property
    def partials(self) -> PartialsModule:
        layout, groups = self._layout, self._groups
        tables = [with_partials(roots, layout.column, self.sensitive) for roots in groups]
        # derived values of the plain functions come first, so that both use the same indices
        values, derived = extract_derived([v for v, _, _ in tables], self._plain_values[1])
        layout, parameters = layout.with_derived(len(derived)), layout.first_parameter
        part = part_of(values)
        parts, names = [declarations(part)], []
        direct: list[tuple[int, int, int]] = []
        direct_at = [0]
        for i, (roots, (_, pointer, columns)) in enumerate(zip(groups, tables, strict=True)):
            parts += [
                function_text(f"d{i}", values[i], layout.index, part),
                product_text(f"s{i}", pointer, columns, parameters),
            ]
            names += [f"d{i}", f"s{i}"]
            direct += [
                (row, columns[e] - parameters, e)
                for row in range(len(roots))
                for e in range(pointer[row], pointer[row + 1])
                if columns[e] >= parameters
            ]
            direct_at.append(len(direct))
        parts.append(function_text("prepare", derived, layout.index, part))
        # the implicit step needs df/dx row by row, of the rates only
        _, pointer, columns = tables[0]
        widest = max(len(columns) for _, _, columns in tables)
        return PartialsModule(
            parts,
            [*names, "prepare"],
            len(derived),
            pointer,
            columns,
            direct_at,
            direct,
            widest,
        )


def cell_phases(
    equations: StateEquations,
) -> tuple[list[list[Expr]], list[int], list[int], list[int], list[float]]:
    """Split the ordered cells into phases, a phase after every delay line.

    The driver advances the line between two phases. A cell reads the new values of earlier phases.
    The new value of a cell in the same phase is replaced by its expression.

    Returns per phase expressions, number of cells, first cell and delay line (-1: none); last, the
    longest delay of each line (s).
    """
    from pamid.engine.symbolic.expression import substitute

    phases: list[list[Expr]] = []
    counts: list[int] = []
    firsts: list[int] = []
    lines: list[int] = []
    lengths: list[float] = []
    current: list[Expr] = []
    inline: dict[Expr, Expr] = {}
    first = 0
    for i, cell in enumerate(equations.cells):
        if cell.buffer_s > 0.0:
            delay_s = expression(0.0 if cell.seconds is None else cell.seconds)
            line_input, line_delay = substitute([cell.update, delay_s], inline)
            phases.append([*current, line_input, line_delay])
            counts.append(len(current))
            firsts.append(first)
            lines.append(len(lengths))
            lengths.append(cell.buffer_s)
            current, inline, first = [], {}, i + 1
        else:
            (update,) = substitute([cell_update(cell)], inline)
            current.append(update)
            inline[cell.here] = update
    if current:
        phases.append(current)
        counts.append(len(current))
        firsts.append(first)
        lines.append(-1)
    return phases, counts, firsts, lines, lengths
