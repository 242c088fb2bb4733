"""Reports on paper: the PDF of a page, and the pages of the two reproduced papers."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from pamid_cli.frame import run as run_command
from PIL import Image
from synthetic_run import make_run, make_trial, run_json
from test_report import flat, outline_of, scripts_of

from pamid.base.errors import FileError
from pamid.report.blocks import blocks_of
from pamid.report.page import page_script
from pamid.report.pdf import BODY, HEAD, STYLES, sheets_of
from pamid.report.sheets import (
    FOOT_IN,
    SIDE_IN,
    TALL_IN,
    TEXT_IN,
    TOP_IN,
    WIDE_IN,
    Sheets,
    Style,
    width_of,
    wrapped,
)
from pamid.report.style import Drawing
from pamid.report.writing import content_of, write_report


def told_on(sheets: Sheets, number: int) -> str:
    return flat(" ".join(text for _, _, text, _, _ in sheets.pages[number].texts))


@pytest.fixture(scope="module")
def sheets(tmp_path_factory: pytest.TempPathFactory) -> Sheets:
    content = content_of(make_run(tmp_path_factory.mktemp("run") / "RUN"))
    pictures: dict[str, Any] = {}
    html = content.html_of(pictures)
    assert not pictures
    figures = "".join(
        f'<figure id="figure-{one.name}"><figcaption>{one.title}</figcaption></figure>'
        for one in content.drawings
    )
    return sheets_of(html.replace("</section>", f"{figures}</section>", 1), content.drawings)


def test_the_first_page_holds_the_answers(sheets: Sheets) -> None:
    first = told_on(sheets, 0)
    places = [
        first.index(mark)
        for mark in (
            "Coulomb friction removes 79 %",
            "WHERE",
            "At the joint port",
            "WHICH",
            "with probability 0.91",
            "HOW FAR",
            "The held-out angle error is",
            "NEXT EXPERIMENT",
            "Torque loops two pressures",
        )
    ]
    assert places == sorted(places)
    assert not sheets.pages[0].drawings


def test_nothing_leaves_the_paper(sheets: Sheets) -> None:
    assert 3 <= len(sheets.pages) <= 14
    assert sum(len(page.drawings) for page in sheets.pages) == 9
    for page in sheets.pages:
        for x, y, text, style, side in page.texts:
            left = x - width_of(text, style) if side == "right" else x
            assert (
                left >= SIDE_IN - 0.01 and left + width_of(text, style) <= WIDE_IN - SIDE_IN + 0.01
            ), text
            assert TOP_IN <= y <= TALL_IN - FOOT_IN, text
        filled = sorted((top, top + height) for top, height, _ in page.drawings)
        assert all(end <= TALL_IN - FOOT_IN + 0.01 for _, end in filled)
        assert all(one[1] <= other[0] for one, other in zip(filled, filled[1:], strict=False))


def test_every_table_of_the_page_is_there(sheets: Sheets) -> None:
    everything = " ".join(told_on(sheets, k) for k in range(len(sheets.pages)))
    for told in (
        "Mean absolute error per channel",
        "data sheet",
        "1.29",
        "All 5 candidates",
        "sonic_conductance",
        "Provenance",
        "ab" * 20,
        "numpy 2.4.0",
    ):
        assert told in everything.replace("ab ab", "abab"), told


def test_lines_are_broken_where_they_may_be() -> None:
    style = Style(9.0)
    lines = wrapped("a conductance_in_m3_per_s_pa that is told, then " + "x" * 400, style, 1.2)
    assert all(width_of(line, style) <= 1.2 for line in lines)
    assert (
        "".join(lines).replace(" ", "") == "aconductance_in_m3_per_s_pathatistold,then" + "x" * 400
    )
    assert any(line.endswith("_") for line in lines)


def test_a_long_table_repeats_its_head() -> None:
    sheets = Sheets()
    sheets.table(
        [("name", "value"), *((f"row {k}", f"{k}") for k in range(200))], frozenset({1}), HEAD, BODY
    )
    assert len(sheets.pages) > 2
    for number in range(len(sheets.pages)):
        assert told_on(sheets, number).startswith("name value")
    assert told_on(sheets, len(sheets.pages) - 1).endswith("199")


def test_a_heading_never_stands_alone_at_the_foot() -> None:
    drawing = Drawing("one", "A finding", lambda figure, narrow: None, 4.0, 4.0)
    page = (
        "<main>"
        + "<p>text</p>" * 30
        + '<h2>Title</h2><figure id="figure-one"><figcaption>A finding</figcaption>'
    )
    sheets = sheets_of(page + "</figure></main>", [drawing])
    number = next(k for k in range(len(sheets.pages)) if sheets.pages[k].drawings)
    assert "A finding" in told_on(sheets, number)


@pytest.mark.slow
def test_the_pdf_is_the_same_every_time(tmp_path: Path) -> None:
    folder = make_trial(tmp_path / "TRIAL")
    first = write_report(folder, pdf=tmp_path / "one.pdf")
    second = write_report(folder, pdf=tmp_path / "two.pdf")
    assert first.pdf is not None and second.pdf is not None
    found = first.pdf.read_bytes()
    assert found.startswith(b"%PDF") and len(found) < 500_000
    assert second.pdf.read_bytes() == found
    assert b"/Title (9 of 12" in found or b"/Title" in found


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


def test_blocks_are_what_the_page_says() -> None:
    page = (
        '<main><p class="rig">r</p><h1>T</h1><section class="answer"><h2><span '
        'class="question">Where</span>There.'
        '</h2><p class="show scripted"><button>x</button></p><math alttext="a = '
        'b"><mi>a</mi></math></section>'
        '<section class="samples"><h2>no</h2><script type="text/plain">QUJD</script></section>'
        "<table><thead><tr><th>n</th><th "
        'class="n">v</th></tr></thead><tbody><tr><td>a<small>b</small></td>'
        '<td class="n">1</td></tr></tbody></table></main>'
    )
    found = blocks_of(page)
    assert [(one.kind, one.text) for one in found] == [
        ("rig", "r"),
        ("h1", "T"),
        ("question", "Where"),
        ("h2", "There."),
        ("equation", "a = b"),
        ("table", ""),
    ]
    assert found[-1].rows == (("n", "v"), ("a\nb", "1")) and found[-1].numeric == {1}
    assert set(STYLES) >= {one.kind for one in found if one.kind != "table"}


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
    assert report.pdf is not None and report.pdf.read_bytes().startswith(b"%PDF")


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


def test_sheets_draw_what_they_are_given(tmp_path: Path) -> None:
    seen: list[Figure] = []
    sheets = Sheets()
    sheets.draw(Drawing("one", "", lambda figure, narrow: seen.append(figure), 2.0, 2.0))
    assert sheets.pdf("title").startswith(b"%PDF") and len(seen) == 1
    place = seen[0].bbox.transformed(seen[0].get_figure(root=True).transFigure.inverted())  # type: ignore[union-attr]
    assert place.width == pytest.approx(TEXT_IN / WIDE_IN, abs=0.01)
    assert place.height == pytest.approx(2.0 / TALL_IN, abs=0.01)
    assert place.y1 == pytest.approx(1.0 - TOP_IN / TALL_IN, abs=0.01)
