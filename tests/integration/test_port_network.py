"""`pamid train-residual --port PORT`: what is missing at a port, a network for it, and its value
inside the equations."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pamid_cli import frame
from train_command import said, train

import pamid.correction.port_network as port_network
from pamid.base.errors import UsageError
from pamid.base.files import write_atomically
from pamid.base.json_file import read_json, write_json
from pamid.base.run_folder import Run
from pamid.base.units import from_si
from pamid.correction.port_network import (
    Corrected,
    Entry,
    entry_of,
    missing_at,
    named_values,
    origin_of,
    train_at_port,
)
from pamid.correction.residual_data import read_columns, read_residual_data
from pamid.estimation.fit_files import fit_json, residual_csv
from pamid.estimation.grey_box import GreyBox, fit_model
from pamid.model.registry import rig_named
from pamid.networks.trained_network import load_network
from pamid.recording.recording import read_recording
from pamid.replications.demonstration import Withheld, write_demo_recording
from pamid.simulation.data_split import split_recordings
from pamid.simulation.replay import channel_mae, replay_track
from pamid.symbolic.expression import symbols

RESULTS = ("network.json", "network.npz", "trace.csv", "residual.csv")
QUICK = ("--hidden", "3", "--iterations", "4")
Copy = Callable[[], Path]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, GreyBox]:
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
def run(place: tuple[Path, GreyBox], tmp_path: Path) -> Copy:
    """Fresh copies of the fitted run."""
    numbers = iter(range(100))
    return lambda: Path(shutil.copytree(place[0] / "run", tmp_path / f"run{next(numbers)}"))


def test_what_is_missing_there_brings_the_model_to_its_data(place: tuple[Path, GreyBox]) -> None:
    """Added at the port where it was found, with its sign, unit and place in time, and no other
    way."""
    model, entry = place[1], Entry("command", "")
    fitted = tuple(
        replay_track(model.assembly, model.fit.p, t, model.fit.stepping, model.evidence.noise)
        for t in model.evidence.tracks(model.assembly)
    )
    missing, p = missing_at(model, fitted, entry)
    held = np.zeros(len(model.held_out[0].track))
    before = channel_mae(list(fitted))

    def error(values: np.ndarray, p: np.ndarray = p) -> np.ndarray:
        return channel_mae(Corrected(model, entry, p).replayed(np.concatenate([values, held]))[:1])

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


def test_one_place_of_a_port(place: tuple[Path, GreyBox]) -> None:
    model = place[1]
    rig = model.evidence.rig
    assert entry_of(rig, "joint") == Entry("joint", "") and entry_of(rig, "muscle_2") == Entry(
        "muscle", "2"
    )
    with pytest.raises(UsageError, match="muscle_1 or muscle_2"):
        entry_of(rig, "muscle")
    outputs = Corrected(
        model, entry_of(rig, "pressure_sensor_2"), model.fit.p
    ).assembly.traced.outputs
    touched = [
        name for name, root in outputs.items() if ("input", port_network.ADDED) in symbols([root])
    ]
    assert touched == ["pressure_2_kpa"]


def test_figures_files_and_text(run: Copy, capsys: pytest.CaptureFixture[str]) -> None:
    folder = run()
    before = (folder / "residual.csv").read_text().splitlines()
    # of seeds 0 to 2 one leaves a quarter, one a third, and one makes it worse
    assert train(folder, "--at", "command", "--iterations", "15", "--seed", "1") == 0
    text, about, fit = (
        capsys.readouterr().out,
        read_json(folder / "network.json"),
        read_json(folder / "fit.json"),
    )
    assert about["enters"] == {"port": "command"} and about["model"] == "replay"
    assert set(fit["parameters"]) < set(about["parameters"])
    assert about["output"]["name"] == "missing" and "missing at command" in about["target"]
    assert "at output" in text and "at command" in text and "moves every channel" in text
    table = read_columns(folder / "residual.csv")
    rows = (table["part"] == 1) & (table["window"] >= 0)
    assert list(about["mae"]) == fit["channels"]
    for channel, errors in about["mae"].items():
        stem, _, unit = channel.rpartition("_")
        for key, kind in (("refitted", "refitted"), ("with_network", "network")):
            error = np.abs(table[channel] - table[f"{stem}_{kind}_{unit}"])[rows].mean()
            assert errors[key] == pytest.approx(error, rel=1e-6)
        assert errors["refitted"] == pytest.approx(fit["mae"][channel]["refitted"], rel=1e-6)
        assert ("with_output_network" in errors) == (channel == "angle_deg")
    # where the dead band is, a correction helps every channel on what it was not trained on, its
    # own more than there
    assert all(
        errors["with_network"] < 0.6 * errors["refitted"] for errors in about["mae"].values()
    )
    assert (
        about["mae"]["angle_deg"]["with_network"] < about["mae"]["angle_deg"]["with_output_network"]
    )
    after = (folder / "residual.csv").read_text().splitlines()
    assert all(new.startswith(f"{old},") for old, new in zip(before, after, strict=True))
    leftover = read_residual_data(folder, replay=True)
    held = leftover.of_part(1)[0]
    values = load_network(folder).predict(leftover.signals(held))
    assert np.isfinite(values).all() and np.ptp(values) > 0.0
    # trained again at the output: the columns of the other channels go
    assert train(folder, *QUICK) == 0
    assert read_json(folder / "network.json")["enters"] == "output"
    assert [n for n in read_columns(folder / "residual.csv") if "network" in n] == [
        "angle_network_deg"
    ]


def test_beside_it_stands_the_network_at_the_output(
    run: Copy, capsys: pytest.CaptureFixture[str]
) -> None:
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
def test_same_bytes_and_resuming(run: Copy) -> None:
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
def test_interrupted_beside_it_keeps_what_it_has(
    run: Copy, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = run()

    def interrupted(*_: Any, **__: Any) -> None:
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


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (("--at", "jont"), 2, "Did you mean 'joint'"),
        (("--at", "valve"), 2, "valve_1 or valve_2"),
        (("--rig", "one-dof"), 2, "--rig belongs to --port PORT"),
        (("--at", "joint", "--channel", "angel_deg"), 2, "Did you mean 'angle_deg'"),
    ],
)
def test_requests_that_are_refused(
    run: Copy, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], code: int, words: str
) -> None:
    folder = run()
    assert train(folder, *options, "--json") == code
    found = said(capsys)
    assert words in found["message"] + found["hint"]
    assert not (folder / "network.json").exists() and read_json(folder / "run.json")["steps"] == []


def _edited(folder: Path, change: Callable[[dict[str, Any], dict[str, Any]], None]) -> None:
    """Change fit.json and run.json."""
    fit, record = read_json(folder / "fit.json"), read_json(folder / "run.json")
    change(fit, record)
    for name, content in (("fit", fit), ("run", record)):
        (folder / f"{name}.json").write_text(json.dumps(content), encoding="utf-8")


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (lambda fit, _: fit["recordings"][0].update(path="gone.csv"), 3, "gone.csv, to which"),
        (lambda fit, _: fit["recordings"][0].update(sha256="0" * 64), 3, "was changed since"),
        (
            lambda _, record: record["inputs"][1].update(sha256="0" * 64),
            3,
            ".toml was changed since",
        ),
        (lambda fit, _: fit.pop("recordings"), 3, "period_s of every recording"),
        (lambda _, record: record["options"].update(rig="my/rig.py"), 3, "add --rig my/rig.py"),
        (lambda fit, _: fit["model"]["values"].update(viscous=0.5), 4, "they differ in angle_deg"),
        (lambda fit, _: fit["model"].update(effects=["no-such-effect"]), 3, "no-such-effect"),
        (lambda fit, _: fit.pop("model"), 3, "does not tell"),
    ],
)
def test_a_run_that_cannot_be_made_again_is_refused(
    run: Copy,
    capsys: pytest.CaptureFixture[str],
    change: Callable[[dict[str, Any], dict[str, Any]], None],
    code: int,
    words: str,
) -> None:
    folder = run()
    _edited(folder, change)
    assert train(folder, *QUICK, "--at", "joint", "--json") == code
    found = said(capsys)
    assert words in found["message"] + found["hint"]
    assert all(step["ended"] for step in read_json(folder / "run.json")["steps"])


def test_effects_and_held_out_recordings_are_remembered(tmp_path: Path) -> None:
    paths = []
    for seed in (3, 4):
        (tmp_path / str(seed)).mkdir()
        paths.append(
            write_demo_recording(
                tmp_path / str(seed),
                Withheld("coulomb-friction", "friction", "coulomb-friction", {}),
                seed=seed,
                duration_s=4.0,
            )
        )
    assert frame.run(
        [
            "fit",
            str(paths[0]),
            "--held-out",
            str(paths[1]),
            "--effect",
            "coulomb-friction@joint",
            "--output",
            str(tmp_path / "run"),
        ]
    ) in (0, 5)
    origin = origin_of(tmp_path / "run")
    assert [a.label for a in origin.assembly.attachments] == ["coulomb-friction@joint"]
    assert (
        [s.recording.path for s in origin.evidence.fit],
        [s.recording.path for s in origin.evidence.held_out],
    ) == ([paths[0]], [paths[1]])
    table = read_columns(tmp_path / "run" / "residual.csv")
    replayed = from_si(np.concatenate([r.model[:, 0] for r in origin.model().held_out]), "deg")
    np.testing.assert_allclose(replayed, table["angle_refitted_deg"][table["part"] == 1], rtol=1e-7)


def test_values_go_to_the_rows_of_their_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two recordings that are each divided in time, fitted rows do not all come first."""
    withheld = Withheld("coulomb-friction", "friction", "coulomb-friction", {})
    paths = []
    for seed in (3, 4):
        (tmp_path / str(seed)).mkdir()
        paths.append(
            write_demo_recording(tmp_path / str(seed), withheld, seed=seed, duration_s=6.0)
        )
    folder = tmp_path / "run"
    assert frame.run(["fit", *map(str, paths), "--output", str(folder)]) in (0, 5)
    residual = read_residual_data(folder, replay=True)
    model, targets = origin_of(folder).model(), []
    number = {id(r): k for k, r in enumerate(model.evidence.recordings)}
    told = [1e3 * number[id(s.recording)] + s.recording.time[s.start : s.stop]
            for s in model.evidence.fit]  # fmt: skip

    def silent(leftover: Any, name: str, target: np.ndarray, **_: Any) -> Any:
        targets.append(target)
        return None, SimpleNamespace(why="interrupted"), np.zeros(len(target))

    monkeypatch.setattr(port_network, "train_network", silent)
    monkeypatch.setattr(port_network, "missing_at", lambda *_: (np.concatenate(told), model.fit.p))
    found = train_at_port(residual, model, Entry("command", ""))
    table = residual.columns
    fitted = table["part"] == 0
    assert np.diff(fitted.astype(int)).max() > 0  # the second recording's fitted part comes later
    np.testing.assert_allclose(
        targets[0], np.where(fitted, 1e3 * table["recording"] + table["time_s"], 0.0), rtol=1e-9
    )
    for channel, values in found.outputs.items():
        gap = np.abs(values - residual.models(channel)["refitted"])
        assert gap.max() < 1e-5 * np.ptp(values)
