"""A sprung cart whose dry friction its model lacks: the machine in equations of its own, and the
model as anybody might write it: in any units, either sign of the coordinate, either state."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from pamid.base.arrays import Array
from pamid.base.units import NONE, from_si, split_column
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig
from pamid.recording.recording import Recording, recording_of

SAMPLES, PERIOD_S = 2400, 0.01
HOLD = (12, 70)  # samples that a push lasts
MASS, SPRING, DAMPING, FRICTION = 1.3, 50.0, 3.0, 1.2  # kg, N/m, N s/m, N
GIVE = 2e-3  # m, over which the machine's friction builds up
NOISE = 1e-4  # m
SI = {"": "", NONE: "", "mm": "m", "kN": "N"}
FINE = 10  # steps of the machine per sample


@dataclass(frozen=True)
class Written:
    """How the model is written and the recording kept: how many of the unit in use make up a metre,
    a newton, a second, of which neither knows; what a column's own unit makes of these; the sign of
    the coordinate; the state beside the position."""

    length: float = 1.0
    force: float = 1.0
    time: float = 1.0
    place: str = "place"
    push: str = "push"
    sign: float = 1.0
    state: str = "velocity"


PLAIN = Written()


@cache
def machine() -> tuple[Array, Array]:
    """Push (N) and position (m), every PERIOD_S / 2: m x'' = push - k x - c x' - f z, where the
    bristles z give way as Dahl (1968) says: z' = (x' - |x'| z) / give."""
    random = np.random.default_rng(7)
    push = np.zeros(0)
    while len(push) < SAMPLES:
        push = np.concatenate([push, np.full(random.integers(*HOLD), random.uniform(-9.0, 9.0))])
    push = np.repeat(push[:SAMPLES], 2)
    h = PERIOD_S / FINE

    def rate(x: Array) -> Array:
        force = push[i] - SPRING * x[0] - DAMPING * x[1] - FRICTION * x[2]
        return np.array([x[1], force / MASS, (x[1] - abs(x[1]) * x[2]) / GIVE])

    x = np.zeros(3)
    position = np.empty(len(push))
    for i in range(len(push)):
        position[i] = x[0]
        for _ in range(FINE // 2):
            a = rate(x)
            b = rate(x + 0.5 * h * a)
            c = rate(x + 0.5 * h * b)
            x = x + h * (a + 2.0 * b + 2.0 * c + rate(x + h * c)) / 6.0
    return push, position + NOISE * random.standard_normal(len(position))


def recorded(written: Written = PLAIN, every: int = 2, **more: Array) -> Recording:
    """The machine's recording as `written`, one sample of `every` PERIOD_S / 2; more: columns."""
    w = written
    push, position = machine()
    time = 0.5 * PERIOD_S * written.time * np.arange(len(push))
    columns = {
        w.push: from_si(w.force * push, split_column(w.push)[1]),
        w.place: from_si(w.sign * w.length * position, split_column(w.place)[1]),
    }
    kept = {name: column[::every] for name, column in columns.items()}
    return recording_of(time[::every], kept | more, name="cart")


def part(recording: Recording, start: int, stop: int, name: str) -> Recording:
    """Samples start..stop in a file of their own, its time from 0."""
    columns = {title: column[start:stop] for title, column in recording.columns.items()}
    return recording_of(recording.time[start:stop] - recording.time[start], columns, name=name)


def turned_about(recording: Recording) -> Recording:
    """The same with its columns in the opposite order."""
    columns = dict(reversed(recording.columns.items()))
    return recording_of(recording.time, columns, name=recording.name)


def cart(written: Written = PLAIN) -> Rig:
    """The model as `written`; off from the machine as data sheets are."""
    force, speed = written.force, written.length / written.time

    def given(name: str, value: float, unit: float) -> Parameter:
        value *= unit
        return Parameter(name, value, 0.1 * value, 10.0 * value, spread=0.5 * value, source="bench")

    class OneCart(Rig):
        """Push to position."""

        inputs = {written.push: SI[split_column(written.push)[1]]}
        outputs = {written.place: SI[split_column(written.place)[1]]}
        ports = {
            "amplifier": Port("command"),
            "guide": Port("motion", "", ("position", "velocity")),
            "ruler": Port("reading", "", ("rate",)),
        }
        states = (State("place"), State(written.state))
        parameters = (
            given("mass", 1.0, force * written.time / speed),
            given("spring", 60.0, force / written.length),
            given("damping", 4.0, force / speed),
        )

        def rates(self, x, u, p, port):
            moving = getattr(x, written.state)
            velocity = moving / p.mass if written.state == "momentum" else moving
            push = written.sign * port("amplifier", getattr(u, written.push)) - p.spring * x.place
            push = port("guide", push - p.damping * velocity, position=x.place, velocity=velocity)
            share = 1.0 if written.state == "momentum" else 1.0 / p.mass
            return {"place": velocity, written.state: share * push}

        def measure(self, x, u, p, port):
            moving = getattr(x, written.state)
            rate = moving / p.mass if written.state == "momentum" else moving
            return {written.place: port("ruler", x.place, rate=rate)}

    return OneCart()
