"""A function in a child process: its answer, its errors, and the limits at which it ends."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from pamid.base.errors import FileError
from pamid.base.files import MIB
from pamid.base.parallel.limited_process import ProcessFailure, ProcessLimits, run_limited

LIMITS = ProcessLimits(seconds=100.0, patience=600.0, memory=256 * MIB)
limited = pytest.mark.skipif(sys.platform != "linux", reason="limits are those of Linux")


def test_the_answer_comes_back(tmp_path):
    found = run_limited("child_work:answer", {"number": 3}, tmp_path, LIMITS, "")
    assert found["number"] == 3
    assert Path(found["at"]) == tmp_path, "what foreign code writes by a bare name lands there"


def test_an_error_of_pamid_comes_back_whole(tmp_path):
    with pytest.raises(FileError, match="too short") as caught:
        run_limited("child_work:refuse", {}, tmp_path, LIMITS, "")
    error = caught.value
    assert (error.hint, error.code, error.exit_code) == ("record more", "too-short", 4)


@pytest.mark.parametrize(
    ("function", "limits", "words"),
    [
        ("crash", LIMITS, r"crashed \(signal 11\).* 256 MiB"),
        ("fail", LIMITS, r"crashed \(AttributeError: no such thing\)"),
        pytest.param("fill_memory", LIMITS, "more than 256 MiB of memory", marks=limited),
        pytest.param(
            "compute", replace(LIMITS, seconds=1.0), "more than 1 s of processor", marks=limited
        ),
        ("wait", replace(LIMITS, patience=1.0), "did not end within 1 s"),
    ],
)
def test_a_failure_has_its_reason(tmp_path, function, limits, words):
    with pytest.raises(ProcessFailure, match=words):
        run_limited(f"child_work:{function}", {}, tmp_path, limits, "")
