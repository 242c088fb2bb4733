"""Excitation within the limits of a model.

MuJoCo runs it on the model of the data sheet. A command that reaches a joint's range, exceeds a
speed or a force, or makes bodies touch is shifted or reduced, a command at a time.

Bodies may touch as they do at the start, and the surroundings as they do without a command (a robot
that stands on a floor). Forces are evaluated without their limits, because within these no actuator
can exceed its limit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import DataError, UsageError, nearest
from pamid.base.schemas.excitation_file import CommandKept, LimitsKept
from pamid.rigs.simulators.excitation_bench import ExcitationBench, LimitViolation
from pamid.rigs.simulators.mechanism import Actuator, Mechanism

SMALLER_BY = 0.8  # an amplitude between runs
LEAST_SENT = 0.01  # of the requested signal: less excites nothing
SMALL_BESIDE = 0.3  # of the largest factor: smaller commands are not the only cause
MARGIN = 0.02  # of a joint's range, kept free at either end when a signal is moved


@dataclass(frozen=True, eq=False)
class SafeExcitation:
    """Excitation within the limits.

    columns: (samples,) in the units of their columns; a command is its shift plus its factor times
    the requested one, about its centre.
    """

    columns: dict[str, Array]
    limits: LimitsKept

    def sentences(self) -> list[str]:
        """Changes of the excitation, and the reach of the run with them."""
        sentences = [f"Tried on the model first. Checked: {'; '.join(self.limits.checked)}."]
        for command in self.limits.commands:
            if command.changed:
                moved = f"its centre moved by {command.shift:.4g}" if command.shift else ""
                scaled = (
                    f"made smaller, {command.factor:.3g} times" if command.factor != 1.0 else ""
                )
                done = " and ".join(part for part in (moved, scaled) if part)
                sentences.append(f"{command.column}: {done}; reason: {'; '.join(command.why)}.")
        if not any(command.changed for command in self.limits.commands):
            sentences.append("It is within all limits without changes.")
        reach = ", ".join(
            f"{n} {low:.3g} .. {high:.3g}" for n, (low, high) in self.limits.reached.items()
        )
        return [*sentences, f"Reached in that run (rad or m): {reach}."]


@dataclass
class _CommandCourse:
    """Current modification of a command.

    sent = centre + shift + factor * (requested + balance - centre).

    rest   number of samples before the command starts; they stay unchanged, and lead to the centre
           if that is shifted
    why    active limit -> time of its first violation, s; -1 without a time
    """

    requested: Array
    centre: float
    range: tuple[float, float] | None = None
    factor: float = 1.0
    shift: float = 0.0
    balance: float = 0.0
    why: dict[str, float] = field(default_factory=dict)

    @property
    def rest(self) -> int:
        return int(np.argmax(self.requested != self.requested[0]))

    @property
    def half(self) -> float:
        """Largest requested deviation from the centre."""
        return float(np.abs(self.requested[self.rest :] + self.balance - self.centre).max())

    def sent(self) -> Array:
        if not self.changed:
            return self.requested
        moved = (
            self.centre + self.shift + self.factor * (self.requested + self.balance - self.centre)
        )
        begins = np.full(self.rest, self.requested[0])
        if self.shift:  # no jump: a drive would have to follow it at once
            begins = np.linspace(self.requested[0], self.centre + self.shift, self.rest)
        moved[: self.rest] = begins
        return moved if self.range is None else np.clip(moved, *self.range)

    def note(self, text: str, at_s: float = -1.0) -> None:
        """Note an active limit, at its first violation."""
        self.why.setdefault(text, at_s)

    def reasons(self) -> tuple[str, ...]:
        return tuple(text if at < 0.0 else f"{text} at {at:.4g} s" for text, at in self.why.items())

    @property
    def changed(self) -> bool:
        return self.factor != 1.0 or bool(self.shift) or bool(self.balance)


def safe_excitation(
    mechanism: Mechanism,
    columns: Mapping[str, Array],
    period_s: float,
    centres: Mapping[str, float] | None = None,
    speeds: Mapping[str, float] | None = None,
) -> SafeExcitation:
    """Bring an excitation within the limits of the model.

    columns: commands in their units, every period_s; centres: those of commands that do not swing
    about 0; speeds: further limits, joint -> rad/s or m/s. UsageError for a joint that does not
    exist, DataError (code "no-room") if no motion is left.
    """
    bench = ExcitationBench(mechanism, period_s, dict(speeds or {}))
    courses = {
        i: _CommandCourse(
            np.asarray(columns[a.column], float),
            (centres or {}).get(a.column, 0.0),
            a.command_range,
        )
        for i, a in enumerate(mechanism.actuators)
        if a.column in columns
    }
    if not courses:
        raise UsageError(
            f"None of {', '.join(columns)} is a command of {mechanism.path}.",
            nearest(next(iter(columns)), list(mechanism.inputs)),
        )
    for i, course in courses.items():
        a = mechanism.actuators[i]
        _within_range(a, course)
        if (allowed := _place_range(mechanism, a)) is not None:
            joint = mechanism.joints[a.joint]
            low, high = joint.range or (0.0, 0.0)
            _fit(course, *allowed, f"joint {joint.name} lies within {low:.4g} .. {high:.4g}")
    bench.rest({i: course.sent()[:1] for i, course in courses.items()})
    moved: set[int] = set()
    while True:
        trouble, reached = bench.run({i: course.sent() for i, course in courses.items()})
        if trouble is None:
            break
        if trouble.joint not in moved:
            moved.add(trouble.joint)
            if _recentre(mechanism, courses, trouble):
                continue
        if not any(course.centre for course in courses.values()):
            bench.require_held(trouble)
        _shrink(mechanism, courses, trouble)
    commands = tuple(
        CommandKept(
            column=mechanism.actuators[i].column,
            factor=c.factor,
            shift=c.shift + c.factor * c.balance,
            why=c.reasons(),
        )
        for i, c in courses.items()
    )
    signals = {mechanism.actuators[i].column: c.sent() for i, c in courses.items()}
    limits = LimitsKept(checked=bench.limits(), commands=commands, reached=reached)
    return SafeExcitation({**columns, **signals}, limits)


# ---- what is changed -----------------------------------------------------------------------------


def _fit(course: _CommandCourse, low: float, high: float, why: str) -> None:
    """Shift a signal as little as possible into low .. high, and reduce it if necessary."""
    half = course.factor * course.half
    now = course.centre + course.shift
    if now - half >= low - 1e-9 and now + half <= high + 1e-9:
        return
    if 2.0 * half > high - low:
        course.factor *= (high - low) / (2.0 * half)
        half = 0.5 * (high - low)
    course.shift += min(max(now, low + half), high - half) - now
    course.note(why)


def _within_range(a: Actuator, course: _CommandCourse) -> None:
    if a.command_range is not None:
        low, high = a.command_range
        _fit(course, low, high, f"{a.column} lies within {low:.4g} .. {high:.4g}")


def _place_range(m: Mechanism, a: Actuator) -> tuple[float, float] | None:
    """Range of a position drive's commands from the range of its joint; None without a range."""
    joint = m.joints[a.joint] if a.joint >= 0 else None
    if a.kind != "position" or joint is None or joint.range is None or not a.gear:
        return None
    free = MARGIN * (joint.range[1] - joint.range[0])
    ends = sorted((a.gear * (joint.range[0] + free), a.gear * (joint.range[1] - free)))
    if a.command_range is not None:
        ends = [max(ends[0], a.command_range[0]), min(ends[1], a.command_range[1])]
    return (ends[0], ends[1]) if ends[1] > ends[0] else None


def _recentre(m: Mechanism, courses: Mapping[int, _CommandCourse], trouble: LimitViolation) -> bool:
    """Shift the signals at a joint that reached an end; returns whether anything was shifted.

    A position moves to the middle of the range. A force gets a zero mean.
    """
    done = False
    guilty = trouble.guilty if trouble.joint >= 0 else ()
    for i in (actuator for actuator in guilty if actuator in courses):
        a, course = m.actuators[i], courses[i]
        allowed = _place_range(m, a) if a.joint == trouble.joint else None
        before = course.shift, course.balance
        if allowed is not None:
            course.shift += 0.5 * (allowed[0] + allowed[1]) - course.centre - course.shift
        elif a.kind == "motor":
            course.balance = course.centre - float(np.mean(course.requested[course.rest :]))
            _within_range(a, course)
        moved = abs(course.shift - before[0]) + abs(course.balance - before[1])
        if moved > 1e-3 * course.half:
            course.note(trouble.text, trouble.at_s)
            done = True
    return done


def _shrink(m: Mechanism, courses: Mapping[int, _CommandCourse], trouble: LimitViolation) -> None:
    """Reduce the responsible commands; all commands if the responsible ones are small already."""
    guilty = [i for i in trouble.guilty if i in courses] or list(courses)
    largest = max(course.factor for course in courses.values())
    if all(courses[i].factor < SMALL_BESIDE * largest for i in guilty):
        guilty = list(courses)
    for i in guilty:
        courses[i].factor *= SMALLER_BY
        courses[i].note(trouble.text, trouble.at_s)
    if any(courses[i].factor < LEAST_SENT for i in guilty):
        names = ", ".join(m.actuators[i].column for i in guilty)
        raise DataError(
            f"{m.path}: no signal is possible for {names}: even with {100 * LEAST_SENT:g} % of the "
            f"signal {trouble.text}, at {trouble.at_s:.4g} s.",
            "Reduce --hold or --duration so that the joint drifts less, or hold the joint against "
            "gravity with --offset. Prefer position commands for a joint that must be held.",
            code="no-room",
        )
