"""`pamid score` and the table per recording: models of a run on recordings that it has not seen."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from identified_runs import SEEN, fitted_run, put_network, random_network
from pamid_cli import frame
from virtual_joint import KNOWN, record

from pamid.base.files import write_atomically
from pamid.estimation.fit_files import residual_csv
from pamid.networks.correction.identified_model import load_identified, record_identified
from pamid.networks.elman import Elman
from pamid.recording.recording import read_recording
from pamid.report.load import load_run

LIGHT = {"inertia_kg_m2": 0.014}
FRICTION = ("coulomb-friction:torque_n_m=0.4",)


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A run, fitted to a joint with dry friction, and recordings of it at two inertias that the run
    has not seen."""
    folder = tmp_path_factory.mktemp("score")
    record(folder / "rec.csv", effects=FRICTION)
    record(folder / "heavy.csv", seconds=6.0, seed=5, effects=FRICTION)
    record(folder / "light.csv", seconds=6.0, seed=6, effects=FRICTION, known=LIGHT)
    model = fitted_run(folder / "run", folder / "rec.csv")
    write_atomically(folder / "run" / "residual.csv", residual_csv(model))
    return folder


@pytest.fixture
def run(place, tmp_path) -> Path:
    return Path(shutil.copytree(place / "run", tmp_path / "run"))


def row(found: dict[str, Any], recording: str, comparison: str) -> dict[str, Any]:
    (one,) = [
        r
        for r in found["recordings"]
        if (r["recording"], r["comparison"], r["channel"]) == (recording, comparison, "angle_deg")
    ]
    return dict(one)


def asked(capsys: pytest.CaptureFixture[str], *words: str | Path) -> tuple[int, dict[str, Any]]:
    code = frame.run([*map(str, words), "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_a_row_per_recording_comparison_and_channel(place, capsys):
    files = (place / "heavy.csv", place / "light.csv")
    code, found = asked(capsys, "score", place / "run", *files)
    assert code == 0 and found["models"] == ["data_sheet", "refitted"]
    rows = [(r["recording"], r["comparison"]) for r in found["recordings"]]
    channels = load_run(place / "run").fit.channels  # type: ignore[union-attr]
    assert len(rows) == len(set(rows)) * len(channels)
    assert set(rows) == {(n, c) for n in ("heavy", "light") for c in ("replay", "loop")}
    for name, known in (("heavy", KNOWN), ("light", LIGHT)):
        one = row(found, name, "replay")
        assert one["known"] == pytest.approx(known)
        assert 0.0 < one["mae"]["refitted"] < one["mae"]["data_sheet"]
        assert one["rms"]["refitted"] > one["mae"]["refitted"]
    assert frame.run(["score", str(place / "run"), *map(str, files)]) == 0
    text = capsys.readouterr().out
    assert "inertia_kg_m2 0.014" in text and "closed loop" in text


def test_the_closed_loop_is_the_model_under_the_recordings_controller(place, capsys):
    _, found = asked(capsys, "score", place / "run", place / "light.csv")
    light = read_recording(place / "light.csv")
    sent = {"reference_deg": light.columns["reference_deg"]}
    made = record_identified(
        load_identified(place / "run"), replace(light, columns=sent), noise=0.0
    )
    gap = light.signal("angle_deg") - made.columns["angle_deg"]
    one = row(found, "light", "loop")
    assert one["mae"]["refitted"] == pytest.approx(np.abs(gap).mean(), rel=1e-9)
    assert one["rms"]["refitted"] == pytest.approx(np.sqrt((gap**2).mean()), rel=1e-9)
    assert one["samples"] == len(light)


@pytest.mark.parametrize("enters", ["output", {"port": "joint"}])
def test_a_network_is_judged_where_it_was_trained(enters, run, place, capsys):
    at_output = enters == "output"
    name = "angle_deg" if at_output else "missing_n_m"
    network = random_network(Elman(3, 2), SEEN, name, 2.0 if at_output else 0.2)
    put_network(run, network, enters=enters, parameters={})
    _, found = asked(capsys, "score", run, place / "heavy.csv")
    one = row(found, "heavy", "replay")
    assert found["models"] == ["data_sheet", "refitted", "with_network"]
    assert one["mae"]["with_network"] != pytest.approx(one["mae"]["refitted"], rel=1e-3)
    put_network(run, replace(network, weights=0.0 * network.weights), enters=enters, parameters={})
    _, found = asked(capsys, "score", run, place / "heavy.csv")
    one = row(found, "heavy", "replay")
    assert one["mae"]["with_network"] == pytest.approx(one["mae"]["refitted"], rel=1e-9)


def test_each_channel_is_judged_with_its_own_network(run, place, capsys):

    def errors(channel):
        code, found = asked(capsys, "score", run, place / "heavy.csv")
        assert code == 0
        (one,) = [
            dict(r["mae"])
            for r in found["recordings"]
            if (r["comparison"], r["channel"]) == ("replay", channel)
        ]
        return one

    angle = random_network(Elman(3, 2), SEEN, "angle_deg", 2.0)
    pressure = random_network(Elman(3, 2), SEEN, "pressure_1_kpa", 9.0)
    alone = {}
    for network in (pressure, angle):
        put_network(run, network)
        alone[network.output_name] = errors(network.output_name)
    beside = run / "networks" / "pressure_1_kpa"
    beside.mkdir(parents=True)
    put_network(beside, pressure)
    for channel, expected in alone.items():
        found = errors(channel)
        assert found == expected
        assert found["with_network"] != pytest.approx(found["refitted"], rel=1e-3)
    assert errors("pressure_2_kpa")["with_network"] == errors("pressure_2_kpa")["refitted"]


@pytest.mark.parametrize(
    "limit, code",
    [
        ("angle_deg > 0.1", 7),
        ("angle_deg < 1000", 7),
        ("angle_deg > 1000", 0),
        ("angle_dge > 1", 2),
    ],
)
def test_a_condition_on_an_error_decides_the_exit_code(limit, code, place, capsys):
    words = ["score", str(place / "run"), str(place / "light.csv"), "--fail-if", limit]
    assert frame.run(words) == code
    found = capsys.readouterr()
    assert "angle [deg]" in found.out and ("--fail-if" in found.err) == (code != 0)
