"""Which model stands for a family among those of which one may be there."""

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
    monkeypatch.setattr(judging, "cause_probability", lambda signature: signature)
    monkeypatch.setattr(judging, "at_bounds", lambda one, _: one.pressed)
    compared = SimpleNamespace(ranking=ranking, signatures=[one.probability for one in ranking])
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
