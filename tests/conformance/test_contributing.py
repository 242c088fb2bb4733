"""What CONTRIBUTING says is one file is one file: each is added to a copy of the package, and is
there without another line."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
COMMAND = PAGE.partition("## Add a command")[2].partition("```python\n")[2].partition("```")[0]
NETWORK = '''"""A line, y = w u + b."""

from dataclasses import dataclass

import numpy as np

from pamid.networks.network import Network


@dataclass(frozen=True)
class Line(Network):
    """A line; powers: nothing."""

    kind = "line"
    size_options = {"powers": (1, 3, "Powers of every input", "1")}
    inputs: int = 1
    powers: int = 1

    @property
    def n_weights(self):
        return self.inputs * self.powers + 1

    def initial(self, seed):
        return np.zeros(self.n_weights)

    def rows(self, inputs):
        u = np.asarray(inputs)
        return np.hstack([*(u**k for k in range(1, self.powers + 1)), np.ones((len(u), 1))])

    def simulate(self, weights, inputs):
        return self.rows(inputs) @ self.flat(weights)

    def sweep(self, weights, inputs):
        yield 0, self.simulate(weights, inputs), self.rows(inputs)
'''
READER = '''"""Numbers, one a line."""

import numpy as np

from pamid.ingest.channels import Channel, Log
from pamid.ingest.log_kinds import Kind


def read_numbers(path):
    return Log(path, "numbers", (Channel("x_m", np.loadtxt(path, comments="%", ndmin=1)),))


KIND = Kind("numbers", (".num",), read_numbers, (b"%numbers",))
'''


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package with one more of everything."""
    place = tmp_path_factory.mktemp("site")
    for folder, name in (("pamid", "pamid"), ("cli", "pamid_cli")):
        shutil.copytree(ROOT / folder, place / name, ignore=shutil.ignore_patterns("__pycache__"))
    (place / "pamid_cli" / "say_hello.py").write_text(COMMAND)
    (place / "pamid" / "networks" / "line.py").write_text(NETWORK)
    (place / "pamid" / "ingest" / "readers" / "numbers.py").write_text(READER)
    for room, theirs, name, mine in (
        ("effects", "coulomb_friction", "CoulombFriction", "MyFriction"),
        ("rigs", "one_dof", "OneDof", "MyJoint"),
    ):
        text = (place / "pamid" / room / f"{theirs}.py").read_text()
        text = text.replace(f"class {name}(", f"class {mine}(").replace('"one-dof"', '"my-joint"')
        file = "my_friction.py" if room == "effects" else "my_joint.py"
        (place / "pamid" / room / file).write_text(text)
    return place


def run(copy: Path, *words: str) -> str:
    found = subprocess.run(
        [sys.executable, *words],
        env={**os.environ, "PYTHONPATH": str(copy), "COLUMNS": "200"},
        cwd=copy,
        capture_output=True,
        text=True,
    )
    assert not found.returncode, found.stderr
    return found.stdout


def pamid(copy: Path, *words: str) -> str:
    return run(copy, "-m", "pamid_cli", *words)


def test_a_command(copy: Path) -> None:
    lines = pamid(copy, "--help").splitlines()
    assert lines[lines.index("  say-hello        Greet somebody.") - 1].startswith("  fit ")
    assert pamid(copy, "say-hello", "Ada") == "Hello, Ada.\n"


def test_a_network(copy: Path) -> None:
    said = " ".join(pamid(copy, "train-residual", "--help").split())
    assert "anfis, elman, line or narx" in said and "Powers of every input of line." in said
    code = (
        "from pamid.correction.output_network import NetworkChoice as W;n = W('line', {'powers': "
        "2, 'hidden': None}).network(3, 0.01);print(n.n_weights, n.words())"
    )
    assert run(copy, "-c", code) == "7 line (inputs 3, powers 2)\n"


def test_a_reader(copy: Path) -> None:
    (copy / "log.num").write_text("%numbers\n1.5\n2.5\n")
    code = (
        "from pathlib import Path; from pamid.ingest.log_reader import read_log;"
        "log = read_log(Path('log.num')); print(log.kind, log.channel('x_m').values)"
    )
    assert run(copy, "-c", code) == "numbers [1.5 2.5]\n"


def test_an_effect_and_a_rig(copy: Path) -> None:
    assert "my-friction" in pamid(copy, "effects", "--rig", "my-joint")
    assert "\nmy-joint " in pamid(copy, "rigs")
    assert "[my-joint|one-dof|two-link]" in pamid(copy, "force-law", "--help")
