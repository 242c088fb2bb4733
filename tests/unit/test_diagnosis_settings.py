"""What a diagnosis weighs with: documented, used, settable, and part of what its results are known
by."""

from __future__ import annotations

import ast
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_decision import FRICTION
from test_missing_term import missing

import pamid.diagnosis
from pamid.base.errors import UsageError
from pamid.diagnosis import notes, ranges
from pamid.diagnosis.budget import Budget, _BlackBox
from pamid.diagnosis.candidate_model import resamples
from pamid.diagnosis.decision import Share, at_noise_floor
from pamid.diagnosis.input_response import _is_better
from pamid.diagnosis.port_evidence import _Smoothing
from pamid.diagnosis.screening import Screened, ScreeningBaseline, promising
from pamid.diagnosis.search import Refitting, _Screening, _StepRefinement
from pamid.diagnosis.settings import DEFAULT, Settings, described, settings_from
from pamid.diagnosis.smoothed_trajectory import SlicedTrack, slices_of
from pamid.diagnosis.smoother import Smoother, SmoothingProblem
from pamid.diagnosis.starting_hints import spectrum_peaks
from pamid.diagnosis.unknown import _Describing, missing_csv, parity, regressors
from pamid.model.background import Gain
from pamid.parallel.jobs import Work
from pamid.parallel.result_store import digest

ROOM = Path(pamid.diagnosis.__file__).parent
SOURCES = {p.name: ast.parse(p.read_text(encoding="utf-8")) for p in sorted(ROOM.glob("*.py"))}
OTHER = Settings(refits=DEFAULT.refits + 1)
nothing: Any = None


def test_every_setting_says_what_it_is_and_what_speaks_for_it() -> None:
    for s in described():
        assert s["unit"] and len(s["meaning"]) > 10 and len(s["evidence"]) > 20, s["name"]


def test_every_setting_is_read() -> None:
    read = {
        node.attr
        for name, tree in SOURCES.items()
        if name != "settings.py"
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
    }
    assert [f.name for f in fields(Settings) if f.name not in read] == []


def test_no_number_stands_beside_them() -> None:
    """A threshold at the head of a module could be neither set nor told apart in the store."""
    found = [
        f"{name}: {ast.unparse(node)}"
        for name, tree in SOURCES.items()
        for node in tree.body
        if isinstance(node, ast.Assign) and not isinstance(node.value, ast.Subscript)
        for value in ast.walk(node.value)
        if isinstance(value, ast.Constant) and isinstance(value.value, int | float)
    ]
    assert found == []


def test_an_unknown_name_is_refused_with_the_nearest() -> None:
    with pytest.raises(UsageError, match="Did you mean 'gap_margin'"):
        settings_from({"gap_margins": 0.2})
    assert settings_from({"gap_margin": 0.2}) == Settings(gap_margin=0.2)


@pytest.mark.parametrize(
    "given",
    [
        {"gap_margin": -0.1},
        {"gap_margin": "0.1"},
        {"refits": 2.5},
        {"refits": 0},
        {"latent_sizes": ()},
        {"latent_times": (0.1, 0.0)},
        {"experiment_ways": ((1.0, "2"),)},
    ],
)
def test_a_value_of_another_kind_is_refused(given: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match=next(iter(given))):
        settings_from(given)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (_BlackBox(nothing, DEFAULT), _BlackBox(nothing, OTHER)),
        (Refitting(nothing, nothing, {}, DEFAULT), Refitting(nothing, nothing, {}, OTHER)),
        (_Smoothing(nothing, nothing, True, DEFAULT), _Smoothing(nothing, nothing, True, OTHER)),
        (_StepRefinement(nothing, DEFAULT), _StepRefinement(nothing, OTHER)),
        (
            _Describing(nothing, nothing, 0, DEFAULT),
            _Describing(nothing, nothing, 0, OTHER),
        ),
        (
            _Screening(
                nothing,
                ScreeningBaseline(nothing, (), (), nothing, 0.0, False, DEFAULT),
                {},
                nothing,
            ),
            _Screening(
                nothing, ScreeningBaseline(nothing, (), (), nothing, 0.0, False, OTHER), {}, nothing
            ),
        ),
    ],
    ids=lambda work: type(work).__name__,
)
def test_results_of_other_settings_have_other_keys(
    one: Work[Any, Any], other: Work[Any, Any]
) -> None:
    assert digest(one) != digest(other)
    assert digest(one) == digest(replace(one))  # type: ignore[type-var]


# ---- a changed field changes what it says ----------------------------------------------------


def budget(error: float, settings: Settings) -> Budget:
    floor = np.ones((16, 1))
    base: Any = SimpleNamespace(absolutes=error * floor)
    return Budget(nothing, base, floor, floor, floor, settings)


def test_the_margin_of_a_gap() -> None:
    assert not at_noise_floor(budget(1.15, DEFAULT), 0)
    assert at_noise_floor(budget(1.15, Settings(gap_margin=0.2)), 0)


def test_what_speaks_against_a_cause() -> None:
    assert not FRICTION.objections()
    assert FRICTION.objections(Settings(least_shrinkage=0.9)) == ["it removes next to nothing"]
    elsewhere = replace(FRICTION, here=0.02, removes=Share(0.45, 0.3, 0.6))
    assert not elsewhere.objections() and elsewhere.objections(Settings(port_negligible=0.05))
    plain = replace(elsewhere, here=0.0, removes=Share(0.98, 0.9, 1.0))
    assert not plain.objections() and plain.objections(Settings(port_overruled=0.95))
    sure = replace(elsewhere, here=0.0, sure=6.9)
    assert not sure.objections() and sure.objections(Settings(further_sure=7.0))


def test_the_pull_from_which_a_background_is_named() -> None:
    def told(settings: Settings) -> list[str]:
        return notes._background(pulled(settings))

    (found,) = told(DEFAULT)
    assert found == (
        "Background force_map_1 stands at 3.0 tolerances: length-asymmetry (with it 2.0) or "
        "force-asymmetry (with it 2.4) would look like this."
    )
    (fewer,) = told(Settings(far_off_alike=1))
    assert "length-asymmetry" in fewer and "force-asymmetry" not in fewer
    (none,) = told(Settings(far_off_eased=2.0))
    assert "no effect of the ranking takes that up" in none
    assert told(Settings(far_off=3.1)) == []
    assert len(told(Settings(far_off=1.0))) == 2, "force_map_2 stands at 1.2"


def test_a_parameter_that_was_moved_far_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    moved = {"": 4.1, "leak": 4.0, "length-asymmetry": 0.4, "force-asymmetry": 2.0, "gravity": 4.1}
    d = pulled(DEFAULT)
    for model in (d.budget.baseline, *d.ranking):
        model.fit.strains = {"contraction_0": moved[model.label], "mass_kg": 0.2}
    monkeypatch.setattr(notes, "_strains", lambda fitted: fitted.strains)
    assert notes._strained(d) == [
        "contraction_0 was moved 4.1 standard deviations of its prior: length-asymmetry (with it "
        "0.4) or force-asymmetry (with it 2.0) would look like this."
    ]
    d.ranking = ()
    assert "no effect of the ranking brings it back" in notes._strained(d)[0]


def pulled(settings: Settings) -> Any:
    """A diagnosis without a cause, its model's background at a bound, and four candidates."""

    def model(label: str, *pulls: float) -> Any:
        terms = [
            SimpleNamespace(
                nuisance=True,
                fitted=True,
                owner=f"background.force_map_{k}",
                value=1.0,
                spread=0.1,
            )
            for k in (1, 2)
        ]
        gain = Gain("force_map", tolerance=0.1)
        assembly = SimpleNamespace(
            parameters=terms, background_terms={term.owner: gain for term in terms}
        )
        fitted = SimpleNamespace(
            problem=SimpleNamespace(assembly=assembly),
            p=[1.0 - 0.1 * pulls[0], 1.0 + 0.1 * pulls[1]],
        )
        attached = [SimpleNamespace(label=label)] if label else []
        return SimpleNamespace(label=label, attached=attached, fit=fitted)

    return SimpleNamespace(
        cause=None,
        settings=settings,
        budget=SimpleNamespace(baseline=model("", 3.0, 1.2)),
        ranking=(
            model("leak", 2.9, 1.2),
            model("length-asymmetry", 2.0, 1.1),
            model("force-asymmetry", 2.4, 1.1),
            model("gravity", 3.0, 1.0),
        ),
    )


def test_the_margin_over_a_guess() -> None:
    guess = np.ones(20)
    assert _is_better(0.85 * guess, guess, 0, DEFAULT)
    assert not _is_better(0.85 * guess, guess, 0, replace(DEFAULT, naive_margin=0.2))
    # six windows of a slow machine: a seventh of the error, one window by accident worse
    few, own = (
        np.array([25.87, 7.97, 2.7, 0.85, 0.69, 8.89]),
        np.array([0.3, 0.8, 2.0, 0.7, 1.9, 0.4]),
    )
    assert _is_better(own, few, 0, DEFAULT)
    assert not _is_better(own, few, 0, replace(DEFAULT, naive_plain=0.1)), "by its interval alone"


def test_how_many_are_refitted() -> None:
    def refitted(settings: Settings, beside: bool = False) -> int:
        base: Any = SimpleNamespace(attached=("one",) if beside else ())
        ground = ScreeningBaseline(base, (), (), nothing, 0.0, False, settings)
        tried: Any = [
            Screened(SimpleNamespace(label=str(i)), SimpleNamespace(), {}, 100.0 - i)  # type: ignore[arg-type]
            for i in range(40)
        ]
        return len(promising({str(i): "one" for i in range(40)}, tried, ground))

    assert refitted(DEFAULT) == DEFAULT.refits
    assert refitted(OTHER) == DEFAULT.refits + 1
    assert refitted(Settings(refits_least=3, refit_share=0.97)) == 3
    assert refitted(DEFAULT, beside=True) == DEFAULT.refits_beside


def test_blocks_of_the_bootstrap() -> None:
    for block in (1, 2, 3):
        rows = resamples(12, 50, 0, block).reshape(50, -1, block)
        assert rows.shape == (50, 12 // block, block)
        assert ((np.diff(rows, axis=2) % 12) == 1).all()


def test_lines_of_the_spectrum() -> None:
    t = 0.01 * np.arange(4000)

    class Track(list[float]):
        period_s, timescale_s = 0.01, 0.6

    replay: Any = SimpleNamespace(
        residual=np.sin(2.0 * np.pi * 3.0 * t)[:, None], track=Track(t.tolist())
    )
    assert spectrum_peaks([replay], np.ones(1))[0] == pytest.approx(3.0, abs=0.05)
    assert spectrum_peaks([replay], np.ones(1), Settings(slowest_line=2.4))[0] >= 4.0
    assert len(spectrum_peaks([replay], np.ones(1), Settings(spectrum_lines=1))) == 1


@pytest.mark.parametrize("hz", [2.9471, 3.0, 3.0123])
def test_a_line_between_two_points_of_the_spectrum(hz: float) -> None:
    """Told to a hundredth of 1/duration: pulses over 120 periods stay in step."""
    t = 0.01 * np.arange(4000)

    class Track(list[float]):
        period_s, timescale_s = 0.01, 0.6

    replay: Any = SimpleNamespace(
        residual=np.sin(2.0 * np.pi * hz * t + 0.7)[:, None], track=Track(t.tolist())
    )
    assert spectrum_peaks([replay], np.ones(1))[0] == pytest.approx(hz, abs=0.01 / 40.0)


def test_rows_and_parity_of_a_missing_term() -> None:
    m = missing(300)
    assert missing_csv(m, Settings(missing_rows=100)).count(b"\n") == 101
    assert parity(m) == "odd" and parity(m, Settings(parity_factor=1e9)) == "mixed"


def test_sizes_and_times_of_a_latent_value() -> None:
    def near(settings: Settings) -> list[tuple[float, float]]:
        evidence: Any = SimpleNamespace(timescale_s=2.0)
        return Smoother(evidence, nothing, (), settings)._near(0.03)

    assert {size for size, _ in near(DEFAULT)} == {0.01, 0.03, 0.1}
    assert {time_s for _, time_s in near(DEFAULT)} == {2.0 * t for t in DEFAULT.latent_times}
    assert near(Settings(latent_reach=2.0, latent_times=(0.5,))) == [(0.03, 1.0)]


def test_slices_of_a_trajectory() -> None:
    replay: Any = SimpleNamespace(
        track=SimpleNamespace(period_s=0.01, timescale_s=0.6),
        windows=[SimpleNamespace(start=0, stop=60)],
    )
    assert [s.stop - s.start for s in slices_of(replay)[0]] == [10] * 6
    assert len(slices_of(replay, Settings(latent_slice=0.5))[0]) == 2
    assert len(slices_of(replay, Settings(latent_slice_samples=20))[0]) == 3


def test_what_a_trajectory_may_jump_by() -> None:
    def joints(settings: Settings) -> Any:
        track = SimpleNamespace(jump=np.array([1e9]), period_s=0.01)
        slices: Any = [SimpleNamespace(start=10 * i, stop=10 * i + 10) for i in range(4)]
        opens = np.array([True, False, True, False])
        runner: Any = SimpleNamespace(track=track)
        sliced = SlicedTrack(runner, slices, opens, nothing, settings)
        x = np.random.default_rng(0).normal(size=(4, 2))
        return sliced.prior(x, np.array([1]), 0.1, 1.0).joint[:, 0]

    inside, opening, _ = joints(DEFAULT)
    assert joints(Settings(latent_stiffness=1e-3))[0] == pytest.approx(1e-2 * inside)
    assert joints(Settings(latent_window_jump=1e2))[1] == pytest.approx(1e2 * opening)


def test_an_effect_has_vanished_where_all_its_amounts_are_at_nothing() -> None:
    def given(owner: str, name: str, null: float | None) -> Any:
        return SimpleNamespace(owner=owner, name=name, null=null, key=f"{owner}:{name}")

    parameters = [given("", "mass", None), given("slip", "forth", 0.0), given("slip", "back", 0.0)]
    parameters.append(given("slip", "reach", None))
    assembly = SimpleNamespace(parameters=parameters)

    def gone(*values: float, defining: tuple[str, ...] = ()) -> tuple[str, ...]:
        slip = SimpleNamespace(label="slip", effect=SimpleNamespace(defining=defining))
        model: Any = SimpleNamespace(
            assembly=assembly, attached=(slip,), fit=SimpleNamespace(p=np.array(values))
        )
        return ranges.vanished(model, "slip")

    assert gone(0.0, 0.0, 0.0, 1.0) == ("forth", "back")
    assert gone(0.0, 1e-9, 0.0, 1.0) == () == gone(1.0, 1.0, 1.0, 0.0)
    # without what defines it, it is a plainer effect, whatever else is there
    assert gone(0.0, 1.0, 0.0, 1.0, defining=("back",)) == ("back",)
    assert gone(0.0, 0.0, 1.0, 1.0, defining=("back",)) == ()


def test_how_hard_a_fit_presses_against_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    bound = SimpleNamespace(owner="play", sized=True, log=True, low=0.1, high=1.0, name="gap")
    bound.softens = False
    ended = SimpleNamespace(bound=bound, at_bound="high")
    monkeypatch.setattr(ranges, "estimates", lambda fitted: [ended])
    fitted = SimpleNamespace(
        residuals=(np.zeros(1),), held=np.array([5.0]), problem=SimpleNamespace(free=(0,))
    )
    assembly = SimpleNamespace(attachments=(SimpleNamespace(label="play"),))
    model: Any = SimpleNamespace(assembly=assembly, fit=fitted)
    assert ranges.at_bounds(model) == ("gap",)
    assert ranges.at_bounds(model, Settings(pressed=6.0)) == ()
    ended.at_bound = "low"  # of a factor: as little of it as the equation can be solved with
    assert ranges.at_bounds(model) == ()
    bound.softens = True  # less of it is no harder to solve: a guess at either end
    assert ranges.at_bounds(model) == ("gap",)
    bound.log = bound.softens = False
    assert ranges.at_bounds(model) == ("gap",)


@dataclass(frozen=True)
class Attached:
    """What `ranges` needs of an assembly."""

    attachments: tuple[Any, ...]
    ranges: dict[str, tuple[float, float]]


def test_ranges_are_widened_of_every_effect_and_below_where_that_is_softer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def bound(owner: str, name: str, **more: Any) -> Any:
        return SimpleNamespace(
            owner=owner, key=f"{owner}:{name}", sized=True, log=True, low=2.0, high=8.0, **more
        )

    ended = [
        SimpleNamespace(bound=bound("spring", "frequency", softens=True), at_bound="low"),
        SimpleNamespace(bound=bound("spring", "drag", softens=False), at_bound="high"),
        SimpleNamespace(bound=bound("rub", "give", softens=False), at_bound="low"),
        SimpleNamespace(bound=bound("rub", "torque", softens=False), at_bound=None),
    ]
    monkeypatch.setattr(ranges, "estimates", lambda fitted: ended)
    fit: Any = SimpleNamespace(
        residuals=(np.zeros(1),), held=np.ones(4), problem=SimpleNamespace(free=range(4))
    )
    spring, rub = SimpleNamespace(label="spring"), SimpleNamespace(label="rub")
    assembly: Any = Attached((spring, rub), {"rub:torque": (0.0, 1.0)})
    wider = ranges.widened(assembly, fit, Settings(wider=4.0))
    assert wider is not None and wider.ranges == {
        "rub:torque": (0.0, 1.0),
        "spring:frequency": (0.5, 8.0),
        "spring:drag": (2.0, 32.0),
    }
    assert ranges.widened(Attached((rub,), {}), fit) is None  # type: ignore[arg-type]


def test_when_a_smoothing_ends_and_how_it_is_damped() -> None:
    settings = Settings(smoother_tolerance=0.5, smoother_damping=1e-3, smoother_damping_rises=7.0)

    def problem(settings: Settings) -> SmoothingProblem:
        return SmoothingProblem(Smoother(nothing, nothing, (), settings), [], True)

    at: Any = SimpleNamespace(cost=1.0)
    assert problem(settings).settled(0.1, at, at) and not problem(DEFAULT).settled(0.1, at, at)
    rule = problem(settings).rule
    assert (rule.start, rule.least, rule.rises) == (1e-3, 1e-3, 7.0)


def test_signs_in_a_formula() -> None:
    signals, units = {"velocity": np.linspace(-1.0, 1.0, 201)}, {"velocity": ""}
    names, sharp = regressors(signals, units)
    _, soft = regressors(signals, units, Settings(formula_sign=1.0))
    sign = names.index("sign(velocity)")
    assert np.abs(sharp[150, sign]) > 0.99 > np.abs(soft[150, sign])
