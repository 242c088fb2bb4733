"""What CONTRIBUTING says is one file is one file: each is added to a copy of the package, and is
there without another line."""

import json
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
FORM = '''"""`pamid export --to list`: a list of the states."""

from pamid.exports.form import Form, Written

ALSO = ("names",)


def write(model, step, files):
    return Written({file: "\\n".join(step.states).encode() for file in files})


FORM = Form(".txt", write)
'''
PAPER = '''"""`pamid reproduce-paper --paper coin`: how often a coin falls on its edge."""

from dataclasses import dataclass

OPTIONS = ("iterations",)


@dataclass(frozen=True)
class Plan:
    seed: int
    throws: int


def plan(*, seed, quick, iterations):
    return Plan(seed, iterations)


def reproduce(run, plan, *, progress):
    return {"schema": "pamid.text/1", "text": f"0 of {plan.throws}"}


def text(found):
    return found["text"]


def converged(found):
    return True
'''
READER = '''"""Numbers, one a line."""

import numpy as np

from pamid.intake.logs.channel_builder import Kind


def read_numbers(builder):
    builder.add("x_m", np.loadtxt(builder.path, comments="%", ndmin=1))


KIND = Kind("numbers", (".num",), read_numbers, (b"%numbers",))
'''

OUTPUT = '''"""What `pamid say-hello` might print with --json."""

from pamid.base.schemas.model import Model, Text


class Greeting(Model, schema="pamid.greeting/1", title="pamid say-hello: a greeting"):
    """A greeting."""

    name: Text
'''


@pytest.fixture(scope="module")
def copy(tmp_path_factory) -> Path:
    """A copy of the package with one more of everything."""
    place = tmp_path_factory.mktemp("site")
    for folder, name in (("pamid", "pamid"), ("cli", "pamid_cli")):
        shutil.copytree(ROOT / folder, place / name, ignore=shutil.ignore_patterns("*.pyc"))
    (place / "pamid_cli" / "say_hello.py").write_text(COMMAND)
    (place / "pamid" / "base" / "schemas" / "greeting.py").write_text(OUTPUT)
    (place / "pamid" / "networks" / "line.py").write_text(NETWORK)
    (place / "pamid" / "intake" / "logs" / "readers" / "numbers.py").write_text(READER)
    (place / "pamid" / "exports" / "forms" / "list.py").write_text(FORM)
    (place / "pamid" / "api" / "replications" / "papers" / "coin.py").write_text(PAPER)
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


def test_a_command(copy):
    lines = pamid(copy, "--help").splitlines()
    assert lines[lines.index("  say-hello        Greet somebody.") - 1].startswith("  fit ")
    assert pamid(copy, "say-hello", "Ada") == "Hello, Ada.\n"
    said = json.loads(pamid(copy, "say-hello", "Ada", "--json"))
    assert said == {"schema": "pamid.text/1", "text": "Ada"}
    described = json.loads(pamid(copy, "schema", "greeting"))
    assert described["required"] == ["schema", "name"]


def test_a_network(copy):
    said = " ".join(pamid(copy, "train-residual", "--help").split())
    assert "anfis, elman, line or narx" in said and "Powers of every input of line." in said
    code = (
        "from pamid.networks.correction.output_network import NetworkChoice as W;"
        "n = W('line', {'powers': 2, 'hidden': None}).network(3, 0.01);"
        "print(n.n_weights, n.words())"
    )
    assert run(copy, "-c", code) == "7 line (inputs 3, powers 2)\n"


def test_a_reader(copy):
    (copy / "log.num").write_text("%numbers\n1.5\n2.5\n")
    code = (
        "from pathlib import Path; from pamid.intake.logs.log_reader import read_log;"
        "log = read_log(Path('log.num')); print(log.kind, log.channel('x_m').values)"
    )
    assert run(copy, "-c", code) == "numbers [1.5 2.5]\n"


def test_a_form_of_export(copy):
    said = " ".join(pamid(copy, "export", "--help").split())
    assert "|list|names|" in said and "; list, also names: a list of the states; " in said
    code = (
        "from pathlib import Path;"
        "from pamid.networks.correction.identified_model import Identified;"
        "from pamid.engine.program import Stepping;"
        "from pamid.exports.exporting import export_model;"
        "from pamid.model.assembly import Assembly; from pamid.model.registry import rig_named;"
        "rig = Assembly(rig_named('one-dof'), ());"
        "model = Identified('one-dof', rig, rig.values(), 0.003, Stepping(1));"
        "(file,) = export_model(model, 'names').files; print(file, file.read_text().split()[0])"
    )
    assert run(copy, "-c", code) == "pamid_one_dof.txt angle\n"


def test_a_paper(copy):
    said = " ".join(pamid(copy, "reproduce-paper", "--help").split())
    assert "[arm|coin|joint]" in said and "every start. (coin or joint)" in said
    assert "coin: how often a coin falls on its edge." in said
    words = ("reproduce-paper", "--paper", "coin", "--iterations", "3", "--output", "coin-run")
    assert pamid(copy, *words) == "0 of 3\n"


def test_an_effect_and_a_rig(copy):
    assert "my-friction" in pamid(copy, "effects", "--rig", "my-joint")
    assert "\nmy-joint " in pamid(copy, "rigs")
    assert "[muscle-mass|my-joint|one-dof|two-link]" in pamid(copy, "force-law", "--help")
