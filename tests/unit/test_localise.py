"""Regimes: a gap planted at known values of a signal is told in that signal, once, with its bounds
and shares."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from virtual_joint import SPECIMEN, record

from pamid.diagnosis.candidate_model import CandidateModel, candidate_from
from pamid.diagnosis.verdict.localise import (
    REGIMES_MOST,
    _followed,
    measured_signals,
    port_signals,
    regimes,
)
from pamid.engine.program import Stepping
from pamid.model.assembly import Assembly
from pamid.model.registry import rig_named
from pamid.simulation.data_split import DataSplit, split_recordings
from pamid.simulation.replay import replay_track

SENSORS = ("reference_deg", "command", "angle_deg", "pressure_1_kpa", "pressure_2_kpa")


def replayed(evidence: DataSplit, known: dict[str, float]) -> CandidateModel:
    """The rig's own model at known parameters, without any fit."""
    assembly = Assembly(evidence.rig, background=True, outputs=evidence.channels).for_fitting()
    p, stepping = assembly.values(known), Stepping(2)
    runs = tuple(
        replay_track(assembly, p, t, stepping, evidence.noise)
        for t in evidence.tracks(assembly, held_out=True)
    )
    fitted: Any = SimpleNamespace(p=p, stepping=stepping)
    return candidate_from(assembly, fitted, runs)


@pytest.fixture(scope="module")
def joint(tmp_path_factory) -> tuple[DataSplit, CandidateModel]:
    """40 s of a joint without any fault, and the model that made it."""
    path = tmp_path_factory.mktemp("joint") / "rec.csv"
    evidence = split_recordings(
        rig_named("one-dof"), [record(path, 40.0, seed=4, columns=SENSORS)], []
    )
    return evidence, replayed(evidence, SPECIMEN)


def signals(joint: tuple[DataSplit, CandidateModel]) -> dict[str, np.ndarray]:
    evidence, base = joint
    found = measured_signals(evidence, base.replays[0])
    found |= _followed(base, base.replays[0], port_signals(base), {})
    return {name: values for name, (values, _) in found.items()}


def with_gap(joint: tuple[DataSplit, CandidateModel], inside: np.ndarray) -> CandidateModel:
    """The model made to err by 2 deg at these samples of its replay."""
    _, base = joint
    r = base.replays[0]
    whole = r.full_outputs.copy()
    whole[r.full_track.lead :][inside, 0] += np.deg2rad(2.0)
    return replace(base, replays=(replace(r, full_outputs=whole),))


def test_a_model_without_error_has_no_regime(joint):
    evidence, base = joint
    r = base.replays[0]
    assert (
        regimes(evidence, replace(base, replays=(replace(r, full_outputs=r.full_track.y),)), None)
        == ()
    )
    everywhere = with_gap(joint, np.ones(len(r.track), bool))
    assert regimes(evidence, everywhere, None) == (), "a gap that is everywhere is in no regime"


def test_opening_is_told_from_closing(joint):
    best = regimes(joint[0], with_gap(joint, signals(joint)["command"] > 0.0), None)[0]
    assert best.signal == "command" and best.low == 0.0 and best.high == pytest.approx(1.0)


@pytest.mark.parametrize(
    "signal, unit, low, high",
    [
        ("time_since_reversal", "s", -1.0, 0.15),
        ("joint_load", "N", 1560.0, 2000.0),
        ("muscle_pressure_1", "kPa", 0.0, 300.0),
    ],
)
def test_a_gap_inside_the_model_is_told_there(joint, signal, unit, low, high):
    """Reversals and load are not measured; without their sensors, neither are the pressures."""
    if signal == "muscle_pressure_1":
        evidence = replace(joint[0], channels=("angle_deg",), noise=joint[0].noise[:1])
        joint = (evidence, replayed(evidence, SPECIMEN))
    x = signals(joint)[signal]
    inside = (x > low) & (x < high)
    assert 0.05 < inside.mean() < 0.5, "the planted regime is a part of the recording"
    best = regimes(joint[0], with_gap(joint, inside), None)[0]
    assert (best.signal, best.unit) == (signal, unit)
    assert best.share_of_gap > 0.8 and best.share_of_time < inside.mean() + 0.15
    shared = np.minimum(best.high, min(high, x.max())) - np.maximum(best.low, max(low, x.min()))
    assert shared > 0.5 * (best.high - best.low)


def test_one_regime_is_told_once(joint):
    """The angle and the contractions of both muscles are the same thing."""
    evidence, base = joint
    found = regimes(evidence, with_gap(joint, signals(joint)["angle"] > 15.0), None)
    names = [r.signal for r in found]
    assert names[0] == "angle"
    assert not {"joint_position", "muscle_contraction_1", "muscle_contraction_2"} & set(names)
    assert len(found) <= REGIMES_MOST
    gains = [r.share_of_gap - r.share_of_time for r in found]
    assert gains[0] == max(gains) and min(gains) > 0.1


def test_what_the_cause_explains_is_the_gap(joint):
    """Samples that a cause leaves as they are belong to no regime of it."""
    evidence, base = joint
    angle = signals(joint)["angle"]
    before = with_gap(joint, (angle > 15.0) | (angle < -15.0))
    after = with_gap(joint, angle < -15.0)
    best = regimes(evidence, before, after)[0]
    assert best.signal == "angle" and best.low > 5.0
