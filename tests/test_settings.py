"""pamid.toml: what goes first, where a value comes from, what is wrong in it; and what shells complete."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from pamid_cli import frame
from pamid_cli.table import COMMANDS

EXAMPLE_MAP = Path(__file__).resolve().parent.parent / "data" / "example" / "muscle_map.csv"


def config(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert frame.run(["config", *words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert isinstance(found, dict)
    return found


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert frame.run([*words, "--json"]) == 3
    found = json.loads(capsys.readouterr().out)
    assert found["schema"] == "pamid.error/1"
    return str(found["message"])


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path / "pamid.toml"


def test_every_value_tells_where_it_comes_from(project: Path, monkeypatch: pytest.MonkeyPatch,
                                               capsys: pytest.CaptureFixture[str]) -> None:
    project.write_text('[defaults]\nseed = 7\njobs = 3\n[diagnose]\njobs = 4\nwithout = ["clock-skew"]\n')
    monkeypatch.setenv("PAMID_DIAGNOSE_SEED", "9")
    told = config(capsys)
    diagnose, fit = told["commands"]["diagnose"], told["commands"]["fit"]
    assert told["file"] == str(project)
    assert diagnose["jobs"] == {"value": 4, "origin": f"{project} [diagnose]"}
    assert diagnose["seed"] == {"value": 9, "origin": "environment, PAMID_DIAGNOSE_SEED"}
    assert diagnose["without"]["value"] == ["clock-skew"]
    assert diagnose["output"]["origin"] == "required"
    assert fit["seed"] == {"value": 7, "origin": f"{project} [defaults]"}
    assert fit["overwrite"] == {"value": False, "origin": "default"}


def test_the_file_of_a_folder_above_holds(project: Path, monkeypatch: pytest.MonkeyPatch,
                                          capsys: pytest.CaptureFixture[str]) -> None:
    project.write_text("[fit]\nseed = 3\n")
    (below := project.parent / "a" / "b").mkdir(parents=True)
    monkeypatch.chdir(below)
    assert config(capsys, "fit")["commands"]["fit"]["seed"]["value"] == 3


def test_a_command_takes_them_and_notes_them(project: Path, capsys: pytest.CaptureFixture[str],
                                             monkeypatch: pytest.MonkeyPatch) -> None:
    project.write_text("[generate-aprbs]\nduration = 4.0\namplitude = 5\nseed = 11\n")
    monkeypatch.setattr(sys, "argv", ["pamid", "generate-aprbs"])
    assert frame.run(["generate-aprbs", "--seed", "2", "--output", "a.csv"]) == 0
    assert frame.command_line() == ["pamid", "generate-aprbs", "--duration", "4.0", "--amplitude", "5"]
    capsys.readouterr()
    project.unlink()
    assert frame.run(["generate-aprbs", "--duration", "4", "--amplitude", "5", "--seed", "2", "--output", "b.csv"]) == 0
    assert Path("a.csv").read_bytes() == Path("b.csv").read_bytes()


def test_a_run_notes_what_it_was_given_elsewhere(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command line in run.json makes the same run where there is no pamid.toml."""
    project.write_text('[force-law]\nseed = 4\n')
    words = ["force-law", str(EXAMPLE_MAP), "--output", "law", "--sets", "2"]
    monkeypatch.setattr(sys, "argv", ["pamid", *words])
    assert frame.run(words) in (0, 5)
    noted = json.loads(Path("law/run.json").read_text())["command"]
    assert noted == ["pamid", *words, "--seed", "4"]


@pytest.mark.parametrize(("text", "said"), [
    ("[diagnos]\n", "Did you mean 'diagnose'?"),
    ("[defaults]\njobz = 2\n", "Did you mean 'jobs'?"),
    ("[diagnose]\njobs = 'two'\n", "[diagnose] jobs: 'two' is not a valid integer"),
    ("[diagnose]\njobs = 0\n", "[diagnose] jobs: 0 is not in the range"),
    ("[diagnose]\nseeed = 0\n", "Did you mean 'seed'?"),
    ("[diagnose]\noverwrite = 1\n", "neither true nor false"),
    ("[diagnose]\nseed = [1, 2]\n", "a list, where one value is wanted"),
    ("[diagnose.seed]\nx = 1\n", "a table, where a value is wanted"),
    ("jobs = 3\n", "is no command"),
    ("[diagnose\n", "is not TOML"),
    ("[diagnose]\njson = true\n", "no such option"),
])  # fmt: skip
def test_what_is_wrong_is_said_with_its_place(project: Path, capsys: pytest.CaptureFixture[str], text: str,
                                              said: str) -> None:
    project.write_text(text)
    message = refused(capsys, "diagnose", "rec.csv", "--output", "run")
    assert str(project) in message and said in message
    assert not (project.parent / "run").exists()


def test_a_file_that_is_no_text_is_refused(project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    project.write_bytes(b"\xff\xfe\x00")
    assert "UTF-8" in refused(capsys, "config")


def completions(words: str, at: int) -> list[str]:
    code = "from pamid_cli import main; main()"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True,
                           env={**os.environ, "_PAMID_COMPLETE": "bash_complete", "COMP_WORDS": words,
                                "COMP_CWORD": str(at)})
    assert not found.stderr
    return [line.partition(",")[2] for line in found.stdout.splitlines()]


def test_shells_complete_commands_options_rigs_and_effects() -> None:
    assert completions("pamid diag", 1) == ["diagnose"]
    assert completions("pamid diagnose --held", 2) == ["--held-out"]
    assert completions("pamid diagnose --rig o", 3) == ["one-dof"]
    assert "coulomb-friction" in completions("pamid effects co", 2)
    assert "angle-sensor-lag" in completions("pamid simulate --effect angle", 3)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_a_shell(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert frame.run(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert f"_PAMID_COMPLETE={shell}_complete" in script
    if shell == "bash" and shutil.which("bash"):
        subprocess.run(["bash", "-n"], input=script, text=True, check=True)


def test_no_command_is_without_its_settings(capsys: pytest.CaptureFixture[str]) -> None:
    assert set(config(capsys)["commands"]) == set(COMMANDS)
