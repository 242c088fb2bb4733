"""Raw logs of many kinds, as people send them: `pamid ingest --guess` maps each, or asks for what
the log does not say."""

import bz2
import gzip
import io
import json
import lzma
import math
import pickle
import tomllib
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pamid_cli import frame

import pamid
from pamid.api.ingesting import IngestResult
from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.intake.logs.guessed_mapping import GuessedMapping

N, T = 1200, 0.02
TIME = np.arange(N) * T
_RANDOM = np.random.default_rng(3)
DRIVE = np.repeat(_RANDOM.uniform(-2.0, 2.0, N // 20), 20)
ANGLE = 3.0 * np.convolve(DRIVE, np.exp(-np.arange(300) / 30.0) / 30.0)[:N]
ANGLE += 1e-3 * _RANDOM.standard_normal(N)
SERIES = (TIME, DRIVE, ANGLE)
LENGTHS = (800, 900, 1000, 700, 1100)


Write = Callable[[Path], Any]


def table(
    columns: Sequence[Array], head: str = "", mark: str = ",", comma: str = ".", end: str = ""
) -> Write:
    """Writes these columns below a head."""
    rows = (
        mark.join("" if value != value else f"{value:.15g}" for value in row).replace(".", comma)
        + end
        for row in zip(*columns, strict=True)
    )
    text = head + "\n".join(rows) + "\n"
    return lambda path: path.write_text(text, encoding="utf-8")


def matlab(**variables: Any) -> Write:
    from scipy.io import savemat

    return lambda path: savemat(path, variables)


def records(stamps: Array = TIME) -> list[dict[str, Any]]:
    return [
        {"t": float(t), "u": float(u), "angle_deg": float(y)}
        for t, u, y in zip(stamps, DRIVE, ANGLE, strict=True)
    ]


def tdms(path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(path) as writer:
        for run, length in (("Run1", 900), ("Run2", 1000)):
            wave = {"wf_increment": T, "wf_start_offset": 0.0}
            volts = {**wave, "unit_string": "V"}
            degrees = {**wave, "unit_string": "deg"}
            channels = [
                nptdms.ChannelObject(run, "Drive", DRIVE[:length], volts),
                nptdms.ChannelObject(run, "Angle", ANGLE[:length], degrees),
            ]
            writer.write_segment(channels)


def nested(path: Path) -> None:
    """As a policy's rollouts are saved: data[i].actions."""
    data = [
        {"time": float(t), "actions": [float(u), float(-u)], "obs": {"angle": float(y)}}
        for t, u, y in zip(TIME, DRIVE, ANGLE, strict=True)
    ]
    path.write_text(json.dumps({"robot": "arm", "data": data}))


def episodes(path: Path) -> None:
    parts = [
        {key: values[:length].tolist() for key, values in (("t", TIME), ("angle_deg", ANGLE))}
        for length in LENGTHS
    ]
    path.write_text(json.dumps({"episodes": parts}))


def repeated() -> Array:
    stamps = TIME.copy()
    at = np.flatnonzero(np.random.default_rng(8).random(N - 1) < 0.01) + 1
    stamps[at] = stamps[at - 1]
    return stamps


@dataclass(frozen=True)
class Raw:
    """A log: its file, how it is written, the columns of its recordings, what is answered where
    `--guess` asks, and the lengths of the recordings."""

    file: str
    write: Write
    columns: tuple[str, ...]
    units: dict[str, str] = field(default_factory=dict)
    period: float | None = None
    lengths: tuple[int, ...] = (N,)
    time_unit: str = ""

    @property
    def asked(self) -> set[str]:
        """What `--guess` leaves open."""
        clock = {"time.period_s": self.period, "time.unit": self.time_unit}
        units = {f"signals.{column}.unit" for column in self.units}
        return units | {key for key, answer in clock.items() if answer}


def clock_time(seconds: float, form: str) -> str:
    moment = datetime(2025, 3, 4, 23, 59, 50) + timedelta(seconds=float(seconds))
    return moment.strftime(form)[:-3]


def lines(
    form: Callable[[float, float, float], str],
    head: str = "",
    encoding: str = "utf-8",
    newline: str = "\n",
) -> Write:
    """Writes a line for every sample below a head."""
    rows = (form(float(t), float(u), float(y)) for t, u, y in zip(*SERIES, strict=True))
    text = head + "\n".join(rows) + "\n"
    return lambda path: path.write_text(text, encoding=encoding, newline=newline)


def parts(t: float, per_s: int = 10**9) -> tuple[int, int]:
    """Seconds since 1970, and the rest in units of which a second has `per_s`."""
    ticks = round(t * per_s)
    return 1_741_082_400 + ticks // per_s, ticks % per_s


def annotated(path: Path) -> None:
    """A query of InfluxDB: one table below the other, one value a row."""
    head = (
        "#group,false,false,true,true,false,false,true,true\n"
        "#datatype,string,long,dateTime:RFC3339,dateTime:RFC3339,dateTime:RFC3339,double,string,"
        "string\n#default,_result,,,,,,,\n"
        ",result,table,_start,_stop,_time,_value,_field,_measurement\n"
    )
    rows = [
        f",,{number},2025-03-04T00:00:00Z,2025-03-06T00:00:00Z,"
        f"{clock_time(t, '%Y-%m-%dT%H:%M:%S.%f')}Z,{value:.15g},{name},bench\n"
        for number, (name, values) in enumerate((("drive_v", DRIVE), ("angle_deg", ANGLE)))
        for t, value in zip(TIME, values, strict=True)
    ]
    path.write_text(head + "".join(rows) + "\n")


def tektronix(path: Path) -> None:
    """Settings beside the first rows of numbers."""
    labels = ["Record Length,1.2e+03", "Sample Interval,2.0e-02", "Source,CH1", "Units,V"]
    rows = (
        f"{labels[i] if i < len(labels) else ','},,{t:.6f},{y:.15g},"
        for i, (t, y) in enumerate(zip(TIME, ANGLE, strict=True))
    )
    path.write_text("\n".join(rows) + "\n")


def stamped(t: float, u: float, y: float) -> dict[str, Any]:
    sec, nanosec = parts(t)
    return {"header": {"stamp": {"sec": sec, "nanosec": nanosec}}, "effort": u, "position": y}


def runs(path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for number, length in enumerate(LENGTHS, 1):
            group = file.create_group(f"run_{number:03d}")
            group["time_s"], group["angle"] = TIME[:length], ANGLE[:length]
            group["angle"].attrs["units"] = "deg"


LOGS = {
    "two columns without a clock": Raw(
        "dryer.dat",
        table((DRIVE, ANGLE), mark=" "),
        ("column_1_v", "column_2_degc"),
        {"column_1": "V", "column_2": "degC"},
        period=0.08,
    ),
    "the number of the row is no clock": Raw(
        "counted.csv",
        table((np.arange(N) * 1.0, DRIVE, ANGLE), "n,u_v,y_deg\n"),
        ("n", "u_v", "y_deg"),
        period=T,
    ),
    "a row of units, one of them unknown": Raw(
        "bench.csv",
        table((*SERIES, 9.0 * ANGLE), "t,M,Winkel,Enc\ns,Nm,deg,counts\n"),
        ("m_n_m", "winkel_deg", "enc"),
        {"enc": "1"},
    ),
    "milliseconds since 1970": Raw(
        "node.csv",
        table((1.7e12 + 1e3 * TIME, DRIVE, ANGLE), "stamp,u_v,angle_deg\n"),
        ("u_v", "angle_deg"),
    ),
    "whole numbers called time": Raw(
        "oven.csv",
        table((np.arange(N) * 1.0, DRIVE, ANGLE), "time,heater_w,temp_degc\n"),
        ("heater_w", "temp_degc"),
        time_unit="min",
    ),
    "repeated stamps": Raw(
        "host.csv",
        table((repeated(), DRIVE, ANGLE), "time_s,u_v,angle_deg\n"),
        ("u_v", "angle_deg"),
    ),
    "a matrix with the time in a column, and a constant": Raw(
        "data.mat",
        matlab(Iz1=5.0 + 1e-7 * (np.arange(N) > 11), data=np.column_stack(SERIES), Ts=T),
        ("iz_1_a", "data_2_v", "data_3_deg"),
        {"iz_1": "A", "data_2": "V", "data_3": "deg"},
        time_unit="s",
    ),
    "five loops in a MAT file": Raw(
        "loops.mat",
        matlab(
            loops=np.array([{"t": TIME[:n], "x_mm": ANGLE[:n], "f_n": DRIVE[:n]} for n in LENGTHS])
        ),
        ("x_mm", "f_n"),
        lengths=LENGTHS,
    ),
    "five loops as variables": Raw(
        "loops.mat",
        matlab(
            **{f"t{k}": TIME[:n] for k, n in enumerate(LENGTHS, 1)},
            **{f"x{k}": ANGLE[:n] for k, n in enumerate(LENGTHS, 1)},
        ),
        ("x_mm",),
        {"x": "mm"},
        lengths=LENGTHS,
    ),
    "runs in the groups of a TDMS file": Raw(
        "bench.tdms", tdms, ("drive_v", "angle_deg"), lengths=(900, 1000)
    ),
    "JSON, an array of records": Raw(
        "log.json",
        lambda path: path.write_text(json.dumps(records())),
        ("u_v", "angle_deg"),
        {"u": "V"},
    ),
    "JSON, a record of arrays": Raw(
        "log.json",
        lambda path: path.write_text(
            json.dumps({"t": TIME.tolist(), "u_v": DRIVE.tolist(), "angle_deg": ANGLE.tolist()})
        ),
        ("u_v", "angle_deg"),
    ),
    "JSON, a record in each line": Raw(
        "log.jsonl",
        lambda path: path.write_text("\n".join(map(json.dumps, records(1.7e9 + TIME))) + "\n"),
        ("u_v", "angle_deg"),
        {"u": "V"},
    ),
    "JSON, nested": Raw(
        "rollout.json",
        nested,
        ("actions_1_n_m", "actions_2_n_m", "angle_rad"),
        {"actions_1": "N m", "actions_2": "N m", "angle": "rad"},
    ),
    "JSON, episodes": Raw("episodes.json", episodes, ("angle_deg",), lengths=LENGTHS),
    "a serial monitor with times": Raw(
        "monitor.txt",
        lines(lambda t, u, y: f"{clock_time(t, '%H:%M:%S.%f')} -> {u:.15g},{y:.15g}"),
        ("column_2_v", "column_3_deg"),
        {"column_2": "V", "column_3": "deg"},
    ),
    "a serial plotter, names beside the numbers": Raw(
        "plotter.txt",
        lines(lambda t, u, y: f"u_v:{u:.15g},angle_deg:{y:.15g}"),
        ("u_v", "angle_deg"),
        period=T,
    ),
    "a serial monitor, names and units beside the numbers": Raw(
        "monitor.txt",
        lines(lambda t, u, y: f"Drive: {u:.15g} V, Angle: {y:.15g} deg"),
        ("drive_v", "angle_deg"),
        period=T,
    ),
    "keys and values in each line": Raw(
        "node.log",
        lines(lambda t, u, y: f"t={t:.4f} u_v={u:.15g} angle_deg={y:.15g}"),
        ("u_v", "angle_deg"),
    ),
    "an oscilloscope that counts rows": Raw(
        "rigol.csv",
        table(
            (np.arange(N) * 1.0, DRIVE, ANGLE),
            "X,CH1,CH2,Start,Increment\nSequence,Volt,Volt,0.0e+00,2.0e-02\n",
            mark=",",
            end=",,",
        ),
        ("x", "ch_1_v", "ch_2_v"),
        period=T,
    ),
    "an oscilloscope with a head": Raw(
        "scope.csv",
        table(SERIES, "Model,MSO54\nSample Interval,2e-02\n\nTIME,CH1,CH2\n"),
        ("ch_1_v", "ch_2_v"),
        {"ch_1": "V", "ch_2": "V"},
    ),
    "a date and a time of day past midnight": Raw(
        "plc.csv",
        lambda path: path.write_text(
            "Datum;Uhrzeit;Soll [V];Ist [°C]\n"
            + "".join(
                f"{clock_time(t, '%d.%m.%Y;%H:%M:%S.%f')};{u:.15g};{y:.15g}\n".replace(
                    ".", ","
                ).replace(",", ".", 2)
                for t, u, y in zip(*SERIES, strict=True)
            )
        ),
        ("soll_v", "ist_degc"),
    ),
    "an oscilloscope with channels called by letters": Raw(
        "pico.csv",
        lines(
            lambda t, u, y: f"{1e3 * t:.6f},{u:.15g},{1e3 * y:.15g}",
            "Time,Channel A,Channel B\n(ms),(V),(mV)\n\n",
            newline="\r\n",
        ),
        ("channela_v", "channel_b_mv"),
    ),
    "an oscilloscope with settings beside its numbers": Raw(
        "tek.csv", tektronix, ("column_5",), {"column_5": "1"}, time_unit="s"
    ),
    "rows of names and of units with labels": Raw(
        "yoko.csv",
        table(
            (np.full(N, np.nan), DRIVE, ANGLE),
            '"Model","DL850"\n"TraceName","CH1","CH2"\n"BlockSize",1200,1200\n'
            '"VUnit","V","deg"\n"SampleRate",5.0E+01,5.0E+01\n\n',
        ),
        ("ch_1_v", "ch_2_deg"),
    ),
    "a scope of a controller, labels and a clock for each channel": Raw(
        "twincat.csv",
        lines(
            lambda t, u, y: f"{1e3 * t:g};{u:.15g};{1e3 * t:g};{y:.15g}".replace(".", ","),
            "Name;Scope\nFile;C:\\scope.tcscopex\n\nName;SetTorque;Name;ActPos\n"
            "SampleTime[ms];20;SampleTime[ms];20\nUnit;Nm;Unit;deg\n\n",
        ),
        ("set_torque_n_m", "act_pos_deg"),
    ),
    "units behind the names, as DIN 461 has it": Raw(
        "din.csv", table(SERIES, "t / s;U / V;Winkel in °\n", ";", ","), ("u_v", "winkel_deg")
    ),
    "units in every cell": Raw(
        "panel.csv",
        lines(
            lambda t, u, y: f'"{clock_time(t, "%Y-%m-%d %H:%M:%S.%f")}",{u:.15g} V,{y:.15g} °C',
            '"Time","drive","temp"\n',
        ),
        ("drive_v", "temp_degc"),
    ),
    "names that end in units which columns do not have": Raw(
        "log.csv", table(SERIES, "time_sec,flow_sec,angle_degrees\n"), ("flow_s", "angle_deg")
    ),
    "ROS, whole seconds and nanoseconds": Raw(
        "topic.csv",
        lines(
            lambda t, u, y: ",".join(map(str, (*parts(t), "base", f"{u:.15g}", f"{y:.15g}"))),
            "header.stamp.secs,header.stamp.nsecs,header.frame_id,effort,position\n",
        ),
        ("effort_n_m", "position_deg"),
        {"effort": "N m", "position": "deg"},
    ),
    "ros2 topic echo --csv, without names": Raw(
        "echo.csv",
        lines(lambda t, u, y: ",".join(map(str, (*parts(t), "base", f"{u:.15g}", f"{y:.15g}")))),
        ("column_4_n_m", "column_5_deg"),
        {"column_4": "N m", "column_5": "deg"},
    ),
    "a message of ROS in each line": Raw(
        "topic.jsonl",
        lines(lambda t, u, y: json.dumps(stamped(t, u, y))),
        ("effort_n_m", "position_deg"),
        {"effort": "N m", "position": "deg"},
    ),
    "timeval, seconds and microseconds": Raw(
        "log.csv",
        lines(
            lambda t, u, y: ",".join(map(str, (*parts(t, 10**6), f"{u:.15g}", f"{y:.15g}"))),
            "tv_sec,tv_usec,u_v,angle_deg\n",
        ),
        ("u_v", "angle_deg"),
    ),
    "hours, minutes, seconds and milliseconds past midnight": Raw(
        "rtc.csv",
        lines(
            lambda t, u, y: f"{clock_time(t, '%H,%M,%S,%f')},{u:.15g},{y:.15g}",
            "hour,minute,second,millisecond,u_v,angle_deg\n",
        ),
        ("u_v", "angle_deg"),
    ),
    "two clocks, that of the device is even": Raw(
        "px4.csv",
        lines(
            lambda t, u, y: (
                f"{round(1e6 * t + 800.0 * abs(math.sin(99.0 * t)))},{round(1e6 * t)},{u:.15g},"
                f"{y:.15g}"
            ),
            "timestamp,timestamp_sample,u_v,angle_deg\n",
        ),
        ("u_v", "angle_deg"),
        time_unit="us",
    ),
    "a sampling rate in a comment": Raw(
        "daq.csv",
        table((DRIVE, ANGLE), "# DAQ 2\n# Fs = 50 Hz\nu_v,angle_deg\n"),
        ("u_v", "angle_deg"),
    ),
    "a sampling interval above the names": Raw(
        "scope.csv",
        table(
            (np.arange(N) * 1.0, DRIVE, ANGLE),
            "Sample Interval,2.0E-02,s\nRecord Length,1200\n\nSample,u_v,angle_deg\n",
        ),
        ("sample", "u_v", "angle_deg"),
    ),
    "the unit of the clock by the sampling rate that is stated": Raw(
        "daq.csv",
        table((1e3 * TIME, DRIVE, ANGLE), "# sample rate: 50 Hz\nclock,u_v,angle_deg\n"),
        ("u_v", "angle_deg"),
    ),
    "one value a row": Raw(
        "long.csv",
        lines(
            lambda t, u, y: f"{t:.2f},u_v,{u:.15g}\n{t:.2f},angle_deg,{y:.15g}",
            "time,signal,value\n",
        ),
        ("u_v", "angle_deg"),
    ),
    "one value a row, tables one below the other": Raw(
        "influx.csv", annotated, ("drive_v", "angle_deg")
    ),
    "dates with the month first": Raw(
        "hobo.csv",
        lines(
            lambda t, u, y: (
                f"{clock_time(t, '%m/%d/%y %I:%M:%S.%f')} {'PM' if t < 10 else 'AM'},"
                f"{u:.15g},{y:.15g}"
            ),
            '"Date Time, GMT+01:00","Volt, V (LGR S/N: 1)","Temp, °C (LGR S/N: 1)"\n',
        ),
        ("volt_v", "temp_degc"),
    ),
    "exponents of Fortran": Raw(
        "run.txt",
        lines(lambda t, u, y: f"{t:.8E} {u:.15E} {y:.15E}".replace("E", "D")),
        ("column_2_v", "column_3_deg"),
        {"column_2": "V", "column_3": "deg"},
        time_unit="s",
    ),
    "UTF-16 without a mark": Raw(
        "bench.csv",
        lines(
            lambda t, u, y: f"{t:.2f}\t{u:.15g}\t{y:.15g}".replace(".", ","),
            "Zeit [s]\tSpannung [V]\tWinkel [°]\n",
            "utf-16-le",
        ),
        ("spannung_v", "winkel_deg"),
    ),
    "a program's log with a time before the names": Raw(
        "node.log",
        lines(
            lambda t, u, y: (
                f"{clock_time(t, '%Y-%m-%d %H:%M:%S,%f')} INFO motor: u_v={u:.15g} "
                f"angle_deg={y:.15g}"
            )
        ),
        ("u_v", "angle_deg"),
    ),
    "a timedelta of pandas, without a name": Raw(
        "frame.csv",
        lines(lambda t, u, y: f"0 days 00:00:{t:09.6f},{u:.15g},{y:.15g}", ",u_v,angle_deg\n"),
        ("u_v", "angle_deg"),
    ),
    "a logger that names, measures and averages in three rows": Raw(
        "toa5.dat",
        lines(
            lambda t, u, y: (
                f'"{clock_time(t, "%Y-%m-%d %H:%M:%S.%f")}",{round(50 * t)},{u:.15g},{y:.15g}'
            ),
            '"TOA5","CR6","CR6","1234","Std.05","CPU:a.CR6","12345","Table1"\n'
            '"TIMESTAMP","RECORD","Batt","Angle"\n"TS","RN","Volts","deg"\n"","","Avg","Smp"\n',
        ),
        ("record", "batt_v", "angle_deg"),
    ),
    "types and units below the names": Raw(
        "inspector.csv",
        table(
            SERIES,
            "time,drive,angle\n,Type: double,Type: double\n,Units: V,Units: deg\n"
            ",Interp: zoh,Interp: linear\n",
        ),
        ("drive_v", "angle_deg"),
    ),
    "groups of an HDF5 file": Raw("runs.h5", runs, ("angle_deg",), lengths=LENGTHS),
}


def answered(text: str, raw: Raw) -> str:
    """The guessed mapping with the answers to what it asks."""
    for column, unit in raw.units.items():
        head, _, tail = text.partition(f"[signals.{column}]")
        text = f"{head}[signals.{column}]" + tail.replace('"?"', json.dumps(unit), 1)
    return text.replace('unit = "?"', f'unit = "{raw.time_unit}"', 1) if raw.time_unit else text


def through(folder: Path, raw: Raw) -> tuple[GuessedMapping, IngestResult]:
    log, mapping = folder / raw.file, folder / "map.toml"
    raw.write(log)
    guessed = pamid.guess_mapping(log)
    mapping.write_text(answered(guessed.text, raw))
    return guessed, pamid.ingest(log, mapping, period=raw.period)


@pytest.mark.parametrize("name", LOGS)
def test_a_raw_log_becomes_recordings(name, tmp_path):
    raw = LOGS[name]
    guessed, made = through(tmp_path, raw)
    assert set(guessed.open) == raw.asked
    assert "one-dof" not in guessed.text.replace("# rig", "")
    assert [tuple(one.columns) for one in made.recordings] == [raw.columns] * len(raw.lengths)
    period = raw.period or {"min": 60.0}.get(raw.time_unit, T)
    assert [len(one) for one in made.recordings] == list(raw.lengths)
    for recording in made.recordings:
        assert recording.sampling_period_s == pytest.approx(period, rel=1e-9)
        last = list(recording.columns)[-1]
        others = {"f_n": DRIVE, "enc": 9.0 * ANGLE, "channel_b_mv": 1e3 * ANGLE}
        wanted = others.get(last, ANGLE)[: len(recording)]
        assert recording.columns[last] == pytest.approx(wanted, rel=1e-7, abs=1e-6), last


def test_an_unanswered_period_is_asked_for_like_a_unit(tmp_path, capsys):
    raw = LOGS["two columns without a clock"]
    raw.write(tmp_path / "dryer.dat")
    mapping = tmp_path / "map.toml"
    guess = ["ingest", "--guess", str(tmp_path / "dryer.dat"), "--output", str(mapping)]
    assert frame.run(guess) == 0
    assert "to be filled in: time.period_s" in capsys.readouterr().out
    tables = tomllib.loads(mapping.read_text())
    assert tables["time"]["period_s"] == "?" and "max_gap_s" not in tables["time"]
    with pytest.raises(FileError, match=r"time\.period_s is \"\?\"") as caught:
        pamid.ingest(tmp_path / "dryer.dat", mapping)
    assert "--period" in caught.value.hint and caught.value.code == "period"
    assert frame.run([*guess, "--overwrite", "--period", "0.08"]) == 0
    assert tomllib.loads(mapping.read_text())["time"]["period_s"] == 0.08


LATER = 7e-3  # s, of the second signal of a log in which signals take turns


@pytest.mark.parametrize(
    "form",
    [
        "{t:.4f},drive_v,{u:.15g}\n{later:.4f},angle_deg,{y:.15g}",
        "{t:.4f},17,cmd,{u:.15g},\n{later:.4f},18,state,,{y:.15g}",
    ],
)
def test_signals_that_take_turns_have_their_own_clocks(form, tmp_path):
    wide = "cmd" in form
    head = "time_s,id,message,drive_v,angle_deg\n" if wide else "time_s,signal,value\n"
    log, mapping = tmp_path / "bus.csv", tmp_path / "map.toml"
    lines(lambda t, u, y: form.format(t=t, later=t + LATER, u=u, y=y), head)(log)
    guessed = pamid.guess_mapping(log, output=mapping)
    assert guessed.open == () and ("id" in str(guessed.notes)) == wide
    (recording,) = pamid.ingest(log, mapping).recordings
    assert recording.sampling_period_s == pytest.approx(T) and tuple(recording.columns) == (
        "drive_v",
        "angle_deg",
    )
    count = min(len(recording), N - 2)
    drive = recording.columns["drive_v"][:count]
    assert drive == pytest.approx(DRIVE[1 : count + 1])  # from the first row with both on
    between = np.interp(TIME + T, TIME + LATER, ANGLE)[:count]
    assert recording.columns["angle_deg"][:count] == pytest.approx(between, abs=0.05)
    assert np.abs(between - ANGLE[1 : count + 1]).max() > 0.1


class Bomb:
    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return pytest.fail, ("the pickle was loaded",)


def member(name: str) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr(name, "x" * 100)
    return packed.getvalue()


def repeated_lines(form: str) -> bytes:
    return "".join(form.format(t=t, k=k) for k, t in enumerate(TIME[:200])).encode()


NO_LOGS = {
    "a pickle": ("log.pkl", pickle.dumps(Bomb()), "because it runs code", "to_parquet"),
    "an old pickle": ("log.pickle", pickle.dumps(Bomb(), 0), "runs code", "to_parquet"),
    "gzip": ("log.csv.gz", gzip.compress(b"t,u\n0,1\n", mtime=0), "gzip", "gunzip -k "),
    "bzip2": ("log.csv.bz2", bz2.compress(b"t,u\n0,1\n"), "bzip2", "bunzip2 -k "),
    "xz": ("log.csv.xz", lzma.compress(b"t,u\n0,1\n"), "packed with xz", "unxz -k "),
    "zip": ("log.zip", member("log.csv"), "a packed archive", "unzip "),
    "a workbook": ("log.xlsx", member("[Content_Types].xml"), "a workbook", "Save it as CSV"),
    "npz": ("log.npz", member("u.npy"), "an archive of NumPy", "with names"),
    "Feather": ("log.feather", b"ARROW1\0\0" + b"\1" * 99, "a Feather", "to_parquet"),
    "a database": ("log.db", b"SQLite format 3\0" + b"\1" * 99, "not a ROS bag", "sqlite3 -header"),
    "ULog": ("log.ulg", b"ULog\x01\x12\x35\x01" + b"\1" * 99, "a ULog", "ulog2csv "),
    "BLF": ("log.blf", b"LOGG" + b"\1" * 99, "CAN frames", "MDF4"),
    "frames of CANalyzer": (
        "bus.asc",
        b"date Tue Mar 4 10:00:00.000 am 2025\nbase hex  timestamps absolute\n"
        + repeated_lines("   {t:.6f} 1  123             Rx   d 2 0A {k:02X}\n"),
        "frames of a CAN bus",
        "DBC",
    ),
    "candump": ("bus.log", repeated_lines("({t:.6f}) can0 123#0A{k:02X}\n"), "CAN bus", "DBC"),
    "YAML": (
        "topic.txt",
        repeated_lines("header:\n  stamp:\n    sec: {k}\nposition:\n- {t:.3f}\n---\n"),
        "a value a line",
        "ros2 topic echo --csv",
    ),
    "rows of several kinds": (
        "flight.log",
        repeated_lines("IMU, {k}, 0, 0.5, {t:.2f}\nATT, {k}, {t:.2f}\n"),
        "cells, the numbers from line",
        "grep '^IMU,' ",
    ),
    "signals in rows": (
        "rows.csv",
        b"time_s," + b",".join(b"%d" % k for k in range(N)) + b"\nu_v" + N * b",1\n"[:2] + b"\n",
        "the signals are rows, not columns: 2 rows",
        ".T.to_csv",
    ),
    "thousands with separators": (
        "log.csv",
        b"time_s;u_v\n" + b"".join(b"%d;1,%03d.5\n" % (k, k) for k in range(100)),
        "log.csv, line 2: '1,000.5' has its thousands separated",
        "without separators",
    ),
}


@pytest.mark.parametrize("name", NO_LOGS)
def test_no_log_is_refused_with_the_cure(name, tmp_path):
    file, content, what, cure = NO_LOGS[name]
    (tmp_path / file).write_bytes(content)
    with pytest.raises(FileError) as caught:
        pamid.guess_mapping(tmp_path / file)
    assert what in caught.value.message and cure in caught.value.hint
    assert " FILE." not in caught.value.hint  # the command names the file


def test_a_large_json_is_refused_before_it_is_read(tmp_path):
    (tmp_path / "log.json").write_text(json.dumps(records()))
    with pytest.raises(FileError, match="--memory-limit"):
        pamid.guess_mapping(tmp_path / "log.json", memory_limit=0.0005)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('{"t": [1, 2, 3', "this is not JSON"),
        ('{"a": 1, "b": "x"}', "there are no signals in it"),
        ("[" * 100_000, "cannot be read as json"),
    ],
)
def test_json_that_is_no_log_is_refused(text, why, tmp_path):
    path = tmp_path / "log.json"
    path.write_text(text)
    with pytest.raises(FileError, match=why):
        pamid.guess_mapping(path)
