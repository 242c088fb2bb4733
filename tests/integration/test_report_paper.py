"""Reports on paper: the PDF of a page, and the pages of the two reproduced papers."""

from __future__ import annotations

import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from markupsafe import Markup
from pamid_cli.frame import run as run_command
from PIL import Image
from pypdf import PdfReader
from report_pages import flat, outline_of, scripts_of
from synthetic_run import make_run, make_trial, run_json

from pamid.base.errors import FileError
from pamid.report.document import (
    Block,
    Document,
    FigureBlock,
    Heading,
    Interactive,
    Paragraphs,
    notes,
    table,
)
from pamid.report.pdf import SIDE_MM, pdf_of
from pamid.report.style import Drawing, render
from pamid.report.web_page import page_script
from pamid.report.writing import content_of, write_report


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> Document:
    """The report of a run with every picture it may have, each the same small drawing."""
    content = content_of(make_run(tmp_path_factory.mktemp("run") / "RUN"))
    small = render(Drawing("one", "A finding", lambda figure, narrow: None, 2.0, 2.0))
    pictures = {
        one.name: replace(small, name=one.name, title=one.title) for one in content.drawings
    }
    assert len(pictures) == 14
    return content.document_of(pictures)


@pytest.fixture(scope="module")
def reader(document: Document) -> PdfReader:
    return PdfReader(io.BytesIO(pdf_of(document)))


def text_on(reader: PdfReader, number: int) -> str:
    return flat(reader.pages[number].extract_text())


def document_of(*blocks: Block) -> Document:
    return Document("Title", "Subtitle", "Headline", Paragraphs(()), blocks)


def test_the_first_page_holds_the_answers(reader: PdfReader) -> None:
    first = text_on(reader, 0)
    places = [
        first.index(mark)
        for mark in (
            "Coulomb friction at the joint port removes 86 % of the gap (P 0.91).",
            "WHERE",
            "At the joint port",
            "WHICH",
            "with probability 0.91",
            "HOW FAR",
            "The held-out angle error is",
            "WHAT IS LEFT",
            "NEXT EXPERIMENT",
            "Torque loops two pressures",
        )
    ]
    assert places == sorted(places)
    assert "A finding" not in first


def test_nothing_leaves_the_paper(reader: PdfReader) -> None:
    assert 3 <= len(reader.pages) <= 14
    edge, wide, tall = 72.0 / 25.4 * SIDE_MM, *map(float, reader.pages[0].mediabox[2:])
    for page in reader.pages:
        found: list[tuple[str, float, float]] = []
        page.extract_text(
            visitor_text=lambda text, cm, tm, font, size, found=found: found.append(  # type: ignore[misc]
                (text, cm[4] + tm[4], cm[5] + tm[5])
            )
        )
        shown = [one for one in found if one[0].strip()]
        assert shown
        for text, x, y in shown:
            assert edge - 1.0 <= x <= wide - edge and 20.0 <= y <= tall - 30.0, (text, x, y)


def test_every_table_of_the_page_is_there(reader: PdfReader) -> None:
    everything = " ".join(text_on(reader, k) for k in range(len(reader.pages)))
    for text in (
        "Mean absolute error per channel",
        "data sheet",
        "1.29",
        "All 5 candidates",
        "Provenance",
        "numpy 2.4.0",
        "m³",
        "× 10⁻",
    ):
        assert text in everything, text
    unbroken = everything.replace(" ", "").replace("\u200b", "")
    assert "ab" * 32 in unbroken and "sonic_conductance" in unbroken


def test_the_metadata_names_no_moment(reader: PdfReader, document: Document) -> None:
    about = reader.metadata
    assert (
        about is not None
        and about.creator == "pamid"
        and flat(about.title or "") == flat(document.headline)
    )
    assert about.creation_date is not None and about.creation_date.year == 1970
    fonts = [
        font.get_object()["/DescendantFonts"][0].get_object()["/FontDescriptor"]
        for page in reader.pages
        for font in page["/Resources"]["/Font"].values()  # type: ignore[index]
    ]
    assert fonts and all("/FontFile2" in font for font in fonts)  # embedded


def test_long_names_are_broken_where_they_may_be() -> None:
    name = "conductance_in_m3_per_s_pa_" * 9 + "x" * 200
    reader = PdfReader(io.BytesIO(pdf_of(document_of(notes(f"a {name} that goes on")))))
    lines = reader.pages[0].extract_text().replace("\u200b", "").splitlines()
    broken = [line for line in lines if "conductance" in line]
    assert len(broken) > 1 and all(line.strip().endswith("_") for line in broken[:-1])
    assert name in "".join(line.strip() for line in lines)


def test_a_long_table_repeats_its_head() -> None:
    rows = [(f"row {k}", f"{k}") for k in range(200)]
    reader = PdfReader(io.BytesIO(pdf_of(document_of(table(["name", "value"], rows, {1})))))
    assert len(reader.pages) > 2
    for number in range(len(reader.pages)):
        assert "name value" in text_on(reader, number)
    assert "row 199 199" in text_on(reader, len(reader.pages) - 1)


def test_a_heading_never_stands_alone_at_the_foot() -> None:
    picture = render(Drawing("one", "A finding", lambda figure, narrow: None, 4.0, 4.0))
    for above in range(28, 44):
        blocks = (Paragraphs(("text",) * above), Heading("Title"), FigureBlock(picture))
        reader = PdfReader(io.BytesIO(pdf_of(document_of(*blocks))))
        pages = [text_on(reader, k) for k in range(len(reader.pages))]
        assert [("Title" in page) for page in pages] == [("A finding" in page) for page in pages]


def test_what_needs_scripts_is_not_printed() -> None:
    reader = PdfReader(
        io.BytesIO(pdf_of(document_of(notes("seen"), Interactive(Markup("<button>unseen")))))
    )
    assert "seen" in text_on(reader, 0) and "unseen" not in text_on(reader, 0)


@pytest.mark.slow
def test_the_pdf_is_the_same_every_time(tmp_path: Path) -> None:
    folder = make_trial(tmp_path / "TRIAL")
    first = write_report(folder, pdf=tmp_path / "one.pdf")
    second = write_report(folder, pdf=tmp_path / "two.pdf")
    assert first.pdf is not None and second.pdf is not None
    found = first.pdf.read_bytes()
    assert found.startswith(b"%PDF") and len(found) < 500_000
    assert second.pdf.read_bytes() == found
    assert "9 of 12" in str(PdfReader(io.BytesIO(found)).metadata)


def test_the_command_writes_a_pdf_beside_the_page_or_elsewhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # they take the time
    monkeypatch.setattr("pamid.report.writing.drawings_of", lambda run, rows: [])
    folder = make_run(tmp_path / "RUN", without=("residual.csv", "trace.csv", "network.json"))
    assert run_command(["report", str(folder), "--pdf", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["pdf"] == str(folder / "report.pdf")
    assert (folder / "report.pdf").read_bytes().startswith(b"%PDF")
    assert run_command(["report", str(folder), "--pdf", str(tmp_path / "deep" / "one.pdf")]) == 0
    assert f"PDF:  {tmp_path / 'deep' / 'one.pdf'}" in capsys.readouterr().out
    (tmp_path / "mine.pdf").write_bytes(b"%PDF-1.4 mine")
    assert run_command(["report", str(folder), "--pdf", str(tmp_path / "mine.pdf")]) == 3
    assert "is not a report" in capsys.readouterr().err
    assert (tmp_path / "mine.pdf").read_bytes() == b"%PDF-1.4 mine"


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
def test_a_reproduced_paper_has_a_page(
    name: str, content: dict[str, Any], told: list[str], tmp_path: Path
) -> None:
    folder = make_paper(tmp_path / "RUN", name, content)
    still = "steps" if name == "paper.json" else "gravity"
    before = (folder / "figures" / f"{still}.png").read_bytes()
    report = write_report(folder, pdf=folder / "report.pdf")
    page = outline_of(report.page)
    text = flat(page.text)
    for sentence in told:
        assert sentence in text, sentence
    assert scripts_of(report.page.read_text(encoding="utf-8")) == [page_script()]
    sources = [value for key, value in page.attributes if key == "src"]
    assert len(sources) == 1 and sources[0].startswith("data:image/png;base64,")
    assert (folder / "figures" / f"{still}.png").read_bytes() == before
    assert report.pdf is not None
    reader = PdfReader(report.pdf)
    printed = flat(" ".join(one.extract_text() for one in reader.pages))
    assert all(flat(sentence)[:40] in printed for sentence in told)
    assert sum(len(one.images) for one in reader.pages) == 1


def test_every_figure_of_a_paper_has_its_heading(tmp_path: Path) -> None:
    """And a run of an earlier version, which has fewer, is read none the less."""
    arm = {
        **arm_paper(),
        "coupling": [
            {
                "pulsed": "2",
                "moved": "angle_1_deg",
                "from_s": 0.4,
                "to_s": 30.4,
                "swing_deg": 1.75,
                "mae": {"fitted": 0.0397, "without_coupling": 0.131, "noise_floor": 0.0396},
            }
        ],
    }
    told = {
        "paper.json": (
            joint_paper(),
            {
                "responses": "Responses to the steps",
                "pressures": "Pressures on the steps",
                "excitation": "The record that the network is trained on",
                "network-training": "The network's training",
                "force-surface": "The force law",
            },
        ),
        "arm-paper.json": (arm, {"coupling": "Coupling between the joints"}),
    }
    for name, (content, headings) in told.items():
        folder = make_paper(tmp_path / name, name, content)
        before = outline_of(write_report(folder).page)
        assert sum(key == "src" for key, _ in before.attributes) == 1
        for still in headings:
            (folder / "figures" / f"{still}.png").write_bytes(
                (folder / "figures" / "steps.png").read_bytes()
            )
        page = outline_of(write_report(folder).page)
        sources = [value for key, value in page.attributes if key == "src"]
        assert len(sources) == 1 + len(headings)
        text = flat(page.text)
        assert all(heading in text for heading in headings.values())
    assert "angle 1, joint 2 pulsed 1.75 – 0.131 0.0397 0.0396" in text


def test_the_diagnosis_of_a_paper_stands_below_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pamid.report.writing.drawings_of", lambda run, rows: [])
    folder = make_paper(tmp_path / "RUN", "paper.json", joint_paper())
    donor = make_run(tmp_path / "OTHER")
    (folder / "diagnosis.json").write_bytes((donor / "diagnosis.json").read_bytes())
    text = flat(outline_of(write_report(folder).page).text)
    assert text.index("Errors on the steps") < text.index(
        "Coulomb friction at the joint port, with probability 0.91"
    )


@pytest.mark.parametrize(
    "damage, told",
    [
        (lambda one: one.update(rows=[]), "rows should be a list with at least one model"),
        (lambda one: one["training"].update(mse="small"), "training.mse should be a number"),
        (lambda one: one.update(schema="pamid.paper/9"), "schema should be 'pamid.paper/1'"),
        (lambda one: one["rows"][0].pop("mae"), "mae should be an object"),
    ],
)
def test_a_damaged_paper_is_named(damage: Any, told: str, tmp_path: Path) -> None:
    content = joint_paper()
    damage(content)
    with pytest.raises(FileError, match=re.escape(told)):
        write_report(make_paper(tmp_path / "RUN", "paper.json", content))


def test_a_picture_that_is_none_is_named(tmp_path: Path) -> None:
    folder = make_paper(tmp_path / "RUN", "paper.json", joint_paper())
    (folder / "figures" / "steps.png").write_bytes(b"<svg onload=alert(1)>")
    with pytest.raises(FileError, match="steps.png is no picture"):
        write_report(folder)
