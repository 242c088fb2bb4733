"""Models made by hand for the tests of exports, what they are driven with, and what pamid itself
says they do."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.units import from_si, split_column, to_si
from pamid.correction.identified_model import Identified, ModelNetwork, simulate_identified
from pamid.engine.program import Stepping
from pamid.model.assembly import Assembly
from pamid.model.attachment import attach
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.registry import effects, rig_named
from pamid.model.rig import Port, Rig
from pamid.networks.elman import Elman
from pamid.networks.scaling import Scaling
from pamid.networks.trained_network import TrainedNetwork

Array = NDArray[np.float64]
PERIOD_S = 0.003
SEVERAL = (
    "dead-time",
    "maxwell-slip-hysteresis",
    "tube-lag",
    "coulomb-friction",
    "angle-sensor-lag",
)
CART = str(Path(__file__).parents[2] / "data" / "rigs" / "cart.py")


class Kettle(Rig):
    """An output in degrees Celsius, one that hangs on the input directly, an input with another
    value than 0, a parameter of the start alone, names that C and MATLAB do not like."""

    inputs = {"power_w": "W", "ambient_degc": "K"}
    optional = {"ambient_degc": 293.15}
    outputs = {"water_degc": "K", "int_w": "W"}
    ports = {"heat": Port("rate", "K/s"), "sensor": Port("reading", "K")}
    states = (State("double", "K"), State("i"))
    parameters = (
        Parameter("e", 0.002, 0.0, 1.0, source="a \\ guess /* ?? */"),
        Parameter("E", 4000.0, 1.0, 1e5),
        Parameter("cold", 280.0, 1.0, 1e3, "K"),
        Parameter("k1", 1.0, 0.0, 5.0),
    )

    def start(self, p: Any) -> dict[str, float]:
        return {"double": p.cold, "i": 0.5 * p.k1}

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Any]:
        heat = port("heat", u.power_w / p.E - p.e * (x.double - u.ambient_degc))
        return {"double": heat, "i": -x.i}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Any]:
        return {"water_degc": port("sensor", x.double) + x.i, "int_w": u.power_w * p.k1}


@dataclass(frozen=True)
class Case:
    """A model with inputs (samples x inputs) and its outputs (samples x outputs), both in the units
    of their names."""

    model: Identified
    inputs: Array
    outputs: Array

    def error(self, outputs: Array) -> float:
        """Largest difference to the model's outputs, as a share of each one's span."""
        return float(
            (np.abs(outputs - self.outputs).max(axis=0) / np.ptp(self.outputs, axis=0)).max()
        )


def made(
    rig: str, *names: str, stepping: Stepping | None = None, background: bool = True
) -> Identified:
    """A rig with effects at their typical size."""
    loaded = Kettle() if rig == "kettle" else rig_named(rig)
    assembly = Assembly(
        loaded, tuple(attach(loaded, n, effects()) for n in names), background=background
    )
    return Identified(loaded.name, assembly, assembly.values(), PERIOD_S, stepping or Stepping())


def with_network() -> Identified:
    """The joint with an Elman network of random weights behind its angle."""
    model, draw = made("one-dof", "coulomb-friction"), np.random.default_rng(3)
    network = Elman(2, 4)
    trained = TrainedNetwork(
        network,
        draw.normal(0.0, 0.3, network.n_weights),
        ("command", "angle_deg"),
        "angle_deg",
        Scaling((-1.0, -50.0), (1.0, 50.0)),
        Scaling((-5.0,), (5.0,)),
        PERIOD_S,
    )
    behind = ModelNetwork(trained, "angle_deg", sources=trained.input_names)
    return Identified(model.name, model.assembly, model.values, PERIOD_S, model.stepping, behind)


CASES = {
    "several effects, two steps": lambda: made("one-dof", *SEVERAL, stepping=Stepping(2)),
    "two effects": lambda: made(
        "one-dof", "bouc-wen-hysteresis", "pwm-quantisation", background=False
    ),
    "implicit": lambda: made("one-dof", "lugre-friction", stepping=Stepping(1, implicit=True)),
    "arm": lambda: made("two-link", "coulomb-friction@joint_2"),
    "cart": lambda: made(CART, "dahl-friction@force", "dead-time@sensor"),
    "kettle": lambda: made("kettle"),
    "network": with_network,
    "no states": lambda: made("cylinder-bench", "gain-error@load_cell"),
    "no states, memory": lambda: made(
        "damper-bench", "coulomb-friction", "dead-time", stepping=Stepping(2)
    ),
}


def driven(model: Identified, samples: int) -> Array:
    """Held random levels on every input, in their units."""
    draw, columns = np.random.default_rng(0), []
    for name in model.inputs:
        size = {"power_w": 2000.0, "ambient_degc": 30.0, "force_n": 5.0}.get(name, 0.4)
        hold = int(draw.integers(60, 140))
        columns.append(np.repeat(draw.uniform(-size, size, samples // hold + 1), hold)[:samples])
    return np.stack(columns, axis=1)


def simulated(model: Identified, inputs: Array) -> Array:
    """The outputs that pamid gives, in their units."""
    u = np.stack(
        [to_si(inputs[:, i], split_column(n)[1]) for i, n in enumerate(model.inputs)], axis=1
    )
    found = simulate_identified(model, u)
    return np.stack(
        [from_si(found[:, i], split_column(n)[1]) for i, n in enumerate(model.outputs)], axis=1
    )


@cache
def case(name: str, samples: int) -> Case:
    """A case, simulated once."""
    model = CASES[name]()
    inputs = driven(model, samples)
    return Case(model, inputs, simulated(model, inputs))
