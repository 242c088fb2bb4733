"""A machine behind a starter rig: stated in a file, drawn, driven and logged here.

What is sent, or imposed, is logged and passes the ports of its columns; it drives the machine's
equations at a fine step, and what they give passes the ports of the readings, each by
`starter_kernel.passed_on`; then come the logger's clock, noise and steps. Nothing is shared with
the rig, the effects or the engine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import UsageError
from pamid.trial.conditions import ALL, Conditions, StarterConditions, draw_starter_conditions
from pamid.trial.faults import NAMELESS, Draw, Fault
from pamid.trial.logger import Readout
from pamid.trial.machine import AHEAD, Record, packed
from pamid.trial.starter_faults import (
    ClockSizes,
    ForceSizes,
    SignalSizes,
    clock_fault,
    force_faults,
    signal_faults,
)

#: fine inputs (steps, columns), constants, what is planted at the ports of `inside`, errors of the
#: maps, step (s), readings to fill (steps, columns); all SI
Run = Callable[[Array, Any, tuple[Any, ...], tuple[Array, ...], float, Array], None]

FEWEST_WAVES, MOST_WAVES = 3, 6  # of a map's error
CLOCK = "clock"  # the place of what is planted in the logger


@dataclass(frozen=True)
class LoggedColumn:
    """A column of the log: `per_si` of its unit are an SI unit, after `shift` is subtracted; noise
    and the steps of the converter in its unit; port: the port that it passes."""

    per_si: float = 1.0
    shift: float = 0.0
    noise: float = 0.0
    steps: tuple[float, float] = (0.0, 0.0)
    port: str = ""

    def written(self, x: Array, jitter: Array, step: float) -> Array:
        """Column for a reading of the sensor (SI), with its noise (in standard deviations) and the
        step of its converter, 0 for none."""
        shown = (x - self.shift) * self.per_si + self.noise * jitter
        return np.floor(shown / step + 0.5) * step if step > 0.0 else shown


@dataclass(frozen=True)
class SentLevels:
    """Levels sent in a column, in a range (SI), each held for a time (s).

    paired  every level is followed by its opposite about the middle, as what integrates it needs
    ramped  it cannot jump: it goes from level to level in a straight line
    """

    low: float
    high: float
    hold_s: tuple[float, float]
    paired: bool = False
    ramped: bool = False


@dataclass(frozen=True, eq=False)
class StarterMachine:
    """A machine; see `pamid.trial.machine.Machine`.

    seconds     of a recording
    steps       of the integration per sample
    sent, logged  input and output columns in the order of `run`; log: how each is written
    parameters  true constants, SI, as they are drawn
    ports       place -> what is there when nothing is planted; `inside`: those that `run` takes
    further     faults in addition to those that every way of a signal and every motion can have; of
                these, leave_out names what leaves no gap at a port, or cannot be
    commands    ports of what is sent, not read; clock: the name of all readings together, where
                they can have a separate clock
    twins       fault -> effect of another port that is the very same here
    maps        half ranges over which the errors of the machine's maps run, SI
    without     columns of which a case may lack any
    """

    name: str
    period_s: float
    seconds: float
    steps: int
    sent: Mapping[str, SentLevels]
    logged: tuple[str, ...]
    log: Mapping[str, LoggedColumn]
    parameters: Mapping[str, Draw]
    ports: Mapping[str, Any]
    inside: tuple[str, ...]
    further: tuple[Fault, ...]
    maps: tuple[float, ...]
    run: Run
    commands: tuple[str, ...] = ()
    clock: str = ""
    leave_out: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    twins: Mapping[str, str] = field(default_factory=dict)
    without: tuple[str, ...] = ()
    controller: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def faults(self) -> Mapping[str, Fault]:
        """Faults that can be planted, port by port."""
        faults: list[Fault] = []
        for port, there in self.ports.items():
            less = self.leave_out.get(port, ())
            if isinstance(there, SignalSizes):
                faults += signal_faults(port, there, self.seconds, port in self.commands, less)
            elif isinstance(there, ForceSizes):
                faults += force_faults(port, there, less)
        faults += [clock_fault(self.clock, self.period_s)] if self.clock else []
        at_ports = {}
        for f in (*faults, *self.further):
            name = f.name if f.name.startswith(NAMELESS) else f"{f.name}@{f.port}"
            twin = {self.twins[name]} if name in self.twins else set()
            at_ports[name] = replace(f, name=name, exact=f.exact | twin)
        return at_ports

    @property
    def withheld_columns(self) -> Mapping[str, tuple[str, ...]]:
        return {ALL: (), **{f"no-{column}": (column,) for column in self.without}}

    def draw_conditions(
        self, random: np.random.Generator, faults: Sequence[Fault], clean: bool
    ) -> Conditions:
        # a reading at which something is planted stays
        spared = {f.port for f in faults}
        channels = [
            name
            for name, columns in self.withheld_columns.items()
            if not any(self.log[c].port in spared for c in columns)
        ]
        return draw_starter_conditions(random, channels, self.seconds, clean)

    def plant(self, fault: str, random: np.random.Generator) -> tuple[str, dict[str, float]]:
        return fault, self.faults[fault].draw(random)

    def truth(self, site: str) -> dict[str, Any]:
        return self.faults[site].truth

    def known(self, c: Any) -> dict[str, float]:
        return {}

    def excitation(self, c: StarterConditions, record: Record, seed: int, noise: int) -> Any:
        """Excitation, SI, by column."""
        streams = np.random.SeedSequence(seed).spawn(len(self.sent))
        count = round(c.seconds / self.period_s)
        return {
            column: _levels(drive, c.amplitude, count, self.period_s, np.random.default_rng(stream))
            for (column, drive), stream in zip(self.sent.items(), streams, strict=True)
        }

    def build(self, random: np.random.Generator, c: StarterConditions) -> Record:
        true = {name: draw(random) for name, draw in self.parameters.items()}
        maps = tuple(draw_map(random, c.background, span) for span in self.maps)
        steps = {k: float(random.uniform(*channel.steps)) for k, channel in self.log.items()}
        return lambda faults, signal, seed: self.record(
            (true, maps, steps), faults, signal, Readout(c.noise, seed, c.logger)
        )

    def planted(self, faults: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
        """Faults at every place, with the sizes by fault: a size counts at the port of its fault,
        or wherever else there is such a size. UsageError for two that set the same size."""
        places, occupied = {**self.ports, CLOCK: ClockSizes()}, set()
        for name, sizes in faults.items():
            for key, value in sizes.items():
                having = [p for p, there in places.items() if hasattr(there, key)]
                port = self.faults[name].port
                place = port if port in having else having[-1]
                if (place, key) in occupied:
                    raise UsageError(
                        f"Fault {name!r} sets {key!r}, which another fault has set.",
                        "Plant only the first or only the second.",
                    )
                occupied.add((place, key))
                places[place] = replace(places[place], **{key: float(value)})
        return places

    def record(
        self,
        specimen: tuple[Mapping[str, float], tuple[Array, ...], Mapping[str, float]],
        faults: Mapping[str, Mapping[str, float]],
        signal: Mapping[str, Array],
        readout: Readout,
    ) -> dict[str, Array]:
        """Simulate the recording of a specimen: constants, errors of its maps, and the converter's
        steps of each column, in its unit. The columns come back in their declared units. UsageError
        if the machine flies apart."""
        from pamid.trial.starter_kernel import passed_on

        places, n = self.planted(faults), len(next(iter(signal.values())))
        (true, maps, converter), logger = specimen, readout.logger
        steps = readout.steps or self.steps
        h = self.period_s / steps
        there = {k: packed(**asdict(place)) for k, place in places.items()}
        # it runs on after the end, for readings that are stamped early
        fine = {
            k: _fine(np.concatenate([signal[k], np.full(AHEAD, signal[k][-1])]), steps, item.ramped)
            for k, item in self.sent.items()
        }

        def through(column: str, x: Array) -> Array:
            port = self.log[column].port
            if places.get(port) is self.ports.get(port):
                return x  # nothing is planted there
            return np.asarray(passed_on(np.ascontiguousarray(x), there[port], h))

        y = np.zeros(((n + AHEAD) * steps, len(self.logged)))
        self.run(
            np.stack([through(k, x) for k, x in fine.items()], axis=1),
            packed(**true),
            tuple(there[p] for p in self.inside),
            maps,
            h,
            y,
        )
        if not np.isfinite(y).all():
            raise UsageError(
                f"The machine becomes unstable with {', '.join(faults) or 'no fault'}.",
                "Draw smaller sizes.",
            )
        stamps = np.arange(n + AHEAD, dtype=np.float64) * self.period_s
        time, clock = stamps[:n], places[CLOCK]
        random = np.random.default_rng(readout.seed)
        sampled_at = time + self.period_s * logger.delays(random, n)
        when = sampled_at + clock.early_s - clock.skew_ppm * 1e-6 * sampled_at
        shown = {k: np.asarray(signal[k]) for k in fine}
        for k, x in zip(self.logged, y.T, strict=True):
            shown[k] = np.interp(when, stamps, through(k, x)[::steps])
        return {"time_s": time} | {
            k: self.log[k].written(x, readout.noise * logger.noise(random, n), converter[k])
            for k, x in shown.items()
        }


def draw_map(random: np.random.Generator, rms: float, span: float) -> Array:
    """The relative error of a map over -span to span, rms in all: 3 to 6 waves of about equal size,
    the longest of three halves. Fewer would be a cubic spring or cogging, which have names."""
    count = int(random.integers(FEWEST_WAVES, MOST_WAVES + 1))
    waves = np.zeros((count, 3))
    waves[:, 0] = random.uniform(0.5, 1.0, count)
    waves[:, 1] = 0.5 * np.pi * (3.0 + np.arange(count) + random.uniform(-0.4, 0.4, count)) / span
    waves[:, 2] = random.uniform(0.0, 2.0 * np.pi, count)
    s = np.linspace(-span, span, 401)
    error = (waves[:, 0] * np.cos(np.outer(s, waves[:, 1]) + waves[:, 2])).sum(axis=1)
    waves[:, 0] *= rms / float(np.sqrt(np.mean(error**2)))
    return waves


def _levels(
    sent: SentLevels, amplitude: float, count: int, period_s: float, random: np.random.Generator
) -> Array:
    """Random levels for the first half, then a slow sweep, then small steps."""
    middle, reach = 0.5 * (sent.low + sent.high), 0.5 * (sent.high - sent.low)
    reach = min(amplitude * reach, middle) if sent.low >= 0.0 else amplitude * reach
    shortest, longest = sent.hold_s
    stamps, levels = [0.0], [0.0]
    level, hold, repeat = 0.0, shortest, False
    while stamps[-1] < count * period_s:
        if repeat:
            level, repeat = -level, False
        else:
            level, repeat = float(random.uniform(-1.0, 1.0)), sent.paired
            hold = float(np.exp(random.uniform(np.log(shortest), np.log(longest))))
            if stamps[-1] > 0.8 * count * period_s:
                level *= 0.3
        moving = hold * (float(random.uniform(0.4, 1.0)) if sent.ramped else 0.0)
        stamps += [stamps[-1] + moving, stamps[-1] + hold]
        levels += [level, level]
    time = np.arange(count) * period_s
    if sent.ramped:
        wave = np.interp(time, stamps, levels)
    else:  # each level from its stamp on
        at = np.searchsorted(np.array(stamps[1::2]), time, side="right")
        wave = np.array([0.0, *levels[1::2]])[at]
    begin, end = int(0.5 * count), int(0.75 * count)
    slow, fast = 0.25 / longest, 0.25 / shortest
    s = np.linspace(0.0, 1.0, end - begin, endpoint=False)
    lasting = (end - begin) * period_s
    turns = lasting * slow * ((fast / slow) ** s - 1.0) / np.log(fast / slow)
    blend = np.minimum(1.0, np.minimum(s, 1.0 - s) * 20.0)
    wave[begin:end] = (1.0 - blend) * wave[begin:end] + blend * 0.8 * np.sin(2.0 * np.pi * turns)
    return np.asarray(middle + reach * wave)


def _fine(signal: Array, steps: int, ramped: bool) -> Array:
    """A signal at the steps of the integration: held, or in straight lines."""
    if not ramped:
        return np.repeat(signal, steps)
    at = np.arange(len(signal) * steps) / steps
    return np.interp(at, np.arange(len(signal)), signal)
