"""Damaged and hostile inputs: always an answer, never a traceback, a hang, a half-written file, or
code that runs. A sample of benchmarks/fuzz.py (`make fuzz`), with its inputs by kind and number."""

import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
from fuzz_child import RunLimits
from fuzz_inputs import KINDS
from fuzz_runs import FAULTS, Outcome, count, run_inputs, signal_after
from fuzz_seeds import make_seeds

#: inputs of each kind, and of a kind that takes long
SAMPLE = int(os.environ.get("PAMID_FUZZ", "8"))
SLOW = ("fit", "binary_log", "run_folder", "trial", "training", "force_map", "declared")
FEW = {**dict.fromkeys(SLOW, 2), "diagnosed": 1}
#: inputs that once were faults
FOUND = {
    "recording": (979,),
    "run_folder": (820, 12060, 51088),
    "words": (4824,),
    "settings": (3144, 9882, 51205, 59271, 76423),
    "force_map": (2733,),
    "training": (8723, 52130),
    "binary_log": (15944,),
    "raw_log": (7773, 20396),
    "resumed": (627, 966),
    "fit": (96557,),
    "trial": (622, 109190),
    "excitation": (1667,),
    "model": (23788,),
    "mapping": (8761,),
    "values": (120, 881, 1094),
    "diagnosed": (6,),
    "model_file": (1564,),
    "counts": (1755,),
}
#: absurd numbers may well draw a warning from a plot; only faults are looked for
pytestmark = [pytest.mark.filterwarnings("ignore"), pytest.mark.usefixtures("unchecked")]


@pytest.fixture(scope="module")
def seeds(tmp_path_factory) -> Path:
    return make_seeds(tmp_path_factory.mktemp("seeds") / "whole")


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_input(kind, seeds, tmp_path, undrawn):
    # figures are drawn in benchmarks/fuzz.py; here their content is worked out
    numbers = (*range(min(FEW.get(kind, SAMPLE), SAMPLE)), *FOUND.get(kind, ()))
    inputs = [(kind, number) for number in numbers]
    outcomes = list(run_inputs(inputs, KINDS, seeds, tmp_path, signals=False))
    assert len(outcomes) == len(inputs)
    faults = [(run.number, run.faults, run.details) for run in outcomes if run.faults]
    assert not faults, faults


# ---- the faults themselves --------------------


def _leave(code: int) -> None:
    raise SystemExit(code)


def _deaf(_: Any) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    while True:
        time.sleep(0.01)


def _half_written(_: Any) -> None:
    Path("out.csv").write_text("time_s,angle_deg\n0,1")
    print("{}")


def _left_behind(_: Any) -> None:
    subprocess.Popen(["sleep", "600"], stdout=subprocess.DEVNULL)
    print("{}")


#: fault -> a command that has it
COMMANDS: dict[str, Any] = {
    "exit 1": lambda _: _leave(1),
    "exit other": lambda _: _leave(7) or print("{}"),
    "escaped": lambda _: print("no JSON"),
    "crash": lambda _: os.kill(os.getpid(), signal.SIGKILL),
    "time": lambda _: time.sleep(600),
    "memory": lambda _: bytearray(1 << 30),
    "deaf": _deaf,
    "unfinished": _half_written,
    "survivor": _left_behind,
    "": lambda _: print("{}"),
}


@pytest.mark.parametrize("fault", COMMANDS)
def test_fault_is_recognised(fault, tmp_path, monkeypatch):
    monkeypatch.setattr("pamid_cli.frame.main", COMMANDS[fault])
    limits = RunLimits(
        seconds=600.0 if fault == "deaf" else 1.0,
        memory=1 << 40,
        patience=0.2,
        allocation=1 << 29,
    )
    # late: a command is deaf once it runs, and a busy machine is slow to run it
    number = next(n for n in range(999) if (signal_after("kind", n) or 0.0) > 1.0)
    (outcome,) = run_inputs(
        [("kind", number)],
        {"kind": lambda site: [("config",)]},
        tmp_path,
        tmp_path / "scratch",
        limits=limits,
        signals=fault == "deaf",
        keep=tmp_path / "faults",
    )
    assert fault in outcome.faults or (not fault and not outcome.faults), outcome
    assert (tmp_path / "faults" / f"kind-{number}" / "COMMANDS").is_file() == bool(fault)
    assert not list((tmp_path / "scratch").iterdir())


def test_forked_reader_reads_a_whole_log(seeds, tmp_path):
    """Readers run in processes that are forked instead of started; this changes no answer."""
    inputs = {"whole": lambda site: [("ingest", "--guess", site.copy("log.h5"))]}
    (outcome,) = run_inputs([("whole", 0)], inputs, seeds, tmp_path / "scratch", signals=False)
    assert outcome.codes == (0,), outcome.details


def test_every_fault_is_counted():
    outcome = Outcome("values", 1, (0, 3), ("deaf",), "", 0.5, 1, True)
    counts = count([outcome, outcome])
    assert counts["fault deaf"] == counts["exit 3"] == counts["SIGTERM sent"] == 2
    assert set(COMMANDS) - {""} == set(FAULTS) - {"disk"}
