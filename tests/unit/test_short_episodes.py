"""Short recordings count together: as episodes with a start each."""

import numpy as np
import pytest
from small_cart import FEW, PERIOD_S, RIG
from virtual_recordings import virtual_recording

from pamid.base.errors import DataError
from pamid.diagnosis.pipeline import diagnose
from pamid.diagnosis.verdict.verdict_figures import diagnosis_file
from pamid.intake.checks.recording_quality import examine
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import Recording, recording_of
from pamid.simulation.data_split import FEWEST_SAMPLES, shortfall_alone, split_recordings
from pamid.simulation.replay import replay_windows


def episodes(count: int, samples: int) -> list[Recording]:
    """Recordings of a cart with friction, each pushed from rest elsewhere along the rail."""
    found, random = [], np.random.default_rng(2)
    for k in range(count):
        push = np.repeat(random.uniform(2.0, 6.0, 10) * random.choice([-1, 1], 10), 30)[:samples]
        made = virtual_recording(
            RIG, {"force_n": push}, PERIOD_S, "coulomb-friction", true={"mass_kg": 1.2}, seed=k
        )
        place = made.columns["position_m"] + random.uniform(-0.5, 0.5)
        found.append(
            recording_of(made.time, {**made.columns, "position_m": place}, name=f"rec-{k}")
        )
    return found


def test_nine_episodes_of_100_samples_are_900_samples():
    evidence = split_recordings(rig_named(RIG), episodes(9, 100), [])
    assert {(s.start, s.stop) for s in (*evidence.fit, *evidence.held_out)} == {(0, 100)}
    assert (len(evidence.fit), len(evidence.held_out)) == (6, 3)
    found = diagnose(evidence, {name: effects()[name] for name in FEW})
    windows = [len(replay_windows(r.track)) for r in found.budget.baseline.replays]
    assert sum(windows) >= 6 and max(windows) <= 4
    assert [c.effect for c in diagnosis_file(found).causes] == ["coulomb-friction"]


def test_check_and_diagnose_draw_the_same_line():
    rig = rig_named(RIG)
    for samples in (FEWEST_SAMPLES - 1, FEWEST_SAMPLES):
        (recording,) = episodes(1, samples)
        short = samples < FEWEST_SAMPLES
        assert bool(shortfall_alone(recording)) == short
        issues = [issue for issue in examine(recording, rig) if issue.kind == "short"]
        assert [issue.severity for issue in issues] == (["wrong"] if short else [])
        if short:
            with pytest.raises(DataError, match="too few to fit and judge") as refused:
                split_recordings(rig, [recording], [])
            assert issues[0].message in refused.value.message
        else:
            split_recordings(rig, [recording], [])
