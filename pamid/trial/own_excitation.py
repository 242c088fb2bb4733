"""Excitation of a machine that is built from a rig: the columns that drive the rig, over their
usual range, as `pamid generate-aprbs` sends them."""

from __future__ import annotations

import math

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import UsageError
from pamid.engine.program import Stepping
from pamid.model.assembly import Assembly
from pamid.model.rig import Rig
from pamid.model.sampling import stated_period
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.excitation.experiments import bounds_of
from pamid.simulation.excitation.waveforms import ramps

MEAN_HOLDS = 45  # of mean length that a recording is to have,
MAX_SAMPLES = 8000  # as far as it has not more samples than these;
FEWEST_HOLDS = 20  # then holds are shortened until there are so many
SAMPLES_PER_HOLD = 40  # in the shortest hold, where the rig states no sampling period
UNSTATED = 1.0  # half range of an input of which the rig states nothing, in the unit of the input


def driven_columns(rig: Rig, loop: str) -> tuple[str, ...]:
    """The columns that are sent: references of the loops, or else their commands, and all other
    inputs that the rig needs. UsageError if there are none."""
    commands = {q.command for q in rig.loops}
    first = [q.reference if loop == "closed" else q.command for q in rig.loops]
    columns = (*first, *(c for c in rig.inputs if c not in rig.optional and c not in commands))
    if not columns:
        raise UsageError(
            f"Rig {rig.name!r} has no required input to excite.",
            "Give the inputs with --excitation.",
        )
    return columns


def runs_closed(rig: Rig) -> bool:
    """Can a controller run it over a range that the rig states?"""
    return bool(rig.loops and rig.controller) and all(
        math.isfinite(stated_reach(rig, q.reference)[1]) for q in rig.loops
    )


def runs_open(rig: Rig) -> bool:
    """Do its commands, where it has any, have a range?"""
    return all(math.isfinite(stated_reach(rig, q.command)[1]) for q in rig.loops)


def stated_reach(rig: Rig, column: str) -> tuple[float, float]:
    """Centre and half range of the usual signal, or of the allowed signal, in the column's unit;
    half is infinite if the rig states none."""
    low, high = bounds_of(rig, column)
    if column in rig.excited:
        return rig.centre.get(column, 0.0), rig.excited[column]
    if math.isfinite(low) and math.isfinite(high):
        return 0.5 * (low + high), 0.5 * (high - low)
    return rig.centre.get(column, 0.0), math.inf


def sampled(rig: Rig) -> tuple[float, float, tuple[float, float]]:
    """Sampling period, length of a recording and holds, all in s."""
    shortest, longest = rig.hold_s
    period = stated_period(rig) or shortest / SAMPLES_PER_HOLD
    mean = 0.5 * (shortest + longest)
    seconds = min(MEAN_HOLDS * mean, MAX_SAMPLES * period)
    faster = min(1.0, seconds / (FEWEST_HOLDS * mean))
    hold = (max(faster * shortest, 2.0 * period), max(faster * longest, 3.0 * period))
    return period, seconds, hold


def made_excitation(rig: Rig, loop: str, amplitude: float, seed: int) -> dict[str, Array]:
    """Columns to send, in their units; amplitude: share of the usual half range. A rig that
    integrates its input is brought back after every level, or it would drift away."""
    period, seconds, hold = sampled(rig)
    integrating = loop == "open" and integrates(rig, period, seconds)
    columns = {}
    for k, column in enumerate(driven_columns(rig, loop)):
        centre, half = stated_reach(rig, column)
        half = amplitude * (half if math.isfinite(half) else UNSTATED)
        count, stream = round(seconds / period), (seed, k)
        if integrating and column not in rig.ramped:
            wave = centre + half * _there_and_back(count, period, hold, stream)
        else:
            wave = aprbs(count * period, period, half, hold, seed=stream, offset=centre)
        low, high = bounds_of(rig, column)
        wave = np.clip(wave, low, high)
        columns[column] = ramps(wave) if column in rig.ramped else wave
    return columns


def integrates(rig: Rig, period_s: float, seconds: float) -> bool:
    """Does the rig, at rest, have a mode slower than the recording is long?"""
    if not rig.states:
        return False
    assembly = Assembly(rig)
    p = assembly.values()
    memory = assembly.program.memory(assembly.start(p), stepping=Stepping(1), period_s=period_s)
    u = np.array([stated_reach(rig, c)[0] for c in assembly.traced.inputs])
    matrix = assembly.program.rate_matrix(memory, u, p, period_s=period_s)
    return bool((np.abs(np.linalg.eigvals(matrix)) * seconds < 1.0).any())


def _there_and_back(
    count: int, period_s: float, hold_s: tuple[float, float], seed: tuple[int, int]
) -> Array:
    """Random levels in [-1, 1], each followed by its opposite for twice as long and by itself: the
    sum, and the sum of the sum, return to their start."""
    random = np.random.default_rng(seed)
    parts = [np.zeros(max(1, round(hold_s[0] / period_s)))]
    while sum(map(len, parts)) < count:
        held, level = max(1, round(random.uniform(*hold_s) / period_s)), random.uniform(-1.0, 1.0)
        parts += [np.full(held, level), np.full(2 * held, -level), np.full(held, level)]
    return np.concatenate(parts)[:count]
