"""`--fail-if`: the figures of a diagnosis that a condition may name."""

import json

import pytest
from pamid_cli.diagnose import _figures
from pamid_cli.fail_if import Condition, exit_code_of
from synthetic_run import make_run


@pytest.fixture
def figures(tmp_path) -> dict[str, float | None]:
    folder = make_run(tmp_path / "RUN", "partly-explained")
    return _figures(json.loads((folder / "diagnosis.json").read_text(encoding="utf-8")))


def test_a_diagnosis_has_a_remainder_a_probability_and_errors(figures):
    assert {"remainder", "probability", "angle_deg"} <= set(figures)
    assert figures["remainder"] is not None and 0.0 < figures["remainder"] < 1.0


def test_without_a_structural_gap_nothing_remains(tmp_path):
    folder = make_run(tmp_path / "RUN", "no-structural-gap")
    found = _figures(json.loads((folder / "diagnosis.json").read_text(encoding="utf-8")))
    assert found["remainder"] == 0.0 and found["probability"] == 0.0


@pytest.mark.parametrize("comparison, code", [(">", 7), (">=", 7), ("<", 6), ("<=", 6)])
def test_a_condition_that_holds_comes_before_failed_jobs(comparison, code, figures):
    assert exit_code_of([Condition("remainder", comparison, 0.001)], figures, 6) == code


@pytest.mark.parametrize("comparison", [">", "<"])
def test_an_unstable_model_meets_every_limit(comparison, capsys):
    assert exit_code_of([Condition("angle_deg", comparison, 1e9)], {"angle_deg": None}) == 7
    assert "angle_deg is of an unstable model (--fail-if)" in capsys.readouterr().err
