"""How benchmarks/published.py scores, what it reads, and what it says where something is missing.

No peer and no data of the benchmarks are needed.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def modules(monkeypatch):
    """The benchmark and its scoring, as they find each other when they run."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    for name in [n for n in sys.modules if n == "peers" or n.startswith("peers.")]:
        monkeypatch.delitem(sys.modules, name)
    import published
    from peers import public_sets

    return published, public_sets


def test_only_samples_behind_the_start_count(modules):
    _, sets = modules
    y = np.zeros(10)
    model = np.r_[np.full(4, 100.0), np.full(6, 0.002)]
    assert sets.rmse(y, model, 4, 1000.0) == pytest.approx(2.0)
    assert sets.rmse(y, model, 3, 1.0) > 10.0


def test_a_run_that_blows_up_is_infinite_and_wrong_lengths_are_refused(modules):
    _, sets = modules
    y = np.zeros(5)
    assert sets.rmse(y, np.array([0.0, 0.0, np.nan, 0.0, 0.0]), 1) == np.inf
    assert sets.rmse(y, np.array([np.nan, 0.0, 0.0, 0.0, 0.0]), 1) == 0.0
    with pytest.raises(ValueError, match="the record"):
        sets.rmse(y, np.zeros(4), 1)
    with pytest.raises(ValueError, match="do not count"):
        sets.rmse(y, y, 5)


def test_a_model_sees_the_first_samples_of_a_test_alone(modules):
    _, sets = modules
    one = sets.SETS["cascaded_tanks"]
    record = sets.Record(np.arange(9.0), np.arange(9.0) + 1.0, 4.0)
    seen = []

    def simulate(u, y0):
        seen.append((u.copy(), y0.copy()))
        y0[:] = 0.0  # what a model does to them does not reach the score
        return u

    assert sets.judge(one, [record], simulate) == [pytest.approx(1.0)]
    np.testing.assert_array_equal(seen[0][0], record.u)
    np.testing.assert_array_equal(seen[0][1], record.y[:5])
    assert record.y[0] == 1.0


def test_the_peers_are_pinned_alike_in_both_places(modules):
    published, _ = modules
    wanted = published.peer_packages((ROOT / "pyproject.toml").read_text())
    pinned = (ROOT / "constraints-peers.txt").read_text().splitlines()
    assert {p.lower() for p in wanted} <= {p.lower() for p in pinned}
    assert all("==" in p for p in wanted)
