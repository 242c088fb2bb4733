"""The report of synthetic runs: every verdict, missing parts, damaged and hostile files, same
bytes, no network."""

import re
from pathlib import Path
from typing import Any

import matplotlib
import pytest
from matplotlib.figure import Figure
from pamid_cli.frame import run as run_command
from report_pages import VERDICTS, Outline, blank, flat, outline_of, scripts_of, text_of
from synthetic_run import (
    CHANNELS,
    diagnosis_json,
    fit_json,
    make_run,
    network_json,
    run_json,
)

from pamid.base.errors import FileError
from pamid.base.schemas.diagnosis_file import CAUSED
from pamid.report.channel_errors import errors_of
from pamid.report.load import load_run
from pamid.report.page import asset
from pamid.report.traces import traces_scripts
from pamid.report.writing import drawings_of, write_report


@pytest.fixture(scope="module")
def drawn(tmp_path_factory) -> Path:
    """A run with its report, pictures included."""
    folder = make_run(tmp_path_factory.mktemp("run") / "RUN")
    write_report(folder)
    return folder


@pytest.fixture(scope="module", params=VERDICTS)
def reported(request, drawn, tmp_path_factory) -> tuple[str, Path, Outline]:
    """`test_text_of_files_never_becomes_markup` draws the figures of an unknown effect."""
    if request.param == "explained":
        return request.param, drawn, outline_of(drawn / "report.html")
    folder = make_run(tmp_path_factory.mktemp("run") / "RUN", request.param)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pamid.report.writing.render", blank)
        return request.param, folder, outline_of(write_report(folder).page)


#: of every verdict, the figures and names that its page gives
SAID = {
    "explained": (
        "Coulomb friction at the joint port, with probability 0.91",
        "removes 86 % of the gap (95 % interval 74 to 98 %)",
        "No material part of the gap",
        "1.4 times the noise floor in the worst channel",
        "18 of 18 held-out windows",
        "0.610 → 0.200 (67 % removed)",
    ),
    "partly-explained": (
        "Coulomb friction at the joint port removes 64 % of the gap (P 0.91)",
        "36 % of the gap, at the muscle port",
        "36 % of the gap (95 % interval 32 to 42 %)",
        "−0.42 sign(velocity) + 0.11 contraction²",
    ),
    "ambiguous": (
        "removes 86 % of the gap (P 0.91)",
        "leak at the pressure port, 85 % (P 0.38)",
        "cannot separate",
    ),
    "unknown-effect": (
        "All of the gap, at the joint port. Remaining: 10 times the noise floor",
        "muscle port removes 77 % of the gap (95 % interval 66 to 88 %)",
        "of the friction family",
        "−0.42 sign(velocity) + 0.11 contraction²",
        "83 % of the fits",
    ),
    "no-structural-gap": ("No structural gap", "1.1 times the noise floor", "Nowhere"),
    "cannot-tell": (
        "Coulomb friction may be missing. It removes 24 % of the gap (95 % interval 4 to 44 %",
        "Undetermined",
    ),
}


def test_three_answers_come_before_the_evidence(reported):
    verdict, _, page = reported
    text = flat(page.text)
    places = [
        text.index(mark)
        for mark in ("Where", "Which", "How far", "What is left", "Next experiment", "Evidence")
    ]
    assert places == sorted(places)
    for words in SAID[verdict]:
        assert words in re.sub(r" (?=[,.)])", "", text), words
    assert ("with cause" in text or "with the cause" in text) == (verdict in CAUSED)


def test_nothing_is_loaded_and_only_our_scripts_run(reported):
    _, folder, page = reported
    assert not {"link", "iframe", "object", "embed", "base", "form", "img"} & set(page.elements)
    for name, value in page.attributes:
        assert name != "href" or value.startswith("#"), "what is linked stands on the page"
        assert not name.startswith("on")
        assert name.startswith("xmlns") or "//" not in value, (name, value)
    source = (folder / "report.html").read_text(encoding="utf-8")
    assert scripts_of(source) == [asset("page.js"), asset("player.js"), *traces_scripts()]
    assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", source))
    assert "@import" not in source


def test_every_axis_names_its_unit(reported):
    _, folder, _ = reported
    run = load_run(folder)
    for drawing in drawings_of(run, errors_of(run)):
        if drawing.name == "rig":  # blocks, no axes
            continue
        figure = Figure(layout="constrained")
        drawing.draw(figure, False)
        assert len(drawing.title) > 20
        for axes in figure.axes:
            quantities = [axes.get_ylabel()] if axes.get_lines() and axes.get_ylabel() else []
            quantities += (
                [axes.get_xlabel()]
                if any(label.get_visible() for label in axes.get_xticklabels())
                else []
            )
            assert quantities and all(
                re.search(r"\[\S.*\]", text) for text in quantities if text
            ), drawing.name


@pytest.mark.parametrize(
    "missing, command",
    [
        ("diagnosis.json", "pamid diagnose"),
        ("network.json", "pamid train-residual"),
        ("residual.csv", "pamid fit"),
    ],
)
def test_a_missing_part_names_the_command_that_adds_it(missing, command, tmp_path):
    assert command in text_of(make_run(tmp_path / "RUN", without=(missing,)))


HOSTILE = "</style></svg><script>alert('x')</script>\"&lt;"
HOSTILE += "$\\alpha_$ `b` \u202e\x07\ud83d\ude00 --><img src=x onerror=y>"


def poison(value: Any, kept: tuple[str, ...]) -> Any:
    if isinstance(value, str):
        return value if value in kept else f"{value}{HOSTILE}"
    if isinstance(value, dict):
        return {key: poison(one, kept) if key != "schema" else one for key, one in value.items()}
    return [poison(one, kept) for one in value] if isinstance(value, list) else value


@pytest.mark.parametrize("verdict", ["explained", "unknown-effect"])
def test_text_of_files_never_becomes_markup(verdict, tmp_path, request):
    if verdict != "unknown-effect":  # its figures are those of the other, but for one
        request.getfixturevalue("undrawn")
    content = {
        "run": run_json(),
        "fit": fit_json(),
        "diagnosis": diagnosis_json(verdict),
        "network": network_json(),
    }
    kept = (verdict, "angle_deg", *CHANNELS)
    parts = {name: poison(value, kept) for name, value in content.items()}
    for name in ("parameters", "background"):
        parts["fit"][name] = {f"{key}{HOSTILE}": value for key, value in parts["fit"][name].items()}
    found = parts["diagnosis"]
    found["background"] = {f"{HOSTILE}{key}": one for key, one in found["background"].items()}
    found["how_far"][f"load{HOSTILE}"] = found["how_far"]["angle_deg"]
    folder = make_run(tmp_path / "RUN", verdict, **parts)
    page = outline_of(write_report(folder).page)
    source = (folder / "report.html").read_text(encoding="utf-8")
    assert scripts_of(source) == [asset("page.js"), *traces_scripts()]
    assert "img" not in page.elements
    assert not any(name.startswith("on") for name, _ in page.attributes)
    assert "<script>alert('x')</script>" in page.text
    assert "\u202e" not in source


def test_same_inputs_give_the_same_bytes(drawn, tmp_path):
    again = make_run(tmp_path / "elsewhere" / "again")
    with matplotlib.rc_context({"font.size": 20.0, "axes.grid": True, "svg.hashsalt": None}):
        write_report(again)
    for path in [drawn / "report.html", *(drawn / "figures").iterdir()]:
        assert path.read_bytes() == (again / path.relative_to(drawn)).read_bytes(), path.name


@pytest.mark.usefixtures("undrawn")
def test_output_elsewhere_never_replaces_a_stranger(tmp_path):
    folder = make_run(tmp_path / "RUN", without=("residual.csv",))
    page, notes = tmp_path / "pages" / "one.html", tmp_path / "notes.html"
    for _ in range(2):
        assert write_report(folder, page).page == page
    notes.write_text("mine", encoding="utf-8")
    with pytest.raises(FileError, match="is not a report"):
        write_report(folder, notes)
    assert notes.read_text(encoding="utf-8") == "mine"
    assert not (folder / "report.html").exists()
    assert run_command(["report", str(folder), "--output", str(notes)]) == 3
    assert run_command(["report", str(folder), "--output", str(notes), "--overwrite"]) == 0
    assert notes.read_text(encoding="utf-8").startswith("<!doctype html>")


@pytest.mark.usefixtures("undrawn")
def test_the_command_prints_one_object(tmp_path, capsys, cli):
    folder = make_run(tmp_path / "RUN")
    told = cli("report", folder)
    assert told["schema"] == "pamid.report/1"
    assert Path(told["page"]) == folder / "report.html" and Path(told["page"]).is_file()
    assert len(told["figures"]) == 14 and all(Path(path).is_file() for path in told["figures"])
    assert told["mae"]["angle_deg"] == {
        "data_sheet": 1.29,
        "refitted": 0.52,
        "with_network": 0.23,
        "with_cause": 0.11,
        "noise_floor": 0.05,
    }
    assert run_command(["report", str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split("  ")[0] == "MAE, held out"
    assert lines[1].split() == [
        "angle",
        "[deg]",
        "1.29",
        "0.520",
        "0.230",
        "0.110",
        "0.0500",
    ]
    assert cli("report", tmp_path / "nowhere", code=3)["code"] == "not-a-run"
