"""Best subsets of what screened candidates change: found by inner products, bounded, one of every
combination of families."""

from itertools import combinations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from pamid.diagnosis.effect_subsets import ScreenedResponses, best_subsets
from pamid.diagnosis.settings import Settings

ROWS = 60
FAMILY = {"rub": "friction", "stick": "friction", "slip": "hysteresis", "late": "timing"}
FAMILY |= {"drift": "offset"}
EVERY = Settings(subsets=99, pair_share=0.0)


def responses(left: np.ndarray, columns: dict[str, np.ndarray]) -> ScreenedResponses:
    """Of candidates with these columns, the first of each its change; own parameters may move up
    alone."""
    screened: Any = [SimpleNamespace(added=SimpleNamespace(label=k, labels=(k,))) for k in columns]
    edges = np.cumsum([0, *(c.shape[1] for c in columns.values())]).tolist()
    everything = np.column_stack(list(columns.values()))
    return ScreenedResponses(
        screened,
        everything.T @ everything,
        everything.T @ left,
        np.array([[0.0, np.inf]] * everything.shape[1]),
        [range(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)],
    )


@pytest.fixture
def drawn() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """What is left is made by `slip` and `late`; `rub` does some of both by itself."""
    random = np.random.default_rng(5)
    columns = {k: 10.0 * random.normal(size=(ROWS, 2)) for k in FAMILY}
    columns["rub"][:, 0] = columns["slip"][:, 0] + columns["late"][:, 0]
    columns["rub"] += random.normal(size=(ROWS, 2))
    left = -columns["slip"][:, 0] - 0.6 * columns["late"][:, 0] + 0.1 * random.normal(size=ROWS)
    return left, columns


def family(a: Any) -> str:
    return FAMILY[a.label]


def test_the_pair_is_found_that_no_single_one_leads_to(drawn):
    found = responses(*drawn)
    alone = {k: found.gain([i]) for i, k in enumerate(FAMILY)}
    assert max(alone, key=lambda k: alone[k]) == "rub", "what a greedy path would begin with"
    assert best_subsets(found, family, 2)[0].labels == {"slip", "late"}


def test_every_combination_of_families_is_stood_for_by_its_best(drawn):
    found, labels = responses(*drawn), list(FAMILY)
    most: dict[frozenset[str], float] = {}
    for i, j in combinations(range(len(labels)), 2):
        names = frozenset((FAMILY[labels[i]], FAMILY[labels[j]]))
        most[names] = max(most.get(names, 0.0), found.gain((i, j)))
    alone = max(found.gain([i]) for i in range(len(labels)))
    pairs = best_subsets(found, family, 2, EVERY)
    assert [(frozenset(FAMILY[k] for k in p.labels), p.gain) for p in pairs] == sorted(
        ((names, g) for names, g in most.items() if len(names) == 2 and g > alone),
        key=lambda e: -e[1],
    )
    three = best_subsets(responses(*drawn), family, 3, EVERY)
    assert three and {len({FAMILY[k] for k in p.labels}) for p in three} == {3}
    assert three[0].labels > {"slip", "late"} and three[0].gain >= pairs[0].gain


def test_the_gain_is_that_of_bounded_least_squares(drawn):
    left, columns = drawn
    found, names = responses(left, columns), list(columns)
    for members in combinations(range(len(names)), 2):
        A = np.column_stack([columns[names[i]] for i in members])
        rows, b = np.concatenate([A, np.eye(4)]), np.concatenate([-left, np.zeros(4)])
        best = lsq_linear(rows, b, bounds=(0.0, np.inf), tol=1e-12)
        assert found.gain(members) == pytest.approx(left @ left - 2.0 * best.cost, rel=1e-6)


def test_what_would_have_to_act_the_other_way_round_gains_nothing():
    change = np.ones((ROWS, 1))
    assert responses(np.ones(ROWS), {"rub": change}).gain([0]) == 0.0
    assert responses(-np.ones(ROWS), {"rub": change}).gain([0]) > 0.9 * ROWS


def test_two_of_one_family_act_together_only_where_they_stand_apart():
    random = np.random.default_rng(8)
    at = {"gap@hip": "hip", "rattle@hip": "hip", "gap@knee": "knee", "late@hip": "hip"}
    columns = {k: 10.0 * random.normal(size=(ROWS, 2)) for k in at}
    # two laws of a gap at the hip would explain it best, the gaps at either joint nearly as well
    left = -columns["gap@hip"][:, 0] - columns["rattle@hip"][:, 0] - 0.8 * columns["gap@knee"][:, 0]
    found = responses(left, columns)

    def kind(a):
        return "timing" if a.label.startswith("late") else "gap"

    def apart(a, b):
        return at[a.label] != at[b.label]

    alone = best_subsets(found, kind, 2, EVERY)
    assert alone and all({kind(s.added) for s in p.members} == {"gap", "timing"} for p in alone)
    beside = best_subsets(found, kind, 2, EVERY, apart)
    assert "gap@knee" in beside[0].labels and len({at[k] for k in beside[0].labels}) == 2
    # one of every combination still, and those of two families are who they were
    assert [p for p in beside if p.labels == alone[0].labels] and len(beside) == len(alone) + 1
    assert all(p.labels != {"gap@hip", "rattle@hip"} for p in beside)
