"""Added-variable plots: their slope is the coefficient of the effect in the joint least squares,
and an effect that is not there has none."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_cart import FEW, cart_evidence, record_cart

from pamid.base.json_file import read_json
from pamid.base.run_folder import ADDED_VARIABLES_FILE, Run
from pamid.base.schemas.added_variables_file import AddedVariable, AddedVariablesFile
from pamid.base.schemas.model import read
from pamid.diagnosis.candidate_model import CandidateModel, transferred
from pamid.diagnosis.pipeline import Diagnosis, diagnose
from pamid.diagnosis.verdict.added_variables import added_variables
from pamid.diagnosis.verdict.diagnosis_run import diagnose_into
from pamid.estimation.grey_box import model_with
from pamid.estimation.linear_rows import left_over, linear_rows
from pamid.estimation.problem import Problem, free_parameters
from pamid.model.attachment import attachments
from pamid.model.registry import effects

CATALOGUE = {name: kind for name, kind in effects().items() if name in FEW}
EVERYTHING = 10**9


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    return record_cart(tmp_path_factory.mktemp("cart"))


@pytest.fixture(scope="module")
def found(recording) -> Diagnosis:
    return diagnose(cart_evidence(recording), CATALOGUE)


def plot_of(d: Diagnosis, effect: str) -> AddedVariable:
    return next(one for one in added_variables(d).plots if one.effect == effect)


def ranked(d: Diagnosis, effect: str) -> CandidateModel:
    return next(c for c in d.ranking if c.label == effect)


def with_value(d: Diagnosis, effect: str, key: str, value: float) -> Diagnosis:
    """The diagnosis with one parameter (SI) of a candidate set."""
    model = ranked(d, effect)
    p = model.fit.p.copy()
    p[model.assembly.keys[f"{effect}:{key}"]] = value
    changed = replace(model, fit=replace(model.fit, p=p))
    return replace(d, ranking=(changed,))


def gauss_newton_amount(d: Diagnosis, effect: str, key: str) -> float:
    """The amount (SI) of one undamped step from where the effect is nothing, at the parameters of
    the refitted model: dense least squares, with exact derivatives."""
    model, base = ranked(d, effect), d.budget.baseline
    p = model.fit.p.copy()
    for name, place in base.assembly.keys.items():
        p[model.assembly.keys[name]] = base.fit.p[place]
    at = model.assembly.keys[f"{effect}:{key}"]
    p[at] = 0.0
    f, problem = base.fit, model.fit.problem
    rows = linear_rows(replace(f, problem=problem, p=p), EVERYTHING)
    bounds = [model.assembly.parameters[i] for i in problem.free]
    own = np.array([b.owner == effect for b in bounds])
    sheet = len(rows.away) - len(own)
    counted = np.concatenate([np.ones(sheet, bool), ~own])
    amount = problem.free.index(at)
    columns = np.column_stack(
        [rows.by_parameters[:, amount], rows.by_parameters[:, ~own], rows.by_starts]
    )
    step = -np.linalg.lstsq(columns[counted], rows.away[counted], rcond=None)[0]
    return float(step[0] * problem.scale.slope(p[list(problem.free)])[amount])


@pytest.mark.parametrize(
    ("effect", "key"), [("coulomb-friction", "level"), ("viscous-friction", "damping")]
)
def test_slope_is_the_gauss_newton_estimate_of_the_amount(found, effect, key):
    model = ranked(found, effect)
    fitted = float(model.fit.p[model.assembly.keys[f"{effect}:{key}"]])
    assert fitted > 0.0
    expected = gauss_newton_amount(found, effect, key)
    assert plot_of(found, effect).slope * fitted == pytest.approx(expected, rel=0.06)


def test_an_effect_that_is_not_there_has_no_slope(tmp_path):
    whole = diagnose(cart_evidence(record_cart(tmp_path, ())), CATALOGUE)
    assert not whole.ranking, "nothing is missing"
    base, evidence = whole.budget.baseline, whole.evidence
    rubbing, *_ = attachments(evidence.rig, [CATALOGUE["coulomb-friction"]])
    assembly = model_with(evidence, (rubbing,), whole.budget.sizes)
    tracks = evidence.tracks(assembly)
    problem = Problem(assembly, tracks, free_parameters(assembly, tracks))
    p = transferred(assembly, (base.assembly, base.fit.p))
    usual = replace(base, assembly=assembly, fit=replace(base.fit, problem=problem, p=p))
    plot = plot_of(replace(whole, ranking=(usual,)), "coulomb-friction")
    assert abs(plot.slope) < 0.05 and plot.low < 0.0 < plot.high and plot.share < 0.1


def test_a_candidate_that_was_refitted_to_nothing_has_no_plot(found):
    gone = with_value(found, "coulomb-friction", "level", 0.0)
    assert added_variables(gone).plots == ()


def test_the_run_folder_holds_them_whole(recording, tmp_path):
    run = Run.create(tmp_path / "run", command=["test"], seed=0)
    diagnose_into(run, cart_evidence(recording), CATALOGUE)
    content = read_json(run.folder / ADDED_VARIABLES_FILE)
    assert content["schema"] == "pamid.added-variables/1"
    assert read(AddedVariablesFile, content).plots[0].effect == "coulomb-friction"
    assert ADDED_VARIABLES_FILE in run.record["files"]
    assert not list(run.folder.glob(".*")), "a file was left half written"


def test_left_over_is_what_dense_least_squares_leaves(found):
    f = found.budget.baseline.fit
    rows = linear_rows(f, EVERYTHING)
    random = np.random.default_rng(2)
    columns = random.normal(size=(len(rows.away), 3))
    for held in (np.zeros(len(f.problem.free), bool), np.arange(len(f.problem.free)) == 0):
        J = np.column_stack([rows.by_parameters[:, ~held], rows.by_starts])
        J /= np.linalg.norm(J, axis=0)
        expected = columns - J @ np.linalg.lstsq(J, columns, rcond=None)[0]
        assert left_over(rows, columns, held) == pytest.approx(expected, abs=1e-6)
