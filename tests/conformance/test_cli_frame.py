"""The frame of the command line: quick help, one JSON object, exit codes, nearest names."""

import json
import os
import shlex
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import pytest
from pamid_cli import frame
from pamid_cli.table import COMMANDS

from pamid.base.errors import ConvergenceError, DataError, FileError, UsageError

HEAVY = ("pamid.model", "numpy", "scipy", "pandas", "pydantic", "torch", "numba", "matplotlib")
Planted = Callable[[Callable[[], frame.Result]], None]


@dataclass(frozen=True)
class Nothing:
    """A test."""


@pytest.fixture
def planted(monkeypatch) -> Planted:
    """Make `pamid plant` run a function of the test."""

    def plant(function):
        made = frame.command("plant", Nothing, example="pamid plant")(lambda _: function())
        module = type(sys)("pamid_cli.plant")
        module.command = made  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "pamid_cli.plant", module)
        monkeypatch.setitem(COMMANDS, "plant", "A test.")

    return plant


def _object(text: str) -> dict[str, Any]:
    found = json.loads(text)
    assert isinstance(found, dict)
    return found


HELP = f"""
import sys
from pamid_cli.frame import run
for name in sys.argv[1:]:
    assert run([name, "--help"] if name else ["--help"]) == 0
    print("loaded", [m for m in {HEAVY!r} if m in sys.modules])
"""


def test_help_is_light_and_ends_with_an_example():
    words = [sys.executable, "-c", HELP, "", *COMMANDS]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    whole, *bodies, end = done.stdout.split("loaded []\n")
    assert end == "" and all(name in whole for name in COMMANDS)
    for name, body in zip(COMMANDS, bodies, strict=True):
        example = body.rpartition("\nExample:\n")[2].rstrip("\n")
        assert example and all(line.startswith("  ") for line in example.splitlines()), name
        assert f"pamid {name}" in example
        assert "--json" in body and "--debug" in body


def test_every_command_file_is_found():
    """One whose head cannot be read would be no command, and nobody would be told."""
    files = Path(frame.__file__).parent.glob("*.py")
    decorated = {f.stem.replace("_", "-") for f in files if "\n@frame.command(" in f.read_text()}
    assert decorated == set(COMMANDS)


@pytest.mark.slow
def test_examples_run_one_after_the_other(tmp_path):
    """In the order of the table, in one folder: what one example writes, the next may read; data/
    lies in it. What is made of a fitted model comes last."""
    (tmp_path / "data").symlink_to(Path(__file__).resolve().parents[2] / "data")
    lines: list[str] = []
    for name in COMMANDS:
        found = subprocess.run(
            [sys.executable, "-m", "pamid_cli", name, "--help"], capture_output=True, text=True
        )
        lines += found.stdout.rpartition("\nExample:\n")[2].splitlines()
    for line in sorted(lines, key=lambda one: "--model fitted" in one):
        words = shlex.split(line, comments=True)
        if words:
            done = subprocess.run(
                [sys.executable, "-m", "pamid_cli", *words[1:]],
                cwd=tmp_path,
                capture_output=True,
                text=True,
            )
            assert done.returncode == 0, f"{line}\n{done.stderr}"


ERRORS = [(UsageError, 2), (FileError, 3), (DataError, 4), (ConvergenceError, 5)]


@pytest.mark.parametrize(("kind", "code"), ERRORS)
def test_exit_codes(kind, code, planted, capsys):
    def fail():
        raise kind("What.", "How.")

    planted(fail)
    assert frame.run(["plant"]) == code
    assert capsys.readouterr().err == "pamid: error: What.\n  How.\n"
    assert frame.run(["plant", "--json"]) == code
    captured = capsys.readouterr()
    assert _object(captured.out)["message"] == "What." and captured.err == ""


def test_unexpected_errors(planted, capsys):
    def fail():
        raise ZeroDivisionError("division\nby zero")

    planted(fail)
    assert frame.run(["plant"]) == 1
    told = capsys.readouterr()
    assert (
        told.err.startswith("pamid: error: ZeroDivisionError: division by zero\n")
        and "--debug" in told.err
    )
    assert "Traceback" not in told.err
    assert frame.run(["plant", "--debug", "--json"]) == 1
    told = capsys.readouterr()
    assert _object(told.out)["code"] == "unexpected" and "Traceback" in told.err


def test_interrupt(planted, capsys):
    def stop():
        raise KeyboardInterrupt

    planted(stop)
    assert frame.run(["plant"]) == 130
    assert frame.run(["plant", "--json"]) == 130
    assert _object(capsys.readouterr().out)["code"] == "interrupted"


def test_only_the_object_reaches_stdout(planted, capsys):
    def chatter():
        print("a library that prints")
        return frame.Result(
            {"schema": "pamid.test/1", "value": 1.5}, "The value is 1.5.", exit_code=6
        )

    planted(chatter)
    assert frame.run(["plant", "--json"]) == 6
    captured = capsys.readouterr()
    assert _object(captured.out) == {"schema": "pamid.test/1", "value": 1.5}
    assert captured.err == "a library that prints\n"
    assert frame.run(["plant"]) == 6
    assert capsys.readouterr().out == "a library that prints\nThe value is 1.5.\n"


def test_a_result_that_is_not_finite_fails_as_json(planted, capsys):
    planted(lambda: frame.Result({"schema": "pamid.test/1", "value": float("nan")}))
    assert frame.run(["plant", "--json"]) == 1
    assert _object(capsys.readouterr().out)["schema"] == "pamid.error/1"


@pytest.mark.parametrize(
    "arguments", [["--help"], ["--version"], ["generate-aprbs", "--help"]], ids=" ".join
)
def test_help_and_version_as_json(arguments, capsys):
    assert frame.run([*arguments, "--json"]) == 0
    assert _object(capsys.readouterr().out)["text"]


@pytest.mark.parametrize(
    "arguments", [["--version"], ["nonsense"], ["nonsense", "--json"]], ids=" ".join
)
def test_no_escape_codes_under_no_color(arguments):
    found = subprocess.run(
        [sys.executable, "-m", "pamid_cli", *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, "NO_COLOR": "1"},
    )
    assert "\x1b" not in found.stdout + found.stderr


def test_a_reader_that_leaves_is_no_error():
    line = f"{shlex.quote(sys.executable)} -m pamid_cli --help | true; exit ${{PIPESTATUS[0]}}"
    found = subprocess.run(["bash", "-c", line], capture_output=True, text=True)
    assert "Traceback" not in found.stderr and "Error" not in found.stderr


def test_a_reader_that_leaves_keeps_the_exit_code(monkeypatch):
    """A condition that is met stays met under `pamid score ... | head`."""

    def closed(_):
        raise BrokenPipeError

    monkeypatch.setattr(frame, "say", closed)
    monkeypatch.setattr(frame, "hang_up", lambda: None)
    met = click.Command("score", callback=lambda: frame.Result({}, "text", 7))
    monkeypatch.setattr(frame, "load_command", lambda _: met)
    assert frame.run(["score"]) == 7
