"""`pamid train-residual --on causes`: the residual of the model with its causes, and that model
with the network in it."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exported import compiled, ran
from identified_runs import fitted_run, joint_recording, put_network, random_network
from pamid_cli import frame
from synthetic_run import diagnosis_json
from train_command import said, train
from virtual_joint import record

import pamid
from pamid.base.files import write_atomically
from pamid.base.json_file import read_json, write_json
from pamid.base.units import from_si, split_column
from pamid.estimation.fit_files import fit_json, model_json, residual_csv, residual_table
from pamid.estimation.grey_box import GreyBox
from pamid.networks.correction.identified_model import (
    Identified,
    load_identified,
    simulate_identified,
)
from pamid.networks.correction.residual_data import derived, read_residual_data, residual_columns
from pamid.networks.elman import Elman
from pamid.networks.trained_network import load_network
from pamid.recording.recording import Recording, read_recording
from pamid.simulation.replay import channel_mae, replay_track

QUICK = ("--hidden", "2", "--iterations", "3")
ON_CAUSES = (*QUICK, "--on", "causes")
WORDS = "the model with its causes on recorded commands: coulomb-friction at joint"
Made = tuple[Path, GreyBox, GreyBox]
Copy = Callable[[], Path]


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Made:
    """A run as of a diagnosis that named the dry friction of a joint: the refitted model and the
    one with the friction; further a recording that the run has not seen."""
    folder = tmp_path_factory.mktemp("causes")
    recording = joint_recording(folder)
    record(folder / "fresh.csv", seconds=5.0, seed=5, effects=("coulomb-friction:torque_n_m=0.4",))
    plain = fitted_run(folder / "run", recording.path)
    cause = fitted_run(folder / "other", recording.path, ("coulomb-friction",))
    fit = fit_json(plain, 0, cause) | {"cause": model_json(cause.assembly, cause.fit)}
    write_json(folder / "run" / "fit.json", fit)
    diagnosis = json.dumps(diagnosis_json("explained"))
    (folder / "run" / "diagnosis.json").write_text(diagnosis, encoding="utf-8")
    write_atomically(folder / "run" / "residual.csv", residual_csv(plain, cause))
    return folder, plain, cause


@pytest.fixture
def run(made, tmp_path) -> Copy:
    """Fresh copies of that run."""
    numbers = iter(range(100))
    return lambda: Path(shutil.copytree(made[0] / "run", tmp_path / f"run{next(numbers)}"))


def outputs_of(model: Identified, recording: Recording) -> dict[str, np.ndarray]:
    """A model's outputs on the recorded command, in their units."""
    u = np.stack([recording.si("command"), np.zeros(len(recording))], axis=1)
    Y = simulate_identified(model, u)
    return {
        n: np.asarray(from_si(Y[:, i], split_column(n)[1])) for i, n in enumerate(model.outputs)
    }


def mean_error(table: dict[str, np.ndarray], kind: str, part: int) -> float:
    rows = (table["part"] == part) & (table["window"] >= 0)
    return float(np.abs(table["angle_deg"] - table[derived("angle_deg", kind)])[rows].mean())


# ---- the column over the fitted part --------------------


def test_the_model_with_the_causes_runs_over_the_fitted_part(made, run):
    """It is its replay there, as over what was held out, and no copy of the refitted model."""
    _, plain, cause = made
    table = residual_columns(run() / "residual.csv")
    e = cause.evidence
    tracks = e.tracks(cause.assembly)
    fitted = [
        replay_track(cause.assembly, cause.fit.p, t, cause.fit.stepping, e.noise) for t in tracks
    ]
    k = e.channels.index("angle_deg")
    for part, replays in ((0, fitted), (1, list(cause.held_out))):
        there = from_si(np.concatenate([r.model[:, k] for r in replays]), "deg")
        np.testing.assert_allclose(
            table["angle_cause_deg"][table["part"] == part], there, rtol=1e-8
        )
        assert mean_error(table, "cause", part) == pytest.approx(
            np.rad2deg(channel_mae(replays)[k]), rel=1e-6
        )
        assert mean_error(table, "cause", part) < 0.6 * mean_error(table, "refitted", part)
    header, _ = residual_table(plain)
    assert set(table) - set(header) == {derived(c, "cause") for c in e.channels}


# ---- training --------------------


def test_it_is_trained_on_what_the_causes_leave(run, capsys):
    folder = run()
    assert train(folder, *ON_CAUSES) == 0
    text, about = capsys.readouterr().out, read_json(folder / "network.json")
    assert (about["on"], about["model"]) == ("causes", "replay")
    assert about["target"] == f"measured angle_deg - {WORDS}" and WORDS in text
    assert [one["name"] for one in about["inputs"]][:2] == ["command", "angle_cause_deg"]
    assert any("A controller computed command" in note for note in about["notes"])
    table = residual_columns(folder / "residual.csv")
    target = table["angle_deg"] - table["angle_cause_deg"]
    trained_rows = np.concatenate(
        [np.r_[s.rows] for s in read_residual_data(folder, on="causes").of_part(0)]
    )
    assert about["output"]["low"] == pytest.approx(target[trained_rows].min())
    assert about["output"]["high"] == pytest.approx(target[trained_rows].max())
    for name, kind in (
        ("refitted", "refitted"),
        ("with_cause", "cause"),
        ("with_network", "network"),
    ):
        assert about["mae"]["angle_deg"][name] == pytest.approx(
            mean_error(table, kind, 1), rel=1e-6
        )
    assert read_json(folder / "run.json")["steps"][-1]["options"]["on"] == "causes"
    line = next(line for line in text.splitlines() if line.startswith("held-out mean"))
    assert line.split()[-5:] == ["refitted", "with", "causes", "at", "output"]


# ---- the model with both --------------------


@pytest.fixture(scope="module")
def trained(made, tmp_path_factory) -> Path:
    """The run with a network on the model with its causes."""
    folder = Path(shutil.copytree(made[0] / "run", tmp_path_factory.mktemp("trained") / "run"))
    assert train(folder, *ON_CAUSES) == 0
    return folder


def test_causes_and_network_go_together(made, trained):
    fresh = read_recording(made[0] / "fresh.csv")
    both, cause = load_identified(trained), load_identified(trained, which="cause")
    assert [a.label for a in both.effects] == ["coulomb-friction"] and both.network is not None
    assert cause.network is None and not both.notes
    network, found, before = (
        load_network(trained),
        outputs_of(both, fresh),
        outputs_of(cause, fresh),
    )
    signals = {"command": fresh.signal("command")}
    signals |= {derived(c, "cause"): values for c, values in before.items()}
    value = network.predict(signals)
    assert np.ptp(value) > 1e-3
    np.testing.assert_allclose(found["angle_deg"], before["angle_deg"] + value, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found["pressure_1_kpa"], before["pressure_1_kpa"], rtol=1e-11)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc")
def test_the_exported_form_holds_both(made, trained, tmp_path, capsys):
    fresh = read_recording(made[0] / "fresh.csv")
    words = ("export", str(trained), "--to", "c", "--output", str(tmp_path / "c"), "--json")
    assert frame.run(list(words)) == 0
    found = said(capsys)
    assert (found["effects"], found["network"]) == (["coulomb-friction"], "elman")
    assert found["notes"] == []
    model = load_identified(trained)
    u = np.stack([fresh.signal("command"), np.zeros(len(fresh))], axis=1)
    Y = ran(compiled(tmp_path / "c"), model.inputs, u)
    for i, (name, values) in enumerate(outputs_of(model, fresh).items()):
        assert np.abs(Y[:, i] - values).max() < 1e-9 * np.ptp(values), name


def test_the_score_judges_the_causes_with_their_network(made, run):
    folder = run()
    silent = random_network(Elman(1, 2), ("command",), "pressure_1_kpa", 2.0)
    silent = replace(silent, weights=0.0 * silent.weights)
    network = replace(silent, output_name="angle_deg")
    put_network(folder, network, on="causes")
    beside = folder / "networks" / "pressure_1_kpa"
    beside.mkdir(parents=True)
    put_network(beside, silent, on="refit")
    found = pamid.score(folder, made[0] / "fresh.csv")
    rows = {(r.comparison, r.channel): r.mae for r in found.recordings}
    for channel, model in (("angle_deg", "with_cause"), ("pressure_1_kpa", "refitted")):
        mae = rows["replay", channel]
        assert mae["with_network"] == pytest.approx(mae[model], rel=1e-9)
    assert rows["replay", "angle_deg"]["with_cause"] < rows["replay", "angle_deg"]["refitted"]
    assert "corrects the model with its causes" in found.to_dict()["notes"][0]
