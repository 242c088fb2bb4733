"""A reading that ends at the limits of its sensor: the states behind it are found, and the limits
are named."""

import numpy as np
import pytest
from small_cart import PERIOD_S

from pamid.base.arrays import Array
from pamid.base.run_folder import Run
from pamid.diagnosis.verdict.diagnosis_run import diagnose_into
from pamid.estimation.grey_box import fit_model, model_with
from pamid.intake.checks.recording_quality import examine
from pamid.model.attachment import attachments
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.registry import effects
from pamid.model.rig import Port, Rig
from pamid.recording.recording import Recording, recording_of
from pamid.simulation.data_split import DataSplit, split_recordings
from pamid.simulation.replay import replay_track

MASS, DRAG, NOISE = 1.1, 2.3, 5e-4  # kg, N s/m, m
FEW = ("asymmetric-saturation", "saturation", "dead-time", "coulomb-friction", "gain-error")
SENSOR = "asymmetric-saturation@sensor"


class DampedCart(Rig):
    """A cart with viscous drag, pushed by a force."""

    inputs = {"force_n": "N"}
    outputs = {"position_m": "m"}
    ports = {
        "force": Port("motion", "N", signals=("velocity", "position")),
        "sensor": Port("reading", "m"),
        "drive": Port("command", "N"),
    }
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (
        Parameter("mass_kg", 1.0, low=0.1, high=10.0, spread=0.2, source="scale"),
        Parameter("drag_n_s_per_m", 2.0, 0.05, 50.0, log=True, spread=2.0, source="guess"),
    )

    def rates(self, x, u, p, port):  # type: ignore[no-untyped-def]
        push = port("drive", u.force_n) - p.drag_n_s_per_m * x.velocity
        force = port("force", push, velocity=x.velocity, position=x.position)
        return {"position": x.velocity, "velocity": force / p.mass_kg}

    def measure(self, x, u, p, port):  # type: ignore[no-untyped-def]
        return {"position_m": port("sensor", x.position)}


def pushes(count: int, seed: int = 1) -> Array:
    random, levels = np.random.default_rng(seed), []
    while len(levels) < count:
        levels += [random.uniform(-3.0, 3.0)] * int(random.integers(8, 40))
    force = np.array(levels[:count])
    return np.asarray(force - force.mean())


def recorded(low: float, high: float, count: int = 1500) -> Recording:
    """The cart's own equations, its sensor limited at these shares of its samples."""
    force, x, v, fine = pushes(count), 0.0, 0.0, 20
    y = np.empty(count)
    for k, f in enumerate(force):
        y[k] = x
        for _ in range(fine):
            v += (f - DRAG * v) / MASS * 2.0 * PERIOD_S / fine
            x += v * 2.0 * PERIOD_S / fine
    y += NOISE * np.random.default_rng(1).standard_normal(count)
    limited = np.clip(y, *np.quantile(y, [low, high]))
    columns = {"force_n": force, "position_m": limited}
    return recording_of(2.0 * PERIOD_S * np.arange(count), columns)


def split(recording: Recording) -> DataSplit:
    return split_recordings(DampedCart(), [recording], [])


@pytest.mark.parametrize(
    "ends", [(0.25, 0.75), (0.0, 0.6), pytest.param((0.3, 1.0), marks=pytest.mark.slow)]
)
def test_the_states_behind_a_limited_reading_are_found(ends):
    """Beyond the limits the reading does not show where the machine is; windows that begin there
    find it all the same."""
    recording = recorded(*ends)
    evidence = split(recording)
    (limits,) = (
        a
        for a in attachments(evidence.rig, [effects()["asymmetric-saturation"]])
        if a.label == SENSOR
    )
    model = fit_model(evidence)
    true = model_with(evidence, (limits,), model.assembly.sizes)
    y = recording.columns["position_m"]
    given = {"mass_kg": MASS, "drag_n_s_per_m": DRAG}
    given |= {f"{SENSOR}:upper": y.max(), f"{SENSOR}:lower": y.min(), f"{SENSOR}:share": 1.0}
    p = true.values()
    for key, value in given.items():
        p[true.keys[key]] = value
    for track in (*evidence.tracks(true), *evidence.tracks(true, held_out=True)):
        done = replay_track(true, p, track, model.fit.stepping, evidence.noise)
        assert done.finite and float(done.losses().mean()) < 10.0 * NOISE


@pytest.mark.parametrize("ends", [(0.25, 0.75), (0.0, 1.0)])
def test_the_limits_of_a_sensor_are_named(ends, tmp_path):
    recording = recorded(*ends)
    clipped = ends != (0.0, 1.0)
    assert bool([i for i in examine(recording) if i.kind == "clipped"]) == clipped
    run = Run.create(tmp_path / "run", command=["test"], seed=0, overwrite=True)
    result = diagnose_into(run, split(recording), {name: effects()[name] for name in FEW})
    assert [c["effect"] for c in result["causes"]] == [SENSOR] * clipped
    if clipped:
        assert result["verdict"] == "explained"
        values = result["causes"][0]["parameters"]
        assert values["upper_m"]["value"] == pytest.approx(
            recording.columns["position_m"].max(), abs=0.01
        )
    else:
        assert result["verdict"] == "no-structural-gap"
