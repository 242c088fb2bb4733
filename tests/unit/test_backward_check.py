"""Which effect of several is dropped again, and how wide ranges of a model beside another are."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pamid.diagnosis import forward_selection
from pamid.diagnosis.ranges import as_wide
from pamid.diagnosis.settings import DEFAULT

GAP = 100.0
DRAWS = np.random.default_rng(3).normal(size=200)


def dropped(
    monkeypatch: pytest.MonkeyPatch, left: float, without: dict[str, float], gain: float = 20.0
) -> str:
    """The effect that is dropped, "" for none: `left` is the excess with both, `without` those
    with either missing; gain: of the held-out log loss by it, in standard errors."""
    spring, gap = SimpleNamespace(label="spring"), SimpleNamespace(label="gap")

    def model(*attached: Any, excess: float) -> Any:
        return SimpleNamespace(attached=attached, excess=excess, finite=True)

    def losses(models: list[Any]) -> np.ndarray:
        worse = np.array([gain if len(m.attached) < 2 else 0.0 for m in models])
        return np.asarray(worse[:, None] + np.array([DRAWS / DRAWS.std(), 0.0 * DRAWS]))

    def refitted(search: Any, attached: Any, *found: Any) -> Any:
        missing = "gap" if attached == (spring,) else "spring"
        return model(*attached, excess=without[missing])

    monkeypatch.setattr(forward_selection, "refitted_with", refitted)
    search: Any = SimpleNamespace(
        settings=DEFAULT,
        budget=SimpleNamespace(baseline=model(excess=GAP)),
        excess=lambda c: c.excess,
        losses=losses,
    )
    both = model(spring, gap, excess=left)
    kept = forward_selection._backward_check(search, both).attached
    return "" if len(kept) == 2 else ("gap" if kept == (spring,) else "spring")


def test_what_costs_little_of_the_gap_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    assert dropped(monkeypatch, 10.0, {"spring": 60.0, "gap": 13.0}) == "gap"
    assert dropped(monkeypatch, 10.0, {"spring": 60.0, "gap": 16.0}) == ""


def test_what_surely_removes_a_quarter_of_the_rest_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    excess = {"spring": 60.0, "gap": 4.5}
    assert dropped(monkeypatch, 1.0, excess) == ""
    assert dropped(monkeypatch, 1.0, excess, gain=1.0) == "gap"  # it may be chance
    assert dropped(monkeypatch, 3.0, excess) == ""
    assert dropped(monkeypatch, 3.5, excess) == "gap"  # nearly all is left with it
    # however small in the gap
    assert dropped(monkeypatch, 0.1, {"spring": 60.0, "gap": 1.5}) == ""


@dataclass(frozen=True)
class Ranged:
    """What `as_wide` needs of an assembly."""

    keys: dict[str, int]
    ranges: dict[str, tuple[float, float]] = field(default_factory=dict)


def test_what_was_widened_stays_wide_in_a_model_that_has_it() -> None:
    pair: Any = Ranged({"spring:frequency": 0, "gap:width": 1}, {"gap:width": (0.0, 1.0)})
    alone: Any = Ranged({"spring:frequency": 0}, {"spring:frequency": (0.4, 9.0)})
    other: Any = Ranged({"rub:torque": 0}, {"rub:torque": (0.0, 4.0)})
    assert as_wide(pair, alone, other).ranges == {
        "gap:width": (0.0, 1.0),
        "spring:frequency": (0.4, 9.0),
    }
    assert as_wide(pair, other) is pair
