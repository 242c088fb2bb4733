"""Training that is interrupted, or dies, goes on as if nothing had happened."""

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
    u, target = teacher_data()
    stopped = train(
        Elman(2, 3), u, target, options=TrainingOptions(iterations=50, progress=stop_at(6))
    )
    assert stopped.why == "interrupted" and not stopped.converged
    np.testing.assert_array_equal(
        stopped.weights,
        train(Elman(2, 3), u, target, options=TrainingOptions(iterations=6)).weights,
    )
    second = train(
        Elman(2, 3),
        u,
        target,
        options=TrainingOptions(iterations=12, starts=3, progress=stop_at(0, start=1)),
    )
    # where it waits for the others
    at_the_gate = train(
        Elman(2, 3), u, target, options=TrainingOptions(iterations=training_module.GATES[0])
    )
    np.testing.assert_array_equal(second.weights, at_the_gate.weights)
    assert len(second.starts_mse) == 2
    assert second.why == "interrupted" and not second.converged


@pytest.mark.parametrize("start", [0, 1])
def test_resuming_equals_never_having_stopped(tmp_path, start):
    u, target = teacher_data()
    options = {"iterations": 15, "starts": 2, "seed": 3}
    undisturbed = train(Elman(2, 4), u, target, options=TrainingOptions(**options))
    file = tmp_path / "checkpoint.npz"
    train(
        Elman(2, 4),
        u,
        target,
        options=TrainingOptions(**options, checkpoint=file, progress=stop_at(7, start)),
    )
    same(
        train(
            Elman(2, 4), u, target, options=TrainingOptions(**options, checkpoint=file, resume=True)
        ),
        undisturbed,
    )


def test_resuming_after_a_crash(tmp_path, monkeypatch):
    monkeypatch.setattr(training_module, "_CHECKPOINT_SECONDS", 0.0)
    u, target = teacher_data()
    file = tmp_path / "checkpoint.npz"
    with pytest.raises(RuntimeError):
        train(
            Elman(2, 4),
            u,
            target,
            options=TrainingOptions(
                iterations=15, checkpoint=file, progress=stop_at(9, error=RuntimeError)
            ),
        )
    seen = []
    going_on = {
        "checkpoint": file,
        "resume": True,
        "progress": lambda step, _: seen.append(step.iteration),
    }
    resumed = train(Elman(2, 4), u, target, options=TrainingOptions(iterations=15, **going_on))
    assert seen == [10, 11, 12, 13, 14, 15]
    same(resumed, train(Elman(2, 4), u, target, options=TrainingOptions(iterations=15)))


@pytest.mark.parametrize("starts", [1, 3])
def test_a_finished_training_can_be_prolonged(tmp_path, starts):
    u, target = teacher_data()
    file = tmp_path / "checkpoint.npz"
    train(
        Elman(2, 4),
        u,
        target,
        options=TrainingOptions(iterations=5, starts=starts, checkpoint=file),
    )
    prolonged = train(
        Elman(2, 4),
        u,
        target,
        options=TrainingOptions(iterations=12, starts=starts, checkpoint=file, resume=True),
    )
    same(
        prolonged,
        train(Elman(2, 4), u, target, options=TrainingOptions(iterations=12, starts=starts)),
    )


def test_foreign_or_broken_checkpoints_are_refused(tmp_path):
    u, target = teacher_data()
    file = tmp_path / "checkpoint.npz"
    train(Elman(2, 4), u, target, options=TrainingOptions(iterations=2, checkpoint=file))
    with pytest.raises(FileError, match="another training"):
        train(
            Elman(2, 4),
            u,
            target + 1e-9,
            options=TrainingOptions(iterations=2, checkpoint=file, resume=True),
        )
    with pytest.raises(FileError, match="another training"):
        train(
            Elman(2, 4),
            u,
            target,
            options=TrainingOptions(iterations=2, seed=1, checkpoint=file, resume=True),
        )
    file.write_bytes(file.read_bytes()[:200])
    with pytest.raises(FileError, match="not a plain npz"):
        train(
            Elman(2, 4),
            u,
            target,
            options=TrainingOptions(iterations=2, checkpoint=file, resume=True),
        )
    with pytest.raises(FileError, match="cannot be written"):
        train(
            Elman(2, 4),
            u,
            target,
            options=TrainingOptions(
                iterations=2, checkpoint=tmp_path / "no_folder" / "checkpoint.npz"
            ),
        )
