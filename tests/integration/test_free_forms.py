"""Effects whose law no file of the catalogue holds: their family is named by the free form that
takes them up, with its curve."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from one_cart import DAMPING, MASS, PERIOD_S, SPRING, cart

from pamid.api.given import evidence_of
from pamid.base.arrays import Array
from pamid.base.parallel.jobs import WorkerPool
from pamid.base.progress import silent
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.comparison import Comparison
from pamid.diagnosis.family_forms import FreeForm, free_forms
from pamid.diagnosis.pipeline import Diagnosis, diagnose
from pamid.diagnosis.search import RefitStart, RefitWork, Search
from pamid.diagnosis.starting_hints import gather_hints
from pamid.diagnosis.verdict.remainder import find_missing
from pamid.diagnosis.verdict.verdict_figures import diagnosis_file
from pamid.engine.symbolic.vocabulary import Expr, Number, absolute, exp, stop, tanh, where
from pamid.model.attachment import attach
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter
from pamid.model.registry import effects
from pamid.recording.recording import recording_of
from pamid.simulation.data_split import DataSplit
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.virtual_rig import simulate_virtual_rig

#: none of them of a family that is planted
FEW = ("external-vibration", "dead-time")
SPECIMEN = {"mass": MASS, "spring": SPRING, "damping": DAMPING}
NOISE = 1e-4  # m
SAMPLES = 1800
NEAR = 0.12  # of the planted curve's range
PUSH = 9.0  # N


class Planted(Effect):
    """Base of what is planted here; `amount` is in N."""

    family = "planted"
    parameters = (Parameter("amount", 1.5, 0.0, 15.0, null=0.0, source="planted"),)


class SteepeningFriction(Planted):
    """Odd, with all powers of the velocity."""

    kinds, signals = ("motion",), ("velocity",)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        steep = 6.0 * at.velocity
        return value - p.amount * (exp(steep) - exp(-steep)) / 12.0


class LopsidedFriction(Planted):
    """It falls with the speed one way, and grows with its square the other."""

    kinds, signals = ("motion",), ("velocity", "position")

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        v, bend = at.velocity, stop(at.position, 5e-4) / 5e-4
        back = 0.2 * bend + 7.0 * v * absolute(v)
        return value - p.amount * where(v > 0.0, bend * (0.4 + exp(-6.0 * v)), back)


class Step(Planted):
    """A force that changes its sign near one place."""

    kinds, signals = ("motion",), ("position",)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - p.amount * tanh((at.position - 0.05) * 15.0)


class OneSidedCurve(Planted):
    """An amplifier that gives less the more it is asked for, one way."""

    kinds = ("command",)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value - 2.0 * p.amount * where(value > 0.0, (value / PUSH) ** 2, 0.0)


class TwoSlips(Planted):
    """Two elements that slip at different lengths."""

    kinds, signals = ("motion",), ("position",)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        x = at.position
        return value - 0.5 * p.amount * (stop(x, 0.03) / 0.03 + stop(x, 0.09) / 0.09)


class Nothing(Planted):
    """Of no influence."""

    kinds, signals = ("motion",), ("velocity",)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value


def recorded(*planted: str | type[Effect]) -> DataSplit:
    """A cart with these effects, whose model is off from it as data sheets are."""
    rig, time = cart(), PERIOD_S * np.arange(SAMPLES)
    type(rig).noise, type(rig).period_s = {"place": NOISE}, PERIOD_S
    push = aprbs(SAMPLES * PERIOD_S, PERIOD_S, PUSH, (0.12, 0.7), seed=7)
    sent = recording_of(time, {"push": push[:SAMPLES]})
    made = simulate_virtual_rig(rig, sent, planted, {}, SPECIMEN, 1.0, 4)
    return evidence_of([recording_of(time, made.columns)], cart(), warn=lambda _: None).evidence


@cache
def diagnosed(planted: type[Effect]) -> Diagnosis:
    return diagnose(recorded(planted), {name: effects()[name] for name in FEW})


def search_of(d: Diagnosis) -> Search:
    hints = gather_hints(d.evidence, d.budget.baseline)
    return Search(d.evidence, d.budget, [], hints, 0, WorkerPool(), silent)


def forms_of(d: Diagnosis) -> tuple[FreeForm, ...]:
    return d.answer.free_forms if d.answer else ()


def fitted(form: FreeForm, name: str) -> float:
    a = form.model.assembly
    return float(form.model.fit.p[a.index_of(name)])


def of_steepening(x: Array) -> Array:
    return np.asarray(1.5 * np.sinh(6.0 * x) / 6.0)


def of_lopsided(x: Array) -> Array:
    forth, back = 0.4 + np.exp(-6.0 * x), 0.2 * np.sign(x) + 7.0 * x * np.abs(x)
    return np.asarray(1.5 * np.where(x > 0.0, forth, back))


def of_step(x: Array) -> Array:
    return np.asarray(1.5 * np.tanh((x - 0.05) * 15.0))


def of_curve(x: Array) -> Array:
    return np.asarray(-3.0 * np.where(x > 0.0, (x / PUSH) ** 2, 0.0))


def of_slips(x: Array) -> Array:
    """Along a way there and back, as it closes after the first time."""
    held, out = np.zeros(2), np.empty((len(x), 2))
    widths = np.array([0.03, 0.09])
    for i in [*range(len(x)), *range(len(x))]:
        held = np.clip(held + x[i] - x[i - 1], -widths, widths)
        out[i] = held
    return np.asarray(0.75 * (out / widths).sum(axis=1))


def beside_damping(form: FreeForm, x: Array, y: Array) -> Array:
    return y + (fitted(form, "damping") - DAMPING) * x


def beside_spring(form: FreeForm, x: Array, y: Array) -> Array:
    return y + (fitted(form, "spring") - SPRING) * x


def beside_mass(form: FreeForm, x: Array, y: Array) -> Array:
    """What the push does with mass, spring and damping that are all too large by the same
    factor."""
    return (x + y) * MASS / fitted(form, "mass") - x


Truth = Callable[[Array], Array]
Beside = Callable[[FreeForm, Array, Array], Array]
CASES: dict[type[Effect], tuple[str, str, Truth, Beside]] = {
    SteepeningFriction: ("friction", "guide", of_steepening, beside_damping),
    LopsidedFriction: ("friction", "guide", of_lopsided, beside_damping),
    Step: ("stiffness", "guide", of_step, beside_spring),
    OneSidedCurve: ("static-map", "amplifier", of_curve, beside_mass),
    TwoSlips: ("hysteresis", "guide", of_slips, beside_spring),
}
each = pytest.mark.parametrize(
    "planted",
    [pytest.param(c, marks=pytest.mark.slow) if c is LopsidedFriction else c for c in CASES],
    ids=lambda c: c.__name__,
)


@each
def test_the_family_is_named_with_its_port(planted):
    family, port, _, _ = CASES[planted]
    d = diagnosed(planted)
    found = diagnosis_file(d, find_missing(d))
    assert found.verdict == "unknown-effect" and not found.causes and found.unknown is not None
    first = found.unknown.free_forms[0]
    assert (first.family, first.port, found.where.port) == (family, port, port)
    assert {one.family for one in found.unknown.free_forms} == {family}
    assert f"of the {family} family, in a form that is not in the catalogue" in found.sentence
    assert found.where.ports[0].port == port
    assert 0.6 < first.shrinkage <= 1.0 and first.low < first.shrinkage < first.high


@each
def test_its_curve_is_the_planted_one(planted):
    """Beside what the refitted parameters of the rig can take up as well."""
    _, _, truth, beside = CASES[planted]
    form = forms_of(diagnosed(planted))[0]
    x, y = np.array(form.curve.x), np.array(form.curve.y)
    said, planned = beside(form, x, y), truth(x)
    moving = np.abs(x) > 0.02 * np.ptp(x)  # a curve may jump at zero
    assert np.max(np.abs(said - planned)[moving]) < NEAR * np.ptp(planned)
    assert np.all(np.array(form.curve.low) <= y) and np.all(y <= np.array(form.curve.high))


def test_nothing_has_no_family():
    d = diagnosed(Nothing)
    assert d.verdict == "no-structural-gap" and forms_of(d) == ()
    search, ports = search_of(d), list(d.evidence.rig.ports)
    assert free_forms(search, d.comparison, d.budget.baseline, ports) == []


def test_noise_has_no_family():
    """A position that the push has not made: nothing takes it up where it was not fitted."""
    random = np.random.default_rng(3)
    columns = {
        "push": random.uniform(-PUSH, PUSH, SAMPLES),
        "place": 0.1 * random.standard_normal(SAMPLES),
    }
    recording = recording_of(PERIOD_S * np.arange(SAMPLES), columns)
    evidence = evidence_of([recording], cart(), warn=lambda _: None).evidence
    d = diagnose(evidence, {"dead-time": effects()["dead-time"]})
    assert d.silent == ("place",) and forms_of(d) == ()


def test_a_withheld_effect_keeps_its_family():
    d = diagnose(recorded("dead-time@amplifier"), {"offset": effects()["offset"]})
    assert d.verdict == "unknown-effect"
    assert [(f.family, f.port) for f in forms_of(d)] == [("command-timing", "amplifier")]


def test_a_gap_far_above_the_floor_is_not_denied():
    """No curve at a port predicts it, and no effect that is known."""
    d = shaken()
    assert d.comparison.floors(d.budget.baseline) > 100.0
    assert d.verdict != "no-structural-gap"


@cache
def shaken() -> Diagnosis:
    return diagnose(recorded("external-vibration:sine_value=3"), {"offset": effects()["offset"]})


@cache
def stuck() -> tuple[Search, Comparison, CandidateModel]:
    """A cart with dry friction and a force that changes its sign near one place; the model that
    has the first alone."""
    d = diagnose(recorded("coulomb-friction", Step), {})
    search = search_of(d)
    named = attach(search.evidence.rig, "coulomb-friction", effects())
    work = RefitWork(search.evidence, search.budget.baseline.fit, search.budget.sizes)
    return search, d.comparison, search.pool.one(work, RefitStart((named,), assembly=None))


def test_the_remainder_beside_a_named_cause_has_a_family():
    search, comparison, named = stuck()
    found = free_forms(search, comparison, named, ["guide"])
    assert [f.family for f in found] == ["stiffness"]
    assert [a.effect.name for a in found[0].model.attached] == [
        "coulomb-friction",
        "free-position-force",
    ]
    assert found[0].removes.share > 0.5
    assert found[0].model.fit.p[found[0].model.assembly.keys["coulomb-friction:level"]] > 0.0
