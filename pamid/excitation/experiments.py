"""Experiments as the signals to send: what a rig can be excited by, tests of its muscles and links,
and a menu of those that tell models apart: for joints with their muscles, and what of it a rig of
one's own can run on its own inputs.

Signals are drawn on a clock of their own (s of the one-dof joint); a bench stretches it to the pace
of its rig. Minutes are the time at the rig, with repetitions and pressures to be set; the signals
are one pass of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import UsageError, nearest
from pamid.excitation.aprbs import aprbs
from pamid.excitation.waveforms import (
    APART,
    GAP_S,
    LOOPS_S,
    PULSES_S,
    amplitude_sweep,
    odd_multisine,
    pulses,
    slow_reversals,
    speed_runs,
    through,
    torque_loops,
    valve_pulses,
)
from pamid.model.rig import Rig

Array = NDArray[np.float64]

OTHER_INERTIA = 6.4  # the two rods of the first paper
PAYLOAD, OTHER_PAYLOAD_KG = "payload_kg", 0.5
TORQUE_NM = 8.0  # highest of the torque loops
PASS_S = 15.0  # what a bench of another pace stretches
MOST_SAMPLES = 10_000

VENTED, PRESSURE, EXTERNAL = "vents_open", "initial_pressure_kpa", "external_"
RELEASE_S, RELEASE_DEG = 20.0, (30.0, 40.0)
PULSED_S = 2.0 * GAP_S * len(PULSES_S)


@dataclass(frozen=True)
class Bench:
    """What can be sent to a rig, and how.

    driven    columns to excite, with centre and half range in their own unit: references of a loop,
    or plain inputs command   columns at rest where the loop stays open (empty on a rig without a
    loop) external  columns for a torque or force from outside known     parameters that the rig is
    used with (name and unit as in a recording's [known]) period_s  sampling period; pace: seconds
    at this rig per second of the joint passes    how often, and as many times faster, a driven
    shape is run through
    """

    rig: Rig
    driven: dict[str, tuple[float, float]]
    period_s: float
    command: tuple[str, ...] = ()
    external: tuple[str, ...] = ()
    known: dict[str, float] = field(default_factory=dict)
    pace: float = 1.0
    passes: int = 1

    def clock(self, seconds: float) -> Array:
        """Sampling instants of a signal of this length, in seconds of the joint."""
        step = self.period_s / self.pace
        return step * np.arange(round(seconds / step), dtype=np.float64)

    def driving(self, shape: Callable[[Array], Array]) -> dict[str, Array]:
        """A shape of time within +-1 on every driven column, each a part of a pass later than the
        one before."""
        whole = self.clock(PASS_S)
        once = shape(self.passes * whole[: len(whole) // self.passes])
        return {
            name: centre + half * np.resize(np.roll(once, round(k * APART * len(once))), len(whole))
            for k, (name, (centre, half)) in enumerate(self.driven.items())
        }

    def open_loop(self, command: Array, torque: Array | None = None) -> dict[str, Array]:
        """Commands in [-1, 1] past the controller, and a torque in N m from outside: joint after
        joint, the others at rest."""
        outside = () if torque is None else self.external
        turns = max(len(self.command), len(outside))
        sent = [
            *((k, name, command) for k, name in enumerate(self.command)),
            *((k, name, torque) for k, name in enumerate(outside) if torque is not None),
        ]
        return {
            name: np.concatenate(
                [wave if k == turn else np.zeros(len(wave)) for turn in range(turns)]
            )
            for k, name, wave in sent
        }

    @property
    def pneumatic(self) -> bool:
        """Are there valves that fill and vent something, to be commanded past a controller?"""
        return bool(self.command) and any(
            q.kind == "flow" and "pressure" in q.signals for q in self.rig.ports.values()
        )


Columns = dict[str, Array]
Settings = tuple[dict[str, float], ...]


def _as_it_is(bench: Bench) -> Settings:
    return ({},)


@dataclass(frozen=True)
class Experiment:
    """An entry of the menu.

    minutes   at the rig; in_turn: for each of its joints signals   columns to send to a bench
    (samples,), in their own units air       needs valves; pushed: needs a torque from outside
    settings  [known] values that change, once per repetition; () where the rig has nothing to
    change
    """

    name: str
    minutes: float
    why: str
    signals: Callable[[Bench], Columns]
    air: bool = False
    pushed: bool = False
    in_turn: bool = False
    settings: Callable[[Bench], Settings] = _as_it_is

    def fits(self, bench: Bench) -> bool:
        return (
            (bench.pneumatic or not self.air)
            and bool(bench.external or not self.pushed)
            and (bool(self.settings(bench) and self.signals(bench)))
        )

    def minutes_on(self, bench: Bench) -> float:
        """Time at the rig; on a rig of one's own, whose protocol is not known, the length of the
        signals."""
        if bench.command:
            return self.minutes * (len(bench.command) if self.in_turn else 1)
        return len(next(iter(self.signals(bench).values()))) * bench.period_s / 60.0


def menu(bench: Bench) -> list[Experiment]:
    """What this bench can run."""
    return [e for e in MENU if e.fits(bench)]


# ---- what a rig can be excited by --------------------------------------------------------------


def excitable(rig: Rig, loop: str) -> tuple[str, ...]:
    """Columns that carry an excitation: the references of a rig's loops, with loop "open" their
    commands; without loops the inputs that it needs. UsageError where it has neither."""
    if rig.loops:
        return tuple(q.reference if loop == "closed" else q.command for q in rig.loops)
    needed = tuple(c for c in rig.inputs if c not in rig.optional)
    if not needed:
        raise UsageError(
            f"rig {rig.name!r} has no loop and needs no input.",
            f"Name one with --column: {', '.join(rig.inputs) or 'it has none'}.",
        )
    return needed


def bounds_of(rig: Rig, column: str) -> tuple[float, float]:
    """Between these a rig lets a column be sent, in its unit: a command of a loop within the
    controller's limit, a reference within the range declared for the angle that a recording begins
    with; infinite where nothing is said."""
    sheet = {p.outside_name: p for p in rig.parameters}
    for q in rig.loops:
        if column == q.command:
            limit = rig.controller.get("command_limit", math.inf)
            return -limit, limit
        begins = sheet.get(f"initial_{q.reading}")
        if column == q.reference and begins is not None:
            return begins.low, begins.high
    return -math.inf, math.inf


def torque_columns(rig: Rig) -> dict[str, float]:
    """Columns for a torque or force from outside, with the usual highest value. UsageError where
    there are none."""
    if found := {name: TORQUE_NM for name in rig.inputs if name.startswith(EXTERNAL)}:
        return found
    raise UsageError(
        f"rig {rig.name!r} has no input {EXTERNAL}<torque or force>, so no torque loops.",
        f"Its inputs: {', '.join(rig.inputs) or 'none'}.",
    )


def held_pressure(rig: Rig, pressure_kpa: float) -> dict[str, float]:
    """[known] of a recording with the valves shut at this gauge pressure; UsageError outside of
    range and supply."""
    sheet = {p.outside_name: p for p in rig.parameters}
    if PRESSURE not in sheet:
        raise UsageError(f"rig {rig.name!r} has no parameter {PRESSURE!r} to hold.")
    held, supply = sheet[PRESSURE], sheet.get("supply_pressure_kpa")
    high = min(held.high, math.inf if supply is None else supply.value)
    if not held.low <= pressure_kpa <= high:
        raise UsageError(f"{PRESSURE} = {pressure_kpa:g} lies outside {held.low:g} .. {high:g}.")
    return {PRESSURE: pressure_kpa}


def at_rest(rig: Rig, samples: int) -> dict[str, Array]:
    """The commands of a rig's loops at 0; without loops the inputs that it needs."""
    names = [q.command for q in rig.loops] or [c for c in rig.inputs if c not in rig.optional]
    return {name: np.zeros(samples) for name in names if not name.startswith(EXTERNAL)}


def muscle_pulses(
    rig: Rig, muscles: Sequence[str], level: float, period_s: float
) -> dict[str, Array]:
    """Commands that vent and fill one muscle after another, `valve_pulses` of duty `level` each, ()
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
    wave = level * valve_pulses(period_s * np.arange(round(PULSED_S / period_s), dtype=np.float64))
    columns = {command: np.zeros(len(chosen) * len(wave)) for command, _ in rig.actuators.values()}
    for k, name in enumerate(chosen):
        command, fills = rig.actuators[name]
        columns[command][k * len(wave) : (k + 1) * len(wave)] = -fills * wave
    return columns


def releases(rig: Rig) -> tuple[str, ...]:
    """Parameters that say where a rig begins that is let go with its muscles vented, one per joint;
    () where it has no such test."""
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
            "Nothing "
            "swings where a joint turns in a horizontal plane.",
            f"Rigs that have one: {able}.",
        )
    if len(release) != len(begins):
        raise UsageError(
            f"{len(release)} angles to release rig {rig.name!r} from; it has {len(begins)} joints."
        )
    known = {
        VENTED: 1.0,
        PRESSURE: 0.0,
        **dict(zip(begins, release, strict=True)),
        **{f"clamped_{joint}": 1.0 for joint in clamped},
        **({} if payload_kg is None else {PAYLOAD: payload_kg}),
    }
    sheet = {p.outside_name: p for p in rig.parameters}
    for name, value in known.items():
        if name not in sheet:
            raise UsageError(f"rig {rig.name!r} has no parameter {name!r}.", nearest(name, sheet))
        if not sheet[name].low <= value <= sheet[name].high:
            raise UsageError(
                f"{name} = {value:g} lies outside {sheet[name].low:g} .. {sheet[name].high:g}."
            )
    return known


def nothing_sent(rig: Rig, samples: int) -> dict[str, Array]:
    """Columns of a recording in which nothing is sent: the inputs that a rig needs, at 0; where it
    needs none, one that is no command, for a recording has at least one column."""
    needed = [c for c in rig.inputs if c not in rig.optional]
    commands = {q.command for q in rig.loops}
    free = sorted(rig.optional, key=commands.__contains__)
    return {c: np.full(samples, rig.optional.get(c, 0.0)) for c in needed or free[:1]}


# ---- the menu ----------------------------------------------------------------------------------


def _torque_loops(b: Bench) -> Columns:
    t = b.clock(LOOPS_S)
    return b.open_loop(np.zeros(len(t)), TORQUE_NM * torque_loops(t))


def _quick_release(b: Bench) -> Columns:
    t = b.clock(12.0)
    knots = [
        knot
        for held in (4.0, 8.0, -4.0, -8.0)
        for knot in ((0.5, 0.0), (0.5, held), (0.5, held), (b.period_s, 0.0), (1.4, 0.0))
    ]
    return b.open_loop(np.zeros(len(t)), through(t, *knots))


def _pressure_hold(b: Bench) -> Columns:
    wave = pulses(b.clock(20.0), 10.0, [(0.3, 0.5), (0.3, -1.0)])
    return dict.fromkeys(b.command, wave)  # every muscle's own pressure is watched: all at once


def _valve_pulses(b: Bench) -> Columns:
    return b.open_loop(valve_pulses(b.clock(PULSED_S)))


def _staircase(b: Bench) -> Columns:
    t = b.clock(16.0)
    levels = np.array([0.02, 0.04, 0.06, 0.08, 0.12, 0.16, 0.22, 0.3])
    return b.open_loop(
        levels[np.minimum((t / 2.0).astype(int), 7)] * np.where(t % 2.0 < 1.0, 1.0, -1.0)
    )


def _driven(shape: Callable[[Array], Array]) -> Callable[[Bench], Columns]:
    return lambda b: b.driving(shape)


def _steps(t: Array) -> Array:
    return aprbs(len(t) * float(t[1] - t[0]), float(t[1] - t[0]), 1.0, seed=7)


def _sheet(b: Bench, name: str) -> float | None:
    return next((p.value for p in b.rig.parameters if p.outside_name == name), None)


def _two_pressures(b: Bench) -> Settings:
    return () if _sheet(b, PRESSURE) is None else ({PRESSURE: 200.0}, {PRESSURE: 500.0})


def _another_inertia(b: Bench) -> Settings:
    name = "inertia_kg_m2"
    sheet = _sheet(b, name)
    if sheet is not None:
        return (
            {
                name: round(sheet * OTHER_INERTIA, 6)
                if b.known.get(name, sheet) < 2.0 * sheet
                else sheet
            },
        )
    if _sheet(b, PAYLOAD) is None:
        return ()
    return ({PAYLOAD: 0.0 if b.known.get(PAYLOAD) else OTHER_PAYLOAD_KG},)


def _at_rest(b: Bench) -> Columns:
    return nothing_sent(b.rig, len(b.clock(RELEASE_S)))


def _swings(b: Bench) -> Settings:
    """All links free, and only the last one."""
    joints = releases(b.rig)
    if len(joints) != len(RELEASE_DEG):
        return ()
    return gravity_test(b.rig, RELEASE_DEG), gravity_test(b.rig, (0.0, RELEASE_DEG[1]), ("1",))


MENU = (
    Experiment(
        "torque-loops-two-pressures",
        8.0,
        "slow torque loops with the valves shut, at 2 and at 5 bar: dry friction in the joint "
        "keeps its width, "
        "hysteresis of the muscles grows with the pressure, nothing in the valves is seen",
        _torque_loops,
        air=True,
        pushed=True,
        in_turn=True,
        settings=_two_pressures,
    ),
    Experiment(
        "quick-release",
        4.0,
        "a held torque is let go with the valves shut: a sensor's lag and compliance show, valves "
        "and dead time "
        "do not",
        _quick_release,
        air=True,
        pushed=True,
        in_turn=True,
    ),
    Experiment(
        "pressure-hold",
        3.0,
        "vent a little, shut all valves and wait: a leak falls for ever, heat settles within 2 s",
        _pressure_hold,
        air=True,
    ),
    Experiment(
        "gravity-test",
        4.0,
        "let go with the muscles vented, once with joint 1 clamped: the links' masses and "
        "the friction of the joints, without any muscle",
        _at_rest,
        settings=_swings,
    ),
    Experiment(
        "valve-pulses",
        3.0,
        "pulses of 30 to 500 ms on the valves, past the controller",
        _valve_pulses,
        air=True,
        in_turn=True,
    ),
    Experiment(
        "duty-staircase",
        3.0,
        "duty from 0.02 to 0.3 in small steps, there and back: what the smallest commands move",
        _staircase,
        air=True,
        in_turn=True,
    ),
    Experiment(
        "aprbs-other-inertia",
        4.0,
        "random steps with another inertia: structural modes move, delays do not",
        _driven(_steps),
        settings=_another_inertia,
    ),
    Experiment(
        "odd-multisine",
        4.0,
        "odd random-phase multisine: an anti-resonance marks compliance, even lines mark asymmetry",
        _driven(odd_multisine),
    ),
    Experiment(
        "slow-reversals",
        4.0,
        "slow triangles with nested reversals and stops: what is dry sticks and remembers",
        _driven(slow_reversals),
    ),
    Experiment(
        "constant-speed-runs",
        4.0,
        "ramps from 4 to 0.08 of the range per second: what grows with the rate and what does not",
        _driven(speed_runs),
    ),
    Experiment(
        "amplitude-sweep",
        4.0,
        "the same swings at 5 to 100 % of the range: what is dry or has play weighs "
        "most in the small ones, what curves in the large ones",
        _driven(amplitude_sweep),
    ),
)
