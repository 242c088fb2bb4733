"""What every specimen differs by."""

from typing import Any

import numpy as np
import pytest

from pamid.model.assembly import Assembly
from pamid.model.background import (
    BEYOND_SIZE,
    HALF_WARM,
    RoughMap,
    SmoothGain,
)
from pamid.model.parameter import Parameter
from pamid.model.port_guide import mapped_ports, tolerance_words
from pamid.model.registry import catalogue_rig, rigs
from pamid.model.rig import Port, Rig, check_rig
from pamid.simulation.free_runs import free_run


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

        def rates(self, x, u, p, port):
            return {}

        def measure(self, x, u, p, port):
            return {"read": p.gain * port("amplifier", u.sent, along=u.sent)}

    Amplifier.period_s = period_s
    return Assembly(Amplifier(), background=True, sizes={("", "time"): 1000.0 * period_s})


@pytest.mark.parametrize("period_s", [0.003, 4.0])
@pytest.mark.parametrize("warming_s", [None, 25.0])
def test_half_of_a_drift_is_there_when_it_is_said(warming_s, period_s):
    """At the time that the rig states, or at a share of the recordings, whatever their pace."""
    assembly = warming(warming_s, period_s)
    p = assembly.values({"background.warmth:drift": 0.1})
    y = free_run(assembly, np.ones((1000, 1)), p, period_s).outputs[:, 0]
    half = HALF_WARM * 1000.0 * period_s if warming_s is None else warming_s
    time = period_s * np.arange(1000)
    np.testing.assert_allclose(y, 1.0 + 0.1 * time / (time + half), rtol=1e-9)
    assert not [b for b in assembly.parameters if b.fitted and b.key.endswith("warming")]


def mapped(**options: Any) -> Assembly:
    """A force with a rough map over the way, read; the way is sent."""

    class Bench(Rig):
        """A way in, a force out."""

        inputs = {"way_mm": "m"}
        outputs = {"force_n": "N"}
        ports = {"rod": Port("motion", "N", {"position": "m", "load": "N"})}
        parameters = (Parameter("push", 40.0, 1.0, 100.0, "N", source="bench"),)
        background = {"rod": RoughMap("rail", "position", tolerance=0.02, **options)}

        def measure(self, x, u, p, port):
            return {"force_n": port("rod", p.push, position=u.way_mm, load=0.5 * p.push)}

    return Assembly(Bench(), background=True, sizes={("rod", "position"): 0.01})


@pytest.mark.parametrize(("options", "share"), [({}, 1.0), ({"of": "load"}, 0.5)])
def test_a_rough_map_is_as_rough_as_its_tolerance(options, share):
    """Drawn from its prior, it leaves its share of the value, root mean square over the range, and
    ends where the recordings do."""
    assembly = mapped(**options)
    waves = [i for i, b in enumerate(assembly.parameters) if b.nuisance and b.fitted]
    end = 0.01 * BEYOND_SIZE
    way = np.linspace(-2.0 * end, 2.0 * end, 801)[:, None]
    inside, random, found = np.abs(way[:, 0]) <= end, np.random.default_rng(3), []
    for _ in range(400):
        p = assembly.values()
        p[waves] = random.normal(0.0, [assembly.parameters[i].spread for i in waves])
        y = free_run(assembly, way, p, 0.01).outputs[:, 0]
        found.append(np.mean((y[inside] / 40.0 - 1.0) ** 2))
        assert np.ptp(y[way[:, 0] > 1.01 * end]) == 0.0
    assert np.sqrt(np.mean(found)) == pytest.approx(0.02 * share, rel=0.05)
    assert free_run(assembly, way, assembly.values(), 0.01).outputs[:, 0] == pytest.approx(40.0)


def test_a_rough_map_over_what_is_never_negative_begins_at_zero():
    """All of its curve lies where the signal can be."""
    assembly = mapped(positive=True, waves=1)
    p = assembly.values()
    p[[b.key.endswith("wave_1") for b in assembly.parameters]] = 0.01
    way = np.array([-0.01, 0.0, 0.5 * 0.01 * BEYOND_SIZE, 0.01 * BEYOND_SIZE])[:, None]
    y = free_run(assembly, way, p, 0.01).outputs[:, 0]
    assert y == pytest.approx([40.4, 40.4, 40.0, 39.6])


@pytest.mark.parametrize(
    "name", [n for n, rig in rigs().items() if rig.background and mapped_ports(rig())]
)
def test_what_check_proposes_for_a_rig_without_tolerances_can_be_pasted(name):
    """The line that is printed is Python, and the rig with it is sound; one that states some is
    told nothing."""
    assert tolerance_words(catalogue_rig(name)) == []

    class Bare(rigs()[name]):  # type: ignore[misc]
        background: Any = {}

    (said,) = tolerance_words(Bare())
    line = said[said.index("background = ") :]
    stated: dict[str, Any] = {}
    exec(line, {"RoughMap": RoughMap}, stated)
    Bare.background = stated["background"]
    check_rig(Bare(), "bare.py")
    plain, rough = Assembly(Bare()), Assembly(Bare(), background=True)
    assert len(rough.parameters) >= len(plain.parameters) + 10 * len(stated["background"])
    assert rough.traced.passages  # every signal of the maps is offered
