"""An effect that only bends a characteristic, by less than ordinary machines bend theirs, is not
named; one that does more, or something else, is judged as before."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from test_decision import FRICTION, GAP, SILENT

from pamid.diagnosis.bends import bend, smooth_bend
from pamid.diagnosis.candidate_model import CandidateModel, candidate_from
from pamid.diagnosis.decision import decide
from pamid.diagnosis.settings import DEFAULT
from pamid.estimation.grey_box import fit_model
from pamid.model.attachment import attach
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import read_recording, write_recording
from pamid.simulation.data_split import split_recordings
from pamid.simulation.virtual_rig import simulate_virtual_rig

Array = NDArray[np.float64]

TANKS = str(Path(__file__).parents[2] / "data" / "rigs" / "tanks.py")
VALUE = np.random.default_rng(5).uniform(-1.0, 1.0, 4000)
RATE = np.random.default_rng(6).normal(0.0, 1.0, 4000)


@pytest.mark.parametrize(
    "change",
    [
        lambda v: -0.08 * np.maximum(v - 0.3, 0.0),
        lambda v: 0.03 * np.abs(v),
        lambda v: 0.02 * v * np.sin(4.0 * v),
        lambda v: -0.02 * np.maximum(v - 0.9, 0.0),
    ],
    ids=["soft limit", "one side weaker", "wave", "at one end"],
)
def test_a_curve_is_a_bend_of_its_size(change: Callable[[Array], Array]) -> None:
    found = smooth_bend(VALUE, VALUE + change(VALUE))
    line = np.polyval(np.polyfit(VALUE, change(VALUE), 1), VALUE)
    left = float(np.sqrt(np.mean((change(VALUE) - line) ** 2) / np.mean(VALUE**2)))
    assert found == pytest.approx(left, rel=1e-6)
    assert 0.0 < left < DEFAULT.ordinary_bend


@pytest.mark.parametrize(
    "changed",
    [
        0.98 * VALUE,
        VALUE + 0.2,
        VALUE - np.clip(VALUE, -0.03, 0.03),
        np.round(VALUE / 0.05) * 0.05,
        VALUE - 0.02 * RATE,
        np.roll(VALUE, 1),
    ],
    ids=["gain", "offset", "dead zone", "steps", "lag", "delay"],
)
def test_what_a_smooth_curve_does_not_do_is_no_bend(changed: Array) -> None:
    assert smooth_bend(VALUE, changed) is None


def test_nothing_that_passes_is_no_bend() -> None:
    assert smooth_bend(np.zeros(50), np.zeros(50)) is None


def pumped(folder: Path, effect: str, planted: str) -> CandidateModel:
    """Two tanks with an effect that their model has as well, fitted."""
    random, time = np.random.default_rng(4), 4.0 * np.arange(400)
    write_recording(folder / "sent.csv", time, {"pump_v": np.repeat(random.uniform(1, 6, 40), 10)})
    sent = read_recording(folder / "sent.csv")
    made = simulate_virtual_rig(TANKS, sent, (f"{effect}:{planted}",), {}, {}, 1.0, 1)
    write_recording(folder / "rec.csv", time, made.columns, made.meta)
    evidence = split_recordings(rig_named(TANKS), [read_recording(folder / "rec.csv")], [])
    model = fit_model(evidence, (attach(evidence.rig, effect, effects()),))
    return candidate_from(model.assembly, model.fit, model.held_out)


def test_a_soft_limit_is_a_bend_of_the_pump_and_a_hard_one_is_none(tmp_path: Path) -> None:
    soft = bend(pumped(tmp_path, "saturation@pump", "limit_v=3,share=0.1"), "saturation@pump")
    hard = bend(pumped(tmp_path, "saturation@pump", "limit_v=3,share=1"), "saturation@pump")
    assert soft is not None and 0.002 < soft < DEFAULT.ordinary_bend
    assert hard is None


def test_what_is_lost_from_a_store_is_no_bend(tmp_path: Path) -> None:
    model = pumped(tmp_path, "first-order-loss@lower", "rate_per_s=0.004")
    assert bend(model, "first-order-loss@lower") is None


def test_an_ordinary_bend_is_not_named() -> None:
    """Probable as it is, it may be the machine's own characteristic: that cannot be told."""
    assert decide(GAP, SILENT, [FRICTION]).verdict == "explained"
    small = replace(FRICTION, bent=0.9 * DEFAULT.ordinary_bend)
    assert decide(GAP, SILENT, [replace(FRICTION, bent=1.1 * DEFAULT.ordinary_bend)]).named
    said = decide(GAP, SILENT, [small], [small], [small])
    assert (said.verdict, said.why, said.named) == ("cannot-tell", "bent", ())
    assert decide(SILENT, SILENT, [small]).verdict == "no-structural-gap"
