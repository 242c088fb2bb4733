"""A model made executable: compiled equations, their sparsity, and runs over recorded inputs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

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
from pamid.symbolic.expression import plain
from pamid.symbolic.memory_cells import TICKS, StateEquations, cell_update
from pamid.symbolic.vocabulary import Expr, expression

if TYPE_CHECKING:  # numba is loaded when a model is compiled, not with the package
    from pamid.engine.integrator import CompiledEquations, Inputs, MemoryArrays, Results

Array = NDArray[np.float64]

# sensitivities of the windows that are run at a time: 1 MiB, which stays in the cache
BLOCK_NUMBERS = 2**17


@dataclass
class Memory:
    """Everything a run carries from one call to the next: states, cells, delay lines and their
    sensitivities.

    x (nx), cells (nc), buffers (delays, length), S (nx + 2 nc, columns), heads (delays); begin
    until the first run.
    """

    x: Array
    cells: Array
    past: Array
    S: Array
    buffers: Array
    buffer_S: Array
    heads: NDArray[np.int64]
    begin: bool = True
    join: bool = False  # the state was set anew since the last run
    # what a simulator that keeps its states to itself has saved: of the plain run, and by column
    # of a copy whose values are moved
    saved: tuple[Any, dict[int, Any]] | None = None

    def arrays(self, *, sensitive: bool = True) -> MemoryArrays:
        """The arrays themselves; without room for sensitivities where these are not wanted."""
        from pamid.engine.integrator import MemoryArrays

        S, buffer_S = self.S, self.buffer_S
        if not sensitive:
            S, buffer_S = S[:, :0].copy(), buffer_S[:, :, :0].copy()
        return MemoryArrays(self.x, self.cells, self.past, S, self.buffers, buffer_S, self.heads)

    def copy(self) -> Memory:
        x, cells, past, S, buffers, buffer_S, heads = (array.copy() for array in self.arrays())
        carried = self.saved and (self.saved[0], dict(self.saved[1]))
        return Memory(x, cells, past, S, buffers, buffer_S, heads, self.begin, self.join, carried)

    def enter(self, x: Array, first: int) -> None:
        """Set the first states to x (n,): sensitivities to these begin here, from column `first`
        on; those to parameters live on in memories."""
        n = len(x)
        self.x[:n] = x
        self.join = True
        if not self.S.size:
            return
        self.S[:n] = 0.0
        self.forget(first)
        self.S[:n, first : first + n] = np.eye(n)

    def forget(self, first: int) -> None:
        """The sensitivities from column `first` on become those of a state that nothing has moved:
        zero."""
        self.S[:, first:] = 0.0
        self.buffer_S[:, :, first:] = 0.0
        if self.saved:
            plain, copies = self.saved
            self.saved = (plain, {k: copy for k, copy in copies.items() if k < first})


@dataclass(frozen=True)
class Stepping:
    """Integration of a sample: steps per sample, and whether the L-stable implicit step is used."""

    substeps: int = 1
    implicit: bool = False

    def doubled(self) -> Stepping:
        return Stepping(2 * self.substeps, self.implicit)


@dataclass(frozen=True, eq=False)
class WindowStarts:
    """Windows of a recording in order, each begun at states that are set anew.

    edges (windows, 2): the first sample, and the one behind the last; states (windows, n): the
    first n ones at the start of each; column: of the first of them among the sensitivities; first:
    number of the recording's first sample, which gives the time.
    """

    edges: NDArray[np.int64]
    states: Array
    column: int
    first: int = 0

    def __len__(self) -> int:
        return len(self.edges)


class RunParts(NamedTuple):
    """Arguments of a run in single steps. What it works on stands in `arrays`: states may be set
    between two steps, and their rows of S with them."""

    equations: CompiledEquations
    arrays: MemoryArrays
    inputs: Inputs
    results: Results

    def step(
        self, k: int, sub: int, times: tuple[float, float, Stepping], first: tuple[bool, bool]
    ) -> tuple[Array, Array]:
        """Step `sub` of sample k; the outputs at its start (outputs,) and their sensitivities
        (outputs, columns). times: of the first sample, s; of a sample, s; how it is divided;
        first: `begin` and `join` of the memory."""
        from pamid.engine.integrator import Times, sweep

        time_s, period_s, step = times
        now = Times(
            float(time_s + k * period_s),
            float(period_s),
            step.substeps,
            step.implicit,
            *first,
            sub,
        )
        inputs = self.inputs._replace(u=self.inputs.u[k : k + 1])
        sweep(self.equations, self.arrays, inputs, now, self.results)
        return self.results.Y[0], self.results.JY[0]


class SimulatedWindow(NamedTuple):
    """Outputs of a window (samples, outputs), their sensitivities (samples, outputs, columns; empty
    without), the states behind its last sample (nx,), their sensitivities (start states, columns),
    and whether all stayed finite."""

    Y: Array
    JY: Array
    end: Array
    S: Array
    fine: bool

    @property
    def J(self) -> Array:
        """The sensitivities as a Jacobian: samples x outputs of one after the other, columns."""
        samples, outputs, columns = self.JY.shape
        return self.JY.reshape(samples * outputs, columns)


class EquationSteps:
    """The stepping of compiled equations."""

    def least_substeps(self, period_s: float) -> int:
        """Least steps per sample of the model."""
        return 1

    def careful(self, substeps: int) -> Stepping:
        """Stepping of a sample that would need this many explicit steps."""
        return Stepping(1, implicit=True)


@dataclass(frozen=True)
class Program(EquationSteps):
    """Compiled equations. `states`, `inputs`, `parameters`, `outputs` give the order of every
    array.

    ordered: do finer steps change less and less? keeps_slopes: are there any expensive enough
    to be kept?"""

    ordered: ClassVar[bool] = True
    keeps_slopes: ClassVar[bool] = False

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    cells: tuple[str, ...]
    delays: tuple[float, ...]
    operations: int
    sensitive: frozenset[str]
    linear: tuple[int, ...]  # places of the inputs that are linear over a sample; others are held
    code: ProgramCode = field(repr=False)

    def memory(
        self, x: Array, columns: int = 0, *, stepping: Stepping | None = None, period_s: float = 1.0
    ) -> Memory:
        """Fresh memory at state x with room for `columns` sensitivities (all zero), padded to full
        lanes."""
        columns = -(-columns // LANES) * LANES
        nx, nc = len(self.states), len(self.cells)
        nd, size = len(self.delays), line_length(self.delays, stepping, period_s)
        return Memory(
            np.array(x, float),
            np.zeros(nc),
            np.zeros(nc),
            np.zeros((nx + 2 * nc, columns)),
            np.zeros((nd, size)),
            np.zeros((nd, size, columns)),
            np.zeros(nd, np.int64),
        )

    def run(
        self,
        memory: Memory,
        u: Array,
        p: Array,
        *,
        period_s: float,
        time_s: float = 0.0,
        stepping: Stepping | None = None,
        columns: NDArray[np.int64] | None = None,
        weights: Array | None = None,
        after: Array | None = None,
    ) -> tuple[Array, Array, int]:
        """Simulate over the rows of u (samples x inputs), carrying `memory` on.

        after: the inputs (inputs,) one sample behind the last row, where there are any: inputs that
        are linear over a sample lead there; without it the last row is held. Columns of u behind
        the inputs, where there are any, are what each linear one rises over the sample.
        columns: for each parameter its sensitivity column or -1; None runs without sensitivities.
        The Jacobian is as wide as the memory's (padded) sensitivities. weights: factor per output
        on its sensitivities. Returns outputs (samples x outputs), their sensitivities (samples x
        outputs x columns; empty without), and the first sample at which the state blew up (-1:
        none).
        """
        from pamid.engine.integrator import Results, Times, WindowTable, sweep_windows

        step = stepping or Stepping()
        equations, inputs = self._prepared(memory, u, p, columns, after, partials=step.implicit)
        wide = memory.S.shape[1]
        shape = len(u), len(self.outputs)
        Y, JY = np.empty(shape), np.empty((1, 1, 0) if columns is None else (*shape, wide))
        times = float(time_s), float(period_s), step.substeps, step.implicit
        held = memory.arrays(sensitive=inputs.sensitive)
        _, bad = sweep_windows(
            equations,
            held,
            inputs,
            Times(*times, memory.begin, memory.join, -1),
            Results(Y, JY, np.ones(len(self.outputs)) if weights is None else weights),
            WindowTable(
                np.array([[0, len(u)]], np.int64),
                np.array([times[0]]),
                np.empty((1, 0)),
                wide,
                np.empty((1, len(memory.x))),
                np.empty((1, 0, held.S.shape[1])),
            ),
        )
        memory.begin = memory.join = False
        return Y, JY, int(bad)

    def run_windows(
        self,
        memory: Memory,
        u: Array,
        p: Array,
        windows: WindowStarts,
        *,
        period_s: float,
        stepping: Stepping | None = None,
        columns: NDArray[np.int64] | None = None,
        weights: Array | None = None,
    ) -> Iterator[SimulatedWindow]:
        """Simulate windows of the recording u (samples x inputs), carrying on in `memory` what is
        not set anew. See `run` for the others.

        Windows are run several at a time, ahead of the one that is yielded: `memory` is that of the
        last window once all have been taken. After a window that is not finite the next ones are
        run only when they are taken.
        """
        from pamid.engine.integrator import Results, Times, WindowTable, sweep_windows

        if not len(windows):
            return
        step, edges, n = stepping or Stepping(), windows.edges, windows.states.shape[1]
        begun, ended = edges[0, 0], edges[-1, 1]
        behind = u[ended] if ended < len(u) else None
        equations, inputs = self._prepared(
            memory, u[begun:ended], p, columns, behind, partials=step.implicit
        )
        held, seen = memory.arrays(sensitive=inputs.sensitive), len(self.outputs)
        wide = held.S.shape[1]
        weights = np.ones(seen) if weights is None else weights
        time_s = (windows.first + edges[:, 0]) * period_s
        rows, starts = edges - begun, np.ascontiguousarray(windows.states, float)
        # Blocks bound the memory of the Jacobian, and each is read while it is still in the cache.
        most, at = BLOCK_NUMBERS // max(1, seen * wide), 0
        while at < len(rows):
            to = max(at + 1, int(np.searchsorted(rows[:, 1], rows[at, 0] + most, side="right")))
            first = rows[at, 0]
            shape = int(rows[to - 1, 1] - first), seen
            Y, JY = np.empty(shape), np.empty((1, 1, 0) if columns is None else (*shape, wide))
            end, S = np.empty((to - at, len(memory.x))), np.empty((to - at, n, wide))
            times = float(period_s), step.substeps, step.implicit, memory.begin, True, -1
            stopped, _ = sweep_windows(
                equations,
                held,
                inputs,
                Times(0.0, *times),
                Results(Y, JY, weights),
                WindowTable(rows[at:to], time_s[at:to], starts[at:to], windows.column, end, S),
            )
            memory.begin = memory.join = False
            count = to - at if stopped < 0 else stopped + 1
            for k, (a, b) in enumerate((rows[at : at + count] - first).tolist()):
                slopes = JY if columns is None else JY[a:b]
                yield SimulatedWindow(Y[a:b], slopes, end[k], S[k], k != stopped)
            at += count

    def driver(
        self,
        memory: Memory,
        u: Array,
        p: Array,
        columns: NDArray[np.int64] | None,
        after: Array | None,
        first: int,
    ) -> RunParts:
        """The same run in single steps, between which `first` states are set from outside: those
        that `memory` lacks. See `run` for the others."""
        from pamid.engine.integrator import Results

        held = memory.arrays(sensitive=columns is not None)
        states = len(memory.x)
        x, S = np.zeros(first + states), np.zeros((first + len(memory.S), held.S.shape[1]))
        x[first:], S[first:] = memory.x, held.S
        shape = (1, len(self.outputs), S.shape[1])
        # whether steps are implicit is known when they are made
        equations, inputs = self._prepared(memory, u, p, columns, after, partials=True)
        results = Results(
            np.empty(shape[:2]),
            np.empty((1, 1, 0) if columns is None else shape),
            np.ones(len(self.outputs)),
        )
        return RunParts(equations, held._replace(x=x, S=S), inputs, results)

    def room(self, samples: int, substeps: int, columns: NDArray[np.int64]) -> KnownSlopes | None:
        """Table for slopes of a track's steps, for `with_slopes`. None where steps cost little."""
        return None

    def with_slopes(self, known: KnownSlopes | None) -> Program:
        """Return a program whose next run with sensitivities begins with these slopes."""
        return self

    def rate_matrix(
        self, memory: Memory, u: Array, p: Array, *, period_s: float, time_s: float = 0.0
    ) -> Array:
        """df/dx (nx x nx) where `memory` stands, at the input u (inputs,)."""
        from pamid.engine.integrator import rate_matrix

        equations, values = self.code.at(p, partials=True)
        u = self._with_rises(u[None, :], None)[0]
        return rate_matrix(equations, memory.arrays(), u, values, time_s, period_s, period_s)

    exchange_matrix = rate_matrix  # by which the length of a step is chosen

    def _prepared(
        self,
        memory: Memory,
        u: Array,
        p: Array,
        columns: NDArray[np.int64] | None,
        after: Array | None,
        *,
        partials: bool,
    ) -> tuple[CompiledEquations, Inputs]:
        """The compiled functions and the inputs of a run; see `run`. partials: are they needed even
        without sensitivities?"""
        from pamid.engine.integrator import Inputs

        # the vector loop needs at least one lane
        sensitive = columns is not None and memory.S.shape[1] > 0
        if columns is None or not sensitive:
            columns = np.full(len(self.parameters), -1, np.int64)
        elif not self.sensitive.issuperset(
            name for name, k in zip(self.parameters, columns, strict=True) if k >= 0
        ):
            raise ValueError("the model was not compiled for sensitivities by these parameters")
        equations, values = self.code.at(p, partials=sensitive or partials)
        return equations, Inputs(self._with_rises(u, after), values, columns, sensitive)

    def _with_rises(self, u: Array, after: Array | None) -> Array:
        return with_rises(u, after, self.linear, len(self.inputs))


def with_rises(u: Array, after: Array | None, linear: tuple[int, ...], inputs: int) -> Array:
    """u (samples, inputs, ...) and, behind its inputs, by how much every linear one rises over each
    sample, unless that is there already."""
    plain = np.ascontiguousarray(u, float)
    if not linear or plain.shape[1] > inputs:
        return plain
    # The last sample has no successor in the recording, so that its input is held unless the
    # caller has the next one.
    moving = plain[:, linear]
    end = moving[-1:] if after is None else np.asarray(after, float)[None, list(linear)]
    return np.ascontiguousarray(
        np.concatenate([plain, np.diff(moving, axis=0, append=end)], axis=1)
    )


def line_length(delays: tuple[float, ...], stepping: Stepping | None, period_s: float) -> int:
    """Steps that the longest of these delays (s) takes, with what is read between them."""
    step = period_s / (stepping or Stepping()).substeps
    return max([int(np.ceil(d / step)) + 3 for d in delays], default=1)


@lru_cache(maxsize=256)
def build_program(
    equations: StateEquations,
    inputs: tuple[str, ...],
    parameters: tuple[str, ...],
    outputs: tuple[str, ...],
    sensitive: frozenset[str] | None = None,
    linear: tuple[str, ...] = (),
) -> Program:
    """Compile equations (from the cache on disk where they were compiled before; in one
    process only once).

    sensitive: parameters with sensitivities (default: all); fewer are cheaper.
    linear: the inputs that the equations were lowered for as linear over a sample
    (`expand_memory`).
    """
    text = ProgramText(equations, inputs, parameters, sensitive, linear)
    return Program(
        equations.states,
        inputs,
        parameters,
        outputs,
        tuple(c.name for c in equations.cells),
        tuple(text.phases[4]),
        text.plain.parts[1].count("\n"),
        frozenset(parameters) if sensitive is None else sensitive,
        tuple(inputs.index(n) for n in linear),
        ProgramCode(text),
    )


@dataclass(frozen=True, eq=False)
class ProgramCode:
    """Machine code of a program. The functions without partials are compiled at once, those with
    partials when they are first needed: they take four fifths of the time, and a model that is
    only simulated needs none."""

    text: ProgramText | ModuleTexts

    def at(self, p: Array, *, partials: bool) -> tuple[CompiledEquations, Array]:
        """The compiled functions, and the parameters p (SI) followed by what depends on them alone.
        partials: for sensitivities, implicit steps or `rate_matrix`."""
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
        # Empty tables of the right shape let one compiled driver serve both kinds of code.
        none = [0] * (len(values) + 1)
        return CompiledEquations(
            _int_array([*(n for f in values for n in (f, 0, 0)), prepare]),
            _int_array(phase_n),
            _int_array(phase_first),
            _int_array(phase_delay),
            _int_array([]),
            _int_array([]),
            _int_array(none),
            _int_array([]).reshape(-1, 3),
        )

    @cached_property
    def _complete(self) -> CompiledEquations:
        from pamid.engine.jit_cache import addresses

        module = self.text.partials
        *partials, prepare = addresses("\n".join(module.parts), module.names)
        address = self._plain.address.copy()
        address[1:-1:3], address[2:-1:3], address[-1] = partials[::2], partials[1::2], prepare
        # the driver sizes its scratch by the array of columns
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
    """Places of symbols: in the array of their space, first column of each space among the
    partials, and the parameters' first column (those before it are the rows of S)."""

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
        """The same with so many values behind the parameters that follow from these alone."""
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

    parts: the declarations, then a function per group of equations, f0 of the rates, f1 of the
    outputs, the others of the cells, last `prepare`; names: of the functions; derived: number of
    values that `prepare` fills.
    """

    parts: list[str]
    names: list[str]
    derived: int


class PartialsModule(NamedTuple):
    """LLVM IR of the functions with partials: per group of equations d, values and partials, and s,
    the product of the partials with S; last `prepare` of what they and the plain functions need.

    What the driver has to know of them is as in `CompiledEquations`: sparsity of the rates'
    (pointer, columns), entries by parameters of all (direct_at, direct). widest: largest number of
    partials of a function.
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
    """The modules of a program that were written in another process."""

    phases: tuple[Any, list[int], list[int], list[int], list[float]]
    plain: PlainModule
    partials: PartialsModule


@dataclass(frozen=True, eq=False)
class ProgramText:
    """The modules that a program is compiled from, written when they are needed; arguments as of
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
        # those of the plain functions first, which read them at the same places
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
    """Cut the ordered cells after every delay line: the driver moves the line between two phases.

    Inside a phase a cell may read another one's new value only if that one stands in an earlier
    phase; where it reads one of its own phase the new value is written out.
    """
    from pamid.symbolic.expression import substitute

    phases: list[list[Expr]] = []
    counts: list[int] = []
    firsts: list[int] = []
    delayed: list[int] = []
    lengths: list[float] = []
    current: list[Expr] = []
    inline: dict[Expr, Expr] = {}
    first = 0
    for i, cell in enumerate(equations.cells):
        if cell.buffer_s > 0.0:
            waits = expression(0.0 if cell.seconds is None else cell.seconds)
            goes_in, seconds = substitute([cell.update, waits], inline)
            phases.append([*current, goes_in, seconds])
            counts.append(len(current))
            firsts.append(first)
            delayed.append(len(lengths))
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
        delayed.append(-1)
    return phases, counts, firsts, delayed, lengths
