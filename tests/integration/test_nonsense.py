"""Recordings that no model of the rig could have made: nothing is explained, whatever an effect
happens to improve."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pamid_cli.diagnose import diagnosis_text
from scripts import load_script

from pamid.base.arrays import Array
from pamid.base.run_folder import Run
from pamid.diagnosis.verdict.diagnosis_run import diagnose_into
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import read_recording, write_recording
from pamid.report.load import load_run
from pamid.simulation.data_split import split_recordings
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.virtual_rig import simulate_virtual_rig

CART = str(Path(__file__).resolve().parents[2] / "data" / "rigs" / "cart.py")
SAMPLES, PERIOD_S = 2400, 0.01
FEW = ("quantisation", "coulomb-friction", "dead-time")


def diagnosed(folder: Path, position: Array, force: Array) -> dict[str, Any]:
    write_recording(
        folder / "rec.csv",
        np.arange(SAMPLES) * PERIOD_S,
        {"force_n": force, "position_m": position},
    )
    run = Run.create(folder / "run", command=["test"], seed=0, overwrite=True)
    return diagnose_into(
        run,
        split_recordings(rig_named(CART), [read_recording(folder / "rec.csv")], []),
        {name: effects()[name] for name in FEW},
    )


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory) -> tuple[Path, Array, Array]:
    """A cart that rubs, its encoder of 0.5 mm and its force."""
    folder = tmp_path_factory.mktemp("cart")
    force = aprbs(SAMPLES * PERIOD_S, PERIOD_S, 3.0, (0.2, 0.8), seed=1)
    write_recording(folder / "sent.csv", np.arange(SAMPLES) * PERIOD_S, {"force_n": force})
    made = simulate_virtual_rig(
        CART,
        read_recording(folder / "sent.csv"),
        ("coulomb-friction:force_n=0.8",),
        {},
        {"mass_kg": 1.2},
        0.0,
        1,
    )
    return folder, force, np.round(made.columns["position_m"] / 5e-4) * 5e-4


def nonsense(kind: str, seed: int) -> Array:
    random = np.random.default_rng(seed)
    white = random.standard_normal(SAMPLES)
    made = {
        "white noise": white,
        "a random walk": 0.03 * white.cumsum(),
        "at rest": 5.0 + 0.02 * white,
    }
    return np.asarray(made[kind])


@pytest.mark.parametrize("kind", ["white noise", "a random walk", "at rest"])
def test_no_cause_is_found_in_what_the_input_did_not_make(kind, rubbing):
    folder, force, _ = rubbing
    found = diagnosed(folder, nonsense(kind, 1), force)
    assert found["verdict"] == "cannot-tell" and found["causes"] == []
    assert "do not show this machine" in found["sentence"] and found["remark"] == found["sentence"]
    assert all(r["probability"] == 0.0 for r in found["ranking"])
    assert found["unknown"] is None and found["next_experiment"] is None, (
        "nothing is described, nothing to tell apart"
    )
    shown = " ".join(diagnosis_text(load_run(folder / "run"), folder / "run").split())
    assert shown.startswith(found["remark"]) and "Where" not in shown and "shrinkage" not in shown


def test_the_recording_itself_is_explained(rubbing):
    folder, force, real = rubbing
    found = diagnosed(folder, real, force)
    assert found["verdict"] == "explained" and found["remark"] == ""
    assert [c["effect"] for c in found["causes"]] == ["coulomb-friction"]
    assert found["how_far"]["position_m"]["shrinkage"] > 0.5
    shown = " ".join(diagnosis_text(load_run(folder / "run"), folder / "run").split())
    assert "[known] fixes a parameter" in shown and "[free] releases" in shown


SUITE = load_script("nonsense.py")
SMOOTH = ("ramp", "sine, fast", "decay", "sawtooth")  # a free response reproduces them
OTHER = ("shuffled rows", "foreign output", "output half a recording late", "foreign input")


@pytest.mark.parametrize("rig", ["cart", pytest.param("thermal-block", marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", [*SMOOTH, *OTHER, "noisy echo"])
def test_nonsense_of_the_suite_is_rejected(kind, rig, tmp_path):
    outcome = SUITE.outcome_of(rig, kind, False, tmp_path)
    assert outcome.word in ("refused", "called nonsense"), outcome.sentence


def test_rows_in_reverse_order_of_time_are_reported(tmp_path):
    outcome = SUITE.outcome_of("thermal-block", "reversed time", False, tmp_path)
    assert outcome.word == "called nonsense" and "reverse order of time" in outcome.sentence


@pytest.mark.slow
def test_one_foreign_channel_of_several_is_named(tmp_path):
    kind = "sine in the last channel"
    outcome = SUITE.outcome_of("cascaded-tanks", kind, False, tmp_path)
    assert "upper_level_cm does not respond to pump_v" in outcome.sentence
    assert "Without it the others can be diagnosed" in outcome.sentence


def test_a_silent_input_is_named(tmp_path):
    outcome = SUITE.outcome_of("cart", "ramp", False, tmp_path)
    assert "position_m does not respond to force_n" in outcome.sentence


def test_the_genuine_partner_of_a_ramp_is_answered(tmp_path):
    assert SUITE.outcome_of("thermal-block", "ramp", True, tmp_path).word == "right"
