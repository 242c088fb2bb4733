"""A decimal comma, another time zone and a clock that runs backwards change no byte of what is
found."""

import json
import locale
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pamid_cli import frame

from pamid.base.json_file import read_json
from pamid.recording.recording import write_recording
from pamid.simulation.excitation.aprbs import aprbs

CART = Path(__file__).resolve().parents[2] / "data" / "rigs" / "cart.py"
COMMAS = ("de_DE.UTF-8", "de_DE", "fr_FR.UTF-8", "nl_NL.UTF-8")
LINES = [
    line.split()
    for line in (
        "generate-aprbs --rig cart.py --amplitude 2 --duration 9 --period 0.01 --hold 0.1 0.5 "
        "--output drawn.csv",
        "generate-aprbs --rig cart.py --amplitude 2 --duration 9 --output played.st",
        "simulate --rig cart.py --excitation sent.csv --effect coulomb-friction --output rec.csv",
        "ingest --guess rec.csv --rig cart.py --output map.toml",
        "ingest rec.csv --mapping map.toml --rig cart.py --output again.csv",
        "check again.csv --rig cart.py",
        "fit again.csv --rig cart.py --output run",
        "train-residual run --hidden 2 --iterations 3",
        "export run --to c --rig cart.py --output model",
    )
]
PAGE = ["report", "run"]
SAYS_WHEN = "run/run.json"

#: `pamid` as part of a program that has set its locale, on a machine whose clock is set back by an
#: hour at every look
_ELSEWHERE = """
import json, locale, sys
from datetime import UTC, datetime, timedelta
import pamid.base.run_folder
from pamid_cli import frame
locale.setlocale(locale.LC_ALL, "")
assert locale.str(1.5) == "1,5"
looks = iter(range(10**6))
class Backwards(datetime):
    @classmethod
    def now(cls, zone=None):
        return datetime(2400, 1, 1, tzinfo=UTC) - timedelta(hours=next(looks))
pamid.base.run_folder.datetime = Backwards
sys.exit(max(frame.run(words) for words in json.loads(sys.argv[1])))
"""


@pytest.fixture(scope="module")
def commas(tmp_path_factory) -> Iterator[dict[str, str]]:
    """The environment of a machine that writes 1,5: an installed locale, or one made here of its
    source."""
    made = tmp_path_factory.mktemp("locales")
    subprocess.run(
        ["localedef", "-i", "de_DE", "-f", "UTF-8", str(made / COMMAS[0])],
        capture_output=True,
        check=False,
    ) if shutil.which("localedef") else None
    own = {"LOCPATH": str(made)} if (made / COMMAS[0]).exists() else {}
    able = next((name for name in COMMAS if own or _installed(name)), None)
    if able is None:
        pytest.skip("no locale with a decimal comma is installed, and none can be made")
    yield {
        **os.environ,
        **own,
        "LC_ALL": able,
        "LANG": able,
        "TZ": "Asia/Kathmandu",
        "OMP_NUM_THREADS": "1",
    }


def _installed(name: str) -> bool:
    before = locale.setlocale(locale.LC_ALL)
    try:
        locale.setlocale(locale.LC_ALL, name)
    except locale.Error:
        return False
    finally:
        locale.setlocale(locale.LC_ALL, before)
    return True


def begun(folder: Path) -> Path:
    folder.mkdir()
    shutil.copy(CART, folder)
    write_recording(
        folder / "sent.csv",
        0.01 * np.arange(900),
        {"force_n": aprbs(9.0, 0.01, 4.0, (0.1, 0.4), seed=1)},
    )
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {
        str(p.relative_to(folder)): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and "__pycache__" not in p.parts
    }


def test_the_same_bytes_elsewhere_and_then(tmp_path, commas, monkeypatch):
    here, there = begun(tmp_path / "here"), begun(tmp_path / "there")
    monkeypatch.chdir(here)
    for words in LINES:
        assert frame.run(words) == 0, words
    done = subprocess.run(
        [sys.executable, "-c", _ELSEWHERE, json.dumps([*LINES, PAGE])],
        cwd=there,
        env=commas,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    one, other = files(here), files(there)
    assert {name for name in one if one[name] != other[name]} == {SAYS_WHEN}
    assert all(
        name.startswith(("run/report.html", "run/figures/")) for name in other.keys() - one.keys()
    )
    record = read_json(there / "run" / "run.json")
    assert record["ended"] < record["begun"] and record["begun"].endswith("+00:00")
    page = (there / "run" / "report.html").read_text(encoding="utf-8")
    assert "did not end" not in page
    table = [line for line in done.stdout.splitlines() if line.startswith("mass_kg")]
    assert table and "," not in table[0]
