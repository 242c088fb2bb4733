"""Fits that long windows would trap: a fit from the data sheet along their end ends elsewhere."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_cart import cart_evidence, record_cart
from virtual_recordings import virtual_recording

from pamid.base.parallel.jobs import WorkerPool
from pamid.base.progress import silent
from pamid.diagnosis import budget
from pamid.diagnosis.budget import Budget, gap_budget
from pamid.diagnosis.pipeline import diagnose
from pamid.diagnosis.settings import DEFAULT
from pamid.estimation.grey_box import fit_model
from pamid.estimation.problem import SHORTEST
from pamid.estimation.restart import refound
from pamid.model.attachment import attach
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import read_recording
from pamid.simulation.data_split import DataSplit, split_recordings

PENDULUM = '''"""A pendulum on a motor."""

from pamid import Parameter, Port, Rig, State
from pamid.equations import sin


class Swing(Rig):
    """A pendulum on a motor."""

    inputs = {"torque_n_m": "N m"}
    outputs = {"angle_rad": "rad"}
    ports = {"hinge": Port("motion", "N m", signals=("velocity", "position"))}
    states = (State("angle", "rad"), State("velocity", "rad/s"))
    parameters = (
        Parameter("inertia_kg_m2", 0.02, low=0.002, high=0.2, source="data sheet"),
        Parameter("weight_n_m", 1.0, low=0.1, high=10.0, source="data sheet"),
    )

    def rates(self, x, u, p, port):
        torque = port("hinge", u.torque_n_m, velocity=x.velocity, position=x.angle)
        pull = p.weight_n_m * sin(x.angle)
        return {"angle": x.velocity, "velocity": (torque - pull) / p.inertia_kg_m2}

    def measure(self, x, u, p, port):
        return {"angle_rad": x.angle}
'''
FEW = ("coulomb-friction", "viscous-friction", "dead-time", "linear-stiffness", "gravity")
PERIOD_S, SAMPLES, STEP = 0.01, 3000, 40


@pytest.fixture(scope="module")
def swung(tmp_path_factory) -> DataSplit:
    """A pendulum that rubs and swings over the top; its data sheet is a third off."""
    folder: Path = tmp_path_factory.mktemp("pendulum")
    (folder / "rig.py").write_text(PENDULUM)
    torque = np.random.default_rng(2).uniform(-0.9, 0.9, SAMPLES // STEP).repeat(STEP)
    recording = virtual_recording(
        str(folder / "rig.py"),
        {"torque_n_m": torque},
        PERIOD_S,
        "coulomb-friction:torque_n_m=0.1",
        true={"inertia_kg_m2": 0.03, "weight_n_m": 1.2},
        path=folder / "rec.csv",
    )
    rig = rig_named(str(folder / "rig.py"))
    return split_recordings(rig, [read_recording(recording.path)], [])


def test_a_fit_that_long_windows_would_trap_goes_on_from_shorter_windows(swung):
    model = fit_model(swung, (attach(swung.rig, "coulomb-friction", effects()),))
    inertia, weight, torque, _ = model.fit.p
    assert (inertia, weight, torque) == pytest.approx((0.03, 1.2, 0.1), rel=0.01)


def fitted(evidence: DataSplit) -> Budget:
    return gap_budget(evidence, seed=0, pool=WorkerPool(1), progress=silent, settings=DEFAULT)


def test_a_baseline_in_a_local_minimum_is_fitted_over_shorter_windows(swung):
    catalogue = effects()
    diagnosis = diagnose(swung, {name: catalogue[name] for name in FEW})
    assert refound(diagnosis.budget.model.fit)
    assert diagnosis.verdict == "explained"
    (cause,) = diagnosis.answer.causes
    assert cause.effect.effect.name == "coulomb-friction"


def test_windows_are_halved_until_the_baseline_is_found_again(tmp_path, monkeypatch):
    cart = cart_evidence(record_cart(tmp_path))
    tried = []

    def third(fit):
        tried.append(fit.problem.window)
        return len(tried) == 3

    monkeypatch.setattr(budget, "refound", third)
    assert fitted(cart).model.fit.problem.window == tried[2]
    assert tried[2] == pytest.approx(tried[0] / 4, rel=0.1)
    tried.clear()
    monkeypatch.setattr(budget, "refound", lambda fit: tried.append(fit.problem.window))
    assert fitted(cart).model.fit.problem.window == tried[0]
    assert SHORTEST <= tried[-1] < 3 * SHORTEST


def test_a_fit_that_ended_elsewhere_is_not_found_again(swung):
    fit = fitted(swung).model.fit
    assert refound(fit) and not refound(replace(fit, cost=0.5 * fit.cost))
