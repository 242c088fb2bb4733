"""Inputs whose term moves nothing, and recorded columns that the rig leaves out, are named."""

from pathlib import Path

import numpy as np
import pytest

from pamid.api.checking import check
from pamid.estimation.lagged_linear import lagged_share
from pamid.recording.recording import write_recording
from pamid.simulation.excitation.aprbs import aprbs

PERIOD_S = 2.0
BOILER = '''"""A boiler: a heater, and water that takes heat away."""
from pamid import Parameter, Port, Rig, State


class Boiler(Rig):
    """A heated block that cools to a room, and by the water that flows through it."""

    inputs = {"power_w": "W"FLOW}
    outputs = {"block_degc": "K"}
    noise = {"block_degc": 0.1}
    ports = {"block": Port("rate", "K/s", {"stored": "K"}), "sensor": Port("reading", "K")}
    states = (State("temperature", "K", 293.15),)
    parameters = (
        Parameter("capacity", 3000.0, 300.0, 30000.0, "J/K", source="weighed"),
        Parameter("loss", 2.0, 0.2, 20.0, "W/K", source="sheet"),
    )
    period_s = 2.0

    def rates(self, x, u, p, port):
        above = x.temperature - 293.15
        heat = (u.power_w - (p.loss + WATER) * above) / p.capacity
        return {"temperature": port("block", heat, stored=above)}

    def measure(self, x, u, p, port):
        return {"block_degc": port("sensor", x.temperature)}
'''
DECLARED = ', "flow_ml_per_min": "m3/s"'


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """A recording with pulses of water, and three rigs: with the right term of the water, with one
    in ml/min though the equations see m3/s, and without any."""
    folder = tmp_path_factory.mktemp("boiler")
    for name, flow, water in (
        ("right", DECLARED, "4.18e6 * u.flow_ml_per_min"),
        ("dead", DECLARED, "4.18 / 60.0 * u.flow_ml_per_min"),
        ("without", "", "0.0"),
    ):
        (folder / f"{name}.py").write_text(BOILER.replace("FLOW", flow).replace("WATER", water))
    random, samples = np.random.default_rng(9), 3000
    power = 400.0 + aprbs(samples * PERIOD_S, PERIOD_S, 380.0, (60.0, 320.0), seed=4)
    flow = np.zeros(samples)
    for begin in range(150, samples, 220):
        flow[begin : begin + 15] = random.choice([240.0, 360.0, 480.0])
    block = np.empty(samples)
    temperature = 293.15
    for k in range(samples):
        block[k] = temperature - 273.15
        loss = (2.0 + 4.18e6 * flow[k] / 6e7) * (temperature - 293.15)
        temperature += PERIOD_S * (power[k] - loss) / 3000.0
    columns = {
        "power_w": power,
        "block_degc": block + random.normal(0.0, 0.1, samples),
        "flow_ml_per_min": flow,
        "humidity_percent": np.repeat(random.uniform(30.0, 60.0, samples // 50), 50),
    }
    write_recording(folder / "rec.csv", PERIOD_S * np.arange(samples), columns)
    return folder


@pytest.mark.parametrize(("rig", "idle"), [("right", False), ("dead", True)])
def test_check_names_an_input_that_moves_nothing(made, rig, idle):
    said = check(made / "rec.csv", rig=str(made / f"{rig}.py")).to_dict()
    found = [f["detail"] for f in said["findings"] if f["check"] == "idle-input"]
    assert len(found) == idle and said["ok"]
    for text in found:
        assert "flow_ml_per_min (0 .. 480) changes no output by more than its noise" in text
        assert "Check its unit" in text


def test_a_regression_explains_what_follows_and_nothing_else():
    random = np.random.default_rng(3)
    pulses = np.repeat(random.choice([0.0, 0.0, 1.0], 200), 15)
    other = np.repeat(random.choice([0.0, 0.0, 1.0], 200), 15)
    left = np.convolve(pulses, np.exp(-np.arange(60) / 20.0), "full")[: pulses.size]
    left = left - left.mean() + 0.1 * random.normal(size=left.size)
    assert lagged_share([(left, pulses, 1.0)], 20.0) > 0.5
    assert lagged_share([(left, other, 1.0)], 20.0) == 0.0
    assert lagged_share([(left, np.ones(left.size), 1.0)], 20.0) == 0.0
