"""Work that a run does once, or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

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
def test_runs_hold_blas_to_one_thread(
    verb: Any, work: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[set[int]] = []

    class EndedError(Exception):
        pass

    def end(*_: Any, **__: Any) -> None:
        seen.append(blas_threads())
        raise EndedError

    with threadpool_limits(2, "blas"):
        monkeypatch.setattr(work, end)
        with pytest.raises(EndedError):
            verb(EXAMPLE, "one-dof", check=False)
        assert seen == [{1}]
        assert blas_threads() == {2}
