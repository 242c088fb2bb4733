"""Reports on paper: the PDF of a page, and the pages of the two reproduced papers."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pamid_cli.frame import run as run_command
from PIL import Image
from pypdf import PdfReader
from report_pages import flat, outline_of, scripts_of
from synthetic_run import make_run, run_json

from pamid.base.errors import FileError
from pamid.report.page import asset
from pamid.report.pdf import installed_browser
from pamid.report.writing import write_report

needs_browser = pytest.mark.skipif(
    installed_browser() is None, reason="no Chromium, Chrome or Edge is installed"
)


def text_of(pdf: Path) -> str:
    return flat(" ".join(page.extract_text() for page in PdfReader(pdf).pages))


@pytest.fixture
def few_files(tmp_path, monkeypatch) -> Path:
    """A run without pictures, which take the time."""
    monkeypatch.setattr("pamid.report.writing.drawings_of", lambda run, rows: [])
    return make_run(tmp_path / "RUN", without=("residual.csv", "trace.csv", "network.json"))


@needs_browser
def test_the_pdf_holds_the_answers_and_the_folded_evidence(few_files):
    report = write_report(few_files, pdf=few_files / "report.pdf")
    assert report.pdf is not None
    printed = text_of(report.pdf)
    for text in (
        "Coulomb friction at the joint port removes 86 % of the gap (P 0.91).",
        "The held-out angle error is",
        "Torque loops two pressures",
        "Mean absolute error per channel",
        "numpy 2.4.0",
    ):
        assert flat(text) in printed, text


@needs_browser
def test_the_command_writes_a_pdf_beside_the_page_or_elsewhere(few_files, tmp_path, capsys, cli):
    folder = few_files
    for _ in range(2):  # a PDF of ours is replaced
        assert cli("report", folder, "--pdf")["pdf"] == str(folder / "report.pdf")
    assert (folder / "report.pdf").read_bytes().startswith(b"%PDF")
    assert run_command(["report", str(folder), "--pdf", str(tmp_path / "deep" / "one.pdf")]) == 0
    assert f"PDF:  {tmp_path / 'deep' / 'one.pdf'}" in capsys.readouterr().out


@pytest.mark.parametrize("browser, code", [(None, "no-browser"), (sys.executable, "not-printed")])
def test_without_a_browser_nothing_is_written(browser, code, few_files, monkeypatch):
    """sys.executable: a program that starts, and prints no page."""
    monkeypatch.setattr("pamid.report.pdf.installed_browser", lambda: browser)
    with pytest.raises(FileError) as raised:
        write_report(few_files, pdf=few_files / "report.pdf")
    assert raised.value.code == code and "print it there" in raised.value.hint
    assert not (few_files / "report.pdf").exists() and not (few_files / "report.html").exists()


# ---- reproduced papers --------------------


def joint_paper() -> dict[str, Any]:
    def row(model: str, trained: float | None, unseen: float | None) -> dict[str, Any]:
        mae = {"6.4 Jn": trained, "Jn": unseen}
        return {
            "model": model,
            "mae": mae,
            "mae_after_1_s": mae,
            "published": {},
            "improvement": {key: None if value is None else 0.25 for key, value in mae.items()},
        }

    training = {
        "iterations": 1000,
        "mse": 0.0006,
        "rmse_of_range": 0.0123,
        "gradient": 4.5e6,
        "mu": 6e4,
        "gamma": 170.5,
        "n_weights": 171,
        "why": "iterations used up",
        "starts_mse": [0.1],
    }
    return {
        "schema": "pamid.paper/1",
        "quick": True,
        "plan": {},
        "notes": ["A twin, not the authors' <b>rig</b>."],
        "twin": {"coulomb_n_m": 0.15, "analytic_mae_without_noise": {"Jn": 1.1}},
        "rows": [
            row("analytic model", 1.29, 1.194),
            row("analytic model + Elman", 0.585, None),
            row("named causes", 0.87, 0.7177),
        ],
        "published": {"mae": {}, "improvement": 0.24, "training": {**training, "seconds": 36101.0}},
        "training": training,
        "diagnosis": {
            "verdict": "explained",
            "sentence": "two-mass explains the gap.",
            "causes": [
                {
                    "effect": "two-mass",
                    "parameters": {"frequency_hz": {"value": 3.45, "low": 3.36, "high": 3.55}},
                }
            ],
        },
    }


def arm_paper() -> dict[str, Any]:
    errors = {
        "angle_1_deg": {
            "unit": "deg",
            "data_sheet": 1.88,
            "fitted_analytic": 0.0396,
            "noise_floor": 0.0395,
        }
    }
    known = {"value": 0.258, "low": 0.257, "high": 0.259, "word": "settled"}
    inertia = {
        "unit": "kg m2",
        "data_sheet": 0.24,
        "truth": 0.2601,
        "without_payload": {**known, "holds": True},
        "gravity": {**known, "holds": False},
    }
    return {
        "schema": "pamid.paper-arm/1",
        "quick": False,
        "notes": ["A virtual arm."],
        "twin": {"law": "braid-and-rubber", "hidden": {"scale": 1.12}},
        "mae": {"gravity": errors},
        "windowed_mae": {"gravity": errors},
        "target": {"share": 0.05, "worst": 1.0022, "reached": True},
        "force_law": {"finding": "the ANFIS is off by 3.89 N"},
        "combinations": {"inertia_kg_m2": inertia},
        "parameters": {
            "scale": {"unit": "", "data_sheet": 1.0, "truth": None, "fitted_anfis": {**known}}
        },
        "fits": {"gravity": {"converged": False, "why": "too few steps"}},
    }


def make_paper(folder: Path, name: str, content: dict[str, Any]) -> Path:
    (folder / "figures").mkdir(parents=True)
    for file, value in (("run.json", {**run_json(), "inputs": []}), (name, content)):
        (folder / file).write_text(json.dumps(value), encoding="utf-8")
    picture = Image.fromarray(np.full((120, 300, 3), 200, np.uint8))
    for still in ("steps", "gravity"):
        picture.save(folder / "figures" / f"{still}.png")
    return folder


@pytest.mark.parametrize(
    "name, content, told",
    [
        (
            "paper.json",
            joint_paper(),
            [
                "At Jn, the analytic model is off by 1.19 deg, the named causes by 0.718 deg.",
                "QUICK: records",
                "analytic model + Elman – 0.585 0.585 25 % – – – –",
                "published 1000 36101",
                "two mass frequency 3.45",
                "coulomb 0.150 N m",
                "A twin, not the authors' <b>rig</b>.",
            ],
        ),
        (
            "arm-paper.json",
            arm_paper(),
            [
                "The errors of the fitted angles in the gravity tests lie within 5 % of the "
                "noise: at most 1.002 times it.",
                "angle 1 deg 1.88 0.0396 0.0395",
                "0.258 (0.257 to 0.259)*",
                "scale 1.12 -",
                "The ANFIS is off by 3.89 N.",
                "Not converged: gravity: too few steps",
            ],
        ),
    ],
)
def test_a_reproduced_paper_has_a_page(name, content, told, tmp_path):
    folder = make_paper(tmp_path / "RUN", name, content)
    still = "steps" if name == "paper.json" else "gravity"
    before = (folder / "figures" / f"{still}.png").read_bytes()
    report = write_report(folder)
    page = outline_of(report.page)
    text = flat(page.text)
    for sentence in told:
        assert sentence in text, sentence
    assert scripts_of(report.page.read_text(encoding="utf-8")) == [asset("page.js")]
    sources = [value for key, value in page.attributes if key == "src"]
    assert len(sources) == 1 and sources[0].startswith("data:image/png;base64,")
    assert (folder / "figures" / f"{still}.png").read_bytes() == before
