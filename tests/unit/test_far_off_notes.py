"""Notes on parameters and background terms that a fit has moved far."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.model.background import Gain
from pamid.verdict import notes


def test_a_background_that_stands_far_off_is_named_with_what_looks_like_it() -> None:
    def told(settings: Settings) -> list[str]:
        return notes._background(pulled(settings))

    (found,) = told(DEFAULT)
    assert found == (
        "Background force_map_1 stands at 3.0 tolerances: length-asymmetry (with it 2.0) or "
        "force-asymmetry (with it 2.4) would look like this."
    )
    assert told(Settings(far_off=3.1)) == []
    assert len(told(Settings(far_off=1.0))) == 2, "force_map_2 stands at 1.2"


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
