"""Comparison of a recording with the data sheet's run on its commands.

Similarity is judged whatever the levels, units and trends. A data sheet is off by a lot, but not in
its signs or by orders of magnitude. Shapes are compared block by block without level and trend,
because an integrator drifts away with the best of data sheets.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from pamid.base.arrays import Array
from pamid.base.units import quantity_of, split_column
from pamid.model.assembly import Assembly
from pamid.model.rig import Rig
from pamid.model.step_rig import StepRig
from pamid.recording.noise import noise_level
from pamid.recording.recording import Recording, match_column
from pamid.simulation.free_runs import choose_stepping, free_run, known_values
from pamid.simulation.initial_state import WindowStart
from pamid.simulation.rig_data import data_of
from pamid.simulation.tracks import track_of
from pamid.simulation.windows import Runner, Window

MOST_COMPARED_SAMPLES = 20000
CORRELATION_BLOCKS = 20
OPENING_SAMPLES = 64  # readings that determine the start state
LEAST_NOISE = 1e-4  # of a reading's standard deviation
CROSSES = 0.2  # of its range: a reading beyond zero, whatever its noise
BLIND_NOISE = 5.0  # times the noise: overshoot of a one-sided reading beyond zero
BLIND_SHARE = 0.1  # share of the time with the model on the side without readings


@dataclass(frozen=True, eq=False)
class SheetComparison:
    """Recording and the data sheet's run on its commands; SI.

    names, inputs   outputs and inputs of the rig
    y, u            as measured (samples x columns)
    model           outputs of the run (NaN from where it diverges)
    simulate        outputs at other inputs, other parameters (default: p) and a clock that runs
                    slower by a factor; None if they diverge
    follow          the same over a number of samples of the recorded inputs, from the state of the
                    first readings, up to where they diverge; None if they do so at once
    """

    names: tuple[str, ...]
    inputs: tuple[str, ...]
    y: Array
    u: Array
    model: Array
    simulate: Callable[..., Array | None]
    follow: Callable[[Array, int], Array | None]
    assembly: Assembly
    p: Array

    @property
    def ran(self) -> bool:
        return bool(np.isfinite(self.model).all())

    @property
    def shown(self) -> Array:
        """Outputs of the run as the sensors show them; some only measure a magnitude."""
        way = magnitude_sensor_signs(self.y, self.model)
        return np.where(way == 0.0, self.model, way * np.abs(self.model))

    def agreement(self) -> Array:
        """Correlation of every output with the model."""
        ours, theirs = shapes(self.y), shapes(self.shown)
        return np.array([correlation(a, b) for a, b in zip(ours, theirs, strict=True)])


def compared_with_sheet(recording: Recording, rig: Rig) -> SheetComparison:
    """Compare the recording with the data sheet's run; PamidError if the rig cannot run on it."""
    data = data_of(rig, recording)
    names = data.measured(rig)
    assembly = Assembly(rig, outputs=names)
    p, _ = known_values(assembly, {k: v for k, v in recording.known.items() if assembly.knows(k)})
    u = data.inputs(assembly)[:MOST_COMPARED_SAMPLES]
    y = data.outputs(names)[:MOST_COMPARED_SAMPLES]
    order = [assembly.program.outputs.index(n) for n in names]
    period = recording.sampling_period_s

    # the steps are chosen once for hundreds of runs; with other values they may be too long
    steps = choose_stepping(assembly, u, p, period, assembly.start(p))
    stepped = isinstance(rig, StepRig)

    def finite_run(
        inputs: Array, values: Array, clock: float = 1.0, start: Array | None = None
    ) -> Array:
        """Outputs up to where they diverge."""
        inputs = np.ascontiguousarray(inputs)
        for stepping in (steps, None) if clock == 1.0 else (None,):
            run = free_run(assembly, inputs, values, clock * period, start=start, stepping=stepping)
            outputs = run.outputs if run.blown_up < 0 else run.outputs[: run.blown_up]
            finite = np.isfinite(outputs).all(axis=1)
            outputs = outputs if finite.all() else outputs[: finite.argmin()]
            if len(outputs) == len(inputs) or stepped:
                break
        return outputs[:, order]

    def simulate(inputs: Array, values: Array = p, clock: float = 1.0) -> Array | None:
        outputs = finite_run(inputs, values, clock)
        return outputs if len(outputs) == len(inputs) else None

    @cache
    def shown() -> Array:
        # state of the model according to the first readings, (states,)
        runner = Runner(assembly, track_of(assembly, data, names), steps)
        y, memory = runner.track.y, runner.memory(p)
        window = Window(0, min(OPENING_SAMPLES, len(y)))
        noise = np.maximum(noise_level(y), LEAST_NOISE * y.std(axis=0))
        weight = 1.0 / np.where(noise > 0.0, noise, 1.0)
        start, n = memory.x.copy(), runner.start_states
        start[:n] = WindowStart.of(runner, memory, window, p, weight, start[:n]).from_readings()
        return start

    def follow(values: Array, samples: int) -> Array | None:
        outputs = finite_run(u[:samples], values, start=shown())
        return outputs if len(outputs) >= min(OPENING_SAMPLES, len(u)) else None

    outputs = simulate(u)
    model = np.full_like(y, np.nan) if outputs is None else outputs
    inputs = tuple(assembly.traced.inputs)
    return SheetComparison(names, inputs, y, u, model, simulate, follow, assembly, p)


def same_quantity_columns(names: Sequence[str]) -> list[tuple[int, int]]:
    kinds = [quantity_of(split_column(n)[1]) for n in names]
    return [(i, j) for i, j in itertools.combinations(range(len(names)), 2) if kinds[i] == kinds[j]]


def recorded_columns(names: Sequence[str], recording: Recording) -> tuple[str, ...]:
    return tuple(match_column(recording.columns, n) or n for n in names)


def shapes(table: Array, samples: int = 0) -> Array:
    """Blocks of every column, without level and trend: (columns, blocks, samples).

    samples: length of a block, by default a share of the table.
    """
    size = min(samples or max(50, len(table) // CORRELATION_BLOCKS), len(table))
    blocks = table[: len(table) // size * size].T.reshape(table.shape[1], -1, size)
    slope = np.linspace(-1.0, 1.0, size)
    slope /= np.sqrt(slope @ slope)
    level = blocks - blocks.mean(axis=2, keepdims=True)
    return np.asarray(level - (level @ slope)[:, :, None] * slope)


def correlation(a: Array, b: Array) -> float:
    """Correlation of two arrays without level, 0 if either is constant."""
    size = math.sqrt(float((a * a).sum()) * float((b * b).sum()))
    return float((a * b).sum()) / size if size > 0.0 else 0.0


def magnitude_sensor_signs(y: Array, model: Array) -> Array:
    """Sign of each column whose sensor only measures a magnitude.

    It is 1 or -1 if the reading stays on this side of zero although the model crosses it. The
    model's magnitude must also correlate better with the reading than the model or its opposite.
    Otherwise it is 0.
    """
    both = np.minimum((model > 0.0).mean(axis=0), (model < 0.0).mean(axis=0)) >= BLIND_SHARE
    crosses = np.minimum(-y.min(axis=0), y.max(axis=0)) > CROSSES * np.ptp(y, axis=0)
    signs, possible = np.zeros(y.shape[1]), both & ~crosses
    if not possible.any():
        return signs
    y, model = y[:, possible], model[:, possible]
    edge = BLIND_NOISE * noise_level(y)
    way = np.where((y > -edge).all(axis=0), 1.0, np.where((y < edge).all(axis=0), -1.0, 0.0))
    sides = [np.mean(way * side * model > edge, axis=0) for side in (1.0, -1.0)]
    ours, theirs, sizes = shapes(y), shapes(model), shapes(np.abs(model))
    like, sized = (
        np.array([correlation(a, b) for a, b in zip(ours, other, strict=True)])
        for other in (theirs, sizes)
    )
    one_sided = (np.minimum(*sides) >= BLIND_SHARE) & (way * sized > np.abs(like))
    signs[possible] = np.where(one_sided, way, 0.0)
    return signs
