"""A model of two parts: a simulator that steps by itself, and compiled equations around it.

The equations get the states and readings of the simulator, and return its forces. At the start of
every exchange, of length h,

    f_k      = F(x_k, r_k, z_k, u_k, p)     the equations; they move their states z and cells on
    x_(k+1)  = step(x_k, f_k, p, h)         the simulator, with f held
    r_(k+1)  = read(x_(k+1), p)

States of the simulator and readings are states of the equations with a rate of zero, set anew after
every exchange. The driver of compiled equations (`pamid.engine.integrator`) therefore serves the
equations unchanged, sensitivities included. Sensitivities of the whole follow by the chain rule
from the slopes of the step. These are finite differences over copies of the simulator that lie
across no jump (`slopes_of`), so that the sensitivities are those of the
recursion as it was computed.

Forces are held over h, so that the method is of order 1 in h for external forces. Coupled
explicitly, a damping c on a mass m needs h below 2 m/c (Kuebler and Schiehlen 2000, Mathematical
and Computer Modelling of Dynamical Systems 6(2), 93-113).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.known_slopes import KnownSlopes
from pamid.engine.program import Memory, Program, RunParts, SimulatedWindow, Stepping, WindowStarts
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.shadow_simulators import BLOWN_UP, Carrier, ShadowCourse
from pamid.engine.simulator import (
    DIFFERENCE,
    Simulator,
    Slopes,
    StepScales,
    library_step,
    moved_parameters,
)

MOST_EXCHANGES = 64  # per sample


class Course(NamedTuple):
    """Arguments of a run in another process; see `Program.run`."""

    inputs: SampledInputs
    p: Array
    stepping: Stepping
    columns: NDArray[np.int64] | None
    weights: Array | None


class FarRunner(Protocol):
    """A process in which a simulator lives, and where whole runs are made."""

    def run_there(
        self, program: SteppedProgram, memory: Memory, course: Course
    ) -> tuple[Array, Array, int]:
        """See `SteppedProgram.run`."""


@dataclass(frozen=True, eq=False)
class SteppedProgram:
    """The two parts combined; used as a `pamid.engine.program.Program` is.

    around     the equations: their states are readings, states of the simulator, those of the
               equations, in this order; their last outputs go into the simulator
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
    def keeps_slopes(self) -> bool:
        """See `Program`. False for hidden states, which cannot be set, and for a simulator in
        another process."""
        return not isinstance(self.simulator, Carrier) and self.far is None

    def room(self, samples: int, substeps: int, columns: NDArray[np.int64]) -> KnownSlopes | None:
        """See `Program`. None also for a table that would be too large."""
        if not self.keeps_slopes:
            return None
        chosen = np.flatnonzero(columns[: self.simulator_parameters] >= 0)
        return KnownSlopes.room(samples, substeps, self._sizes, chosen)

    @property
    def _sizes(self) -> tuple[int, int, int, int]:
        return self.readings, self.simulated, self.forces, self.simulator_parameters

    def with_slopes(self, known: KnownSlopes | None) -> SteppedProgram:
        """See `Program`."""
        return replace(self, known=known)

    def least_substeps(self, period_s: float) -> int:
        """Least exchanges per sample of the simulator."""
        return max(1, int(np.ceil(period_s / self.simulator.longest_s - 1e-9)))

    def careful(self, substeps: int) -> Stepping:
        """Stepping where more exchanges are needed than an explicit step would take. The simulator
        has no implicit step, so that all of them are made; the equations' states are solved
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
        inputs: SampledInputs,
        p: Array,
        *,
        stepping: Stepping | None = None,
        columns: NDArray[np.int64] | None = None,
        weights: Array | None = None,
    ) -> tuple[Array, Array, int]:
        """See `Program.run`."""
        step = stepping or Stepping()
        if self.far is not None:
            return self.far.run_there(self, memory, Course(inputs, p, step, columns, weights))
        wide, seen = memory.S.shape[1], len(self.outputs)
        Y = np.empty((len(inputs), seen))
        JY = np.empty((1, 1, 0) if columns is None else (len(inputs), seen, wide))
        columns = None if wide == 0 else columns
        around = self.around.driver(memory, inputs, p, columns, self.readings)
        times = inputs.time_s, inputs.period_s, step
        run = self._run_copies if isinstance(self.simulator, Carrier) else self._run_compiled
        bad = run(memory, around, p, columns, times, Y, JY)
        memory.begin = memory.join = False
        # Slopes near a state that has blown up hold nowhere else.
        if bad >= 0 and columns is not None and self.known is not None:
            self.known.forget()
        memory.x[:] = around.arrays.x[self.readings :]
        if columns is not None:
            memory.S[:] = around.arrays.S[self.readings :]
            if weights is not None:
                JY *= weights[:, None]
        return Y, JY, bad

    def _run_copies(
        self,
        memory: Memory,
        around: RunParts,
        p: Array,
        columns: NDArray[np.int64] | None,
        times: tuple[float, float, Stepping],
        Y: Array,
        JY: Array,
    ) -> int:
        """Run with shadow copies; the first sample at which a state is no longer finite, or -1."""
        assert isinstance(self.simulator, Carrier)
        x, S, seen = around.arrays.x, around.arrays.S, Y.shape[1]
        course = ShadowCourse(self.simulator, memory, x, S, p, columns, self.simulator_parameters)
        course.read()
        time_s, period_s, step = times
        parts, bad = 1 if self.whole else step.substeps, -1
        times = time_s, period_s, replace(step, substeps=parts)
        for k in range(len(Y)):
            for sub in range(parts):
                first = memory.begin, memory.join
                values, slopes = around.step(k, sub, times, first)
                memory.begin = memory.join = False
                if sub == 0:
                    Y[k] = values[:seen]
                    if columns is not None:
                        JY[k] = slopes[:seen]
                course.step(values[seen:], slopes[seen:], period_s / parts)
            if not (np.abs(x) < BLOWN_UP).all():
                bad = k
                Y[k + 1 :] = np.nan
                if columns is not None:
                    JY[k + 1 :] = np.nan
                break
        course.keep(memory)
        return bad

    def _run_compiled(
        self,
        memory: Memory,
        around: RunParts,
        p: Array,
        columns: NDArray[np.int64] | None,
        times: tuple[float, float, Stepping],
        Y: Array,
        JY: Array,
    ) -> int:
        """As `_run_copies`, of a simulator whose states are seen, in a compiled loop."""
        assert not isinstance(self.simulator, Carrier)
        from pamid.engine.integrator import Times
        from pamid.engine.stepped_kernel import Exchange, stepped_sweep

        time_s, period_s, step = times
        self._read_start(around.arrays.x, around.arrays.S, p, columns)
        parameters, chosen = self._simulator_values(p, columns)
        known = self.known
        if known is None or not (columns is None or known.is_by(chosen)):
            known = KnownSlopes.none(self._sizes)
        # Models of a library are costly to make, so that all that a run may need are made before it
        # begins.
        copies, by = moved_parameters(parameters, chosen)
        places = np.zeros(0, np.int64) if columns is None else np.asarray(columns[chosen], np.int64)
        scales = StepScales(DIFFERENCE, *self.simulator.sizes, by, places, parameters, known.level)
        run_times = Times(
            float(time_s),
            float(period_s),
            step.substeps,
            step.implicit,
            memory.begin,
            memory.join,
            -1,
        )
        with library_step(self.simulator, copies, period_s / step.substeps, self.readings) as c:
            return int(
                stepped_sweep(
                    *around[:3], run_times, around.results, Exchange(c, scales, known), (Y, JY)
                )
            )

    def _simulator_values(
        self, p: Array, columns: NDArray[np.int64] | None
    ) -> tuple[Array, NDArray[np.intp]]:
        """Parameters of the simulator, and the places of those with a sensitivity."""
        n = self.simulator_parameters
        none = np.zeros(0, np.intp)
        chosen = none if columns is None else np.flatnonzero(columns[:n] >= 0)
        return np.ascontiguousarray(p[:n], float), chosen

    def _read_start(self, x: Array, S: Array, p: Array, columns: NDArray[np.int64] | None) -> None:
        """Write the readings of the state that a run begins with, and their rows of S."""
        assert not isinstance(self.simulator, Carrier)
        if not self.readings:
            return
        values, chosen = self._simulator_values(p, columns)
        part = slice(self.readings, self.readings + self.simulated)
        state = x[part]
        n = len(state)
        moved = n + len(chosen) if columns is not None else 0
        states, parameters = np.tile(state, (1 + moved, 1)), np.tile(values, (1 + moved, 1))
        size = np.abs(values[chosen])
        by = DIFFERENCE * np.concatenate(
            [np.maximum(np.abs(state), self.simulator.sizes[0]), size + (size == 0.0)]
        )
        if moved:
            states[1 + np.arange(n), np.arange(n)] += by[:n]
            parameters[1 + n + np.arange(len(chosen)), chosen] += by[n:]
        readings = self.simulator.reads(states, parameters)
        x[: self.readings] = readings[0]
        if columns is not None:
            slopes = (readings[1:] - readings[0]).T / by
            S[: self.readings] = slopes[:, :n] @ S[part]
            S[: self.readings, columns[chosen]] += slopes[:, n:]

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
        """See `Program.run_windows`; slopes that are kept are those of the whole recording."""
        n, known = windows.states.shape[1], self.known
        for (start, stop), x in zip(windows.edges.tolist(), windows.states, strict=True):
            memory.enter(x, windows.column)
            program = self.with_slopes(known.part(start, stop)) if known else self
            Y, JY, bad = program.run(
                memory,
                inputs.part(start, stop),
                p,
                stepping=stepping,
                columns=columns,
                weights=weights,
            )
            fine = bad < 0 and bool(np.isfinite(Y).all())
            yield SimulatedWindow(Y, JY, memory.x.copy(), memory.S[:n].copy(), fine)

    @property
    def whole(self) -> bool:
        """Whether a sample is a single exchange under any stepping."""
        return isinstance(self.simulator, Carrier) and self.simulator.whole_samples

    def rate_matrix(
        self, memory: Memory, u: Array, p: Array, *, period_s: float, time_s: float = 0.0
    ) -> Array:
        """Equivalent of df/dx (nx x nx): the Jacobian of the equations' states, and (A - I)/h
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
        x, S = np.concatenate([np.zeros(first), memory.x]), np.eye(first + nx, nx, -first)
        self._read_start(x, S, p, none)
        inside = replace(memory.copy(), x=x)
        rates = self.around.rate_matrix(inside, u, p, period_s=period_s, time_s=time_s) @ S
        self.run(trial, SampledInputs(u[None, :], period_s, time_s), p, columns=none)
        # An equivalent rate: the simulator has no derivative in time, only the map of an
        # exchange.
        matrix = (trial.S[:nx, :nx] - np.eye(nx)) / period_s
        matrix[self.simulated :] = rates[first + self.simulated :]
        return matrix

    def exchange_matrix(
        self, memory: Memory, u: Array, p: Array, *, period_s: float, time_s: float = 0.0
    ) -> Array:
        """The part of `rate_matrix` that goes through the exchanges, by which their length is
        chosen. Motion within an exchange, such as an impact, is left to the simulator's step.
        """
        matrix = self.rate_matrix(memory, u, p, period_s=period_s, time_s=time_s)
        if isinstance(self.simulator, Carrier):
            return matrix
        around = self.around.driver(
            memory.copy(), SampledInputs(u[None, :], period_s), p, None, self.readings
        )
        inside, n = around.arrays.x, self.simulated
        self._read_start(inside, around.arrays.S, p, None)
        x, (parameters, none) = (
            inside[self.readings : self.readings + n].copy(),
            self._simulator_values(p, None),
        )
        times = time_s, period_s, Stepping()
        f = around.step(0, 0, times, (memory.begin, memory.join))[0][len(self.outputs) :]
        alone = slopes_of(self.simulator, x, f, parameters, period_s, none, none).by_state
        matrix[:n, :n] -= (alone[self.readings :] - np.eye(n)) / period_s
        return matrix


def slopes_of(
    simulator: Simulator,
    x: Array,
    f: Array,
    p: Array,
    h: float,
    chosen: NDArray[np.intp],
    pushed: NDArray[np.intp] | None = None,
) -> Slopes:
    """Slopes of a step of h seconds by forward differences over copies. chosen: places of
    parameters; pushed: of forces, all without it (the slopes by others are zero).

    A further copy has everything moved to the other side. Where the slopes do not predict it, a
    jump lies between, as where a contact closes. A difference across it is the jump over the
    arbitrary width of the difference. Such slopes are computed on the other side as well, as near
    as rounding allows. The smaller action of the two is taken, as by the minmod limiter (Roe
    (1986), Annu. Rev. Fluid Mech. 18, 337-365).
    """
    from pamid.engine.stepped_kernel import step_slopes

    nx, nf = len(x), len(f)
    moves = np.ones(nf, bool) if pushed is None else np.isin(np.arange(nf), pushed)
    copies, by = moved_parameters(p, chosen)
    readings = simulator.reads(x[None], p[None]).shape[1]
    after = np.empty(readings + nx)
    slopes = np.zeros((len(after), nx + nf + len(chosen)))
    places = np.zeros(len(chosen), np.int64)
    scales = StepScales(DIFFERENCE, *simulator.sizes, by, places, p, np.zeros(0))
    with library_step(simulator, copies, h, readings) as c:
        step_slopes(c, scales, np.array(x), np.array(f), moves, after, slopes)
    return Slopes(after, *np.split(slopes, [nx, nx + nf], axis=1))
