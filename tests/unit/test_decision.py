"""From figures to a verdict: rules, what is said against a cause, p-values, intervals, and what
calibration makes of labelled cases."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

import pamid.diagnosis.decision as decision
import pamid.diagnosis.verdict as verdict
from pamid.base.errors import DataError
from pamid.base.metrics import shrinkage_interval
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.decision import Share, Weighed, decide, gap_share, is_real
from pamid.diagnosis.forward_selection import ForwardStep
from pamid.diagnosis.judgement import (
    QUESTIONS,
    Calibration,
    Line,
    calibration,
    forecast_interval,
)
from pamid.diagnosis.settings import DEFAULT
from pamid.diagnosis.signature import Signature, cause_probability
from pamid.diagnosis.verdict_grounds import LeftOver, VerdictStatistics
from pamid.trial.calibration import calibration_json, lesson
from pamid.trial.cases import TRIAL_PARTS

Array = NDArray[np.float64]

#: what is missing shows as latent evidence alone: even odds at one nat per sample
PLAIN = Calibration(
    {
        "missing": Line(0.0, {"missing": 4.0}, 0.5),
        "cause": Line(0.0, {"sure": 1.0}, 0.5),
        "further": Line(0.0, {"sure": 1.0}, 0.5),
    },
    silent=(0.01, 0.02, 0.02, 0.1, 0.4),
    spread=0.3,
    cases={},
    stated_yes=0.5,
)
#: a gap, and what nothing but noise and tolerances leaves
GAP = LeftOver(
    floors=6.0, of_signal=0.05, missing=30.0, next_sure=15.0, next_removes=0.75, network=0.4
)
SILENT = LeftOver(
    floors=1.03, of_signal=0.01, missing=0.02, next_sure=0.5, next_removes=0.01, network=0.0
)
FRICTION = Weighed("coulomb-friction", "friction", 0.97, Share(0.64, 0.55, 0.7), (), 0.8)
LEAK = Weighed("leak", "leak", 0.8, Share(0.2, 0.1, 0.3), (), 0.15)
#: what speaks for an effect that is there, and for one that is not
SPEAKING = Signature(
    removed=0.6,
    of_left=0.6,
    sure=12.0,
    steady=1.0,
    lead=0.3,
    lead_sure=8.0,
    wins=1.0,
    at_port=1.0,
    evidence=400.0,
    evidence_lead=60.0,
    eased=4.0,
    left=0.05,
    remaining=1.1,
    bounds=0.0,
    converged=1.0,
    beside=0.0,
)
SPEECHLESS = replace(
    SPEAKING,
    removed=0.01,
    of_left=0.01,
    sure=0.6,
    steady=0.5,
    lead=-0.2,
    lead_sure=-6.0,
    wins=0.0,
    at_port=0.3,
    evidence=1.0,
    evidence_lead=-5.0,
    eased=0.0,
    left=0.98,
    remaining=6.0,
)
#: a further effect that is real, and one that is not
ADDED = ForwardStep(
    "leak",
    "leak",
    removed=0.3,
    of_left=0.8,
    gain=0.6,
    sure=12.0,
    margin=6.0,
    at_port=1.0,
    unexplained=3.0,
)
NEEDLESS = replace(
    ADDED, removed=0.01, of_left=0.05, gain=0.02, sure=1.5, margin=0.5, at_port=0.6, unexplained=0.2
)
#: a clear case: large gap, removed by one effect that wins everywhere
CLEAR = VerdictStatistics(
    visible=6.0,
    gap=8.0,
    of_signal=0.05,
    left=0.02,
    ceiling=0.6,
    shrinkage=0.75,
    gain=2.3,
    sure=15.0,
    helps=1.0,
    margin=0.5,
    margin_gain=1.0,
    margin_sure=12.0,
    wins=1.0,
    missing=30.0,
    unexplained=0.03,
    at_port=1.0,
    strain=1.0,
    pull=1.0,
    channels=3,
    remaining=1.05,
    remaining_of_signal=0.01,
)
QUIET = replace(
    CLEAR, visible=1.03, gap=0.05, of_signal=0.01, shrinkage=0.01, sure=0.5, missing=0.02
)
FOREIGN = replace(CLEAR, left=0.98, shrinkage=0.01, sure=0.8, unexplained=28.0, remaining=5.9)


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Rules do not depend on what was learnt from which cases."""
    monkeypatch.setattr(decision, "calibration", lambda: PLAIN)
    yield


@pytest.mark.usefixtures("plain")
def test_the_words_follow_from_causes_and_remainder() -> None:
    found = decide(GAP, SILENT, [FRICTION], [FRICTION])
    assert (found.verdict, found.named, found.known) == ("explained", (FRICTION.effect,), 0.97)
    assert not found.remainder_real and found.gap > 0.99 > 0.01 > found.remainder
    found = decide(GAP, GAP, [FRICTION, LEAK])
    assert (found.verdict, found.named) == ("partly-explained", (FRICTION.effect, LEAK.effect))
    assert found.remainder_real
    unlikely = replace(FRICTION, probability=0.2)
    found = decide(GAP, GAP, [unlikely], [unlikely])
    assert (found.verdict, found.named, found.known) == ("unknown-effect", (), 0.2)
    assert decide(SILENT, SILENT, [unlikely], [unlikely]).verdict == "no-structural-gap"
    assert decide(SILENT, SILENT, []).verdict == "no-structural-gap"


@pytest.mark.usefixtures("plain")
def test_no_cause_is_named_where_hardly_more_than_the_floor_is_left() -> None:
    """However probable: some effect always takes a part of next to nothing off."""
    for before, word in ((1.09, "no-structural-gap"), (1.11, "explained")):
        found = decide(replace(GAP, floors=before), SILENT, [FRICTION], [FRICTION], [FRICTION])
        assert (found.verdict, bool(found.named)) == (word, word == "explained")


@pytest.mark.usefixtures("plain")
@pytest.mark.parametrize(("second", "verdict"), [(0.2, "ambiguous"), (0.1, "unknown-effect")])
def test_what_is_improbable_beside_the_first_does_not_make_the_two_probable(
    second: float, verdict: str
) -> None:
    first, other = replace(FRICTION, probability=0.45), replace(LEAK, probability=second)
    assert decide(GAP, GAP, [first], [], [first, other]).verdict == verdict


def test_a_gap_between_none_and_real_stays_open(monkeypatch: pytest.MonkeyPatch) -> None:
    """More probable than not, and less than what is called real: neither is said."""
    surer = replace(PLAIN.lines["missing"], yes=0.95)
    strict = replace(PLAIN, lines={**PLAIN.lines, "missing": surer})
    monkeypatch.setattr(decision, "calibration", lambda: strict)
    features = {f: replace(GAP, missing=f) for f in (0.2, 1.1, 30.0)}
    chances = {f: surer.probability(one.features()) for f, one in features.items()}
    unlikely = replace(FRICTION, probability=0.4)
    words = {f: decide(one, one, [unlikely], [unlikely]) for f, one in features.items()}
    told = {
        f: "unknown-effect" if p >= 0.95 else "cannot-tell" if p > 0.5 else "no-structural-gap"
        for f, p in chances.items()
    }
    assert {f: d.verdict for f, d in words.items()} == told and len(set(told.values())) == 3
    (still_open,) = (d for d in words.values() if d.verdict == "cannot-tell")
    assert (still_open.named, still_open.why, still_open.gap_real) == ((), "open", False)
    near = replace(features[1.1], floors=1.05)
    assert decide(near, near, [unlikely]).verdict == "no-structural-gap", "at the noise floor"


@pytest.mark.usefixtures("plain")
def test_families_that_tie_are_ambiguous_where_one_of_them_is_probable() -> None:
    halves = [replace(FRICTION, probability=0.45), replace(LEAK, probability=0.4)]
    found = decide(GAP, SILENT, halves[:1], halves)
    assert (found.verdict, found.known) == ("ambiguous", pytest.approx(0.85))
    assert found.named == (FRICTION.effect, LEAK.effect)
    few = [replace(one, probability=0.1) for one in halves]
    assert decide(GAP, GAP, few[:1], few).verdict == "unknown-effect"
    slight = [replace(FRICTION, probability=0.8), replace(LEAK, probability=0.1)]
    assert decide(GAP, SILENT, slight[:1], slight).named == (FRICTION.effect,)
    behind = [replace(FRICTION, probability=0.1), replace(LEAK, probability=0.8)]
    assert len(decide(GAP, SILENT, behind[:1], behind).named) == 2, "the best model's own stays"
    twins = [FRICTION, replace(FRICTION, effect="lugre-friction")]
    assert decide(GAP, SILENT, twins[:1], twins).verdict == "explained", "of one family"


@pytest.mark.usefixtures("plain")
def test_families_that_are_probable_together_are_named_together() -> None:
    """One of them is there more probably than not, though none is by itself."""
    drag = replace(FRICTION, effect="quadratic-drag", family="drag", probability=0.1)
    one, other = replace(FRICTION, probability=0.3), replace(LEAK, probability=0.25)
    rivals = [drag, other, one]
    found = decide(GAP, SILENT, [one], [], rivals)
    assert (found.verdict, found.known) == ("ambiguous", pytest.approx(0.55))
    assert found.named == (one.effect, other.effect), "the most probable first, no more than needed"
    assert decide(SILENT, SILENT, [one], [], rivals).verdict == "no-structural-gap"
    few = [replace(r, probability=0.12) for r in rivals]
    assert decide(GAP, GAP, few[:1], [], few).verdict == "unknown-effect"
    held = [replace(other, at_bound=("level",)), one, drag]
    assert decide(GAP, GAP, [one], [], held).verdict == "unknown-effect"
    plain = decide(GAP, SILENT, [FRICTION], [], [FRICTION, other])
    assert plain.verdict == "explained", "a probable cause needs no company"


@pytest.mark.usefixtures("plain")
@pytest.mark.parametrize(
    ("against", "why"),
    [
        ({"removes": Share(0.3, -0.1, 0.6)}, "goes through zero"),
        ({"removes": Share(0.01, 0.005, 0.02)}, "next to nothing"),
        ({"at_bound": ("torque_n_m",)}, "torque_n_m ended at a bound"),
        ({"vanished": ("torque_n_m",)}, "torque_n_m ended at nothing"),
        ({"again": ("drag_n_s_per_m",)}, "does what drag_n_s_per_m of the rig does"),
        ({"here": 0.001, "removes": Share(0.45, 0.3, 0.6)}, "enters at its port"),
    ],
)
def test_no_probability_names_a_cause_that_something_speaks_against(
    against: dict[str, Any], why: str
) -> None:
    bad = replace(FRICTION, probability=0.999, **against)
    assert any(why in one for one in bad.objections()) and not FRICTION.objections()
    assert FRICTION.effect not in decide(GAP, SILENT, [bad], [bad]).named
    beside = decide(GAP, SILENT, [bad, LEAK])
    assert beside.named == (LEAK.effect,), "what stands beside it stays"
    assert decide(SILENT, SILENT, [bad], [bad]).verdict == "no-structural-gap"


@pytest.mark.usefixtures("plain")
def test_a_probable_cause_that_the_held_out_windows_do_not_back_wants_more_data() -> None:
    unsure = replace(FRICTION, removes=Share(0.41, -0.1, 0.7))
    found = decide(GAP, SILENT, [unsure], [unsure])
    assert (found.verdict, found.named, found.why) == ("cannot-tell", (), "few")
    improbable = replace(unsure, probability=0.2)
    assert decide(GAP, SILENT, [improbable], [improbable]).verdict == "unknown-effect"


@pytest.mark.usefixtures("plain")
def test_nothing_is_blamed_for_recordings_that_show_nothing_of_the_model() -> None:
    for before in (GAP, SILENT):
        for tied in ([FRICTION], [FRICTION, LEAK]):
            found = decide(before, SILENT, [FRICTION], tied, doubt="empty")
            assert (found.verdict, found.named, found.why) == ("cannot-tell", (), "empty")


def test_held_out_windows_back_a_cause_or_do_not() -> None:
    """Sixteen windows; losses of the refitted model are 1 to 2, the floor is at 0.2."""
    before = np.random.default_rng(2).uniform(1.0, 2.0, (16, 1))
    stands = cast(Any, SimpleNamespace)
    ones = np.ones((16, 1))
    budget = Budget(stands(), stands(absolutes=before), before, 0.2 * ones, before)

    def backs(after: Array) -> bool:
        share = gap_share(budget, before, after, 0)
        own = replace(FRICTION, removes=share)
        return not own.objections()

    assert backs(0.6 * before) and backs(
        np.where(np.arange(16)[:, None] % 5 == 0, 1.1, 0.6) * before
    )
    assert not backs(0.99 * before), "next to nothing"
    few = np.where(np.arange(16)[:, None] == 3, 0.01, 1.02) * before
    assert not backs(few), "one window makes the whole difference"


def test_the_share_of_the_gap_is_that_above_the_floor() -> None:
    """Half of an error of 2 floors is all that is above the floor; what is left is the rest."""
    stands = cast(Any, SimpleNamespace)
    floor = np.ones((8, 1))
    budget = Budget(stands(), stands(absolutes=2.0 * floor), floor, floor, floor)
    whole = gap_share(budget, 2.0 * floor, 1.0 * floor, 0)
    assert (whole.share, whole.rest.share) == (pytest.approx(1.0), pytest.approx(0.0))
    half = gap_share(budget, 2.0 * floor, 1.5 * floor, 0)
    assert half.share == half.low == half.high == pytest.approx(0.5)
    beside = gap_share(budget, 1.75 * floor, 1.5 * floor, 0)
    assert beside.share == pytest.approx(0.25), "beside what another removes"
    rest = Share(0.64, 0.58, 0.7).rest
    assert (rest.share, rest.low, rest.high) == pytest.approx((0.36, 0.3, 0.42))
    none = Budget(stands(), stands(absolutes=floor), floor, floor, floor)
    found = gap_share(none, floor, floor, 0)
    assert (found.share, found.low, found.high) == (0.0, -1.0, 1.0), "no gap, no share of it"


def test_a_p_value_counts_the_silent_cases_that_reach_as_much() -> None:
    assert [PLAIN.p_value(p) for p in (0.5, 0.4, 0.1, 0.02, 0.0)] == pytest.approx(
        [1 / 6, 2 / 6, 3 / 6, 5 / 6, 1.0]
    )


def test_features_stay_within_what_the_trial_has_seen() -> None:
    """Whatever a rig brings, no feature runs away with a probability."""
    x = LeftOver(1e6, 50.0, 1e9, 1e4, -7.0, 3.0).features()
    assert x == {
        "floors": 2.0,
        "of_signal": 0.0,
        "missing": 3.0,
        "next_sure": 2.0,
        "next_removes": -0.2,
        "network": 1.0,
        "network_of_error": 0.99,
        "stated": 0.0,
    }
    lines = calibration().lines
    assert set(lines) == set(QUESTIONS) and set(lines["missing"].weights) <= set(x)
    wild = replace(
        SPEAKING, removed=9.0, of_left=-3.0, sure=1e4, lead_sure=-1e4, left=7.0, remaining=1e9
    ).features()
    assert set(lines["cause"].weights) <= set(wild)
    assert (wild["removed"], wild["of_left"], wild["sure"]) == (1.0, -0.2, 2.0)
    assert (wild["lead_sure"], wild["left"], wild["remaining"]) == (-2.0, 1.2, 2.0)
    odd = replace(ADDED, removed=-3.0, gain=1e3, sure=1e4, margin=-1.0, unexplained=1e9).features()
    assert set(lines["further"].weights) <= set(odd)
    assert (odd["removed"], odd["gain"], odd["sure"], odd["margin"]) == (-3.0, 2.0, 2.0, 0.0)


def test_what_a_network_takes_of_next_to_nothing_counts_for_little() -> None:
    near, far = (replace(GAP, floors=f, network=0.7).features() for f in (1.1, 10.0))
    assert near["network"] == far["network"] == 0.7
    assert near["network_of_error"] == pytest.approx(0.7 * 0.1 / 1.1)
    assert far["network_of_error"] == pytest.approx(0.63)


def test_forecasts_are_wider_than_the_windows_alone() -> None:
    random = np.random.default_rng(0)
    before = random.uniform(1.0, 2.0, 12)
    after = 0.3 * before * random.uniform(0.8, 1.2, 12)
    low, high = shrinkage_interval(before, after)
    wide = forecast_interval(before, after)
    assert wide[0] < low < 1.0 - after.sum() / before.sum() < high < wide[1] < 1.0
    ratio = 1.0 - after.sum() / before.sum()
    reach = np.log((1.0 - wide[0]) / (1.0 - ratio))
    own = np.log((1.0 - low) / (1.0 - ratio))
    assert reach == pytest.approx(np.hypot(own, calibration().spread * np.sqrt(ratio)))
    assert forecast_interval(before[:1], after[:1]) == (-1.0, 1.0)


def _case(
    number: int, stratum: str, grounds: VerdictStatistics | None, right: bool
) -> tuple[dict[str, Any], dict[str, Any]]:
    planted = {
        "fault": "leak",
        "family": "leak",
        "port": "pressure",
        "exact": ["leak"] if stratum == "single" else [],
    }
    truth = [] if stratum == "no-gap" else [planted]
    label = {
        "number": number,
        "part": "calibration",
        "stratum": stratum,
        "truth": truth,
        "conditions": {},
    }
    first = {
        "effect": "leak" if right else "gravity",
        "family": "leak" if right else "gravity",
        "port": "pressure" if right else "joint",
        "probability": 0.0,
        "signature": vars(SPEAKING if right else SPEECHLESS),
    }
    result = {
        "case": number,
        "failed": None,
        "visibility": 3.0 if truth else None,
        "visibility_each": 3.0 if truth else None,
        "shrinkage": None,
        "diagnosis": {
            "grounds": vars(grounds) if grounds else None,
            "ranking": [first] if grounds else [],
            "members": [first] if grounds else [],
            "look_alikes": [],
            "causes": [],
            "verdict": "explained",
            "where": {},
            "further": [vars(ADDED if right else NEEDLESS)] if truth else [],
        },
    }
    return label, result


def test_calibration_learns_what_the_labels_say() -> None:
    """Sixty cases drawn around three plain ones: the lines fitted to them tell them apart."""
    random = np.random.default_rng(1)

    def near(g: VerdictStatistics) -> VerdictStatistics:
        return replace(
            g,
            visible=g.visible * random.uniform(0.9, 1.2),
            missing=g.missing * random.uniform(0.5, 2.0),
            unexplained=g.unexplained * random.uniform(0.5, 2.0),
            sure=g.sure * random.uniform(0.5, 1.5),
        )

    cases = [
        _case(3 * i + k, stratum, near(g), right)
        for i in range(20)
        for k, (stratum, g, right) in enumerate(
            (("single", CLEAR, True), ("withheld", FOREIGN, False), ("no-gap", QUIET, False))
        )
    ]
    cases.append(_case(60, "no-gap", None, False))
    one = lesson(
        [c[0] for c in cases], [c[1] for c in cases], machine="one-dof", seed=0, digest="abc"
    )
    found = calibration_json([one])
    assert (found["cases"]["part"], found["cases"]["used"]) == ("calibration", 61)
    assert found["cases"]["machines"] == [
        {"rig": "one-dof", "seed": 0, "sha256": "abc", "used": 61}
    ]
    lines = {q: Line(**line) for q, line in found["lines"].items()}
    missing, cause, further = (lines[q] for q in QUESTIONS)
    steps = [NEEDLESS]
    assert missing.probability(QUIET.before.features()) < missing.yes
    assert missing.probability(CLEAR.before.features()) > missing.yes
    assert missing.probability(CLEAR.after(steps).features()) < missing.yes, "nothing is left"
    assert missing.probability(FOREIGN.before.features()) > missing.yes
    assert cause.probability(SPEECHLESS.features()) < 0.2 < 0.5 <= cause.yes
    assert cause.probability(SPEAKING.features()) > max(cause.yes, 0.8)
    assert (
        further.probability(NEEDLESS.features()) < 0.2 < 0.8 < further.probability(ADDED.features())
    )
    assert found["silent"] == sorted(found["silent"]) and found["silent"][0] == 0.0


def test_the_test_part_teaches_nothing() -> None:
    label, result = _case(0, "single", CLEAR, True)
    with pytest.raises(DataError, match="calibration part"):
        lesson([{**label, "part": "test"}], [result], machine="one-dof", seed=0, digest="")


def test_the_shipped_calibration_names_its_cases() -> None:
    c = calibration()
    assert (
        c.cases["part"] == TRIAL_PARTS[0]
        and c.cases["used"] >= 100
        and len(c.cases["sha256"]) == 64
    )
    assert all(0.0 < line.yes < 1.0 for line in c.lines.values())
    assert list(c.silent) == sorted(c.silent) and c.spread >= 0.0


def test_plain_evidence_is_not_overruled_and_nothing_at_the_floor_is_real() -> None:
    """A line that says no to everything: only what no tolerance leaves is a gap."""
    rough = LeftOver(
        floors=12.0, of_signal=0.01, missing=59.0, next_sure=0.0, next_removes=0.0, network=0.0
    )
    plain = replace(rough, missing=2.0 * DEFAULT.plain_missing)
    assert not is_real(0.0, rough, DEFAULT) and is_real(0.0, plain, DEFAULT)
    assert not is_real(1.0, replace(plain, floors=1.05), DEFAULT)


def test_the_line_does_not_overrule_what_fitted_and_held_out_data_say(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A slight effect beside a strong one: little of the gap, much of what was left, and nothing
    else would have taken it; a line that finds it improbable."""
    yes = 0.5
    wary = replace(PLAIN, lines={**PLAIN.lines, "cause": Line(-5.0, {"sure": 1.0}, yes)})
    monkeypatch.setattr("pamid.diagnosis.signature.calibration", lambda: wary)
    slight = replace(SPEAKING, removed=0.05, of_left=0.6, steady=0.6, remaining=4.0)
    assert wary.lines["cause"].probability(slight.features()) < yes
    assert cause_probability(slight) == yes
    for doubt in ({"evidence_lead": 4.0}, {"sure": 4.0}, {"lead_sure": 4.0}):
        assert cause_probability(replace(slight, **doubt)) < yes
    # where nothing but noise is left there is nothing else to tell it from
    assert cause_probability(replace(slight, remaining=1.0, evidence_lead=-4.0)) == yes


def test_of_effects_that_cannot_be_told_apart_the_most_probable_comes_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What they remove is alike: the order of the ranking says nothing."""

    def one(label: str, probability: float) -> Any:
        return label, SimpleNamespace(effect=SimpleNamespace(label=label), probability=probability)

    tied = [one("lugre-friction", 0.46), one("bouc-wen-hysteresis", 0.66), one("play", 0.9)]
    chosen = SimpleNamespace(named=("lugre-friction", "bouc-wen-hysteresis"))
    d: Any = SimpleNamespace(
        verdict="ambiguous", cause=object(), judged=SimpleNamespace(tied=tied, decision=chosen)
    )
    monkeypatch.setattr(verdict, "_cause", lambda model, member, share: (model, share))
    assert verdict._causes(d) == (("bouc-wen-hysteresis", 0.5), ("lugre-friction", 0.5))
