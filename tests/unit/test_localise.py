"""Regimes: a gap planted at known values of a signal is told in that signal, once, with its bounds
and shares."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from counted import calls_of
from virtual_joint import SPECIMEN, record

from pamid.diagnosis.candidate_model import CandidateModel, candidate_from
from pamid.engine.program import Stepping
from pamid.model.assembly import Assembly
from pamid.model.registry import rig_named
from pamid.recording.recording import read_recording
from pamid.simulation.data_split import DataSplit, split_recordings
from pamid.simulation.replay import replay_track
from pamid.verdict.localise import (
    REGIMES_MOST,
    _followed,
    _since_reversal,
    _stretch,
    measured_signals,
    port_signals,
    recorded_units,
    regimes,
)

SENSORS = ("reference_deg", "command", "angle_deg", "pressure_1_kpa", "pressure_2_kpa")
EXAMPLE_RIGS = Path(__file__).resolve().parents[2] / "data" / "rigs"


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
def joint(tmp_path_factory: pytest.TempPathFactory) -> tuple[DataSplit, CandidateModel]:
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


def test_a_model_without_error_has_no_regime(joint: tuple[DataSplit, CandidateModel]) -> None:
    evidence, base = joint
    r = base.replays[0]
    assert (
        regimes(evidence, replace(base, replays=(replace(r, full_outputs=r.full_track.y),)), None)
        == ()
    )
    everywhere = with_gap(joint, np.ones(len(r.track), bool))
    assert regimes(evidence, everywhere, None) == (), "a gap that is everywhere is in no regime"


def test_forwards_and_backwards_end_at_zero(joint: tuple[DataSplit, CandidateModel]) -> None:
    speed = signals(joint)["joint_velocity"]
    best = regimes(joint[0], with_gap(joint, speed < 0.0), None)[0]
    assert best.signal in ("velocity", "joint_velocity") and best.unit == "deg/s"
    assert best.high == 0.0 and best.low < 0.9 * speed.min()
    assert best.share_of_gap > 0.9 and best.share_of_time == pytest.approx(
        np.mean(speed < 0.0), abs=0.05
    )


def test_a_coincidence_of_two_drifts_is_no_regime() -> None:
    """The gap grows once while the room is warm; when it does so in every one of many cycles, it
    is a regime."""
    noise = np.random.default_rng(8).normal(size=4000)
    for cycles, stated in ((0.7, False), (20.0, True)):
        slow = np.sin(2.0 * np.pi * cycles * np.arange(4000) / 4000)
        gap = np.where(slow > 0.3, 4.0, 0.5) + 0.2 * noise**2
        stretch = _stretch("room", "degC", 20.0 + slow + 0.02 * noise, gap)
        assert (stretch is not None) == stated
    assert stretch is not None and stretch.regime.low == pytest.approx(20.3, abs=0.2)


def test_signals_come_in_the_units_of_the_recording() -> None:
    """Columns as they are named, their rates per second; inside the model what was recorded as
    well, but no difference of temperature on a scale with another zero."""
    rig: Any = SimpleNamespace(
        inputs={"pressure_bar": "Pa", "valve_percent": ""},
        outputs={"position_mm": "m", "oil_degc": "K"},
        rate_names={"position": "velocity"},
        optional={},
    )
    evidence: Any = SimpleNamespace(rig=rig, channels=("position_mm", "oil_degc"))
    assert recorded_units(evidence) == {
        "position": "mm",
        "velocity": "mm/s",
        "pressure": "bar",
        "pressure rate": "bar/s",
    }
    steps = np.arange(60.0)
    y = np.stack([1e-3 * steps, 293.15 + steps], axis=1)
    track = SimpleNamespace(y=y, u=np.full((60, 2), 2e5), period_s=0.5, timescale_s=1.0)
    r: Any = SimpleNamespace(track=track, seen=(True, True), model=y)
    found = measured_signals(evidence, r)
    assert {name: unit for name, (_, unit) in found.items()} == {
        "position": "mm",
        "velocity": "mm/s",
        "oil": "degC",
        "oil_rate": "K/s",
        "pressure": "bar",
        "valve": "percent",
    }
    sizes = {name: float(values[30]) for name, (values, _) in found.items()}
    want = {"position": 30.0, "velocity": 2.0, "oil": 50.0, "oil_rate": 2.0, "pressure": 2.0}
    assert sizes == pytest.approx(want | {"valve": 2e7})


def test_opening_is_told_from_closing(joint: tuple[DataSplit, CandidateModel]) -> None:
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
def test_a_gap_inside_the_model_is_told_there(
    joint: tuple[DataSplit, CandidateModel], signal: str, unit: str, low: float, high: float
) -> None:
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


def test_filling_is_told_from_venting(joint: tuple[DataSplit, CandidateModel]) -> None:
    best = regimes(joint[0], with_gap(joint, signals(joint)["valve_flow_2"] > 0.0), None)[0]
    assert best.signal in ("valve_flow_2", "valve_ratio_2") and best.share_of_gap > 0.9


def test_one_regime_is_told_once(joint: tuple[DataSplit, CandidateModel]) -> None:
    """The angle and the contractions of both muscles are the same thing."""
    evidence, base = joint
    found = regimes(evidence, with_gap(joint, signals(joint)["angle"] > 15.0), None)
    names = [r.signal for r in found]
    assert names[0] == "angle"
    assert not {"joint_position", "muscle_contraction_1", "muscle_contraction_2"} & set(names)
    assert len(found) <= REGIMES_MOST
    gains = [r.share_of_gap - r.share_of_time for r in found]
    assert gains[0] == max(gains) and min(gains) > 0.1


def test_what_the_cause_explains_is_the_gap(joint: tuple[DataSplit, CandidateModel]) -> None:
    """Samples that a cause leaves as they are belong to no regime of it."""
    evidence, base = joint
    angle = signals(joint)["angle"]
    before = with_gap(joint, (angle > 15.0) | (angle < -15.0))
    after = with_gap(joint, angle < -15.0)
    best = regimes(evidence, before, after)[0]
    assert best.signal == "angle" and best.low > 5.0


def test_it_costs_next_to_nothing(joint: tuple[DataSplit, CandidateModel]) -> None:
    inside = with_gap(joint, signals(joint)["angle"] > 15.0)
    regimes(joint[0], inside, None)  # what is kept from the first time on
    assert calls_of(lambda: regimes(joint[0], inside, None)) < 100_000, (
        "not one per sample and signal"
    )


def test_time_since_the_last_reversal() -> None:
    """A crawl at 1 % of the usual speed is no reversal, and what stands keeps its direction."""
    speed = np.array([1.0, 1.0, 0.0, 1.0, -1.0, -1.0, 0.01, -1.0, 1.0, 1.0])
    assert _since_reversal(speed).tolist() == [
        0.0,
        1.0,
        2.0,
        3.0,
        0.0,
        1.0,
        2.0,
        3.0,
        0.0,
        1.0,
    ]


def test_a_rig_of_ones_own(tmp_path: Path) -> None:
    """A cart: its port's velocity tells reversals, and what it measures is not told twice."""
    rig = rig_named(str(EXAMPLE_RIGS / "cart.py"))
    seconds = 0.01 * np.arange(1200)
    random = np.random.default_rng(3)
    force = np.repeat(random.uniform(-2.0, 2.0, 40), 30)
    speed = np.cumsum(0.01 * force)
    rows = np.column_stack(
        [seconds, force, np.cumsum(0.01 * speed) + 1e-4 * random.normal(size=1200)]
    )
    path = tmp_path / "cart.csv"
    np.savetxt(
        path, rows, delimiter=",", header="time_s,force_n,position_m", comments="", fmt="%.9g"
    )
    evidence = split_recordings(rig, [read_recording(path)], [])
    base = replayed(evidence, {})
    assert port_signals(base).names == ("force_velocity", "force_position")
    for r in regimes(evidence, base, None):
        assert 0.0 <= r.share_of_time <= 1.0 and 0.0 <= r.share_of_gap <= 1.0 and r.low < r.high
