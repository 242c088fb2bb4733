"""What a new user sees first: the demo says what it begins with, long work says how much of a stage
is done, and an excitation is found under the name of what it does."""

from __future__ import annotations

import io
import re
import subprocess
from pathlib import Path
from typing import Any

import pytest
from pamid_cli import frame
from small_cart import RIG, record_cart

import pamid
from pamid.base.errors import DataError
from pamid.base.progress import ProgressLine, Settled, listening, tell
from pamid.base.work_stages import WORK_STAGES, WorkStage


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
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    found = Clock()
    monkeypatch.setattr("pamid.base.progress.time", found)
    return found


def test_a_stage_that_counts_says_how_much_is_done_and_left(clock: Clock) -> None:
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


def test_known_stages_are_listed_once_and_say_what_is_left_of_all(clock: Clock) -> None:
    stages = (WorkStage("one", 0.2, "the first"), WorkStage("two", 0.6), WorkStage("three", 0.2))
    stream = Terminal()
    with ProgressLine("anything", stream=stream, stages=stages) as line:
        clock.now = 104.0
        line.say("one")
        assert stream.getvalue().startswith("\ranything: 3 stages: the first, two, three\n")
        assert stream.getvalue().endswith("anything: 1 of 3, one (4 s)")
        clock.now = 120.0
        line.say("two 5/10: x")  # 0.2 + 0.3 of the whole in 20 s
        told = "anything: 2 of 3, two 5/10: x (20 s, 50 %, about 20 s left)"
        assert stream.getvalue().rstrip().endswith(told)
        clock.now = 130.0
        line.say("one more time")  # what was reached stays reached
        assert "2 of 3, one more time (30 s, a further round)" in stream.getvalue()
        clock.now = 132.0
        line.say("one 1/4: y")
        assert "one 1/4: y (32 s, a further round, 25 % of this stage)" in stream.getvalue()
        clock.now = 1000.0
        line.say("three")
        assert "3 of 3, three (15 min, 80 %, about 4 min left)" in stream.getvalue()
    assert stream.getvalue().count("3 stages") == 1


def test_no_time_left_is_estimated_from_the_first_steps(clock: Clock) -> None:
    stream = Terminal()
    with ProgressLine("training", 1000, stream=stream) as line:
        clock.now = 113.0
        line.update(17, "")
        assert stream.getvalue().rstrip().endswith("training: 17/1000 (13 s, 1 %)")
        clock.now = 120.0
        line.update(200, "")
        assert stream.getvalue().rstrip().endswith("200/1000 (20 s, 20 %, at most 80 s left)")
    with ProgressLine("anything", stream=stream) as line:
        clock.now = 130.0
        line.say("screening 0/50: leak")
        clock.now = 131.0
        line.say("screening 2/50: leak")
        assert stream.getvalue().rstrip().endswith("(11 s, 4 % of this stage)")


def test_make_prints_what_it_installs_before_it_begins() -> None:
    plan = subprocess.run(
        ["make", "--dry-run", "--always-make", "demo"],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    before, installs, _ = plan.partition("pip install")
    assert installs and re.search(r"echo .*minutes.* GB", before)


def test_a_final_result_stays_while_the_rest_runs(clock: Clock) -> None:
    stream = io.StringIO()
    with ProgressLine("anything", in_logs=True, stream=stream) as line:
        line.say("fitting")
        line.say(Settled("mass 1.2 kg"))  # quick work says nothing
        clock.now = 104.0
        line.say("intervals")
        clock.now = 105.0
        line.say("intervals")
        line.say(Settled("friction\x1b[2J 0.8 N"))
    assert stream.getvalue().splitlines() == [
        "anything: mass 1.2 kg",
        "anything: intervals (4 s)",
        "anything: friction [2J 0.8 N",
    ]


def test_stages_share_the_whole_among_them() -> None:
    """Fitting begins each diagnosis; a stage is found by how its text begins, the first that
    does."""
    for label, stages in WORK_STAGES.items():
        assert sum(one.share for one in stages) == pytest.approx(1.0), label
        begins = [one.begins for one in stages]
        assert not [(a, b) for k, a in enumerate(begins) for b in begins[:k] if a.startswith(b)], (
            label
        )


def test_a_diagnosis_tells_of_its_stages_in_their_order(tmp_path: Path) -> None:
    said: list[str] = []
    pamid.diagnose(record_cart(tmp_path), RIG, check=False, progress=said.append)
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


def test_a_bootstrap_counts_its_draws_after_the_fit_has_been_told(tmp_path: Path) -> None:
    said: list[str] = []
    pamid.fit(record_cart(tmp_path), RIG, bootstrap=3, check=False, progress=said.append)
    (fitted,) = [k for k, text in enumerate(said) if isinstance(text, Settled)]
    assert said[fitted].startswith("fitted, intervals follow: mass_kg 1.")
    draws = [k for k, text in enumerate(said) if text.startswith("bootstrap draw")]
    assert (
        len(draws) == 3 and draws[0] > fitted and said[draws[-1]].startswith("bootstrap draw 3/3")
    )
    assert any(text.startswith("fitting ") and "/" in text for text in said[:fitted])


def test_a_log_gets_its_first_line_soon(clock: Clock) -> None:
    stream = io.StringIO()
    with ProgressLine("anything", in_logs=True, stream=stream) as line:
        for second in range(1, 20):
            clock.now = 100.0 + second
            line.say("fitting")
    assert stream.getvalue().splitlines() == [
        "anything: fitting (3 s)",
        "anything: fitting (18 s)",
    ]


def test_the_demo_says_what_it_begins_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said: list[str] = []

    def before_all_work(*_: Any, **__: Any) -> Any:
        said.append(capsys.readouterr().err)
        raise DataError("Enough.", "")

    monkeypatch.setattr("pamid.replications.demonstration.run_demo", before_all_work)
    frame.run(["demo", "--output", str(tmp_path / "run")])
    assert "a fault that is withheld" in said[0] and "about a minute" in said[0]


def test_an_excitation_is_found_by_what_it_does(capsys: pytest.CaptureFixture[str]) -> None:
    told = []
    for name in ("excite", "generate-aprbs"):
        assert frame.run([name, "--help"]) == 0
        told.append(capsys.readouterr().out)
    assert told[0] == told[1] and "`pamid excite` is the same command" in told[0]


def told_by(
    words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> list[str]:
    """What a command says of its own progress."""
    heard: list[str] = []

    def update(self: ProgressLine, done: int, text: str = "", total: int | None = None) -> None:
        heard.append(text)

    monkeypatch.setattr(ProgressLine, "update", update)
    assert frame.run(words) == 0, capsys.readouterr().err
    return heard


@pytest.mark.parametrize("command", ["simulate", "export", "check", "check a rig"])
def test_a_long_command_tells_its_stages_in_their_order(
    command: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    recording = record_cart(tmp_path)
    words = {
        "simulate": ["simulate", "--rig", RIG, "--excitation", str(recording), "--output", "o.csv"],
        "export": ["export", "run", "--rig", RIG, "--to", "fmu", "--output", "cart.fmu"],
        "check": ["check", str(recording), "--rig", RIG],
        "check a rig": ["check", RIG],
    }[command]
    if command == "export":
        assert frame.run(["fit", str(recording), "--rig", RIG, "--output", "run"]) == 0
    heard = told_by(words, monkeypatch, capsys)
    begins = [one.begins for one in WORK_STAGES[command]]
    told = [next((b for b in begins if text.startswith(b)), "") for text in heard]
    told = [one for one in dict.fromkeys(told) if one]
    assert told == [one for one in begins if one in told] and len(told) >= 3
    assert sum(one.share for one in WORK_STAGES[command]) == pytest.approx(1.0)


def test_places_and_runs_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    recording = record_cart(tmp_path)
    assert frame.run(["fit", str(recording), "--rig", RIG, "--output", "run"]) == 0
    excitation = ["--rig", RIG, "--excitation", str(recording), "--seed", "8"]
    assert frame.run(["simulate", *excitation, "--output", "new.csv"]) == 0
    heard = told_by(["score", "run", "new.csv", "--rig", RIG], monkeypatch, capsys)
    assert [text.split(":")[0] for text in heard][:2] == ["runs 0/4", "runs 1/4"]
    effect = Path(RIG).parents[2] / "pamid" / "effects" / "quadratic_drag.py"
    heard = told_by(["check", str(effect)], monkeypatch, capsys)
    counts = [re.match(r"places (\d+)/(\d+): ", text) for text in heard if "places" in text]
    assert len(counts) > 3 and [int(one[1]) for one in counts if one] == list(range(len(counts)))


def test_what_is_told_reaches_only_who_listens() -> None:
    heard: list[str] = []
    tell("nobody")
    with listening(heard.append):
        tell("somebody")
    tell("nobody")
    assert heard == ["somebody"]
