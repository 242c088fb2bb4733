"""What reaches the terminal: names cannot steer it, commands to copy hold, and a stream that fails
is told of."""

import json
import os
import shlex
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from pamid_cli import frame
from small_cart import RIG, record_cart

from pamid.base.errors import quoted
from pamid.base.printable_text import printable, printable_json

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


def test_nothing_that_steers_a_terminal_gets_through():
    for nasty in NASTY:
        assert not obeyed(printable(nasty)) and printable(nasty) != nasty
        as_json = json.dumps({nasty: nasty}, ensure_ascii=False, indent=1)
        assert not obeyed(printable_json(as_json)) and json.loads(printable_json(as_json)) == {
            nasty: nasty
        }
    plain = "Größe\tµm\n… 5 °C, ½ – ×\n"
    assert printable(plain) == plain


def test_names_of_columns_and_of_files_are_written_out(tmp_path, capfd):
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


@pytest.mark.parametrize("word", ODD)
def test_a_quoted_word_is_that_word_to_a_shell(word):
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
def test_commands_to_copy_hold_for_any_folder(odd, tmp_path, monkeypatch, capsys):
    place = tmp_path / odd
    place.mkdir()
    shutil.copy(RIG, place / "my rig.py")
    rig = str(place / "my rig.py")
    record_cart(place)
    (place / "rec.toml").write_text(f'[recording]\nrig = "{"my;touch x.py"}"\n')
    steps: list[list[str]] = [
        [
            *[
                "generate-aprbs",
                "--column",
                "force_n",
                "--duration",
                "9",
                "--amplitude",
                "3",
                "--seed",
                "1",
            ],
            *("--rig", rig, "--output", str(place / "sent.csv")),
        ],
        [
            *("simulate", "--rig", rig, "--excitation", str(place / "push.csv")),
            *("--output", str(place / "sim.csv")),
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
