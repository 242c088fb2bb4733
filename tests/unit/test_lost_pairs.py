"""Where a pair of the trial was lost: the first gate that one of the two did not pass."""

from __future__ import annotations

from typing import Any

import pytest

from pamid.trial.figure_table import trial_text
from pamid.trial.lost_pairs import PAIR_GATES, lost_at
from pamid.trial.marking import Marked
from pamid.trial.scoring import score_cases

FRICTION = {"fault": "stribeck-friction", "family": "friction", "port": "joint", "exact": []}
PLAY = {"fault": "backlash", "family": "play", "port": "structure", "exact": []}
CONDITIONS = {"background": 0.0, "channels": "all", "loop": "closed", "noise": 1.0}


def step(*tried: tuple[str, ...], taken: bool = True, closed: tuple[str, ...] = ()) -> Any:
    return {"tried": tried, "closed": closed, "taken": taken}


def result(
    *further: Any,
    alone: tuple[str, ...] = ("friction", "leak"),
    causes: tuple[str, ...] = (),
    each: float = 2.0,
    number: int = 0,
) -> dict[str, Any]:
    return {
        "case": number,
        "failed": None,
        "visibility": 3.0,
        "visibility_each": each,
        "seconds": 1.0,
        "shrinkage": None,
        "screened_family": "friction",
        "diagnosis": {
            "verdict": "explained" if causes else "unknown-effect",
            "causes": [
                {"effect": c, "family": c, "port": "joint", "probability": 0.9} for c in causes
            ],
            "ranking": [
                {"effect": a, "family": a, "port": "joint", "probability": 0.1} for a in alone
            ],
            "where": {"port": "joint", "indistinguishable": []},
            "look_alikes": [],
            "further": list(further),
        },
    }


BOTH, OTHER = ("friction", "play"), ("friction", "leak")
LOST = {
    "unseen": result(step(OTHER), causes=("friction",), each=1.02),
    "nothing-sought": result(causes=("friction",)),
    "screen": result(step(OTHER, taken=False), causes=("friction",)),
    "ports": result(
        step(OTHER, closed=("play",)), causes=("friction",), alone=("friction", "play")
    ),
    "refits": result(step(OTHER), causes=("friction",), alone=("friction", "play")),
    "losses": result(step(OTHER, BOTH), causes=("friction", "leak")),
    "further": result(step(BOTH, OTHER, taken=False), causes=("friction",)),
    "verdict": result(step(BOTH, OTHER)),
}


@pytest.mark.parametrize("gate", PAIR_GATES)
def test_each_gate(gate: str) -> None:
    assert lost_at(Marked({"truth": [FRICTION, PLAY]}, LOST[gate])) == gate


def test_nothing_was_lost() -> None:
    named = result(step(BOTH), causes=BOTH)
    assert lost_at(Marked({"truth": [FRICTION, PLAY]}, named)) == ""
    assert lost_at(Marked({"truth": [FRICTION]}, result())) == "", "one planted"
    three = result(step(OTHER), step((*OTHER, "play"), taken=False), causes=("friction",))
    assert lost_at(Marked({"truth": [FRICTION, PLAY]}, three)) == "further"


def test_a_file_that_does_not_tell_what_was_tried() -> None:
    old = result({"taken": True}, causes=("friction",), alone=BOTH)
    assert lost_at(Marked({"truth": [FRICTION, PLAY]}, old)) == "refits"


def test_the_trial_counts_them_and_shows_them() -> None:
    results = [
        {**LOST["further"], "case": 0},
        {**LOST["further"], "case": 1},
        {**LOST["unseen"], "case": 2},
        {**result(step(BOTH), causes=BOTH), "case": 3},
    ]
    labels = [
        {"number": i, "stratum": "double", "truth": [FRICTION, PLAY], "conditions": CONDITIONS}
        for i in range(4)
    ]
    found = score_cases(labels, results)
    assert found.lost_pairs == {"unseen": 1, "further": 2}
    text = trial_text(found.as_json())
    assert f"    2  {PAIR_GATES['further']}" in text and f"    1  {PAIR_GATES['unseen']}" in text
