"""From grounds to a verdict: features, probabilities, intervals, and what calibration makes of
labelled cases."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from pamid.base.errors import DataError
from pamid.base.metrics import shrinkage_interval
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.decision import (
    Decision,
    Line,
    VerdictStatistics,
    calibration,
    decide,
    features,
    forecast_interval,
    is_confirmed,
    probabilities,
)
from pamid.diagnosis.forward_selection import ForwardStep
from pamid.trial.calibration import calibration_json
from pamid.trial.cases import TRIAL_PARTS

Array = NDArray[np.float64]

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
    unexplained=0.3,
    at_port=1.0,
    strain=1.0,
    pull=1.0,
    channels=3,
)
QUIET = replace(
    CLEAR,
    visible=1.03,
    gap=0.05,
    of_signal=0.01,
    shrinkage=0.01,
    sure=0.5,
    missing=0.02,
    left=0.9,
    margin=0.0,
    margin_sure=0.3,
    wins=0.4,
    unexplained=0.02,
)
FOREIGN = replace(
    CLEAR,
    left=0.98,
    shrinkage=0.01,
    sure=0.8,
    margin=0.01,
    margin_sure=0.5,
    wins=0.4,
    unexplained=28.0,
    at_port=0.6,
)


def test_the_three_plain_cases() -> None:
    assert decide(CLEAR, ambiguous=False).verdict == "explained"
    assert decide(CLEAR, ambiguous=True).verdict == "ambiguous"
    assert decide(FOREIGN, ambiguous=False).verdict == "unknown-effect"
    assert decide(QUIET, ambiguous=False).verdict == "no-structural-gap"
    assert decide(CLEAR, ambiguous=False).first > 0.9 > 0.2 > decide(FOREIGN, ambiguous=False).first


def test_a_cause_that_removes_next_to_nothing_is_not_named() -> None:
    assert decide(replace(CLEAR, shrinkage=0.01), ambiguous=False).verdict == "unknown-effect"


def test_a_cause_that_the_held_out_windows_do_not_back_is_not_named() -> None:
    found = decide(CLEAR, ambiguous=False, confirmed=False)
    assert found.verdict == "unknown-effect" and found.first <= found.known <= 0.5
    assert decide(QUIET, ambiguous=False, confirmed=False).verdict == "no-structural-gap"


def test_a_name_that_hangs_on_the_windows_is_no_more_than_even_odds() -> None:
    sure = decide(CLEAR, ambiguous=False)
    found = decide(CLEAR, ambiguous=True, steady=False)
    assert found.verdict == "ambiguous" and found.first <= 0.5 < sure.first
    # that something known is missing does not hang on its name
    assert (found.gap, found.known) == (sure.gap, sure.known)


def test_held_out_windows_back_a_cause_or_do_not() -> None:
    """Eight windows that chose and eight that report; losses of the refitted model are 1 to 2."""
    before = np.random.default_rng(2).uniform(1.0, 2.0, (16, 1))
    reporting = np.arange(16) % 4 > 1

    def backs(after: Array) -> bool:
        stands = cast(Any, SimpleNamespace)
        budget = Budget(stands(), stands(absolutes=before), before, np.ones((16, 1)), before)
        return is_confirmed(budget, stands(absolutes=after), reporting, 0)

    assert backs(0.6 * before) and backs(
        np.where(np.arange(16)[:, None] % 5 == 0, 1.1, 0.6) * before
    )
    assert not backs(np.where(reporting[:, None], 1.03, 0.3) * before), (
        "it shrinks only where it was chosen"
    )
    assert not backs(0.99 * before), "next to nothing"
    few = np.where(np.arange(16)[:, None] == 3, 0.01, 1.02) * before
    assert not backs(few), "one window makes the whole difference"


def test_nothing_is_blamed_for_recordings_that_show_nothing_of_the_model() -> None:
    for ambiguous in (False, True):
        found = decide(CLEAR, ambiguous=ambiguous, empty=True)
        assert (found.verdict, found.known, found.first) == ("unknown-effect", 0.0, 0.0)
    assert decide(QUIET, ambiguous=False, empty=True).verdict == "no-structural-gap"


def test_features_stay_within_what_the_trial_has_seen() -> None:
    """Whatever a rig brings, no feature runs away with a probability."""
    wild = replace(
        CLEAR, visible=1e6, missing=1e9, sure=1e4, margin_sure=1e4, strain=50.0, left=3.0, gap=1e6
    )
    x = features(wild)
    assert (x["visible"], x["missing"], x["sure"], x["left"]) == (2.0, 3.0, 2.0, 1.2)
    lines = calibration().lines
    assert set(x) >= {name for q, line in lines.items() if q != "further" for name in line.weights}
    odd = replace(ADDED, removed=-3.0, gain=1e3, sure=1e4, margin=-1.0, unexplained=1e9).features()
    assert set(odd) >= set(lines["further"].weights)
    assert (odd["removed"], odd["gain"], odd["sure"], odd["margin"]) == (-3.0, 2.0, 2.0, 0.0)


def test_probabilities_share_what_is_left() -> None:
    found = probabilities(Decision("explained", 0.99, 0.9, 0.6), [0.7, 0.2, 0.1])
    assert found[0] == 0.6
    assert sum(found) == pytest.approx(0.9)
    assert found[1] / found[2] == pytest.approx(0.201 / 0.101)
    assert probabilities(Decision("unknown-effect", 0.9, 0.1, 0.05), []) == []


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
    truth = (
        []
        if stratum == "no-gap"
        else [
            {
                "fault": "leak",
                "family": "leak",
                "port": "pressure",
                "exact": ["leak"] if stratum == "single" else [],
            }
        ]
    )
    top = "leak" if right else "gravity"
    label = {
        "number": number,
        "part": "calibration",
        "stratum": stratum,
        "truth": truth,
        "conditions": {},
    }
    ranking = [{"effect": top, "family": top, "port": "", "probability": 0.0}] if grounds else []
    result = {
        "case": number,
        "failed": None,
        "visibility": 3.0 if truth else None,
        "shrinkage": None,
        "diagnosis": {
            "grounds": vars(grounds) if grounds else None,
            "ranking": ranking,
            "look_alikes": [],
            "causes": [],
            "verdict": "explained",
            "where": {},
            "further": [vars(ADDED if right else NEEDLESS)] if truth else [],
        },
    }
    return label, result


def test_calibration_learns_what_the_labels_say() -> None:
    """Sixty cases drawn around the three plain ones: the lines fitted to them tell them apart."""
    random = np.random.default_rng(1)

    def near(g: VerdictStatistics) -> VerdictStatistics:
        return replace(
            g,
            visible=g.visible * random.uniform(0.9, 1.2),
            missing=g.missing * random.uniform(0.5, 2.0),
            sure=g.sure * random.uniform(0.5, 1.5),
            margin_sure=g.margin_sure * random.uniform(0.5, 1.5),
        )

    cases = [
        _case(3 * i + k, stratum, near(g), right)
        for i in range(20)
        for k, (stratum, g, right) in enumerate(
            (("single", CLEAR, True), ("withheld", FOREIGN, False), ("no-gap", QUIET, False))
        )
    ]
    cases.append(_case(60, "no-gap", None, False))
    found = calibration_json([c[0] for c in cases], [c[1] for c in cases], seed=0, digest="abc")
    assert found["cases"] == {"part": "calibration", "seed": 0, "sha256": "abc", "used": 60}

    def says(question: str, g: VerdictStatistics) -> float:
        line, x = found["lines"][question], features(g)
        return float(
            1.0 / (1.0 + np.exp(-line["bias"] - sum(w * x[k] for k, w in line["weights"].items())))
        )

    assert says("gap", QUIET) < found["lines"]["gap"]["yes"] < says("gap", CLEAR)
    assert says("known", FOREIGN) < found["lines"]["known"]["yes"] < says("known", CLEAR)
    assert says("first", CLEAR) > 0.8
    further = Line(**found["lines"]["further"])
    assert (
        further.probability(NEEDLESS.features()) < 0.2 < 0.8 < further.probability(ADDED.features())
    )


def test_the_test_part_teaches_nothing() -> None:
    label, result = _case(0, "single", CLEAR, True)
    with pytest.raises(DataError, match="calibration part"):
        calibration_json([{**label, "part": "test"}], [result], seed=0, digest="")


def test_the_shipped_calibration_names_its_cases() -> None:
    c = calibration()
    assert (
        c.cases["part"] == TRIAL_PARTS[0]
        and c.cases["used"] >= 100
        and len(c.cases["sha256"]) == 64
    )
    assert all(0.0 < line.yes < 1.0 for line in c.lines.values())
