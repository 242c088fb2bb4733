"""Recorded-command replay: what nothing measures is carried over, and the floor knows of every
correction."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from virtual_joint import SPECIMEN, record

from pamid.engine.program import Stepping
from pamid.model.assembly import Assembly
from pamid.model.registry import rig_named
from pamid.simulation.data_split import STATE_JUMP, DataSplit, split_recordings
from pamid.simulation.free_runs import state_spread
from pamid.simulation.replay import Replay, noise_floor, replay_track, run_windows

ANGLE = ("reference_deg", "command", "angle_deg")


@pytest.fixture(scope="module")
def angle_only(tmp_path_factory: pytest.TempPathFactory) -> tuple[DataSplit, Assembly, np.ndarray]:
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


def test_pressures_that_nobody_measured_are_carried_over(
    angle_only: tuple[DataSplit, Assembly, np.ndarray],
) -> None:
    """Estimated anew from the angle in every window they follow each error of the model, and the
    replay goes astray."""
    carried = run(angle_only)
    anew = run(angle_only, np.full(4, np.inf))
    evidence = angle_only[0]
    assert evidence.jump[2:] == pytest.approx(1e3, rel=0.5), "a hundredth of some 100 kPa"
    departed = [np.sqrt(np.mean((r.starts - r.carried)[1:, 2:] ** 2)) for r in (carried, anew)]
    assert departed[0] < 0.5 * departed[1]
    assert carried.losses().mean() < 0.7 * anew.losses().mean()


def test_the_floor_is_the_noise_whatever_the_states_were_corrected_by(
    angle_only: tuple[DataSplit, Assembly, np.ndarray],
) -> None:
    """The truth of the floor makes the same corrections: a mean absolute error of 0.8 standard
    deviations is left."""
    evidence, assembly, p = angle_only
    done = run(angle_only)
    assert np.abs(done.starts - done.carried)[1:].max() > 0.0
    floor = noise_floor(assembly, p, done, Stepping(2), evidence.noise)
    assert floor.losses().mean() / evidence.noise[0] == pytest.approx(
        np.sqrt(2.0 / np.pi), abs=0.12
    )


def test_the_windows_cover_what_is_scored_and_the_lead_in_is_not(
    angle_only: tuple[DataSplit, Assembly, np.ndarray],
) -> None:
    r = run(angle_only)
    assert r.full_track.lead > 0 and len(r.track) == len(r.full_track) - r.full_track.lead == len(
        r.model
    )
    assert r.windows[0].start == 0 and r.windows[-1].stop == len(r.track)
    assert all(a.stop == b.start for a, b in zip(r.windows[:-1], r.windows[1:], strict=True))
    assert len(r.entered) == len(r.windows) < len(r.starts)
    assert 0.8 < r.scored.mean() < 0.9


def test_following_a_replay_gives_its_outputs(
    angle_only: tuple[DataSplit, Assembly, np.ndarray],
) -> None:
    _, assembly, p = angle_only
    r = run(angle_only)
    again = run_windows(assembly.program, assembly, p, r.track, r.windows, r.entered, Stepping(2))
    assert again == pytest.approx(r.model, abs=1e-9)


def test_spread_of_the_states(tmp_path: Path) -> None:
    """A hundred kilopascals and some ten degrees on a joint; nothing is said of a state that does
    not move."""
    recording = record(tmp_path / "rec.csv", 12.0, seed=5)
    spread = state_spread(Assembly(rig_named("one-dof")), recording)
    assert 0.05 < spread[0] < 1.0 and np.all((spread[2:] > 2e4) & (spread[2:] < 3e5))
    still = replace(
        recording,
        columns={
            k: np.zeros_like(v) if k == "command" else v for k, v in recording.columns.items()
        },
    )
    assert np.isinf(state_spread(Assembly(rig_named("one-dof")), still)).any()
    assert STATE_JUMP < 0.1
