"""The exported C: equal to pamid, without warnings, without memory of its own, and its example host
runs."""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from exported import STRICT, built, case

from pamid.engine.sampled_inputs import SampledInputs
from pamid.exports.c_source import c_files, model_name
from pamid.exports.step import _input, step_of

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc")


@needs_gcc
@pytest.mark.skipif(shutil.which("nm") is None, reason="there is no nm")
def test_takes_no_memory_and_has_no_globals(tmp_path):
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
def test_parameters_are_changed_from_outside(tmp_path):
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
    program = lower.program_with({})
    memory = program.memory(lower.start, **run)
    begun = SampledInputs(u[:200], model.period_s)
    program.run(memory, begun, lower.values, stepping=model.stepping)
    then = replace(begun, time_s=0.6)
    aside = memory.copy()
    heavy = lower.knowing({"inertia_kg_m2": 0.5})
    first = program.run(memory, then, heavy.values, stepping=model.stepping)[0][[0, -1], 0]
    second = program.run(aside, then, lower.values, stepping=model.stepping)[0][-1, 0]
    assert np.allclose(np.array(done, float), np.degrees([*first, second]), rtol=1e-11, atol=0.0)
    assert abs(first[1] - second) > 1e-3


def test_no_input_begins_at_absolute_zero():
    rig, begins = type(case("kettle", 1).model.assembly.rig), {"double": 288.15, "i": 0.0}

    def starts(**stated):
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
def test_the_program_refuses_a_table_without_what_it_needs(text, said, tmp_path):
    """As `pamid simulate` does: values of nowhere give a quiet, wrong simulation."""
    program = built("kettle", tmp_path)
    done = subprocess.run([program], input=text, capture_output=True, text=True)
    assert done.returncode == 1 and done.stderr.strip() == said
    good = subprocess.run(
        [program], input="power_w\n5\n\n5\n", capture_output=True, text=True, check=True
    )
    assert len(good.stdout.splitlines()) == 3, "what is optional may be missing"
