"""The cost of many columns and of names from other people's files."""

from __future__ import annotations

import tomllib
import warnings
from pathlib import Path

import numpy as np
import pytest
from counted import calls_of

from pamid.api.given import unknown_columns
from pamid.authoring.column_match import best_match
from pamid.base.csv_table import header_line, name_fault, table_bytes
from pamid.base.errors import DataError, FileError, listed
from pamid.checks.inspection import inspect
from pamid.estimation import memory_needed as memory
from pamid.ingest.ingesting import guess_mapping
from pamid.model.registry import rig_named
from pamid.recording.recording import (
    Recording,
    read_recording,
    recording_of,
    write_recording,
)
from pamid.simulation.data_split import split_recordings

CART = Path(__file__).resolve().parents[2] / "data" / "rigs" / "cart.py"
N = 300
TIME = 0.02 * np.arange(N)


def wide(columns: int) -> Recording:
    random = np.random.default_rng(1)
    return recording_of(TIME, {f"c{k}_v": random.standard_normal(N) for k in range(columns)})


def test_checking_costs_in_proportion_to_the_columns() -> None:
    """Counted, not timed: twice the columns cost at most about twice the calls."""
    few, many = wide(40), wide(160)
    inspect(few)  # what is compiled and cached once is no part of the cost
    assert calls_of(lambda: inspect(many)) < 6 * calls_of(lambda: inspect(few))


def test_guessing_costs_in_proportion_to_the_columns(tmp_path: Path) -> None:
    cost = {}
    for columns in (40, 160):
        write_recording(path := tmp_path / f"{columns}.csv", TIME, wide(columns).columns)
        guess_mapping(path, None)
        cost[columns] = calls_of(lambda path=path: guess_mapping(path, None))
    assert cost[160] < 6 * cost[40]


def test_a_new_rig_of_a_wide_recording_is_refused_in_a_short_message() -> None:
    names = list(wide(400).columns)
    best = {40: names[:40], 400: names}
    cost = {}
    for count, columns in best.items():
        with pytest.raises(FileError) as caught:
            best_match(columns)
        assert "more" in caught.value.message and len(caught.value.message) < 3000
        cost[count] = calls_of(lambda columns=columns: refused(columns))
    assert cost[400] < 15 * cost[40]


def refused(columns: list[str]) -> None:
    with pytest.raises(FileError):
        best_match(columns)


def test_unknown_columns_are_summed_up() -> None:
    rig = rig_named(str(CART))
    few, many = wide(3), wide(30)
    assert len(unknown_columns(rig, few)) == 3
    (sentence,) = unknown_columns(rig, many)
    assert "30 columns" in sentence and "and 18 more" in sentence


def test_names_are_listed_up_to_a_number() -> None:
    assert listed("abc") == "a, b, c"
    assert listed("abc", 2) == "a, b and 1 more"


# ---- names that a spreadsheet or a terminal obeys ------------------------------------------------


@pytest.mark.parametrize(
    "name",
    ["=cmd|' /C calc'!A0", "+1_v", "-x_m", "@sum_n", "a\x1b[31mb_v", "x\u202ey_m", "a\tb", 'q"_v'],
)
def test_a_name_that_is_obeyed_is_refused_where_it_enters_and_where_it_leaves(
    tmp_path: Path, name: str
) -> None:
    path = tmp_path / "rec.csv"
    cell = '"' + name.replace('"', '""') + '"'
    path.write_text(f"time_s,{cell}\n" + "".join(f"{t:g},{t * t:g}\n" for t in TIME))
    with pytest.raises(FileError) as read:
        read_recording(path)
    assert read.value.code == "header" and "line 1" in read.value.message
    assert "\x1b" not in read.value.message and "Rename" in read.value.hint
    with pytest.raises(FileError):
        write_recording(tmp_path / "out.csv", TIME, {name: TIME})
    with pytest.raises(FileError):
        header_line(["time_s", name])
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.parametrize("name", ["angle_deg", "Winkel Motor_deg", "p1.ist_kpa", "угол_rad", "a=b"])
def test_ordinary_names_pass(name: str) -> None:
    assert name_fault(name) == ""


def test_a_rig_with_such_an_output_is_refused(tmp_path: Path) -> None:
    text = CART.read_text(encoding="utf-8").replace("position_m", "=position_m")
    (tmp_path / "odd.py").write_text(text, encoding="utf-8")
    with pytest.raises(FileError, match="formula"):
        rig_named(str(tmp_path / "odd.py"))


def test_tables_are_the_same_whatever_the_size_of_a_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = np.random.default_rng(0).standard_normal((1000, 3))
    rows[5, 1] = np.nan
    whole = table_bytes(["a", "b", "c"], rows, ["%.9g"] * 3, blank=True)
    monkeypatch.setattr("pamid.base.csv_table.ROWS_AT_A_TIME", 7)
    assert table_bytes(["a", "b", "c"], rows, ["%.9g"] * 3, blank=True) == whole
    assert whole.split(b"\n")[6].split(b",")[1] == b"" and whole.count(b"\n") == 1001


def test_a_guessed_mapping_shows_hostile_names_written_out(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(
        "t;a\x1b[2Jb;note\x1b[31m\n" + "".join(f"{k * 0.01:.3f};{k % 7};w\n" for k in range(300))
    )
    text = guess_mapping(tmp_path / "log.csv", None).text
    assert "\x1b" not in text and tomllib.loads(text)["time"]["source"] == "t"


# ---- warnings of NumPy ---------------------------------------------------------------------------

HALF = np.arange(N) < N // 2
COURSES = {
    "nothing": np.zeros(N),
    "one value": np.full(N, 1e20),
    "half at rest": np.where(HALF, np.sin(9.0 * TIME), 0.0),
    "a step": np.where(HALF, 0.0, 1.0),
    "a spike": np.where(np.arange(N) == 150, 1.0, 0.0),
    "a ramp": TIME,
    "tiny": 1e-25 * np.sin(9.0 * TIME),
    "huge": 1e25 * np.sin(9.0 * TIME),
    "repeats": np.repeat(np.sin(9.0 * TIME[::6]), 6),
}


@pytest.mark.parametrize("course", COURSES)
def test_odd_recordings_are_checked_without_a_warning(course: str) -> None:
    """Warnings are errors here, those of NumPy among them."""
    random = np.random.default_rng(2)
    force = np.repeat(random.uniform(-3.0, 3.0, N // 10), 10)
    for columns in (
        {"force_n": force, "position_m": COURSES[course]},
        {"force_n": COURSES[course], "position_m": np.cumsum(force) * 1e-3},
    ):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            odd = recording_of(TIME, columns, digits=17)
            for rig in (None, rig_named(str(CART))):
                inspect(odd, rig)


# ---- memory of a diagnosis -----------------------------------------------------------------------


def cart_run(samples: int) -> Recording:
    random = np.random.default_rng(4)
    force = np.repeat(random.uniform(-3.0, 3.0, samples // 10), 10)
    position = 1e-3 * np.cumsum(np.cumsum(force) * 0.01)
    columns = {"force_n": force, "position_m": position + 1e-4 * random.standard_normal(samples)}
    return recording_of(0.01 * np.arange(samples), columns)


def test_more_memory_than_promised_is_said_before_the_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    evidence = split_recordings(rig_named(str(CART)), [cart_run(2000)], [])
    assert memory.memory_warning(evidence, 2) == ""
    assert memory.memory_needed(evidence, 8) > memory.memory_needed(evidence, 1)
    monkeypatch.setattr(memory, "PROMISED", 1)
    sentence = memory.memory_warning(evidence, 2)
    assert "2000 samples" in sentence and "period_s" in sentence
    monkeypatch.setattr(memory, "machine_memory", lambda: 1000)
    with pytest.raises(DataError, match="this machine has 1000 bytes"):
        memory.memory_warning(evidence, 2)


def test_the_machine_says_what_it_has() -> None:
    has = memory.machine_memory()
    assert has is None or has > 1 << 20
