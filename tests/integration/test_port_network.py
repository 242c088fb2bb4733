"""`pamid train-residual --port PORT`: what is missing at a port, a network for it, and its value
inside the equations."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from train_command import train

import pamid.networks.correction.port_network as port_network
from pamid.api.replications.demonstration import Withheld, write_demo_recording
from pamid.base.files import write_atomically
from pamid.base.json_file import read_json, write_json
from pamid.base.run_folder import Run
from pamid.estimation.fit_files import fit_json, residual_csv
from pamid.estimation.grey_box import GreyBox, fit_model
from pamid.model.registry import rig_named
from pamid.networks.correction.port_network import (
    Entry,
    missing_at,
    named_values,
    replayed_with,
)
from pamid.recording.recording import read_recording
from pamid.simulation.data_split import split_recordings
from pamid.simulation.replay import channel_mae, replay_track

RESULTS = ("network.json", "network.npz", "trace.csv", "residual.csv")
QUICK = ("--hidden", "3", "--iterations", "4")
Copy = Callable[[], Path]


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> tuple[Path, GreyBox]:
    """A folder with a run fitted to 20 s of a virtual joint whose valves have a dead band, and its
    model."""
    folder = tmp_path_factory.mktemp("joint")
    withheld = Withheld("valve-dead-band", "valve-dead-band", "valve-dead-band:dead_band=0.08", {})
    recording = write_demo_recording(folder, withheld, seed=3, duration_s=20.0)
    run = Run.create(
        folder / "run", command="fit", seed=0, inputs=[recording, recording.with_suffix(".toml")]
    )
    model = fit_model(split_recordings(rig_named("one-dof"), [read_recording(recording)], []))
    write_json(run.path("fit.json"), fit_json(model, 0))
    write_atomically(run.path("residual.csv"), residual_csv(model))
    run.finish()
    return folder, model


@pytest.fixture
def run(place, tmp_path) -> Copy:
    """Fresh copies of the fitted run."""
    numbers = iter(range(100))
    return lambda: Path(shutil.copytree(place[0] / "run", tmp_path / f"run{next(numbers)}"))


def test_what_is_missing_there_brings_the_model_to_its_data(place):
    model, entry = place[1], Entry("command", "")
    fitted = tuple(
        replay_track(model.assembly, model.fit.p, t, model.fit.stepping, model.evidence.noise)
        for t in model.evidence.tracks(model.assembly)
    )
    missing, p = missing_at(model, fitted, entry)
    held = np.zeros(len(model.held_out[0].track))
    before = channel_mae(list(fitted))

    def error(values, p=p):
        added = np.concatenate([values, held])
        return channel_mae(replayed_with(model, entry, p, added)[:1])

    np.testing.assert_allclose(error(0.0 * missing, model.fit.p), before, rtol=1e-9)
    assert (error(missing) < 0.25 * before).all() and error(missing)[0] < 0.1 * before[0]
    assert (error(-missing) > before).all() and error(np.roll(missing, 100))[0] > 3.0 * error(
        missing
    )[0]
    np.testing.assert_allclose(model.assembly.values(named_values(model, p)), p, rtol=1e-12)
    # what a dead band takes away just beyond it: about its width (0.08), against the command
    command = model.evidence.tracks(model.assembly)[0].u[:, 0]
    taken = -missing * np.sign(command)
    assert 0.04 < np.median(taken[(np.abs(command) > 0.08) & (np.abs(command) < 0.3)]) < 0.12


def test_beside_it_stands_the_network_at_the_output(run, capsys):
    one, other = run(), run()
    names, *lines = (other / "residual.csv").read_text().splitlines()
    keep = [i for i, n in enumerate(names.split(",")) if "loop" not in n and n != "reference_deg"]
    (other / "residual.csv").write_text(
        "\n".join(
            ",".join(row.split(",")[i] for i in keep)
            # so the replay is corrected
            for row in (names, *lines)
        )
        + "\n"
    )
    assert train(one, *QUICK, "--at", "command") == train(other, *QUICK) == 0
    here, there = (
        read_json(folder / "network.json")["mae"]["angle_deg"] for folder in (one, other)
    )
    assert here["with_output_network"] == there["with_network"] != here["with_network"]


@pytest.mark.slow
def test_same_bytes_and_resuming(run):
    one, other, third = run(), run(), run()
    options = ("--hidden", "3", "--at", "joint", "--iterations")
    assert (
        train(one, *options, "4", "--jobs", "2") == train(other, *options, "4", "--jobs", "1") == 0
    )
    assert train(third, *options, "2") == train(third, *options, "4", "--resume") == 0
    for name in RESULTS:
        assert (
            (one / name).read_bytes() == (other / name).read_bytes() == (third / name).read_bytes()
        ), name


@pytest.mark.slow
def test_interrupted_beside_it_keeps_what_it_has(run, monkeypatch, capsys):
    folder = run()

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(port_network, "train_correction", interrupted)
        assert train(folder, *QUICK, "--at", "joint") == 130
    about = read_json(folder / "network.json")
    assert (
        "with_output_network" not in about["mae"]["angle_deg"]
        and "at joint" in capsys.readouterr().err
    )
    assert read_json(folder / "run.json")["steps"][-1]["outcome"] == "interrupted"
    assert train(folder, *QUICK, "--at", "joint", "--resume") == 0
    assert "with_output_network" in read_json(folder / "network.json")["mae"]["angle_deg"]
