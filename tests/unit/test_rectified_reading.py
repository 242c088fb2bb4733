"""A drive whose sensor reads its speed without the sign: where windows begin, either may be it."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from pamid.base.arrays import Array
from pamid.diagnosis.candidate_model import refit, window_starts_from
from pamid.engine.program import Stepping
from pamid.engine.symbolic.vocabulary import Number, absolute
from pamid.estimation.grey_box import fit_model
from pamid.estimation.multiple_shooting import initial_states
from pamid.estimation.problem import Problem
from pamid.estimation.weights import Weights
from pamid.model.assembly import Assembly
from pamid.model.attachment import attach
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.registry import effects
from pamid.model.rig import Port, Rig
from pamid.recording.recording import Recording, recording_of
from pamid.simulation.data_split import split_recordings
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.free_runs import free_run
from pamid.simulation.replay import replay_track

PERIOD_S, SAMPLES, NOISE = 0.01, 1600, 0.01
INERTIA, FRICTION = 1.3, 0.8  # of the machine; its data sheet says 1


class Drive(Rig):
    """Torque to speed, read by a tachometer behind a rectifier."""

    inputs = {"torque": ""}
    outputs = {"read": ""}
    ports = {"shaft": Port("motion", "", ("velocity",))}
    states = (State("speed"), State("warmth"))
    parameters = (
        Parameter("inertia", 1.0, 0.3, 3.0, spread=0.5, source="bench"),
        Parameter("viscous", 1.0, 0.1, 5.0, spread=0.5, source="bench"),
    )
    period_s = PERIOD_S

    def rates(self, x, u, p, port):
        torque = port("shaft", u.torque - p.viscous * x.speed, velocity=x.speed)
        return {"speed": torque / p.inertia, "warmth": x.speed * x.speed - x.warmth}

    def measure(self, x, u, p, port):
        return {"read": absolute(x.speed)}


@cache
def driven(begun: float) -> tuple[Recording, Array]:
    """A recording that begins in the middle of a motion that its drive does not explain, and the
    speed with its sign."""
    torque = aprbs(SAMPLES * PERIOD_S, PERIOD_S, 1.0, (0.3, 1.2), seed=4)[:SAMPLES]

    class Signed(Drive):
        """The same with the sign."""

        def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
            return {"read": x.speed}

    machine = Assembly(Signed())
    p = machine.values({"inertia": INERTIA, "viscous": FRICTION})
    speed = free_run(machine, torque[:, None], p, PERIOD_S, start=np.array([begun, 0.0])).outputs[
        :, 0
    ]
    noise = NOISE * np.random.default_rng(5).standard_normal(SAMPLES)
    read = np.abs(speed) + noise
    time = PERIOD_S * np.arange(SAMPLES)
    return recording_of(time, {"torque": torque, "read": read}, name="drive"), speed


@pytest.mark.parametrize("begun", [-2.5, 2.5])
def test_windows_begin_with_the_sign_of_the_motion(begun):
    recording, speed = driven(begun)
    evidence = split_recordings(Drive(), [recording], [])
    assembly = Assembly(evidence.rig)
    problem = Problem(assembly, evidence.tracks(assembly), ())
    weights = Weights(evidence.noise, np.ones(1))
    p = assembly.values({"inertia": INERTIA, "viscous": FRICTION})
    (starts,) = initial_states(problem, p, weights, Stepping(2))
    true = speed[[w.start for w in problem.windows(problem.tracks[0])]]
    np.testing.assert_allclose(starts[:, 0], true, atol=10.0 * NOISE)
    # and the same where windows are replayed, each from its own beginning alone
    (track,) = evidence.tracks(assembly, held_out=True)
    replay = replay_track(assembly, p, track, Stepping(2), evidence.noise)
    assert np.abs(replay.residual[replay.scored]).mean() < 2.0 * NOISE


@pytest.mark.parametrize("begun", [-2.5, 2.5])
def test_a_fit_comes_out_alike_whichever_way_the_motion_goes(begun):
    recording, _ = driven(begun)
    found = fit_model(split_recordings(Drive(), [recording], []))
    values = dict(zip(found.assembly.keys, found.fit.p, strict=True))
    assert values["inertia"] == pytest.approx(INERTIA, rel=0.02)
    assert values["viscous"] == pytest.approx(FRICTION, rel=0.02)


class Trusting(Drive):
    """The same, its tachometer taken to show the sign."""

    ports = Drive.ports | {"tacho": Port("reading", "")}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"read": port("tacho", x.speed)}


@pytest.mark.parametrize("begun, fold", [(-2.5, 0.1), (-2.5, 1.0), (2.5, 0.1)])
def test_a_reading_that_folds_signs_begins_its_windows_anew(begun, fold):
    """The model without the effect has found every window begin forwards."""
    recording, speed = driven(begun)
    evidence = split_recordings(Trusting(), [recording], [])
    plain = fit_model(evidence)
    label = "full-wave-rectification"
    blind = Assembly(evidence.rig, (attach(evidence.rig, label, effects()),))
    assert window_starts_from(plain.fit, plain.assembly).starts is plain.fit.starts
    assert window_starts_from(plain.fit, blind).starts is None
    found = refit(evidence, blind, plain.fit, first={f"{label}:fold": fold})
    values = dict(zip(blind.keys, found.p, strict=True))
    assert values[f"{label}:fold"] == pytest.approx(1.0, abs=0.02)
    assert values["inertia"] == pytest.approx(INERTIA, rel=0.03)
    windows = found.problem.windows(found.problem.tracks[0])
    true = speed[[w.start for w in windows]]
    np.testing.assert_allclose(found.starts[0][:, 0], true, atol=20.0 * NOISE)
