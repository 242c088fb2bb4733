"""Recordings in, trajectories out: input tables, integration steps, free runs, virtual rigs, sizes
at the ports."""

from __future__ import annotations

import hashlib
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import DataError
from pamid.base.units import from_si, size_to_si, split_column
from pamid.engine.lane_program import LaneProgram
from pamid.engine.program import Memory, Program, Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.symbolic.expression import symbol
from pamid.engine.symbolic.vocabulary import Expr
from pamid.model.assembly import Assembly
from pamid.model.bound_parameter import TRAVEL, TRAVELLED, Sizes
from pamid.model.executable import Executable
from pamid.recording.recording import Recording
from pamid.simulation.rig_data import Data, data_of

# |eigenvalue| x step up to which the explicit step is used: accurate, and two thirds of where the
# classical Runge-Kutta method becomes unstable (2.79 on the real axis, 2.83 on the imaginary axis)
STEADY = 1.8
MOST_SUBSTEPS = 16  # beyond, the implicit step is cheaper; below, it errs a hundred times as much
LOOKED_AT = 3000  # samples along which it is looked for
KEPT_CHOICES = 16
_CHOSEN: dict[tuple[Hashable, ...], Stepping] = {}


def known_values(assembly: Assembly, known: dict[str, float]) -> tuple[Array, list[int]]:
    """Parameter vector with the known values of a recording, and their places."""
    return assembly.values(known), [assembly.index_of(name) for name in known]


def choose_stepping(assembly: Assembly, u: Array, p: Array, period_s: float, x: Array) -> Stepping:
    """Steps per sample from the spectral radius of df/dx (of what steps by itself: of what is
    exchanged with it) along a robust run of the first seconds. The last few choices are kept: the
    checks of a recording and the begin of its fit ask the same of the same equations."""
    if not isinstance(assembly.program, Program):
        return _chosen_stepping(assembly, u, p, period_s, x)
    t = assembly.traced
    equations = tuple(t.rates.items()), t.cells, t.inputs, t.linear, tuple(assembly.keys)
    arrays = tuple(np.asarray(a, float).tobytes() for a in (u[: LOOKED_AT + 1], p, x))
    key = (equations, hashlib.blake2b(b"|".join(arrays)).digest(), u.shape, period_s)
    if key not in _CHOSEN:
        while len(_CHOSEN) >= KEPT_CHOICES:
            _CHOSEN.pop(next(iter(_CHOSEN)), None)
        _CHOSEN[key] = _chosen_stepping(assembly, u, p, period_s, x)
    return _CHOSEN[key]


def _chosen_stepping(assembly: Assembly, u: Array, p: Array, period_s: float, x: Array) -> Stepping:
    program = assembly.program
    careful = Stepping(2, implicit=True)
    memory = program.memory(x, stepping=careful, period_s=period_s)
    fastest = 0.0
    block = max(1, min(len(u), LOOKED_AT) // 40)
    inputs = SampledInputs(u, period_s)
    for i in range(0, min(len(u), LOOKED_AT), block):
        matrix = (
            program.exchange_matrix(memory, u[i], p, period_s=period_s, time_s=i * period_s)
            if i
            else None
        )
        if matrix is not None and np.isfinite(matrix).all():
            fastest = max(fastest, float(np.abs(np.linalg.eigvals(matrix)).max(initial=0.0)))
        if program.run(memory, inputs.part(i, i + block), p, stepping=careful)[2] >= 0:
            break
    return _stepping_for(fastest, period_s, program)


def _stepping_for(fastest: float, period_s: float, program: Executable | LaneProgram) -> Stepping:
    """Steps per sample for a largest |eigenvalue| of df/dx."""
    needed = int(2 ** np.ceil(np.log2(max(1.0, fastest * period_s / STEADY))))
    needed = max(needed, program.least_substeps(period_s))
    return Stepping(needed) if needed <= MOST_SUBSTEPS else program.careful(needed)


def choose_steppings(
    lanes: LaneProgram, u: Array, p: Array, period_s: float, x: Array
) -> list[Stepping]:
    """`choose_stepping` of several runs of the same equations, side by side: u (samples, inputs,
    lanes), p (parameters, lanes), x (states, lanes)."""
    careful = Stepping(2, implicit=True)
    memory = lanes.memory(x, stepping=careful, period_s=period_s)
    fastest, running = np.zeros(x.shape[1]), np.ones(x.shape[1], bool)
    block = max(1, min(len(u), LOOKED_AT) // 40)
    inputs = SampledInputs(u, period_s)
    for i in range(0, min(len(u), LOOKED_AT), block):
        if i:
            time = i * period_s
            matrices = lanes.exchange_matrices(memory, u[i], p, period_s=period_s, time_s=time)
            for lane in np.flatnonzero(running & np.isfinite(matrices).all(axis=(1, 2))):
                radius = np.abs(np.linalg.eigvals(matrices[lane])).max(initial=0.0)
                fastest[lane] = max(fastest[lane], float(radius))
        _, bad = lanes.run(memory, inputs.part(i, i + block), p, stepping=careful)
        running &= bad < 0
    return [_stepping_for(f, period_s, lanes) for f in fastest.tolist()]


@dataclass(frozen=True)
class FreeRun:
    """Outputs of a run (samples x outputs, SI) and their names; `blown_up` is the first sample
    without a finite state, or -1; further: the columns of further outputs."""

    outputs: Array
    blown_up: int
    memory: Memory
    names: tuple[str, ...]
    further: Array


def free_run(
    assembly: Assembly,
    u: Array,
    p: Array,
    period_s: float,
    *,
    start: Array | None = None,
    stepping: Stepping | None = None,
    further: Mapping[str, Expr] | None = None,
) -> FreeRun:
    """Simulate from `start` (default: the rig's) over the inputs u (samples x inputs).

    further: values by name that are the last columns of the outputs.
    """
    x = assembly.start(p) if start is None else start
    step = stepping or choose_stepping(assembly, u, p, period_s, x)
    program = assembly.program_with(dict(further)) if further else assembly.program
    memory = program.memory(x, stepping=step, period_s=period_s)
    outputs, _, bad = program.run(memory, SampledInputs(u, period_s), p, stepping=step)
    names = program.outputs
    return FreeRun(outputs, bad, memory, names, outputs[:, len(names) - len(further or ()) :])


def virtual_recording(
    assembly: Assembly,
    excitation: Recording,
    p: Array,
    *,
    noise: float = 1.0,
    seed: int = 0,
    fineness: int = 4,
) -> dict[str, Array]:
    """Simulate the recording of a rig with these effects: columns in their units.

    Sensor noise is white with the rig's standard deviations times `noise`; in a closed loop the
    controller sees it. Integrated with `fineness` times the steps that a fit would take.
    """
    rig, period = assembly.rig, excitation.sampling_period_s
    jitter = sensor_noise(assembly, len(excitation), noise, seed)
    u = noisy_inputs(data_of(rig, excitation).inputs(assembly), assembly.traced.inputs, jitter)
    extra = _loop_commands(assembly)
    step = choose_stepping(assembly, u, p, period, assembly.start(p))
    step = replace(step, substeps=step.substeps * fineness)
    run = free_run(assembly, u, p, period, stepping=step, further=extra)
    if run.blown_up >= 0:
        raise DataError(
            f"the virtual rig {rig.name!r} became unstable at {run.blown_up * period:.3f} s",
            "lower the amplitude, or correct the parameters of the effects",
        )
    columns = dict(excitation.columns)
    for i, name in enumerate(run.names):
        clean = from_si(run.outputs[:, i], split_column(name)[1])
        columns[name] = clean if name in extra else clean + jitter[name]
    return columns


def noiseless_recordings(
    assembly: Assembly, excitations: Sequence[Recording], p: Array
) -> list[dict[str, Array] | None]:
    """Columns of `virtual_recording` without noise, of excitations of equal length and period,
    simulated side by side; None for an excitation at which the rig becomes unstable.

    p: (parameters, excitations).
    """
    period, extra = excitations[0].sampling_period_s, _loop_commands(assembly)
    lanes = assembly.lane_program_with(extra)
    u = np.stack([data_of(assembly.rig, r).inputs(assembly) for r in excitations], axis=2)
    begun = [assembly.begin(q) for q in p.T]
    x = np.array([[begin.get(name, 0.0) for begin in begun] for name in lanes.states])
    x = x.reshape(len(lanes.states), len(excitations))
    steppings = choose_steppings(lanes, u, p, period, x)
    out: list[dict[str, Array] | None] = [None] * len(excitations)
    for stepping in dict.fromkeys(steppings):
        chosen = [k for k, s in enumerate(steppings) if s == stepping]
        memory = lanes.memory(x[:, chosen], stepping=stepping, period_s=period)
        Y, bad = lanes.run(
            memory, SampledInputs(u[:, :, chosen], period), p[:, chosen], stepping=stepping
        )
        for lane, k in enumerate(chosen):
            if bad[lane] < 0:
                read = {
                    name: from_si(Y[:, i, lane], split_column(name)[1])
                    for i, name in enumerate(lanes.outputs)
                }
                out[k] = excitations[k].columns | read
    return out


def _loop_commands(assembly: Assembly) -> dict[str, Expr]:
    """Commands of the controllers of a closed loop, as further outputs."""
    commands = [loop.command for loop in assembly.rig.loops] if assembly.controller else []
    return {c: symbol("cell", c) for c in commands}


def sensor_noise(assembly: Assembly, samples: int, noise: float, seed: int) -> dict[str, Array]:
    """White noise on every output, in the column's unit, with the rig's standard deviations times
    `noise`."""
    rig, random = assembly.rig, np.random.default_rng(seed)
    return {
        name: noise * rig.noise.get(name, 0.0) * random.standard_normal(samples)
        for name in rig.outputs
    }


def noisy_inputs(u: Array, names: tuple[str, ...], jitter: dict[str, Array]) -> Array:
    """u with the noise that a controller in the model sees, in place."""
    for i, name in enumerate(names):
        if name.startswith("noise_"):
            reading = name.removeprefix("noise_")
            u[:, i] = size_to_si(jitter[reading], split_column(reading)[1])
    return u


def port_probes(assembly: Assembly) -> dict[tuple[str, str, str], Expr]:
    """Every value and signal at every port whose size the rig does not declare itself: (port,
    place and port in a single word, signal) -> expression."""
    return {
        (passage.port, passage.where, name): value
        for passage in assembly.traced.passages
        for name, value in (("value", passage.value), *passage.signals)
        if isinstance(value, Expr) and name not in assembly.rig.ports[passage.port].size
    }


def sizes_of(probes: Sequence[tuple[str, str, str]], tables: Sequence[Array]) -> Sizes:
    """Magnitude (95th percentile of |signal|) by port and signal, the largest of its places and of
    these tables (each samples x probes); what never differs from zero is left out. Next to that of
    a position half of its travel (between the percentiles 2.5 and 97.5: the same where it goes to
    and fro about its zero), which is the same wherever it is counted from."""
    sizes: Sizes = {}
    for table in tables:
        for (port, _, name), column in zip(probes, table.T, strict=True):
            if not len(column):
                continue
            low, high = np.percentile(column, (2.5, 97.5))
            largest = {name: float(np.percentile(np.abs(column), 95.0))}
            if name == TRAVELLED:
                largest[TRAVEL] = 0.5 * float(high - low)
            for signal, size in largest.items():
                if np.isfinite(size) and size > 0.0:
                    sizes[port, signal] = max(sizes.get((port, signal), 0.0), size)
    return sizes


def longest_time(durations_s: Sequence[float]) -> Sizes:
    """The duration of the longest recording, of which the duration of a drift is a multiple."""
    return {("", "time"): max(durations_s, default=0.0)}


def port_sizes(assembly: Assembly, runs: list[tuple[Array, Array, float]]) -> Sizes:
    """Sizes at every port over free runs (u, p, period) from the rig's start, and the longest
    run's duration: all that is known before anything was measured."""
    probes = port_probes(assembly)
    time = longest_time([len(u) * period for u, _, period in runs])
    if not probes:
        return time
    further = {f"{where}.{n}": x for (_, where, n), x in probes.items()}
    tables = []
    for u, p, period in runs:
        run = free_run(assembly, u, p, period, further=further)
        tables.append(run.further[: run.blown_up] if run.blown_up >= 0 else run.further)
    return time | sizes_of(list(probes), tables)


def state_spread(assembly: Assembly, recording: Data) -> Array:
    """Standard deviation of each of the rig's states over a free run on the recorded inputs (SI);
    infinite where the run has no time scale: a state that runs away or does not move."""
    p, _ = known_values(assembly, recording.known)
    states = {f"state.{s.name}": symbol("state", s.name) for s in assembly.rig.states}
    u, period = recording.inputs(assembly), recording.sampling_period_s
    run = free_run(assembly, u, p, period, further=states)
    spread = run.further.std(axis=0) if run.blown_up < 0 else np.zeros(len(states))
    return np.where(np.isfinite(spread) & (spread > 0.0), spread, np.inf)
