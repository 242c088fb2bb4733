"""Small machines for effects of the general catalogue: two sprung carts and two tanks, in any units
of length, force and time."""

import numpy as np
from virtual_recordings import virtual_recording

from pamid.engine.symbolic.vocabulary import absolute, sqrt
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig
from pamid.simulation.data_split import DataSplit, split_recordings
from pamid.simulation.excitation.aprbs import aprbs


def carts(length: float = 1.0, force: float = 1.0, time: float = 1.0) -> Rig:
    """A driven cart that pulls another one on a cord; its guide is pressed by a current. The
    arguments are how many of the unit in use make up a metre, a newton, a second."""
    speed = length / time

    def given(name: str, value: float, unit: float) -> Parameter:
        value *= unit
        return Parameter(name, value, 0.1 * value, 10.0 * value, spread=value, source="bench")

    class TwoCarts(Rig):
        """Force to the positions of both carts."""

        inputs = {"push": "", "current": ""}
        outputs = {"first": "", "second": ""}
        ports = {
            "amplifier": Port("command"),
            "guide": Port("motion", "", ("position", "velocity", "current")),
            "cord": Port("transmission", "", ("stretch",)),
            "ruler": Port("reading", "", ("rate",)),
        }
        states = tuple(State(name) for name in ("first", "v_first", "second", "v_second"))
        parameters = (
            given("mass", 1.5, force * time / speed),
            given("carried", 0.8, force * time / speed),
            given("spring", 30.0, force / length),
            given("tie", 400.0, force / length),
            given("damping", 4.0, force / speed),
            given("loss", 3.0, force / speed),
        )
        noise = {"first": 2e-4 * length, "second": 2e-4 * length}
        period_s = 0.004 * time

        def rates(self, x, u, p, port):
            pull = p.tie * (x.first - x.second) + p.loss * (x.v_first - x.v_second)
            pull = port("cord", pull, stretch=x.first - x.second)
            push = port("amplifier", u.push) - p.spring * x.first - p.damping * x.v_first
            push = port(
                "guide", push, position=x.first, velocity=x.v_first, current=absolute(u.current)
            )
            return {
                "first": x.v_first,
                "v_first": (push - pull) / p.mass,
                "second": x.v_second,
                "v_second": (pull - 0.3 * p.damping * x.v_second) / p.carried,
            }

        def measure(self, x, u, p, port):
            return {"first": port("ruler", x.first, rate=x.v_first), "second": x.second}

    return TwoCarts()


def tanks(length: float = 1.0, force: float = 1.0, time: float = 1.0) -> Rig:
    """A pump fills a tank that drains into another; `force` plays no part."""

    class TwoTanks(Rig):
        """Pump to both levels."""

        inputs = {"pump": ""}
        outputs = {"upper": "", "lower": ""}
        ports = {
            "upper_balance": Port("rate", "", ("stored", "downstream")),
            "lower_balance": Port("rate", "", ("stored", "upstream")),
        }
        states = (State("upper", "", 0.3 * length), State("lower", "", 0.2 * length))
        parameters = tuple(
            Parameter(
                name, value, 0.2 * value, 5.0 * value, spread=0.3 * value, source="run-out, 1/s"
            )
            for name, value in (
                ("fill", 0.3 / time),
                ("drain", 0.2 / time),
                ("outlet", 0.15 / time),
            )
        )
        noise = {"upper": 5e-4 * length, "lower": 5e-4 * length}
        period_s = 0.05 * time

        def rates(self, x, u, p, port):
            def root(level):
                return level / sqrt(absolute(level) / length + 0.01)

            through = p.drain * root(x.upper)
            upper = port(
                "upper_balance", p.fill * u.pump - through, stored=x.upper, downstream=x.lower
            )
            lower = port(
                "lower_balance",
                through - p.outlet * root(x.lower),
                stored=x.lower,
                upstream=x.upper,
            )
            return {"upper": upper, "lower": lower}

        def measure(self, x, u, p, port):
            return {"upper": x.upper, "lower": x.lower}

    return TwoTanks()


def inputs_of(rig: Rig, samples: int, length: float = 1.0, force: float = 1.0) -> np.ndarray:
    """What drives a bench (samples x inputs): random steps."""
    if "pump" in rig.inputs:
        return length * steps(samples, 0.6, (40, 200), 3, 0.7)[:, None]
    return np.column_stack(
        [force * steps(samples, 9.0, (20, 150), 5, 0.0), steps(samples, 0.9, (300, 600), 6, 1.0)]
    )


def steps(
    samples: int, amplitude: float, hold: tuple[int, int], seed: int, offset: float
) -> np.ndarray:
    """Random steps held for so many samples."""
    return aprbs(float(samples), 1.0, amplitude, hold, seed=seed, offset=offset)[:samples]


def recorded(rig: Rig, spec: str, specimen: dict[str, float], samples: int) -> DataSplit:
    """A recording of a bench with this effect and these parameters, sensor noise included."""
    sent = dict(zip(rig.inputs, inputs_of(rig, samples).T, strict=True))
    made = virtual_recording(rig, sent, rig.period_s, spec, true=specimen, seed=4)
    return split_recordings(rig, [made], [])
