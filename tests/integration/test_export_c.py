"""The exported C: equal to pamid, without warnings, without memory of its own, and its example host
runs."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported import CASES, Array, case
from pamid_cli import frame

from pamid.export.c_source import c_files, comment, model_name
from pamid.export.statements import identifier, identifiers
from pamid.export.step import _input, step_of

STRICT = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-O2")
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc")


def built(name: str, folder: Path) -> Path:
    """The case as a program in a folder."""
    step = step_of(case(name, 1).model)
    for file, text in c_files(step).items():
        (folder / file).write_text(text)
    return compiled(folder)


def compiled(folder: Path) -> Path:
    """The program of the C files in a folder."""
    subprocess.run(
        ["gcc", *STRICT, *sorted(p.name for p in folder.glob("*.c")), "-lm", "-o", "model"],
        cwd=folder,
        check=True,
    )
    return folder / "model"


def ran(program: Path, names: tuple[str, ...], inputs: Array) -> Array:
    rows = [",".join(map(repr, row)) for row in inputs.tolist()]
    done = subprocess.run(
        [program],
        input="\n".join([",".join(names), *rows, ""]),
        capture_output=True,
        text=True,
        check=True,
    )
    return np.array([line.split(",") for line in done.stdout.splitlines()[1:]], float)


@needs_gcc
@pytest.mark.parametrize("name", CASES)
def test_equal_to_pamid(name: str, tmp_path: Path) -> None:
    c = case(name, 5000)
    assert c.error(ran(built(name, tmp_path), c.model.inputs, c.inputs)) < 1e-12


@needs_gcc
def test_over_the_length_of_a_recording(tmp_path: Path) -> None:
    c = case("several effects, two steps", 66667)
    assert (
        c.error(ran(built("several effects, two steps", tmp_path), c.model.inputs, c.inputs))
        < 1e-12
    )


@needs_gcc
@pytest.mark.skipif(shutil.which("nm") is None, reason="there is no nm")
def test_takes_no_memory_and_has_no_globals(tmp_path: Path) -> None:
    step = step_of(case("several effects, two steps", 1).model)
    name = model_name(step)
    for file, text in c_files(step).items():
        (tmp_path / file).write_text(text)
    subprocess.run(["gcc", *STRICT, "-c", f"{name}.c"], cwd=tmp_path, check=True)
    symbols = subprocess.run(
        ["nm", f"{name}.o"], cwd=tmp_path, capture_output=True, text=True, check=True
    ).stdout
    kinds = {line.split()[-1]: line.split()[-2] for line in symbols.splitlines()}
    assert {n for n, k in kinds.items() if k == "T"} == {
        f"{name}_{f}" for f in ("init", "start", "prepare", "step", "outputs")
    }
    assert not {n for n, k in kinds.items() if k in "BbDdCc"}
    assert {n for n, k in kinds.items() if k == "U"} <= {
        "exp",
        "log",
        "sqrt",
        "tanh",
        "sin",
        "cos",
        "pow",
        "memcpy",
        "memset",
        "__stack_chk_fail",
    }


@needs_gcc
def test_parameters_are_changed_from_outside(tmp_path: Path) -> None:
    """Both before the start and in the middle of a run, and a copied struct rewinds."""
    model = case("several effects, two steps", 1).model
    step = step_of(model)
    name = model_name(step)
    for file, text in c_files(step).items():
        (tmp_path / file).write_text(text)
    (tmp_path / "host.c").write_text(f"""
        #include "{name}.h"
        #include <stdio.h>
        int main(void)
        {{
            {name} m, saved;
            double u[2] = {{0.3, 0.0}}, y[5];
            int k;
            {name}_init(&m);
            m.p[{name.upper()}_P_INITIAL_PRESSURE_KPA] = 400.0;
            {name}_start(&m);
            for (k = 0; k < 200; k++) {{
                {name}_step(&m, u, y);
            }}
            saved = m;
            m.p[{name.upper()}_P_INERTIA_KG_M2] = 0.5;
            {name}_prepare(&m);
            {name}_outputs(&m, u, y);
            printf("%.17g\\n", y[0]);
            for (k = 0; k < 200; k++) {{
                {name}_step(&m, u, y);
            }}
            printf("%.17g\\n", y[0]);
            for (k = 0; k < 200; k++) {{
                {name}_step(&saved, u, y);
            }}
            printf("%.17g\\n", y[0]);
            return 0;
        }}""")
    subprocess.run(
        ["gcc", *STRICT, "host.c", f"{name}.c", "-lm", "-o", "host"], cwd=tmp_path, check=True
    )
    done = subprocess.run(
        [tmp_path / "host"], capture_output=True, text=True, check=True
    ).stdout.split()
    lower = model.knowing({"initial_pressure_kpa": 400.0})
    u, memory = np.tile([0.3, 0.0], (201, 1)), None
    run = {"period_s": model.period_s, "stepping": model.stepping}
    memory = lower.program.memory(lower.start, **run)
    lower.program.run(memory, u[:200], lower.values, **run)
    aside = memory.copy()
    heavy = lower.knowing({"inertia_kg_m2": 0.5})
    first = lower.program.run(memory, u[:200], heavy.values, time_s=0.6, **run)[0][[0, -1], 0]
    second = lower.program.run(aside, u[:200], lower.values, time_s=0.6, **run)[0][-1, 0]
    assert np.allclose(np.array(done, float), np.degrees([*first, second]), rtol=1e-11, atol=0.0)
    assert abs(first[1] - second) > 1e-3


def test_the_names_of_the_languages_are_avoided() -> None:
    assert identifiers(["double", "k1", "k", "dead-time:delay_s", "1st", "é"]) == [
        "double_2",
        "k1_2",
        "k",
        "dead_time_delay_s",
        "v1st",
        "v",
    ]
    assert identifier("a" * 99) == "a" * 50
    assert comment("a */ b /* c \\ d ?? é\n e") == "a * / b / * c / d ? ? ? e"


def test_an_optional_input_stands_at_its_value() -> None:
    step = step_of(case("kettle", 1).model)
    assert [(v.name, v.unit, round(v.start, 9)) for v in step.inputs] == [
        ("power_w", "W", 0.0),
        ("ambient_degc", "degC", 20.0),
    ]
    assert {v.name: v.fixed for v in step.parameters} == {
        "e": False,
        "E": False,
        "cold_k": True,
        "k1": False,
    }
    assert step.feedthrough() == ((), ("power_w",))


def test_no_input_begins_at_absolute_zero() -> None:
    """A required temperature begins at the rig's centre, or where the rig's own temperature does;
    other inputs at the centre, or within their range."""
    rig, begins = type(case("kettle", 1).model.assembly.rig), {"double": 288.15, "i": 0.0}

    def starts(**stated: dict[str, Any]) -> list[tuple[float, bool]]:
        needy = type(rig.__name__, (rig,), {"name": rig.name, "optional": {}, **stated})()
        found = [_input(needy, name, begins) for name in rig.inputs]
        return [(round(v.start, 9), v.required) for v in found]

    assert starts() == [(0.0, True), (15.0, True)]
    stated = {"centre": {"ambient_degc": 25.0}, "ranges": {"power_w": (50.0, 900.0)}}
    assert starts(**stated) == [(50.0, True), (25.0, True)]
    assert [required for _, required in starts(optional=rig.optional)] == [True, False]


@needs_gcc
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("ambient_degc\n20\n", "the input column power_w is missing"),
        ("power_w,ambient_degc\n5,20\n5\n", "row 3 has 1 cells of 2"),
        ("power_w,ambient_degc\n5,20\nfive,20\n", "row 3: five is not a number"),
    ],
)
def test_the_program_refuses_a_table_without_what_it_needs(
    text: str, said: str, tmp_path: Path
) -> None:
    """As `pamid simulate` does: values of nowhere give a quiet, wrong simulation."""
    program = built("kettle", tmp_path)
    done = subprocess.run([program], input=text, capture_output=True, text=True)
    assert done.returncode == 1 and done.stderr.strip() == said
    good = subprocess.run(
        [program], input="power_w\n5\n\n5\n", capture_output=True, text=True, check=True
    )
    assert len(good.stdout.splitlines()) == 3, "what is optional may be missing"


def test_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(
        "pamid.correction.identified_model.load_identified",
        lambda *_, **__: case("two effects", 1).model,
    )
    monkeypatch.chdir(tmp_path)
    for form, file in (("c", "pamid_one_dof/pamid_one_dof.c"), ("matlab", "pamid_one_dof.m")):
        assert frame.run(["export", "run", "--to", form, "--json"]) == 0
        told = json.loads(capsys.readouterr().out)
        assert (told["schema"], told["outputs"][0], told["period_s"]) == (
            "pamid.export/1",
            "angle_deg",
            0.003,
        )
        assert file in told["files"] and (tmp_path / file).is_file()
        assert frame.run(["export", "run", "--to", form]) == 3
        assert "exists already" in capsys.readouterr().err
        assert frame.run(["export", "run", "--to", form, "--overwrite"]) == 0
        assert "command, external_torque_nm -> angle_deg" in capsys.readouterr().out
    assert (
        frame.run(
            [
                "export",
                "run",
                "--to",
                "matlab",
                "--output",
                "a/my-joint.m",
                "--known",
                "radius_m=0.04",
            ]
        )
        == 0
    )
    text = (tmp_path / "a" / "my_joint.m").read_text()
    assert text.startswith("function [y, s] = my_joint(u, s, p)") and "p.radius_m = 0.04;" in text
