"""A model of two parts: a simulator that steps by itself, and compiled equations around it.

The equations get the states and readings of the simulator, and return its forces. At the start of
every exchange, of length h,

    f_k      = F(x_k, r_k, z_k, u_k, p)     the equations; they move their own states z and cells on
    x_(k+1)  = step(x_k, f_k, p, h)         the simulator, with f held
    r_(k+1)  = read(x_(k+1), p)

States of the simulator and readings are states of the equations with a rate of zero, set anew after
every exchange. The driver of compiled equations (`pamid.engine.integrator`) therefore serves the
equations unchanged, sensitivities included. Sensitivities of the whole follow by the chain rule
from the slopes of the step. These are finite differences over copies of the simulator that lie
across no jump (`pamid.engine.simulator.slopes_of`), so that the sensitivities are those of the
recursion as it was computed.

Forces are held over h, so that the method is of order 1 in h for external forces. Coupled
explicitly, a damping c on a mass m needs h below 2 m/c (Kuebler and Schiehlen 2000, Mathematical
and Computer Modelling of Dynamical Systems 6(2), 93-113).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from pamid.engine.known_slopes import FAR, STILL_HOLDS, KnownSlopes
from pamid.engine.program import Memory, Program, SimulatedWindow, Stepping, WindowStarts
from pamid.engine.shadow_simulators import BLOWN_UP, Carrier, ShadowCourse
from pamid.engine.simulator import (
    DIFFERENCE,
    PROBED,
    SIDES_AGREE,
    SLOPE_ROUNDING,
    THIN,
    Differences,
    Simulator,
    Slopes,
    slopes_of,
)
from pamid.engine.step_driver import StepDriver

if TYPE_CHECKING:  # numba is loaded when a model is run, not with the package
    from pamid.engine.stepped_kernel import KnownInC

Array = NDArray[np.float64]

MOST_EXCHANGES = 64  # per sample


class FarRunner(Protocol):
    """A process in which a simulator lives, and where whole runs are made."""

    def run_there(
        self, program: SteppedProgram, memory: Memory, *course: Any
    ) -> tuple[Array, Array, int]:
        """See `SteppedProgram.run`, whose arguments these are, in its order."""


@dataclass(frozen=True, eq=False)
class SteppedProgram:
    """The two parts as one; used as a `pamid.engine.program.Program` is.

    around     the equations: their states are readings, states of the simulator, their own ones,
               in this order; their last outputs go into the simulator
    simulator_parameters
               number of the first parameters, which belong to the simulator
    """

    simulator: Simulator | Carrier
    around: Program
    readings: int
    simulated: int
    forces: int
    simulator_parameters: int
    far: FarRunner | None = None
    known: KnownSlopes | None = None  # of the exchanges of the next run with sensitivities
    states: tuple[str, ...] = field(init=False)
    outputs: tuple[str, ...] = field(init=False)
    ordered: ClassVar[bool] = False  # contacts come and go with the length of a step

    def __post_init__(self) -> None:
        object.__setattr__(self, "states", self.around.states[self.readings :])
        object.__setattr__(self, "outputs", self.around.outputs[: -self.forces])

    @property
    def inputs(self) -> tuple[str, ...]:
        return self.around.inputs

    @property
    def parameters(self) -> tuple[str, ...]:
        return self.around.parameters

    @property
    def cells(self) -> tuple[str, ...]:
        return self.around.cells

    @property
    def keeps_slopes(self) -> bool:
        """See `Program`. False for hidden states, which cannot be set, and for a simulator in
        another process."""
        return not isinstance(self.simulator, Carrier) and self.far is None

    def room(self, samples: int, substeps: int, columns: NDArray[np.int64]) -> KnownSlopes | None:
        """See `Program`. None also for a table that would be too large."""
        if not self.keeps_slopes:
            return None
        sizes = self.readings, self.simulated, self.forces, self.simulator_parameters
        return KnownSlopes.room(
            samples, substeps, sizes, np.flatnonzero(columns[: self.simulator_parameters] >= 0)
        )

    def with_slopes(self, known: KnownSlopes | None) -> SteppedProgram:
        """See `Program`."""
        return replace(self, known=known)

    def least_substeps(self, period_s: float) -> int:
        """Least exchanges per sample of the simulator."""
        return max(1, int(np.ceil(period_s / self.simulator.longest_s - 1e-9)))

    def careful(self, substeps: int) -> Stepping:
        """Stepping where more exchanges are needed than an explicit step would take. The simulator
        has no implicit step, so that all of them are made; the equations' own states are solved
        for."""
        return Stepping(min(substeps, MOST_EXCHANGES), implicit=True)

    def memory(
        self, x: Array, columns: int = 0, *, stepping: Stepping | None = None, period_s: float = 1.0
    ) -> Memory:
        """See `Program.memory`."""
        # Readings follow from the states, so that they are no part of what a caller may set.
        inside = np.concatenate([np.zeros(self.readings), x])
        memory = self.around.memory(inside, columns, stepping=stepping, period_s=period_s)
        memory.x, memory.S = memory.x[self.readings :].copy(), memory.S[self.readings :].copy()
        return memory

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
        """See `Program.run`."""
        if self.far is not None:
            step = stepping or Stepping()
            given = u, p, period_s, time_s, step, columns, weights, after
            return self.far.run_there(self, memory, *given)
        step = stepping or Stepping()
        wide, seen = memory.S.shape[1], len(self.outputs)
        JY = np.empty((1, 1, 0) if columns is None else (len(u), seen, wide))
        columns = None if wide == 0 else columns
        around = self.around.driver(memory, u, p, columns, after, self.readings)
        Y = np.empty((len(u), seen))
        course = self._course(memory, around.arrays.x, around.arrays.S, p, columns)
        course.read()
        parts = 1 if self.whole else step.substeps
        bad, times = -1, (time_s, period_s, replace(step, substeps=parts))
        first_bad = course.in_c(around, memory, times, Y, JY)
        if first_bad is not None:
            bad = first_bad
        for k in range(len(u)) if first_bad is None else ():
            for sub in range(parts):
                values, slopes = around.step(k, sub, times, memory.begin, memory.join)
                memory.begin = memory.join = False
                if sub == 0:
                    Y[k] = values[:seen]
                    if columns is not None:
                        JY[k] = slopes[:seen]
                course.step(k * parts + sub, values[seen:], slopes[seen:], period_s / parts)
            if not course.finite:
                bad = k
                Y[k + 1 :] = np.nan
                if columns is not None:
                    JY[k + 1 :] = np.nan
                break
        course.keep(memory)
        # Slopes near a state that has blown up hold nowhere else.
        if bad >= 0 and columns is not None and self.known is not None:
            self.known.forget()
        memory.x[:] = course.x[self.readings :]
        if columns is not None:
            memory.S[:] = course.S[self.readings :]
            if weights is not None:
                JY *= weights[:, None]
        return Y, JY, bad

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
        """See `Program.run_windows`; slopes that are kept are those of the whole recording."""
        n, known = windows.states.shape[1], self.known
        for (start, stop), x in zip(windows.edges.tolist(), windows.states, strict=True):
            memory.enter(x, windows.column)
            program = self.with_slopes(known.part(start, stop)) if known else self
            Y, JY, bad = program.run(
                memory,
                u[start:stop],
                p,
                period_s=period_s,
                time_s=(windows.first + start) * period_s,
                stepping=stepping,
                columns=columns,
                weights=weights,
                after=u[stop] if stop < len(u) else None,
            )
            fine = bad < 0 and bool(np.isfinite(Y).all())
            yield SimulatedWindow(Y, JY, memory.x.copy(), memory.S[:n].copy(), fine)

    def _course(
        self,
        memory: Memory,
        x: Array,
        S: Array,
        p: Array,
        columns: NDArray[np.int64] | None,
    ) -> _Course | ShadowCourse:
        if isinstance(self.simulator, Carrier):
            return ShadowCourse(self.simulator, memory, x, S, p, columns, self.simulator_parameters)
        course = _Course(self, self.simulator, x, S, p, columns)
        known = self.known
        if known is not None and (columns is None or known.is_by(course.chosen)):
            course.known, course.level = known, known.level
        return course

    @property
    def whole(self) -> bool:
        """Whether a sample is one exchange under any stepping."""
        return isinstance(self.simulator, Carrier) and self.simulator.whole_samples

    def rate_matrix(
        self, memory: Memory, u: Array, p: Array, *, period_s: float, time_s: float = 0.0
    ) -> Array:
        """Equivalent of df/dx (nx x nx): the Jacobian of the equations' own states, and (A - I)/h
        of the simulator's, with the A by which a step of h moves deviations on."""
        nx, first = len(self.states), self.readings
        if isinstance(self.simulator, Carrier):  # its states are hidden
            inside = replace(memory.copy(), x=np.concatenate([np.zeros(first), memory.x]))
            matrix = self.around.rate_matrix(inside, u, p, period_s=period_s, time_s=time_s)
            return matrix[first:, first:]
        none = np.full(len(self.parameters), -1, np.int64)
        wide = self.memory(memory.x, nx).S
        np.fill_diagonal(wide, 1.0)
        trial = replace(
            memory.copy(), S=wide, buffer_S=np.zeros((*memory.buffers.shape, wide.shape[1]))
        )
        shown = _Course(
            self,
            self.simulator,
            np.concatenate([np.zeros(first), memory.x]),
            np.eye(first + nx, nx, -first),
            p,
            none,
        )
        shown.read()
        inside = replace(memory.copy(), x=shown.x)
        rates = self.around.rate_matrix(inside, u, p, period_s=period_s, time_s=time_s) @ shown.S
        self.run(trial, u[None, :], p, period_s=period_s, time_s=time_s, columns=none)
        # An equivalent rate: the simulator has no derivative in time, only the map of one
        # exchange.
        matrix = (trial.S[:nx, :nx] - np.eye(nx)) / period_s
        matrix[self.simulated :] = rates[first + self.simulated :]
        return matrix

    def exchange_matrix(
        self, memory: Memory, u: Array, p: Array, *, period_s: float, time_s: float = 0.0
    ) -> Array:
        """The part of `rate_matrix` that goes through the exchanges, by which their length is
        chosen. Motion within an exchange, such as an impact, is left to the simulator's own step.
        """
        matrix = self.rate_matrix(memory, u, p, period_s=period_s, time_s=time_s)
        if isinstance(self.simulator, Carrier):
            return matrix
        around = self.around.driver(memory.copy(), u[None, :], p, None, None, self.readings)
        inside = around.arrays.x
        course = _Course(self, self.simulator, inside, around.arrays.S, p, None)
        course.read()
        x = inside[course.part].copy()
        times = (time_s, period_s, Stepping())
        f = around.step(0, 0, times, memory.begin, memory.join)[0][len(self.outputs) :]
        none = np.zeros(0, np.intp)
        alone = slopes_of(self.simulator, x, f, course.simulator_p, period_s, none, none).by_state
        n = self.simulated
        matrix[:n, :n] -= (alone[self.readings :] - np.eye(n)) / period_s
        return matrix


@dataclass(eq=False)
class _Course:
    """The simulator's part of a run: it moves readings and states on in x (first of all there), and
    their rows of S."""

    program: SteppedProgram
    simulator: Simulator
    x: Array
    S: Array
    p: Array
    columns: NDArray[np.int64] | None
    known: KnownSlopes | None = None
    level: Array = field(default_factory=lambda: np.zeros(0))  # of the known slopes, along the run

    def __post_init__(self) -> None:
        q = self.program
        self.simulator_p = np.ascontiguousarray(self.p[: q.simulator_parameters], float)
        self.part = slice(q.readings, q.readings + q.simulated)
        self.both = slice(0, q.readings + q.simulated)
        none = np.zeros(0, np.intp)
        wanted = (
            none
            if self.columns is None
            else np.flatnonzero(self.columns[: q.simulator_parameters] >= 0)
        )
        self.chosen = wanted
        self.places = none if self.columns is None else self.columns[wanted]

    def read(self) -> None:
        """Readings of the state that a run begins with."""
        q = self.program
        if not q.readings:
            return
        x, chosen = self.x[self.part], self.chosen
        moved = len(x) + len(chosen) if self.columns is not None else 0
        xs, ps = np.tile(x, (1 + moved, 1)), np.tile(self.simulator_p, (1 + moved, 1))
        tiny = np.abs(self.simulator_p[chosen])
        by = DIFFERENCE * np.concatenate(
            [np.maximum(np.abs(x), self.simulator.sizes[0]), tiny + (tiny == 0.0)]
        )
        if moved:
            xs[1 + np.arange(len(x)), np.arange(len(x))] += by[: len(x)]
            ps[1 + len(x) + np.arange(len(chosen)), chosen] += by[len(x) :]
        readings = self.simulator.reads(xs, ps)
        self.x[: q.readings] = readings[0]
        if moved:
            slopes = (readings[1:] - readings[0]).T / by
            self.S[: q.readings] = slopes[:, : len(x)] @ self.S[self.part]
            self.S[: q.readings, self.places] += slopes[:, len(x) :]

    def step(self, row: int, f: Array, by: Array, h: float) -> None:
        """One exchange of h seconds, the row-th of the run, under f (forces), whose sensitivities
        are `by` (forces, columns)."""
        step = Differences(self.simulator, self.x[self.part], f, self.simulator_p, h)
        if self.columns is None:
            self.x[self.both], _ = self._after(row, step)
            return
        after, by_state, by_force, by_parameter = self._slopes(
            row, step, np.asarray(by.any(axis=1))
        )
        rows = by_state @ self.S[self.part] + by_force @ by
        rows[:, self.places] += by_parameter
        self.S[self.both] = rows
        self.x[self.both] = after

    def _slopes(self, row: int, step: Differences, pushed: NDArray[np.bool_]) -> Slopes:
        """Slopes by the states, by the forces that a free parameter moves (zero by the others), and
        by the chosen parameters. Known slopes are reused where they hold."""
        known, x, f = self.known, step.x, step.f
        if known is None or not known.filled[row]:
            slopes = self._worked_out(step, pushed)
            if known is not None:
                known.counts[0] += 1
                known.pushed[row] = pushed
                known.keep(row, x, f, self.simulator_p, slopes.after, np.hstack(slopes[1:]))
            return slopes
        lacking = known.lacking(row, f, pushed)
        if lacking.any():
            known.pushed[row] |= lacking
            at = len(x) + np.flatnonzero(lacking)
            known.slopes[row][:, at] = step.slopes(at)
        after, predicted = self._after(row, step)
        moves, acts = known.hold(row, x, f, self.simulator_p, after, self.level)
        if not acts:
            known.counts[2] -= predicted
            after = step.after
            known.keep(row, x, f, self.simulator_p, after, self._probed(row, step, moves))
        else:
            known.counts[1] += 1
        return Slopes(after, *known.parts(row, self.simulator_p))

    def _worked_out(self, step: Differences, pushed: NDArray[np.bool_]) -> Slopes:
        forces = np.flatnonzero(pushed)
        narrow = slopes_of(step.simulator, step.x, step.f, step.p, step.h, self.chosen, forces)
        by_force = np.zeros((len(narrow.after), len(pushed)))
        by_force[:, forces] = narrow.by_force
        return narrow._replace(by_force=by_force)

    def _probed(self, row: int, step: Differences, moves: bool) -> Array:
        """Slopes of a row for a step where they are in doubt; moves: those by parameters alone."""
        known, nx, nf = self.known, len(step.x), len(step.f)
        assert known is not None
        pushed = np.flatnonzero(known.pushed[row])
        places = np.concatenate([np.arange(nx), nx + pushed])
        by_parameter = nx + nf + np.arange(len(self.chosen))  # columns of the table
        slopes = known.scaled(row, self.simulator_p)
        chosen = nx + nf + self.chosen  # places of a step
        if not (moves or step.agree(places, slopes[:, places], PROBED)):
            both = step.slopes(np.concatenate([places, chosen]))
            slopes[:, places], slopes[:, by_parameter] = np.split(both, [len(places)], axis=1)
            known.counts[0] += 1
            return slopes
        far = known.far(row, self.simulator_p)[self.chosen]
        if far.any():
            slopes[:, by_parameter[far]] = step.slopes(chosen[far])
        fails = len(by_parameter) > 0 and not step.agree(chosen, slopes[:, by_parameter], PROBED)
        if fails:
            slopes[:, by_parameter] = step.slopes(chosen)
        known.counts[0 if fails or far.any() else 1] += 1
        return slopes

    def _after(self, row: int, step: Differences) -> tuple[Array, bool]:
        """Readings and states behind a step, and whether it was predicted."""
        known, x, f = self.known, step.x, step.f
        if known is not None:
            predicted = known.predict_step(row, x, f, self.simulator_p, self.level)
            if predicted is not None:
                known.counts[2] += 1
                return predicted, True
            known.check(row, x, f, self.simulator_p, step.after, self.level)
        return step.after, False

    def in_c(
        self,
        around: StepDriver,
        memory: Memory,
        times: tuple[float, float, Stepping],
        Y: Array,
        JY: Array,
    ) -> int | None:
        """The whole run in one compiled loop, as `SteppedProgram.run` makes it; the first sample at
        which it blew up, or -1. None where the simulator is no function of a library."""
        time_s, period_s, stepping = times
        n, tiny = len(self.chosen), np.abs(self.simulator_p[self.chosen])
        by = DIFFERENCE * (tiny + (tiny == 0.0))
        # Models of the library are costly to make, so that all that a run may need are made before
        # it begins.
        p = np.tile(self.simulator_p, (3 + 2 * n if n else 1, 1))
        if n:
            p[1 + np.arange(n), self.chosen] += by
            p[1 + n, self.chosen] -= by
            p[2 + n + np.arange(n), self.chosen] -= THIN * by
            p[2 + 2 * n, self.chosen] -= PROBED * by
        with self.simulator.in_c(p, period_s / stepping.substeps) as c:
            if c is None:
                return None
            from pamid.engine.integrator import Times
            from pamid.engine.stepped_kernel import SteppedInC, stepped_sweep

            bad = stepped_sweep(
                around.equations,
                around.arrays,
                around.inputs,
                Times(
                    float(time_s),
                    float(period_s),
                    stepping.substeps,
                    stepping.implicit,
                    memory.begin,
                    memory.join,
                    -1,
                ),
                around.results,
                SteppedInC(
                    c.step,
                    c.data,
                    c.models,
                    c.count,
                    c.state_at,
                    c.force_at,
                    c.cleared_at,
                    c.reading_at,
                    c.leads_at,
                    *self.simulator.sizes,
                    by,
                    np.asarray(self.places, np.int64),
                    DIFFERENCE,
                    THIN,
                    SIDES_AGREE,
                    SLOPE_ROUNDING,
                    PROBED,
                ),
                self._known_in_c(),
                Y,
                JY,
            )
        memory.begin = memory.join = False
        return int(bad)

    def _known_in_c(self) -> KnownInC:
        from pamid.engine.stepped_kernel import KnownInC

        q = self.program
        t = self.known or KnownSlopes.none(
            (q.readings, q.simulated, q.forces, q.simulator_parameters)
        )
        rows = t.filled, t.x, t.f, t.p, t.after, t.slopes, t.pushed, t.last, t.last_after, t.trust
        limits = STILL_HOLDS, FAR, SLOPE_ROUNDING, t.prediction_limit
        return KnownInC(*rows, t.chosen, t.counts, self.simulator_p, self.level, *limits)

    def keep(self, memory: Memory) -> None:
        """All that a run carries on stands in the memory's arrays."""

    @property
    def finite(self) -> bool:
        return bool((np.abs(self.x) < BLOWN_UP).all())
