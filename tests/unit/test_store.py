"""Scaling, and a trained network with its two files."""

import hashlib
import json
import pickle

import numpy as np
import pytest

from pamid.base.errors import FileError
from pamid.networks.elman import Elman
from pamid.networks.scaling import Scaling, scaling_of
from pamid.networks.trained_network import (
    TrainedNetwork,
    load_network,
    save_network,
    train_on_signals,
)
from pamid.networks.training_problem import TrainingOptions


def teacher_data() -> tuple[np.ndarray, np.ndarray]:
    """Held random levels into a random Elman network, its output scaled and noisy."""
    draw = np.random.default_rng(5)
    u = np.repeat(draw.uniform(-1.0, 1.0, (75, 2)), 20, axis=0)
    teacher = Elman(2, 3)
    y = teacher.simulate(0.6 * np.random.default_rng(7).normal(size=teacher.n_weights), u)
    return u, y / np.abs(y).max() + 0.01 * draw.normal(size=len(u))


def test_scaling():
    data = np.array([[0.0, 10.0], [4.0, 30.0], [1.0, 20.0]])
    scaling = scaling_of(data, ("angle", "pressure"))
    assert scaling == Scaling((0.0, 10.0), (4.0, 30.0))
    np.testing.assert_allclose(scaling.forward(data), [[-1.0, -1.0], [1.0, 1.0], [-0.5, 0.0]])
    np.testing.assert_allclose(scaling.backward(scaling.forward(data)), data, atol=1e-14)
    alone = scaling_of(data[:, 1], ("pressure",))
    np.testing.assert_allclose(alone.backward(alone.forward(data[:, 1])), data[:, 1], atol=1e-14)


# --- a trained network and its files --------------------


@pytest.fixture(scope="module")
def trained() -> tuple[TrainedNetwork, dict[str, np.ndarray], np.ndarray]:
    u, target = teacher_data()
    signals = {"angle_deg": 40.0 * u[:, 0], "pressure_kpa": 200.0 + 50.0 * u[:, 1]}
    network, _ = train_on_signals(
        Elman(2, 3),
        signals,
        3.0 * target + 1.0,
        output_name="residual_deg",
        period_s=0.003,
        options=TrainingOptions(iterations=60),
    )
    return network, signals, 3.0 * target + 1.0


class Trap:
    sprung = False

    def __reduce__(self):
        return setattr, (Trap, "sprung", True)


def replace_weights(folder, content: bytes, keep_hash: bool = False) -> None:
    (folder / "network.npz").write_bytes(content)
    if not keep_hash:  # an attacker who also mends the hash
        about = json.loads((folder / "network.json").read_text())
        about["weights"]["sha256"] = hashlib.sha256(content).hexdigest()
        (folder / "network.json").write_text(json.dumps(about))


def npz(tmp_path, **arrays) -> bytes:
    np.savez(tmp_path / "other.npz", **arrays)
    return (tmp_path / "other.npz").read_bytes()


def test_tampered_weights_are_refused(trained, tmp_path):
    save_network(tmp_path, trained[0])
    replace_weights(tmp_path, npz(tmp_path, weights=trained[0].weights + 1e-3), keep_hash=True)
    with pytest.raises(FileError, match="was changed"):
        load_network(tmp_path)


def test_pickles_are_refused_and_never_run(trained, tmp_path):
    save_network(tmp_path, trained[0])
    for content in (
        pickle.dumps(Trap()),
        npz(tmp_path, weights=np.array([Trap()] * 22, dtype=object)),
    ):
        replace_weights(tmp_path, content)
        with pytest.raises(FileError, match="npz file"):
            load_network(tmp_path)
    assert not Trap.sprung


@pytest.mark.parametrize(
    "weights", [np.zeros(21), np.zeros((22, 1)), np.zeros(22, dtype=np.float32)]
)
def test_wrong_arrays_are_refused(trained, tmp_path, weights):
    save_network(tmp_path, trained[0])
    replace_weights(tmp_path, npz(tmp_path, weights=weights))
    with pytest.raises(FileError, match="should hold 22 float64 weights"):
        load_network(tmp_path)
    replace_weights(tmp_path, npz(tmp_path, weights=np.full(22, np.nan)))
    with pytest.raises(FileError, match="not finite"):
        load_network(tmp_path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda a: a.update(schema="pamid.network/9"), "is not a pamid.network/1"),
        (lambda a: a.update(kind="elmann"), "unknown kind of network 'elmann'.*elman"),
        (lambda a: a.pop("period_s"), "lacks 'period_s'"),
        (lambda a: a["sizes"].update(hidden=-1), "whole number"),
        (lambda a: a["sizes"].update(depth=2), "does not describe a network"),
        (lambda a: a["inputs"].pop(), "does not describe a network"),
        (lambda a: a["output"].update(low="x"), "does not describe a network"),
        (lambda a: a.update(inputs=3), "does not describe a network"),
    ],
)
def test_wrong_descriptions_are_refused(trained, tmp_path, change, words):
    save_network(tmp_path, trained[0])
    about = json.loads((tmp_path / "network.json").read_text())
    change(about)
    (tmp_path / "network.json").write_text(json.dumps(about))
    with pytest.raises(FileError, match=words):
        load_network(tmp_path)
