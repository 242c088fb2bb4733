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
from pamid.model.bound_parameter import Bound
from pamid.schemas.estimates import Estimate


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


def bound(owner: str, name: str, **more: Any) -> Bound:
    """A parameter of an effect between 2 and 8, known within a factor."""
    stated: dict[str, Any] = dict(
        key=f"{owner}:{name}", owner=owner, name=name, unit="", factor=1.0, value=4.0, low=2.0,
        high=8.0, spread=1.0, log=True, null=None, fitted=True, tries=(), source="", sized=True,
    )  # fmt: skip
    return Bound(**(stated | more))


def ended(at_bound: str | None) -> Estimate:
    return Estimate(value=4.0, low=2.0, high=8.0, unit="", word="weak", at_bound=at_bound)


@pytest.mark.parametrize(
    ("log", "softens", "end", "pressed"),
    [
        (True, False, "high", True),
        # of a factor: as little of it as the equation can be solved with
        (True, False, "low", False),
        # less of it is no harder to solve: a guess at either end
        (True, True, "low", True),
        (False, False, "low", True),
    ],
)
def test_how_hard_a_fit_presses_against_a_bound(
    log: bool, softens: bool, end: str, pressed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    gap = bound("play", "gap", log=log, softens=softens)
    monkeypatch.setattr(ranges, "estimates", lambda fitted: {gap: ended(end)})
    fitted = SimpleNamespace(
        residuals=(np.zeros(1),), held=np.array([5.0]), problem=SimpleNamespace(free=(0,))
    )
    assembly = SimpleNamespace(attachments=(SimpleNamespace(label="play"),))
    model: Any = SimpleNamespace(assembly=assembly, fit=fitted)
    assert ranges.at_bounds(model) == (("gap",) if pressed else ())
    assert ranges.at_bounds(model, Settings(pressed=6.0)) == ()


@pytest.mark.parametrize(("end", "families"), [("low", {"reach_m": "friction"}), (None, {})])
def test_hysteresis_that_slips_at_once_is_friction(
    end: str | None, families: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    level = bound("slip", "level_m", key="slip:level")
    reach = bound("slip", "reach_m", key="slip:reach")
    ends = {level: ended("low"), reach: ended(end)}
    monkeypatch.setattr(ranges, "estimates", lambda fitted: ends)
    slip: Any = SimpleNamespace(label="slip", effect=MaxwellSlipHysteresis())
    model: Any = SimpleNamespace(fit=None)
    assert ranges.at_limits(model, slip) == families


@dataclass(frozen=True)
class Attached:
    """What `ranges` needs of an assembly."""

    attachments: tuple[Any, ...]
    ranges: dict[str, tuple[float, float]]


def test_ranges_are_widened_of_every_effect_and_below_where_that_is_softer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ends = {
        bound("spring", "frequency", softens=True): ended("low"),
        bound("spring", "drag"): ended("high"),
        bound("rub", "give"): ended("low"),
        bound("rub", "torque"): ended(None),
    }
    monkeypatch.setattr(ranges, "estimates", lambda fitted: ends)
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
