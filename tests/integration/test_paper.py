"""`pamid reproduce-paper`: the twin misses what the paper's model missed, and the table says what
it is."""

import json
from dataclasses import replace

import pytest
from pamid_cli import frame

from pamid.api.replications.joint_twin import TWIN_INERTIAS, Twin, analytic_loop, calibration
from pamid.api.replications.papers import joint as paper
from pamid.api.replications.papers.joint import text as table_text
from pamid.base.json_file import read_json
from pamid.base.metrics import mae
from pamid.model.registry import effects
from pamid.recording.recording import read_recording

SMALL = "reproduce-paper --quick --seconds 12 --iterations 4 --starts 2 --jobs 1 --json"
WRITTEN = (
    "run.json",
    "training.csv",
    "training.toml",
    "steps-6.4-jn.csv",
    "steps-jn.csv",
    "figures/steps.png",
    "figures/responses.png",
    "figures/pressures.png",
    "figures/excitation.png",
    "figures/network-training.png",
    "figures/force-surface.png",
    "network.json",
    "network.npz",
    "trace.csv",
    "checkpoint.npz",
    "diagnosis.json",
    "paper.json",
)


@pytest.fixture
def few_effects(monkeypatch) -> None:
    """A catalogue small enough for a test."""
    names = ("two-mass", "coulomb-friction")
    monkeypatch.setattr(paper, "effects", lambda: {name: effects()[name] for name in names})


def test_the_analytic_model_misses_the_twin_by_the_published_errors():
    found = calibration(Twin())
    assert found == pytest.approx({"6.4 Jn": 1.2890, "Jn": 1.1706}, abs=0.02)
    for case, published in paper.PUBLISHED["analytic model"].items():
        assert found[case] == pytest.approx(published, abs=0.02)


@pytest.mark.slow
def test_a_quick_run(few_effects, tmp_path, capsys):
    folder = tmp_path / "paper"
    assert frame.run([*SMALL.split(), "--output", str(folder)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["schema"] == "pamid.paper/1" and found["quick"]
    assert [name for name in WRITTEN if not (folder / name).is_file()] == []
    rows = {row["model"]: row for row in found["rows"]}
    assert list(rows)[:3] == ["analytic model", "refitted model", "analytic model + Elman"]
    for row in found["rows"]:
        for case, error in row["mae"].items():
            assert row["improvement"][case] == pytest.approx(
                1.0 - error / rows["analytic model"]["mae"][case]
            )
    for case, name in (("6.4 Jn", "steps-6.4-jn.csv"), ("Jn", "steps-jn.csv")):
        recording = read_recording(folder / name)
        assert recording.known["inertia_kg_m2"] == pytest.approx(TWIN_INERTIAS[case])
        model = analytic_loop(recording)["angle_loop_deg"]
        assert rows["analytic model"]["mae"][case] == pytest.approx(
            mae(recording.signal("angle_deg"), model)
        )
        assert rows["analytic model"]["mae_after_1_s"][case] == pytest.approx(
            mae(recording.signal("angle_deg")[334:], model[334:])
        )
    assert found["training"]["iterations"] == 4 and len(found["training"]["starts_mse"]) == 2
    assert found["diagnosis"]["verdict"] == read_json(folder / "diagnosis.json")["verdict"]
    untimed = [{k: v for k, v in row.items() if k != "seconds"} for row in found["rows"]]
    assert {**found, "rows": untimed} == read_json(folder / "paper.json")
    text = table_text(found)
    assert text.startswith("QUICK") and "not the authors' rig" in text
    assert "1.94 %" in text and "0.9793" in text
    assert frame.run([*SMALL.split(), "--output", str(folder)]) == 3  # a folder that is taken
    assert "--overwrite" in json.loads(capsys.readouterr().out)["hint"]


def test_an_interrupted_training_is_kept_and_goes_on(few_effects, tmp_path, monkeypatch, capsys):
    def stopped(residual, *, options):
        def report(step, start):
            options.progress(step, start)
            if step.iteration == 2:
                raise KeyboardInterrupt

        return unpatched(residual, options=replace(options, progress=report))

    def stop(*given):
        raise KeyboardInterrupt

    unpatched = paper.train_correction
    folder = tmp_path / "paper"
    with monkeypatch.context() as patch:
        patch.setattr(paper, "train_correction", stopped)
        assert frame.run([*SMALL.split(), "--output", str(folder)]) == 130
    assert json.loads(capsys.readouterr().out)["code"] == "interrupted"
    assert read_json(folder / "run.json")["outcome"] == "interrupted"
    assert read_json(folder / "network.json")["training"]["iterations"] == 2
    assert (folder / "checkpoint.npz").is_file() and not (folder / "paper.json").exists()
    monkeypatch.setattr(paper, "explain", stop)
    assert frame.run([*SMALL.split(), "--output", str(folder), "--resume"]) == 130
    whole = tmp_path / "whole"
    assert frame.run([*SMALL.split(), "--output", str(whole)]) == 130
    assert (folder / "network.npz").read_bytes() == (whole / "network.npz").read_bytes()
