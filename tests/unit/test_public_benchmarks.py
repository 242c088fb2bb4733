"""How benchmarks/published.py scores, what it reads, and what it says where something is missing.

No peer and no data of the benchmarks are needed.
"""

import importlib
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pamid.model.registry import rig_named

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


def test_starts_and_units_are_those_of_the_benchmarks(modules):
    _, sets = modules
    found = {s.name: (s.start, s.scale, s.unit) for s in sets.SETS.values()}
    assert found == {
        "cascaded_tanks": (5, 1.0, "V"),
        "emps": (20, 1000.0, "mm"),
        "silverbox": (50, 1000.0, "mV"),
    }
    assert all(len(s.published) == len(s.tests) for s in sets.SETS.values())
    assert all(t.file != s.fit for s in sets.SETS.values() for t in s.tests)


def test_records_are_read_by_the_names_of_their_columns(modules, tmp_path):
    _, sets = modules
    path = tmp_path / "x.csv"
    path.write_text("time_s,level_v,pump_v\n0,1,2\n4,3,4\n8,5,6\n")
    found = sets.read_record(path, ("pump_v", "level_v"), 2)
    np.testing.assert_array_equal(found.u, [2.0, 4.0])
    np.testing.assert_array_equal(found.y, [1.0, 3.0])
    assert found.period_s == 4.0
    with pytest.raises(ValueError, match="no column 'force_n'"):
        sets.read_record(path, ("force_n", "level_v"))
    path.write_text("time_s,level_v,pump_v\n0,1,nan\n4,3,4\n")
    with pytest.raises(ValueError, match="no number"):
        sets.read_record(path, ("pump_v", "level_v"))


def test_what_is_missing_is_a_row_with_its_reason(modules, tmp_path):
    published, sets = modules
    one = sets.SETS["cascaded_tanks"]
    found = published.row_of("deepsi", one, tmp_path, None, False)
    assert "estimation.csv is not there" in found["skipped"]
    folder = tmp_path / one.name
    folder.mkdir()
    for name in ("estimation.csv", "validation.csv"):
        (folder / name).write_text("time_s\n")
    found = published.row_of("deepsi", one, tmp_path, tmp_path / "nowhere", False)
    assert found["skipped"] == "deepSI is not installed: --install"
    assert "skipped" in published.lines("deepsi", one, found)[0]


def test_a_row_that_fails_says_why_and_its_last_line_is_the_answer(modules):
    published, sets = modules
    answer = {"version": "x 1", "errors": [0.25], "cpu_s": 3.2, "remark": "r"}
    assert published.told(0, f"noise\n{json.dumps(answer)}\n", "") == answer
    assert published.told(1, "", "a\nValueError: b\n")["skipped"] == "failed: ValueError: b"
    assert "nothing was printed" in published.told(0, "", "")["skipped"]
    rows = published.lines("pamid", sets.SETS["cascaded_tanks"], answer)
    assert rows == ["| cascaded_tanks | validation | x 1 | 0.25 V | 3 s | r |"]
    unstable = published.lines("pamid", sets.SETS["cascaded_tanks"], answer | {"errors": [None]})
    assert "unstable V" in unstable[0]


def test_a_row_of_one_set_is_not_asked_of_another(modules):
    published, sets = modules
    asked = list(published.ROWS)
    found = {name: published.rows_of(one, asked) for name, one in sets.SETS.items()}
    for name, only in published.ONLY.items():
        assert [one for one, rows in found.items() if name in rows] == [only]
    assert all(len(rows) >= len(asked) - len(published.ONLY) for rows in found.values())
    scripts = [ROOT / "benchmarks" / "peers" / script for script, _ in published.ROWS.values()]
    assert all(script.exists() for script in scripts)


def test_pulses_and_reference_are_read_from_the_columns_that_are_there(
    modules, monkeypatch, tmp_path
):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks" / "peers"))
    loop = importlib.import_module("public_loop")
    path = tmp_path / "x.csv"
    path.write_text("time_s,position_m,reference_m\n0,1,2\n1,3,4\n2,5,6\n")
    found = loop.loop_columns(path, None, "position_m")
    np.testing.assert_array_equal(found["reference_m"], [2.0, 4.0, 6.0])
    np.testing.assert_array_equal(found["pulse_v"], np.zeros(3))
    path.write_text("time_s,position_m,reference_m,pulse_n\n0,1,2,7\n1,3,4,8\n2,5,6,9\n")
    np.testing.assert_array_equal(loop.loop_columns(path, 2, "position_m")["pulse_v"], [7.0, 8.0])


def test_the_loop_of_emps_is_the_published_controller():
    """At rest a reference that lies ahead drives with kv kp times its distance, within 10 V."""
    rig = rig_named(str(ROOT / "benchmarks" / "rigs" / "emps_in_its_loop.py"))
    x = SimpleNamespace(position=0.0, velocity=0.0, seen=0.0)
    values = SimpleNamespace(**{p.name: p.value for p in rig.parameters})

    def force(reference, pulse):
        u = SimpleNamespace(reference_m=reference, pulse_v=pulse)
        passed = []
        rig.rates(x, u, values, lambda name, value, **_: passed.append(value) or value)
        return passed[0]

    assert force(1e-4, 0.0).value == pytest.approx(35.15065 * 243.45 * 160.18 * 1e-4)
    assert force(0.0, 2.0).value == pytest.approx(35.15065 * 2.0)
    assert force(1.0, 0.0).value == pytest.approx(35.15065 * 10.0)


def test_the_peers_are_pinned_alike_in_both_places(modules):
    published, _ = modules
    wanted = published.peer_packages((ROOT / "pyproject.toml").read_text())
    pinned = (ROOT / "constraints-peers.txt").read_text().splitlines()
    assert {p.lower() for p in wanted} <= {p.lower() for p in pinned}
    assert all("==" in p for p in wanted)


def test_widest_vectors_are_read_from_the_flags(modules):
    published, _ = modules
    assert published.vectors("flags : sse2 avx avx2 avx512f\n") == "AVX-512"
    assert published.vectors("flags : sse2 avx avx2\n") == "AVX2"
    assert published.vectors("") == "unknown"
