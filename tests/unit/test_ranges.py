"""Parameters of an effect that ended at nothing, or at a bound."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pamid.diagnosis import ranges
from pamid.diagnosis.settings import Settings
from pamid.effects.maxwell_slip_hysteresis import MaxwellSlipHysteresis


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


def test_hysteresis_that_slips_at_once_is_friction(monkeypatch: pytest.MonkeyPatch) -> None:
    bounds = [SimpleNamespace(key=f"slip:{name}", name=f"{name}_m") for name in ("level", "reach")]
    ends = [SimpleNamespace(bound=b, at_bound="low") for b in bounds]
    monkeypatch.setattr(ranges, "estimates", lambda fitted: ends)
    slip: Any = SimpleNamespace(label="slip", effect=MaxwellSlipHysteresis())
    model: Any = SimpleNamespace(fit=None)
    assert ranges.at_limits(model, slip) == {"reach_m": "friction"}
    ends[1].at_bound = ""
    assert ranges.at_limits(model, slip) == {}


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
    wider = ranges.widened(assembly, fit)
    assert wider is not None and wider.ranges == {
        "rub:torque": (0.0, 1.0),
        "spring:frequency": (0.5, 8.0),
        "spring:drag": (2.0, 32.0),
    }
    assert ranges.widened(Attached((rub,), {}), fit) is None  # type: ignore[arg-type]
