"""The cost of many columns, and names from other people's files."""

import cProfile
import pstats
from pathlib import Path

import numpy as np
import pytest

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


def calls(recording: Recording) -> int:
    """Functions called by a check, of Python and of C."""
    profile = cProfile.Profile()
    profile.runcall(inspect, recording)
    return pstats.Stats(profile).total_calls  # type: ignore[attr-defined, no-any-return]


def test_checking_costs_in_proportion_to_the_columns():
    """Counted, not timed: twice the columns cost at most about twice the calls."""
    few, many = wide(40), wide(160)
    inspect(few)  # what is compiled and cached once is no part of the cost
    assert calls(many) < 6 * calls(few)


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


# ---- warnings of NumPy ---------------------------------------------------------------------------
