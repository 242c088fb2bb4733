"""What data cannot do either: be evaluated or unpickled anywhere, leave the folder of its run, or
break out of the quotes and comments of the files that pamid writes from it."""

import json
import shutil
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from identified_runs import SEEN, fitted_run, put_network, random_network
from pamid_cli import frame
from synthetic_run import diagnosis_json, fit_json, make_run
from virtual_joint import record

from pamid.base.errors import FileError
from pamid.intake.logs.guessed_mapping import guess_of
from pamid.intake.logs.log_reader import read_log
from pamid.networks.elman import Elman
from pamid.recording.recording import toml_text
from pamid.report.writing import write_report
from pamid.simulation.excitation.writers import FORMATS, SentSignals

# ---- a run stays in its folder --------------------


def test_nothing_is_written_or_removed_through_a_link(tmp_path, undrawn, cli):
    """A run folder is anybody's: its `figures` may be a link into the user's own pictures."""
    run, own = make_run(tmp_path / "run"), tmp_path / "pictures"
    own.mkdir()
    for name in ("window.png", "targets.png", "motion.gif"):
        (own / name).write_text("mine")
    (run / "figures").symlink_to(own)
    with pytest.raises(FileError, match="is a link"):
        write_report(run)
    assert "is a link" in cli("animate", run, code=3)["message"]
    assert {path.name: path.read_text() for path in own.iterdir()} == dict.fromkeys(
        ("window.png", "targets.png", "motion.gif"), "mine"
    )
    assert not (run / "report.html").exists()


def test_a_page_vouches_for_nothing_outside_its_run(tmp_path, undrawn):
    diagnosis = diagnosis_json("explained")
    assert (
        "next-experiment.csv"
        in write_report(make_run(tmp_path / "good", diagnosis=diagnosis)).page.read_text()
    )
    diagnosis["next_experiment"]["excitation"] = "../../other.csv"
    assert (
        "other.csv"
        not in write_report(make_run(tmp_path / "bad", diagnosis=diagnosis)).page.read_text()
    )
    fit = fit_json()
    fit["recordings"][0]["path"] = "rec.csv; touch stolen"
    run = make_run(tmp_path / "fit", fit=fit)
    (run / "diagnosis.json").unlink()
    assert (
        "pamid diagnose &#39;rec.csv; touch stolen&#39; --rig" in write_report(run).page.read_text()
    )


# ---- names in what is written --------------------

NASTY = (
    'a"b',
    "a'b",
    "a\nrig = './evil.py'",
    "a]\n[recording",
    "a = 1\nrig",
    "a\\",
    "*/ int x; /*",
    "*) x := 1; (*",
    "\x00\x1b[2J",
    "\u202egnp",
    "a\r\nb",
    '"""',
    "#",
)


@pytest.mark.parametrize("nasty", NASTY)
def test_names_cannot_leave_their_place_in_toml(nasty):
    tables = {
        "recording": {"rig": nasty, "loop": "open"},
        "known": {nasty: 1.0, "inertia_kg_m2": 0.5},
    }
    assert tomllib.loads(toml_text(tables)) == tables


@pytest.mark.parametrize("nasty", NASTY[:7])
def test_names_of_a_log_cannot_leave_their_place_in_a_mapping(nasty, tmp_path):
    quoted = nasty.replace('"', '""')
    rows = "".join(f"{0.003 * k:.3f},{np.sin(k / 20):.4f},{k % 3}\n" for k in range(300))
    (tmp_path / "log.csv").write_text(
        f'time,"angle {quoted} [deg]","{quoted} [{quoted}]"\n{rows}', encoding="utf-8", newline=""
    )
    found = guess_of(read_log(tmp_path / "log.csv"), None, "")
    told = tomllib.loads(found.text)
    assert set(told) <= {
        "loop",
        "time",
        "signals",
        "atmosphere",
        "known",
    }


@pytest.mark.parametrize("form", ["st", "h"])
def test_names_cannot_leave_the_comments_of_an_excitation(form):
    about = "pamid */ int stolen; /* *) stolen : BOOL; (*\nstolen"
    content = FORMATS[form].content
    assert content is not None
    text = content(
        SentSignals({"command": np.array([0.0, 1.0, 1.0])}, 0.003, "sent", about)
    ).decode()
    outside = text.split("*/" if form == "h" else "*)")
    assert "stolen" in outside[0] and not any(
        "stolen" in part.split("/*" if form == "h" else "(*")[0] for part in outside[1:]
    )


@pytest.fixture(scope="module")
def fitted(tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("fitted")
    fitted_run(place / "run", record(place / "rec.csv", 6.0).path)
    put_network(place / "run", random_network(Elman(len(SEEN), 2), SEEN, "angle_deg", 1.0))
    return place / "run"


INJECTED = "x\n*/ int stolen(void) { return 1; } /* \" 'stolen"
#: texts of a run that an export has to find as they were: everything else may say what it likes
NAMES = (
    "schema",
    "rig",
    "effects",
    "channels",
    "name",
    "path",
    "sha256",
    "loop",
    "kind",
    "enters",
    "model",
    "file",
)


def poisoned(node: Any, key: str = "") -> Any:
    """The same with something else in all texts that are no names."""
    if isinstance(node, dict):
        return {k: poisoned(v, k) for k, v in node.items()}
    if isinstance(node, list):
        return [poisoned(one, key) for one in node]
    return f"{node}{INJECTED}" if isinstance(node, str) and key not in NAMES else node


def misnamed(node: Any) -> Any:
    """The same with something else in every name: of parameters, channels, effects, rigs,
    inputs."""
    if isinstance(node, dict):
        return {
            f"{k}{INJECTED}" if "_" in k and k not in ("n_weights", "period_s") else k: misnamed(v)
            for k, v in node.items()
        }
    if isinstance(node, list):
        return [misnamed(one) for one in node]
    return (
        f"{node}{INJECTED}"
        if isinstance(node, str) and "pamid." not in node and len(node) < 64
        else node
    )


@pytest.mark.parametrize("form", ["c", "matlab"])
def test_no_text_of_a_run_becomes_source(form, fitted, tmp_path, unchecked, capsys):
    """Names in exported source are those of the rig and its effects: what a run calls otherwise is
    refused. Its texts (why a fit ended, where a value is from) are not written at all."""

    def exported(run, which):
        out = run / ("out" if form == "c" else "out.m")
        frame.run(["export", str(run), "--to", form, "--which", which, "--output", str(out)])
        capsys.readouterr()
        files = [out] if out.is_file() else list(out.glob("*.[ch]"))
        return [path.read_text() for path in files]

    files = {
        name: json.loads((fitted / name).read_text())
        for name in ("run.json", "fit.json", "network.json")
    }
    for number, change in enumerate((poisoned, *[misnamed] * len(files))):
        shutil.copytree(fitted, run := tmp_path / str(number))
        for name in list(files) if number == 0 else list(files)[number - 1 : number]:
            (run / name).write_text(json.dumps(change(files[name])))
        made = [text for which in ("refitted", "network") for text in exported(run, which)]
        assert made or number, "as its texts are no names, the model is exported"
        assert not any("stolen" in text for text in made)
