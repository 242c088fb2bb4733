"""Training that is interrupted, or dies, goes on as if nothing had happened."""

from typing import Any

import numpy as np
import pytest

import pamid.networks.network_training as training_module
from pamid.base.errors import FileError
from pamid.networks.checkpoints import TrainingStep
from pamid.networks.elman import Elman
from pamid.networks.network_training import Training, train
from pamid.networks.training_problem import TrainingOptions


def teacher_data() -> tuple[np.ndarray, np.ndarray]:
    """Held random levels into a random Elman network, its output scaled and noisy."""
    draw = np.random.default_rng(5)
    u = np.repeat(draw.uniform(-1.0, 1.0, (75, 2)), 20, axis=0)
    teacher = Elman(2, 3)
    y = teacher.simulate(0.6 * np.random.default_rng(7).normal(size=teacher.n_weights), u)
    return u, y / np.abs(y).max() + 0.02 * draw.normal(size=len(u))


U, TARGET = teacher_data()


def trained(target: np.ndarray = TARGET, **options: Any) -> Training:
    return train(Elman(2, 4), U, target, options=TrainingOptions(**options))


def stop_at(iteration, start=0, error=KeyboardInterrupt):
    def progress(step: TrainingStep, number: int) -> None:
        if (step.iteration, number) == (iteration, start):
            raise error

    return progress


def same(a: Training, b: Training) -> None:
    np.testing.assert_array_equal(a.weights, b.weights)
    assert a.why == b.why and a.starts_mse == b.starts_mse and a.best == b.best
    assert (a.effective_samples, a.supported_weights) == (b.effective_samples, b.supported_weights)
    for name in a.trace:
        np.testing.assert_array_equal(a.trace[name], b.trace[name], err_msg=name)


def test_interrupt_returns_the_best_so_far():
    stopped = trained(iterations=50, progress=stop_at(6))
    assert stopped.why == "interrupted" and not stopped.converged
    np.testing.assert_array_equal(stopped.weights, trained(iterations=6).weights)
    second = trained(iterations=12, starts=3, progress=stop_at(0, start=1))
    # where it waits for the others
    at_the_gate = trained(iterations=training_module.GATES[0])
    np.testing.assert_array_equal(second.weights, at_the_gate.weights)
    assert len(second.starts_mse) == 2
    assert second.why == "interrupted" and not second.converged


@pytest.mark.parametrize("start", [0, 1])
def test_resuming_equals_never_having_stopped(tmp_path, start):
    options = {"iterations": 15, "starts": 2, "seed": 3}
    kept = {**options, "checkpoint": tmp_path / "checkpoint.npz"}
    trained(**kept, progress=stop_at(7, start))
    same(trained(**kept, resume=True), trained(**options))


def test_resuming_after_a_crash(tmp_path, monkeypatch):
    monkeypatch.setattr(training_module, "_CHECKPOINT_SECONDS", 0.0)
    kept = {"iterations": 15, "checkpoint": tmp_path / "checkpoint.npz"}
    with pytest.raises(RuntimeError):
        trained(**kept, progress=stop_at(9, error=RuntimeError))
    seen = []
    resumed = trained(**kept, resume=True, progress=lambda step, _: seen.append(step.iteration))
    assert seen == [10, 11, 12, 13, 14, 15]
    same(resumed, trained(iterations=15))


@pytest.mark.parametrize("starts", [1, 3])
def test_a_finished_training_can_be_prolonged(tmp_path, starts):
    kept = {"starts": starts, "checkpoint": tmp_path / "checkpoint.npz"}
    trained(iterations=5, **kept)
    prolonged = trained(iterations=12, **kept, resume=True)
    same(prolonged, trained(iterations=12, starts=starts))


def test_foreign_or_broken_checkpoints_are_refused(tmp_path):
    kept = {"iterations": 2, "checkpoint": tmp_path / "checkpoint.npz"}
    trained(**kept)
    with pytest.raises(FileError, match="another training"):
        trained(TARGET + 1e-9, **kept, resume=True)
    with pytest.raises(FileError, match="another training"):
        trained(**kept, seed=1, resume=True)
    kept["checkpoint"].write_bytes(kept["checkpoint"].read_bytes()[:200])
    with pytest.raises(FileError, match="not a plain npz"):
        trained(**kept, resume=True)
    with pytest.raises(FileError, match="cannot be written"):
        trained(iterations=2, checkpoint=tmp_path / "no_folder" / "checkpoint.npz")
