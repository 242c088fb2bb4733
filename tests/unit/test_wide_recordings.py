"""The cost of many columns and of names from other people's files."""

import tomllib
import warnings
from pathlib import Path

import numpy as np
import pytest
from counted import calls_of

from pamid.api.ingesting import guess_mapping
from pamid.base.csv_table import header_line
from pamid.base.errors import FileError
from pamid.intake.checks.inspection import inspect
from pamid.model.registry import rig_named
from pamid.recording.recording import (
    Recording,
    read_recording,
    recording_of,
    write_recording,
)

CART = Path(__file__).resolve().parents[2] / "data" / "rigs" / "cart.py"
N = 300
TIME = 0.02 * np.arange(N)


def wide(columns: int) -> Recording:
    random = np.random.default_rng(1)
    return recording_of(TIME, {f"c{k}_v": random.standard_normal(N) for k in range(columns)})


def test_checking_costs_in_proportion_to_the_columns():
    """Counted, not timed: twice the columns cost at most about twice the calls."""
    few, many = wide(40), wide(160)
    inspect(few)  # what is compiled and cached once is no part of the cost
    assert calls_of(lambda: inspect(many)) < 6 * calls_of(lambda: inspect(few))


# ---- names that a spreadsheet or a terminal obeys ------------------------------------------------


@pytest.mark.parametrize(
    "name",
    ["=cmd|' /C calc'!A0", "+1_v", "-x_m", "@sum_n", "a\x1b[31mb_v", "x\u202ey_m", "a\tb", 'q"_v'],
)
def test_a_name_that_is_obeyed_is_refused_where_it_enters_and_where_it_leaves(tmp_path, name):
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


def test_a_rig_with_such_an_output_is_refused(tmp_path):
    text = CART.read_text(encoding="utf-8").replace("position_m", "=position_m")
    (tmp_path / "odd.py").write_text(text, encoding="utf-8")
    with pytest.raises(FileError, match="formula"):
        rig_named(str(tmp_path / "odd.py"))


def test_a_guessed_mapping_shows_hostile_names_written_out(tmp_path):
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
def test_odd_recordings_are_checked_without_a_warning(course):
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
