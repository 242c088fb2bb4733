"""What was once a number in the equations of a muscle is a parameter of every rig with muscles."""

from dataclasses import replace

import pytest

from pamid.model.registry import catalogue_rig
from pamid.rigs.muscle import LAWS, CoefficientLaw
from pamid.rigs.one_dof import OneDof


@pytest.mark.parametrize("name", ["one-dof", "two-link"])
@pytest.mark.parametrize("law", LAWS)
def test_coefficients_of_the_law_are_held_parameters(name, law):
    rig = catalogue_rig(f"{name}:{law}")
    own = {p.name: p for p in rig.parameters}
    assert set(LAWS[law].parameters) <= set(rig.parameters)
    others = {p.name for other in LAWS if other != law for p in LAWS[other].parameters}
    assert not others & set(own)
    for p in LAWS[law].parameters:
        assert not p.fitted and p.source and p.low <= p.value <= p.high


def test_another_law_brings_its_own_coefficients_and_no_others():
    rig = OneDof()
    double = replace(LAWS["three-element"].parameters[0], name="gain")
    rig.static_force = CoefficientLaw(lambda e, p, c: c.gain * p * (1.0 - 3.0 * e), (double,))
    assert [p.name for p in rig.parameters[-2:]] == ["volume_at_rest", "gain"]
    rig.static_force = lambda contraction, pressure: pressure * (1e-3 - contraction * 1e-3)
    assert rig.parameters == OneDof.parameters
