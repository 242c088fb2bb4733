"""What a new user sees first: the demo says what it begins with, long work says how much of a stage
is done, and an excitation is found under the name of what it does."""

import io

import pytest
from pamid_cli import frame
from small_cart import FEW, RIG, record_cart

import pamid
from pamid.base.errors import DataError
from pamid.base.progress import ProgressLine, Settled
from pamid.base.work_stages import WORK_STAGES
from pamid.model.registry import effects


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Clock:
    """Time as the test tells it."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch) -> Clock:
    found = Clock()
    monkeypatch.setattr("pamid.base.progress.time", found)
    return found


def test_a_stage_that_counts_says_how_much_is_done_and_left(clock):
    stream = Terminal()
    with ProgressLine("anything", stream=stream) as line:
        clock.now = 110.0
        line.say("screening 5/25: leak")
        assert stream.getvalue().endswith("screening 5/25: leak (10 s, 20 % of this stage)")
        clock.now = 120.0
        line.say("screening 15/25: gravity")
        told = "(20 s, 60 % of this stage, about 10 s of it left)"
        assert stream.getvalue().rstrip().endswith(told)
        clock.now = 130.0
        line.say("refitting 1/8: leak")  # another stage: nothing is known of its pace
        assert stream.getvalue().rstrip().endswith("refitting 1/8: leak (30 s, 12 % of this stage)")
        clock.now = 140.0
        line.say("noise floor")
        assert stream.getvalue().rstrip().endswith("noise floor (40 s)")


def test_a_diagnosis_tells_of_its_stages_in_their_order(tmp_path):
    said: list[str] = []
    left_out = [name for name in effects() if name not in FEW]
    pamid.diagnose(record_cart(tmp_path), RIG, check=False, without=left_out, progress=said.append)
    begins = [one.begins for one in WORK_STAGES["diagnose"]]
    told = [next((b for b in begins if text.startswith(b)), None) for text in said]
    known = [b for b in told if b is not None]
    assert {"fitting", "noise floor", "screening", "refitting"} <= set(known)
    first = [known.index(b) for b in begins if b in known]
    assert first == sorted(first)
    stay = [str(text) for text in said if isinstance(text, Settled)]
    assert stay[0].startswith("refitted, held-out errors: ") and stay[-1].startswith("verdict: ")
    # the first figures wait for no search
    told_before = told[: [str(text) for text in said].index(stay[0])]
    assert set(told_before) <= {"fitting", "noise floor", None}


def test_the_demo_says_what_it_begins_with(tmp_path, monkeypatch, capsys):
    said: list[str] = []

    def before_all_work(*_, **__):
        said.append(capsys.readouterr().err)
        raise DataError("Enough.", "")

    monkeypatch.setattr("pamid.api.replications.demonstration.run_demo", before_all_work)
    frame.run(["demo", "--output", str(tmp_path / "run")])
    assert "a hidden fault" in said[0] and "about a minute" in said[0]
