"""The table of speeds of benchmarks/speed.py: its rows, ratios from given times, and what it
says where a peer is not there. Nothing here is timed but one short row, of which no time is judged.
"""

import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def speed(monkeypatch):
    """The benchmark, as it finds its neighbours when it runs."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    for name in [n for n in sys.modules if n == "peers" or n.startswith("peers.")]:
        monkeypatch.delitem(sys.modules, name)
    import speed

    return speed


@pytest.fixture
def asked(speed, tmp_path):
    def make(vectors="AVX-512", samples=66_667):
        return speed.Asked(samples, 2, tmp_path / "environment", vectors, tmp_path)

    return make


#: figures from which every row's lines are made; of peers CPU seconds, ours 0.1 s
GIVEN = {
    "pass": {"share": 0.75, "dgemm": 60e9, "pass": 0.1, "iteration": 0.15, "trials": 1.0},
    "two-cores": {"pass": 1.7, "starts": 1.9},
    "peers": {"ours": 0.1, "inside": 0.5, "by-hand": 0.31, "pyrenn": 10.1},
    "paper-job": {
        "clock": 60.0,
        "cpu": 110.0,
        "whole_clock": 200.0,
        "mse": 2.6e-4,
        "iterations": 713.0,
    },
    "free-run": {"free": 0.013, "nine": 0.048, "scipy": 26.0},
    "all-effects": {"free": 0.013, "nine": 0.048, "all": 0.154, "all_nine": 0.816, "effects": 33.0},
    "fit": {"seconds": 2.9, "free": 37.0, "length_s": 200.0},
    "arm": {"free": 0.04, "nine": 0.186, "mujoco": 0.3},
    "diagnosis": {"clock": 42.0, "cpu": 80.0, "memory_gb": 0.5},
    "million": {"clock": 1000.0, "cpu": 975.0, "memory_gb": 4.2},
    "cold-start": {"cold": 25.0, "cached": 0.3},
}

#: what the goals are of, in order: (figure, bound)
EXPECTED = {
    "pass": [(0.75, 0.85), (1.5, 1.2)],
    "two-cores": [(1.7, 1.85), (1.9, 1.85)],
    "peers": [(5.0, 8.0), (3.1, 3.0), (101.0, 100.0)],
    "paper-job": [(60.0, 20.0)],
    "free-run": [(13.0, 6.5), (48.0, 24.0)],
    "all-effects": [(154.0, None), (17.0, 8.0)],
    "fit": [(2.9, 5.0)],
    "arm": [(40.0, None), (4.65, 3.5)],
    "diagnosis": [(42.0, 21.0)],
    "million": [(4.2, 2.5), (975.0, 400.0)],
    "cold-start": [(25.0, 8.0)],
}
REACHED = {
    "our sensitivities by hand in JAX",
    "pyrenn",
    "two cores: two starts",
    "fit of 200 s with background (37 parameters)",
}


def lines_of(speed, asked):
    return {n: speed.ROWS[n].lines(GIVEN[n], asked) for n in speed.ROWS}


def test_every_row_is_there_with_its_ratio_and_goal(speed, asked):
    assert list(speed.ROWS) == list(EXPECTED)
    for name, lines in lines_of(speed, asked()).items():
        found = [(line.figure, line.goal.bound) for line in lines]
        assert found == [(pytest.approx(f), bound) for f, bound in EXPECTED[name]], name
        assert all(line.row == name for line in lines)


def test_a_goal_is_reached_at_its_bound_on_the_right_side(speed, asked):
    lines = [line for found in lines_of(speed, asked()).values() for line in found]
    reached = {line.work for line in lines if line.reached}
    assert reached == REACHED
    assert [line.work for line in lines if line.reached is None] == [
        "all 33 effects attached, free",
        "arm: free run",
    ]
    assert speed.Line("x", "x", 2.0, "s", speed.most(2.0)).reached is True
    assert speed.Line("x", "x", 2.0, "s", speed.least(2.1)).reached is False


def test_goals_by_time_are_the_processors_own(speed, asked):
    wide, narrow, other = (
        speed.run_lines(GIVEN["free-run"], asked(v)) for v in ("AVX-512", "AVX2", "unknown")
    )
    assert [line.reached for line in wide] == [False, False]
    assert [line.reached for line in narrow] == [True, True]
    assert [line.reached for line in other] == [None, None]
    short = speed.run_lines(GIVEN["free-run"], asked(samples=1000))
    assert [line.reached for line in short] == [None, None]  # its goals are of the whole record


def test_a_peer_that_is_absent_is_said_and_not_counted(speed, asked):
    lines = speed.peer_lines({"ours": 0.1}, asked())
    assert [line.reached for line in lines] == [None] * 3
    assert all("not measured" in speed.printed(line) for line in lines)
    (_, nine) = speed.arm_lines({"free": 0.04, "nine": 0.12}, asked())
    assert nine.reached


def test_rows_are_chosen_by_name_and_long_ones_only_when_asked(speed):
    assert speed.chosen_rows("fit,pass", False) == ["pass", "fit"]
    assert speed.chosen_rows("million", False) == ["million"]
    usual = speed.chosen_rows("", False)
    assert set(speed.ROWS) - set(usual) == {"paper-job", "diagnosis", "million"}
    assert speed.chosen_rows("", True) == list(speed.ROWS)
    with pytest.raises(SystemExit, match="no row 'fits'"):
        speed.chosen_rows("fits", False)


def test_a_printed_line_has_a_cell_per_column(speed, asked):
    heads = speed.HEAD[0].count("|")
    for found in lines_of(speed, asked()).values():
        assert all(speed.printed(line).count("|") == heads for line in found)
    line = lines_of(speed, asked())["pass"][0]
    assert speed.printed(line) == (
        "| LM pass (66667 x 171), share of dgemm's rate | 0.75 of dgemm | dgemm 60.0 GF/s | 75% | "
        ">= 0.85 | missed | 100 ms |"
    )


def test_what_two_rows_share_is_measured_once(speed, asked, monkeypatch):
    calls = []

    def measure(given):
        calls.append(given)
        return GIVEN["all-effects"] | GIVEN["free-run"]

    for name in ("free-run", "all-effects"):
        row = speed.ROWS[name]
        monkeypatch.setitem(speed.ROWS, name, speed.Row(measure, row.lines, row.long))
    shown = []
    lines = speed.table(["free-run", "all-effects"], asked(), shown.append)
    assert len(calls) == 1
    assert shown == [*speed.HEAD, *map(speed.printed, lines)]


def test_quick_rows_run_and_tell_their_vectors(speed, asked):
    given = asked(samples=1100)
    lines = speed.table(["free-run", "all-effects"], given, lambda text: None)
    told = speed.as_json(lines, given)
    assert told["vectors"] == "AVX-512"
    assert [line["row"] for line in json.loads(json.dumps(told))["lines"]] == (
        ["free-run"] * 2 + ["all-effects"] * 2
    )
    assert all(line.figure > 0.0 for line in lines)
    assert "33 effects" in lines[2].work
