"""Threads and imports of a run."""

import subprocess
import sys
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import pamid

EXAMPLE = Path(__file__).parents[2] / "data" / "example" / "joint.csv"


def blas_threads() -> set[int]:
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


@pytest.mark.parametrize(
    ("verb", "work"),
    [
        (pamid.diagnose, "pamid.api.diagnosing.diagnose_into"),
        (pamid.fit, "pamid.api.fitting.fit_model"),
    ],
)
def test_runs_hold_blas_to_one_thread(verb, work, monkeypatch):
    seen: list[set[int]] = []

    class EndedError(Exception):
        pass

    def end(*_, **__):
        seen.append(blas_threads())
        raise EndedError

    with threadpool_limits(2, "blas"):
        monkeypatch.setattr(work, end)
        with pytest.raises(EndedError):
            verb(EXAMPLE, "one-dof", check=False)
        assert seen == [{1}]
        assert blas_threads() == {2}


def test_worker_processes_load_what_they_need():
    """Every worker process of a trial imports the diagnosis."""
    heavy = ("scipy.linalg", "scipy.signal", "scipy.sparse", "pandas", "matplotlib", "torch")
    loaded = f"print([m for m in {heavy} if m in sys.modules])"
    code = f"import sys, pamid.diagnosis.verdict.diagnosis_run; {loaded}"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
