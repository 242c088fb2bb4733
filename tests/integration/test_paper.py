"""`pamid reproduce-paper`: the twin misses what the paper's model missed, and the table says what
it is."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pamid_cli import frame

from pamid.base.json_file import read_json
from pamid.base.metrics import mae
from pamid.excitation.aprbs import aprbs
from pamid.model.assembly import Assembly
from pamid.model.registry import effects, rig_named
from pamid.networks.elman import Elman
from pamid.recording.recording import read_recording
from pamid.replications import joint_paper as paper
from pamid.replications.joint_twin import (
    AMPLITUDE_DEG,
    HOLD_S,
    PERIOD_S,
    TWIN_INERTIAS,
    TWIN_RIG,
    Twin,
    analytic_loop,
    calibration,
    excitation,
    step_reference,
)
from pamid.replications.papers.joint import text as table_text
from pamid.simulation.virtual_rig import attach_specs

SMALL = (
    "reproduce-paper",
    "--quick",
    "--seconds",
    "12",
    "--iterations",
    "4",
    "--starts",
    "2",
    "--jobs",
    "1",
    "--json",
)
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
def few_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    """A catalogue small enough for a test."""
    names = ("two-mass", "coulomb-friction")
    monkeypatch.setattr(paper, "effects", lambda: {name: effects()[name] for name in names})


def test_the_analytic_model_misses_the_twin_by_the_published_errors() -> None:
    found = calibration(Twin())
    assert found == pytest.approx({"6.4 Jn": 1.2890, "Jn": 1.1706}, abs=0.02)
    for case, published in paper.PUBLISHED["analytic model"].items():
        assert found[case] == pytest.approx(published, abs=0.02)


def test_the_twin_settles_under_random_steps() -> None:
    reference = aprbs(30.0, PERIOD_S, AMPLITUDE_DEG, HOLD_S, seed=1)
    inertia = TWIN_INERTIAS["6.4 Jn"]
    known = replace(excitation(reference), known={"inertia_kg_m2": inertia})
    model = analytic_loop(known)["angle_loop_deg"]

    def error(twin: Twin) -> float:
        return mae(twin.record(reference, inertia)["columns"]["angle_deg"], model)

    assert error(Twin()) < 1.5
    assert error(replace(Twin(), damping=0.138)) > 3.0  # why the twin's damping is not lower


def test_the_steps_are_those_of_the_paper() -> None:
    steps = step_reference()
    assert len(steps) == 3334 and len(steps) * PERIOD_S == pytest.approx(10.002)
    changes = np.flatnonzero(np.diff(steps)) + 1
    assert changes * PERIOD_S == pytest.approx(0.252 + 1.626 * np.arange(6))
    assert steps[changes].tolist() == [20.0, -20.0, 30.0, -30.0, 40.0, -40.0]
    assert len(aprbs(200.0, PERIOD_S, 40.0)) == 66667
    assert TWIN_INERTIAS["6.4 Jn"] == pytest.approx(0.0896)


def test_the_paper_s_arithmetic() -> None:
    assert paper.published_improvement() == pytest.approx(0.240, abs=5e-4)
    assert Elman(5, 10).n_weights == 171 == paper.PUBLISHED_TRAINING["n_weights"]
    assert paper.of_range(0.0015) == pytest.approx(0.0194, abs=5e-5)


def test_another_load_leaves_spring_and_inboard_inertia() -> None:
    rig, twin = rig_named(TWIN_RIG), Twin()
    values = {}
    for case, inertia in TWIN_INERTIAS.items():
        attached = attach_specs(rig, twin.effects(inertia))
        assembly = Assembly(rig, tuple(a for a, _ in attached))
        values[case] = assembly.values(
            {f"{a.label}:{k}": v for a, given in attached for k, v in given.items()}
        )
    heavy, light = values["6.4 Jn"], values["Jn"]
    assert not np.allclose(heavy, light)
    moved = paper.carried(assembly, heavy, TWIN_INERTIAS["6.4 Jn"], TWIN_INERTIAS["Jn"])
    assert moved == pytest.approx(light)
    bare = Assembly(rig)
    assert paper.carried(bare, bare.values(), 0.0896, 0.014) == pytest.approx(bare.values())
    # an inboard part that is all there is
    assert paper.carried(assembly, light, 0.014, 0.006)[assembly.keys["two-mass:share"]] == 0.0


@pytest.mark.slow
def test_a_quick_run(few_effects: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "paper"
    assert frame.run([*SMALL, "--output", str(folder)]) == 0
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
    kept = read_json(folder / "paper.json")
    assert {
        **found,
        "rows": [{k: v for k, v in row.items() if k != "seconds"} for row in found["rows"]],
    } == kept
    text = table_text(found)
    assert (
        text.startswith("QUICK")
        and "not the authors' rig" in text
        and "1.94 %" in text
        and "0.9793" in text
    )
    assert frame.run([*SMALL, "--output", str(folder)]) == 3  # a folder that is taken
    assert "--overwrite" in json.loads(capsys.readouterr().out)["hint"]


def test_an_interrupted_training_is_kept_and_goes_on(
    few_effects: None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def stopped(*given: Any, progress: Any, **options: Any) -> Any:
        def told(step: Any, start: int) -> None:
            progress(step, start)
            if step.iteration == 2:
                raise KeyboardInterrupt

        return unpatched(*given, progress=told, **options)

    def stop(*given: Any) -> Any:
        raise KeyboardInterrupt

    unpatched = paper.train_correction
    folder = tmp_path / "paper"
    with monkeypatch.context() as patch:
        patch.setattr(paper, "train_correction", stopped)
        assert frame.run([*SMALL, "--output", str(folder)]) == 130
    assert json.loads(capsys.readouterr().out)["code"] == "interrupted"
    assert read_json(folder / "run.json")["outcome"] == "interrupted"
    assert read_json(folder / "network.json")["training"]["iterations"] == 2
    assert (folder / "checkpoint.npz").is_file() and not (folder / "paper.json").exists()
    monkeypatch.setattr(paper, "explain", stop)
    assert frame.run([*SMALL, "--output", str(folder), "--resume"]) == 130
    whole = tmp_path / "whole"
    assert frame.run([*SMALL, "--output", str(whole)]) == 130
    assert (folder / "network.npz").read_bytes() == (whole / "network.npz").read_bytes()
