"""Slopes of what is stepped are worked out once and used again where they hold."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
import pytest
from pendulums import SteppedTwin, WrittenPendulum

import pamid
from pamid.base.arrays import Array
from pamid.diagnosis.candidate_model import slopes_along
from pamid.engine import known_slopes, stepped_kernel
from pamid.engine.known_slopes import KnownSlopes
from pamid.engine.program import Stepping
from pamid.engine.simulator import StepScales
from pamid.estimation.multiple_shooting import fit
from pamid.estimation.problem import Fit, FitStart, Problem, free_parameters
from pamid.estimation.smoother import SlicedTrack, slices_of, start_trajectory
from pamid.model.assembly import Assembly
from pamid.model.attachment import attachments
from pamid.model.registry import effects
from pamid.recording.recording import Recording
from pamid.simulation.data_split import split_recordings
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.replay import replay_track
from pamid.simulation.windows import Runner

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
def problem(recording) -> Problem:
    evidence = split_recordings(SteppedTwin(), [recording], [])
    a = Assembly(evidence.rig, outputs=evidence.channels).for_fitting()
    tracks = evidence.tracks(a)
    return Problem(a, tracks, free_parameters(a, tracks))


@pytest.fixture
def copies(monkeypatch) -> Iterator[list[int]]:
    """How many steps of a simulation were asked for, call by call."""
    asked: list[int] = []
    steps = SteppedTwin.steps

    def counted(self, x, *given):
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


def test_slopes_that_are_known_are_those_that_were_worked_out(problem, copies):
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


def test_slopes_by_forces_are_worked_out_where_they_are_pushed(recording, problem, copies):
    """Of what follows the recorded command alone none are needed; an effect at the rail adds its
    own to the slopes that the rig without it has left, and no others."""
    bare = Runner(problem.assembly, problem.tracks[0], Stepping(1), problem.free).keeping()
    p, samples, n = problem.start(), len(bare.track), len(problem.assembly.rig.states)
    _run(problem, bare, p)
    assert sum(copies) == samples * (1 + n + len(problem.free) + 1)
    assert bare.known is not None and not bare.known.pushed.any()
    rig = problem.assembly.rig
    offset = next(
        a for a in attachments(rig, [effects()["linear-stiffness"]]) if a.ports == ("rail",)
    )
    evidence = split_recordings(rig, [recording], [])
    a = Assembly(rig, (offset,), outputs=evidence.channels).for_fitting()
    tracks = evidence.tracks(a)
    pushing = Problem(a, tracks, free_parameters(a, tracks))
    runner = Runner(a, tracks[0], Stepping(1), pushing.free)
    candidate, p = runner.keeping(bare.known), pushing.start()
    stiffness = next(i for i, b in enumerate(a.parameters) if b.owner and b.null == 0.0)
    p[stiffness] = 1e-9  # it pushes, and moves next to nothing
    copies.clear()
    found = _run(pushing, candidate, p)
    assert sum(copies) <= samples * (1 + 1 + 1 + 1)  # the step, the force, its check, one step more
    known = candidate.known
    assert known is not None and known.pushed.any(axis=0).tolist() == [True, False]
    exact = _run(pushing, runner, p)
    assert np.abs(found[1] - exact[1]).max() <= 1e-6 * np.abs(exact[1]).max()


def _table() -> KnownSlopes:
    """Of one exchange of x' = x + 0.1 max(x - 1, 0), at rest up to a stop at 1."""
    found = KnownSlopes.room(1, 1, (0, 1, 0, 0), np.zeros(0, np.intp))
    assert found is not None
    return found


def test_what_lies_behind_a_stop_is_not_foretold():
    none, known, after = np.zeros(0), _table(), np.empty(1)
    scales = StepScales(0.0, none, none, none, np.zeros(0, np.int64), none, np.ones(1))

    def step(x):
        return np.array([x + 0.1 * max(x - 1.0, 0.0)])

    def check(x):
        stepped_kernel._check(scales, known, 0, np.array([x]), none, step(x))

    def predicted(x):
        return bool(stepped_kernel._predict(scales, known, 0, np.array([x]), none, after))

    known.slopes[0] = 1.1
    stepped_kernel._keep(scales, known, 0, np.array([1.5]), none, step(1.5))
    assert not predicted(1.4)  # nothing was checked
    check(1.3)
    assert predicted(1.2) and after == pytest.approx(step(1.2))
    assert not predicted(0.8)  # beyond what was checked
    check(0.8)
    assert not predicted(1.2)  # it was wrong there
    assert predicted(0.8) and np.array_equal(after, step(0.8))  # the very same step


def test_a_fit_that_keeps_slopes_ends_where_one_without_does(problem, copies, monkeypatch):
    ended, cost = list[Fit](), list[int]()
    for most in (known_slopes.MOST_NUMBERS, 0):
        monkeypatch.setattr(known_slopes, "MOST_NUMBERS", most)
        copies.clear()
        ended.append(fit(problem, FitStart(stepping=Stepping(1))))
        cost.append(sum(copies))
    one, other = ended
    assert one.converged and other.converged
    error = np.sqrt(np.diag(other.covariance))
    apart = problem.scale.inside(one.p[list(problem.free)])
    apart = apart - problem.scale.inside(other.p[list(problem.free)])
    assert (np.abs(apart) < 0.02 * error).all()
    assert np.allclose(one.covariance, other.covariance, rtol=1e-2, atol=1e-6)
    assert cost[0] < cost[1]


@pytest.mark.parametrize("moving", [False, True])
def test_smoothing_begins_with_slopes_along_the_replay(recording, moving, copies):
    evidence = split_recordings(SteppedTwin(), [recording], [])
    a = Assembly(evidence.rig, outputs=evidence.channels).for_fitting()
    (track,) = evidence.tracks(a, held_out=True)
    free, p, step = free_parameters(a, (track,)), a.values(), Stepping(1)
    replay = replay_track(a, p, track, step, evidence.noise)
    runner = Runner(a, replay.track, step, free, all_states=True)
    slices, opens = slices_of(replay)
    start = start_trajectory(runner, p, replay, slices, opens)
    found, cost = [], []
    for known in (slopes_along(Runner(a, replay.track, step, free), p, replay), (None, None)):
        sliced = SlicedTrack(runner, slices, opens, start, known=known)
        copies.clear()
        found.append(sliced.linearise(start, p, np.ones(len(free)), evidence.noise, moving))
        cost.append(sum(copies))
    for one, other in zip(*found, strict=True):
        assert np.allclose(one, other, rtol=1e-6, atol=1e-9)
    assert cost[0] == 0 < cost[1]  # along the replay itself every step had been made
