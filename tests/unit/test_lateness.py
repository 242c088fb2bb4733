"""What a check takes for late."""

import dataclasses

import numpy as np
import one_cart
import pytest

from pamid.engine.program import Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.symbolic.vocabulary import clip, sin
from pamid.intake.checks.recording_quality import examine
from pamid.model.assembly import Assembly
from pamid.model.attachment import attach
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.registry import effects, rig_named
from pamid.model.rig import Port, Rig
from pamid.recording.recording import Recording, recording_of
from pamid.simulation.free_runs import free_run


@pytest.mark.parametrize("time", [1.0, 200.0, 1.0 / 200.0])
def test_late_is_late_at_any_pace(time):
    """Neither what counts as late nor how far is looked is a matter of the unit of time."""
    written = one_cart.Written(time=time)
    recording, rig = one_cart.recorded(written), one_cart.cart(written)
    moved = {**recording.columns, "place": np.roll(recording.columns["place"], 4)}
    late = dataclasses.replace(recording, columns=moved)
    shifts = [
        issue.figures["delay_s"] / given.sampling_period_s
        for given in (recording, late)
        for issue in examine(given, rig)
        if issue.kind == "delay"
    ]
    # a cart heavier than its data sheet is late by itself
    assert shifts == pytest.approx([8.0, 12.0], abs=1.1)


def test_a_reading_that_is_early_is_led_by_its_slope_where_the_rig_offers_none():
    """The damper bench offers no rate of its force, which rises ever faster here: one that
    is read two samples early is two rises ahead."""
    rig = rig_named("damper-bench")
    assembly = Assembly(rig, (attach(rig, "clock-skew", effects()),))
    assert "rate" not in rig.ports["load_cell"].signals
    place = {n: i for i, n in enumerate(assembly.traced.inputs)}
    u = np.zeros((200, len(place)))
    u[:, place["position_mm"]] = 1e-7 * np.arange(200) ** 2
    force = []
    for early in (0.0, 2.0):
        given = {"clock-skew:start_s": -early * rig.period_s, "clock-skew:skew_ppm": 0.0}
        p = assembly.values(given)
        memory = assembly.program.memory(assembly.start(p), period_s=rig.period_s)
        force.append(assembly.program.run(memory, SampledInputs(u, rig.period_s), p)[0][100:, 0])
    ahead, rise = force[1] - force[0], np.diff(force[0], append=np.nan)
    assert ahead[:-1] == pytest.approx(2.0 * rise[:-1], rel=0.05)


class Swing(Rig):
    """A pendulum that is driven; friction: of its bearing, which the data sheet lacks."""

    inputs = {"torque": ""}
    outputs = {"angle": ""}
    ports = {"hinge": Port("motion", "", ("velocity",))}
    states = (State("angle"), State("velocity"))
    parameters = (
        Parameter("steepness", 30.0, 10.0, 60.0, spread=0.1, source="length"),
        Parameter("damping", 0.05, 0.001, 3.0, spread=1.0, log=True, source="guess"),
    )
    period_s = 0.01
    friction = 0.0

    def rates(self, x, u, p, port):
        torque = port("hinge", u.torque - p.damping * x.velocity, velocity=x.velocity)
        rubbed = self.friction * clip(50.0 * x.velocity, -1.0, 1.0)
        return {"angle": x.velocity, "velocity": torque - rubbed - p.steepness * sin(x.angle)}

    def measure(self, x, u, p, port):
        return {"angle": x.angle}


def swung(friction: float, early: int = 0) -> Recording:
    """A recording of the swing, of which the angle is read so many samples early."""
    machine = Swing()
    machine.friction = friction
    model, random, time = Assembly(machine), np.random.default_rng(1), 0.01 * np.arange(1500)
    rates = 2.0 * np.pi * random.uniform(0.3, 0.9, 3)
    torque = np.sin(rates[:, None] * time + np.arange(3)[:, None]).sum(axis=0)
    run = free_run(model, torque[:, None], model.values(), 0.01, stepping=Stepping(8))
    angle = np.roll(run.outputs[:, 0], -early) + 1e-4 * random.standard_normal(len(time))
    return recording_of(time, {"torque": torque, "angle": angle}, name="swing")


@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_friction_that_is_missing_is_no_early_reading(friction):
    """The model without it falls behind within a run, not within short windows; a reading that is
    early is early there, too."""
    for early in (0, 6):
        issues = examine(swung(friction, early), Swing())
        delays = [issue.figures["delay_s"] for issue in issues if issue.kind == "delay"]
        assert len(delays) == bool(early) and all(delay < 0.0 for delay in delays)
