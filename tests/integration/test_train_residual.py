"""`pamid train-residual`: what it trains on, how it judges, and that nothing is lost or
half-written."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from train_command import said, train

from pamid.api.replications.demonstration import Withheld, write_demo_recording
from pamid.base.errors import FileError
from pamid.base.files import write_atomically
from pamid.base.json_file import read_json, write_json
from pamid.base.network_folders import channel_network_files, channel_networks
from pamid.base.run_folder import Run
from pamid.estimation.fit_files import fit_json, residual_csv
from pamid.estimation.grey_box import fit_model
from pamid.model.registry import rig_named
from pamid.networks.correction.residual_data import residual_columns
from pamid.networks.trained_network import load_network
from pamid.recording.recording import read_recording
from pamid.report.load import load_run
from pamid.report.recording_errors import held_out_errors
from pamid.simulation.data_split import split_recordings

LOOP = [
    "reference_deg",
    "command_loop",
    "angle_loop_deg",
    "velocity_loop_deg_per_s",
    "acceleration_loop_deg_per_s2",
]
RESULTS = ("network.json", "network.npz", "trace.csv", "residual.csv")
QUICK = ("--hidden", "3", "--iterations", "4")
Copy = Callable[[], Path]


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    """15 s of a virtual joint with a dead band of its valves and a damping that is off."""
    withheld = Withheld(
        "valve-dead-band",
        "valve-dead-band",
        "valve-dead-band:dead_band=0.08",
        {"damping_m2_s": 1.2},
    )
    return write_demo_recording(
        tmp_path_factory.mktemp("recording"), withheld, seed=3, duration_s=15.0
    )


@pytest.fixture(scope="module")
def fitted(recording, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("fitted") / "run"
    run = Run.create(folder, command="fit", seed=0, inputs=[recording])
    model = fit_model(split_recordings(rig_named("one-dof"), [read_recording(recording)], []))
    write_json(run.path("fit.json"), fit_json(model, 0))
    write_atomically(run.path("residual.csv"), residual_csv(model))
    run.finish()
    return folder


@pytest.fixture
def run(fitted, tmp_path) -> Copy:
    """Fresh copies of the fitted run."""
    numbers = iter(range(100))
    return lambda: Path(shutil.copytree(fitted, tmp_path / f"run{next(numbers)}"))


def steps(folder: Path) -> list[dict[str, Any]]:
    return list(read_json(folder / "run.json")["steps"])


def test_the_first_papers_network(run):
    """The gain is judged on the fitted part. Ten seconds determine few of 171 weights, so that the
    held-out error hangs on the last bit: from one seed it was 53 % or 99 %. What 200 s give stands
    in docs/measured/papers.md."""
    folder = run()
    words = ["train-residual", str(folder), "--iterations", "40", "--seed", "2", "--json"]
    command = [sys.executable, "-m", "pamid_cli", *words]
    found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    assert found == read_json(folder / "network.json")
    assert (found["kind"], found["n_weights"], found["model"]) == ("elman", 171, "loop")
    assert [one["name"] for one in found["inputs"]] == LOOP
    table = residual_columns(folder / "residual.csv")
    held = table["part"] == 1
    late = held & (table["time_s"] >= table["time_s"][held][0] + 1.0 - 1e-9)
    for ending, rows in (("", held), ("_after_1_s", late)):
        for name, column in (("refitted", "angle_loop_deg"), ("with_network", "angle_network_deg")):
            error = np.abs(table["angle_deg"] - table[column])[rows].mean()
            assert found["mae"]["angle_deg"][name + ending] == pytest.approx(error, rel=1e-6)
    gained = [
        np.abs(table["angle_deg"] - table[column])[~held].mean()
        for column in ("angle_network_deg", "angle_loop_deg")
    ]
    assert gained[0] < 0.5 * gained[1]
    target = (table["angle_deg"] - table["angle_loop_deg"])[~held]
    assert (found["output"]["low"], found["output"]["high"]) == pytest.approx(
        (target.min(), target.max())
    )
    trace = np.loadtxt(folder / "trace.csv", delimiter=",", skiprows=1)
    assert len(trace) == 41 and trace[-1, 1] == found["training"]["mse"] < trace[0, 1]
    one = load_network(folder).predict({name: table[name][held] for name in LOOP})
    np.testing.assert_allclose(
        table["angle_network_deg"][held], table["angle_loop_deg"][held] + one, rtol=1e-7
    )
    (step,) = steps(folder)
    assert step["ended"] and step["outcome"] == "done" and len(step["inputs"]) == 2


def test_as_in_the_paper(run, capsys):
    folder = run()
    assert train(folder, *QUICK, "--as-in-paper", "--mu", "0.02", "--mu-increase", "8") == 0
    assert "plain steps as in the paper" in capsys.readouterr().out
    assert read_json(folder / "network.json")["training"]["plain"] is True
    (options,) = [one["options"] for one in steps(folder)]
    assert options["as_in_paper"] is True and options["damping"]["decrease"] == 0.1
    rows = np.genfromtxt(folder / "trace.csv", delimiter=",", names=True)
    assert rows["mu"][0] == 0.02
    np.testing.assert_allclose(
        rows["mu"][1:] / rows["mu"][:-1], 0.1 * 8.0 ** (rows["trials"][1:] - 1.0)
    )
    capsys.readouterr()
    assert train(folder, *QUICK, "--mu-increase", "0.5", "--json") == 2
    assert "increase must be above 1" in said(capsys)["message"]


@pytest.mark.parametrize(
    ("options", "sizes", "words"),
    [
        (
            ("--network", "anfis"),
            {"inputs": 5, "sets": 2, "shape": "gaussian"},
            "anfis 2x2x2x2x2 = 32 rules, 212 weights",
        ),
        (
            ("--network", "anfis", "--inputs", "angle_loop_deg,command_loop", "--sets", "3"),
            {"inputs": 2, "sets": 3, "shape": "gaussian"},
            "anfis 3x3 = 9 rules, 39 weights",
        ),
        (
            ("--network", "narx", "--hidden", "3"),
            {"inputs": 5, "hidden": 3, "input_lags": 2, "output_lags": 2, "stride": 10},
            "narx 5-3-1 seeing 2 earlier inputs and 2 earlier outputs, 10 samples apart, 58 "
            "weights",
        ),
    ],
)
def test_every_network_is_trained(run, capsys, options, sizes, words):
    folder = run()
    assert train(folder, *options, "--iterations", "4") == 0
    about = read_json(folder / "network.json")
    assert about["kind"] == options[1] and about["sizes"] == sizes
    assert capsys.readouterr().out.startswith(words)
    table = residual_columns(folder / "residual.csv")
    held = table["part"] == 1
    values = load_network(folder).predict({name: x[held] for name, x in table.items()})
    np.testing.assert_allclose(
        table["angle_network_deg"][held], table["angle_loop_deg"][held] + values, rtol=1e-7
    )
    trace = np.loadtxt(folder / "trace.csv", delimiter=",", skiprows=1)
    assert trace[-1, 1] < trace[0, 1]


@pytest.mark.parametrize("network", ["elman", "narx"])
def test_torch_trains_the_network_of_the_compiled_kernels(run, network):
    compiled, by_torch = run(), run()
    options = ("--network", network, *QUICK, "--starts", "2")
    assert train(compiled, *options) == train(by_torch, *options, "--device", "cpu") == 0
    ours, theirs = (read_json(folder / "network.json") for folder in (compiled, by_torch))
    assert theirs["training"]["starts_mse"] == pytest.approx(
        ours["training"]["starts_mse"], rel=0.02
    )
    errors = [about["mae"]["angle_deg"]["with_network"] for about in (theirs, ours)]
    assert errors[0] == pytest.approx(errors[1], rel=0.02)


def test_same_run_and_seed_same_bytes(run):
    one, other = run(), run()
    before = (one / "residual.csv").read_text().splitlines()
    assert train(one, *QUICK) == train(other, *QUICK) == 0
    for name in (*RESULTS, "checkpoint.npz"):
        assert (one / name).read_bytes() == (other / name).read_bytes(), name
    assert [
        line.rsplit(",", 1)[0] for line in (one / "residual.csv").read_text().splitlines()
    ] == before
    # trained again: in the place of the first network
    assert train(one, *QUICK, "--seed", "1") == 0
    assert (one / "network.npz").read_bytes() != (other / "network.npz").read_bytes()
    assert list(residual_columns(one / "residual.csv")) == list(
        residual_columns(other / "residual.csv")
    )
    assert train(other, *QUICK, "--channel", "pressure_1_kpa") == 0
    columns = list(residual_columns(other / "residual.csv"))
    assert {"pressure_1_network_kpa", "angle_network_deg"} <= set(columns)


def test_the_held_out_part_is_never_trained_on(run):
    one, other = run(), run()
    names, *lines = (other / "residual.csv").read_text().splitlines()
    place, part = names.split(",").index("angle_deg"), names.split(",").index("part")
    for i, line in enumerate(lines):
        cells = line.split(",")
        if cells[part] == "1":
            cells[place] = f"{float(cells[place]) + 5.0:.9g}"
            lines[i] = ",".join(cells)
    (other / "residual.csv").write_text("\n".join([names, *lines]) + "\n")
    assert train(one, *QUICK) == train(other, *QUICK) == 0
    assert (one / "network.npz").read_bytes() == (other / "network.npz").read_bytes()
    errors = [read_json(folder / "network.json")["mae"]["angle_deg"] for folder in (one, other)]
    assert errors[1]["with_network"] > errors[0]["with_network"] + 4.0


# ---- several networks in a run --------------------


def test_networks_of_several_channels_live_side_by_side(run, capsys):
    """The one trained last is the run's, the others lie beside it with their columns; each is the
    network that it would be alone, and one of a channel that has one takes its place."""
    folder, alone = run(), run()
    channels = ("angle_deg", "pressure_1_kpa", "pressure_2_kpa")
    for channel in channels:
        assert train(folder, *QUICK, "--channel", channel) == 0
    assert train(alone, *QUICK, "--channel", "pressure_1_kpa") == 0
    beside = channel_networks(folder)
    assert list(beside) == ["angle_deg", "pressure_1_kpa"]
    assert load_network(folder).output_name == "pressure_2_kpa"
    for name in ("network.npz", "network.json", "trace.csv"):
        assert (beside["pressure_1_kpa"] / name).read_bytes() == (alone / name).read_bytes()
    columns = residual_columns(folder / "residual.csv")
    assert {f"{c.rpartition('_')[0]}_network_{c.rpartition('_')[2]}" for c in channels} <= set(
        columns
    )
    known, lonely = load_run(folder), load_run(alone)
    assert set(known.network_errors(in_loop=False)) == {"pressure_1_kpa", "pressure_2_kpa"}
    assert set(known.network_errors(in_loop=True)) == {"angle_deg"}
    assert (
        known.network_errors(in_loop=False)["pressure_1_kpa"]
        == lonely.network_errors(in_loop=False)["pressure_1_kpa"]
    )
    assert known.residual is not None and known.residual.of("angle_deg", "network") is None
    assert known.residual.of("angle_deg", "loop_network") is not None
    assert known.residual.of("pressure_1_kpa", "network") is not None
    rows = {row.channel: row for row in held_out_errors(known) if "with_network" in row.mae}
    assert set(rows) == set(channels)
    assert train(folder, *QUICK, "--channel", "angle_deg", "--seed", "5") == 0
    assert list(channel_networks(folder)) == ["pressure_1_kpa", "pressure_2_kpa"]
    assert load_network(folder).output_name == "angle_deg"
    listed = read_json(folder / "run.json")["files"]
    assert all((folder / name).is_file() for name in listed if name.startswith("networks/"))
    assert not [name for name in listed if name.startswith("networks/angle_deg/")]
    assert train(folder, *QUICK, "--at", "joint") == 0  # moves every channel: stays alone
    assert channel_networks(folder) == {}


@pytest.mark.parametrize("name", ["../up", "a/b", "", ".", "a b"])
def test_no_other_folder_is_written_whatever_a_channel_is_called(name):
    with pytest.raises(FileError, match="not a channel name"):
        channel_network_files(name)
