"""pamid.toml: what goes first, where a value comes from, what is wrong in it; and what shells
complete."""

import os
import re
import sys
from pathlib import Path
from typing import Any

import click
import pytest
from conftest import Cli
from pamid_cli import frame, settings_files
from pamid_cli.table import every_command

from pamid.base import trust

EXAMPLES = Path(__file__).resolve().parents[2] / "data" / "example"
EXAMPLE_MAP, RECORDING = EXAMPLES / "muscle_map.csv", EXAMPLES / "joint.csv"


@pytest.fixture
def project(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path / "pamid.toml"


def test_the_file_of_a_folder_above_holds(project, monkeypatch, cli):
    project.write_text("[fit]\nseed = 3\n")
    (below := project.parent / "a" / "b").mkdir(parents=True)
    monkeypatch.chdir(below)
    assert cli("config", "fit")["commands"]["fit"]["seed"]["value"] == 3


def test_a_command_takes_them_and_notes_them(project, capsys, monkeypatch):
    project.write_text("[generate-aprbs]\nduration = 4.0\namplitude = 5\nseed = 11\n")
    monkeypatch.setattr(sys, "argv", ["pamid", "generate-aprbs"])
    assert frame.run(["generate-aprbs", "--seed", "2", "--output", "a.csv"]) == 0
    words = ["pamid", "generate-aprbs", "--duration", "4.0", "--amplitude", "5"]
    assert frame.command_line() == words
    capsys.readouterr()
    project.unlink()
    assert frame.run([*words[1:], "--seed", "2", "--output", "b.csv"]) == 0
    assert Path("a.csv").read_bytes() == Path("b.csv").read_bytes()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[diagnos]\n", "Did you mean 'diagnose'?"),
        ("[defaults]\njobz = 2\n", "Did you mean 'jobs'?"),
        ("[diagnose]\njobs = 'two'\n", "[diagnose] jobs: 'two' is not a valid integer"),
        ("[diagnose]\njobs = 0\n", "[diagnose] jobs: 0 is not in the range"),
        ("[diagnose]\nseeed = 0\n", "Did you mean 'seed'?"),
        ("[diagnose]\noverwrite = 1\n", "neither true nor false"),
        ("[diagnose]\nseed = [1, 2]\n", "a list, but must be a single value"),
        ("[diagnose.seed]\nx = 1\n", "a table, but must be a single value"),
        ("jobs = 3\n", "there is no command [jobs]"),
        ("[diagnose\n", "is not TOML"),
        ("[diagnose]\njson = true\n", "no such option"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(project, cli, text, said):
    project.write_text(text)
    message = cli("diagnose", "rec.csv", "--output", "run", code=3)["message"]
    assert str(project) in message and said in message
    assert not (project.parent / "run").exists()


# ---- whose settings are believed --------------------

RISKY = (
    '[check]\nrig = "./rig.py"\n[fit]\nrig = "./rig.py"\ncluster = "tcp://127.0.0.1:1"\noverwrite '
    "= true\n"
    'seed = 3\nheld-out = ["b.csv"]\n'
)
RIG = """open(__file__ + ".ran", "w").close()
from pamid.rigs.one_dof import *
"""


def values(cli: Cli, command: str = "fit") -> dict[str, Any]:
    return {
        name: about["value"] for name, about in cli("config", command)["commands"][command].items()
    }


def test_code_an_address_and_leave_to_replace_come_from_my_own_file_at_home(project, cli):
    project.write_text(RISKY)
    found = values(cli)
    assert (found["rig"], found["cluster"], found["overwrite"]) == (
        "./rig.py",
        "tcp://127.0.0.1:1",
        True,
    )
    assert cli("config")["harmless_only"] == "" and cli("config")["ignored"] == {}


def test_outside_my_home_the_working_folder_gives_harmless_options_only(
    project, capsys, cli, monkeypatch
):
    monkeypatch.setenv("HOME", str(project.parent / "home"))
    project.write_text(RISKY)
    (project.parent / "rig.py").write_text(RIG)
    found = values(cli)
    assert (found["rig"], found["cluster"], found["overwrite"]) == (None, None, False)
    assert found["seed"] == 3 and found["held-out"] == ["b.csv"]  # and the rest counts
    assert frame.run(["check", str(RECORDING)]) == 0
    told = capsys.readouterr().err
    assert (
        f"{project}: [check] rig is ignored, because the file lies outside your home. Give --rig"
        in told
    )
    assert not (project.parent / "rig.py.ran").exists()
    assert (
        frame.run(["check", str(RECORDING), "--rig", "one-dof"]) == 0
        and "is ignored" not in capsys.readouterr().err  # progress may show on a busy machine
    )
    assert "outside your home" in cli("config")["harmless_only"]
    # a name of the catalogue runs nothing
    project.write_text('[fit]\nrig = "two-link"\n')
    assert values(cli)["rig"] == "two-link" and not capsys.readouterr().err


def test_of_the_folders_above_only_those_of_my_home_count(project, capsys, cli, monkeypatch):
    """A pamid.toml in a folder above the working folder once ran a rig file that nobody had
    named."""
    project.write_text(RISKY)
    (project.parent / "rig.py").write_text(RIG)
    (below := project.parent / "below").mkdir()
    monkeypatch.chdir(below)
    assert values(cli)["seed"] == 3
    monkeypatch.setenv("HOME", str(below))
    assert frame.run(["check", str(RECORDING)]) == 0
    assert (
        f"Warning: {project} is ignored: it lies above the working folder and outside your home."
        in capsys.readouterr().err
    )
    assert values(cli)["seed"] == 0 and cli("config")["ignored"][str(project)]
    assert not (project.parent / "rig.py.ran").exists()
    (below / "pamid.toml").write_text("[fit]\nseed = 5\n")  # the nearer one goes first
    capsys.readouterr()
    assert values(cli)["seed"] == 5 and not capsys.readouterr().err


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files without owners")
@pytest.mark.parametrize(
    ("place", "mode"),
    [("pamid.toml", 0o666), ("", 0o777), ("", 0o1777), ("..", 0o777), ("pamid.toml", 0o622)],
)
def test_what_others_may_write_is_ignored(tmp_path, capsys, cli, place, mode, monkeypatch):
    (folder := tmp_path / "shared" / "project").mkdir(parents=True)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(folder)
    (folder / "pamid.toml").write_text("[fit]\nseed = 5\n")
    assert values(cli)["seed"] == 5
    (folder / place).resolve().chmod(mode)
    told = cli("config", "fit")
    assert told["commands"]["fit"]["seed"]["value"] == 0 and told["file"] is None
    assert "others may write" in told["ignored"][str(folder / "pamid.toml")]
    assert frame.run(["config"]) == 0
    assert f"Ignored: {folder / 'pamid.toml'}: others may write" in capsys.readouterr().out


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files without owners")
def test_whose_file_it_is(tmp_path, monkeypatch):
    """Ownership by what the file system says; another user is played, as tests may not be root."""
    file = tmp_path / "pamid.toml"
    file.write_text("")
    assert trust.why_shared(file) == "" and trust.is_users_file(file)
    me = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: me + 1)  # now it is somebody else's
    assert not trust.is_users_file(file)
    if me:
        assert "belongs to another user" in trust.why_shared(file)
    # root's are believed, for harmless options
    else:
        assert trust.why_shared(file) == ""


def test_every_option_that_runs_a_file_is_known_as_one():
    """A new command's --rig or --effect would otherwise be taken from anybody's settings."""
    running = [
        (c.name, o)
        for c in every_command()
        for o in c.params
        if isinstance(o, click.Option)
        and re.search(r"\bit is run\b|\(name or file\)", o.help or "")
    ]
    assert len(running) > 10
    assert [(c, o.name) for c, o in running if not settings_files.is_risky(o, ["./evil.py"])] == []
    flags = [
        o for c in every_command() for o in c.params if {"--force", "--overwrite"} & set(o.opts)
    ]
    assert flags and all(
        settings_files.is_risky(o, True) for o in flags if isinstance(o, click.Option)
    )
