"""Recordings: what is read, and that nonsense is refused with file, column and line."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pamid.recording.recording import read_recording, write_recording

ROWS = 60


def _lines() -> list[str]:
    random = np.random.default_rng(1)
    rows = [
        f"{0.003 * k:.9g},{random.uniform(-1, 1):.6f},{20 * np.sin(0.1 * k):.6f},{300 + k:.3f}"
        for k in range(ROWS)
    ]
    return ["time_s,command,angle_deg,pressure_1_kpa", *rows]


Make = Callable[..., Path]


@pytest.fixture
def make(tmp_path) -> Make:
    """Write a recording, changed by `change(lines)` (lines[0] is the header), and its TOML; return
    the CSV's path."""

    def write(change=lambda lines: None, toml="", end="\n"):
        lines = _lines()
        change(lines)
        path = tmp_path / "rec.csv"
        path.write_text("".join(line + end for line in lines), encoding="utf-8", newline="")
        if toml:
            path.with_suffix(".toml").write_text(toml, encoding="utf-8")
        return path

    return write


def test_a_good_recording(make):
    path = make(
        toml='[recording]\nrig = "one-dof"\nloop = "closed"\nsampling_period_s = 0.003\n'
        "[known]\ninertia_kg_m2 = 0.0896\nsupply_pressure_kpa = 600\n"
        "[controller]\nkp_per_deg = 0.1\ncommand_limit = 1.0\n"
    )
    recording = read_recording(path)
    assert (recording.name, recording.rig, recording.loop, recording.sampling_period_s) == (
        "rec",
        "one-dof",
        "closed",
        0.003,
    )
    assert len(recording) == ROWS and list(recording.columns) == [
        "command",
        "angle_deg",
        "pressure_1_kpa",
    ]
    assert recording.known == {"inertia_kg_m2": 0.0896, "supply_pressure_kpa": 600.0}
    assert recording.controller == {"kp_per_deg": 0.1, "command_limit": 1.0}
    assert recording.warnings == () and len(recording.sha256) == 64
    np.testing.assert_array_equal(recording.signal("pressure_1_kpa"), 300.0 + np.arange(ROWS))
    with pytest.raises(ValueError, match="read-only"):
        recording.columns["command"][0] = 1.0


def test_units_are_converted(make):
    recording = read_recording(make())
    np.testing.assert_allclose(
        recording.signal("angle_rad"), np.radians(recording.signal("angle_deg")), rtol=1e-14
    )
    np.testing.assert_allclose(
        recording.si("angle_deg"), np.radians(recording.columns["angle_deg"]), rtol=1e-14
    )
    np.testing.assert_allclose(recording.si("pressure_1_bar")[:2], [3.0e5, 3.01e5], rtol=1e-14)
    assert recording.has("pressure_1_pa") and not recording.has("pressure_2_pa")


@pytest.mark.parametrize("end", ["\r\n", "\n"])
def test_dialects_that_mean_the_same(make, end):
    def change(lines):
        lines[0] = '\ufefftime_s, command,angle_deg ,"pressure_1_kpa"'
        lines[5] = lines[5].replace(",", ", ")
        lines.insert(9, "")
        lines.append("")

    recording = read_recording(make(change, end=end))
    assert len(recording) == ROWS and list(recording.columns) == [
        "command",
        "angle_deg",
        "pressure_1_kpa",
    ]


def test_what_is_written_is_read_again(tmp_path):
    random = np.random.default_rng(0)
    stamps = 0.003 * np.arange(400) + 5000.0
    columns = {
        "command": random.uniform(-1, 1, 400),
        "angle_deg": 1e-7 * random.standard_normal(400),
    }
    meta = {
        "recording": {"rig": 'a "b"\\c', "loop": "open"},
        "known": {"inertia_kg_m2": 0.1, "n": 2},
    }
    path = tmp_path / "out.csv"
    write_recording(path, stamps, columns, meta)
    first = path.read_bytes()
    recording = read_recording(path)
    for name, values in columns.items():
        np.testing.assert_allclose(recording.signal(name), values, rtol=5e-9)
    assert (recording.rig, recording.loop) == ('a "b"\\c', "open")
    assert (
        recording.known == {"inertia_kg_m2": 0.1, "n": 2.0} and recording.sampling_period_s == 0.003
    )
    write_recording(path, recording.time, recording.columns, meta)
    assert path.read_bytes() == first
    assert sorted(item.name for item in tmp_path.iterdir()) == ["out.csv", "out.toml"]
