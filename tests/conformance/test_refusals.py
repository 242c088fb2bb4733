"""What is said where something is refused: how to mend it, once, and never the very thing that was
given; and that nothing outside pamid, a stream, a folder or a home that is gone, is called a fault
of pamid."""

import errno
import io
import json
import os
import pwd
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pamid_cli.frame import run

from pamid.base.errors import PamidError
from pamid.base.json_file import read_json
from pamid.base.toml_file import read_toml

ROWS = [
    f"{0.003 * k:.6g},{np.sin(k / 9):.6f},{40 * np.sin(k / 11):.6f},{k % 3}" for k in range(420)
]
HEAD = "time_s,command,angle_deg,force_1_n"
Files = dict[str, bytes | str]


def table(*lines: str) -> Files:
    return {"rec.csv": "\n".join(lines) + "\n"}


def put(folder: Path, files: Files) -> Path:
    for name, content in files.items():
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return folder / "rec.csv"


# ---- words, files and streams that used to be called a fault of pamid --------------------------


@pytest.mark.parametrize(
    "text",
    [
        f'{{"a": {"9" * 400}}}',
        f'{{"a": {"9" * 5000}}}',
        '{"a": 1e999}',
        '{"a": NaN}',
        "[" * 100_000,
        '"\\ud800',
        "",
    ],
)
def test_numbers_and_depths_that_no_json_of_pamid_has(text, tmp_path):
    (tmp_path / "fit.json").write_text(text)
    with pytest.raises(PamidError) as caught:
        read_json(tmp_path / "fit.json")
    assert caught.value.exit_code == 3


def test_whole_numbers_of_toml_have_64_bits(tmp_path):
    (tmp_path / "x.toml").write_text(f"a = [{2**63 - 1}, {-(2**63)}, 1e300]\n")
    assert read_toml(tmp_path / "x.toml") == {"a": [2**63 - 1, -(2**63), 1e300]}
    (tmp_path / "x.toml").write_text(f"[a]\nb = [{{c = {2**63}}}]\n")
    with pytest.raises(PamidError, match="more than 19 digits"):
        read_toml(tmp_path / "x.toml")


@pytest.mark.parametrize(
    "line",
    [
        "seed = inf",
        "seed = nan",
        "seed = 1979-05-27",
        f"seed = {'9' * 5000}",
        "seed = [07:32:00]",
        f"seed = {'[' * 3000}",
        "output = ''",
        "effect = [inf]",
        "seed = {a = 1}",
    ],
)
@pytest.mark.parametrize("command", [["config"], ["fit", "x.csv"]], ids=["config", "fit"])
def test_settings_of_another_kind(line, command, here, cli):
    (here / "pamid.toml").write_text(f"[fit]\n{line}\n")
    assert "pamid.toml" in cli(*command, code=3)["message"]


class Full(io.StringIO):
    """As /dev/full: nothing more can be written."""

    def write(self, text: str, /) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize(
    "words",
    [["effects"], ["effects", "--json"], ["fit", "no.csv", "--output", "x", "--json"], ["--help"]],
    ids=" ".join,
)
def test_a_full_standard_output(words, monkeypatch, capsys):
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", Full())
        assert run(words) == 3
    told = capsys.readouterr().err
    assert "fault" not in told and ("no.csv" in words or "No space left" in told)


@pytest.mark.skipif(os.name != "posix", reason="a shell of POSIX")
@pytest.mark.parametrize(
    ("words", "code"),
    [("effects >&-", 3), ("fit no.csv --output x 2>&-", 3), ("effects >/dev/full", 3)],
)
def test_streams_that_are_closed_or_full(words, code):
    done = subprocess.run(
        ["sh", "-c", f"{sys.executable} -m pamid_cli {words}"],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert (
        done.returncode == code
        and "Traceback" not in done.stderr
        and "Exception ignored" not in done.stderr
    ), done


def test_names_that_are_no_text(tmp_path):
    """On Linux a file is named by bytes; those that are no letters are spelt out, in JSON as its
    own escapes."""
    name = os.fsdecode(b"\xff.csv")
    put(tmp_path, {name: "\n".join([HEAD, *ROWS]), "rec.csv": ""})
    for encoding, more in (("utf-8", ["--json"]), ("latin-1", ["--json"]), ("latin-1", [])):
        done = subprocess.run(
            [sys.executable, "-m", "pamid_cli", "check", name, *more],
            capture_output=True,
            cwd=tmp_path,
            env={**os.environ, "PYTHONIOENCODING": f"{encoding}:strict"},
            timeout=300,
        )
        assert done.returncode == 0, done
        if more:
            assert json.loads(done.stdout)["file"] == name
        else:
            assert done.stdout.startswith(b"\\udcff.csv: 420 samples"), done


def test_a_working_folder_that_was_removed(tmp_path, monkeypatch, capsys, cli):
    path = put(tmp_path, table(HEAD, *ROWS))
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert run(["effects", "--json"]) == 0
    assert run(["check", str(path), "--json"]) == 0
    capsys.readouterr()
    assert (
        cli("simulate", "--excitation", "rec.csv", "--output", "out.csv", code=3)["code"]
        != "unexpected"
    )


@pytest.fixture
def homeless(monkeypatch) -> None:
    """No HOME, and nobody in the password file."""

    def nobody(_):
        raise KeyError("uid not found")

    monkeypatch.setattr(pwd, "getpwuid", nobody)
    for name in ("HOME", "XDG_CACHE_HOME", "PAMID_CACHE", "NUMBA_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)


def test_without_a_home_compiled_code_has_a_private_folder(homeless, monkeypatch):
    from pamid.engine import cache_folder as place
    from pamid.engine import numba_cache
    from pamid.engine.jit_cache import cache_folder

    folder = cache_folder()
    assert folder == place.private_folder() / "pamid" and folder.is_absolute()
    assert place.private_folder().stat().st_mode & 0o077 == 0
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")  # and whatever it becomes is undone
    access, own = os.access, Path(numba_cache.__file__).parent
    monkeypatch.setattr(os, "access", lambda path, mode: path != own and access(path, mode))
    monkeypatch.setattr(numba_cache.config, "CACHE_DIR", "", raising=False)
    numba_cache._settle()
    assert os.environ["NUMBA_CACHE_DIR"] == str(place.private_folder()), (
        "numba would take ./~/.cache"
    )
    monkeypatch.setenv("HOME", "/nonexistent/home")
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    numba_cache._settle()
    assert os.environ["NUMBA_CACHE_DIR"] == str(place.private_folder()), (
        "numba would find no place and give up"
    )


def test_without_a_home_a_command_runs(homeless, tmp_path, capsys):
    path = put(tmp_path, table(HEAD, *ROWS))
    card, made = tmp_path / "card.png", tmp_path / "x.csv"
    assert run(f"check {path} --rig one-dof --figure {card} --json".split()) == 0
    assert card.is_file()
    assert run(f"simulate --excitation {path} --rig one-dof --output {made}".split()) == 0


# ---- messages that contradicted --------------------


def test_a_column_of_another_rig_is_not_sent_to_this_one(tmp_path, capsys):
    """What `Next:` proposed was refused."""
    nexts = {}
    for column in ("force_n", "reference_deg", "reference_psi"):
        words = ["generate-aprbs", "--column", column, "--amplitude", "2", "--duration", "20"]
        assert run([*words, "--output", str(tmp_path / f"{column}.csv")]) == 0
        nexts[column] = re.search(r"^Next: (.*)$", capsys.readouterr().out, re.MULTILINE)
    assert nexts["reference_deg"] and nexts["reference_deg"][1].startswith(
        "pamid simulate --rig one-dof"
    )
    for other in ("force_n", "reference_psi"):
        assert nexts[other] and nexts[other][1].startswith(
            "send it to your rig. To simulate it, give a suitable rig with --rig"
        )
