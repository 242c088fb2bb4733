"""Slopes of what is stepped are worked out once and used again where they hold."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from pendulums import SteppedTwin, WrittenPendulum

import pamid
from pamid.engine import known_slopes
from pamid.engine.known_slopes import FAR, STILL_HOLDS, KnownSlopes
from pamid.engine.program import Stepping
from pamid.engine.stepped import SteppedProgram
from pamid.estimation.multiple_shooting import fit
from pamid.estimation.problem import Fit, Problem, free_parameters
from pamid.excitation.aprbs import aprbs
from pamid.model.assembly import Assembly
from pamid.recording.recording import Recording
from pamid.simulation.data_split import split_recordings
from pamid.simulation.windows import Runner

Array = NDArray[np.float64]

PERIOD = WrittenPendulum.period_s
MASSES = {"cart_kg": 1.12, "bob_kg": 0.18, "rail_n_s_per_m": 1.7}
SUBSTEPS = 2


@pytest.fixture(scope="module")
def recording() -> Recording:
    u = aprbs(6.0, PERIOD, 6.0, (0.2, 1.0), seed=4)
    sent = pd.DataFrame({"time_s": PERIOD * np.arange(len(u)), "force_n": u})
    sent = pamid.Recording.from_pandas(sent)
    return pamid.simulate(sent, WrittenPendulum, parameters=MASSES)


@pytest.fixture
def problem(recording: Recording) -> Problem:
    evidence = split_recordings(SteppedTwin(), [recording], [])
    a = Assembly(evidence.rig, outputs=evidence.channels).for_fitting()
    tracks = evidence.tracks(a)
    return Problem(a, tracks, free_parameters(a, tracks))


@pytest.fixture
def copies(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """How many steps of a simulation were asked for, call by call."""
    asked: list[int] = []
    steps = SteppedTwin.steps

    def counted(self: Any, x: Array, *given: Any) -> tuple[Array, Array]:
        asked.append(len(x))
        return steps(self, x, *given)

    monkeypatch.setattr(SteppedTwin, "steps", counted)
    yield asked


def _run(problem: Problem, runner: Runner, p: Array) -> tuple[Array, Array]:
    """Outputs and their derivatives along the track, window by window as a fit runs it."""
    memory, rows = runner.memory(p), []
    for window in problem.windows(runner.track):
        runner.enter(memory, memory.x[: runner.start_states].copy())
        *found, fine = runner.run(memory, window, p, True)
        assert fine
        rows.append(found)
    y, by = zip(*rows, strict=True)
    return np.concatenate(y), np.concatenate(by)


def test_slopes_that_are_known_are_those_that_were_worked_out(
    problem: Problem, copies: list[int]
) -> None:
    runner = Runner(problem.assembly, problem.tracks[0], Stepping(SUBSTEPS), problem.free)
    keeping, p = runner.keeping(), problem.start()
    assert keeping.known is not None
    exchanges = SUBSTEPS * len(runner.track)
    y, by = _run(problem, runner, p)
    first = _run(problem, keeping, p)
    assert keeping.known.counts.tolist() == [exchanges, 0, 0]
    copies.clear()
    again = _run(problem, keeping, p)
    assert keeping.known.counts.tolist() == [exchanges, exchanges, exchanges]
    assert not copies  # where each had been made already
    for found in (first, again):
        assert np.array_equal(found[0], y)
        assert np.abs(found[1] - by).max() <= 1e-9 * np.abs(by).max()


def test_near_by_they_hold_and_far_off_they_are_worked_out_anew(problem: Problem) -> None:
    runner = Runner(problem.assembly, problem.tracks[0], Stepping(SUBSTEPS), problem.free)
    sheet, exchanges = problem.start(), SUBSTEPS * len(runner.track)
    keeping = runner.keeping()
    _run(problem, keeping, sheet)
    for share in (0.01, 1.0):
        p = sheet.copy()
        p[list(problem.free)] *= 1.0 + share
        own = keeping.keeping(keeping.known)
        assert own.known is not None
        (y, by), (exact, exactly) = _run(problem, own, p), _run(problem, runner, p)
        assert np.array_equal(y, exact)  # nothing was checked yet, so all steps are made
        if share > FAR:
            assert own.known.counts.tolist() == [exchanges, 0, 0]
            assert np.abs(by - exactly).max() <= 1e-9 * np.abs(exactly).max()
            continue
        assert own.known.counts[1] > 0.95 * exchanges
        size = np.sqrt((exactly**2).mean(axis=0))
        assert (np.sqrt(((by - exactly) ** 2).mean(axis=0)) <= STILL_HOLDS * size).all()


def test_a_fit_that_keeps_slopes_ends_where_one_without_does(
    problem: Problem, copies: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    ended, cost = list[Fit](), list[int]()
    for most in (known_slopes.MOST_NUMBERS, 0):
        monkeypatch.setattr(known_slopes, "MOST_NUMBERS", most)
        copies.clear()
        ended.append(fit(problem, stepping=Stepping(1)))
        cost.append(sum(copies))
    one, other = ended
    assert one.converged and other.converged
    error = np.sqrt(np.diag(other.covariance))
    apart = problem.scale.inside(one.p[list(problem.free)])
    apart = apart - problem.scale.inside(other.p[list(problem.free)])
    assert (np.abs(apart) < 0.02 * error).all()
    assert np.allclose(one.covariance, other.covariance, rtol=1e-2, atol=1e-6)
    assert cost[0] < cost[1]


def test_equations_keep_none(recording: Recording) -> None:
    evidence = split_recordings(WrittenPendulum(), [recording], [])
    a = Assembly(evidence.rig, outputs=evidence.channels)
    runner = Runner(a, evidence.tracks(a)[0], Stepping(1))
    assert runner.keeping() is runner


def test_slopes_by_other_parameters_are_not_taken(problem: Problem) -> None:
    program = problem.assembly.program
    assert isinstance(program, SteppedProgram)
    runner = Runner(problem.assembly, problem.tracks[0], Stepping(1), problem.free).keeping()
    fewer = replace(runner, free=problem.free[:1], known=None)
    p = problem.start()
    _run(problem, runner, p)
    assert fewer.keeping(runner.known).known is not runner.known
    mistaken = replace(fewer, known=runner.known)
    exact, found = _run(problem, fewer, p), _run(problem, mistaken, p)
    assert np.array_equal(exact[1], found[1])


def test_too_much_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    none = np.zeros(0, np.intp)
    assert KnownSlopes.room(1000, 1, (0, 4, 1, 3), none) is not None
    monkeypatch.setattr(known_slopes, "MOST_NUMBERS", 100)
    assert KnownSlopes.room(1000, 1, (0, 4, 1, 3), none) is None
