"""The arm whose muscles have force compensators: an option that leaves the plain arm as it is."""

import numpy as np
import pytest

from pamid.engine.program import Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.model.assembly import Assembly
from pamid.model.registry import catalogue_rig

STRETCHED = {"clamped_1": 1.0, "initial_angle_1_deg": -40.0}


def run(variant: str, **known: float) -> dict[str, np.ndarray]:
    """Outputs by name (SI) over 3 s at rest."""
    a = Assembly(catalogue_rig(variant), sensitive=frozenset())
    p = a.values(known)
    memory = a.program.memory(a.start(p), period_s=0.003)
    u = np.zeros((1000, len(a.program.inputs)))
    y, _, bad = a.program.run(memory, SampledInputs(u, 0.003), p, stepping=Stepping(4))
    assert bad == -1
    return dict(zip(a.rig.outputs, y.T, strict=True))


@pytest.mark.parametrize("law", ["exponential", "polynomial"])
def test_a_stretched_muscle_is_let_off_to_the_limit(law):
    """At -40 deg and 5.5 bar muscle 11 pulls with more than 1200 N; its compensator opens until it
    pulls no more than that, the other muscles keep their air."""
    plain = run(f"two-link:{law}", **STRETCHED)
    compensated = run(f"two-link:{law}-compensated", **STRETCHED)
    assert plain["force_11_n"].min() > 1250.0
    assert compensated["force_11_n"][0] == pytest.approx(plain["force_11_n"][0])
    assert compensated["force_11_n"][-1] == pytest.approx(1200.0, abs=5.0)
    assert compensated["pressure_11_kpa"][-1] < plain["pressure_11_kpa"][-1] - 20e3
    for i in ("12", "21", "22"):
        np.testing.assert_allclose(compensated[f"force_{i}_n"], plain[f"force_{i}_n"], rtol=1e-9)


def test_shut_it_is_the_plain_arm():
    plain = run("two-link", **STRETCHED)
    shut = run("two-link:exponential-compensated", compensator_opening=0.0, **STRETCHED)
    for name, values in plain.items():
        np.testing.assert_allclose(shut[name], values, rtol=1e-12, atol=1e-12)
