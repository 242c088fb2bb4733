"""A latent value per port: the smoother's algebra, and where it places what was planted."""

from pathlib import Path

import numpy as np
import pytest
from virtual_joint import record

from pamid.base.parallel.jobs import WorkerPool
from pamid.diagnosis.candidate_model import CandidateModel, candidate_from
from pamid.diagnosis.settings import DEFAULT
from pamid.engine.block_tridiagonal import eliminate
from pamid.estimation.grey_box import fit_model
from pamid.estimation.port_evidence import PortEvidence, locate, shapley_value
from pamid.estimation.smoother import Smoother, SmoothingProblem
from pamid.model.registry import rig_named
from pamid.simulation.data_split import DataSplit, split_recordings

SENSORS = ("reference_deg", "command", "angle_deg", "pressure_1_kpa", "pressure_2_kpa")


def test_elimination_equals_the_dense_solution():
    random = np.random.default_rng(3)
    w, n, m = 7, 4, 3
    A = random.standard_normal((w * n, w * n))
    keep = np.kron(np.eye(w) + np.eye(w, k=1) + np.eye(w, k=-1), np.ones((n, n)))
    dense = (A @ A.T) * keep + 30.0 * np.eye(w * n)
    rhs = random.standard_normal((w, n, m))
    D = np.stack([dense[i * n : (i + 1) * n, i * n : (i + 1) * n] for i in range(w)])
    off = np.stack([dense[(i + 1) * n : (i + 2) * n, i * n : (i + 1) * n] for i in range(w - 1)])
    x, log_det = eliminate(D, off, rhs, 0.0)
    assert x.reshape(-1, m) == pytest.approx(
        np.linalg.solve(dense, rhs.reshape(-1, m)), rel=1e-9, abs=1e-12
    )
    assert log_det == pytest.approx(np.linalg.slogdet(dense)[1], rel=1e-9)


def recorded(folder: Path, effect: str) -> tuple[DataSplit, CandidateModel]:
    """15 s of a joint with an effect that its baseline does not know."""
    recording = record(
        folder / f"{effect or 'nothing'}.csv",
        15.0,
        seed=7,
        effects=(effect,) if effect else (),
        columns=SENSORS,
        known={"inertia_kg_m2": 0.014},
    )
    evidence = split_recordings(rig_named("one-dof"), [recording], [])
    model = fit_model(evidence)
    return evidence, candidate_from(model.assembly, model.fit, model.held_out)


def located(folder: Path, effect: str) -> tuple[CandidateModel, PortEvidence]:
    evidence, base = recorded(folder, effect)
    return base, locate(evidence, base, WorkerPool(), alike=DEFAULT.port_alike)


@pytest.mark.parametrize(
    ("effect", "port", "among"),
    [
        ("coulomb-friction", "joint", 1),
        ("leak", "pressure", 2),
        ("pressure-sensor-offset", "pressure_sensor", 1),
    ],
)
def test_places_what_was_planted(tmp_path, effect, port, among):
    """The planted port is in the class of ports with the largest evidence; for a leak, which shows
    in the pressures alone, the pressure sensors can follow it as well."""
    _, found = located(tmp_path, effect)
    assert any(port in k for k in found.classes[:among]), found.gains
    assert found.most > 500.0
    rig = rig_named("one-dof")
    shares = found.shares(rig)
    assert sum(shares.values()) == pytest.approx(1.0)


def test_nothing_missing_finds_nothing(tmp_path):
    base, found = located(tmp_path, "")
    samples = sum(int(r.scored.sum()) for r in base.replays)
    assert found.most < 0.05 * samples


@pytest.fixture(scope="module")
def bent(tmp_path_factory) -> tuple[DataSplit, CandidateModel]:
    """Its parameters have bent to the friction."""
    return recorded(tmp_path_factory.mktemp("bent"), "coulomb-friction")


def test_the_right_port_leaves_nothing(bent):
    """With a latent torque the data are explained down to the noise; with a latent flow they are
    not."""
    left = {}
    for port in ("joint", "valve"):
        smoother = Smoother(*bent, (port,))
        left[port] = (
            sum(one.cost for one in smoother.best.linearised)
            / (len(SENSORS) - 2)
            / len(bent[1].replays[0].track)
        )
    assert left["joint"] < 1.3 < 1.6 < left["valve"]


def test_two_classes_share_what_they_explain_together():
    values = shapley_value(3.0, 1.0, 3.5), shapley_value(1.0, 3.0, 3.5)
    assert values == (2.75, 0.75) and sum(values) == 3.5
    assert shapley_value(3.0, 3.0, 3.0) == 1.5, "what either explains is shared equally"


def test_a_step_goes_where_the_cost_falls(bent):
    """Along the Gauss-Newton step the cost falls by twice the promised gain per unit: the gradient
    over states, latent values, joints and parameters is that of the cost."""
    smoother = Smoother(*bent, ("joint",))
    s, x = smoother.fitted, tuple(track.start for track in smoother.tracks)
    solver = SmoothingProblem(smoother, smoother._priors(x, 0.03, 0.1), True)
    point = solver.point(s, x, smoother._linearised(s, x, True))
    step = solver.step(point, 1e-3)

    def cost(share):
        part = step._replace(s=share * step.s, x=[share * d for d in step.x])
        return solver.moved(point, part).cost

    slope = (cost(1e-5) - cost(-1e-5)) / 2e-5
    assert np.abs(step.s).max() > 0.01, "the parameters take part"
    assert slope == pytest.approx(-2.0 * step.gain, rel=2e-3)
