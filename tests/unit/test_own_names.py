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
