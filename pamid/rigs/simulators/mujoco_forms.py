"""Effects of a finding as elements of a MuJoCo model.

A joint of MuJoCo has dry friction, a damper and a spring that are polynomials, and limits. A motor
without a command adds LuGre friction and a periodic torque. A second joint on the same axis adds
play or a soft shaft; an encoder of the load reads the sum of both. An actuator has a delay, a
first-order lag, a gain, an offset and limits. An effect without such an element is written in its
nearest form, with a note, or is left to the caller.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.rigs.simulators.mechanism import Mechanism, ModelPort

CALLBACK = "`pamid export --to c` writes the whole model for a callback"
# of a Maxwell-slip reach: bristles that give by it store the same work as its four elements
MAXWELL_SHARE = 0.305
TINY_SPRING = 1e-3  # of a constant force, per unit of length: a distant spring replaces it


@dataclass(frozen=True)
class IdentifiedEffect:
    """Effect of a finding. values: its parameters by name, SI; ports: its ports."""

    label: str
    name: str
    values: Mapping[str, float]
    ports: tuple[ModelPort, ...]


@dataclass(frozen=True)
class Stop:
    """Buffers beyond a range: stiffness and damping, SI."""

    low: float
    high: float
    stiffness: float
    damping: float


@dataclass(frozen=True)
class FlexibleLoad:
    """Load behind its motor.

    half_gap                   half the play, SI
    frequency, damping_ratio   of the contact, or of the shaft if there is no play
    share                      share of the load behind the motor
    is_read                    whether the encoder of the joint is on the load, not on the motor
    """

    half_gap: float
    frequency: float
    damping_ratio: float
    share: float
    is_read: bool = False


@dataclass
class JointTerms:
    """Forces at a joint.

    They are -friction sign(v) - (damping . (v, v|v|, v^3)) - (spring . (1, q, q^2, q^3)), and the
    further parts. onset: speed at which the friction is reached; 0: dry. motors: (attribute, its
    numbers) of motors without a command: "lugre" with stiffness and damping of the bristles,
    sliding and static level, Stribeck velocity, or "cogging" with a force amplitude * sin(poles * q
    + phase).

    The methods return a note on the form of an effect, "" for MuJoCo's form.
    """

    friction: float = 0.0
    onset: float = 0.0
    damping: Array = field(default_factory=lambda: np.zeros(3))
    spring: Array = field(default_factory=lambda: np.zeros(4))
    motors: list[tuple[str, tuple[float, ...]]] = field(default_factory=list)
    stop: Stop | None = None
    behind: FlexibleLoad | None = None

    def add(
        self,
        friction: float = 0.0,
        damping: float = 0.0,
        quadratic: float = 0.0,
        cubic: float = 0.0,
        constant: float = 0.0,
        note: str = "",
    ) -> str:
        """Dry friction, dampers and a constant force."""
        self.friction += friction
        self.damping += [damping, quadratic, cubic]
        self.spring[0] -= constant
        return note

    def add_spring(self, linear: float, cubic: float, rest: float) -> str:
        """A force -linear (q - rest) - cubic (q - rest)^3."""
        self.spring += [
            -linear * rest - cubic * rest**3,
            linear + 3.0 * cubic * rest**2,
            -3.0 * cubic * rest,
            cubic,
        ]
        return ""

    def add_yielding(self, level: float, speed: float) -> str:
        """Friction with an onset; several of them add their slopes at rest."""
        slope = (self.friction / self.onset if self.onset else 0.0) + level / max(speed, 1e-9)
        self.onset = (self.friction + level) / slope
        note = "is written as a frictionloss that sets in over its speed (solreffriction)"
        return self.add(friction=level, note=note)

    def add_bristles(
        self,
        stiffness: float,
        sliding: float,
        *,
        damping: float = 0.0,
        breakaway: float = 1.0,
        velocity: float = 1.0,
        note: str = "",
    ) -> str:
        """LuGre friction."""
        numbers = stiffness, damping, sliding, sliding * breakaway, velocity
        self.motors.append(("lugre", numbers))
        return note

    def add_wave(self, sine: float, cosine: float, poles: float) -> str:
        wave = math.hypot(sine, cosine), poles, math.atan2(cosine, sine)
        self.motors.append(("cogging", wave))
        return ""

    def add_stop(self, low: float, high: float, stiffness: float, speed: float) -> str:
        # the effect's damping grows with the depth; its value at a twentieth of the way stands for
        # it
        damping = stiffness * 0.05 * min(abs(low), abs(high)) / speed
        self.stop = Stop(low, high, stiffness, damping)
        return ""

    def add_load_behind(self, p: Any, half_gap: float = 0.0, *, is_read: bool = False) -> str:
        if self.behind is not None:
            return "is not in the file: another effect lies between this joint and its link"
        self.behind = FlexibleLoad(half_gap, p.frequency, p.damping, p.share, is_read)
        closed_by_load = is_read and p.motor_feedback <= 0.5
        return "is written with the motor's encoder in the loop" if closed_by_load else ""


@dataclass
class CommandTerms:
    """Modifications of a command: delay (s), limits, gain, offset, lag (s)."""

    delay: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    gain: float = 1.0
    offset: float = 0.0
    lag: float = 0.0

    def add_law(
        self, gain: float = 0.0, offset: float = 0.0, lag: float = 0.0, delay: float = 0.0
    ) -> str:
        """A delay, a lag and a relative gain error of the command, then an offset."""
        self.delay += delay
        self.lag += lag
        self.gain *= 1.0 + gain
        self.offset = self.offset * (1.0 + gain) + offset
        return ""

    def add_limits(self, low: float, high: float, share: float) -> str:
        # a limit acts on the command after the effects before it
        self.low = max(self.low, (low - self.offset) / self.gain)
        self.high = min(self.high, (high - self.offset) / self.gain)
        return "" if share > HARD else _SOFT_LIMIT


@dataclass
class ReadingTerms:
    """Modifications of a reading: delay (s), limit."""

    delay: float = 0.0
    cutoff: float = math.inf

    def add_delay(self, delay: float) -> str:
        self.delay += delay
        return ""

    def add_limit(self, limit: float, share: float) -> str:
        self.cutoff = min(self.cutoff, limit)
        return "" if share > HARD else _SOFT_LIMIT


@dataclass
class Forms:
    """A finding in MuJoCo's elements, by number of joint, actuator and sensor.

    The notes list effects in another form, and effects that are not written.
    """

    joints: dict[int, JointTerms] = field(default_factory=dict)
    commands: dict[int, CommandTerms] = field(default_factory=dict)
    readings: dict[int, ReadingTerms] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def forms_of(mechanism: Mechanism, effects: Sequence[IdentifiedEffect]) -> Forms:
    """All effects in MuJoCo's elements."""
    forms = Forms()
    for effect in effects:
        notes = [_at_port(forms, mechanism, effect, port) for port in effect.ports]
        forms.notes += [f"{effect.label} {note}" for note in dict.fromkeys(notes) if note]
    return forms


def _at_port(forms: Forms, mechanism: Mechanism, effect: IdentifiedEffect, port: ModelPort) -> str:
    """Add an effect at a port; returns the note on it, or ""."""
    table: Mapping[str, Callable[[Any, Any], str]]
    terms: Any
    if port.kind in ("motion", "transmission"):
        table, terms = _AT_JOINTS, forms.joints.setdefault(port.number, JointTerms())
    elif port.kind == "command":
        table, terms = _AT_COMMANDS, forms.commands.setdefault(port.number, CommandTerms())
    else:
        table, terms = _AT_READINGS, forms.readings.setdefault(port.number, ReadingTerms())
        if mechanism.sensors[port.number].adr < 0:
            return "is not in the file: it acts at a reading, and the file has no sensor for it"
    write = table.get(effect.name)
    if write is None:
        values = ", ".join(f"{k} = {v:.5g}" for k, v in effect.values.items())
        return f"({values}, SI) is not in the file: MuJoCo has no attribute for it; {CALLBACK}"
    return write(terms, SimpleNamespace(**effect.values))


def _hysteresis(share: float) -> Callable[[JointTerms, Any], str]:
    """Bristles of the same level that deflect by a share of the reach."""
    note = "is written as bristle friction (lugre) of its level and reach"
    return lambda t, p: t.add_bristles(p.level / (share * p.reach), p.level, note=note)


HARD = 0.98  # a limit that removes this share of the excess counts as hard
_SOFT_LIMIT = "is written as a hard limit"

#: effect -> its form in MuJoCo, by the kind of its port; p: its parameters
_AT_JOINTS: dict[str, Callable[[JointTerms, Any], str]] = {
    "coulomb-friction": lambda t, p: t.add(friction=p.level),
    "viscous-friction": lambda t, p: t.add(damping=p.damping),
    "directional-damping": lambda t, p: t.add(
        damping=0.5 * (p.forward + p.backward),
        note="is written as the mean damping of both directions",
    ),
    "directional-friction": lambda t, p: t.add(
        friction=0.5 * (p.forward + p.backward),
        constant=0.5 * (p.backward - p.forward),
        note="is written as the mean frictionloss of both directions and a constant force",
    ),
    "yielding-friction": lambda t, p: t.add_yielding(p.level, p.speed),
    "quadratic-drag": lambda t, p: t.add(quadratic=p.drag),
    "cubic-drag": lambda t, p: t.add(cubic=p.drag),
    "linear-stiffness": lambda t, p: t.add_spring(p.stiffness, 0.0, p.rest),
    "cubic-stiffness": lambda t, p: t.add_spring(0.0, p.hardening, p.rest),
    "constant-offset": lambda t, p: t.add(constant=p.level),
    "lugre-friction": lambda t, p: t.add_bristles(
        p.level / p.give,
        p.level,
        damping=p.settling * (p.level / p.give),
        breakaway=p.breakaway,
        velocity=p.speed,
    ),
    "stribeck-friction": lambda t, p: t.add_bristles(
        p.level / p.give, p.level, breakaway=p.breakaway, velocity=p.speed
    ),
    "dahl-friction": lambda t, p: t.add_bristles(p.level / p.reach, p.level),
    "bouc-wen-hysteresis": _hysteresis(1.0),
    "maxwell-slip-hysteresis": _hysteresis(MAXWELL_SHARE),
    "hardening-hysteresis": _hysteresis(1.0),
    "cogging": lambda t, p: t.add_wave(p.sine, p.cosine, 2.0 * math.pi / p.period),
    "gravity": lambda t, p: t.add_wave(-p.sine, -p.cosine, 1.0),
    "end-stop": lambda t, p: t.add_stop(-p.limit, p.limit, p.stiffness, p.speed),
    "one-sided-end-stop": lambda t, p: t.add_stop(p.lower, p.upper, p.stiffness, p.speed),
    "two-mass": lambda t, p: t.add_load_behind(p),
    "backlash": lambda t, p: t.add_load_behind(p, p.half_gap),
    "load-side-backlash": lambda t, p: t.add_load_behind(p, p.half_gap, is_read=True),
}
_AT_COMMANDS: dict[str, Callable[[CommandTerms, Any], str]] = {
    "dead-time": lambda t, p: t.add_law(delay=p.delay),
    "first-order-lag": lambda t, p: t.add_law(lag=p.time_constant),
    "gain-error": lambda t, p: t.add_law(gain=p.gain),
    "offset": lambda t, p: t.add_law(offset=p.level),
    "saturation": lambda t, p: t.add_limits(-p.limit, p.limit, p.share),
    "asymmetric-saturation": lambda t, p: t.add_limits(p.lower, p.upper, p.share),
}
_AT_READINGS: dict[str, Callable[[ReadingTerms, Any], str]] = {
    "dead-time": lambda t, p: t.add_delay(p.delay),
    "saturation": lambda t, p: t.add_limit(p.limit, p.share),
}
