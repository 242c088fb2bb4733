"""The recording in data/example is what the commands in data/README.md make."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
from pamid_cli.frame import run

from pamid.base.files import sha256_of
from pamid.recording.recording import read_recording

DATA = Path(__file__).resolve().parents[2] / "data"
PAGE = (DATA / "README.md").read_text(encoding="utf-8")


def block(output: str) -> str:
    """The shell lines of the page that make this file."""
    found = re.findall(r"^```sh\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    return next(b for b in found if b.rstrip().endswith(output))


def test_sums_are_those_written_down():
    sums = re.findall(r"^([0-9a-f]{64})  (example/\S+)$", PAGE, re.MULTILINE)
    assert {name for _, name in sums} == {f"example/{p.name}" for p in (DATA / "example").iterdir()}
    for wanted, name in sums:
        assert sha256_of(DATA / name) == wanted, name


def test_the_commands_make_it_again(here):
    for line in block("joint.csv").splitlines():
        assert run(shlex.split(line)[1:]) == 0
    kept, made = (
        read_recording(DATA / "example" / "joint.csv"),
        read_recording(here / "joint.csv"),
    )
    assert list(made.columns) == list(kept.columns)
    assert (made.loop, made.rig, made.known, made.controller) == (
        kept.loop,
        kept.rig,
        kept.known,
        kept.controller,
    )
    np.testing.assert_array_equal(made.time, kept.time)
    for name, values in kept.columns.items():
        np.testing.assert_allclose(
            made.columns[name], values, rtol=0.0, atol=1e-6 * float(np.ptp(values)), err_msg=name
        )


def test_the_commands_make_the_log_again(here):
    *commands, script = block("bench_log.csv").splitlines()
    for line in commands:
        assert run(shlex.split(line)[1:]) == 0
    words = shlex.split(script)
    subprocess.run([sys.executable, str(DATA.parent / words[1]), *words[2:]], check=True)
    logs = (here / "bench_log.csv", DATA / "example" / "bench_log.csv")
    made, kept = (log.read_text("cp1252").splitlines() for log in logs)
    assert made[:5] == kept[:5] and len(made) == len(kept)
    rows = [
        np.array([row.replace(",", ".").split(";") for row in log[5:]], float)
        for log in (made, kept)
    ]
    # a last digit may fall the other way elsewhere
    np.testing.assert_allclose(rows[0], rows[1], atol=1.1e-3)


def test_the_log_becomes_the_recording_it_was_made_of(here):
    log = str(DATA / "example" / "bench_log.csv")
    guess = ["--rig", "one-dof", "--pressures", "absolute", "--output", "map.toml"]
    assert run(["ingest", "--guess", log, *guess]) == 0
    assert run(["ingest", log, "--mapping", "map.toml", "--output", "rec.csv"]) == 0
    for line in block("bench_log.csv").splitlines()[:2]:
        assert run(shlex.split(line)[1:]) == 0
    made, kept = read_recording(here / "rec.csv"), read_recording(here / "bench.csv")
    assert made.loop == "closed" and made.rig == "one-dof" and len(made) == len(kept)
    for name, values in made.columns.items():
        digit = {"angle_deg": 1e-3, "reference_deg": 1e-3, "command": 1e-4}.get(name, 1e-2)
        np.testing.assert_allclose(
            values, kept.columns[name], rtol=0.0, atol=0.51 * digit, err_msg=name
        )
