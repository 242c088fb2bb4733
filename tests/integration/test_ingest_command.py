"""`pamid ingest`: raw logs in, recordings out, with every repair told; all files or none."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pamid_cli import frame

from pamid.base.arrays import Array
from pamid.intake.logs import conversion_record
from pamid.intake.logs.channels import Channel, Log
from pamid.intake.logs.conversion import Conversion, convert
from pamid.intake.logs.mapping import mapping_of
from pamid.model.registry import rig_named
from pamid.recording.recording import Recording, read_recording, write_recording

T, N = 0.003, 2000
ONE_DOF = rig_named("one-dof")


def plant(t: Array) -> dict[str, Array]:
    """What an arm might do at the times t (s), in the units of the columns, with the digits of a
    recording."""
    angle = 20.0 * np.sin(2 * np.pi * 0.4 * t) + 2.0 * np.sin(2 * np.pi * 9.0 * t)
    made = {
        "reference_deg": 20.0 * np.sign(np.sin(2 * np.pi * 0.4 * t)),
        "command": np.clip(np.cos(5 * t), -0.9, 0.9),
        "angle_deg": angle,
        "pressure_1_kpa": 400.0 + 5.0 * angle,
        "pressure_2_kpa": 400.0 - 5.0 * angle,
    }
    return {
        name: np.array([float(f"{value:.9g}") for value in values]) for name, values in made.items()
    }


def ran(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any]]:
    code = frame.run(["ingest", *words, "--json"])
    return code, json.loads(capsys.readouterr().out)


def converted(
    capsys: pytest.CaptureFixture[str], output: str = "rec.csv", *more: str, log: str = "log.csv"
) -> tuple[int, dict[str, Any]]:
    """What the command says of a log with the mapping map.toml."""
    return ran(capsys, log, "--mapping", "map.toml", "--output", output, *more)


MAPPING = """
rig = "one-dof"
loop = "closed"
[time]
source = "Zeit"
unit = "ms"
{time}
[signals.reference_deg]
source = "Soll"
unit = "rad"
sign = -1
[signals.command]
source = "u"
unit = "%"
[signals.angle_deg]
source = "Ist"
unit = "rad"
sign = -1
offset = 1.5
[signals.pressure_1_kpa]
source = "p1"
unit = "bar"
pressure = "absolute"
[signals.pressure_2_kpa]
source = "p2"
unit = "psi"
pressure = "gauge"
[atmosphere]
pressure_kpa = 98.7
[known]
inertia_kg_m2 = 0.0896
[controller]
kp_per_deg = 0.1
"""


def raw(t: Array, stamps: Array) -> dict[str, Array]:
    """The same in the units, signs and offsets of the mapping's log."""
    y = plant(t)
    return {
        "Zeit": stamps * 1e3,
        "Soll": -np.radians(y["reference_deg"]),
        "u": 100.0 * y["command"],
        "Ist": -np.radians(y["angle_deg"] - 1.5),
        "p1": (y["pressure_1_kpa"] + 98.7) / 100.0,
        "p2": y["pressure_2_kpa"] / 6.894757293168361,
    }


def write_log(path: Path, columns: dict[str, Array], *, comma: str = ",") -> None:
    """A German CSV: semicolons and decimal commas, nothing where a value is missing."""
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    lines = [
        ";".join("" if value != value else repr(value).replace(".", comma) for value in row)
        for row in rows
    ]
    path.write_text(";".join(columns) + "\n" + "\n".join(lines) + "\n", encoding="utf-8")


def prepare(stamps: Array | None = None, t: Array | None = None, time: str = "") -> None:
    t = np.arange(N) * T if t is None else t
    write_log(Path("log.csv"), raw(t, t if stamps is None else stamps))
    Path("map.toml").write_text(MAPPING.format(time=time), encoding="utf-8")


def require_plant(made: Recording, t: Array) -> None:
    for name, values in plant(t).items():
        assert made.columns[name] == pytest.approx(values, rel=1e-9, abs=1e-12), name


# ---- there and back --------------------


def test_a_recording_comes_back_from_raw_form(here, capsys):
    prepare()
    code, said = converted(capsys)
    assert code == 0 and said["schema"] == "pamid.ingest/1"
    made = read_recording("rec.csv")
    require_plant(made, np.arange(N) * T)
    assert (made.loop, made.rig, made.sampling_period_s) == ("closed", "one-dof", T)
    assert made.known == {"inertia_kg_m2": 0.0896} and made.controller == {"kp_per_deg": 0.1}
    told = json.loads(Path("rec.ingest.json").read_text())
    assert told == said["recordings"][0] and told["schema"] == "pamid.ingest/1"
    assert (
        len(told["source"]["sha256"]) == 64
        and told["mapping"]["signals"]["angle_deg"]["sign"] == -1
    )
    assert told["clocks"][0]["state"] == "even" and told["clocks"][0]["repairs"] == []
    assert told["signals"]["pressure_1_kpa"]["atmosphere_taken_off_kpa"] == 98.7
    assert sorted(p.name for p in here.iterdir()) == [
        "log.csv",
        "map.toml",
        "rec.csv",
        "rec.ingest.json",
        "rec.toml",
    ]


def test_guess_then_ingest_gives_the_recording_back(here, capsys):
    t = np.arange(N) * T
    write_recording("known.csv", t, plant(t), {"recording": {"loop": "closed"}})
    guess = ("--guess", "known.csv", "--rig", "one-dof")
    code, said = ran(capsys, *guess, "--output", "map.toml")
    assert code == 0 and said["open"] == [
        "signals.pressure_1_kpa.pressure",
        "signals.pressure_2_kpa.pressure",
    ]
    code, error = converted(capsys, log="known.csv")
    assert code == 3 and error["message"].startswith(
        'map.toml: signals.pressure_1_kpa.pressure is "?"; allowed: "gaug'
    )
    assert converted(capsys, "rec.csv", "--pressures", "gauge", log="known.csv")[0] == 0
    before, after = read_recording("known.csv"), read_recording("rec.csv")
    assert after.columns.keys() == before.columns.keys()
    assert all((after.columns[c] == before.columns[c]).all() for c in before.columns)
    assert frame.run(["ingest", *guess]) == 0
    assert capsys.readouterr().out == Path("map.toml").read_text()


# ---- the time base, end to end --------------------


def late(t: Array, seed: int = 0) -> Array:
    wait = np.random.default_rng(seed).exponential(0.8e-3, t.size)
    return np.asarray(np.maximum.accumulate(t + wait) + 1e-9 * np.arange(t.size))


def test_jittered_sampling_is_resampled_by_the_stamps(here, capsys):
    t = np.sort(np.arange(N) * T + np.random.default_rng(1).normal(0.0, 0.8e-3, N))
    prepare(t, t, "period_s = 0.003")
    code, said = converted(capsys)
    assert code == 0 and said["recordings"][0]["clocks"][0]["cure"] == "jittered-sampling"
    made = read_recording("rec.csv")
    true = plant(t[0] + made.time)
    assert np.sqrt(np.mean((made.columns["angle_deg"] - true["angle_deg"]) ** 2)) < 0.004
    # held, nothing in between
    assert set(np.unique(made.columns["reference_deg"])) <= {-20.0, 20.0}
    words = "log.csv --mapping map.toml --output o.csv --time-base late-stamps"
    frame.run(["ingest", *words.split()])
    assert "the data speak against late-stamps" in capsys.readouterr().err


def test_where_the_data_do_not_tell_it_is_asked(here, capsys):
    t = np.arange(N) * T
    write_log(Path("log.csv"), raw(np.zeros(N), late(t)))
    Path("map.toml").write_text(MAPPING.format(time=""), encoding="utf-8")
    code, error = converted(capsys)
    assert code == 4 and "no signal moves enough" in error["message"]
    assert "late-stamps" in error["hint"] and "jittered-sampling" in error["hint"]
    assert not list(here.glob("rec*"))
    assert converted(capsys, "rec.csv", "--time-base", "late-stamps")[0] == 0
    Path("map.toml").write_text(MAPPING.format(time='repair = "none"'), encoding="utf-8")
    code, error = converted(capsys, "o.csv")
    assert code == 3 and 'time.repair is "none"' in error["message"]


def test_gaps_and_long_empty_runs_split_and_short_ones_are_filled(here, capsys):
    k = np.arange(N)
    t = k * T + (k >= 800) * 1.2345
    log = raw(t, t)
    log["Ist"][300:304] = np.nan  # 15 ms: filled
    log["p1"][1500:1520] = np.nan  # 63 ms: split
    log["p2"][1990:] = np.nan  # the end is missing
    stay = (k != 600) & (k != 601)  # two rows never came
    write_log(Path("log.csv"), {name: values[stay] for name, values in log.items()})
    Path("map.toml").write_text(MAPPING.format(time="max_gap_s = 0.05"), encoding="utf-8")
    code, said = converted(capsys, "out")
    assert code == 0
    told = said["recordings"]
    assert [part["recording"]["path"] for part in told] == [
        "out/log-1.csv",
        "out/log-2.csv",
        "out/log-3.csv",
    ]
    assert [part["recording"]["samples"] for part in told] == [800, 700, 470]
    assert [part["recording"]["first_row"] for part in told] == [0, 798, 1518]
    repairs = {repair["what"]: repair["count"] for repair in told[0]["clocks"][0]["repairs"]}
    assert repairs == {"samples-missing": 2, "gaps": 1}
    assert told[0]["signals"]["angle_deg"]["empty_cells"] == 4
    for part, begin in zip(told, (0, 800, 1520), strict=True):
        made = read_recording(part["recording"]["path"])
        rows = slice(begin, begin + len(made))
        kept = np.ones(len(made), dtype=bool)
        if begin == 0:
            kept[[300, 301, 302, 303, 600, 601]] = False
        true = plant(t[rows])
        assert made.columns["angle_deg"][kept] == pytest.approx(true["angle_deg"][kept], rel=1e-9)
        assert made.columns["angle_deg"] == pytest.approx(true["angle_deg"], abs=0.2)


# ---- logs whose channels have clocks of their own --------------------


def made_of(channels: list[Channel], signals: dict[str, str], **time: Any) -> Conversion:
    tables: dict[str, Any] = {"time": time, "signals": {}}
    for column, source in signals.items():
        tables["signals"][column] = {"source": source}
        if column.startswith("pressure"):
            tables["signals"][column]["pressure"] = "gauge"
    mapping = mapping_of({**tables, "rig": "one-dof"}, "map.toml")
    return convert(Log(Path("log.mf4"), "mdf", tuple(channels)), mapping, ONE_DOF, "map.toml")


def test_every_channel_comes_to_the_common_base_in_its_own_way():
    """Events, a slow pressure and a fast angle with a line that must not alias."""
    slow, mid, fast = (np.arange(0.0, 12.0, period) for period in (0.01, 0.003, 0.001))
    events = np.array([0.0, 2.0005, 5.1, 9.3])
    levels = np.array([0.0, 0.5, -0.5, 0.25])
    angle = plant(fast)["angle_deg"] + 0.35 * np.sin(2 * np.pi * 310 * fast)
    made = made_of(
        [
            Channel("u", levels, events, ""),
            Channel("soll", plant(mid)["reference_deg"], mid, "deg"),
            Channel("w", angle, fast, "deg"),
            Channel("p", 4.0 + np.sin(slow), slow, "bar"),
        ],
        {"reference_deg": "soll", "command": "u", "angle_deg": "w", "pressure_1_kpa": "p"},
    )
    assert len(made.recordings) == 1 and made.period == T
    columns, t = made.recordings[0].columns, made.recordings[0].time
    inner = slice(50, -50)
    assert columns["angle_deg"][inner] == pytest.approx(plant(t)["angle_deg"][inner], abs=5e-5)
    assert columns["pressure_1_kpa"] == pytest.approx(400.0 + 100.0 * np.sin(t), abs=2e-3)
    assert set(columns["command"]) == {0.0, 0.5, -0.5, 0.25}
    switch = [float(t[i + 1]) for i in np.flatnonzero(np.diff(columns["command"]))]
    assert switch == pytest.approx(events[1:], abs=T / 2 + 1e-9)
    assert list(columns) == ["reference_deg", "command", "angle_deg", "pressure_1_kpa"]


def test_a_stated_period_decimates_with_the_filter():
    t = np.arange(12000) * 1e-3
    angle = plant(t)["angle_deg"] + 0.35 * np.sin(2 * np.pi * 310 * t)
    made = made_of(
        [Channel("t", t, None, "s"), Channel("w", angle, None, "deg")],
        {"angle_deg": "w"},
        source="t",
        period_s=T,
    )
    columns, base = made.recordings[0].columns, made.recordings[0].time
    assert columns["angle_deg"][50:-50] == pytest.approx(plant(base)["angle_deg"][50:-50], abs=5e-5)
    assert conversion_record.at_limit(np.array([0.0, 1.0, 1.0, 1.0, 0.5, 0.0, 0.0])) == 3


# ---- files --------------------


def test_nothing_is_replaced_without_being_told(here, capsys):
    prepare()
    Path("rec.toml").write_text("precious")
    assert converted(capsys)[1]["message"] == "rec.toml exists already."
    assert not Path("rec.csv").exists() and Path("rec.toml").read_text() == "precious"
    assert converted(capsys, "rec.csv", "--overwrite")[0] == 0
    for output in ("log.csv", "map.csv"):  # the log itself; map.toml beside map.csv
        code, error = converted(capsys, output, "--overwrite")
        assert code == 3 and "would be overwritten" in error["message"]
    code, error = converted(capsys, "rec.txt")
    assert code == 3 and "neither a .csv file nor a folder" in error["message"]


def test_what_a_killed_ingest_left_is_swept_by_the_next(here, capsys):
    prepare()
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    left, busy, link = (
        here / f".ingest-unfinished.{process}.0{number}.tmp"
        for number, process in enumerate((ended.pid, os.getppid(), ended.pid))
    )
    (here / "other").mkdir()
    (here / "other" / "rec.csv").write_text("mine")
    for stage in (left, busy):
        stage.mkdir()
        (stage / "rec.csv").write_text("half")
    link.symlink_to(here / "other")
    assert converted(capsys)[0] == 0
    assert not left.exists()
    assert (busy / "rec.csv").exists() and link.is_symlink()
    assert (here / "other" / "rec.csv").read_text() == "mine"
