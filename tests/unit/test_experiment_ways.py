"""Experiments without a loop leave the rig where it was recorded, and what was recorded beside is
sent again."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from virtual_recordings import virtual_recording

from pamid.base.arrays import Array
from pamid.diagnosis.planning import experiment_ways
from pamid.diagnosis.planning.experiment_ways import (
    LEEWAY,
    Predictions,
    Way,
    led_away,
    predicted_text,
    reaches,
    ways_to_run,
)
from pamid.diagnosis.planning.next_experiment import bench_of
from pamid.estimation.grey_box import fit_model
from pamid.model.registry import rig_named
from pamid.simulation.data_split import DataSplit, split_recordings
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.excitation.experiments import Experiment, menu
from pamid.simulation.excitation.waveforms import washed_out

PERIOD_S, SAMPLES = 0.005, 4000
CART = str(Path(__file__).resolve().parents[2] / "data" / "rigs" / "cart.py")


def split(rig: str, columns: dict[str, Array]) -> DataSplit:
    """What the rig records of these columns."""
    return split_recordings(rig_named(rig), [virtual_recording(rig, columns, PERIOD_S, seed=3)], [])


@pytest.fixture(scope="module")
def pushed() -> tuple[DataSplit, Any]:
    """A free cart that was pushed to and fro about a place, as a controller would, and its
    model."""
    wave = washed_out(aprbs(SAMPLES * PERIOD_S, PERIOD_S, 1.0, (0.1, 0.4), seed=1), 0.05)
    evidence = split(CART, {"force_n": 4.0 * wave})
    return evidence, fit_model(evidence, ())


def multisine(evidence: DataSplit) -> Experiment:
    return next(e for e in menu(bench_of(evidence)) if e.name == "odd-multisine")


def worst(predictions: Predictions, model: Any, way: Way) -> float:
    """How far an experiment swings, over what was recorded, of the worst name."""
    every = [x for r in predictions.of(model, way) if r for x in reaches(predictions.evidence, r)]
    return max((x.high - x.low) / (x.recorded[1] - x.recorded[0]) for x in every)


def test_a_free_cart_stays_where_it_was_recorded(pushed):
    """As they are, the shapes drive it off; all the ways that are left keep it."""
    evidence, model = pushed
    bench = bench_of(evidence)
    predictions, entries = Predictions(evidence), menu(bench)
    assert max(worst(predictions, model, Way(bench, e)) for e in entries) > 3.0
    ways = ways_to_run(predictions, bench, entries, [model])
    assert ways and [w.experiment for w in ways] == sorted(
        (w.experiment for w in ways), key=entries.index
    )
    high = bench.driven["force_n"]
    for way in ways:
        assert worst(predictions, model, way) <= 1.0 + 2.0 * LEEWAY
        sent = way.columns["force_n"]
        assert np.abs(sent - high[0]).max() <= high[1] * (1.0 + 1e-9)
        assert "recorded: " in predicted_text(predictions, way, [model])


def test_a_model_that_would_run_off_forbids_it(pushed, monkeypatch):
    """It is enough that one of the models leads away."""
    evidence, model = pushed
    light = replace(model, fit=replace(model.fit, p=model.fit.p / 50.0))
    bench, e = bench_of(evidence), multisine(evidence)
    predictions = Predictions(evidence)
    assert len(ways_to_run(predictions, bench, [e], [model, light])) < len(
        ways_to_run(predictions, bench, [e], [model])
    )
    monkeypatch.setattr(experiment_ways, "WAYS", ((20.0, 1),))
    assert not ways_to_run(predictions, bench, [e], [model])
    assert "position_m from 0 to" in led_away(predictions, bench, e, [model])
