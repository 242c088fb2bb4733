"""An effect: a small piece of physics that attaches to a port and vanishes exactly at its null.

    class CoulombFriction(Effect):
        family, kinds, signals = "friction", ("motion",), ("position",)
        parameters = (
            Parameter.level(0.03, 0.0, 0.5, spread=0.1).with_source("..."),
            Parameter.width("give", 0.001, 0.0001, 0.02, factor=3.0).with_source("..."),
        )

        def act(self, value, at, p, z):
            return value - p.level * stop(at.position, p.give) / p.give

`value` is what passes through the port, `at` holds the signals offered there, `p` the parameters
(SI) and `z` the effect's states. `act` returns the new value, or (value, {state: rate}).

Three further properties are class attributes, where they are needed:
    general_parameters  other sizes and bounds at ports of `general_kinds`, or at those that offer
                        none of the `home_signals`, under the same names
    stand_ins           a signal that ports may offer under other names: {"level": ("load", ...)}
    roles               the effect acts at several ports together, each of which plays a part: the
                        signals of every part, ("stored", "downstream") and ("upstream",)
"""

from __future__ import annotations

import inspect
import math
import re
import sys
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from pamid.base.errors import FileError, nearest
from pamid.engine.symbolic.vocabulary import EquationError, Expr, Number, integral
from pamid.model.parameter import Parameter

KINDS = {
    "command": "what is sent to the actuator, held over a sample",
    "flow": "flow through a valve",
    "rate": "rate of change of a stored quantity: pressure, level, temperature",
    "actuator-force": "force of an actuator before it meets the mechanism",
    "motion": "force or torque on a moving coordinate",
    "transmission": "what a shaft, chain or belt hands on",
    "reading": "what a sensor returns",
}


@dataclass(frozen=True)
class State:
    """A state of a rig or an effect: name, SI unit, value at the start of a recording."""

    name: str
    unit: str = ""
    start: float = 0.0


class Signals:
    """Signals of a port at a place: at.velocity, at.pressure, ...

    at.offers("law"): whether a signal is there; at.time, in s; at.step and at.period, of the
    integrator and of the recording, in s; at.kind: kind of the port; rig_period_s: the rig's usual
    sampling period, a number; upper_bounds: by parameter of the effect, upper end of its range
    (SI), numbers.
    """

    def __init__(
        self,
        values: dict[str, Any],
        where: str,
        rig_period_s: float,
        upper_bounds: Mapping[str, float],
    ) -> None:
        self._values, self._where, self.rig_period_s = values, where, rig_period_s
        self.upper_bounds = upper_bounds

    def offers(self, name: str) -> bool:
        return name in self._values

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        values = self._values
        if name in values:
            return values[name]
        # only differences of it matter to an effect
        if name == "position" and "velocity" in values:
            return integral(values["velocity"])
        raise EquationError(
            f"{self._where} does not offer the signal {name!r}; it offers "
            f"{', '.join(sorted(values)) or 'none'}",
            nearest(name, list(values)),
        )


class Effect:
    """Base of all effects. Class attributes are its data sheet; `act` is its equation."""

    name: ClassVar[str] = ""
    family: ClassVar[str] = ""
    # family where the port is of another kind than kinds[0]
    families: ClassVar[dict[str, str]] = {}
    kinds: ClassVar[tuple[str, ...]] = ()  # ports it is at home at
    # ports it also serves on rigs without a separate catalogue
    general_kinds: ClassVar[tuple[str, ...]] = ()
    signals: ClassVar[tuple[str, ...]] = ()  # signals it cannot do without
    unit: ClassVar[str] = ""  # only at ports of this SI unit
    # SI units of quantities for which its physics has no meaning: a temperature has no play
    excluded_units: ClassVar[tuple[str, ...]] = ()
    # kinds of ports at which its derivatives are those of its mean course, for fits to follow:
    # those of a staircase say nothing of where it leads
    mean_slope_at: ClassVar[tuple[str, ...]] = ()
    everywhere: ClassVar[bool] = False  # a single copy acts on all matching ports together
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    # signals that make a port its home: without them the port belongs to general_kinds
    home_signals: ClassVar[tuple[str, ...]] = ()
    # the same names with the sizes and bounds that hold at ports of general_kinds
    general_parameters: ClassVar[tuple[Parameter, ...]] = ()
    # signal -> names under which a port may offer it instead; the first offered is taken
    stand_ins: ClassVar[dict[str, tuple[str, ...]]] = {}
    # it acts at several ports together, with common parameters: the signals of each part
    roles: ClassVar[tuple[tuple[str, ...], ...]] = ()
    states: ClassVar[tuple[State, ...]] = ()
    # amounts without which it is another, plainer effect
    defining: ClassVar[tuple[str, ...]] = ()
    # parameter -> family that the effect belongs to where it ends at the lower bound
    limits: ClassVar[dict[str, str]] = {}
    symptoms: ClassVar[tuple[str, ...]] = ()  # of `pamid.base.symptoms`
    look_alikes: ClassVar[tuple[str, ...]] = ()
    absorbed_by: ClassVar[tuple[str, ...]] = ()  # parameters of a rig that do the same

    def __init_subclass__(cls, sensor: str = "", **kwargs: Any) -> None:
        """Name the effect after its class.

        sensor: SI unit of the readings to which the effect is confined, as a special case of an
        effect that acts on any reading.
        """
        super().__init_subclass__(**kwargs)
        if sensor:
            cls.kinds, cls.general_kinds, cls.families, cls.unit = ("reading",), (), {}, sensor
        if "name" not in cls.__dict__:
            cls.name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", cls.__name__).lower()

    def act(
        self, value: Expr, at: Any, p: Any, z: Any
    ) -> Number | tuple[Number, dict[str, Number]]:
        """The value after the effect, and the rates of its states if it has any."""
        raise NotImplementedError

    def starts(self, hints: Hints) -> list[dict[str, float]]:
        """Further starting values for a fit (SI), after the typical ones; usually none."""
        return []

    @classmethod
    def family_at(cls, kind: str) -> str:
        return cls.families.get(kind, cls.family)

    @classmethod
    def suits_unit(cls, unit: str) -> bool:
        """Whether its physics applies to a quantity in this SI unit."""
        return cls.unit in ("", unit) and unit not in cls.excluded_units

    @classmethod
    def parameters_at(cls, kind: str, offered: Collection[str] = ()) -> tuple[Parameter, ...]:
        """Its parameters at a port of this kind that offers these signals."""
        at_home = kind in cls.kinds and set(cls.home_signals) <= set(offered)
        return cls.parameters if at_home or not cls.general_parameters else cls.general_parameters

    @classmethod
    def offered_as(cls, signal: str, offered: Collection[str]) -> str:
        """The name under which a port that offers these signals offers this signal (itself where it
        does not)."""
        names = (signal, *cls.stand_ins.get(signal, ()))
        return next((n for n in names if n in offered), signal)

    @classmethod
    def story(cls) -> dict[str, str]:
        """The docstring of the effect's file, section by section: title, What it is, Equation,
        ..."""
        module = sys.modules.get(cls.__module__)
        text = (
            inspect.cleandoc(cls.__doc__) if cls.__doc__ and cls.__doc__ != Effect.__doc__ else ""
        )
        return sections((module.__doc__ if module and module.__doc__ else "") or text)


@dataclass(frozen=True)
class Hints:
    """Data from which an effect may choose starting values.

    peaks_hz: of the gap's spectrum, strongest first; reach: largest magnitude of each signal at the
    port where the model's states are those of the recording (SI); periods: of the gap's spectrum
    over the position at the port, strongest first (unit of the position); timescale_s: correlation
    time of the recordings, of which parameters in time are multiples (nan: not known); plateaus:
    spacing of those on which the recorded values of a reading rest, where they do, and any of them
    (SI); period_s: sampling period of the recordings (nan: not known); extremes: lowest and highest
    recorded value of a reading, per recording (SI).
    """

    peaks_hz: tuple[float, ...] = ()
    reach: Mapping[str, float] = field(default_factory=dict)
    periods: tuple[float, ...] = ()
    timescale_s: float = math.nan
    plateaus: tuple[tuple[float, float], ...] = ()
    period_s: float = math.nan
    extremes: tuple[tuple[float, float], ...] = ()


RIG_SECTIONS = ("What it is", "Equations", "Typically missing", "References")
SECTIONS = ("What it is", "What it looks like", "Looks like it", "Equation", "References")


def sections(doc: str, named: tuple[str, ...] = SECTIONS) -> dict[str, str]:
    """Split a docstring into its title and the sections of these names."""
    lines = inspect.cleandoc(doc).splitlines()
    by_heading: dict[str, list[str]] = {"title": lines[:1]}
    heading = ""
    for line in lines[1:]:
        if line.strip() in named:
            heading = line.strip()
            by_heading[heading] = []
        elif heading:
            by_heading[heading].append(line.strip())
    return {k: "\n".join(v).strip() for k, v in by_heading.items()}


def problems(effect: type[Effect]) -> list[str]:
    """Faults of an effect's data sheet, in words (empty: none)."""
    wrong = []
    if not effect.family:
        wrong.append("it names no family")
    for kind in (*effect.kinds, *effect.general_kinds):
        if kind not in KINDS:
            wrong.append(
                f"unknown kind of port {kind!r} (kinds: {', '.join(KINDS)}) "
                f"{nearest(kind, list(KINDS))}"
            )
    if not effect.kinds and not effect.general_kinds:
        wrong.append("it names no kind of port")
    if not any(p.null is not None for p in effect.parameters):
        wrong.append("no parameter has a null, so it can never be switched off")
    names = [p.name for p in effect.parameters] + [s.name for s in effect.states]
    general = {p.name for p in effect.general_parameters}
    if general and general != {p.name for p in effect.parameters}:
        wrong.append("its general_parameters have other names than its parameters")
    wrong += [
        f"the name {n!r} is used twice" for n in sorted({n for n in names if names.count(n) > 1})
    ]
    if effect.act is Effect.act:
        wrong.append("it has no act()")
    story = effect.story()
    wrong += [f"its docstring lacks the section {s!r}" for s in SECTIONS if not story.get(s)]
    wrong += [f"parameter {p.name!r} names no source" for p in effect.parameters if not p.source]
    wrong += [
        f"general parameter {p.name!r} names no source"
        for p in effect.general_parameters
        if not p.source
    ]
    return wrong


def require_sound(effect: type[Effect], where: str) -> None:
    """Refuse an effect that cannot work at all (missing documentation is left to `pamid check`)."""
    fatal = [w for w in problems(effect) if "docstring" not in w and "source" not in w]
    if fatal:
        raise FileError(
            f"{where}: effect {effect.name!r}: " + "; ".join(fatal),
            "see pamid effects coulomb-friction",
        )
