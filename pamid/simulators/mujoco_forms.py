"""Effects of a finding as elements of a MuJoCo model.

A joint of MuJoCo has dry friction, a damper and a spring that are polynomials, and limits. A motor
without a command adds LuGre friction and a periodic torque. A second joint on the same axis adds
play or a soft shaft. An actuator has a delay, a first-order lag, a gain, an offset and limits. An
effect without such an element is written in its nearest form, with a note, or is left to the
caller.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.simulators.mechanism import Mechanism, ModelPort
from pamid.simulators.mujoco_schema import reads, reads_polynomials

Array = NDArray[np.float64]

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
class Bristle:
    """LuGre friction: stiffness and damping of the bristles, sliding and static level, Stribeck
    velocity, SI."""

    stiffness: float
    damping: float
    sliding: float
    static: float
    velocity: float


@dataclass(frozen=True)
class Wave:
    """A force amplitude * sin(poles * q + phase)."""

    amplitude: float
    poles: float
    phase: float


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
    """

    half_gap: float
    frequency: float
    damping_ratio: float
    share: float


@dataclass
class JointTerms:
    """Forces at a joint.

    They are -friction sign(v) - (damping . (v, v|v|, v^3)) - (spring . (1, q, q^2, q^3)), and the
    further parts. onset: speed at which the friction is reached; 0: dry.
    """

    friction: float = 0.0
    onset: float = 0.0
    damping: Array = field(default_factory=lambda: np.zeros(3))
    spring: Array = field(default_factory=lambda: np.zeros(4))
    bristles: list[Bristle] = field(default_factory=list)
    waves: list[Wave] = field(default_factory=list)
    stop: Stop | None = None
    behind: FlexibleLoad | None = None

    def add_spring(self, linear: float, cubic: float, rest: float) -> None:
        """A force -linear (q - rest) - cubic (q - rest)^3."""
        self.spring += [
            -linear * rest - cubic * rest**3,
            linear + 3.0 * cubic * rest**2,
            -3.0 * cubic * rest,
            cubic,
        ]


@dataclass
class CommandTerms:
    """Modifications of a command: delay (s), limits, gain, offset, lag (s)."""

    delay: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    gain: float = 1.0
    offset: float = 0.0
    lag: float = 0.0


@dataclass
class ReadingTerms:
    """Modifications of a reading: delay (s), limit."""

    delay: float = 0.0
    cutoff: float = math.inf


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
    """All effects in MuJoCo's elements, for the installed version of MuJoCo."""
    forms = Forms()
    for effect in effects:
        notes: list[str] = []
        for port in effect.ports:
            notes.append(_at_port(forms, mechanism, effect, port))
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


# ---- at joints -----------------------------------------------------------------------------------


def _dry(terms: JointTerms, p: Any) -> str:
    terms.friction += p.level
    return ""


def _viscous(terms: JointTerms, p: Any) -> str:
    terms.damping[0] += p.damping
    return ""


def _directional_damping(terms: JointTerms, p: Any) -> str:
    terms.damping[0] += 0.5 * (p.forward + p.backward)
    return "is written as the mean damping of both directions"


def _directional_friction(terms: JointTerms, p: Any) -> str:
    terms.friction += 0.5 * (p.forward + p.backward)
    terms.spring[0] += 0.5 * (p.forward - p.backward)
    return "is written as the mean frictionloss of both directions and a constant force"


def _yielding(terms: JointTerms, p: Any) -> str:
    terms.onset = _joined_onset(terms, p.level, p.speed)
    terms.friction += p.level
    return "is written as a frictionloss that sets in over its speed (solreffriction)"


def _joined_onset(terms: JointTerms, level: float, speed: float) -> float:
    """Onset of several frictions, from the sum of their slopes at rest."""
    slope = (terms.friction / terms.onset if terms.onset else 0.0) + level / max(speed, 1e-9)
    return (terms.friction + level) / slope


def _drag(power: int) -> Callable[[JointTerms, Any], str]:
    def write(terms: JointTerms, p: Any) -> str:
        if not reads_polynomials():
            return f"(drag = {p.drag:.5g}, SI) is not in the file: this MuJoCo has linear dampers"
        terms.damping[power - 1] += p.drag
        return ""

    return write


def _linear_spring(terms: JointTerms, p: Any) -> str:
    terms.add_spring(p.stiffness, 0.0, p.rest)
    return ""


def _cubic_spring(terms: JointTerms, p: Any) -> str:
    if not reads_polynomials():
        return f"(hardening = {p.hardening:.5g}) is not in the file: this MuJoCo has linear springs"
    terms.add_spring(0.0, p.hardening, p.rest)
    return ""


def _constant(terms: JointTerms, p: Any) -> str:
    terms.spring[0] -= p.level
    return ""


def _bristled(terms: JointTerms, bristle: Bristle, words: str) -> str:
    """LuGre friction; a frictionloss if this MuJoCo has no bristles."""
    if reads("actuator/dcmotor", "lugre"):
        terms.bristles.append(bristle)
        return words
    terms.friction += bristle.sliding
    return "is written as a frictionloss of its sliding level: this MuJoCo has no LuGre friction"


def _lugre(terms: JointTerms, p: Any) -> str:
    k = p.level / p.give
    sliding, static = p.level, p.level * p.breakaway
    return _bristled(terms, Bristle(k, p.settling * k, sliding, static, p.speed), "")


def _stribeck(terms: JointTerms, p: Any) -> str:
    static = p.level * p.breakaway
    return _bristled(terms, Bristle(p.level / p.give, 0.0, p.level, static, p.speed), "")


def _dahl(terms: JointTerms, p: Any) -> str:
    return _bristled(terms, Bristle(p.level / p.reach, 0.0, p.level, p.level, 1.0), "")


def _hysteresis(share: float) -> Callable[[JointTerms, Any], str]:
    """Bristles of the same level that deflect by a share of the reach."""

    def write(terms: JointTerms, p: Any) -> str:
        words = "is written as bristle friction (lugre) of its level and reach"
        k = p.level / (share * p.reach)
        return _bristled(terms, Bristle(k, 0.0, p.level, p.level, 1.0), words)

    return write


def _cogging(terms: JointTerms, p: Any) -> str:
    return _wave(terms, p, 2.0 * math.pi / p.period)


def _gravity(terms: JointTerms, p: Any) -> str:
    return _wave(terms, SimpleNamespace(sine=-p.sine, cosine=-p.cosine), 1.0)


def _wave(terms: JointTerms, p: Any, poles: float) -> str:
    if not reads("actuator/dcmotor", "cogging"):
        return f"(sine = {p.sine:.5g}, cosine = {p.cosine:.5g}) is not in the file: {CALLBACK}"
    wave = Wave(math.hypot(p.sine, p.cosine), poles, math.atan2(p.cosine, p.sine))
    terms.waves.append(wave)
    return ""


def _end_stop(terms: JointTerms, p: Any) -> str:
    return _one_sided_stop(
        terms, SimpleNamespace(stiffness=p.stiffness, lower=-p.limit, upper=p.limit, speed=p.speed)
    )


def _one_sided_stop(terms: JointTerms, p: Any) -> str:
    # the effect's damping grows with the depth; its value at a twentieth of the way stands for it
    damping = p.stiffness * 0.05 * min(abs(p.lower), abs(p.upper)) / p.speed
    terms.stop = Stop(p.lower, p.upper, p.stiffness, damping)
    return ""


def _two_mass(terms: JointTerms, p: Any) -> str:
    return _load_behind(terms, FlexibleLoad(0.0, p.frequency, p.damping, p.share))


def _backlash(terms: JointTerms, p: Any) -> str:
    return _load_behind(terms, FlexibleLoad(p.half_gap, p.frequency, p.damping, p.share))


def _load_behind(terms: JointTerms, behind: FlexibleLoad) -> str:
    if terms.behind is not None:
        return "is not in the file: another effect lies between this joint and its link"
    terms.behind = behind
    return ""


_AT_JOINTS: dict[str, Callable[[Any, Any], str]] = {
    "coulomb-friction": _dry,
    "viscous-friction": _viscous,
    "directional-damping": _directional_damping,
    "directional-friction": _directional_friction,
    "yielding-friction": _yielding,
    "quadratic-drag": _drag(2),
    "cubic-drag": _drag(3),
    "linear-stiffness": _linear_spring,
    "cubic-stiffness": _cubic_spring,
    "constant-offset": _constant,
    "lugre-friction": _lugre,
    "stribeck-friction": _stribeck,
    "dahl-friction": _dahl,
    "bouc-wen-hysteresis": _hysteresis(1.0),
    "maxwell-slip-hysteresis": _hysteresis(MAXWELL_SHARE),
    "hardening-hysteresis": _hysteresis(1.0),
    "cogging": _cogging,
    "gravity": _gravity,
    "end-stop": _end_stop,
    "one-sided-end-stop": _one_sided_stop,
    "two-mass": _two_mass,
    "backlash": _backlash,
}


# ---- at commands and readings --------------------------------------------------------------------


def _dead_time(terms: CommandTerms | ReadingTerms, p: Any) -> str:
    if not reads("actuator/motor", "delay"):
        return f"(delay = {p.delay:.5g} s) is not in the file: this MuJoCo has no delays"
    terms.delay += p.delay
    return ""


def _lag(terms: CommandTerms, p: Any) -> str:
    terms.lag += p.time_constant
    return ""


def _gain(terms: CommandTerms, p: Any) -> str:
    terms.gain *= 1.0 + p.gain
    terms.offset *= 1.0 + p.gain
    return ""


def _offset(terms: CommandTerms, p: Any) -> str:
    terms.offset += p.level
    return ""


def _saturation(terms: CommandTerms | ReadingTerms, p: Any) -> str:
    if isinstance(terms, ReadingTerms):
        terms.cutoff = min(terms.cutoff, p.limit)
        return "" if p.share > HARD else _SOFT_LIMIT
    return _asymmetric_saturation(
        terms, SimpleNamespace(lower=-p.limit, upper=p.limit, share=p.share)
    )


def _asymmetric_saturation(terms: CommandTerms, p: Any) -> str:
    # a limit acts on the command after the effects before it
    terms.low = max(terms.low, (p.lower - terms.offset) / terms.gain)
    terms.high = min(terms.high, (p.upper - terms.offset) / terms.gain)
    return "" if p.share > HARD else _SOFT_LIMIT


HARD = 0.98  # a limit that removes this share of the excess counts as a hard one
_SOFT_LIMIT = "is written as a hard limit"

_AT_COMMANDS: dict[str, Callable[[Any, Any], str]] = {
    "dead-time": _dead_time,
    "first-order-lag": _lag,
    "gain-error": _gain,
    "offset": _offset,
    "saturation": _saturation,
    "asymmetric-saturation": _asymmetric_saturation,
}
_AT_READINGS: dict[str, Callable[[Any, Any], str]] = {
    "dead-time": _dead_time,
    "saturation": _saturation,
}
