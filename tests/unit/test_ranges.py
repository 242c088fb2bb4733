"""Parameters of an effect that ended at nothing, or at a bound."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pamid.diagnosis import ranges
from pamid.effects.maxwell_slip_hysteresis import MaxwellSlipHysteresis


def test_an_effect_has_vanished_where_all_its_amounts_are_at_nothing():
    def given(owner, name, null):
        return SimpleNamespace(owner=owner, name=name, null=null, key=f"{owner}:{name}")

    parameters = [given("", "mass", None), given("slip", "forth", 0.0), given("slip", "back", 0.0)]
    parameters.append(given("slip", "reach", None))
    assembly = SimpleNamespace(parameters=parameters)

    def gone(*values, defining=()):
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


@pytest.mark.parametrize(("end", "families"), [("low", {"reach_m": "friction"}), ("", {})])
def test_hysteresis_that_slips_at_once_is_friction(end, families, monkeypatch):
    level, reach = (
        SimpleNamespace(owner="slip", key=f"slip:{name}", name=f"{name}_m")
        for name in ("level", "reach")
    )
    ended = {id(b): SimpleNamespace(at_bound=at) for b, at in ((level, "low"), (reach, end))}
    estimates = SimpleNamespace(items=lambda: [(b, ended[id(b)]) for b in (level, reach)])
    monkeypatch.setattr(ranges, "estimates", lambda fitted: estimates)
    slip: Any = SimpleNamespace(label="slip", effect=MaxwellSlipHysteresis())
    model: Any = SimpleNamespace(fit=None)
    assert ranges.at_limits(model, slip) == families
