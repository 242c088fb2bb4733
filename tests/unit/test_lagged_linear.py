"""The lagged linear regression that shows whether recordings contain a response."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pamid.base.arrays import Array
from pamid.estimation.lagged_linear import inputs_move, lagged_response
from pamid.model.assembly import Assembly
from pamid.model.registry import rig_named
from pamid.recording.recording import read_recording, write_recording
from pamid.simulation.data_split import split_recordings
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.tracks import Track

CART = str(Path(__file__).resolve().parents[2] / "data" / "rigs" / "cart.py")
PERIOD_S, SAMPLES = 0.02, 1500


def moved(force: Array, drag: float = 2.0) -> Array:
    """Position of a cart of 1 kg with viscous drag, with noise."""
    position, velocity = np.zeros(len(force)), 0.0
    for k in range(len(force) - 1):
        velocity += PERIOD_S * (force[k] - drag * velocity)
        position[k + 1] = position[k] + PERIOD_S * velocity
    return position + 5e-4 * np.random.default_rng(3).standard_normal(len(force))


@pytest.fixture(scope="module")
def force() -> Array:
    return aprbs(SAMPLES * PERIOD_S, PERIOD_S, 3.0, (0.16, 0.8), seed=1)


def response(folder: Path, force: Array, position: Array, period_s: float = PERIOD_S) -> Any:
    time_s = period_s * np.arange(len(force))
    write_recording(folder / "rec.csv", time_s, {"force_n": force, "position_m": position})
    data = split_recordings(rig_named(CART), [read_recording(folder / "rec.csv")], [])
    return lagged_response(data, Assembly(data.rig))


@pytest.mark.parametrize("step", [1, -1], ids=["forward", "rows in reverse order"])
def test_a_machine_responds_in_its_direction(step, force, tmp_path):
    found = response(tmp_path, force[::step], moved(force)[::step])
    assert found.is_clear and found.is_reversed == (step < 0)


@pytest.mark.parametrize(
    ("scale", "period_s"), [(-1.0, PERIOD_S), (1e4, PERIOD_S), (1e-6, PERIOD_S), (1.0, 60.0)]
)
def test_neither_sign_nor_unit_matters(scale, period_s, force, tmp_path):
    usual = response(tmp_path, force, moved(force))
    other = response(tmp_path, -scale * force, scale * moved(force), period_s)
    assert other.forward == pytest.approx(usual.forward, rel=1e-3)
    assert other.backwards == pytest.approx(usual.backwards, rel=1e-3)


@pytest.mark.parametrize("kind", ["ramp", "sine", "noise", "foreign"])
def test_an_output_without_the_input_does_not_respond(kind, force, tmp_path):
    time_s = PERIOD_S * np.arange(SAMPLES)
    noise = np.random.default_rng(5).standard_normal(SAMPLES)
    position = {
        "ramp": 0.5 * time_s + 5e-4 * noise,
        "sine": np.sin(2.0 * time_s) + 5e-4 * noise,
        "noise": noise,
        "foreign": moved(aprbs(SAMPLES * PERIOD_S, PERIOD_S, 3.0, (0.16, 0.8), seed=8)),
    }[kind]
    assert response(tmp_path, force, position).absent.all()


@pytest.mark.parametrize(
    ("u", "moves"),
    [
        (np.r_[np.zeros(50), np.ones(50)], False),  # one step
        (np.linspace(0.0, 1.0, 100), False),
        (np.full(100, 3.0), False),
        (np.r_[np.zeros(80), np.ones(3), np.zeros(17)], True),  # a short pulse
        (np.sin(np.arange(100)), True),
    ],
)
def test_an_input_moves_to_and_fro(u, moves):
    y = np.zeros((len(u), 1))
    track = Track("rec", u[:, None], y, np.zeros(0), (), 1.0, np.zeros(0), 1.0)
    assert inputs_move([track]) == moves
