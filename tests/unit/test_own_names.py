"""A log that no rig has names for becomes a recording with all of its channels."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pamid_cli import frame

import pamid
from pamid.base.errors import FileError
from pamid.ingest.channels import Channel
from pamid.ingest.guessed_mapping import guess_of
from pamid.ingest.log_reader import read_log
from pamid.ingest.own_names import own_columns
from pamid.model.registry import rig_named
from pamid.recording.recording import read_recording

COUNT = 900


def channel(name: str, unit: str = "") -> Channel:
    return Channel(name, np.zeros(3), unit=unit)


def test_names_and_units_are_spelt_as_a_recording_spells_them() -> None:
    found = own_columns(
        [
            channel("M_soll", "Nm"),
            channel("Winkel Abtrieb", "°"),
            channel("Drehzahl", "1/min"),
            channel("bench/speed_rpm"),
            channel("Größe", "furlong"),
            channel("2. Druck", "bar"),
            channel("p"),
            channel("P"),
        ]
    )
    assert {column: text for column, (_, text) in found.items()} == {
        "m_soll_n_m": "Nm",
        "winkel_abtrieb_deg": "°",
        "drehzahl_rpm": "U/min",
        "speed_rpm": "rpm",
        "grosse": "",
        "channel_2_druck_bar": "bar",
        "p": "",
        "p_2": "",
    }


def strangers_log(folder: Path) -> Path:
    """A torque servo: odd names, units in brackets, 300 Hz in stamps of four decimals."""
    random = np.random.default_rng(2)
    torque = np.repeat(random.uniform(-1.0, 1.0, COUNT), random.integers(10, 40, COUNT))[:COUNT]
    angle = np.cumsum(np.cumsum(torque)) / 300.0
    rows = "".join(
        f"{k / 300.0:.4f},{u:.3f},{a:.2f}\n"
        for k, (u, a) in enumerate(zip(torque, angle, strict=True))
    )
    path = folder / "messung.csv"
    path.write_text("Zeit [s],M_soll [Nm],Winkel [deg]\n" + rows, encoding="utf-8")
    return path


def test_from_a_strangers_log_to_a_rig_of_ones_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    log = strangers_log(tmp_path)
    assert frame.run(["check", str(log)]) == 3
    assert f"pamid ingest --guess {log}" in capsys.readouterr().out
    assert frame.run(["ingest", "--guess", str(log), "--output", "map.toml"]) == 0
    assert "2 of 2 channels guessed" in capsys.readouterr().out
    assert frame.run(["ingest", str(log), "--mapping", "map.toml", "--output", "rec.csv"]) == 0
    recording = read_recording("rec.csv")
    assert recording.rig is None and set(recording.columns) == {"m_soll_n_m", "winkel_deg"}
    capsys.readouterr()
    assert frame.run(["new-rig", "rec.csv", "--output", "belt.py", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["like"] == "servo-axis" and said["unused"] == []
    assert [c["stands_for"] for c in said["columns"]] == ["torque_nm", "angle_deg"]


def oven_log(folder: Path) -> Path:
    """Records of an oven: an epoch stamp, a heater in percent, a thermocouple in Fahrenheit."""
    heat = np.repeat([0.0, 100.0, 40.0], 60)
    degf = 70.0 + np.cumsum(heat) / 50.0
    records = [
        {"timestamp": 1717416000.0 + 2.0 * k, "heater_pct": q, "tc_degF": round(t, 1)}
        for k, (q, t) in enumerate(zip(heat.tolist(), degf.tolist(), strict=True))
    ]
    path = folder / "oven.json"
    path.write_text(json.dumps(records), encoding="utf-8")
    return path


def test_percent_and_fahrenheit_are_units_of_a_name(tmp_path: Path) -> None:
    log = oven_log(tmp_path)
    alone = guess_of(read_log(log))
    assert alone.open == ()
    mapping = tmp_path / "map.toml"
    mapping.write_text(alone.text, encoding="utf-8")
    words = ["ingest", str(log), "--mapping", str(mapping), "--output", str(tmp_path / "rec.csv")]
    assert frame.run(words) == 0
    recording = read_recording(tmp_path / "rec.csv")
    assert set(recording.columns) == {"heater_percent", "tc_degf"}
    assert recording.columns["tc_degf"][0] == pytest.approx(70.0)
    assert recording.columns["heater_percent"].max() == pytest.approx(100.0)


def test_a_duty_is_mapped_to_the_power_with_a_question(tmp_path: Path) -> None:
    guessed = guess_of(read_log(oven_log(tmp_path)), rig_named("thermal-two-mass"))
    assert guessed.mapped == 2 and guessed.open == ("signals.power_w.unit",)
    assert 'or scale = W per "percent"' in guessed.text
    # the room's temperature is optional, and comes last
    assert (
        "ambient_degc" not in guessed.text and "[signals.element_temperature_degc]" in guessed.text
    )


def test_only_a_rig_that_is_named_is_mapped_to(tmp_path: Path) -> None:
    joint = Path(__file__).resolve().parents[2] / "data" / "example" / "joint.csv"
    guessed = pamid.guess_mapping(joint)
    assert '\nrig = "one-dof"' not in guessed.text and guessed.mapped == guessed.channels == 7
    log = strangers_log(tmp_path)
    guessed = pamid.guess_mapping(log, "one-dof")
    assert 'rig = "one-dof"' in guessed.text and "M_soll" in guessed.notes[-1]
    with pytest.raises(FileError):
        pamid.new_rig(log, output=tmp_path / "mine.py")


def test_errors_on_the_way_name_the_cure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Another dialect is one problem, not three; a rig file is named by its path; columns that fit
    no rig may have one written."""
    monkeypatch.chdir(tmp_path)
    text = strangers_log(tmp_path).read_text(encoding="utf-8")
    Path("de.csv").write_text(text.replace(",", ";").replace(".", ","), encoding="utf-8")
    assert frame.run(["check", "de.csv", "--json"]) == 3
    findings = json.loads(capsys.readouterr().out)["findings"]
    assert len(findings) == 1 and "pamid ingest --guess de.csv" in findings[0]["detail"]
    Path("belt.py").write_text("", encoding="utf-8")
    with pytest.raises(FileError) as caught:
        pamid.diagnose("rec.csv", "belt", output=tmp_path / "run")
    assert "./belt.py" in caught.value.hint
    recorded = "time_s,m_soll_n_m,winkel_deg\n" + text.partition("\n")[2]
    Path("rec.csv").write_text(recorded, encoding="utf-8")
    assert frame.run(["fit", "rec.csv", "--rig", "one-dof", "--output", "run"]) == 3
    assert "pamid new-rig rec.csv" in capsys.readouterr().err


def test_what_moves_in_steps_is_held(tmp_path: Path) -> None:
    """A duty that somebody set, not the reading of few bits that follows it slowly."""
    random = np.random.default_rng(4)
    duty = np.repeat(random.uniform(0.0, 100.0, 30), 30)
    heat = np.convolve(duty, np.exp(-np.arange(400) / 90.0) / 90.0)[:COUNT]
    heat = 0.32 * np.round(heat / 0.32)
    rows = "".join(
        f"{3 * k},{q:.2f},{t:.2f}\n" for k, (q, t) in enumerate(zip(duty, heat, strict=True))
    )
    path = tmp_path / "lab.csv"
    path.write_text("Time (s),Heater,Sensor (degC)\n" + rows, encoding="utf-8")
    text = guess_of(read_log(path)).text
    heater, sensor = text.partition("[signals.heater]")[2].split("[signals.sensor_degc]")
    assert 'interpolation = "hold"' in heater and "interpolation" not in sensor
    assert 'unit = "?"' in heater


def test_an_undecided_clock_is_a_question(tmp_path: Path) -> None:
    """Irregular stamps, and no signal that moves enough to tell why."""
    random = np.random.default_rng(6)
    stamps = np.cumsum(2.0 + random.exponential(0.4, COUNT))
    rows = "".join(f"{t:.3f},{random.normal():.3f}\n" for t in stamps)
    path = tmp_path / "odd.csv"
    path.write_text("time_s,noise_v\n" + rows, encoding="utf-8")
    assert guess_of(read_log(path)).open == ("time.repair",)
