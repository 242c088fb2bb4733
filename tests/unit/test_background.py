"""What every specimen differs by."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pamid.model.assembly import Assembly
from pamid.model.background import HALF_WARM, SmoothGain
from pamid.model.parameter import Parameter
from pamid.model.rig import Port, Rig
from pamid.simulation.free_runs import free_run
from pamid.symbolic.vocabulary import Number


def warming(warming_s: float | None, period_s: float) -> Assembly:
    """A reading of what is sent whose gain drifts; its recordings are 1000 samples long."""

    class Amplifier(Rig):
        """Volts in, volts out."""

        inputs = {"sent": ""}
        outputs = {"read": ""}
        ports = {"amplifier": Port("command", "", ("along",))}
        parameters = (Parameter("gain", 1.0, 0.1, 10.0, source="bench"),)
        background = {
            "amplifier": SmoothGain(
                "warmth", ("along", 0.0, 1.0), tolerance=0.1, drift=True, warming_s=warming_s
            )
        }

        def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
            return {}

        def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
            return {"read": p.gain * port("amplifier", u.sent, along=u.sent)}

    Amplifier.period_s = period_s
    return Assembly(Amplifier(), background=True, sizes={("", "time"): 1000.0 * period_s})


@pytest.mark.parametrize("period_s", [0.003, 4.0])
@pytest.mark.parametrize("warming_s", [None, 25.0])
def test_half_of_a_drift_is_there_when_it_is_said(warming_s: float | None, period_s: float) -> None:
    """At the time that the rig states, or at a share of the recordings, whatever their pace."""
    assembly = warming(warming_s, period_s)
    p = assembly.values({"background.warmth:drift": 0.1})
    y = free_run(assembly, np.ones((1000, 1)), p, period_s).outputs[:, 0]
    half = HALF_WARM * 1000.0 * period_s if warming_s is None else warming_s
    time = period_s * np.arange(1000)
    np.testing.assert_allclose(y, 1.0 + 0.1 * time / (time + half), rtol=1e-9)
    assert not [b for b in assembly.parameters if b.fitted and b.key.endswith("warming")]
