"""The ANFIS network against finite differences and plain sums; its use as a muscle's force law
inside a rig."""

import itertools
import math

import numpy as np
import pytest

from pamid.base.errors import DataError
from pamid.engine.symbolic.vocabulary import expression
from pamid.model.assembly import Assembly
from pamid.model.registry import rig_named
from pamid.networks.anfis import Anfis
from pamid.networks.correction.trained_force_law import (
    ForceLaw,
    _extended,
    _steps,
    check_force_law,
    force_law_of,
)
from pamid.networks.network_training import train
from pamid.networks.scaling import Scaling
from pamid.networks.trained_network import (
    TrainedNetwork,
    load_network,
    save_network,
    train_on_signals,
)
from pamid.networks.training_problem import TrainingOptions
from pamid.rigs.muscle import exponential
from pamid.simulation.free_runs import free_run

KINDS = pytest.mark.parametrize(
    "network",
    [Anfis(1, 4), Anfis(2, 3), Anfis(3, 2)],
    ids=str,
)


def record(network: Anfis, samples: int = 40, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Weights of order one and inputs that also lie on a grid place and outside [-1, 1]."""
    draw = np.random.default_rng(seed)
    u = draw.uniform(-1.3, 1.3, (samples, network.inputs))
    u[0] = -1.0
    return draw.normal(size=network.n_weights), u


def by_hand(network: Anfis, weights: np.ndarray, row: np.ndarray) -> float:
    """The documented equations and layout, rule by rule."""
    m, n, h = network.inputs, network.sets, 2.0 / (network.sets - 1)
    grid = [-1.0 + h * i for i in range(n)]
    w = [float(v) for v in weights]

    def membership(k: int, i: int) -> float:
        own = w[(k * n + i) * 2 : (k * n + i + 1) * 2]
        bent = [limit * math.tanh(d / limit) for d, limit in zip(own, (0.45, 1.5), strict=True)]
        t = (row[k] - grid[i] - h * bent[0]) / (h * 0.6 * math.exp(bent[1]))
        return math.exp(-0.5 * t * t)

    above = below = 0.0
    for r, rule in enumerate(itertools.product(range(n), repeat=m)):
        fired = math.prod(membership(k, i) for k, i in enumerate(rule))
        bias, *slopes = w[m * n * 2 + r * (m + 1) :][: m + 1]
        above += fired * (
            bias
            + sum(
                s * (row[k] - grid[i]) / h
                for k, (s, i) in enumerate(zip(slopes, rule, strict=True))
            )
        )
        below += fired
    return above / below


@KINDS
def test_output_follows_the_documented_equations(network):
    weights, u = record(network)
    held = np.clip(u, -1.0, 1.0)  # beyond the range counts as its edge
    assert (held != u).any()
    np.testing.assert_allclose(
        network.simulate(weights, u), [by_hand(network, weights, x) for x in held], atol=1e-12
    )


def test_training_recovers_a_smooth_function():
    """Noise of 2e-3 of the range; 95 weights from 4000 samples leave an error of about 3e-4."""
    draw = np.random.default_rng(0)
    u = draw.uniform(-1.0, 1.0, (4000, 2))
    truth = 0.75 * np.tanh(2.0 * u[:, 0] + u[:, 1]) + 0.2 * np.sin(2.0 * u[:, 1]) * u[:, 0]
    network = Anfis(2, 5)
    training = train(
        network,
        u,
        truth + 4e-3 * draw.standard_normal(len(u)),
        options=TrainingOptions(iterations=15),
    )
    error = network.simulate(training.weights, u) - truth
    assert math.sqrt(np.mean(error**2)) / np.ptp(truth) < 4e-4


# ---- force laws --------------------


def chart(contraction: np.ndarray, pressure_kpa: np.ndarray) -> np.ndarray:
    """The rig's own law, N."""
    pairs = zip(contraction.tolist(), pressure_kpa.tolist(), strict=True)
    return np.array([float(exponential(expression(e), expression(1e3 * p))) for e, p in pairs])


@pytest.fixture(scope="module")
def muscle() -> TrainedNetwork:
    """5 x 5 rules on 2000 points of the rig's own law; pressure first."""
    draw = np.random.default_rng(0)
    e, p = draw.uniform(-0.03, 0.25, 2000), draw.uniform(0.0, 650.0, 2000)
    return train_on_signals(
        Anfis(2, 5),
        {"pressure_bar": p / 100.0, "contraction": e},
        chart(e, p) / 1e3,
        output_name="force_kn",
        period_s=1.0,
        options=TrainingOptions(iterations=60),
    )[0]


def evaluated(law: ForceLaw, contraction: float, pressure_kpa: float) -> float:
    return float(law(expression(contraction), expression(1e3 * pressure_kpa)))


def test_force_law_is_the_networks_prediction_in_si(muscle, tmp_path):
    save_network(tmp_path, muscle)
    law, draw = force_law_of(tmp_path), np.random.default_rng(3)
    np.testing.assert_array_equal(load_network(tmp_path).weights, muscle.weights)
    assert load_network(tmp_path).network == muscle.network
    for e, p in zip(draw.uniform(-0.02, 0.24, 20), draw.uniform(10.0, 640.0, 20), strict=True):
        wanted = (
            1e3 * muscle.predict(dict(zip(muscle.input_names, ([p / 100.0], [e]), strict=True)))[0]
        )
        assert evaluated(law, e, p) == pytest.approx(wanted, abs=1e-8)
        assert wanted == pytest.approx(chart(np.array([e]), np.array([p]))[0], abs=1.0)  # N


def test_the_guard_looks_at_the_law_itself(muscle):
    law, side = force_law_of(muscle), len(_steps())
    grid = _extended(lambda inputs: muscle.network.simulate(muscle.weights, inputs))
    # pressure in bar, contraction
    steps = muscle.input_scaling.backward(np.stack([_steps(), _steps()], axis=1))
    force = muscle.output_scaling.backward(grid.ravel()).reshape(side, side) * 1e3
    for i, k in ((0, 0), (0, 60), (120, 120), (3, 118), (60, 60), (119, 2)):
        # N
        assert force[i, k] == pytest.approx(
            evaluated(law, steps[k, 1], 100.0 * steps[i, 0]), abs=0.05
        )


RIG_FILE = """
from pathlib import Path

from pamid.networks.correction.trained_force_law import force_law_of
from pamid.rigs.one_dof import OneDof


class TrainedJoint(OneDof):
    def __init__(self) -> None:
        super().__init__()
        self.static_force = force_law_of(Path(__file__).parent)
"""


def test_rig_file_with_the_trained_law_moves_as_the_rig_with_its_own(muscle, tmp_path):
    save_network(tmp_path, muscle)
    (tmp_path / "trained_joint.py").write_text(RIG_FILE)
    command = np.repeat(np.random.default_rng(5).choice([-1.0, 1.0], 16), 60)
    u = np.column_stack([command, np.zeros_like(command)])
    angles = []
    for name in ("one-dof", str(tmp_path / "trained_joint.py")):
        assembly = Assembly(rig_named(name))
        angles.append(np.rad2deg(free_run(assembly, u, assembly.values({}), 0.003).outputs[:, 0]))
    assert np.ptp(angles[0]) > 30.0
    assert 0.0 < np.abs(angles[1] - angles[0]).max() < 0.01


def wavy(along: int, size_n: float) -> TrainedNetwork:
    """1000 N at 500 kPa and contraction 0, falling to 0, with a wave along one input that counters
    the slope midway."""
    x = np.random.default_rng(0).uniform(-1.0, 1.0, (3000, 2))
    network = Anfis(2, 5)
    wave = size_n * np.sin(4.0 * x[:, along]) * (1.0 if along == 0 else -1.0)
    force = 500.0 + 250.0 * (x[:, 1] - x[:, 0]) + wave
    weights = train(network, x, force / 500.0 - 1.0, options=TrainingOptions(iterations=10)).weights
    return TrainedNetwork(
        network,
        weights,
        ("contraction", "pressure_kpa"),
        "force_n",
        Scaling((0.0, 0.0), (0.25, 500.0)),
        Scaling((0.0,), (1000.0,)),
        1.0,
    )


def test_guard_lets_a_monotone_law_pass(muscle):
    for law, most in ((muscle, 1.0), (wavy(1, 0.0), 0.1)):
        wrong_way, fault = check_force_law(law)
        assert max(wrong_way) < most and not fault


@pytest.mark.parametrize(
    ("along", "words"),
    [
        (1, r"falls from .* N between pressure_kpa = .* and "),
        (0, r"grows from .* N between contraction = .* and "),
    ],
)
def test_guard_says_where_a_law_moves_the_wrong_way(along, words):
    law = wavy(along, 150.0)
    with pytest.raises(DataError, match=words) as refused:
        force_law_of(law)
    assert ("between contraction" in str(refused.value)) == (along == 0)
    with pytest.warns(UserWarning, match=words):
        force_law_of(law, strict=False)
    found, _ = check_force_law(law)
    turn = math.acos(250.0 / 600.0) / 4.0  # the slope of 150 sin 4x - 250 x changes sign at +-turn
    fall = 2.0 * (150.0 * math.sin(4.0 * turn) - 250.0 * turn)
    assert found[1 - along] == pytest.approx(fall, rel=0.02)
    assert found[along] < 5.0
