"""The exported FMUs, judged by FMPy: valid, equal to pamid at 3 ms and at 10 ms, rewound bit by
bit."""

import io
import re
import shutil
import subprocess
import zipfile
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from exported import PERIOD_S, STRICT, Case, Slave, case, fmu_of, simulated

from pamid.exports.c_source import model_name
from pamid.exports.fmu import standard_headers
from pamid.exports.step import step_of

pytest.importorskip("fmpy", reason="pip install 'pamid[verify]'")
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc")
SEVERAL = "several effects, two steps"


@pytest.fixture(params=[2, 3], ids=["fmi2", "fmi3"])
def version(request) -> Iterator[int]:
    yield request.param


@needs_gcc
@pytest.mark.parametrize("name", [SEVERAL, "arm", "kettle", "implicit", "network"])
def test_valid_in_the_eyes_of_fmpy(name, version, tmp_path):
    from fmpy.validation import validate_fmu

    (tmp_path / "model.fmu").write_bytes(fmu_of(name, version).data)
    assert validate_fmu(str(tmp_path / "model.fmu")) == []


@needs_gcc
def test_a_host_that_steps_by_10_ms(version, tmp_path):
    """Its inputs hold for 10 ms, the model goes on in samples of 3 ms, and time does not begin at
    0."""
    # samples until the end of every step
    hosts, n = case(SEVERAL, 2000).inputs, np.arange(1, 2001) * 10 // 3
    within = np.searchsorted(n, np.arange(n[-1] + 1), side="right").clip(max=len(n) - 1)
    fine = simulated(case(SEVERAL, 1).model, hosts[within])
    found = Slave(SEVERAL, version, tmp_path, start=7.0).run(hosts, 0.01, 7.0, ahead=True)
    assert Case(case(SEVERAL, 1).model, hosts, fine[n]).error(found) < 1e-12


@needs_gcc
def test_an_output_that_hangs_on_an_input(version, tmp_path):
    c = case("kettle", 400)
    slave = Slave("kettle", version, tmp_path / "a")
    assert c.error(slave.run(c.inputs)) < 1e-12
    after = Slave("kettle", version, tmp_path / "b").run(c.inputs, ahead=True)
    assert np.allclose(after[:-1, 0], c.outputs[1:, 0], rtol=1e-12) and np.array_equal(
        after[:, 1], c.inputs[:, 0]
    )
    structure = {
        o.variable.name: [v.name for v in o.dependencies] for o in slave.description.outputs
    }
    assert structure == {"water_degc": [], "int_w": ["power_w"]}


@needs_gcc
def test_a_state_brings_back_every_bit(version, tmp_path):
    c, slave = case(SEVERAL, 2000), Slave(SEVERAL, version, tmp_path)
    kind, unpack = ("state", "deSerialize") if version == 2 else ("State", "deserialize")

    def call(verb: str, *given: Any) -> Any:
        return getattr(slave.fmu, f"{verb}FMU{kind}")(*given)

    slave.run(c.inputs[:1000])
    state = call("get")
    packed = call("serialize", state)
    first = slave.run(c.inputs[1000:], start=3.0)
    call("set", state)
    assert np.array_equal(slave.run(c.inputs[1000:], start=3.0), first)
    again = call(unpack, packed)
    call("set", again)
    assert np.array_equal(slave.run(c.inputs[1000:], start=3.0), first)
    for one in (state, again):
        call("free", one)
    with pytest.raises(Exception, match="doStep|DoStep"):
        slave.fmu.doStep(0.0, PERIOD_S)  # back in time without a state
    slave.fmu.reset()
    slave.begin(0.0)
    assert c.error(slave.run(c.inputs)) < 1e-12


@needs_gcc
def test_units_are_real(version, tmp_path):
    with zipfile.ZipFile(io.BytesIO(fmu_of("kettle", version).data)) as file:
        root = ElementTree.fromstring(file.read("modelDescription.xml"))
    units = {u.attrib["name"]: dict(u[0].attrib) for u in root.iter("Unit")}
    assert units["degC"] == {"K": "1", "offset": "273.15"} and units["W"] == {
        "kg": "1",
        "m": "2",
        "s": "-3",
    }
    assert root.find("DefaultExperiment").attrib["stepSize"] == "0.003"  # type: ignore[union-attr]
    with zipfile.ZipFile(io.BytesIO(fmu_of(SEVERAL, version).data)) as file:
        root = ElementTree.fromstring(file.read("modelDescription.xml"))
    units = {u.attrib["name"]: dict(u[0].attrib) for u in root.iter("Unit")}
    assert units["deg"] == {"rad": "1", "factor": "0.017453292519943295"}
    assert units["kPa"] == {"kg": "1", "m": "-1", "s": "-2", "factor": "1000.0"}
    slave = Slave(SEVERAL, version, tmp_path)
    about = {v.name: v for v in slave.description.modelVariables}
    assert (
        about["angle_deg"].unit,
        about["command"].unit,
        about["coulomb-friction:torque_n_m"].unit,
    ) == ("deg", None, "N m")
    assert (about["inertia_kg_m2"].start, about["inertia_kg_m2"].variability) == (
        "0.014",
        "tunable",
    )
    assert about["inertia_kg_m2"].description == "first paper, Jn"


@needs_gcc
@pytest.mark.parametrize("name", ["implicit", "kettle"])
def test_sources_compile_without_warnings(name, version, tmp_path):
    step = step_of(case(name, 1).model)
    with zipfile.ZipFile(io.BytesIO(fmu_of(name, version, "").data)) as file:
        file.extractall(tmp_path)
    sources = tmp_path / "sources"
    done = subprocess.run(
        [
            *("gcc", *STRICT, "-fPIC", "-shared", "-isystem", standard_headers()),
            *sorted(sources.glob("*.c")),
            *("-lm", "-o", tmp_path / "model.so"),
        ],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    shim = (sources / f"fmi{version}.c").read_text()
    declared = set(
        re.findall(
            rf"FMI{version}_Export \w+TYPE +(\w+)",
            re.sub(r"\s+", " ", (standard_headers() / f"fmi{version}Functions.h").read_text()),
        )
    )
    defined = set(re.findall(rf"^[\w* ]*?\b(fmi{version}\w+)\(", shim, re.MULTILINE))
    assert declared == defined and len(declared) > 40
    assert model_name(step) in shim + (sources / "fmu.h").read_text()


def test_without_a_compiler_the_sources_are_shipped(version):
    plain, failed = fmu_of("kettle", version, ""), fmu_of("kettle", version, "false")
    assert plain.data == failed.data and (plain.binary, failed.binary) == ("", "")
    assert "no C compiler" in plain.why and "false failed" in failed.why
    with zipfile.ZipFile(io.BytesIO(plain.data)) as file:
        assert not [n for n in file.namelist() if n.startswith("binaries")]
        assert "sources/pamid_kettle.c" in file.namelist()
