"""What reaches the terminal: names cannot steer it, commands to copy hold, and a stream that fails
is told of."""

from __future__ import annotations

import io
import json
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from pamid_cli import frame
from pamid_cli.table import every_command
from small_cart import RIG, record_cart

from pamid.base.errors import quoted
from pamid.base.json_file import read_json, write_json
from pamid.base.printable_text import printable, printable_json
from pamid.base.progress import ProgressLine

NASTY = (
    "\x1b]0;owned\x07",
    "\x1b[2J",
    "\x9b31m",
    "a\rb",
    "\u202egnp.exe",
    "x\u200by",
    "\u2066",
    "\x7f",
    "\U000e0041",
    "\ufeff",
    "\udcff",
)
ODD = (
    "a b",
    "a;touch x",
    "it's",
    'a"b',
    "$(touch x)",
    "`touch x`",
    "a\nb",
    "-rf",
    "a\\b",
    "\x1b[31m",
    "\u202eb",
    "é",
    "~",
    "*",
    "a\tb",
    "\udcff",
)


def obeyed(text: str) -> list[str]:
    """Characters of a text that a terminal obeys or hides."""
    return [c for c in text if not (c.isprintable() or c in "\n\t")]


def test_nothing_that_steers_a_terminal_gets_through() -> None:
    for nasty in NASTY:
        assert not obeyed(printable(nasty)) and printable(nasty) != nasty
        as_json = json.dumps({nasty: nasty}, ensure_ascii=False, indent=1)
        assert not obeyed(printable_json(as_json)) and json.loads(printable_json(as_json)) == {
            nasty: nasty
        }
    plain = "Größe\tµm\n… 5 °C, ½ – ×\n"
    assert printable(plain) == plain


def test_names_of_columns_and_of_files_are_written_out(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    name = "angle\x1b[31m\u202e_deg"
    rows = [f"{0.01 * k:.2f},{np.sin(0.01 * k)},{np.cos(0.01 * k)}" for k in range(200)]
    path = str(tmp_path / "a\x1b[2J.csv")  # by hand: pamid writes no such name
    Path(path).write_text("\n".join([f"time_s,{name},x_deg", *rows]) + "\n")
    for words in (
        ["check", path],
        ["check", path + "x"],
        ["fit", path, "--rig", "one-dof", "--output", "x"],
        ["ingest", "--guess", path],
        ["\x1b[2J"],
        ["check", "--\x1b[2J"],
        ["check", path, "--rig", "\x1b[2J"],
        ["effects", "\x9b31m"],
        ["--\u202e"],
    ):
        for more in ([], ["--json"]):
            frame.run([*words, *more])
            told = capfd.readouterr()
            assert told.out or told.err
            assert not obeyed(told.out) and not obeyed(told.err), words
            if more:
                assert isinstance(json.loads(told.out), dict)


def test_texts_of_a_run_are_written_out(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], unchecked: None
) -> None:
    record_cart(tmp_path)
    run = tmp_path / "run"
    assert frame.run(["fit", str(tmp_path / "rec.csv"), "--rig", RIG, "--output", str(run)]) == 0
    fit = read_json(run / "fit.json")
    for key in ("rig", "schema", "why"):
        write_json(run / "fit.json", {**fit, key: "\x1b[2J\u202e"})
        for words in (
            ["report", str(run)],
            ["export", str(run), "--to", "c", "--output", str(tmp_path / "c")],
            ["fit", str(tmp_path / "rec.csv"), "--rig", RIG, "--output", str(run), "--resume"],
        ):
            frame.run(words)
            told = capfd.readouterr()
            assert not obeyed(told.out + told.err), words


def test_progress_is_written_out(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr("pamid.base.progress._LIVE_S", 0.0)
    stream = Terminal()
    with ProgressLine("fit\x1b[2J", stream=stream) as progress:
        progress.update(1, "\x1b]0;x\x07\nmore")
    assert (
        "\x1b[2J" not in stream.getvalue()
        and "\x07" not in stream.getvalue()
        and "\n" not in stream.getvalue()
    )


@pytest.mark.parametrize("word", ODD)
def test_a_quoted_word_is_that_word_to_a_shell(word: str) -> None:
    told = quoted(word)
    assert not obeyed(told) and "\n" not in told and not told.startswith("-")
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("no bash")
    said = subprocess.run(
        [os.fsencode(bash), b"-c", os.fsencode(f"printf %s {told}")], capture_output=True
    ).stdout
    assert said == os.fsencode(f"./{word}" if word.startswith("-") else word)


@pytest.mark.parametrize("odd", ["a b; touch x", "it's\na\x1b[31m"])
def test_commands_to_copy_hold_for_any_folder(
    odd: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    place = tmp_path / odd
    place.mkdir()
    shutil.copy(RIG, place / "my rig.py")
    rig = str(place / "my rig.py")
    record_cart(place)
    (place / "rec.toml").write_text(f'[recording]\nrig = "{"my;touch x.py"}"\n')
    steps: list[list[str]] = [
        [
            "generate-aprbs",
            "--rig",
            rig,
            "--column",
            "force_n",
            "--duration",
            "9",
            "--amplitude",
            "3",
            "--hold",
            "0.2",
            "0.8",
            "--seed",
            "1",
            "--output",
            str(place / "sent.csv"),
        ],
        [
            "simulate",
            "--rig",
            rig,
            "--excitation",
            str(place / "push.csv"),
            "--output",
            str(place / "sim.csv"),
        ],
        ["fit", str(place / "sim.csv"), "--rig", rig, "--output", str(place / "run")],
        ["ingest", "--guess", str(place / "push.csv"), "--output", str(place / "map.toml")],
    ]
    for words in steps:
        code = frame.run(words)
        told = capsys.readouterr()
        assert code in (0, 5), told.err
        follow = told.out[told.out.index("Next:") :]
        assert "\n" not in follow.rstrip("\n") and not obeyed(follow)
        if "$'" not in follow:
            assert any(str(place) in word for word in shlex.split(follow.removeprefix("Next:"))), (
                follow
            )
    assert frame.run(["fit", str(place / "rec.csv"), "--output", str(place / "other")]) == 3
    assert "--rig 'my;touch x.py'" in capsys.readouterr().err


# ---- streams that fail --------------------


def pamid(*words: str, shell: str) -> subprocess.CompletedProcess[str]:
    """A command as a shell starts it, with what follows it on the line."""
    line = f"{shlex.join([sys.executable, '-m', 'pamid_cli', *words])} {shell}"
    return subprocess.run(["bash", "-c", line], capture_output=True, text=True)


needs_full = pytest.mark.skipif(
    not Path("/dev/full").exists() or shutil.which("bash") is None, reason="no /dev/full"
)


@needs_full
@pytest.mark.parametrize(
    "words",
    [
        ("effects",),
        ("--help",),
        ("--version",),
        ("completion", "bash"),
        ("rigs", "--json"),
        ("nonsense", "--json"),
    ],
)
@pytest.mark.parametrize("shell", [">/dev/full", ">&-"])
def test_a_result_that_cannot_be_printed_is_told(words: tuple[str, ...], shell: str) -> None:
    done = pamid(*words, shell=shell)
    wrong_call = words[0] == "nonsense"
    # click prints them, and misses nothing
    silent = shell == ">&-" and words[0] in ("--help", "--version")
    assert done.returncode == (2 if wrong_call else 0 if silent else 3), done.stderr
    assert "Traceback" not in done.stderr and "Exception ignored" not in done.stderr
    assert silent or "pamid: error: " in done.stderr


@needs_full
def test_nobody_reading_what_stands_beside_the_result_is_no_error(tmp_path: Path) -> None:
    for shell in ("2>/dev/full", "2>&-", "| head -n 1", "<&-"):
        done = pamid("effects", shell=shell)
        assert done.returncode == 0 and done.stdout, shell
        assert "Traceback" not in done.stderr
    assert pamid("nonsense", shell="2>/dev/full").returncode == 2
    assert pamid("effects", shell="| true; exit ${PIPESTATUS[0]}").returncode == 0
    done = pamid("check", str(record_cart(tmp_path)), "--rig", RIG, shell=">&- 2>&- <&-")
    assert done.returncode == 3


def test_the_old_word_for_overwriting_is_heard_and_not_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["generate-aprbs", "--duration", "20", "--output", str(tmp_path / "a.csv")]
    assert frame.run(words) == 0 and frame.run(words) == 3
    assert "--overwrite" in capsys.readouterr().err
    assert frame.run([*words, "--force"]) == 0 and frame.run([*words, "--overwrite"]) == 0
    monkeypatch.setenv("PAMID_GENERATE_APRBS_FORCE", "1")
    assert frame.run(words) == 0
    monkeypatch.delenv("PAMID_GENERATE_APRBS_FORCE")
    (tmp_path / "pamid.toml").write_text("[generate-aprbs]\nforce = true\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))  # only there a file may give leave to replace
    assert frame.run(words) == 0
    capsys.readouterr()
    overwriting = []
    for command in every_command():
        assert frame.run([str(command.name), "--help"]) == 0
        told = capsys.readouterr().out
        assert "--force" not in told.replace("--force-", "")
        overwriting += [command.name] if "--overwrite" in told else []
    assert len(overwriting) == 16
    assert frame.run(["config", "simulate", "--json"]) == 0
    options = json.loads(capsys.readouterr().out)["commands"]["simulate"]
    assert "overwrite" in options and "force" not in options
