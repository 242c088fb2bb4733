"""Every kind of raw log, written by a tool of its own and read back; what is wrong with a file is
said, not raised."""

import shutil
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pamid.base.errors import FileError
from pamid.intake.logs.channels import Log
from pamid.intake.logs.log_reader import _read_in_child, known_kinds, read_here, read_log

N = 400
TIME = np.arange(N) * 0.003
#: host stamps as they come: late, never early
LATE = TIME + np.random.default_rng(1).exponential(2e-4, N)
ANGLE = 40.0 * np.sin(7.0 * TIME)
PRESSURE = 300.0 + 50.0 * np.cos(5.0 * TIME)
SLOW = np.arange(N // 3) * 0.009
FORCE = 800.0 * np.cos(SLOW)

octave = pytest.mark.skipif(
    shutil.which("octave-cli") is None, reason="octave-cli is not installed"
)


def matches(log: Log, name: str, values: Any, stamps: Any = None, unit: str | None = None) -> None:
    channel = log.channel(name)
    np.testing.assert_allclose(channel.values, values, rtol=1e-9, atol=1e-9)
    if stamps is None:
        assert channel.stamps is None
    else:
        assert channel.stamps is not None
        np.testing.assert_allclose(channel.stamps, stamps, rtol=0, atol=1e-9)
    if unit is not None:
        assert channel.unit == unit


def said(log: Log, *words: str) -> bool:
    return any(all(word in detail for word in words) for detail in log.details)


def test_a_json_log_of_blank_lines_is_refused(tmp_path):
    file = tmp_path / "log.json"
    file.write_bytes(b"\xef\xbb\xbf\n\n")
    with pytest.raises(FileError, match="this is not JSON"):
        read_here(file, "json")


def test_a_reader_in_its_own_process_keeps_the_stated_period(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text("# Fs = 1000 Hz\nangle,current\n" + "1.5,2\n2.5,3\n" * 20)
    stated = read_here(file, "csv").stated
    assert stated is not None and _read_in_child(file, "csv").stated == stated


# MAT


def write_mat(path: Path, **options: Any) -> Path:
    from scipy.io import savemat

    structure = {
        "time": LATE,
        "blockName": "rig/Scope",
        "signals": {"values": ANGLE, "label": "angle", "dimensions": 1.0},
    }
    several = np.array(
        [
            {"values": np.column_stack([ANGLE, PRESSURE]), "label": "", "dimensions": 2.0},
            {"values": PRESSURE.reshape(1, 1, N), "label": "p1", "dimensions": 1.0},
        ]
    )
    desk = {
        "X": {"Name": "time", "Data": LATE},
        "Description": "made for a test",
        "Y": np.array(
            [
                {"Name": '"Model Root"/"Angle"', "Data": ANGLE, "XIndex": 1.0, "Unit": "deg"},
                {"Name": "p1", "Data": PRESSURE, "XIndex": 1.0, "Unit": "kPa"},
            ]
        ),
    }
    two_rasters = {
        "X": np.array([{"Name": "fast", "Data": LATE}, {"Name": "slow", "Data": SLOW}]),
        "Y": np.array(
            [
                {"Name": "a", "Data": ANGLE, "XIndex": 1.0},
                {"Name": "f", "Data": FORCE, "XIndex": 2.0},
            ]
        ),
    }
    series = {
        "Name": "torque",
        "Time": LATE,
        "Data": ANGLE.reshape(1, 1, N),
        "DataInfo": {"Units": "N m"},
    }
    savemat(
        path,
        {
            "t": TIME,
            "angle": ANGLE,
            "both": np.column_stack([TIME, ANGLE]),
            "Kp": 2.5,
            "who": "anna",
            "scope": structure,
            "out": {"time": LATE, "signals": several},
            "desk": desk,
            "rasters": two_rasters,
            "series": series,
            "steps": np.arange(N, dtype=np.int32),
            "on": ANGLE > 0,
        },
        **options,
    )
    return path


@pytest.mark.parametrize("compressed", [False, True])
def test_mat_of_every_layout(tmp_path, compressed):
    log = read_log(write_mat(tmp_path / "rig.mat", do_compression=compressed))
    assert log.kind == "mat"
    matches(log, "t", TIME)
    matches(log, "angle", ANGLE)
    matches(log, "both/1", TIME)
    matches(log, "both/2", ANGLE)
    matches(log, "scope/angle", ANGLE, LATE)
    matches(log, "out/1/1", ANGLE, LATE)
    matches(log, "out/1/2", PRESSURE, LATE)
    matches(log, "out/p1", PRESSURE, LATE)
    matches(log, "desk/Model Root/Angle", ANGLE, LATE, "deg")
    matches(log, "desk/p1", PRESSURE, LATE, "kPa")
    matches(log, "rasters/a", ANGLE, LATE)
    matches(log, "rasters/f", FORCE, SLOW)
    matches(log, "series", ANGLE, LATE, "N m")
    matches(log, "steps", np.arange(N))
    matches(log, "on", ANGLE > 0)
    assert said(log, "left out", "Kp") and said(log, "left out", "who")


def write_tables(path: Path, version: str) -> Path:
    import pandas

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from matio import save_to_mat

        by_time = pandas.DataFrame(
            {"angle": ANGLE, "p1": PRESSURE}, index=pandas.to_timedelta(LATE, unit="s")
        )
        by_time.index.name = "Time"
        plain = pandas.DataFrame({"t": TIME, "angle": ANGLE})
        save_to_mat(
            str(path),
            {"tt": by_time, "tab": plain, "x": ANGLE, "s": {"Time": LATE, "Data": PRESSURE}},
            version=version,
        )
    return path


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_mat_tables_and_timetables(tmp_path, version):
    log = read_log(write_tables(tmp_path / "rig.mat", version))
    matches(log, "tt/angle", ANGLE, LATE)
    matches(log, "tt/p1", PRESSURE, LATE)
    matches(log, "tab/t", TIME)
    matches(log, "x", ANGLE)
    matches(log, "s", PRESSURE, LATE)


@octave
@pytest.mark.parametrize(
    ("option", "name"),
    [*((form, "o.mat") for form in ("-v7", "-v6", "-v4", "-text", "-hdf5")), ("-hdf5", "o.h5")],
)
def test_what_octave_saves(tmp_path, option, name):
    path = tmp_path / name
    code = (
        f"t = (0:{N - 1})' * 0.003; u = [t, 40 * sin(7 * t)]; row = 300 + 50 * cos(5 * t'); "
        f"save('{option}', '{path}', 't', 'u', 'row')"
    )
    subprocess.run(["octave-cli", "--norc", "--eval", code], check=True, capture_output=True)
    log = read_log(path)
    assert log.kind == ("hdf5" if option == "-hdf5" else "mat")
    matches(log, "t", TIME)
    matches(log, "u/2", ANGLE)
    matches(log, "row", PRESSURE)


# HDF5, Parquet


def write_hdf5(path: Path) -> Path:
    import h5py

    with h5py.File(path, "w") as file:
        group = file.create_group("rig")
        group["time"] = TIME
        group.create_dataset("angle", data=ANGLE, compression="gzip").attrs["units"] = "deg"
        group["both"] = np.vstack([ANGLE, PRESSURE])
        group["state"] = np.array([b"run"] * N)
        kind = np.dtype([("ticks", "i8"), ("force", "f4")])
        group["packed"] = np.array(list(zip(range(N), range(N), strict=True)), dtype=kind)
        file["objects"] = h5py.SoftLink("/rig")
        file["elsewhere"] = h5py.ExternalLink("other.h5", "/secret")
        file["rig/again"] = file["rig"]  # a circle
        file.create_dataset("huge", shape=(10**13,), dtype="f8", chunks=(1000,))
        group.create_dataset("texts", data=["a"] * N, dtype=h5py.string_dtype())
    return path


def test_hdf5_with_groups_units_compounds_and_traps(tmp_path):
    log = read_log(write_hdf5(tmp_path / "rig.h5"))
    matches(log, "rig/time", TIME)
    matches(log, "rig/angle", ANGLE, unit="deg")
    matches(log, "rig/both/2", PRESSURE)
    matches(log, "rig/packed/force", np.arange(N))
    for name in ("objects", "elsewhere", "huge", "rig/texts", "rig/state"):
        assert said(log, "left out", name)


def test_parquet(tmp_path):
    import pyarrow
    import pyarrow.parquet

    ticks = 1_700_000_000_000_000_000 + (TIME * 1e9).round().astype(np.int64)
    gaps = [None if index % 7 == 0 else float(value) for index, value in enumerate(ANGLE)]
    angle = pyarrow.field("angle", pyarrow.float64(), metadata={"unit": "deg"})
    fields = [
        ("ns", pyarrow.int64()),
        ("when", pyarrow.timestamp("ns", tz="UTC")),
        angle,
        ("gaps", pyarrow.float32()),
        ("on", pyarrow.bool_()),
        ("state", pyarrow.string()),
    ]
    table = pyarrow.table(
        [ticks, ticks, ANGLE, gaps, ANGLE > 0, ["run"] * N], schema=pyarrow.schema(fields)
    )
    pyarrow.parquet.write_table(table, tmp_path / "rig.parquet")
    log = read_log(tmp_path / "rig.parquet")
    matches(log, "ns", (TIME * 1e9).round())  # float64 would have rounded to 256 ns
    matches(log, "when", TIME, unit="s")
    matches(log, "angle", ANGLE, unit="deg")
    matches(log, "on", ANGLE > 0)
    holes = log.channel("gaps").values
    assert np.isnan(holes[::7]).all() and np.allclose(holes[1::7], ANGLE[1::7], rtol=1e-6)
    assert said(log, "beyond float64") and said(log, "left out", "state")


# TDMS, MDF


def write_tdms(path: Path) -> Path:
    from nptdms import ChannelObject, TdmsWriter

    def waveform(name: str, values: Any, start: str, step: float, unit: str) -> Any:
        return ChannelObject(
            "rig",
            name,
            values,
            {
                "wf_start_time": np.datetime64(start),
                "wf_increment": step,
                "wf_start_offset": 0.0,
                "unit_string": unit,
            },
        )

    with TdmsWriter(path) as writer:
        writer.write_segment(
            [
                waveform("angle", ANGLE[:200], "2024-03-01T12:00:00.000000", 0.003, "deg"),
                waveform("force", FORCE, "2024-03-01T12:00:00.004500", 0.009, "N"),
            ]
        )
        writer.write_segment([ChannelObject("rig", "angle", ANGLE[200:])])
        writer.write_segment(
            [
                ChannelObject("loose", "u", PRESSURE),
                ChannelObject("loose", "texts", ["a", "b"]),
                ChannelObject(
                    "loose",
                    "when",
                    np.datetime64("2024-03-01T12:00:00")
                    + (TIME * 1e6).round().astype("timedelta64[us]"),
                ),
            ]
        )
    return path


def test_tdms_waveforms_that_begin_at_different_times(tmp_path):
    log = read_log(write_tdms(tmp_path / "rig.tdms"))
    matches(log, "rig/angle", ANGLE, TIME, "deg")
    matches(log, "rig/force", FORCE, 0.0045 + SLOW, "N")
    matches(log, "loose/u", PRESSURE)
    matches(log, "loose/when", TIME, unit="s")
    assert said(log, "left out", "loose/texts")


def write_mdf(path: Path, version: str = "4.10") -> Path:
    from asammdf import MDF, Signal

    file = MDF(version=version)
    file.append(
        [
            Signal(ANGLE, LATE, name="angle", unit="deg"),
            Signal(PRESSURE, LATE, name="p", unit="kPa"),
        ]
    )
    file.append(
        [Signal(FORCE, SLOW, name="force", unit="N"), Signal(-FORCE, SLOW, name="p", unit="bar")]
    )
    counts = (np.arange(SLOW.size) % 2).astype(np.uint8)
    words = {"val_0": 0, "text_0": b"off", "val_1": 1, "text_1": b"on"}
    file.append([Signal(counts, SLOW, name="valve", conversion=words)])
    file.append([Signal(counts, SLOW, name="scaled", conversion={"a": 0.5, "b": 3.0})])
    file.append([Signal(counts, SLOW, name="code", conversion={"formula": "X1*2"})])
    saved = file.save(path, overwrite=True)
    file.close()
    assert Path(saved) == path
    return path


@pytest.mark.parametrize(("version", "suffix"), [("4.10", "mf4"), ("3.30", "mdf")])
def test_mdf_keeps_the_stamps_of_every_group(tmp_path, version, suffix):
    log = read_log(write_mdf(tmp_path / f"rig.{suffix}", version))
    matches(log, "angle", ANGLE, LATE, "deg")
    # a common table would have filled it to the rate of the angle
    matches(log, "force", FORCE, SLOW, "N")
    matches(log, "group 1/p", PRESSURE, LATE, "kPa")
    matches(log, "group 2/p", -FORCE, SLOW, "bar")
    matches(log, "valve", np.arange(SLOW.size) % 2, SLOW)
    matches(log, "scaled", 0.5 * (np.arange(SLOW.size) % 2) + 3.0, SLOW)
    assert said(log, "left out", "formula", "code")


def test_mdf_never_evaluates_the_formula_of_a_clock(tmp_path, monkeypatch):
    """Whoever reads a channel reads the stamps of its group, by that channel's own conversion."""
    from asammdf import MDF, Signal
    from asammdf.blocks import v4_blocks
    from asammdf.blocks.conversion_utils import from_dict

    file = MDF(version="4.10")
    file.append([Signal(ANGLE, TIME, name="angle")])
    file.append([Signal(FORCE, SLOW, name="force")])
    file.groups[0].channels[0].conversion = from_dict({"formula": "X1*2"})
    file.save(tmp_path / "rig.mf4")
    file.close()
    monkeypatch.setattr(
        v4_blocks, "evaluate", lambda formula, *rest: pytest.fail(f"{formula} was evaluated")
    )
    log = read_here(tmp_path / "rig.mf4", "mdf")
    matches(log, "force", FORCE, SLOW)
    assert said(log, "left out", "clock", "formula", "angle")


# ROS


def joint_message(store: Any, index: int, *, one: bool) -> Any:
    known_kinds = store.types
    nanoseconds = 1_700_000_000_000_000_000 + index * 3_000_000
    stamp = known_kinds["builtin_interfaces/msg/Time"](nanoseconds // 10**9, nanoseconds % 10**9)
    header = (index, stamp, "base") if one else (stamp, "base")
    names, values = ["elbow", "wrist"], [ANGLE[index], PRESSURE[index]]
    if index % 2:  # the order of the joints is the sender's business
        names, values = names[::-1], values[::-1]
    return known_kinds["sensor_msgs/msg/JointState"](
        known_kinds["std_msgs/msg/Header"](*header),
        names,
        np.array(values),
        np.array([]),
        np.array(values) * 2,
    )


def write_ros(path: Path, form: str) -> Path:
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    one = form == "bag"
    store = get_typestore(Stores.ROS1_NOETIC if one else Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
    with Writer1(path) if one else Writer(path, version=9, storage_plugin=plugin) as bag:
        joints = bag.add_connection("/joints", "sensor_msgs/msg/JointState", typestore=store)
        force = bag.add_connection("/force", "std_msgs/msg/Float64", typestore=store)
        for index in range(N):
            received = 1_700_000_000_000_000_000 + int(round(LATE[index] * 1e9))
            message = joint_message(store, index, one=one)
            number = store.types["std_msgs/msg/Float64"](PRESSURE[index])
            pack = store.serialize_ros1 if one else store.serialize_cdr
            bag.write(joints, received, pack(message, "sensor_msgs/msg/JointState"))
            bag.write(force, received, pack(number, "std_msgs/msg/Float64"))
    return path


@pytest.mark.parametrize("form", ["bag", "sqlite3", "mcap"])
def test_ros_bags_by_header_stamp(tmp_path, form):
    path = write_ros(tmp_path / ("rig.bag" if form == "bag" else "rig"), form)
    alone = [path] if form == "bag" else [path, *path.glob("*.db3"), *path.glob("*.mcap")]
    for one in alone:
        log = read_log(one)
        assert log.kind == "ros"
        matches(log, "/joints/position/elbow", ANGLE, TIME)  # not LATE, as the recorder got it
        matches(log, "/joints/effort/wrist", 2 * PRESSURE, TIME)
        matches(log, "/force/data", PRESSURE, LATE.round(9))
        assert said(log, "/force", "no header")
    assert len(alone) == (1 if form == "bag" else 2)


# what is no log


def test_kinds_are_told_by_content_and_by_name(tmp_path):
    table = "t,angle\n" + "".join(f"{a:.9f},{b:.9f}\n" for a, b in zip(TIME, ANGLE, strict=True))
    for name in ("rig.csv", "rig.TXT", "rig.dat"):
        (tmp_path / name).write_text(table)
        assert read_log(tmp_path / name).kind == "csv"
    (tmp_path / "rig.xyz").write_text(table)
    with pytest.raises(FileError, match="Valid kinds are: .*csv"):
        read_log(tmp_path / "rig.xyz")
    matches(read_log(tmp_path / "rig.xyz", "csv"), "t", TIME)
    with pytest.raises(FileError, match="Did you mean 'parquet'"):
        read_log(tmp_path / "rig.csv", "parkett")
    with pytest.raises(FileError, match="Did you mean 'rig.csv'"):
        read_log(tmp_path / "rigg.csv")
    with pytest.raises(FileError, match="does not begin as a tdms"):
        read_log(Path(shutil.copy(tmp_path / "rig.csv", tmp_path / "rig.tdms")))
    log = read_log(Path(shutil.copy(write_tdms(tmp_path / "ok.tdms"), tmp_path / "renamed.mat")))
    assert log.kind == "tdms" and said(log, "named .mat")
    with pytest.raises(FileError, match="its content is tdms"):
        read_log(tmp_path / "renamed.mat", "mat")
    with pytest.raises(FileError, match="folder"):
        read_log(tmp_path)


def stub(folder: Path, monkeypatch: pytest.MonkeyPatch, package: str, code: str) -> None:
    """A package of this name that comes before the installed one."""
    (folder / "stubs").mkdir()
    (folder / "stubs" / f"{package}.py").write_text(code)
    monkeypatch.syspath_prepend(str(folder / "stubs"))


@pytest.mark.parametrize(
    "kind",
    [kind for kind in known_kinds().values() if kind.extra and kind.suffixes],
    ids=lambda kind: kind.name,
)
def test_a_missing_package_is_named_with_its_extra(tmp_path, monkeypatch, kind):
    path = tmp_path / f"rig{kind.suffixes[0]}"
    path.write_bytes(kind.marks[0] + b"5.0 MAT-file".ljust(109) + b"\1" + bytes(600))
    package = kind.packages[0]
    stub(tmp_path, monkeypatch, package, f"raise ModuleNotFoundError('none', name={package!r})")
    with pytest.raises(FileError) as caught:
        read_log(path)
    assert caught.value.code == "missing-extra"
    assert caught.value.hint == f"pip install 'pamid[{kind.extra}]'"


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("import os; os.kill(os.getpid(), 11)", "crashed"),
        ("import time; time.sleep(60)", "did not end"),
        ("bytearray(1 << 40)", "not enough memory"),
    ],
)
def test_a_reader_that_crashes_or_hangs_is_an_error(tmp_path, monkeypatch, code, words):
    if "sleep" in code:
        monkeypatch.setattr("pamid.intake.logs.log_reader.PATIENCE", 1.0)
    stub(tmp_path, monkeypatch, "nptdms", code)
    (tmp_path / "rig.tdms").write_bytes(b"TDSm" + bytes(100))
    with pytest.raises(FileError, match=words):
        read_log(tmp_path / "rig.tdms")


def test_nothing_that_a_file_brings_is_executed(tmp_path):
    import pickle

    import h5py
    import pandas

    class Trap:
        def __reduce__(self):
            return Path.touch, (tmp_path / "sprung",)

    bomb = pickle.dumps(Trap())
    for name in ("a.csv", "a.pkl", "a.mat", "a.h5", "a.parquet", "a.tdms"):
        (tmp_path / name).write_bytes(bomb)
    np.savez(tmp_path / "a.npz", x=np.array([Trap()], dtype=object))
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["x"] = np.frombuffer(bomb, dtype=np.uint8)
        file["x"].attrs["CLASS"] = "VLARRAY"
        file["y"] = np.void(bomb)
    pandas.DataFrame({"x": [bomb, bomb]}).to_parquet(tmp_path / "b.parquet")
    for path in sorted(tmp_path.iterdir()):
        if path.name != "b.h5":
            with pytest.raises(FileError):
                read_log(path)
    # bytes, as numbers
    assert [channel.name for channel in read_log(tmp_path / "b.h5").channels] == ["x"]
    assert not (tmp_path / "sprung").exists()


def ros_2(path: Path) -> Path:
    """The one file of a bag by itself."""
    folder = write_ros(path.with_suffix(""), "mcap" if path.suffix == ".mcap" else "sqlite3")
    return Path(shutil.copy(next(folder.glob(f"*{path.suffix}")), path))


def parquet(path: Path) -> Path:
    import pandas

    pandas.DataFrame({"t": TIME, "angle": ANGLE}).to_parquet(path)
    return path


def hdf5(path: Path) -> Path:
    import h5py

    with h5py.File(path, "w") as file:
        file["rig/t"] = TIME
        file.create_dataset("rig/angle", data=ANGLE, compression="gzip")
    return path


def text(path: Path) -> Path:
    path.write_text(
        "t;angle\n" + "".join(f"{a:.9f};{b:.9f}\n" for a, b in zip(TIME, ANGLE, strict=True))
    )
    return path


DAMAGE = """
import json, sys, numpy
from pathlib import Path
from pamid.base.errors import FileError
from pamid.intake.logs.log_reader import known_kinds, read_here
from pamid.intake.logs.log_reader import read_log
name, whole, *paths = sys.argv[1:]
true = {channel.name: channel.values for channel in read_here(Path(whole), name).channels}
for path in paths:
    try:
        found = read_here(Path(path), name).channels
    except FileError:
        found = ()
    right = all(channel.name in true and channel.values.size <= true[channel.name].size and numpy.allclose(
        channel.values, true[channel.name][: channel.values.size], rtol=1e-12, equal_nan=True) for channel in found)
    print(path, int(right), flush=True)
"""  # noqa: E501


@pytest.mark.parametrize(
    ("suffix", "kind", "write"),
    [
        ("mat", "mat", write_mat),
        ("mat", "mat", lambda path: write_tables(path, "v7.3")),
        ("h5", "hdf5", hdf5),
        ("tdms", "tdms", write_tdms),
        ("mf4", "mdf", write_mdf),
        ("bag", "ros", lambda path: write_ros(path, "bag")),
        ("mcap", "ros", ros_2),
        ("db3", "ros", ros_2),
        ("parquet", "parquet", parquet),
        ("csv", "csv", text),
    ],
)
def test_damaged_files_are_refused_or_read_right(tmp_path, suffix, kind, write):
    """Cut: a FileError, or a beginning of the true values. Bitten: a FileError or channels. Empty:
    a FileError."""
    whole = write(tmp_path / f"whole.{suffix}")
    data = whole.read_bytes()
    random = np.random.default_rng(0)
    cut, bitten = [], []
    for number, share in enumerate((0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 0.999)):
        cut.append(tmp_path / f"cut{number}.{suffix}")
        cut[-1].write_bytes(data[: int(len(data) * share)])
    for number in range(12):
        hurt = bytearray(data)
        for place in random.integers(0, len(data) if number % 2 else min(2000, len(data)), size=8):
            hurt[place] ^= 1 << int(random.integers(8))
        bitten.append(tmp_path / f"bitten{number}.{suffix}")
        bitten[-1].write_bytes(bytes(hurt))
    left = [str(path) for path in [*cut, *bitten]]
    crashes = []
    while left:
        done = subprocess.run(
            [sys.executable, "-c", DAMAGE, kind, str(whole), *left], capture_output=True, text=True
        )
        answers = dict(line.split() for line in done.stdout.splitlines())
        assert all(answers.get(str(path), "1") == "1" for path in cut), (
            "a cut file was read wrongly"
        )
        left = left[len(answers) :]
        # the process died on the next one: only a parser in C may do that, an exception of ours
        # must not
        if left:
            assert done.returncode < 0, done.stderr[-2000:]
            crashes.append(left.pop(0))
    for path in [cut[3], *crashes[:1]]:
        try:
            read_log(Path(path))
        except FileError as error:
            assert error.code in ("damaged", "no-signals", "file", "ragged")
    whole.write_bytes(b"")
    with pytest.raises(FileError, match="empty"):
        read_log(whole)
