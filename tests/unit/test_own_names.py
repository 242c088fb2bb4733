"""A log that no rig has names for becomes a recording with all of its channels."""

from pathlib import Path

import numpy as np
from pamid_cli import frame

from pamid.intake.logs.channel_columns import channel_columns
from pamid.intake.logs.channels import Channel
from pamid.intake.logs.guessed_mapping import guess_of
from pamid.intake.logs.log_reader import read_log
from pamid.recording.recording import read_recording

COUNT = 900


def channel(name: str, unit: str = "") -> Channel:
    return Channel(name, np.zeros(3), unit=unit)


def test_names_and_units_are_spelt_as_a_recording_spells_them():
    found = channel_columns(
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


def test_from_a_strangers_log_to_a_rig_of_ones_own(here, capsys, cli):
    log = strangers_log(here)
    assert frame.run(["check", str(log)]) == 3
    assert f"pamid ingest --guess {log}" in capsys.readouterr().out
    assert frame.run(["ingest", "--guess", str(log), "--output", "map.toml"]) == 0
    assert "2 of 2 channels guessed" in capsys.readouterr().out
    assert frame.run(["ingest", str(log), "--mapping", "map.toml", "--output", "rec.csv"]) == 0
    recording = read_recording("rec.csv")
    assert recording.rig is None and set(recording.columns) == {"m_soll_n_m", "winkel_deg"}
    capsys.readouterr()
    said = cli("new-rig", "rec.csv", "--output", "belt.py")
    assert said["like"] == "servo-axis" and said["unused"] == []
    assert [c["stands_for"] for c in said["columns"]] == ["torque_nm", "angle_deg"]


def test_what_moves_in_steps_is_held(tmp_path):
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


def test_an_undecided_clock_is_a_question(tmp_path):
    """Irregular stamps, and no signal that moves enough to tell why."""
    random = np.random.default_rng(6)
    stamps = np.cumsum(2.0 + random.exponential(0.4, COUNT))
    rows = "".join(f"{t:.3f},{random.normal():.3f}\n" for t in stamps)
    path = tmp_path / "odd.csv"
    path.write_text("time_s,noise_v\n" + rows, encoding="utf-8")
    assert guess_of(read_log(path)).open == ("time.repair",)
