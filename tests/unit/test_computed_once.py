"""Work that a run does once, or not at all."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import pamid
from pamid.engine import jit_cache
from pamid.engine.program import Program, Stepping, build_program
from pamid.model.isolability import isolability
from pamid.model.registry import rig_named
from pamid.symbolic.expression import symbol
from pamid.symbolic.memory_cells import StateEquations
from pamid.symbolic.vocabulary import exp

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


def test_worker_processes_load_what_they_need() -> None:
    """Every worker process of a trial imports the diagnosis."""
    heavy = ("scipy.linalg", "scipy.signal", "scipy.sparse", "pandas", "matplotlib", "torch")
    loaded = f"print([m for m in {heavy} if m in sys.modules])"
    code = f"import sys, pamid.verdict.diagnosis_run; {loaded}"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_isolability_is_computed_once_per_rig_and_sensors(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = rig_named("one-dof")
    found = isolability(rig, ("angle_deg",))
    monkeypatch.setattr("pamid.model.isolability.trace", lambda *_: pytest.fail("traced again"))
    assert isolability(rig, ("angle_deg",)) is found


# ---- partial derivatives ------------------------------------------------------------------------


def oscillator(stiffness: float) -> Program:
    """A mass on a spring that hardens, its parameters behind what depends on them alone."""
    x, v, u = symbol("state", "x"), symbol("state", "v"), symbol("input", "u")
    k, d = symbol("parameter", "k"), symbol("parameter", "d")
    pull = exp(k) * (x + stiffness * x**3) + (k * d + 1.0) * v
    equations = StateEquations(("x", "v"), (v, u - pull), (x, pull * exp(d)), ())
    return build_program(equations, ("u",), ("k", "d"), ("x", "pull"))


def test_partials_are_compiled_when_they_are_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    compiled: list[str] = []
    addresses = jit_cache.addresses

    def counted(text: str, names: list[str]) -> list[int]:
        compiled.extend(names)
        return addresses(text, names)

    monkeypatch.setattr(jit_cache, "addresses", counted)
    program, p = oscillator(0.3), np.array([0.4, 0.2])
    u = np.random.default_rng(0).standard_normal((50, 1))

    def run(columns: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        memory = program.memory(np.array([0.1, 0.0]), columns=2)
        Y, JY, bad = program.run(memory, u, p, period_s=0.05, columns=columns)
        assert bad == -1
        return Y, JY

    before, _ = run(None)
    assert compiled == ["f0", "f1", "prepare"]
    _, slopes = run(np.array([0, 1]))
    assert compiled[3:] == ["d0", "s0", "d1", "s1", "prepare"]
    after, _ = run(None)
    assert (before == after).all() and len(compiled) == 8
    memory = program.memory(np.array([0.1, 0.0]))
    implicit = program.run(memory, u, p, period_s=0.05, stepping=Stepping(1, implicit=True))[0]
    assert np.allclose(implicit, before, atol=0.05)
    for j in range(2):
        sides = []
        for change in (1e-5, -1e-5):
            moved = p.copy()
            moved[j] += change
            memory = program.memory(np.array([0.1, 0.0]))
            sides.append(program.run(memory, u, moved, period_s=0.05)[0])
        assert np.allclose((sides[0] - sides[1]) / 2e-5, slopes[:, :, j], rtol=1e-6, atol=1e-8)


def test_implicit_steps_compile_their_partials() -> None:
    program, p = oscillator(0.7), np.array([0.4, 0.2])
    memory = program.memory(np.array([0.1, 0.0]))
    u = np.zeros((200, 1))
    Y, _, bad = program.run(memory, u, p, period_s=0.01, stepping=Stepping(1, implicit=True))
    memory = program.memory(np.array([0.1, 0.0]))
    explicit = program.run(memory, u, p, period_s=0.01)[0]
    assert bad == -1 and np.allclose(Y, explicit, atol=1e-4)
