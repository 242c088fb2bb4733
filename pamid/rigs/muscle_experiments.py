"""Experiments of joints that antagonistic muscles drive: what such a rig adds to the general menu
of `pamid.simulation.excitation.experiments`, and the tests of its muscles and links."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import UsageError, nearest
from pamid.model.rig import Rig
from pamid.simulation.excitation.experiments import (
    Bench,
    Columns,
    Experiment,
    Settings,
    data_sheet_value,
    nothing_sent,
)
from pamid.simulation.excitation.waveforms import (
    GAP_S,
    LOOPS_S,
    PULSES_S,
    nested_loops,
    paired_pulses,
    pulses,
    through,
)

VENTED, INITIAL_PRESSURE, PAYLOAD = "vents_open", "initial_pressure_kpa", "payload_kg"
HIGHEST_TORQUE_NM = 8.0  # of the torque loops
RELEASE_S, RELEASE_DEG = 20.0, (30.0, 40.0)
PULSED_S = 2.0 * GAP_S * len(PULSES_S)


def held_pressure(rig: Rig, pressure_kpa: float) -> dict[str, float]:
    """[known] of a recording with the valves shut at this gauge pressure; UsageError outside of
    range and supply."""
    sheet = {p.outside_name: p for p in rig.parameters}
    if INITIAL_PRESSURE not in sheet:
        raise UsageError(
            f"Rig {rig.name!r} has no parameter {INITIAL_PRESSURE!r} to hold.",
            "Choose a rig with muscles: `pamid rigs` lists them.",
        )
    held, supply = sheet[INITIAL_PRESSURE], sheet.get("supply_pressure_kpa")
    high = min(held.high, math.inf if supply is None else supply.value)
    if not held.low <= pressure_kpa <= high:
        raise UsageError(
            f"{INITIAL_PRESSURE} = {pressure_kpa:g} lies outside {held.low:g} .. {high:g}."
        )
    return {INITIAL_PRESSURE: pressure_kpa}


def muscle_pulses(
    rig: Rig, muscles: Sequence[str], level: float, period_s: float
) -> dict[str, Array]:
    """Commands that vent and fill the muscles in turn, `paired_pulses` of duty `level`, ()
    for all of them; the commands of all joints, samples. UsageError for a muscle that is not there.
    """
    chosen = list(muscles) or list(rig.actuators)
    strange = [repr(name) for name in chosen if name not in rig.actuators]
    if strange or not chosen:
        raise UsageError(
            f"rig {rig.name!r} has no muscle {', '.join(strange)}".rstrip() + ".",
            f"Muscles it declares (actuators): {', '.join(rig.actuators) or 'none'}.",
        )
    if not 0.0 < level <= 1.0:
        raise UsageError(f"The level is {level:g}; a duty lies in (0, 1].")
    wave = level * paired_pulses(period_s * np.arange(round(PULSED_S / period_s), dtype=np.float64))
    columns = {command: np.zeros(len(chosen) * len(wave)) for command, _ in rig.actuators.values()}
    for k, name in enumerate(chosen):
        command, fills = rig.actuators[name]
        columns[command][k * len(wave) : (k + 1) * len(wave)] = -fills * wave
    return columns


def releases(rig: Rig) -> tuple[str, ...]:
    """Parameters that state where a rig begins that is let go with its muscles vented, a parameter
    per joint; () where it has no such test."""
    sheet = {p.outside_name for p in rig.parameters}
    names = tuple(f"initial_{q.reading}" for q in rig.loops)
    return names if names and sheet >= {VENTED, *names} else ()


def gravity_test(
    rig: Rig, release: Sequence[float], clamped: Sequence[str] = (), payload_kg: float | None = None
) -> dict[str, float]:
    """[known] of a recording in which a rig swings by itself: muscles vented, let go at these
    angles (in the unit of the readings), some joints clamped. UsageError where the rig does not
    swing, has no such joint or no such range."""
    from pamid.model.registry import rigs

    begins = releases(rig)
    if not begins:
        able = ", ".join(name for name, kind in rigs().items() if releases(kind())) or "none"
        raise UsageError(
            f"rig {rig.name!r} has no gravity test: no parameters {VENTED} and initial_<angle>. "
            "Nothing swings where a joint turns in a horizontal plane.",
            f"Rigs that have it: {able}.",
        )
    if len(release) != len(begins):
        raise UsageError(
            f"{len(release)} angles to release rig {rig.name!r} from; it has {len(begins)} joints."
        )
    known = {
        VENTED: 1.0,
        INITIAL_PRESSURE: 0.0,
        **dict(zip(begins, release, strict=True)),
        **{f"clamped_{joint}": 1.0 for joint in clamped},
        **({} if payload_kg is None else {PAYLOAD: payload_kg}),
    }
    sheet = {p.outside_name: p for p in rig.parameters}
    for name, value in known.items():
        if name not in sheet:
            raise UsageError(
                f"Rig {rig.name!r} has no parameter {name!r}.",
                nearest(name, sheet) or f"Name a parameter that it has: {', '.join(sheet)}.",
            )
        if not sheet[name].low <= value <= sheet[name].high:
            raise UsageError(
                f"{name} = {value:g} lies outside {sheet[name].low:g} .. {sheet[name].high:g}."
            )
    return known


# ---- the menu ----------------------------------------------------------------------------------


def _torque_loops(b: Bench) -> Columns:
    t = b.clock(LOOPS_S)
    return b.open_loop(np.zeros(len(t)), HIGHEST_TORQUE_NM * nested_loops(t))


def _quick_release(b: Bench) -> Columns:
    t = b.clock(12.0)
    knots = [
        knot
        for held in (4.0, 8.0, -4.0, -8.0)
        for knot in ((0.5, 0.0), (0.5, held), (0.5, held), (b.period_s, 0.0), (1.4, 0.0))
    ]
    return b.open_loop(np.zeros(len(t)), through(t, *knots))


def _staircase(b: Bench) -> Columns:
    t = b.clock(16.0)
    levels = np.array([0.02, 0.04, 0.06, 0.08, 0.12, 0.16, 0.22, 0.3])
    return b.open_loop(
        levels[np.minimum((t / 2.0).astype(int), 7)] * np.where(t % 2.0 < 1.0, 1.0, -1.0)
    )


def _swings(b: Bench) -> Settings:
    """All links free, and only the last."""
    joints = releases(b.rig)
    if len(joints) != len(RELEASE_DEG):
        return ()
    return gravity_test(b.rig, RELEASE_DEG), gravity_test(b.rig, (0.0, RELEASE_DEG[1]), ("1",))


EXPERIMENTS = (
    Experiment(
        "torque-loops-two-pressures",
        8.0,
        "slow torque loops with the valves shut, at 2 and at 5 bar: dry friction in the joint "
        "keeps its width, "
        "hysteresis of the muscles grows with the pressure, nothing in the valves is seen",
        _torque_loops,
        commanded=True,
        pushed=True,
        in_turn=True,
        settings=lambda b: (
            ()
            if data_sheet_value(b, INITIAL_PRESSURE) is None
            else ({INITIAL_PRESSURE: 200.0}, {INITIAL_PRESSURE: 500.0})
        ),
    ),
    Experiment(
        "quick-release",
        4.0,
        "a held torque is let go with the valves shut: a sensor's lag and compliance show, valves "
        "and dead time do not",
        _quick_release,
        commanded=True,
        pushed=True,
        in_turn=True,
    ),
    Experiment(
        "pressure-hold",
        3.0,
        "vent a little, shut all valves and wait: a leak falls for ever, heat settles within 2 s",
        # every muscle's pressure is watched: all at once
        lambda b: dict.fromkeys(b.command, pulses(b.clock(20.0), 10.0, [(0.3, 0.5), (0.3, -1.0)])),
        commanded=True,
    ),
    Experiment(
        "gravity-test",
        4.0,
        "let go with the muscles vented, once with joint 1 clamped: the links' masses and "
        "the friction of the joints, without any muscle",
        lambda b: nothing_sent(b.rig, len(b.clock(RELEASE_S))),
        settings=_swings,
    ),
    Experiment(
        "valve-pulses",
        3.0,
        "pulses of 30 to 500 ms on the valves, past the controller",
        lambda b: b.open_loop(paired_pulses(b.clock(PULSED_S))),
        commanded=True,
        in_turn=True,
    ),
    Experiment(
        "duty-staircase",
        3.0,
        "duty from 0.02 to 0.3 in small steps, there and back: what the smallest commands move",
        _staircase,
        commanded=True,
        in_turn=True,
    ),
)
