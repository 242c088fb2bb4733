"""What of a recording is held out: its end, unless a part of it rests."""

import numpy as np
import pytest
from small_cart import PERIOD_S, RIG
from virtual_recordings import virtual_recording

from pamid.base.arrays import Array
from pamid.diagnosis.pipeline import diagnose
from pamid.diagnosis.verdict.notes import notes_of, remark
from pamid.estimation.fit_files import residual_table
from pamid.estimation.grey_box import fit_model
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import Recording, recording_of
from pamid.simulation.data_split import DataSplit, split_recordings

TIME = PERIOD_S * np.arange(1000)
NOISE_MM = 0.05
SWINGS = np.sin(9.0 * TIME) + np.sin(5.3 * TIME)
FADES = np.exp(-TIME / 1.2)


def moved(shape: Array, name: str = "rec", seed: int = 1) -> Recording:
    """A recording of a cart whose position has this shape, and whose force its slope."""
    noise = NOISE_MM * np.random.default_rng(seed).standard_normal(len(shape))
    force = np.gradient(shape, TIME)
    return recording_of(TIME, {"force_n": force, "position_mm": 20.0 * shape + noise}, name=name)


def parts(e: DataSplit) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    fitted, held = ([(s.start, s.stop) for s in part] for part in (e.fit, e.held_out))
    return fitted, held


@pytest.mark.parametrize(
    ("shape", "rests"),
    [
        (SWINGS, False),
        (0.4 * SWINGS + TIME, False),
        (FADES * SWINGS, True),  # it dies away
        (1.0 - FADES, True),  # a step and its plateau
        (np.where(TIME < 7.0, 0.0, SWINGS), True),  # it begins late
    ],
)
def test_where_a_part_rests_tenths_spread_over_the_recording_are_held_out(shape, rests):
    recording = moved(shape)
    evidence = split_recordings(rig_named(RIG), [recording], [])
    spread = ([(0, 100), (200, 400), (500, 700), (800, 1000)], [(100, 200), (400, 500), (700, 800)])
    assert parts(evidence) == (spread if rests else ([(0, 700)], [(700, 1000)]))
    assert [r.sha256 for r in evidence.spread] == ([recording.sha256] if rests else [])
    assert not evidence.held_out_rests


@pytest.mark.parametrize(("sent", "rests"), [(0.0, True), (1.0, True), (SWINGS, False)])
def test_what_is_sent_rests_too_and_what_never_moves_says_nothing(sent, rests):
    """A motion that becomes small while the drive goes on is worth to be judged on."""
    noise = NOISE_MM * np.random.default_rng(3).standard_normal(len(TIME))
    columns = {"force_n": sent + 0.0 * TIME, "position_mm": 20.0 * SWINGS * FADES + noise}
    recording = recording_of(TIME, columns)
    assert bool(split_recordings(rig_named(RIG), [recording], []).spread) == rests


def test_a_step_response_is_judged():
    """A cart that is pushed, and braked: its last three tenths are a plateau, of which nothing can
    be told."""
    time = PERIOD_S * np.arange(1200)
    push = 8.0 * ((time > 0.5) & (time < 0.8)) - 8.0 * ((time > 1.5) & (time < 1.8))
    true = {"mass_kg": 1.2}
    recording = virtual_recording(RIG, {"force_n": push}, PERIOD_S, "coulomb-friction", true=true)
    evidence = split_recordings(rig_named(RIG), [recording], [])
    assert len(evidence.spread) == 1 and not evidence.whole_held_out
    found = diagnose(evidence, {k: effects()[k] for k in ("coulomb-friction", "dead-time")})
    assert remark(found) == "" and any("in several parts" in note for note in notes_of(found))
    assert found.ranking[0].label == "coulomb-friction"
    header, rows = residual_table(fit_model(evidence))
    columns = dict(zip(header, rows.T, strict=True))
    assert (np.diff(columns["time_s"]) > 0.0).all() and len(rows) == len(time)
    assert np.unique(np.diff(columns["part"])).tolist() == [-1.0, 0.0, 1.0]
