"""Which model stands for a family among those of which one may be there, and which one for the
best, of which not everything may be named."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pamid.diagnosis import judging
from pamid.diagnosis.settings import DEFAULT


@dataclass(frozen=True)
class Model:
    """A model of one effect, with the probability that its figures give it."""

    family: str
    probability: float
    pressed: bool = False
    attached: tuple[str, ...] = ("one",)


def stood_for(monkeypatch: pytest.MonkeyPatch, *ranking: Model) -> list[Model]:
    monkeypatch.setattr(judging, "at_bounds", lambda one, _: one.pressed)
    compared = SimpleNamespace(ranking=ranking, chances={one: one.probability for one in ranking})
    found = judging._most_probable_of_families(
        cast(Any, SimpleNamespace(settings=DEFAULT)), cast(Any, compared), cast(Any, ranking[0])
    )
    return cast(list[Model], found)


def test_the_most_probable_of_a_family_stands_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first of the ranking has a rival of its own family that is as good, and is less probable
    for it."""
    first, plain, other = Model("friction", 0.3), Model("friction", 0.4), Model("hysteresis", 0.2)
    assert stood_for(monkeypatch, first, other, plain) == [plain, other]


def test_one_that_is_pressed_against_a_bound_stands_back(monkeypatch: pytest.MonkeyPatch) -> None:
    pressed, free = Model("friction", 0.4, pressed=True), Model("friction", 0.3)
    assert stood_for(monkeypatch, pressed, free) == [free]
    assert stood_for(monkeypatch, pressed) == [pressed], "unless the family has no other"


def test_no_rivals_are_sought_among_several_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    assert stood_for(monkeypatch, Model("friction", 0.4, attached=("one", "other"))) == []


def weighed_up(verdict: str, named: str, attached: int) -> Any:
    """What is made of a best model with so many effects; named: one letter each."""
    return SimpleNamespace(
        best=SimpleNamespace(attached=range(attached)),
        decision=SimpleNamespace(verdict=verdict, named=tuple(named)),
    )


@pytest.mark.parametrize(
    ("before", "instead", "stands"),
    [
        (("explained", "a", 2), ("explained", "a", 1), True),
        # of a pair one may not be named, and the other is nothing by itself: a third would be named
        (("partly-explained", "a", 2), ("ambiguous", "bc", 1), False),
        (("partly-explained", "ab", 3), ("explained", "a", 2), False),
        (("unknown-effect", "", 2), ("explained", "a", 1), True),
        (("unknown-effect", "", 1), ("explained", "b", 1), True),
        (("explained", "a", 2), ("unknown-effect", "", 1), False),
        (("ambiguous", "ab", 1), ("explained", "a", 1), True),
    ],
)
def test_a_model_that_names_less_does_not_take_the_place_of_a_pair(
    before: tuple[str, str, int], instead: tuple[str, str, int], stands: bool
) -> None:
    assert judging._stands(weighed_up(*before), weighed_up(*instead)) is stands
