"""A diagnosis that is killed or interrupted goes on with --resume: nothing finished is done again,
no bit differs."""

import json
import os
import shutil
import signal
from collections import Counter
from pathlib import Path

import pytest
from disturbed import EVERY_STEP, QUICK_CASES, Halted, leftovers, quick_examine
from pamid_cli import frame
from small_cart import RIG, others, record_cart

import pamid.api.trial_cases as work
from pamid.base.json_file import read_json
from pamid.base.parallel.result_store import Store

FILES = [
    *("diagnosis.json", "fit.json", "residual.csv", "free-run.csv", "added-variables.json"),
    *("next-experiment.csv", "next-experiment.toml"),
]


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    return record_cart(tmp_path_factory.mktemp("cart"))


@pytest.fixture(scope="module")
def undisturbed(recording, tmp_path_factory) -> Path:
    """Run folder of the same diagnosis without a disturbance."""
    folder = tmp_path_factory.mktemp("undisturbed") / "run"
    assert frame.run(words(recording, folder, "--jobs", "1")) == 0
    return folder


def words(recording: Path, folder: Path, *more: str) -> list[str]:
    return ["diagnose", str(recording), "--rig", RIG, *others(), "--output", str(folder), *more]


def same_files(one: Path, other: Path) -> bool:
    there = [name for name in FILES if (one / name).exists()]
    return "diagnosis.json" in there and all(
        (one / n).read_bytes() == (other / n).read_bytes() for n in there
    )


def results(folder: Path) -> int:
    """How many results of jobs are kept."""
    return len(list((folder / "jobs").glob("*.npz")))


@pytest.mark.parametrize(
    ("jobs", "when", "number"),
    [pytest.param(1, "after", 6, marks=pytest.mark.slow), (2, "before", 12)],
)
def test_killed_and_resumed(jobs, when, number, recording, undisturbed, tmp_path, capfd):
    folder, whole = tmp_path / "run", read_json(undisturbed / "run.json")["jobs"]
    halted = Halted(words(recording, folder, "--jobs", str(jobs)), when, ".npz", number)
    halted.end(signal.SIGKILL)  # the main process alone
    first = results(folder)
    assert first == number - (when == "before") < whole["worked"]
    assert len(leftovers(folder)) == (when == "before"), "it was killed with a result in its hands"
    assert read_json(folder / "run.json")["ended"] is None

    assert frame.run(words(recording, folder, "--json")) == 3, (
        "what is unfinished is not lost by accident"
    )
    refused = json.loads(capfd.readouterr().out)
    assert "unfinished" in refused["message"]
    assert "--resume" in refused["hint"] and "--overwrite" in refused["hint"]
    assert frame.run(words(recording, folder, "--resume", "--seed", "1")) == 3, "another diagnosis"
    assert frame.run(words(recording, folder, "--resume", "--overwrite")) == 2

    assert frame.run(words(recording, folder, "--resume", "--jobs", str(3 - jobs))) == 0
    record = read_json(folder / "run.json")
    assert record["jobs"] == {"worked": whole["worked"] - first, "kept": first, "failed": 0}
    assert record["outcome"] == "done" and len(record["resumed"]) == 1
    assert (
        same_files(undisturbed, folder) and not (folder / "jobs").exists() and not leftovers(folder)
    )
    halted.require_no_survivors()

    capfd.readouterr()
    assert frame.run(words(recording, folder, "--resume", "--json")) == 0, (
        "finished: there is nothing to do"
    )
    assert json.loads(capfd.readouterr().out) == read_json(folder / "diagnosis.json")
    assert read_json(folder / "run.json") == record


@pytest.mark.parametrize(
    ("number", "everyone"),
    [(signal.SIGINT, True), pytest.param(signal.SIGTERM, False, marks=pytest.mark.slow)],
)
def test_interrupted_and_resumed(number, everyone, recording, undisturbed, tmp_path):
    """Ctrl-C, which a terminal sends to all processes, and the signal of a shutdown, which comes to
    one."""
    folder = tmp_path / "run"
    halted = Halted(words(recording, folder, "--jobs", "2"), "after", ".npz", 9)
    code, said = halted.end(number, everyone=everyone)
    assert code == 130 and "interrupted" in said and "Traceback" not in said
    halted.require_no_survivors()
    record = read_json(folder / "run.json")
    assert record["outcome"] == "interrupted" and record["jobs"]["worked"] == results(folder) == 9
    assert not leftovers(folder)
    assert frame.run(words(recording, folder, "--resume")) == 0
    assert read_json(folder / "run.json")["jobs"]["kept"] == 9 and same_files(undisturbed, folder)


def test_killed_before_there_was_a_run(recording, tmp_path):
    """Nothing but the beginning of run.json is there: the folder is as good as empty."""
    fitted = ["fit", str(recording), "--rig", RIG, "--output"]
    Halted([*fitted, str(tmp_path / "run")], "before", "run.json", 1).end(signal.SIGKILL)
    assert len(leftovers(tmp_path / "run")) == 1 and not (tmp_path / "run" / "run.json").exists()
    for more in ((), ("--resume",), ("--overwrite",)):
        folder = shutil.copytree(tmp_path / "run", tmp_path / f"run{more}")
        assert frame.run([*fitted, str(folder), *more]) == 0
        assert {p.name for p in folder.iterdir()} == {
            "fit.json",
            "free-run.csv",
            "residual.csv",
            "run.json",
        }


def journalled(store: Store) -> Counter[str]:
    """How often each job was worked out."""
    lines = (store.folder / "journal.jsonl").read_text().splitlines()
    return Counter(json.loads(line)["key"] for line in lines)


def test_what_was_damaged_meanwhile_is_worked_out_again(
    recording, undisturbed, tmp_path, monkeypatch
):
    import pamid.diagnosis.verdict.diagnosis_run as whole

    def broken(*_):
        raise RuntimeError("in the end")

    folder, store = tmp_path / "run", Store(tmp_path / "run" / "jobs")
    with monkeypatch.context() as patched:
        patched.setattr(whole, "with_experiment", broken)
        assert frame.run(words(recording, folder)) == 1
    assert read_json(folder / "run.json")["outcome"] == "failed"
    done = journalled(store)
    assert (
        set(done.values()) == {1}
        and len(done) == read_json(undisturbed / "run.json")["jobs"]["worked"]
    )
    files = sorted(store.folder.glob("*.npz"))
    files[0].write_bytes(files[1].read_bytes())
    files[2].write_bytes(files[2].read_bytes()[:100])
    with monkeypatch.context() as patched:
        patched.setattr(whole, "with_experiment", broken)
        assert frame.run(words(recording, folder, "--resume")) == 1
    assert journalled(store) - done == Counter({files[0].stem: 1, files[2].stem: 1})
    assert frame.run(words(recording, folder, "--resume")) == 0 and same_files(undisturbed, folder)


def test_a_failed_job_is_told_and_tried_again(recording, undisturbed, tmp_path, monkeypatch, capfd):
    from pamid.diagnosis import search

    screen, folder = search.screen, tmp_path / "run"

    def failing(evidence, ground, attachment, *more):
        if attachment.label == "quadratic-drag":
            os.kill(os.getpid(), signal.SIGKILL)
        return screen(evidence, ground, attachment, *more)

    with monkeypatch.context() as patched:
        patched.setattr(search, "screen", failing)
        assert frame.run(words(recording, folder, "--jobs", "2", "--json")) == 6
    found = json.loads(capfd.readouterr().out)
    (failed,) = found["failed_jobs"]
    assert failed["job"] == "screening quadratic-drag" and "killed" in failed["why"]
    assert found == read_json(folder / "diagnosis.json") and found["verdict"] == "explained"
    assert [r["why"] for r in found["ranking"] if r["effect"] == "quadratic-drag"] == [
        failed["why"]
    ]
    record = read_json(folder / "run.json")
    assert record["outcome"] == "partial" and record["jobs"]["failed"] == 1
    assert frame.run(words(recording, folder, "--resume")) == 0
    assert same_files(undisturbed, folder)
    assert read_json(folder / "run.json")["jobs"] == {
        "worked": 4,
        "kept": record["jobs"]["worked"] - 2,
        "failed": 0,
    }, "its screening, further steps and refit, and the next experiment, for one model more"


def test_a_bootstrap_goes_on_where_it_was_killed(recording, tmp_path):
    def fitted(folder, *more):
        words = ["--rig", RIG, "--bootstrap", "12", "--output", str(folder)]
        return ["fit", str(recording), *words, *more]

    whole, folder = tmp_path / "whole", tmp_path / "run"
    assert frame.run(fitted(whole, "--jobs", "2")) == 0 and not (whole / "jobs").exists()
    Halted(fitted(folder, "--jobs", "1"), "after", ".npz", 5).end(signal.SIGKILL)
    assert results(folder) == 5 and frame.run(fitted(folder)) == 3
    assert frame.run(fitted(folder, "--resume")) == 0
    assert read_json(folder / "run.json")["jobs"] == {"worked": 7, "kept": 5, "failed": 0}
    assert (folder / "fit.json").read_bytes() == (whole / "fit.json").read_bytes()


@pytest.mark.parametrize(
    "number", [pytest.param(signal.SIGKILL, marks=pytest.mark.slow), signal.SIGTERM]
)
def test_a_training_goes_on_where_it_was_disturbed(number, recording, tmp_path):
    def trained(folder, *more):
        words = ["--hidden", "2", "--iterations", "8", "--jobs", "1"]
        return ["train-residual", str(folder), *words, *more]

    whole, folder = tmp_path / "whole", tmp_path / "run"
    assert frame.run(["fit", str(recording), "--rig", RIG, "--output", str(whole)]) == 0
    shutil.copytree(whole, folder)
    done = frame.run(trained(whole))
    code, said = Halted(trained(folder), "after", "checkpoint.npz", 3, stand_in=EVERY_STEP).end(
        number
    )
    assert code == (130 if number == signal.SIGTERM else -number) and "Traceback" not in said
    assert (folder / "network.json").exists() == (number == signal.SIGTERM), "what it had reached"
    assert frame.run(trained(folder, "--resume")) == done and not leftovers(folder)
    for name in ("network.json", "network.npz", "trace.csv", "residual.csv"):
        assert (folder / name).read_bytes() == (whole / name).read_bytes()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_trial_goes_on_where_it_was_disturbed(number, tmp_path, monkeypatch):
    def tried(folder, *more):
        return ["trial", "--output", str(folder), "--cases", "6", "--jobs", "1", *more]

    whole, folder = tmp_path / "whole", tmp_path / "run"
    event = ("before", "0", 4) if number == signal.SIGKILL else ("after", "0", 3)
    halted = Halted(tried(folder), *event, stand_in=QUICK_CASES)
    code, _ = halted.end(number)
    assert code == (130 if number == signal.SIGTERM else -number)
    assert len(leftovers(folder)) == (number == signal.SIGKILL)
    assert len(list((folder / "cases").glob("[0-9]*.json"))) == 3
    again: list[int] = []

    def examine(case, place):
        again.append(case.number)
        return quick_examine(case, place)

    monkeypatch.setattr(work, "examine", examine)
    assert frame.run(tried(folder, "--resume")) == 0 and len(again) == 3 and not leftovers(folder)
    assert frame.run(tried(whole)) == 0
    cases = (f"cases/{p.name}" for p in (whole / "cases").iterdir())
    for name in ("trial.json", "labels.json", *cases):
        assert (folder / name).read_bytes() == (whole / name).read_bytes()
