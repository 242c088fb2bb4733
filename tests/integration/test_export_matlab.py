"""The exported MATLAB function, run in GNU Octave: equal to pamid."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from exported import Array, Case, case, simulated

from pamid.correction.identified_model import Identified
from pamid.export.m_source import m_file
from pamid.export.step import step_of

needs_octave = pytest.mark.skipif(
    shutil.which("octave-cli") is None, reason="there is no octave-cli"
)
LOOP = "for k = {first}:{last}\n  [Y(k, :), s] = model(U(k, :), s);\nend\n"


def ran(model: Identified, inputs: Array, folder: Path, script: str = "") -> Array:
    """Outputs of the function in Octave; script: what to do instead of one run over the inputs U
    into Y."""
    (folder / "model.m").write_text(m_file(step_of(model), "model"))
    np.savetxt(folder / "u.txt", inputs, fmt="%.17g")
    lines = [
        "U = load('u.txt'); Y = zeros(rows(U), columns(model(U(1, :))));",
        script or "[Y(1, :), s] = model(U(1, :));\n" + LOOP.format(first=2, last=len(inputs)),
        "f = fopen('y.txt', 'w'); fprintf(f, [repmat('%.17g ', 1, columns(Y)) \"\\n\"], Y'); "
        "fclose(f);",
    ]
    (folder / "script.m").write_text("\n".join(lines))
    done = subprocess.run(
        ["octave-cli", "--no-history", "--norc", "--no-gui", "script.m"],
        cwd=folder,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0 and not done.stderr, done.stderr
    return np.loadtxt(folder / "y.txt", ndmin=2)


@needs_octave
@pytest.mark.parametrize(
    ("name", "samples"),
    [
        ("two effects", 1500),
        ("several effects, two steps", 250),
        ("implicit", 200),
        ("arm", 200),
        ("cart", 3000),
        ("kettle", 3000),
        ("network", 300),
    ],
)
def test_equal_to_pamid(name: str, samples: int, tmp_path: Path) -> None:
    c = case(name, samples)
    assert c.error(ran(c.model, c.inputs, tmp_path)) < 1e-12


@needs_octave
def test_other_parameters(tmp_path: Path) -> None:
    """From the start on, and in a running model."""
    model = case("two effects", 1).model
    lower, inputs = model.knowing({"initial_pressure_kpa": 400.0}), np.tile([0.3, 0.0], (400, 1))
    script = (
        "p = model(); p.initial_pressure_kpa = 400; [Y(1, :), s] = model(U(1, :), [], p);\n"
        + LOOP.format(first=2, last=200)
        + "s.p.inertia_kg_m2 = 0.5;\n"
        + LOOP.format(first=201, last=400)
    )
    found = ran(model, inputs, tmp_path, script)
    run = {"period_s": model.period_s, "stepping": model.stepping}
    assert Case(lower, inputs, simulated(lower, inputs[:200])).error(found[:200]) < 1e-12
    memory = lower.program.memory(lower.start, **run)
    lower.program.run(memory, inputs[:200], lower.values, **run)
    heavy = lower.knowing({"inertia_kg_m2": 0.5}).values
    wanted = lower.program.run(memory, inputs[200:], heavy, time_s=0.6, **run)[0][:, 0]
    assert np.allclose(found[200:, 0], np.degrees(wanted), rtol=1e-10, atol=1e-10)
    assert np.abs(found[200:, 0] - simulated(lower, inputs)[200:, 0]).max() > 0.1


def test_names_are_those_that_matlab_takes() -> None:
    """At most 63 letters, digits and underscores, none of them a word of the language."""
    for name in ("kettle", "several effects, two steps", "network"):
        text = m_file(step_of(case(name, 1).model), "model")
        assigned = set(re.findall(r"^(?:p\.)?(\w+) = ", text, re.MULTILINE))
        assert max(map(len, assigned)) <= 63 and not assigned & {
            "double",
            "end",
            "i",
            "e",
            "function",
        }
        assert text.isascii() and "%#codegen" in text
