"""Windows of a track in one compiled loop: the same numbers as windows that are run singly."""

from typing import Any

import numpy as np
import pytest

from pamid.base.arrays import Array
from pamid.engine import program
from pamid.engine.program import Memory, Stepping
from pamid.model.assembly import Assembly
from pamid.model.attachment import attach
from pamid.model.between_samples import as_recorded
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import recording_of
from pamid.simulation.rig_data import data_of
from pamid.simulation.tracks import track_of
from pamid.simulation.windows import Runner, Window, cut

SAMPLES, PERIOD_S = 900, 0.004
STEPPINGS = [Stepping(), Stepping(3), Stepping(1, implicit=True)]


def cart(stepping: Stepping, all_states: bool = False) -> tuple[Runner, Array]:
    """A cart whose force is linear between samples, comes late (a delay line) and has play (a
    cell), with its parameters."""
    random = np.random.default_rng(1)
    t = PERIOD_S * np.arange(SAMPLES)
    columns = {"force_n": 4.0 * random.standard_normal(SAMPLES), "position_m": np.sin(t)}
    recording = recording_of(t, columns, {"between": {"force_n": "linear"}})
    rig = as_recorded(rig_named("data/rigs/cart.py"), [recording])
    specs = "dead-time@sensor", "play@sensor", "maxwell-slip-hysteresis"
    added = tuple(attach(rig, spec, effects()) for spec in specs)
    assembly = Assembly(rig, added).for_fitting()
    track = track_of(assembly, data_of(assembly.rig, recording), ("position_m",))
    free = tuple(i for i, b in enumerate(assembly.parameters) if b.fitted)
    return Runner(assembly, track, stepping, free, all_states), assembly.values()


def singly(
    runner: Runner,
    memory: Memory,
    windows: list[Window],
    starts: Array,
    p: Array,
    sensitivities: bool,
    weights: Array | None = None,
) -> list[tuple[Any, ...]]:
    """Y, Jacobian, states and sensitivities at the end, finite: by one call per window."""
    rows = []
    for window, x in zip(windows, starts, strict=True):
        runner.enter(memory, x)
        Y, J, fine = runner.run(memory, window, p, sensitivities, weights)
        S = memory.S[: runner.start_states].copy()
        rows.append((Y, J, memory.x.copy(), S, fine))
    return rows


def starts_of(runner: Runner, count: int) -> Array:
    x = runner.assembly.start(runner.assembly.values())[: runner.start_states]
    return x + 0.05 * np.random.default_rng(2).standard_normal((count, len(x)))


@pytest.mark.parametrize("stepping", STEPPINGS)
@pytest.mark.parametrize("all_states", [False, True])
@pytest.mark.parametrize("most", [1, 7000, program.BLOCK_NUMBERS])
def test_windows_in_a_loop_equal_windows_run_singly(monkeypatch, stepping, all_states, most):
    monkeypatch.setattr(program, "BLOCK_NUMBERS", most)
    runner, p = cart(stepping, all_states)
    windows, weights = cut(SAMPLES, 70), np.array([3.0])
    starts = starts_of(runner, len(windows))
    loop, single = runner.memory(p), runner.memory(p)
    found = list(runner.run_windows(loop, windows, starts, p, True, weights))
    for run, (Y, J, end, S, fine) in zip(
        found, singly(runner, single, windows, starts, p, True, weights), strict=True
    ):
        assert run.fine and fine
        assert np.array_equal(run.Y, Y) and np.array_equal(run.J, J)
        assert np.array_equal(run.end, end) and np.array_equal(run.S, S)
    # what is remembered goes on, in values and in sensitivities by parameters
    for one, other in zip(loop.arrays(), single.arrays(), strict=True):
        assert np.array_equal(one, other)
    assert np.abs(found[-1].J[:, : len(runner.free)]).max() > 0.0


def test_a_window_that_runs_away_ends_only_itself():
    """The next window begins at its start states; what the sensor remembers stays finite."""
    runner, p = cart(Stepping())
    windows = cut(SAMPLES, 100)
    starts = starts_of(runner, len(windows))
    starts[3, 0] = 1e20
    found = list(runner.run_windows(runner.memory(p), windows, starts, p, False))
    rows = singly(runner, runner.memory(p), windows, starts, p, False)
    assert [run.fine for run in found] == [k != 3 for k in range(len(windows))]
    for run, (Y, *_) in zip(found, rows, strict=True):
        assert np.array_equal(run.Y, Y, equal_nan=True)
