"""Replays over more than one window: which models may run how long from one estimated state, and
over which horizon they are compared."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from pamid.diagnosis.budget import Budget, _over_horizon
from pamid.diagnosis.settings import DEFAULT
from pamid.engine.program import Stepping
from pamid.estimation.grey_box import GreyBox
from pamid.model.assembly import Assembly
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig
from pamid.recording.recording import recording_of
from pamid.simulation.data_split import DataSplit, split_recordings
from pamid.simulation.free_runs import virtual_recording
from pamid.simulation.replay import WHOLE, Replay, noise_floor, replay_track, warm_up

PERIOD_S, SAMPLES, NOISE_M = 0.05, 4000, 1e-3
TIMESCALE_S = 1.0
STEPPING = Stepping(2)


class Carriage(Rig):
    """A carriage that is pushed; with a spring it returns, without one it rolls on."""

    inputs = {"force_n": "N"}
    outputs = {"position_m": "m"}
    ports = {
        "guide": Port("motion", "N", ("position", "velocity")),
        "ruler": Port("reading", "m", ("rate",)),
    }
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (
        Parameter("mass", 1.0, 0.1, 10.0, "kg", spread=0.5, source="test"),
        Parameter("damping", 1.0, 0.0, 10.0, "N s/m", spread=0.5, source="test"),
        Parameter("spring", 1.0, 0.0, 10.0, "N/m", spread=0.5, source="test"),
    )
    noise = {"position_m": NOISE_M}
    period_s = PERIOD_S
    timescale_s = TIMESCALE_S

    def rates(self, x, u, p, port):
        force = u.force_n - p.damping * x.velocity - p.spring * x.position
        force = port("guide", force, position=x.position, velocity=x.velocity)
        return {"position": x.velocity, "velocity": force / p.mass}

    def measure(self, x, u, p, port):
        return {"position_m": port("ruler", x.position, rate=x.velocity)}


FORGETS = {"mass_kg": 1.0, "damping_n_s_per_m": 1.5, "spring_n_per_m": 1.0}


@dataclass(frozen=True, eq=False)
class Held:
    """Recordings of a carriage and its model with these parameters."""

    evidence: DataSplit
    assembly: Assembly
    p: np.ndarray

    def replay(self, per_run: int, **changes: Any) -> Replay:
        (track,) = self.evidence.tracks(self.assembly, held_out=True)
        track = replace(track, **changes)
        return replay_track(
            self.assembly, self.p, track, STEPPING, self.evidence.noise, per_run=per_run
        )

    def floor(self, per_run: int) -> Replay:
        done = self.replay(per_run)
        return noise_floor(self.assembly, self.p, done, STEPPING, self.evidence.noise, seed=3)


def keys(values: dict[str, float], assembly: Assembly) -> np.ndarray:
    p = assembly.values()
    for name, value in values.items():
        (place,) = (k for k, b in enumerate(assembly.parameters) if b.name == name)
        p[place] = value
    return p


def carriage(truth: dict[str, float], model: dict[str, float] | None = None) -> Held:
    """A carriage with these parameters, pushed to and fro about where it stands, and its model."""
    random = np.random.default_rng(5)
    # each push is taken back at once: without a spring the carriage would leave the room
    push = np.repeat(np.outer(random.uniform(-1.0, 1.0, SAMPLES // 40), [1.0, -1.0]), 20)
    time = PERIOD_S * np.arange(len(push))
    plain = Assembly(Carriage())
    sent = recording_of(time, {"force_n": push}, {"recording": {"loop": "open"}})
    made = virtual_recording(plain, sent, keys(truth, plain), seed=6)
    columns = {"force_n": push, "position_m": made["position_m"]}
    meta = {"recording": {"loop": "open"}}
    recording = recording_of(time, columns, meta)
    evidence = split_recordings(Carriage(), [recording], [])
    assembly = Assembly(evidence.rig, outputs=evidence.channels)
    return Held(evidence, assembly, keys(model or truth, assembly))


@pytest.fixture(scope="module")
def forgets() -> Held:
    return carriage(FORGETS)


def test_a_whole_run_equals_its_windows_where_the_model_is_exact(forgets):
    whole, windows = forgets.replay(WHOLE), forgets.replay(1)
    assert whole.losses().shape == windows.losses().shape
    assert whole.losses().mean() == pytest.approx(windows.losses().mean(), rel=0.1)
    assert whole.losses().mean() == pytest.approx(NOISE_M * np.sqrt(2.0 / np.pi), rel=0.1)


def test_a_contracting_model_forgets_where_it_began(forgets):
    """The first window of the recording is off by 50 times the noise, and with it the start."""
    (track,) = forgets.evidence.tracks(forgets.assembly, held_out=True)
    exact = forgets.replay(WHOLE, lead=0, first=0)
    off = track.y.copy()
    first = exact.windows[0].stop
    off[:first] += 50.0 * NOISE_M
    misled = forgets.replay(WHOLE, lead=0, first=0, y=off)
    apart = np.abs(misled.model - exact.model)[:, 0]
    assert apart[: first // 2].max() > 5.0 * NOISE_M
    assert apart[len(apart) // 2 :].max() < 0.01 * NOISE_M
    assert misled.losses()[-1] == pytest.approx(exact.losses()[-1], rel=1e-2)


@pytest.mark.parametrize("per_run", [1, 2, 4, WHOLE])
def test_only_the_start_of_a_run_is_not_scored(forgets, per_run):
    r = forgets.replay(per_run)
    assert r.per_run == per_run
    expected = np.ones(len(r.track), bool)
    for k, w in enumerate(r.windows):
        if k % per_run == 0:
            expected[w.start : w.start + warm_up(w)] = False
    assert (r.scored == expected).all()
    assert len(r.losses()) == len(r.windows)


def test_the_floor_is_simulated_over_the_same_horizon(forgets):
    for per_run in (1, 4, WHOLE):
        floor = forgets.floor(per_run)
        assert floor.per_run == per_run
        assert floor.losses().mean() == pytest.approx(NOISE_M * np.sqrt(2.0 / np.pi), rel=0.1)


# ---- the horizon of a comparison ----------------------------------------------------------------


def budget(held: Held) -> Budget:
    """The budget of a model as if it had been fitted."""
    windows, floor = (held.replay(1),), (held.floor(1),)
    fit = SimpleNamespace(p=held.p, stepping=STEPPING, residuals=(np.zeros(1),))
    model = GreyBox(held.evidence, held.assembly, cast(Any, fit), 0.0, windows, windows, floor)
    return _over_horizon(model, 3, DEFAULT)


def test_single_windows_are_kept_where_whole_recordings_show_no_more(forgets):
    found = budget(forgets)
    assert found.evidence.per_run == 1 and found.short is None
    longest = max(w.stop - w.start for w in found.baseline.runs[0].windows)
    assert found.horizon_s == pytest.approx(longest * PERIOD_S)


def test_whole_recordings_are_used_where_they_show_more_of_the_gap():
    """Windows of 3.8 s hide a wrong spring behind a damper that yields in 30 s: each begins where
    it was measured."""
    slow = {"mass_kg": 1.0, "damping_n_s_per_m": 10.0, "spring_n_per_m": 0.3}
    held = carriage(slow, {**slow, "spring_n_per_m": 1.0})
    found = budget(held)
    assert found.evidence.per_run == WHOLE
    (r,) = found.baseline.runs
    assert found.horizon_s == pytest.approx(len(r.track) * PERIOD_S)
    assert found.short is not None and found.short.mean() < found.baseline.absolutes.mean()
    assert (found.short == held.replay(1).losses()).all()
