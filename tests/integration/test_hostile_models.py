"""Model files of other programs that ask for too much, name a pipe, or hold a number that is not
finite; and commands that are signalled in the middle of native code."""

import os
import signal
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from disturbed import Halted

from pamid.base.errors import FileError, UsageError
from pamid.rigs.simulators.fmu_file import _fresh_name, _remarks, read_fmu
from pamid.rigs.simulators.foreign_limits import VARIABLE, foreign_limits

ARM = """<mujoco model="arm">
{option}
<worldbody><body>
<joint name="j" type="hinge" axis="0 1 0" {joint}/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" {geom}/>
{more}
</body></worldbody>
<actuator><motor name="m" joint="j"/></actuator>
<sensor><jointpos name="jp" joint="j"/></sensor>
</mujoco>"""
HEIGHTS = '<asset><hfield name="z" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>'
WITHOUT_END = '<replicate count="100000" offset="0 0 0.1"><geom size="0.01"/></replicate>'


def model(folder: Path, **parts: str) -> Path:
    whole = {"option": "", "joint": "", "geom": 'mass="1"', "more": "", **parts}
    path = folder / "arm.xml"
    path.write_text(ARM.format(**whole))
    return path


def refusal(path: Path) -> FileError:
    from pamid.rigs.simulators.mujoco_file import open_mujoco

    with pytest.raises(FileError) as caught:
        open_mujoco(path)
    return caught.value


# ---- MuJoCo --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"option": '<option timestep="nan"/>'}, "timestep is nan"),
        ({"option": '<option timestep="0"/>'}, "timestep"),
        ({"option": '<option timestep="-0.01"/>'}, "timestep"),
        ({"option": '<option timestep="inf"/>'}, "timestep is inf"),
        ({"option": '<option gravity="0 0 nan"/>'}, "gravity is nan"),
        ({"joint": 'damping="nan"'}, "joint 'j', line 4: dof_damping is nan"),
        ({"joint": 'stiffness="inf"'}, "joint 'j', line 4: jnt_stiffness is inf"),
        ({"joint": 'armature="nan"'}, "nan"),
        ({"geom": 'mass="nan"'}, "NaN"),
        ({"geom": 'mass="inf"'}, "arm.xml: "),
        ({"option": '<visual><map znear="nan"/></visual>'}, "NaN"),
    ],
)
def test_numbers_that_cannot_be_are_refused(tmp_path, monkeypatch, parts, words):
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    error = refusal(model(tmp_path, **parts))
    assert words in error.message and error.exit_code == 3
    assert [p.name for p in tmp_path.iterdir()] == ["arm.xml"], "no log of MuJoCo's"


def test_a_warning_of_mujoco_becomes_a_remark(tmp_path):
    pytest.importorskip("mujoco")
    from pamid.rigs.simulators.mujoco_file import open_mujoco
    from pamid.rigs.simulators.mujoco_mechanism import mechanism_of

    loaded = replace(open_mujoco(model(tmp_path)), warnings=("mesh z is odd",))
    (found,) = mechanism_of(loaded).findings
    assert "MuJoCo warns: mesh z is odd" in str(found) and not found.hinders


@pytest.mark.parametrize(
    "more",
    [
        '<include file="{}"/>',
        '<geom type="mesh" mesh="z"/></body></worldbody><asset><mesh name="z" file="{}"/></asset>'
        "<worldbody><body>",
        '</body></worldbody><asset><hfield name="z" file="{}" size="1 1 1 1"/></asset>'
        "<worldbody><body>",
        '</body></worldbody><asset><texture name="z" type="2d" file="{}"/></asset>'
        "<worldbody><body>",
    ],
)
@pytest.mark.parametrize("place", ["", "assets"])
def test_only_regular_files_are_read(tmp_path, more, place):
    pytest.importorskip("mujoco")
    (tmp_path / place).mkdir(exist_ok=True)
    os.mkfifo(tmp_path / place / "pipe.png")
    name = "pipe.png"
    if place and "include" in more:
        name = f"{place}/{name}"
    option = f'<compiler meshdir="{place}" texturedir="{place}"/>' if place else ""
    error = refusal(model(tmp_path, option=option, more=more.format(name)))
    assert error.code == "not-a-file" and "pipe.png is a pipe" in error.message


def test_a_model_that_is_a_pipe_is_refused(tmp_path):
    pytest.importorskip("mujoco")
    os.mkfifo(tmp_path / "arm.xml")
    assert refusal(tmp_path / "arm.xml").code == "not-a-file"


def test_a_link_to_an_included_file_will_do(tmp_path):
    pytest.importorskip("mujoco")
    from pamid.rigs.simulators.mujoco_file import open_mujoco

    (tmp_path / "real.txt").write_text('<mujoco><geom name="more" size="0.1"/></mujoco>')
    (tmp_path / "link.xml").symlink_to("real.txt")
    loaded = open_mujoco(model(tmp_path, more='<include file="link.xml"/>'))
    assert loaded.model.ngeom == 2


@pytest.mark.skipif(sys.platform != "linux", reason="limits are those of Linux")
@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"more": WITHOUT_END}, "s of processor time"),
        (
            {"option": HEIGHTS},
            "cannot read it",
        ),
    ],
)
def test_a_model_without_end_is_refused(tmp_path, monkeypatch, parts, words):
    pytest.importorskip("mujoco")
    monkeypatch.setattr("pamid.rigs.simulators.foreign_limits.COMPILE_S", 2.0)
    error = refusal(model(tmp_path, **parts))
    assert words in error.message and VARIABLE in error.hint


def test_too_many_joints_are_refused_by_their_number(tmp_path, monkeypatch):
    pytest.importorskip("mujoco")
    monkeypatch.setenv(VARIABLE, "0.5")
    body = '<body><joint type="hinge"/><geom size="0.01"/></body>'
    more = f'<replicate count="600" offset="0 0 0.1">{body}</replicate>'
    error = refusal(model(tmp_path, more=more))
    assert "the model has 601 joints; the limit is 500" in error.message


# ---- FMUs ----------------------------------------------------------------------------------------

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="m" guid="g" numberOfEventIndicators="0">
<CoSimulation modelIdentifier="m" canHandleVariableCommunicationStepSize="true"/>
<ModelVariables>
<ScalarVariable name="u" valueReference="0" causality="input" variability="continuous">
<Real start="0"/></ScalarVariable>
<ScalarVariable name="y" valueReference="1" causality="output" variability="continuous">
<Real/></ScalarVariable>{variables}
</ModelVariables>
<ModelStructure><Outputs><Unknown index="2"/></Outputs></ModelStructure>
</fmiModelDescription>"""


def fmu(folder: Path, variables: str = "", files: int = 1, size: int = 100, pad: int = 0) -> Path:
    path = folder / "m.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as packed:
        text = DESCRIPTION.format(variables=variables) + " " * pad
        packed.writestr("modelDescription.xml", text)
        for place in ("linux64", "darwin64", "win64"):
            ending = {"linux64": "so", "darwin64": "dylib", "win64": "dll"}[place]
            packed.writestr(f"binaries/{place}/m.{ending}", b"")
        for k in range(files):
            packed.writestr(f"resources/{k}", bytes(size))
    return path


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"size": 8 << 20}, "it unpacks to 8 MiB, of an FMU at most 5 MiB"),
        ({"files": 300}, "it holds 304 files, of an FMU at most 200"),
        ({"pad": 2 << 20}, "its modelDescription.xml has 2 MiB"),
    ],
)
def test_an_fmu_that_unpacks_to_too_much_is_refused(tmp_path, monkeypatch, parts, words):
    pytest.importorskip("fmpy")
    path = fmu(tmp_path, **parts)
    assert read_fmu(path).name == "m", "within the usual limits"
    monkeypatch.setenv(VARIABLE, "0.01")
    with pytest.raises(FileError, match=words) as caught:
        read_fmu(path)
    assert VARIABLE in caught.value.hint and caught.value.code == "too-large"


def test_an_fmu_that_is_a_pipe_is_refused(tmp_path):
    pytest.importorskip("fmpy")
    os.mkfifo(tmp_path / "m.fmu")
    with pytest.raises(FileError, match="is a pipe"):
        read_fmu(tmp_path / "m.fmu")


def test_a_factor_that_is_no_number_is_refused(monkeypatch):
    for word in ("much", "-1", "nan", "0"):
        monkeypatch.setenv(VARIABLE, word)
        with pytest.raises(UsageError, match=VARIABLE):
            foreign_limits()


class Incomparable(SimpleNamespace):
    def __eq__(self, other: object) -> bool:
        raise AssertionError("comparing every variable with every other costs their square")

    __hash__ = None  # type: ignore[assignment]


def test_remarks_on_variables_compare_none_of_them():
    variables = [Incomparable(name=f"p{k}", causality="parameter") for k in range(100)]
    said = _remarks(variables, variables[:10], False, False, True)
    assert "left out, as no real numbers: p10, p11" in said[-1] and "and 70 more" in said[-1]


def test_names_stay_short_where_many_are_alike():
    taken: dict[str, int] = {}
    names = [_fresh_name("x", taken) for _ in range(2000)]
    assert names[:4] == ["x", "x_", "x_3", "x_4"]
    assert len(set(names)) == 2000 and max(map(len, names)) <= len("x_2000")


# ---- signals -------------------------------------------------------------------------------------

#: halts while the child compiles
WHILE_COMPILING = """
import pamid.base.parallel.limited_process as apart
apart.tell = lambda text: happened("before", text)
"""
#: waits for ever in native code, which a signal does not interrupt
DEAF = """
import ctypes
import pamid.api.checking as checking
from pamid_cli import signals
signals.GRACE_S = 0.5
def deaf(*_):
    libc, lock = ctypes.CDLL(None), ctypes.create_string_buffer(256)
    os.write(event, b"halted")
    while True:
        libc.pthread_mutex_lock(lock)
checking.check.of = deaf
"""
#: halts in a callback of native code, where an exception is lost
IN_CALLBACK = """
import ctypes
import pamid.api.checking as checking
from pamid_cli import signals
signals.GRACE_S = 600.0
def called_back(*_):
    kind = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)
    numbers = (ctypes.c_int * 2)(2, 1)
    ctypes.CDLL(None).qsort(numbers, 2, 4, kind(lambda *_: happened("before", "callback") or 0))
    while True:
        time.sleep(0.01)
checking.check.of = called_back
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_a_compilation(tmp_path, number):
    pytest.importorskip("mujoco")
    path = model(tmp_path, more=WITHOUT_END)
    command = ["check", str(path)]
    halted = Halted(command, "before", "compiling", 1, stand_in=WHILE_COMPILING)
    code, said = halted.end(number)
    assert code == 130 and "interrupted" in said and "Traceback" not in said
    halted.require_no_survivors()


@pytest.mark.skipif(sys.platform != "linux", reason="a lock of glibc")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_native_code_that_hears_none(tmp_path, number):
    halted = Halted(["check", "x.csv"], "before", "nothing", 1, stand_in=DEAF)
    code, said = halted.end(number)
    assert code == 130 and "interrupted" in said


def test_an_interrupt_lost_in_a_callback_comes_again():
    halted = Halted(["check", "x.csv"], "before", "callback", 1, stand_in=IN_CALLBACK)
    code, said = halted.end(signal.SIGTERM)
    assert code == 130 and "interrupted" in said and "Traceback" not in said
