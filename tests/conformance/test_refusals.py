"""What is said where something is refused: how to mend it, once, and never the very thing that was
given; and that nothing outside pamid, a stream, a folder or a home that is gone, is called a fault
of pamid."""

from __future__ import annotations

import ast
import errno
import io
import json
import os
import pwd
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pamid_cli.frame import run

from pamid.base.errors import PamidError, nearest
from pamid.base.json_file import read_json
from pamid.base.toml_file import read_toml
from pamid.checks.inspection import inspect
from pamid.model.registry import rig_named
from pamid.recording.recording import read_recording, require_excited
from pamid.simulation.data_split import split_recordings

ROOT = Path(__file__).resolve().parents[2]
ROWS = [
    f"{0.003 * k:.6g},{np.sin(k / 9):.6f},{40 * np.sin(k / 11):.6f},{k % 3}" for k in range(420)
]
HEAD = "time_s,command,angle_deg,force_1_n"
Files = dict[str, bytes | str]


def table(*lines: str) -> Files:
    return {"rec.csv": "\n".join(lines) + "\n"}


def cell(text: str) -> Files:
    return table(HEAD, *ROWS[:60], f"{0.003 * 60:.6g},0.5,{text},1", *ROWS[61:])


def toml(text: str) -> Files:
    return {**table(HEAD, *ROWS), "rec.toml": text}


def clock(stamp: Callable[[int], float]) -> Files:
    return table(HEAD, *(f"{stamp(k):.12g},{row.partition(',')[2]}" for k, row in enumerate(ROWS)))


#: broken recordings: file -> content
BROKEN: dict[str, Files] = {
    "nothing there": {},
    "a namesake": {"reg.csv": "x"},
    "empty": {"rec.csv": b""},
    "only a header": table(HEAD),
    "no UTF-8": {"rec.csv": b"time_s,\xff\n1,2\n"},
    "bad bytes below": {"rec.csv": f"{HEAD}\n".encode() + b"\xff,1,2,3\n"},
    "a zero byte": {"rec.csv": f"{HEAD}\n0,\x001,2,3\n"},
    "no time": table(HEAD[7:], *ROWS),
    "no header": table(*ROWS),
    "only time": table("time_s", *("0" for _ in ROWS)),
    "semicolons": table(HEAD.replace(",", ";"), "0;1;2;3"),
    "no name": table("time_s,command,,force_1_n", *ROWS),
    "a comma too many": table(f"{HEAD},", *ROWS),
    "the same name twice": table("time_s,command,command,angle_deg", *ROWS),
    "a word": cell("off"),
    "no cell": cell(""),
    "nan": cell("nan"),
    "1e999": cell("1e999"),
    "x 1e300": cell("1e300"),
    "400 digits": cell("9" * 400),
    "5000 digits": cell("9" * 5000),
    "a row too short": table(HEAD, *ROWS[:9], "0.027,1"),
    "decimal commas": cell("1,5"),
    "nothing but tiny": table(HEAD, *(f"{r.rpartition(',')[0]},1e-200" for r in ROWS)),
    "stamps twice": table(HEAD, ROWS[0], *ROWS),
    "stamps back": table(HEAD, *ROWS[::-1]),
    "a gap": table(HEAD, *ROWS[:200], *ROWS[300:]),
    "uneven": clock(lambda k: 0.003 * k + 0.0005 * (k % 2)),
    "stamps x 1e300": clock(lambda k: 1e300 * k),
    "too short": table(HEAD, *ROWS[:40]),
    "too short to fit": table(HEAD, *ROWS[:199]),
    "at rest": table(HEAD, *(f"{r.split(',')[0]},0,{r.split(',')[2]},1" for r in ROWS)),
    "no outputs": table("time_s,command", *(",".join(r.split(",")[:2]) for r in ROWS)),
    "no input": table("time_s,angle_deg", *(",".join(r.split(",")[::2]) for r in ROWS)),
    "foreign unit": table(HEAD.replace("deg", "degrees"), *ROWS),
    "other quantity": table(HEAD.replace("deg", "kpa"), *ROWS),
    "misspelt": table(HEAD.replace("command", "comand"), *ROWS),
    "TOML: no TOML": toml("x"),
    "TOML: no UTF-8": {**table(HEAD, *ROWS), "rec.toml": b"\xff"},
    "TOML: deep": toml(f"a = {'[' * 4000}{']' * 4000}"),
    "TOML: deeper than a rig": toml(f"a = {'[' * 90}{']' * 90}"),
    "TOML: 400 digits": toml(f"[known]\nm_kg = {'9' * 400}"),
    "TOML: 5000 digits": toml(f"[known]\nm_kg = {'9' * 5000}"),
    "TOML: inf": toml("[known]\ninertia_kg_m2 = inf"),
    "TOML: text": toml('[known]\ninertia_kg_m2 = "1"'),
    "TOML: no table": toml("known = 1"),
    "TOML: a loop": toml('[recording]\nloop = "clsoed"'),
    "TOML: a number": toml("[recording]\nrig = 1"),
    "TOML: another period": toml("[recording]\nsampling_period_s = 0.004"),
    "TOML: a rig file": toml('[recording]\nrig = "./mine.py"'),
    "TOML: no such rig": toml('[recording]\nrig = "one-dov"'),
    "TOML: no such parameter": toml("[known]\ninertia_kg = 1.0"),
}


def put(folder: Path, files: Files) -> Path:
    for name, content in files.items():
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return folder / "rec.csv"


def refusals(path: Path) -> list[PamidError]:
    """Everything that reading, checking against the rig and dividing it may raise."""
    found = []
    for rig in (None, "one-dof"):
        try:
            recording = read_recording(path)
            from pamid.model.registry import rig_of

            made = rig_named(rig or rig_of([recording]))
            require_excited(recording, "angle_deg")
            split_recordings(made, [recording], [])
            from pamid.model.assembly import Assembly

            Assembly(made).values(recording.known)
        except PamidError as error:
            found.append(error)
    return found


@pytest.mark.parametrize("kind", BROKEN)
def test_every_refusal_of_a_recording_says_how_to_mend_it(kind: str, tmp_path: Path) -> None:
    found = refusals(put(tmp_path, BROKEN[kind]))
    assert found, "it was taken"
    for error in found:
        assert error.hint.strip(), error.message
        assert error.exit_code in (3, 4)
        assert str(error).count("Did you mean") <= 1, str(error)
        assert "Did you mean 'rec.csv'" not in str(error)
        assert len(str(error)) < 1000 + len(str(tmp_path)), "a message is read, not a file"


@pytest.mark.parametrize("kind", BROKEN)
def test_check_says_it_once(kind: str, tmp_path: Path) -> None:
    path = put(tmp_path, BROKEN[kind])
    if not path.exists():
        with pytest.raises(PamidError) as caught:
            inspect(path, "one-dof")
        assert caught.value.hint
        return
    for rig in (None, "one-dof"):
        for finding in inspect(path, rig).said["findings"]:
            assert finding["detail"].count("Did you mean") <= 1, finding


@pytest.mark.parametrize(
    "name",
    [
        "recording/recording",
        "recording/file_checks",
        "simulation/data_split",
        "checks/inspection",
        "base/toml_file",
    ],
)
def test_no_refusal_in_the_code_lacks_its_hint(name: str) -> None:
    """Also those that no recording of the table above meets."""
    tree = ast.parse((ROOT / "pamid" / f"{name}.py").read_text())
    calls = [
        n
        for n in ast.walk(tree)
        if isinstance(n, ast.Call)
        and isinstance(n.func, ast.Name)
        and n.func.id in ("FileError", "DataError")
    ]
    assert calls
    for call in calls:
        assert len(call.args) >= 2 and not (
            isinstance(call.args[1], ast.Constant) and not call.args[1].value
        ), f"pamid/{name}.py, line {call.lineno}: no hint"


def test_the_nearest_name_is_another_one() -> None:
    assert (
        nearest("ff.csv", ["ff.csv", "fg.csv"]) == ""
        and nearest("ff.csv", ["fg.csv"]) == "Did you mean 'fg.csv'?"
    )
    assert nearest("Angle_deg", ["angle_deg"]) == "Did you mean 'angle_deg'?"


@pytest.mark.parametrize("name", ["pipe", "folder.csv", "null"])
def test_what_is_no_file_is_said_to_be_none(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = (
        tmp_path / "pipe.csv"
        if name == "pipe"
        else Path("/dev/null")
        if name == "null"
        else tmp_path / name
    )
    if name == "pipe":
        os.mkfifo(path)
    elif name != "null":
        path.mkdir()
    for words in (["check", path], ["fit", path, "--output", tmp_path / "run"]):
        assert run([*map(str, words), "--json"]) == 3
        said = json.loads(capsys.readouterr().out)
        assert "Did you mean" not in said["hint"] and said["hint"], said
        assert ("folder" if name == "folder.csv" else "a pipe") in said["message"], said


# ---- words, files and streams that used to be called a fault of pamid --------------------------


@pytest.mark.parametrize("command", ["fit", "diagnose", "generate-aprbs", "simulate"])
def test_a_negative_seed_is_a_usage_error(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = (
        [] if command == "generate-aprbs" else ["--excitation"] if command == "simulate" else [""]
    )
    words = [
        command,
        *([*filter(None, given), "x.csv"] if given else []),
        "--seed",
        "-1",
        "--output",
        "out",
    ]
    assert run([*words, "--json"]) == 2
    assert "--seed" in json.loads(capsys.readouterr().out)["message"]


@pytest.mark.parametrize(
    "words",
    [
        ["generate-aprbs", "--duration", "20", "--output", "file/x.csv"],
        ["simulate", "--excitation", "rec.csv", "--rig", "one-dof", "--output", "file/x.csv"],
        ["check", "rec.csv", "--figure", "file/x.png"],
        ["check", "x" * 300 + ".csv"],
        ["fit", "rec.csv", "--output", "x" * 300],
        ["simulate", "--excitation", "rec.csv", "--output", "x" * 300 + ".csv"],
        ["export", "x" * 300, "--to", "c"],
        ["report", "file"],
    ],
    ids=lambda words: words[0],
)
def test_what_the_system_does_not_do_is_a_wrong_file(
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    put(tmp_path, {**table(HEAD, *ROWS), "file": "x"})
    assert run([*words, "--json"]) == 3
    said = json.loads(capsys.readouterr().out)
    assert said["code"] != "unexpected" and said["hint"] and len(said["message"]) < 400, said


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
def test_numbers_and_depths_that_no_json_of_pamid_has(text: str, tmp_path: Path) -> None:
    (tmp_path / "fit.json").write_text(text)
    with pytest.raises(PamidError) as caught:
        read_json(tmp_path / "fit.json")
    assert caught.value.exit_code == 3


def test_whole_numbers_of_toml_have_64_bits(tmp_path: Path) -> None:
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
def test_settings_of_another_kind(
    line: str,
    command: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pamid.toml").write_text(f"[fit]\n{line}\n")
    assert run([*command, "--json"]) == 3
    assert "pamid.toml" in json.loads(capsys.readouterr().out)["message"]


class Full(io.StringIO):
    """As /dev/full: nothing more can be written."""

    def write(self, text: str, /) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize(
    "words",
    [["effects"], ["effects", "--json"], ["fit", "no.csv", "--output", "x", "--json"], ["--help"]],
    ids=" ".join,
)
def test_a_full_standard_output(
    words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
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
def test_streams_that_are_closed_or_full(words: str, code: int) -> None:
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


def test_names_that_are_no_text(tmp_path: Path) -> None:
    """On Linux a file is named by bytes; those that are no letters are spelt out, in JSON as its
    own escapes."""
    name = os.fsdecode(b"\xff.csv")
    put(tmp_path, {name: "\n".join([HEAD, *ROWS]), "rec.csv": ""})
    for encoding in ("utf-8", "latin-1"):
        done = subprocess.run(
            [sys.executable, "-m", "pamid_cli", "check", name, "--json"],
            capture_output=True,
            cwd=tmp_path,
            env={**os.environ, "PYTHONIOENCODING": f"{encoding}:strict"},
            timeout=300,
        )
        assert done.returncode == 0 and json.loads(done.stdout)["file"] == name, done
        done = subprocess.run(
            [sys.executable, "-m", "pamid_cli", "check", name],
            capture_output=True,
            cwd=tmp_path,
            env={**os.environ, "PYTHONIOENCODING": f"{encoding}:strict"},
            timeout=300,
        )
        assert done.returncode == 0 and done.stdout.startswith(b"\\udcff.csv: 420 samples"), done


def test_a_working_folder_that_was_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = put(tmp_path, table(HEAD, *ROWS))
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert run(["effects", "--json"]) == 0
    assert run(["check", str(path), "--json"]) == 0
    capsys.readouterr()
    assert run(["simulate", "--excitation", "rec.csv", "--output", "out.csv", "--json"]) == 3
    assert json.loads(capsys.readouterr().out)["code"] != "unexpected"


@pytest.fixture
def homeless(monkeypatch: pytest.MonkeyPatch) -> None:
    """No HOME, and nobody in the password file."""

    def nobody(_: Any) -> Any:
        raise KeyError("uid not found")

    monkeypatch.setattr(pwd, "getpwuid", nobody)
    for name in ("HOME", "XDG_CACHE_HOME", "PAMID_CACHE", "NUMBA_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)


def test_without_a_home_compiled_code_has_a_private_folder(
    homeless: None, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_without_a_home_a_command_runs(
    homeless: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = put(tmp_path, table(HEAD, *ROWS))
    assert (
        run(
            [
                "check",
                str(path),
                "--rig",
                "one-dof",
                "--figure",
                str(tmp_path / "card.png"),
                "--json",
            ]
        )
        == 0
    )
    assert (tmp_path / "card.png").is_file()
    assert (
        run(
            [
                "simulate",
                "--excitation",
                str(path),
                "--rig",
                "one-dof",
                "--output",
                str(tmp_path / "x.csv"),
            ]
        )
        == 0
    )


# ---- messages that contradicted --------------------


def test_a_column_of_another_rig_is_not_sent_to_this_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
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
            "send it to your rig; to simulate it, name one with --rig"
        )
