"""`import pamid`, as somebody at a notebook uses it: verbs, typed results, cards, plots, run
folders."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas
import pytest
from pamid_cli import frame
from pydantic import ValidationError
from small_cart import FEW, RIG, record_cart

import pamid
from pamid.base.card import escaped
from pamid.base.errors import FileError
from pamid.model.registry import effects

LEFT_OUT = [name for name in effects() if name not in FEW]
BENCH_LOG = Path(__file__).parents[2] / "data" / "example" / "bench_log.csv"
HOSTILE = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    return record_cart(tmp_path_factory.mktemp("cart"))


@pytest.fixture(scope="module")
def fitted(recorded) -> pamid.FitResult:
    return pamid.fit(recorded, RIG, progress=False)


@pytest.fixture(scope="module")
def found(recorded) -> pamid.DiagnosisResult:
    return pamid.diagnose(recorded, RIG, without=LEFT_OUT, jobs=1, progress=False)


def in_a_fresh_python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout


def test_type_checkers_see_every_name():
    text = Path(str(pamid.__file__)).read_text(encoding="utf-8")
    block = text[text.index("if TYPE_CHECKING:") : text.index("__version__ =")]
    assert not [
        n for n in pamid.__all__ if n != "__version__" and not re.search(rf"\b{n}\b", block)
    ]


def test_report_is_a_verb_whether_its_package_is_loaded_or_not():
    code = "import pamid; print(callable(pamid.report)); import pamid.report.formatting; "
    assert in_a_fresh_python(f"{code}print(callable(pamid.report))") == "True\nTrue\n"


# ---- recordings --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.drop(columns="time_s"), "has no column 'time_s'"),
        (lambda t: t.assign(operator="Ann"), "holds more than numbers"),
        (lambda t: t.assign(position_m=np.nan), "bench.csv"),
        (lambda t: t.head(10), "too short: 10 samples"),
    ],
)
def test_a_table_that_is_no_recording(recorded, change, words):
    table = change(pamid.read_recording(recorded).to_pandas())
    with pytest.raises(pamid.PamidError, match=words) as caught:
        pamid.Recording.from_pandas(table, "bench")
    assert "/tmp" not in str(caught.value)


# ---- a fit -------------------------------------------------------------------------------------


def test_a_fit_has_typed_parameters(fitted):
    mass = fitted.parameters["mass_kg"]
    assert mass.low is not None and mass.high is not None
    assert mass.low < mass.value < mass.high and (mass.prior, mass.unit) == (1.0, "kg")
    assert mass.word == "settled" and mass.source == "kitchen scale"
    with pytest.raises(ValidationError):
        mass.value = 2.0  # type: ignore[misc]
    with pytest.raises(KeyError, match="Did you mean 'mass_kg'"):
        fitted.parameters["mas_kg"]
    assert fitted.converged and fitted.channels == ("position_m",) and fitted.rig == "cart"
    assert fitted.errors["position_m"].refitted < fitted.errors["position_m"].data_sheet  # type: ignore[operator]
    assert "FitResult cart" in repr(fitted) and "mass_kg" in repr(fitted.parameters)


def test_a_fit_is_the_commands(fitted, recorded, tmp_path):
    folder = tmp_path / "by-command"
    assert frame.run(["fit", str(recorded), "--rig", RIG, "--output", str(folder)]) == 0
    saved = fitted.save(tmp_path / "by-hand")
    names = {path.name for path in folder.iterdir()}
    assert (
        names
        == {path.name for path in saved.iterdir()}
        == {"fit.json", "free-run.csv", "residual.csv", "run.json"}
    )
    for name in names - {"run.json"}:
        assert (folder / name).read_bytes() == (saved / name).read_bytes(), name
    mine, theirs = (json.loads((f / "run.json").read_text()) for f in (saved, folder))
    assert {k: mine[k] for k in ("seed", "options", "inputs", "outcome", "files")} == {
        k: theirs[k] for k in ("seed", "options", "inputs", "outcome", "files")
    }
    assert fitted.to_dict() == json.loads((folder / "fit.json").read_text())


# ---- a diagnosis -------------------------------------------------------------------------------


def test_a_diagnosis_answers_where_which_how_far(found):
    assert found.verdict == "explained" and found.ports[0][0] == "force"
    (cause,) = found.causes
    assert (cause.effect, cause.family, cause.port) == ("coulomb-friction", "friction", "force")
    force = cause.parameters["force_n"]
    assert force.low is not None and force.low < force.value and force.unit == "N"
    assert cause.share == 1.0 and cause.probability is not None and 0.0 <= cause.probability <= 1.0
    assert found.errors["position_m"].with_cause < found.errors["position_m"].refitted  # type: ignore[operator]
    assert found.parameters["mass_kg"].value == pytest.approx(1.2, rel=0.05)
    card = found._repr_html_()
    assert cause.removes is not None and 0.0 < cause.removes.low <= cause.removes.share
    assert found.remainder is not None and not found.remainder.real
    shown = (
        escaped(found.sentence),
        "Where: At the force port.",
        "Which: Coulomb friction at the force port",
        "Refitted: mass ",
        "position",
        "What is left: No material part of the gap.",
        "<svg",
        "◆",
    )
    for words in shown:
        assert words in card, words
    assert "DiagnosisResult explained" in repr(found) and "coulomb-friction" in repr(found)


def test_a_diagnosis_is_the_commands(found, recorded, tmp_path):
    folder, words = tmp_path / "run", [w for name in LEFT_OUT for w in ("--without", name)]
    drawn = tmp_path / "pictures" / "rig.png"
    words += ["--output", str(folder), "--figure", str(drawn)]
    assert frame.run(["diagnose", str(recorded), "--rig", RIG, *words]) == 0
    assert drawn.read_bytes() == found.overview_png()
    saved = found.save(tmp_path / "saved")
    assert sorted(p.name for p in folder.iterdir()) == sorted(p.name for p in saved.iterdir())
    for path in folder.iterdir():
        if path.name != "run.json":
            assert path.read_bytes() == (saved / path.name).read_bytes(), path.name


def test_a_card_is_text_whatever_a_file_says(found, tmp_path):
    folder = found.save(tmp_path / "run")
    for name, key in (("fit.json", "rig"), ("diagnosis.json", "sentence")):
        told = json.loads((folder / name).read_text())
        told[key] = HOSTILE + "\x1b[2J\u202e"
        if "causes" in told:
            told["causes"][0] |= {"effect": HOSTILE, "family": HOSTILE, "port": HOSTILE}
        (folder / name).write_text(json.dumps(told))
    opened = pamid.open_run(folder)
    assert isinstance(opened, pamid.DiagnosisResult)
    shown = opened._repr_html_() + pamid.FitResult._repr_html_(opened)
    assert "<script" not in shown and "&lt;script&gt;" in shown
    assert "\x1b" not in shown and "\u202e" not in shown
    table = pandas.DataFrame(
        {"time_s": 0.01 * np.arange(100), f"x{HOSTILE}_m": np.sin(np.arange(100.0))}
    )
    card = pamid.Recording.from_pandas(table, HOSTILE)._repr_html_()
    assert "<script" not in card and "&lt;script&gt;" in card


# ---- raw logs ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bench_mapping(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "map.toml"
    guessed = pamid.guess_mapping(
        BENCH_LOG, "one-dof", pressures="absolute", known={"inertia_kg_m2": 0.0896}, output=path
    )
    assert guessed.text == path.read_text() and not guessed.open and guessed.mapped > 3
    with pytest.raises(FileError, match="exists already"):
        pamid.guess_mapping(BENCH_LOG, output=path)
    return path


def test_a_model_is_exported_as_by_the_command(found, tmp_path):
    run = str(found.save(tmp_path / "run"))
    theirs, mine = tmp_path / "theirs" / "cart.m", tmp_path / "mine" / "cart.m"
    words = ["--to", "matlab", "--output", str(theirs), "--rig", RIG]
    assert frame.run(["export", run, *words]) == 0
    made = pamid.export(found, "matlab", output=mine, warn=lambda note: None)
    assert isinstance(made, pamid.ExportResult) and made.files == (str(mine),)
    assert mine.read_text() == theirs.read_text()
    assert made.to_dict()["schema"] == "pamid.export/1" and str(mine) in made.summary()
    with pytest.raises(FileError, match="exists already"):
        pamid.export(found, "matlab", output=mine, warn=lambda note: None)


def test_a_force_map_becomes_a_rig_as_by_the_command(tmp_path):
    muscle_map = Path("data/example/muscle_map.csv")
    words = ["--output", str(tmp_path / "theirs"), "--sets", "2"]
    assert frame.run(["force-law", str(muscle_map), *words]) == 0
    law = pamid.force_law(muscle_map, tmp_path / "mine", sets=2)
    assert isinstance(law, pamid.ForceLawResult)
    assert law.rig_file.read_text() == (tmp_path / "theirs" / law.rig_file.name).read_text()
    assert law.to_dict()["anfis"]["sets"] == 2 and "ANFIS 2x2" in law.summary()


def test_a_log_becomes_recordings_as_by_the_command(bench_mapping, tmp_path):
    words = ["--mapping", str(bench_mapping), "--output", str(tmp_path / "theirs" / "bench.csv")]
    assert frame.run(["ingest", str(BENCH_LOG), *words]) == 0
    output = tmp_path / "mine" / "bench.csv"
    seen: list[str] = []
    made = pamid.ingest(BENCH_LOG, bench_mapping, output=output, progress=seen.append)
    assert isinstance(made, pamid.IngestResult) and seen == ["0/1 bench_log.csv"]
    for theirs in (tmp_path / "theirs").iterdir():
        mine = output.with_name(theirs.name).read_text()
        assert mine.replace(str(output.parent), str(theirs.parent)) == theirs.read_text()
    (recording,) = made.recordings
    assert recording.known == {"inertia_kg_m2": 0.0896} and made.rig == recording.rig == "one-dof"
    assert str(output) in made.summary() and str(recording.time.size) in made._repr_html_()
    assert made.to_dict()["recordings"][0]["recording"]["samples"] == recording.time.size
    with pytest.raises(FileError, match="exists already"):
        pamid.ingest([BENCH_LOG], bench_mapping, output=output)


# ---- check, network, report, run folders -------------------------------------------------------


def test_a_network_is_added_to_a_run(fitted, tmp_path):
    folder = fitted.save(tmp_path / "run")
    lines: list[str] = []
    network = pamid.train_residual(folder, hidden=2, iterations=3, progress=lines.append)
    assert (network.kind, network.iterations, network.weights) == ("elman", 3, 13)
    assert {"refitted", "with_network"} <= network.errors["position_m"].keys()
    assert lines and lines[0].startswith(("0/3 ", "1/3 ")) and not network.interrupted
    assert "position_m" in network._repr_html_() and "elman" in repr(network)
    assert network.plot_training().get_suptitle()
    assert pamid.open_run(folder).errors["position_m"].with_network is not None
    page = pamid.report(network)
    assert page.page == folder / "report.html" and page.page.is_file()
