"""The joint with on-off valves: what is averaged is what pulses would let through."""

from types import SimpleNamespace

import numpy as np
import pytest

from pamid.api.options.names import entries
from pamid.engine.program import Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.symbolic.expression import expression
from pamid.model.assembly import Assembly
from pamid.model.registry import catalogue_rig, rigs
from pamid.rigs.switched_joint import EDGE, SwitchedJoint

T_ON, T_OFF, PERIOD = 2e-3, 1e-3, 30e-3
P = SimpleNamespace(
    opening_delay=expression(T_ON),
    closing_delay=expression(T_OFF),
    pulse_period=expression(PERIOD),
)


def pulsed(duty: float, periods: int = 40, step_s: float = 2e-5) -> float:
    """Share of the time that a solenoid is open, pulse by pulse: it opens T_ON after its coil was
    switched on without a pause, and shuts T_OFF after it was switched off."""
    n, is_open, since, open_steps, was = round(PERIOD / step_s), False, 0.0, 0, False
    for k in range(periods * n):
        on = (k % n) < round(duty * n)
        since = since + step_s if on == was else 0.0
        was = on
        if on and since >= T_ON - 1e-9:
            is_open = True
        if not on and since >= T_OFF - 1e-9:
            is_open = False
        open_steps += is_open and k >= n  # the first period begins shut
    return open_steps / ((periods - 1) * n)


def opened(command: float) -> float:
    return float(SwitchedJoint().opened(expression(command), P).value)


@pytest.mark.parametrize("duty", [0.0, 0.03, 0.1, 0.25, 0.5, 0.9, 0.985, 1.0])
def test_average_of_the_pulses(duty):
    """Away from the two edges, where it is spread."""
    assert opened(duty) == pytest.approx(pulsed(duty), abs=3e-3)
    assert opened(-duty) == -opened(duty)


def test_edge_is_where_the_solenoid_begins_to_open():
    edge = T_ON / PERIOD
    assert opened(edge) == 0.0
    assert opened(edge + EDGE) == pytest.approx(EDGE + T_OFF / PERIOD, abs=1e-12)
    assert opened(1.7) == 1.0


def test_listed_and_the_joint_where_nothing_is_late():
    assert "switched-joint" in rigs() and "switched-joint" in entries("rigs")
    found = {}
    at_once = {"opening_delay_ms": 0.0, "closing_delay_ms": 0.0}
    for name, known in (("one-dof", {}), ("switched-joint", at_once), ("switched-joint ", {})):
        a = Assembly(catalogue_rig(name.strip()), sensitive=frozenset())
        p = a.values(known)
        u = np.zeros((400, len(a.traced.inputs)))
        u[:, 0] = 0.05 * np.sign(np.sin(np.arange(400) / 30.0))
        memory = a.program.memory(a.start(p), period_s=0.003)
        found[name] = a.program.run(memory, SampledInputs(u, 0.003), p, stepping=Stepping(2))[0]
    plain = found["one-dof"]
    scale = np.ptp(plain, axis=0)
    np.testing.assert_allclose(found["switched-joint"] / scale, plain / scale, rtol=0, atol=1e-9)
    # a duty of 5 % is a pulse of 1.5 ms: shorter than the solenoid needs
    assert np.ptp(found["switched-joint "][:, 0]) < 1e-9 < np.ptp(plain[:, 0])
