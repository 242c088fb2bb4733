"""What was once a number in the equations of a muscle is a parameter of every rig with muscles."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pamid.engine.program import Stepping
from pamid.model.assembly import Assembly
from pamid.model.registry import catalogue_rig, name_of
from pamid.model.rig import Rig
from pamid.rigs.muscle import LAWS, CoefficientLaw
from pamid.rigs.one_dof import OneDof
from pamid.symbolic.expression import expression

PERIOD_S = 0.003
VOLUME = ("volume_cubic_m3", "volume_quadratic_m3", "volume_linear_m3", "volume_at_rest_m3")


def outputs(rig: Rig, known: dict[str, float] | None = None) -> NDArray[np.float64]:
    """A second of the rig, whose first command swings."""
    a = Assembly(rig, sensitive=frozenset())
    p = a.values(known)
    u = np.zeros((333, len(a.traced.inputs)))
    u[:, 0] = 0.5 * np.sign(np.sin(np.arange(333) / 25.0))
    memory = a.program.memory(a.start(p), period_s=PERIOD_S)
    y, _, bad = a.program.run(memory, u, p, period_s=PERIOD_S, stepping=Stepping(2))
    assert bad == -1
    return y


@pytest.mark.parametrize("name", ["one-dof", "two-link"])
@pytest.mark.parametrize("law", LAWS)
def test_coefficients_of_the_law_are_held_parameters(name: str, law: str) -> None:
    rig = catalogue_rig(f"{name}:{law}")
    own = {p.name: p for p in rig.parameters}
    assert set(LAWS[law].parameters) <= set(rig.parameters)
    others = {p.name for other in LAWS if other != law for p in LAWS[other].parameters}
    assert not others & set(own)
    for p in LAWS[law].parameters:
        assert not p.fitted and p.source and p.low <= p.value <= p.high


def test_all_constants_stated_are_seen() -> None:
    """Every coefficient, and each of the volume's, moves the free run when [known] states another
    one."""
    for law in LAWS:
        rig = catalogue_rig(f"one-dof:{law}")
        begins = [{"initial_pressure_kpa": pressure} for pressure in (250.0, 550.0)]
        plain = [outputs(rig, known) for known in begins]
        asked = [p.outside_name for p in LAWS[law].parameters]
        asked += [*VOLUME, "temperature_ratio"] if law == "exponential" else []
        sheet = {p.outside_name: p.value for p in rig.parameters}
        for name in asked:
            moved = [outputs(rig, {**known, name: 1.05 * sheet[name]}) for known in begins]
            assert max(np.abs(y - y0).max() for y, y0 in zip(moved, plain, strict=True)) > 1e-6


def test_warmer_air_is_a_smaller_conductance() -> None:
    rig, ratio = OneDof(), 0.81
    c = {f"conductance_{way}_m3_per_s_pa": 3.777e-9 * ratio**0.5 for way in ("in", "out")}
    np.testing.assert_allclose(
        outputs(rig, {"temperature_ratio": ratio}), outputs(rig, c), rtol=1e-9, atol=1e-12
    )


def test_called_alone_a_law_has_its_data_sheet() -> None:
    value = LAWS["exponential"](expression(0.1), expression(4e5)).value
    wanted = (-15.3369 * 4 + 275.7318) * np.exp(-3.046) - 8.2115 * 40 + 268.3102 * 4 - 274.2475
    assert value == pytest.approx(wanted, rel=1e-12)


def test_another_law_brings_its_own_coefficients_and_no_others() -> None:
    rig = OneDof()
    double = replace(LAWS["three-element"].parameters[0], name="gain")
    rig.static_force = CoefficientLaw(lambda e, p, c: c.gain * p * (1.0 - 3.0 * e), (double,))
    assert [p.name for p in rig.parameters[-2:]] == ["volume_at_rest", "gain"]
    rig.static_force = lambda contraction, pressure: pressure * (1e-3 - contraction * 1e-3)
    assert rig.parameters == OneDof.parameters


def test_a_rig_that_has_travelled_is_still_known() -> None:
    travelled = pickle.loads(pickle.dumps(catalogue_rig("one-dof:polynomial")))
    assert name_of(travelled) == "one-dof:polynomial"
