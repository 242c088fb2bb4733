"""Recordings: what is read, and that nonsense is refused with file, column and line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pamid.base.errors import DataError, FileError, PamidError
from pamid.recording.recording import (
    match_column,
    read_recording,
    require_excited,
    toml_text,
    write_recording,
)

EMPS = Path(__file__).resolve().parents[3] / "shared" / "data" / "emps"
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
def make(tmp_path: Path) -> Make:
    """Write a recording, changed by `change(lines)` (lines[0] is the header), and its TOML; return
    the CSV's path."""

    def write(
        change: Callable[[list[str]], object] = lambda lines: None, toml: str = "", end: str = "\n"
    ) -> Path:
        lines = _lines()
        change(lines)
        path = tmp_path / "rec.csv"
        path.write_text("".join(line + end for line in lines), encoding="utf-8", newline="")
        if toml:
            path.with_suffix(".toml").write_text(toml, encoding="utf-8")
        return path

    return write


def _set_cell(row: int, column: int, text: str) -> Callable[[list[str]], None]:
    def change(lines: list[str]) -> None:
        cells = lines[row].split(",")
        cells[column] = text
        lines[row] = ",".join(cells)

    return change


def _refusal(path: Path) -> PamidError:
    with pytest.raises(PamidError) as caught:
        read_recording(path)
    return caught.value


def test_a_good_recording(make: Make) -> None:
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


def test_without_toml_everything_is_unknown(make: Make) -> None:
    recording = read_recording(make())
    assert (recording.loop, recording.rig, recording.known, recording.controller) == (
        None,
        None,
        {},
        {},
    )
    assert recording.sampling_period_s == 0.003


def test_units_are_converted(make: Make) -> None:
    recording = read_recording(make())
    np.testing.assert_allclose(
        recording.signal("angle_rad"), np.radians(recording.signal("angle_deg")), rtol=1e-14
    )
    np.testing.assert_allclose(
        recording.si("angle_deg"), np.radians(recording.columns["angle_deg"]), rtol=1e-14
    )
    np.testing.assert_allclose(recording.si("pressure_1_bar")[:2], [3.0e5, 3.01e5], rtol=1e-14)
    assert recording.has("pressure_1_pa") and not recording.has("pressure_2_pa")


def test_a_slice_keeps_its_stamps(make: Make) -> None:
    part = read_recording(make()).slice(10, 20)
    assert len(part) == 10 and part.time[0] == pytest.approx(0.03)
    assert part.signal("pressure_1_kpa")[0] == 310.0


@pytest.mark.parametrize("end", ["\r\n", "\n"])
def test_dialects_that_mean_the_same(make: Make, end: str) -> None:
    def change(lines: list[str]) -> None:
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


# each: what is done to the lines, code, words of the message
WRONG: dict[str, tuple[Callable[[list[str]], object], str, tuple[str, ...]]] = {
    "empty file": (lambda lines: lines.clear(), "empty", ("is empty",)),
    "only blank lines": (
        lambda lines: lines.__setitem__(slice(None), ["", ""]),
        "empty",
        ("is empty",),
    ),
    "header only": (lambda lines: lines.__delitem__(slice(1, None)), "empty", ("no rows",)),
    "no header": (lambda lines: lines.pop(0), "header", ("line 1", "'0'")),
    "first column is not time": (
        lambda lines: lines.__setitem__(0, "t,command,angle_deg,pressure_1_kpa"),
        "header",
        ("line 1", "'t'", "time_s"),
    ),
    "semicolons": (
        lambda lines: lines.__setitem__(slice(None), [line.replace(",", ";") for line in lines]),
        "header",
        ("line 1", "not 'time_s'"),
    ),
    "column twice": (
        lambda lines: lines.__setitem__(0, "time_s,command,command,pressure_1_kpa"),
        "header",
        ("'command'", "twice"),
    ),
    "column without a name": (
        lambda lines: lines.__setitem__(0, "time_s,command,,pressure_1_kpa"),
        "header",
        ("column 3", "no name"),
    ),
    "time alone": (
        lambda lines: lines.__setitem__(slice(None), [line.split(",")[0] for line in lines]),
        "header",
        ("no column",),
    ),
    "word in a cell": (_set_cell(7, 2, "open"), "cell", ("line 8", "'angle_deg'", "'open'")),
    "NaN": (_set_cell(30, 3, "NaN"), "cell", ("line 31", "'pressure_1_kpa'", "'NaN'")),
    "infinity": (_set_cell(30, 3, "-inf"), "cell", ("line 31", "'pressure_1_kpa'", "-inf")),
    "overflow": (_set_cell(30, 3, "1e999"), "cell", ("line 31", "'pressure_1_kpa'", "1e999")),
    "empty cell": (_set_cell(2, 1, ""), "cell", ("line 3", "'command'", "empty")),
    "NA": (_set_cell(2, 1, "NA"), "cell", ("line 3", "'command'", "'NA'")),
    "truth value": (_set_cell(2, 1, "True"), "cell", ("line 3", "'command'", "'True'")),
    "thousands underscore": (
        _set_cell(2, 3, "1_000"),
        "cell",
        ("line 3", "'pressure_1_kpa'", "'1_000'"),
    ),
    "short row": (
        lambda lines: lines.__setitem__(12, "0.033,0.1"),
        "row",
        ("line 13", "2 cells", "4 columns"),
    ),
    "long row": (
        lambda lines: lines.__setitem__(12, lines[12] + ",7"),
        "row",
        ("line 13", "5 cells", "4 columns"),
    ),
    "long first row": (
        lambda lines: lines.__setitem__(1, lines[1] + ",7"),
        "row",
        ("line 2", "5 cells"),
    ),
    "decimal commas": (
        lambda lines: lines.__setitem__(
            slice(1, None), [line.replace(".", ",") for line in lines[1:]]
        ),
        "row",
        ("line 2",),
    ),
    "blank line before": (
        lambda lines: (lines.insert(3, ""), _set_cell(20, 1, "x")(lines)),
        "cell",
        ("line 21",),
    ),
    "stamp twice": (
        _set_cell(20, 0, "0.054"),
        "stamps-repeated",
        ("line 21", "'time_s'", "0.054", "twice"),
    ),
    "stamps back": (
        _set_cell(20, 0, "0.0520"),
        "stamps-unsorted",
        ("line 21", "0.052 s comes after 0.054 s"),
    ),
    "stamps reversed": (
        lambda lines: lines.__setitem__(slice(1, None), lines[:0:-1]),
        "stamps-unsorted",
        ("line 3",),
    ),
    "gap": (lambda lines: lines.__delitem__(slice(31, 34)), "gap", ("line 32", "gap of 0.012 s")),
    "uneven": (_set_cell(20, 0, "0.0571"), "stamps-uneven", ("line 21", "1 %")),
}


@pytest.mark.parametrize(("change", "code", "words"), WRONG.values(), ids=WRONG.keys())
def test_nonsense_is_refused(
    make: Make, change: Callable[[list[str]], object], code: str, words: tuple[str, ...]
) -> None:
    path = make(change)
    error = _refusal(path)
    assert isinstance(error, FileError) and error.exit_code == 3 and error.code == code
    assert str(path) in error.message
    for word in words:
        assert word in error.message


def test_missing_file_and_folder(tmp_path: Path, make: Make) -> None:
    make()
    error = _refusal(tmp_path / "rek.csv")
    assert error.code == "missing" and "rec.csv" in error.hint
    assert "folder" in _refusal(tmp_path).message


def test_no_text_at_all(tmp_path: Path, make: Make) -> None:
    path = tmp_path / "rec.csv"
    path.write_bytes(b"\xff\xfe\x00\x01" * 50)
    assert _refusal(path).code == "encoding"
    path = make()
    path.write_bytes(path.read_bytes() + b"\xff,1,1,1\n")
    assert _refusal(path).exit_code == 3


def test_ten_samples_are_too_few(make: Make) -> None:
    error = _refusal(make(lambda lines: lines.__delitem__(slice(11, None))))
    assert isinstance(error, DataError) and (error.exit_code, error.code) == (4, "too-short")
    assert "10 samples" in error.message and "50" in error.message


def test_jitter_below_one_percent_is_no_fault(make: Make) -> None:
    assert read_recording(make(_set_cell(20, 0, "0.05702"))).sampling_period_s == pytest.approx(
        0.003
    )


TOML_WRONG = {
    "syntax": ("[recording]\nloop = closed\n", ("line 2",)),
    "loop": ('[recording]\nloop = "close"\n', ("loop", "'close'")),
    "text expected": ("[recording]\nrig = 1\n", ("rig", "1")),
    "number expected": ('[known]\ninertia_kg_m2 = "0.1"\n', ("[known]", "inertia_kg_m2")),
    "truth value": ("[controller]\ncommand_limit = true\n", ("command_limit",)),
    "not finite": ("[known]\ninertia_kg_m2 = nan\n", ("inertia_kg_m2",)),
    "no table": ("known = 3\n", ("[known]",)),
    "other period": ("[recording]\nsampling_period_s = 0.004\n", ("0.004", "0.003")),
    "period in ms": ("[recording]\nsampling_period_s = 3\n", ("sampling_period_s", "0.003")),
    "negative period": ("[recording]\nsampling_period_s = -0.003\n", ("-0.003",)),
}


@pytest.mark.parametrize(("toml", "words"), TOML_WRONG.values(), ids=TOML_WRONG.keys())
def test_wrong_toml_is_refused(make: Make, toml: str, words: tuple[str, ...]) -> None:
    error = _refusal(make(toml=toml))
    assert error.exit_code == 3 and "rec.toml" in error.message
    for word in words:
        assert word in error.message


def test_unknown_keys_are_kept_and_named(make: Make) -> None:
    toml = (
        '[recording]\nlop = "open"\n[controler]\na = 1\n[controller]\nkpp_per_deg = '
        "1.0\nkp_per_m = 2.0\n"
    )
    recording = read_recording(make(toml=toml))
    told = "\n".join(recording.warnings)
    assert len(recording.warnings) == 3
    assert (
        "'lop'" in told and "'loop'" in told and "'controller'" in told and "'kp_per_deg'" in told
    )
    assert recording.controller == {"kpp_per_deg": 1.0, "kp_per_m": 2.0}


def test_match_column() -> None:
    assert match_column("angle_rad", "angle_deg") == "angle_rad"
    assert match_column(["angle_rad", "angle_deg"], "angle_deg") == "angle_deg"
    assert match_column(["pressure_1_filtered", "pressure_2_kpa"], "pressure_1_kpa") is None
    assert match_column("command_1", "command") is None
    assert match_column("external_torque_n_m", "external_torque_nm") == "external_torque_n_m"
    assert match_column("command_pct", "command") == "command_pct"
    assert match_column("body_temperature_degf", "body_temperature_degc") == "body_temperature_degf"


@pytest.mark.parametrize(
    ("column", "wanted", "words"),
    [
        ("pressure_1_psi", "pressure_1_kpa", ("psi", "_kpa", "_bar")),
        ("pressure_1_n", "pressure_1_kpa", ("'N'", "_kpa")),
        ("angle", "angle_deg", ("without a unit", "_deg")),
        ("angle_degrees", "angle_deg", ("degrees", "_deg")),
        ("command_counts", "command", ("counts", "no unit")),
    ],
)
def test_wrong_unit_suffix(column: str, wanted: str, words: tuple[str, ...]) -> None:
    with pytest.raises(FileError) as caught:
        match_column([column], wanted)
    assert caught.value.code == "unit" and column in caught.value.message
    for word in words:
        assert word in str(caught.value)


def test_missing_column_offers_the_nearest(make: Make) -> None:
    recording = read_recording(make())
    with pytest.raises(FileError, match="no column 'angel_deg'") as caught:
        recording.signal("angel_deg")
    assert caught.value.code == "missing-column" and "'angle_deg'" in caught.value.hint


def test_a_constant_command_is_not_excited(make: Make) -> None:
    def freeze(lines: list[str]) -> None:
        for row in range(1, len(lines)):
            _set_cell(row, 1, "0.25")(lines)

    recording = read_recording(make(freeze))
    with pytest.raises(DataError, match="command is constant") as caught:
        require_excited(recording, "command")
    assert caught.value.exit_code == 4
    require_excited(recording, "angle_deg")


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
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


def test_nothing_unfit_is_written(tmp_path: Path) -> None:
    stamps = 0.003 * np.arange(60)
    for columns in ({"a": np.full(60, np.nan)}, {"a": np.zeros(59)}, {"time_s": stamps}, {}):
        with pytest.raises(FileError):
            write_recording(tmp_path / "out.csv", stamps, columns)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(FileError):
        toml_text({"known": {"a": object()}})


def test_a_long_recording_is_never_read_slowly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reader that goes cell by cell is for files that are refused (its time:
    benchmarks/waiting.py)."""
    monkeypatch.setattr(
        "pamid.recording.recording.explain_cells", lambda *_: pytest.fail("read cell by cell")
    )
    random = np.random.default_rng(0)
    path = tmp_path / "long.csv"
    write_recording(
        path,
        0.003 * np.arange(66667),
        {f"x{i}_deg": random.standard_normal(66667) for i in range(7)},
    )
    assert len(read_recording(path)) == 66667


@pytest.mark.skipif(
    not EMPS.is_dir(), reason="the measured EMPS records are not beside this checkout"
)
@pytest.mark.parametrize("name", ["estimation", "pulses"])
def test_measured_records_load(name: str) -> None:
    recording = read_recording(EMPS / f"{name}.csv")
    assert (
        len(recording) == 24841
        and recording.sampling_period_s == 0.001
        and recording.loop == "closed"
    )
    assert recording.warnings == ()
