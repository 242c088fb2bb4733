"""Experiments without a loop leave the rig where it was recorded, and what was recorded beside is
sent again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pamid.estimation.grey_box import fit_model
from pamid.excitation.aprbs import aprbs
from pamid.excitation.experiments import MENU, Experiment, menu
from pamid.excitation.washout import washed_out
from pamid.excitation.waveforms import amplitude_sweep, odd_multisine, slow_reversals, speed_runs
from pamid.model.registry import rig_named
from pamid.planning import experiment_ways
from pamid.planning.experiment_ways import (
    LEEWAY,
    Predictions,
    Way,
    carried_texts,
    led_away,
    predicted_text,
    reaches,
    ways_to_run,
)
from pamid.planning.next_experiment import bench_of
from pamid.recording.recording import read_recording, write_recording
from pamid.simulation.data_split import DataSplit, split_recordings
from pamid.simulation.free_runs import virtual_recording
from pamid.simulation.virtual_rig import simulate_virtual_rig

Array = NDArray[np.float64]

PERIOD_S, SAMPLES = 0.005, 4000
CART = str(Path(__file__).resolve().parents[2] / "data" / "rigs" / "cart.py")
DAMPER = '''"""A damper on a bench that imposes the speed."""
from pamid import Parameter, Port, Rig


class Damper(Rig):
    """Force in proportion to the speed, with a voltage at its coil and the heat of the oil."""

    inputs = {"velocity_mm_per_s": "m/s", "voltage_v": "V", "oil_degc": "K"}
    inputs["external_force_n"] = "N"
    optional = {"voltage_v": 0.0, "oil_degc": 293.15, "external_force_n": 0.0}
    between = {"velocity_mm_per_s": "linear"}
    outputs = {"force_n": "N"}
    noise = {"force_n": 1.0}
    ports = {"rod": Port("motion", "N", {"velocity": "m/s", "voltage": "V", "heat": "K"})}
    parameters = (
        Parameter("damping", 900.0, 50.0, 20000.0, "N s/m", spread=1.5, log=True, source="sheet"),
    )
    period_s = 0.005

    def measure(self, x, u, p, port):
        v = u.velocity_mm_per_s
        force = -p.damping * v + u.external_force_n
        return {"force_n": port("rod", force, velocity=v, voltage=u.voltage_v, heat=u.oil_degc)}
'''


def split(folder: Path, rig: str, columns: dict[str, Array]) -> DataSplit:
    """What the rig records of these columns."""
    time = PERIOD_S * np.arange(SAMPLES)
    write_recording(folder / "sent.csv", time, columns)
    made = simulate_virtual_rig(rig, read_recording(folder / "sent.csv"), (), {}, {}, 1.0, 3)
    write_recording(folder / "rec.csv", time, made.columns, made.meta)
    return split_recordings(rig_named(rig), [read_recording(folder / "rec.csv")], [])


@pytest.fixture(scope="module")
def pushed(tmp_path_factory: pytest.TempPathFactory) -> tuple[DataSplit, Any]:
    """A free cart that was pushed to and fro about a place, as a controller would, and its
    model."""
    wave = washed_out(aprbs(SAMPLES * PERIOD_S, PERIOD_S, 1.0, (0.1, 0.4), seed=1), 0.05)
    evidence = split(tmp_path_factory.mktemp("cart"), CART, {"force_n": 4.0 * wave})
    return evidence, fit_model(evidence, ())


@pytest.fixture(scope="module")
def imposed(tmp_path_factory: pytest.TempPathFactory) -> DataSplit:
    """A damper moved to and fro by 60 mm, its voltage in steps, its oil at one temperature."""
    folder = tmp_path_factory.mktemp("damper")
    (folder / "damper.py").write_text(DAMPER)
    t = PERIOD_S * np.arange(SAMPLES)
    columns = {
        "velocity_mm_per_s": 30.0 * 2.0 * np.pi * np.sin(2.0 * np.pi * t),
        "voltage_v": np.floor(t / 5.0),
        "oil_degc": np.full(SAMPLES, 40.0),
        "external_force_n": 3.0 * np.sin(t),
    }
    return split(folder, str(folder / "damper.py"), columns)


def multisine(evidence: DataSplit) -> Experiment:
    return next(e for e in menu(bench_of(evidence)) if e.name == "odd-multisine")


def worst(predictions: Predictions, model: Any, way: Way) -> float:
    """How far an experiment swings, over what was recorded, of the worst name."""
    every = [x for r in predictions.of(model, way) if r for x in reaches(predictions.evidence, r)]
    return max((x.high - x.low) / (x.recorded[1] - x.recorded[0]) for x in every)


def test_a_free_cart_stays_where_it_was_recorded(pushed: tuple[DataSplit, Any]) -> None:
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
        assert "recorded were" in predicted_text(predictions, way, [model])


def test_predictions_are_recordings_without_noise(pushed: tuple[DataSplit, Any]) -> None:
    """Of every way by itself, and None where the model blows up in that way alone."""
    evidence, model = pushed
    bench, e = bench_of(evidence), multisine(evidence)
    shares = (0.25, 1.0, 1e30, 0.5)
    ways = [
        Way(replace(bench, driven={k: (c, s * h) for k, (c, h) in bench.driven.items()}), e)
        for s in shares
    ]
    made = Predictions(evidence).of_all(model, ways)
    for share, way, (recording,) in zip(shares, ways, made, strict=True):
        assert (recording is None) == (share == 1e30)
        if recording is None:
            continue
        sent = replace(recording, columns=way.columns)
        alone = virtual_recording(model.assembly, sent, model.fit.p, noise=0.0, fineness=1)
        assert list(alone) == list(recording.columns)
        for name, values in alone.items():
            np.testing.assert_allclose(recording.columns[name], values, rtol=1e-9, atol=1e-12)


def test_a_model_that_would_run_off_forbids_it(
    pushed: tuple[DataSplit, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_the_way_of_an_imposed_speed_counts(imposed: DataSplit) -> None:
    model: Any = fit_model(imposed, ())
    bench = bench_of(imposed)
    predictions = Predictions(imposed)
    for way in ways_to_run(predictions, bench, menu(bench), [model]):
        speed = way.columns["velocity_mm_per_s"]
        assert np.ptp(np.cumsum(speed) * PERIOD_S) < 1.15 * 60.0, way.experiment.name
    plain = np.cumsum(multisine(imposed).signals(bench)["velocity_mm_per_s"]) * PERIOD_S
    assert np.ptp(plain) > 1.15 * 60.0
    assert ways_to_run(predictions, bench, [multisine(imposed)], [model])


def test_what_was_recorded_beside_is_sent_again(imposed: DataSplit) -> None:
    """Not a force from outside, which nothing on the bench sends."""
    bench, e = bench_of(imposed), multisine(imposed)
    recorded, sent = imposed.recordings[0], e.columns(bench)
    assert set(sent) == {"velocity_mm_per_s", "voltage_v", "oil_degc"}
    for name in ("voltage_v", "oil_degc"):
        np.testing.assert_array_equal(sent[name], recorded.signal(name)[: len(sent[name])])
    assert carried_texts(bench) == [
        "sent: velocity_mm_per_s",
        "voltage_v varies as recorded (0 .. 3); a column that nothing sends need not be sent",
        "oil_degc stays at 40, as recorded",
    ]


@pytest.mark.parametrize("shape", [odd_multisine, slow_reversals, speed_runs, amplitude_sweep])
def test_what_is_washed_out_adds_up_to_little(shape: Callable[[Array], Array]) -> None:
    """Within +-1, and its sum within what a running mean of that length can leave."""
    wave, share = shape(15.0 / SAMPLES * np.arange(SAMPLES)), 0.1
    left = washed_out(wave, share)
    assert left.shape == wave.shape and np.abs(left).max() <= 1.0
    assert np.ptp(np.cumsum(left)) < share * SAMPLES
    assert abs(left.sum()) < 1e-6


def test_an_experiment_is_described_without_the_words_of_one_domain() -> None:
    """The menu serves an oven and a tank as it serves a shaft."""
    driven = [e for e in MENU if e.name not in ("aprbs-other-inertia",)]
    words = {word.strip(",:;") for e in driven for word in e.why.split()}
    assert words
    assert not words & {"dry", "sticks", "play", "torque", "compliance", "friction", "joint"}


OVEN = '''"""An oven: power, the temperature of the room and a flow of water."""
from pamid import Parameter, Port, Rig, State


class Oven(Rig):
    """A heated block in a room, cooled by water."""

    inputs = {"power_w": "W", "room_degf": "K", "flow_ml_per_min": "m3/s"}
    outputs = {"temperature_degc": "K"}
    noise = {"temperature_degc": 0.1}
    ports = {"block": Port("rate", "K/s")}
    states = (State("temperature", "K", 293.15),)
    parameters = (
        Parameter("capacity", 400.0, 100.0, 1000.0, "J/K", source="weighed"),
        Parameter("loss", 0.8, 0.1, 5.0, "W/K", source="sheet"),
    )
    period_s = 2.0
    EXCITED

    def rates(self, x, u, p, port):
        above = x.temperature - u.room_degf
        loss = (p.loss + 4.2e6 * u.flow_ml_per_min) * above
        return {"temperature": port("block", (u.power_w - loss) / p.capacity)}

    def measure(self, x, u, p, port):
        return {"temperature_degc": x.temperature}
'''


@pytest.mark.parametrize(
    ("excited", "sent"),
    [
        ("", ["power_w", "flow_ml_per_min"]),
        ('excited = {"power_w": 40.0}', ["power_w"]),
        ('excited = {"power_w": 40.0, "room_degf": 1.7}', ["power_w"]),
    ],
)
def test_nobody_commands_the_temperature_of_a_room(
    excited: str, sent: list[str], tmp_path: Path
) -> None:
    """What only drifts is not sent, whatever the rig states, nor what the rig does not state: it
    goes on as recorded, and so it is written."""
    (tmp_path / "oven.py").write_text(OVEN.replace("EXCITED", excited))
    t = 2.0 * np.arange(1500)
    random = np.random.default_rng(5)
    columns = {
        "power_w": 50.0 + aprbs(3000.0, 2.0, 40.0, (40.0, 240.0), seed=2),
        "room_degf": np.round(72.0 + 1.7 * np.sin(2e-3 * t) + 0.1 * random.normal(size=t.size), 1),
        "flow_ml_per_min": 20.0 * (np.sin(0.03 * t) > 0.8),
    }
    write_recording(tmp_path / "sent.csv", t, columns)
    named = str(tmp_path / "oven.py")
    made = simulate_virtual_rig(named, read_recording(tmp_path / "sent.csv"), (), {}, {}, 1.0, 3)
    write_recording(tmp_path / "rec.csv", t, made.columns, made.meta)
    evidence = split_recordings(rig_named(named), [read_recording(tmp_path / "rec.csv")], [])
    bench = bench_of(evidence)
    assert list(bench.driven) == sent
    columns = multisine(evidence).columns(bench)
    assert set(columns) == set(evidence.rig.inputs), "every input that the rig needs is there"
    room = columns["room_degf"]
    assert np.array_equal(room[:1000], evidence.recordings[0].signal("room_degf")[:1000])
    assert carried_texts(bench)[0] == f"sent: {', '.join(sent)}"
    assert any(text.startswith("room_degf varies as recorded (70") for text in carried_texts(bench))
