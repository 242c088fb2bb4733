"""`pamid runs` and `pamid report --compare`: runs at a glance and side by side."""

import json
import shlex
import shutil
from pathlib import Path

import pytest
from pamid_cli.frame import run
from report_pages import flat, outline_of
from synthetic_run import make_run, make_trial

from pamid.report.pdf import installed_browser


def test_runs_are_listed_with_their_verdicts(tmp_path, capsys, cli):
    make_run(tmp_path / "a" / "first")
    make_run(tmp_path / "second", "no-structural-gap")
    make_run(tmp_path / "fitted", without=("diagnosis.json",))
    make_trial(tmp_path / "trial")
    (tmp_path / "empty").mkdir()
    found = cli("runs", str(tmp_path))
    rows = {Path(one["path"]).name: one for one in found["runs"]}
    assert list(rows) == ["first", "fitted", "second", "trial"]
    assert rows["first"]["verdict"] == "explained"
    assert rows["first"]["causes"] == ["coulomb-friction"]
    assert rows["first"]["mae"]["angle_deg"]["refitted"] == 0.52
    assert rows["first"]["command"] == "diagnose" and rows["first"]["recordings"] == ["rec"]
    assert [rows[name]["kind"] for name in ("fitted", "second", "trial")] == [
        "fit",
        "diagnosis",
        "trial",
    ]
    assert run(["runs", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert "removes 86 % of the gap" in text
    following = shlex.split(text.partition("Next: pamid ")[2])
    assert following[:2] == ["report", "--compare"]
    assert run([*following, "--output", str(tmp_path / "both.html")]) == 0


@pytest.fixture
def pair(tmp_path) -> tuple[Path, Path]:
    """Two runs of other recordings; one parameter moved beyond its intervals, one cause other."""
    first = make_run(tmp_path / "monday" / "RUN")
    second = tmp_path / "friday" / "RUN"
    shutil.copytree(first, second)
    fit = json.loads((second / "fit.json").read_text(encoding="utf-8"))
    fit["recordings"][0] |= {"name": "later", "sha256": "cd" * 32}
    (second / "fit.json").write_text(json.dumps(fit), encoding="utf-8")
    found = json.loads((second / "diagnosis.json").read_text(encoding="utf-8"))
    found["causes"][0]["effect"] = "stribeck-friction"
    moved = found["parameters"]["damping_m2_s"]
    moved |= {key: 2.0 * moved[key] for key in ("value", "low", "high")}
    (second / "diagnosis.json").write_text(json.dumps(found), encoding="utf-8")
    return first, second


def test_runs_side_by_side(pair, tmp_path, cli):
    page = tmp_path / "both.html"
    words = ("report", "--compare", *map(str, pair), "--output", str(page))
    found = cli(*words)
    assert found["changed"] == ["recordings", "content (sha256)"]
    assert [one["causes"] for one in found["runs"]] == [["coulomb-friction"], ["stribeck-friction"]]
    text = flat(outline_of(page).text)
    assert "The runs differ: monday/RUN gives Coulomb friction; friday/RUN gives Stribeck" in text
    rows = text.split("damping_m2_s")[1].split("sonic_conductance")[0]
    assert "differs" in rows and "0.00160" in rows and "0.00320" in rows
    assert "agrees" in text.split("dead_volume_m3")[1][:120]
    again = page.read_bytes()
    if installed_browser() is not None:
        assert run([*words, "--pdf"]) == 0 and page.read_bytes() == again
        assert page.with_suffix(".pdf").read_bytes().startswith(b"%PDF")
