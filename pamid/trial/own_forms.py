"""Faults of a machine that is built from a rig's equations: every effect of the
catalogue wherever it fits, in another form, and effects that are in no catalogue.

Such a machine must not be a model that the tool can reach by fitting, or the trial asks nothing.
Here an effect of the catalogue acts in another form: with d the change that it makes,

    value + lag(d (1 + bend tanh((d/scale)^2)), settling)

large changes counting for more, or less, than small ones, on signals that are bent slightly. The
bend is even in d: were it odd, a friction would become larger in a single direction, which is
another effect of the catalogue. Where the effect is at its null d is 0, and so is all of this,
exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import UsageError
from pamid.engine.symbolic.vocabulary import Expr, Number, cos, expression, lag, maximum, sin, tanh
from pamid.model.attachment import Attachment, attachments, fits
from pamid.model.effect import KINDS, Effect
from pamid.model.parameter import Parameter
from pamid.model.registry import effects
from pamid.model.rig import Rig
from pamid.trial.faults import NAMELESS, Draw, Fault, around, between
from pamid.trial.starter_machine import MOST_WAVES

FORM = "form_"  # leads the names of what makes the other form
FORM_BEND, FORM_SKEW, FORM_SETTLING, FORM_SCALE = (
    FORM + word for word in ("bend", "skew", "settling", "scale")
)
SIGNAL_SIZE = FORM + "size_"
#: signals that tell no motion and no level: they are what they are
UNBENT = ("time", "period", "inertia")


def _number(name: str, value: float) -> Parameter:
    return Parameter(name, value, source="drawn by the trial", unit="1")


class _BentSignals:
    """The signals of a port, each x as x (1 + skew tanh(x/size)) where its size is known."""

    def __init__(self, at: Any, p: Any, bent: Sequence[str]) -> None:
        self._at, self._p, self._bent = at, p, bent

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        value = getattr(self._at, name)
        if name not in self._bent or not isinstance(value, Expr):
            return value
        return value * (
            1.0 + getattr(self._p, FORM_SKEW) * tanh(value / getattr(self._p, SIGNAL_SIZE + name))
        )


def in_another_form(kind: type[Effect], signals: Sequence[str]) -> type[Effect]:
    """The effect as the module's docstring has it, under the same name; signals: those that are
    bent. Its further parameters (SI) are set by who draws the machine."""
    bent = tuple(s for s in signals if s not in UNBENT)
    shape_parameters = (
        *(_number(name, 0.0) for name in (FORM_BEND, FORM_SKEW, FORM_SETTLING)),
        *(_number(name, 1.0) for name in (FORM_SCALE, *(SIGNAL_SIZE + s for s in bent))),
    )

    def act(
        self: Effect, value: Expr, at: Any, p: Any, z: Any
    ) -> Number | tuple[Number, dict[str, Number]]:
        result = kind.act(self, value, _BentSignals(at, p, bent), p, z)
        after, rates = result if isinstance(result, tuple) else (result, None)
        change = expression(after) - value
        share = change / getattr(p, FORM_SCALE)
        stretched = change * (1.0 + getattr(p, FORM_BEND) * tanh(share * share))
        other = value + lag(stretched, getattr(p, FORM_SETTLING))
        return other if rates is None else (other, rates)

    return type(
        f"{kind.__name__}InAnotherForm",
        (kind,),
        {
            "name": kind.name,
            "parameters": (*kind.parameters, *shape_parameters),
            "general_parameters": (*kind.general_parameters, *shape_parameters)
            if kind.general_parameters
            else (),
            "act": act,
            "__doc__": kind.__doc__,
        },
    )


class Roughness(Effect):
    """Roughness of an ordinary machine's maps: value (1 + sum of a few waves over the port's first
    signal), or over the value itself where the port offers none."""

    family = "roughness"
    kinds = tuple(KINDS)
    parameters = tuple(
        _number(f"{word}_{i}", 0.0)
        for i in range(MOST_WAVES)
        for word in ("height", "number", "phase")
    )

    def __init__(self, signal: str) -> None:
        self.signal = signal

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        along = getattr(at, self.signal) if self.signal else value
        error: Number = 0.0
        for i in range(MOST_WAVES):
            height, number, phase = (
                getattr(p, f"{word}_{i}") for word in ("height", "number", "phase")
            )
            error = error + height * cos(number * along + phase)
        return value * (1.0 + error)


def wave_values(waves: Array) -> dict[str, float]:
    """Parameters of a `Roughness` by name; waves: (height, wave number, phase) in each row."""
    return {
        f"{word}_{i}": float(number)
        for i, row in enumerate(waves)
        for word, number in zip(("height", "number", "phase"), row, strict=True)
    }


# ---- in no catalogue ---------------------------------------------------------------------------

AMOUNT = "amount"
VALUE_SIZE = Parameter("usual", 1.0, size="value", source="what usually passes here")


def _amount(value: float) -> Parameter:
    return Parameter(AMOUNT, value, low=0.0, high=1.0, null=0.0, source="drawn by the trial")


class SwayingGain(Effect):
    """A gain that varies periodically with time."""

    family = "nameless"
    general_kinds = ("command", "flow", "rate", "actuator-force", "motion", "reading")
    parameters = (
        _amount(0.12),
        Parameter("cycle", 0.3, size="time", source="a few times in a recording"),
    )

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value * (1.0 + p.amount * sin((2.0 * np.pi) * at.time / p.cycle))


class RememberedGain(Effect):
    """A gain that grows with the recent values, of either sign."""

    family = "nameless"
    general_kinds = ("command", "flow", "rate", "actuator-force", "motion")
    parameters = (
        _amount(0.2),
        VALUE_SIZE,
        Parameter("memory", 0.5, size="timescale", source="about as long as the machine's memory"),
    )

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        share = value / p.usual
        return value * (1.0 - p.amount * tanh(lag(share * share, p.memory)))


class SpeedAcrossPlace(Effect):
    """A force even in the velocity and odd in the position."""

    family = "nameless"
    general_kinds = ("motion",)
    signals = ("velocity", "position")
    parameters = (
        _amount(0.15),
        VALUE_SIZE,
        Parameter("speed", 1.0, size="velocity", source="usual there"),
        Parameter("travel", 1.0, size="position", source="usual there"),
    )

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        fast = at.velocity / p.speed
        return value - p.amount * p.usual * tanh(fast * fast * at.position / p.travel)


class LopsidedCross(Effect):
    """A share of the value of either sign that depends on the velocity."""

    family = "nameless"
    general_kinds = ("motion", "actuator-force")
    signals: ClassVar[tuple[str, ...]] = ("velocity",)
    parameters = (
        _amount(0.2),
        VALUE_SIZE,
        Parameter("speed", 1.0, size="velocity", source="usual there"),
    )

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        fast = tanh(at.velocity / p.speed)
        return value + p.amount * maximum(value, 0.0) * fast


#: by the word that the trial's labels have for them
NAMELESS_EFFECTS: dict[str, type[Effect]] = {
    kind.name: kind for kind in (SwayingGain, RememberedGain, SpeedAcrossPlace, LopsidedCross)
}


# ---- faults -------------------------------------------------------------------------------------

TIMES_TYPICAL, WAY = "times", "way"  # of what is planted: times the typical size, and which way


def _signed(low: float, high: float) -> Draw:
    return lambda random: float(random.choice((-1.0, 1.0))) * float(random.uniform(low, high))


FORM_DRAWS: dict[str, Draw] = {
    FORM_BEND: _signed(0.2, 0.4),
    FORM_SKEW: _signed(0.03, 0.1),
    FORM_SETTLING: between(0.3, 1.5),  # sampling periods
}


def planted_places(rig: Rig) -> dict[str, Attachment]:
    """Everything that can be planted, by the name of its fault: effect@port, or nameless:word@port.
    UsageError if nothing fits."""
    known = {
        f"{a.effect.name}@{a.label.partition('@')[2] or a.group(rig)}": a
        for a in attachments(rig, effects().values())
    }
    nameless = {
        f"{NAMELESS}{kind.name}@{port}": Attachment(kind(), (port,), f"{kind.name}@{port}")
        for kind in NAMELESS_EFFECTS.values()
        for port, at in rig.ports.items()
        if fits(kind, replace(at, general=True))
    }
    if not known or not nameless:
        raise UsageError(
            f"Nothing can be planted in rig {rig.name!r}: no effect fits its ports.",
            "Add ports; `pamid rigs` shows those of other rigs.",
        )
    return known | nameless


def fault_of(rig: Rig, name: str, a: Attachment) -> Fault:
    """Sizes of a fault as multiples of the typical value at its port on that rig."""
    if name.startswith(NAMELESS):
        return Fault(name, "", a.group(rig), {TIMES_TYPICAL: around(1.0)}, (TIMES_TYPICAL,))
    others = {
        p.name: around(1.0, 0.7, 1.4)
        for p in a.effect.parameters_at(rig.ports[a.ports[0]].kind)
        if p.null is None
    }
    draws = {TIMES_TYPICAL: around(1.0), WAY: _signed(1.0, 1.0), **FORM_DRAWS, **others}
    return Fault(
        name, a.family(rig), a.group(rig), draws, (TIMES_TYPICAL,), frozenset((a.effect.name,))
    )
