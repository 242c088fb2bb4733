"""A single muscle against a mass: its equations beside those of the first paper written by hand,
and what a fit of a virtual recording finds again."""

import json
from pathlib import Path

import numpy as np
import pytest
from pamid_cli import frame

from pamid.engine.program import Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.symbolic.expression import expression
from pamid.model.assembly import Assembly
from pamid.model.registry import catalogue_rig
from pamid.rigs.muscle import LAWS
from pamid.rigs.muscle_mass import MuscleMass

ATMOSPHERE = 101325.0


def static_force(contraction: float, gauge: float) -> float:
    return float(LAWS["exponential"](expression(contraction), expression(gauge)).value)


def run(samples: int, u: np.ndarray, **known: float) -> np.ndarray:
    """Position (m), pressure (Pa, gauge) and force (N), every 3 ms."""
    a = Assembly(catalogue_rig("muscle-mass"), sensitive=frozenset())
    p = a.values(known)
    memory = a.program.memory(a.start(p), period_s=0.003)
    inputs = np.broadcast_to(u, (samples, 2)).copy()
    y, _, bad = a.program.run(memory, SampledInputs(inputs, 0.003), p, stepping=Stepping(4))
    assert bad == -1
    return y


def test_rates_are_the_paper_s_equations():
    """Equations 1 to 5 by hand at one state, while filling and while venting."""
    rig, x = MuscleMass(), {"position": 0.004, "velocity": 0.05, "pressure": 3.2e5}
    rates = Assembly(rig)
    p = {q.name: q.value * q.factor for q in rig.parameters}
    contraction, rate = 0.10 + 0.004 / 0.250, 0.05 / 0.250
    pull = static_force(contraction, x["pressure"] - ATMOSPHERE) - 6e-4 * rate * x["pressure"]
    acceleration = (pull - p["mass"] * 9.81 - p["viscous"] * 0.05 + 7.0) / p["mass"]
    e = contraction
    volume = 2.6421e-4 * e**3 - 7.9263e-4 * e**2 + 4.4988e-4 * e + 7.8540e-5 + 5e-6
    slope = 3 * 2.6421e-4 * e**2 - 2 * 7.9263e-4 * e + 4.4988e-4

    def flow(up, down):
        inside = max(down / up - 0.433, 0.0) / (1.0 - 0.433)
        return 3.777e-9 * up * np.sqrt(1.0 - inside**2)

    supply = 600e3 + ATMOSPHERE
    air = {0.4: 0.4 * flow(supply, 3.2e5), -0.3: -0.3 * flow(3.2e5, ATMOSPHERE)}
    for command, drawn in air.items():
        expected = (ATMOSPHERE * drawn - x["pressure"] * slope * rate) / volume
        step = 1e-6
        memory = rates.program.memory(np.array([x[s.name] for s in rig.states]), period_s=step)
        u = np.broadcast_to([command, 7.0], (2, 2)).copy()
        y, _, _ = rates.program.run(memory, SampledInputs(u, step), rates.values())
        assert y[0, 1] == pytest.approx(x["pressure"] - ATMOSPHERE, rel=1e-12)
        assert (y[1, 1] - y[0, 1]) / step == pytest.approx(expected, rel=1e-3)
        moved = y[1, 0] - y[0, 0]
        assert moved == pytest.approx(0.05 * step + 0.5 * acceleration * step**2, abs=1e-15)


def test_a_virtual_recording_tells_its_damper_and_its_scale(here, capsys):
    for words in (
        "generate-aprbs --rig muscle-mass --duration 9 --seed 1 --output u.csv",
        "simulate --rig muscle-mass --excitation u.csv --set damping_m2_s=0.001 --set scale=1.1 "
        "--seed 2 --output rec.csv",
        "check rec.csv --rig muscle-mass",
        "fit rec.csv --rig muscle-mass --output run",
    ):
        assert frame.run(words.split()) == 0, capsys.readouterr()
    found = json.loads(Path("run/fit.json").read_text())
    for name, truth in (("damping_m2_s", 0.001), ("scale", 1.1)):
        one = found["parameters"][name]
        assert one["low"] < truth < one["high"], one
        assert one["value"] == pytest.approx(truth, rel=0.1)
    for channel, one in found["mae"].items():
        assert one["refitted"] < 1.2 * one["noise_floor"], channel
