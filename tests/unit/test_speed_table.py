"""The table of benchmarks/speed.py: its rows and ratios from given times. Nothing is timed here."""

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


class Stopwatch:
    """A tree that is not run: its commands take given CPU seconds, one after the other."""

    def __init__(self, speed, *cpu_s):
        self.speed, self.left, self.calls = speed, list(cpu_s), []

    def run(self, *words, cold=False):
        self.calls.append((words, cold))
        return self.speed.Spent(self.left.pop(0), 1.0, 0.5)


def test_a_row_has_both_figures_their_ratio_and_the_goal(speed):
    figure = speed.Figure("a diagnosis", 60.0, 15.0, "s CPU", 20.0)
    assert figure.ratio == 0.25
    assert figure.text == "| a diagnosis | 60 | 15 | 0.25 | 20 | s CPU | reached |"
    assert speed.Figure("a diagnosis", None, 25.0, "s CPU", 20.0).text == (
        "| a diagnosis | - | 25 | - | 20 | s CPU | missed |"
    )


def test_the_first_run_is_cold_and_the_warm_one_the_second_after_it(speed, tmp_path):
    old, new = Stopwatch(speed, 83.0, 70.0, 60.0), Stopwatch(speed, 30.0, 22.0, 20.0)
    warm, first = speed.joint_rows(speed.Pair(old, new, tmp_path))
    assert (warm.old, warm.new) == (60.0, 20.0) and (first.old, first.new) == (83.0, 30.0)
    assert [cold for _, cold in new.calls] == [True, False, False]
    assert [words for words, _ in old.calls] == [words for words, _ in new.calls]


def test_a_case_of_the_trial_is_the_median_of_the_rigs(speed, tmp_path):
    count = len(speed.STARTERS)
    old = Stopwatch(speed, *(40.0 + 4.0 * k for k in range(count)))
    new = Stopwatch(speed, *(4.0 + 4.0 * k for k in range(count)))
    (figure,) = speed.trial_rows(speed.Pair(old, new, tmp_path), cases=4)
    assert figure.old == 10.0 + (count - 1) / 2 and figure.new == 1.0 + (count - 1) / 2


def test_rows_stand_in_the_order_of_the_table(speed):
    assert speed.chosen_rows("servo,joint", False) == ["joint", "servo"]
    assert not any(speed.ROWS[name].long for name in speed.chosen_rows("", False))
    assert speed.chosen_rows("", True) == list(speed.ROWS)
    with pytest.raises(SystemExit, match="no row 'sevro'"):
        speed.chosen_rows("sevro", False)


def test_an_unknown_commit_is_refused(speed, tmp_path):
    with (
        pytest.raises(SystemExit, match="no commit 'no-such-commit'"),
        speed.checked_out("no-such-commit", tmp_path),
    ):
        pass
