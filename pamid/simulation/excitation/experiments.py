"""Experiments as the signals to send: what a rig can be excited by, and a menu of those that tell
models apart: the general ones, after those that a rig states itself (`Rig.experiments`).

Signals are drawn on a separate clock; a bench stretches it to the pace of its rig. Minutes are
the time at the rig, with repetitions and settings; the signals are a single pass of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import UsageError
from pamid.base.units import quantity_of, split_column, to_si
from pamid.model.rig import Rig
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.excitation.waveforms import (
    APART,
    amplitude_sweep,
    odd_multisine,
    slow_reversals,
    speed_runs,
    washed_out,
)

HIGHEST_EXTERNAL = 8.0  # N or N m: of a force or torque from outside, where a rig states none
PASS_S = 15.0  # what a bench of another pace stretches
MOST_EXPERIMENT_SAMPLES = 10_000

EXTERNAL = "external_"


@dataclass(frozen=True)
class Bench:
    """Signals that a rig accepts.

    driven: columns to excite, with centre and half range in their unit: references of a loop,
    or plain inputs. command: columns at rest where the loop stays open (empty on a rig without a
    loop). external: columns for a torque or force from outside. known: parameters that the rig is
    used with (name and unit as in a recording's [known]). period_s: sampling period. pace: seconds
    at this rig per second of the signals' clock. passes: how often, and as many times faster, a
    driven shape is run through. washed: share of the length whose running mean is taken off a
    driven shape, so that what adds it up comes back (0: none). carried: columns that are sent
    with every excitation (samples,), repeated where it is longer.
    """

    rig: Rig
    driven: dict[str, tuple[float, float]]
    period_s: float
    command: tuple[str, ...] = ()
    external: tuple[str, ...] = ()
    known: dict[str, float] = field(default_factory=dict)
    pace: float = 1.0
    passes: int = 1
    washed: float = 0.0
    carried: dict[str, Array] = field(default_factory=dict)

    def clock(self, seconds: float) -> Array:
        """Sampling instants of a signal of this length, in seconds of the signals' clock."""
        step = self.period_s / self.pace
        return step * np.arange(round(seconds / step), dtype=np.float64)

    def driving(self, shape: Callable[[Array], Array]) -> dict[str, Array]:
        """A shape of time within +-1 on every driven column, each a part of a pass later than the
        column before."""
        whole = self.clock(PASS_S)
        once = shape(self.passes * whole[: len(whole) // self.passes])
        waves = {
            name: np.resize(np.roll(once, round(k * APART * len(once))), len(whole))
            for k, name in enumerate(self.driven)
        }
        if self.washed:
            waves = {name: washed_out(wave, self.washed) for name, wave in waves.items()}
        return {name: c + h * waves[name] for name, (c, h) in self.driven.items()}

    def open_loop(self, command: Array, outer: Array | None = None) -> dict[str, Array]:
        """Commands in [-1, 1] past the controller, and a force or torque from outside: loop after
        loop, the others at rest."""
        outside = () if outer is None else self.external
        turns = max(len(self.command), len(outside))
        sent = [
            *((k, name, command) for k, name in enumerate(self.command)),
            *((k, name, outer) for k, name in enumerate(outside) if outer is not None),
        ]
        return {
            name: np.concatenate(
                [wave if k == turn else np.zeros(len(wave)) for turn in range(turns)]
            )
            for k, name, wave in sent
        }


Columns = dict[str, Array]
Settings = tuple[dict[str, float], ...]


@dataclass(frozen=True)
class Experiment:
    """An entry of the menu.

    minutes: at the rig; in_turn: for each of its loops. why: its signals, and what they show on any
    rig; shows: the same by kind of port, for a rig that has the kind. signals: columns to send to a
    bench (samples,), in their units. commanded: needs commands past a controller. pushed: needs
    a torque or force from outside. settings: [known] values that change, once per repetition; ()
    where the rig has nothing to change.
    """

    name: str
    minutes: float
    why: str
    signals: Callable[[Bench], Columns]
    commanded: bool = False
    pushed: bool = False
    in_turn: bool = False
    settings: Callable[[Bench], Settings] = lambda bench: ({},)
    shows: Mapping[str, str] = field(default_factory=dict)

    def reason(self, rig: Rig) -> str:
        """Why it is made, in the words of the rig's ports."""
        kinds = {port.kind for port in rig.ports.values()}
        return ", ".join([self.why, *(text for kind, text in self.shows.items() if kind in kinds)])

    def fits(self, bench: Bench) -> bool:
        if (self.commanded and not bench.command) or (self.pushed and not bench.external):
            return False
        return bool(self.settings(bench) and self.signals(bench))

    def columns(self, bench: Bench) -> Columns:
        """Its signals, and the columns that the bench carries with them."""
        sent = self.signals(bench)
        samples = len(next(iter(sent.values())))
        constant = {k: np.resize(v, samples) for k, v in bench.carried.items() if k not in sent}
        return {**sent, **constant}

    def minutes_on(self, bench: Bench) -> float:
        """Time at the rig; on a user's rig, whose protocol is not known, the length of the
        signals."""
        if bench.command:
            return self.minutes * (len(bench.command) if self.in_turn else 1)
        return len(next(iter(self.signals(bench).values()))) * bench.period_s / 60.0


def menu(bench: Bench) -> list[Experiment]:
    """Experiments that this bench can run."""
    return [e for e in (*bench.rig.experiments, *MENU) if e.fits(bench)]


# ---- what a rig can be excited by --------------------------------------------------------------


def commanded(rig: Rig) -> tuple[str, ...]:
    """Inputs that an excitation moves: of those that a rig needs the ones that it states in
    `excited`, or all of them where it states none of them. A rig that needs none: those stated."""
    needed = tuple(c for c in rig.inputs if c not in rig.optional)
    stated = tuple(c for c in rig.excited if c in rig.inputs)
    return tuple(c for c in needed if c in stated) or needed or stated


def excitable(rig: Rig, loop: str) -> tuple[str, ...]:
    """Columns that carry an excitation: the references of a rig's loops, with loop "open" their
    commands; without loops the inputs that are `commanded`. UsageError where it has none."""
    if rig.loops:
        return tuple(q.reference if loop == "closed" else q.command for q in rig.loops)
    needed = commanded(rig)
    if not rig.inputs:
        raise UsageError(
            f"Nothing is sent to rig {rig.name!r}: it has no input.",
            "Release the machine and record its motion. To simulate, give any recording: "
            f"pamid simulate --rig {rig.name} --excitation REC.csv.",
        )
    if not needed:
        raise UsageError(
            f"rig {rig.name!r} has no loop and needs no input.",
            f"Name an input with --column: {', '.join(rig.inputs)}.",
        )
    return needed


def bounds_of(rig: Rig, column: str) -> tuple[float, float]:
    """Between these a rig lets a column be sent, in its unit: an input within its range, a command
    of a loop within the controller's limit, a reference within the range declared for the reading
    that a recording begins with; infinite where nothing is stated."""
    if column in rig.ranges:
        low, high = rig.ranges[column]
        return float(low), float(high)
    sheet = {p.outside_name: p for p in rig.parameters}
    for q in rig.loops:
        if column == q.command:
            limit = rig.controller.get("command_limit", math.inf)
            return -limit, limit
        begins = sheet.get(f"initial_{q.reading}")
        if column == q.reference and begins is not None:
            return begins.low, begins.high
    return -math.inf, math.inf


def usual_range(rig: Rig, column: str) -> tuple[float, float] | None:
    """Centre and half range (SI) of what is usually sent in this column, or of all that can be;
    None where the rig does not say."""
    symbol, half = split_column(column)[1], usual_half(rig, column)
    if half is None:
        return None
    centre = usual_centre(rig, column, half)
    low, high = (float(to_si(centre + side * half, symbol)) for side in (-1.0, 1.0))
    return 0.5 * (low + high), 0.5 * (high - low)


def usual_half(rig: Rig, column: str) -> float | None:
    """Half range of what is usually sent in a column, or of all that can be, in its unit; None
    where the rig does not say."""
    if column in rig.excited:
        return rig.excited[column]
    low, high = rig.ranges.get(column, (-math.inf, math.inf))
    return 0.5 * (high - low) if math.isfinite(high - low) else None


def usual_centre(rig: Rig, column: str, half: float) -> float:
    """Centre of a swing by `half`, in the unit of the column: the rig's centre, moved by as much as
    keeps the swing within the column's bounds where it fits between them at all."""
    (low, high), centre = bounds_of(rig, column), rig.centre.get(column, 0.0)
    return min(max(centre, low + half), high - half) if 2.0 * half <= high - low else centre


def rest_level(rig: Rig, column: str, centre: float, half: float) -> float:
    """Where a column begins, in its unit: at 0, from which a rig is started, where that is no
    larger step than the signal makes itself and within bounds; else at the centre."""
    low, high = bounds_of(rig, column)
    return 0.0 if abs(centre) <= 2.0 * half and low <= 0.0 <= high else centre


def held_level(rig: Rig, column: str) -> float | None:
    """Where an input stays that is not excited, in its unit: at the rig's centre, else at 0 or the
    bound next to it. None of an absolute temperature without a centre: its 0 is no state of rest.
    """
    if column in rig.centre:
        return rig.centre[column]
    if quantity_of(split_column(column)[1]) == "temperature":
        return None
    low, high = bounds_of(rig, column)
    return min(max(0.0, low), high)


def external_columns(rig: Rig) -> dict[str, float]:
    """Columns for a torque or force from outside, with the usual highest value, in their units.
    UsageError where there are none."""
    names = [name for name in rig.inputs if name.startswith(EXTERNAL)]
    if limits := {name: rig.external.get(name, HIGHEST_EXTERNAL) for name in names}:
        return limits
    raise UsageError(
        f"rig {rig.name!r} has no input {EXTERNAL}<torque or force>, so no torque loops.",
        f"Its inputs: {', '.join(rig.inputs) or 'none'}.",
    )


def at_rest(rig: Rig, samples: int) -> dict[str, Array]:
    """The commands of a rig's loops at 0; without loops the inputs that it needs."""
    names = [q.command for q in rig.loops] or [c for c in rig.inputs if c not in rig.optional]
    return {name: np.zeros(samples) for name in names if not name.startswith(EXTERNAL)}


def nothing_sent(rig: Rig, samples: int) -> dict[str, Array]:
    """Columns of a recording in which nothing is sent: the inputs that a rig needs, at 0; where it
    needs none, an input that is no command, for a recording needs a column."""
    needed = [c for c in rig.inputs if c not in rig.optional]
    commands = {q.command for q in rig.loops}
    free = sorted(rig.optional, key=commands.__contains__)
    return {c: np.full(samples, rig.optional.get(c, 0.0)) for c in needed or free[:1]}


# ---- the menu ----------------------------------------------------------------------------------


def _driven(shape: Callable[[Array], Array]) -> Callable[[Bench], Columns]:
    return lambda b: b.driving(shape)


def data_sheet_value(b: Bench, name: str) -> float | None:
    return next((p.value for p in b.rig.parameters if p.outside_name == name), None)


def _changed(b: Bench) -> Settings:
    """The first parameter that the rig can be changed in, at its other value; where it has been
    changed already, as its data sheet has it."""
    for name, other in b.rig.changeable.items():
        sheet = data_sheet_value(b, name)
        if sheet is not None:
            now = b.known.get(name, sheet)
            return ({name: other if now < 2.0 * sheet or now == sheet else sheet},)
    return ()


MENU = (
    Experiment(
        "aprbs-other-setting",
        4.0,
        "random steps with the rig changed: its dynamics move, delays do not",
        _driven(lambda t: aprbs(len(t) * float(t[1] - t[0]), float(t[1] - t[0]), 1.0, seed=7)),
        settings=_changed,
    ),
    Experiment(
        "odd-multisine",
        4.0,
        "odd random-phase multisine: even lines mark asymmetry",
        _driven(odd_multisine),
        shows={"motion": "an anti-resonance marks compliance"},
    ),
    Experiment(
        "slow-reversals",
        4.0,
        "slow triangles with nested reversals and stops: hysteresis shows as loops",
        _driven(slow_reversals),
        shows={"motion": "dry friction sticks at the stops"},
    ),
    Experiment(
        "constant-rate-ramps",
        4.0,
        "ramps from 4 to 0.08 of the range per second: what grows with the rate and what does not",
        _driven(speed_runs),
    ),
    Experiment(
        "amplitude-sweep",
        4.0,
        "the same swings at 5 to 100 % of the range: what has a threshold weighs most in the "
        "small ones, what curves in the large ones",
        _driven(amplitude_sweep),
        shows={
            "motion": "dry friction in the small ones",
            "transmission": "play in the small ones",
        },
    ),
)
