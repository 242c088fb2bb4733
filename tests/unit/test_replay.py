"""Recorded-command replay: what nothing measures is carried over, and the floor knows of every
correction."""

from dataclasses import replace

import numpy as np
import pytest
from small_cart import RIG, record_cart
from virtual_joint import SPECIMEN, record
from virtual_recordings import virtual_recording

from pamid.engine.program import Stepping
from pamid.model.assembly import Assembly
from pamid.model.attachment import attach
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import read_recording
from pamid.simulation.data_split import DataSplit, split_recordings
from pamid.simulation.replay import Replay, noise_floor, replay_track

ANGLE = ("reference_deg", "command", "angle_deg")


@pytest.fixture(scope="module")
def angle_only(tmp_path_factory) -> tuple[DataSplit, Assembly, np.ndarray]:
    """A healthy joint of which only the angle was recorded, and the model that made it with 3 %
    more force."""
    path = tmp_path_factory.mktemp("joint") / "rec.csv"
    evidence = split_recordings(
        rig_named("one-dof"), [record(path, 24.0, seed=5, columns=ANGLE)], []
    )
    # windows of 1 s: what is carried over counts where they are short against the tanks' filling
    evidence = replace(evidence, timescale_s=0.6)
    assembly = Assembly(evidence.rig, background=True, outputs=evidence.channels).for_fitting()
    p = assembly.values({**SPECIMEN, "scale": 1.03 * SPECIMEN["scale"]})
    return evidence, assembly, p


def run(given: tuple[DataSplit, Assembly, np.ndarray], jump: np.ndarray | None = None) -> Replay:
    evidence, assembly, p = given
    track = evidence.tracks(assembly, held_out=True)[0]
    return replay_track(
        assembly,
        p,
        track if jump is None else replace(track, jump=jump),
        Stepping(2),
        evidence.noise,
    )


def test_pressures_that_nobody_measured_are_carried_over(angle_only):
    """Estimated anew from the angle in every window they follow each error of the model, and the
    replay goes astray."""
    carried = run(angle_only)
    anew = run(angle_only, np.full(4, np.inf))
    evidence = angle_only[0]
    assert evidence.jump[2:] == pytest.approx(1e3, rel=0.5), "a hundredth of some 100 kPa"
    departed = [np.sqrt(np.mean((r.starts - r.carried)[1:, 2:] ** 2)) for r in (carried, anew)]
    assert departed[0] < 0.5 * departed[1]
    assert carried.losses().mean() < 0.7 * anew.losses().mean()


def test_the_floor_is_the_noise_whatever_the_states_were_corrected_by(angle_only):
    """The truth of the floor makes the same corrections: a mean absolute error of 0.8 standard
    deviations is left."""
    evidence, assembly, p = angle_only
    done = run(angle_only)
    assert np.abs(done.starts - done.carried)[1:].max() > 0.0
    floor = noise_floor(assembly, p, done, Stepping(2), evidence.noise)
    assert floor.losses().mean() / evidence.noise[0] == pytest.approx(
        np.sqrt(2.0 / np.pi), abs=0.12
    )


def test_what_travel_alone_makes_forget_is_led_in_from_the_beginning(tmp_path):
    """A held-out part begins in the middle of a recording: what a wide play holds there was settled
    long before, what a lag holds was not."""
    evidence = split_recordings(rig_named(RIG), [read_recording(record_cart(tmp_path))], [])
    # far less than the recording: a lead of ten of them is not all of it
    evidence = replace(evidence, timescale_s=0.02)
    (span,) = evidence.held_out
    leads = {}
    for name in ("play@sensor", "signal-hysteresis@sensor", "first-order-lag@sensor"):
        assembly = Assembly(evidence.rig, (attach(evidence.rig, name, effects()),))
        (track,) = evidence.tracks(assembly, held_out=True)
        assert len(track) - track.lead == span.stop - span.start
        leads[name] = track.lead
    assert leads["play@sensor"] == leads["signal-hysteresis@sensor"] == span.start
    assert leads["first-order-lag@sensor"] < 0.1 * span.start
    assert not Assembly(evidence.rig).keeps_memories


def test_a_wide_hysteresis_foretells_what_it_was_held_out_from():
    """With the block's own parameters what is held out is met to the noise, however long ago the
    widest loops of its sensor began: by where they stand it would be off by degrees, and cool down
    to another room."""
    random = np.random.default_rng(4)
    given = {"share": 0.15, "reach_k": 60.0}
    sizes = ",".join(f"{name}={value}" for name, value in given.items())
    sent = {"power_w": np.repeat(random.uniform(0.0, 100.0, 50), 30)}
    made = virtual_recording("thermal-block", sent, 10.0, f"signal-hysteresis@sensor:{sizes}")
    evidence = split_recordings(rig_named("thermal-block"), [made], [])
    hysteresis = attach(evidence.rig, "signal-hysteresis@sensor", effects())
    assembly = Assembly(evidence.rig, (hysteresis,))
    p = assembly.values({f"signal-hysteresis@sensor:{k}": v for k, v in given.items()})
    (track,) = evidence.tracks(assembly, held_out=True)
    left = replay_track(assembly, p, track, Stepping(2), evidence.noise).losses(2)
    assert np.sqrt(left.mean()) < 1.5 * evidence.noise[0]
