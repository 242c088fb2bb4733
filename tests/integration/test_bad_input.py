"""Bad input through the command line: what is said, with which exit code, and that nothing is left
behind.

The list of refusals is the one a user meets; what a file can hold is covered in full by
test_recording.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pamid_cli.frame import run
from virtual_joint import excitation, record

RIG = '''"""A mass."""

from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig


class Mass(Rig):
    """A mass that is pushed."""

    inputs = {"force_n": "N"}
    outputs = {"position_m": "m"}
    ports = {"push": Port("motion", "N", ("velocity",)), "gauge": Port("reading", "m"), "spare": Port("reading", "m")}
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (Parameter("mass", 1.0, 0.1, 10.0, "kg", source="test"),)

    def rates(self, x, u, p, port):
        return {"position": x.velocity, "velocity": port("push", u.force_n, velocity=x.velocity) / p.mass}

    def measure(self, x, u, p, port):
        return {"position_m": port("gauge", x.position)}
'''  # noqa: E501

EFFECT = '''"""A push that never stops.

What it is
    A push.
What it looks like
    Pushed.
Looks like it
    A pull.
Equation
    value += size + 0.01
References
    Nobody (2001), A Journal 1(1).
"""

from pamid.model.effect import Effect
from pamid.model.parameter import Parameter


class Push(Effect):
    """A push."""

    family = "offset"
    kinds = ("motion",)
    parameters = (Parameter("amount", 0.1, low=-1.0, high=1.0, null=0.0, source="test"),)

    def act(self, value, at, p, z):
        return value + p.amount + 0.01
'''

Said = tuple[int, dict[str, Any]]


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Callable[..., Said]:
    """Exit code and JSON of `pamid ... --json`; the same in words leaves with the same code and
    says the same."""

    def made(*arguments: str | Path) -> Said:
        words = [str(a) for a in arguments]
        code = run([*words, "--json"])
        told = json.loads(capsys.readouterr().out)
        if told["schema"] == "pamid.error/1":
            assert run(words) == code
            shown = capsys.readouterr()
            assert "Traceback" not in shown.err and not shown.out
            assert told["message"] in shown.err and told["hint"] in shown.err
        return code, told

    return made


@pytest.fixture(scope="session")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("good") / "rec.csv", 6.0).path


def changed(good: Path, folder: Path, change: Callable[[list[str]], Any]) -> Path:
    """A copy of the good recording with its lines changed (lines[0] is the header)."""
    lines = good.read_text().splitlines()
    lines = change(lines) or lines
    path = folder / "bad.csv"
    path.write_text("".join(line + "\n" for line in lines))
    path.with_suffix(".toml").write_text(good.with_suffix(".toml").read_text())
    return path


def _cell(lines: list[str], row: int, column: str, text: str) -> None:
    cells = lines[row].split(",")
    cells[lines[0].split(",").index(column)] = text
    lines[row] = ",".join(cells)


def _column(column: str, value: Callable[[int], str] | None) -> Callable[[list[str]], list[str]]:
    """Every cell of a column replaced, or the column removed."""

    def change(lines: list[str]) -> list[str]:
        i = lines[0].split(",").index(column)
        rows = [line.split(",") for line in lines]
        for k, row in enumerate(rows):
            if value is None:
                del row[i]
            elif k:
                row[i] = value(k)
        return [",".join(row) for row in rows]

    return change


def _renamed(old: str, new: str) -> Callable[[list[str]], list[str]]:
    return lambda lines: [lines[0].replace(old, new), *lines[1:]]


def _swapped(lines: list[str]) -> None:
    lines[100], lines[101] = lines[101], lines[100]


def _repeated(lines: list[str]) -> None:
    _cell(lines, 101, "time_s", lines[100].split(",")[0])


BAD: dict[str, tuple[Callable[[list[str]], Any], int, str, tuple[str, ...]]] = {
    "missing column": (_column("command", None), 3, "missing-column", ("bad.csv", "'command'")),
    "misspelt column": (
        _renamed("command", "comand"),
        3,
        "missing-column",
        ("'command'", "Did you mean 'comand'?"),
    ),
    "no output at all": (
        lambda lines: [
            ",".join(line.split(",")[:2])
            for line in (
                "time_s,command",
                *(f"{0.003 * k:.9g},{np.sin(k):.5f}" for k in range(2000)),
            )
        ],
        3,
        "file",
        ("none of the outputs", "angle_deg"),
    ),
    "wrong unit suffix": (_renamed("angle_deg", "angle_kpa"), 3, "unit", ("angle_kpa", "angle")),
    "unit nobody reads": (
        _renamed("pressure_1_kpa", "pressure_1_psi"),
        3,
        "unit",
        ("pressure_1_psi", "kpa"),
    ),
    "NaN": (
        lambda lines: _cell(lines, 7, "angle_deg", "nan"),
        3,
        "cell",
        ("line 8", "angle_deg", "nan"),
    ),
    "empty cell": (
        lambda lines: _cell(lines, 7, "angle_deg", ""),
        3,
        "cell",
        ("line 8", "angle_deg", "empty"),
    ),
    "word": (
        lambda lines: _cell(lines, 7, "command", "off"),
        3,
        "cell",
        ("line 8", "command", "'off'"),
    ),
    "repeated stamps": (_repeated, 3, "stamps-repeated", ("line 102", "twice")),
    "unsorted stamps": (_swapped, 3, "stamps-unsorted", ("line 102", "comes after")),
    "empty file": (lambda lines: lines.clear(), 3, "empty", ("bad.csv", "empty")),
    "header only": (lambda lines: [lines[0]], 3, "empty", ("no rows",)),
    "constant command": (
        _column("command", lambda k: "0.25"),
        4,
        "not-excited",
        ("command", "constant", "0.25"),
    ),
    "constant angle": (
        _column("angle_deg", lambda k: "3"),
        4,
        "not-excited",
        ("angle_deg", "constant"),
    ),
    "10 samples only": (lambda lines: lines[:11], 4, "too-short", ("10 samples",)),
    "100 samples only": (lambda lines: lines[:101], 4, "", ("100 samples",)),
}


@pytest.mark.parametrize("command", ["fit", "diagnose"])
@pytest.mark.parametrize("kind", BAD)
def test_bad_recordings(
    kind: str, command: str, good: Path, tmp_path: Path, call: Callable[..., Said]
) -> None:
    change, code, word, needles = BAD[kind]
    path, output = changed(good, tmp_path, change), tmp_path / "run"
    if kind == "empty file":
        path.write_text("")
    got, said = call(command, path, "--rig", "one-dof", "--output", output)
    assert (got, said["schema"]) == (code, "pamid.error/1"), said
    told = said["message"] + " " + said["hint"]
    missing = [n for n in needles if n not in told]
    assert not missing, (missing, told)
    assert not word or said["code"] == word, said
    assert said["hint"] or kind == "no output at all", "how to mend it"
    assert not output.exists(), "a refusal leaves nothing behind"


def test_the_good_recording_is_taken(good: Path, tmp_path: Path, call: Callable[..., Said]) -> None:
    """What the refusals above are measured against: unchanged, it fits."""
    path, output = changed(good, tmp_path, lambda lines: lines), tmp_path / "run"
    code, said = call("fit", path, "--output", output)
    assert code in (0, 5) and said["schema"] == "pamid.fit/1"
    assert json.loads((output / "fit.json").read_text()) == said


def test_bad_held_out_recordings_are_refused_before_anything_is_fitted(
    good: Path, tmp_path: Path, call: Callable[..., Said]
) -> None:
    path = changed(good, tmp_path, lambda lines: _cell(lines, 7, "angle_deg", "inf"))
    code, said = call("fit", good, "--held-out", path, "--output", tmp_path / "run")
    assert code == 3 and "bad.csv, line 8" in said["message"] and not (tmp_path / "run").exists()


def test_a_recording_that_is_not_there(tmp_path: Path, call: Callable[..., Said]) -> None:
    code, said = call("fit", tmp_path / "no.csv", "--output", tmp_path / "run")
    assert code == 3 and "no.csv" in said["message"] and not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "needles"),
    [
        (("--rig", "one-dov"), 3, ("unknown rig 'one-dov'", "Did you mean 'one-dof'?")),
        (("--rig", "one-dof:exponentiel"), 3, ("'exponentiel'", "Did you mean 'exponential'?")),
        (("--rig", "nowhere/cart.py"), 3, ("nowhere/cart.py",)),
        (
            ("--effect", "coulomb-fricton"),
            3,
            ("unknown effect 'coulomb-fricton'", "Did you mean 'coulomb-friction'?"),
        ),
        (("--effect", "coulomb-friction@wrist"), 3, ("'wrist'", "joint")),
        (("--effect", "overflow"), 3, ("'overflow'", "no place")),
        (("--efect", "leak"), 2, ("--efect",)),
    ],
)
def test_unknown_names_offer_the_nearest(
    arguments: tuple[str, ...],
    code: int,
    needles: tuple[str, ...],
    good: Path,
    tmp_path: Path,
    call: Callable[..., Said],
) -> None:
    got, said = call("fit", good, *arguments, "--output", tmp_path / "run")
    assert got == code, said
    assert all(n in said["message"] + " " + said["hint"] for n in needles), said
    assert not (tmp_path / "run").exists()


def test_unknown_parameters_of_an_effect_offer_the_nearest(
    tmp_path: Path, call: Callable[..., Said]
) -> None:
    source = excitation(tmp_path / "reference.csv", 4.0)
    code, said = call(
        "simulate",
        "--excitation",
        source,
        "--effect",
        "dead-time:delay=0.03",
        "--output",
        tmp_path / "rec.csv",
    )
    assert code == 3 and "'delay'" in said["message"] and "delay_s" in said["hint"]
    code, said = call(
        "simulate",
        "--excitation",
        source,
        "--known",
        "inertia_kg=0.1",
        "--output",
        tmp_path / "rec.csv",
    )
    assert code == 3 and "inertia_kg_m2" in said["hint"] and not (tmp_path / "rec.csv").exists()


def test_an_unknown_parameter_in_the_toml(
    good: Path, tmp_path: Path, call: Callable[..., Said]
) -> None:
    path = changed(good, tmp_path, lambda lines: lines)
    path.with_suffix(".toml").write_text("[known]\ninertia_kg_m3 = 0.1\n")
    code, said = call("fit", path, "--output", tmp_path / "run")
    assert code == 3 and "'inertia_kg_m3'" in said["message"] and "inertia_kg_m2" in said["hint"]
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("command", ["fit", "check", "rigs"])
def test_a_rig_with_an_unused_port(
    command: str, good: Path, tmp_path: Path, call: Callable[..., Said]
) -> None:
    rig = tmp_path / "mass.py"
    rig.write_text(RIG)
    rows = [f"{0.01 * k:.9g},{np.sin(0.1 * k):.6f},{np.sin(0.07 * k):.6f}" for k in range(600)]
    (tmp_path / "cart.csv").write_text("\n".join(["time_s,force_n,position_m", *rows]) + "\n")
    arguments: dict[str, list[str | Path]] = {
        "fit": ["fit", tmp_path / "cart.csv", "--rig", rig, "--output", tmp_path / "run"],
        "check": ["check", rig],
        "rigs": ["rigs", rig],
    }
    code, said = call(*arguments[command])
    told = json.dumps(said)
    assert (
        code == 3
        and "'spare'" in told
        and "never passes a value" in told
        and "drop the port" in told
    )
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("command", ["check", "fit", "diagnose"])
def test_a_recording_never_runs_the_rig_file_it_names(
    command: str, good: Path, tmp_path: Path, call: Callable[..., Said]
) -> None:
    """Recordings are data: a rig file in their TOML is named in the answer, and not executed."""
    marker, rig = tmp_path / "it-ran", tmp_path / "evil.py"
    rig.write_text(f"open({str(marker)!r}, 'w').close()\n")
    target = tmp_path / "rec.csv"
    target.write_bytes(good.read_bytes())
    target.with_suffix(".toml").write_text(f"[recording]\nrig = {str(rig)!r}\n")
    code, said = call(
        command, target, *(("--output", tmp_path / "run") if command != "check" else ())
    )
    assert code == 3
    assert not marker.exists()
    assert "evil.py" in json.dumps(said) and "--rig" in json.dumps(said)


def test_an_effect_that_is_not_null_at_its_null(tmp_path: Path, call: Callable[..., Said]) -> None:
    path = tmp_path / "push.py"
    path.write_text(EFFECT)
    code, said = call("check", path)
    wrong = [f for f in said["findings"] if not f["ok"] and not f["advice"]]
    assert code == 3 and not said["ok"]
    assert any("null" in f["check"] for f in wrong), wrong
    path.write_text(EFFECT.replace("p.amount + 0.01", "p.amount"))
    assert call("check", path)[0] == 0


def test_a_run_folder_already_taken(good: Path, tmp_path: Path, call: Callable[..., Said]) -> None:
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "thesis.txt").write_text("years of work")
    (tmp_path / "file").write_text("also")
    for more in ((), ("--overwrite",)):
        code, said = call("fit", good, "--output", tmp_path / "taken", *more)
        assert (code, said["code"]) == (3, "run-folder") and "not a run" in said["message"]
        code, said = call("fit", good, "--output", tmp_path / "file", *more)
        assert code in (2, 3) and "is a file" in said["message"]
    assert (tmp_path / "taken" / "thesis.txt").read_text() == "years of work"
    assert (tmp_path / "file").read_text() == "also"
    output = tmp_path / "run"
    assert call("fit", good, "--output", output)[0] in (0, 5)
    before = (output / "fit.json").read_bytes()
    code, said = call("fit", good, "--output", output)
    assert (code, said["code"]) == (3, "run-folder") and "--overwrite" in said["hint"]
    assert (output / "fit.json").read_bytes() == before
    assert call("fit", good, "--output", output, "--overwrite")[0] in (0, 5)
    # the same input gives the same output
    assert (output / "fit.json").read_bytes() == before


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="POSIX")
def test_kill_in_the_middle_leaves_nothing_half_written(
    good: Path, tmp_path: Path, call: Callable[..., Said]
) -> None:
    output = tmp_path / "run"
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "pamid_cli",
            "fit",
            str(good),
            "--bootstrap",
            "1000",
            "--output",
            str(output),
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    while not (output / "run.json").is_file() and process.poll() is None:
        time.sleep(0.02)
    assert process.poll() is None, "it ended before it could be killed"
    process.kill()
    assert process.wait() == -signal.SIGKILL
    for path in output.rglob("*"):
        if path.suffix == ".json":
            json.loads(path.read_text())
    assert not (output / "fit.json").exists() and not (output / "residual.csv").exists()
    code, said = call("report", output)
    # an unfinished run is said to be one
    assert code == 3 and said["message"], said
    assert call("fit", good, "--output", output, "--overwrite")[0] in (0, 5)
    assert not [p for p in output.iterdir() if p.name.startswith(".")]
