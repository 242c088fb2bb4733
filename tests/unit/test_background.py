"""What every specimen differs by."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pamid
from pamid.checks.conformance import rig_findings
from pamid.model.assembly import Assembly
from pamid.model.background import (
    BEYOND_SIZE,
    HALF_WARM,
    RoughMap,
    SmoothGain,
    SplitGain,
    pull_of,
)
from pamid.model.effect import State
from pamid.model.parameter import Parameter
from pamid.model.port_guide import mapped_ports, tolerance_words
from pamid.model.registry import catalogue_rig, rigs
from pamid.model.rig import Port, Rig, check_rig
from pamid.recording.recording import Recording, recording_of
from pamid.simulation.data_split import split_recordings
from pamid.simulation.free_runs import free_run
from pamid.symbolic.vocabulary import Number, rate_of

Array = NDArray[np.float64]


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


def mapped(**options: Any) -> Assembly:
    """A force with a rough map over the way, read; the way is sent."""

    class Bench(Rig):
        """A way in, a force out."""

        inputs = {"way_mm": "m"}
        outputs = {"force_n": "N"}
        ports = {"rod": Port("motion", "N", {"position": "m", "load": "N"})}
        parameters = (Parameter("push", 40.0, 1.0, 100.0, "N", source="bench"),)
        background = {"rod": RoughMap("rail", "position", tolerance=0.02, **options)}

        def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
            return {"force_n": port("rod", p.push, position=u.way_mm, load=0.5 * p.push)}

    return Assembly(Bench(), background=True, sizes={("rod", "position"): 0.01})


@pytest.mark.parametrize(("options", "share"), [({}, 1.0), ({"of": "load"}, 0.5)])
def test_a_rough_map_is_as_rough_as_its_tolerance(options: dict[str, Any], share: float) -> None:
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


def test_one_wave_may_be_all_of_a_rough_map() -> None:
    """Three tolerances are those of the curve's root mean square, in whatever terms it lies: the
    slots of a motor are one wave. How far it stands is told by the curve, too."""
    rough = mapped().background_terms["background.rail"]
    waves = [q for q in rough.parameters if q.fitted]
    way = np.linspace(0.0, 1.0, 2001)
    for share in (1.0, 2.9):
        height = share * 0.02 * 2.0**0.5  # of a wave with that root mean square
        assert np.sqrt(np.mean((height * np.cos(4.0 * np.pi * way)) ** 2)) == pytest.approx(
            share * 0.02, rel=1e-3
        )
        assert all(q.low < -height and height < q.high for q in waves)
        strains = [height / waves[0].spread, *(len(waves) - 1) * [0.0]]
        assert pull_of(rough, strains) == pytest.approx(share)
    assert pull_of(SmoothGain("warmth", ("along", 0.0, 1.0), tolerance=0.1), [0.5, -2.0]) == 2.0


def test_a_rough_map_over_what_is_never_negative_begins_at_zero() -> None:
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
def test_what_check_proposes_for_a_rig_without_tolerances_can_be_pasted(name: str) -> None:
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


class Stage(Rig):
    """A stage whose motor and whose drag pass one port together."""

    inputs = {"current_a": "A"}
    outputs = {"position_m": "m"}
    ports = {"carriage": Port("motion", "N", {"position": "m", "velocity": "m/s"})}
    states = (State("position", "m"), State("velocity", "m/s"))
    parameters = (
        Parameter("mass", 8.0, 4.0, 16.0, "kg", spread=1.5, source="CAD"),
        Parameter("drag", 25.0, 0.0, 100.0, "N s/m", spread=10.0, source="guess"),
    )

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        rest = 40.0 * u.current_a - p.drag * x.velocity
        rest = port("carriage", rest, position=x.position, velocity=x.velocity)
        return {"position": x.velocity, "velocity": rest / p.mass}

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        return {"position_m": x.position}


def test_a_map_of_a_balance_is_proposed_of_what_drives() -> None:
    """At a steady speed drive and drag add up to nothing, however rough the drive is: a share of
    the sum would leave all of it to an effect, friction by name."""
    (said,) = tolerance_words(Stage())
    assert "offer at port carriage, which passes a balance," in said
    assert 'RoughMap("carriage_map", "position", of="load", tolerance=0.02)' in said
    assert "background =" not in said  # as the rig is, it would be refused
    assert "dry friction" in said  # what such a map can take up

    class Whole(Stage):
        background = {"carriage": RoughMap("map", "position", tolerance=0.02)}

    (said,) = tolerance_words(Whole())
    assert "is a share of a balance" in said and 'of="load"' in said

    class Pushed(Stage):
        def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
            push = port("carriage", 40.0 * u.current_a, position=x.position, velocity=x.velocity)
            return {"position": x.velocity, "velocity": (push - p.drag * x.velocity) / p.mass}

    class PushedAndStated(Pushed):
        background = Whole.background

    (said,) = tolerance_words(Pushed())
    assert "balance" not in said and "load" not in said
    assert tolerance_words(PushedAndStated()) == []


def test_a_map_of_a_signal_that_is_not_offered_is_found_by_check() -> None:
    """Every fit would refuse it."""

    class Loaded(Stage):
        background = {"carriage": RoughMap("map", "position", of="load", tolerance=0.02)}

    wrong = [f for f in rig_findings(Loaded()) if f.wrong]
    assert [f.check for f in wrong] == ["background"] and "'load'" in wrong[0].detail
    time = 0.01 * np.arange(400)
    made = recording_of(time, {"current_a": np.sin(time), "position_m": np.cos(time)})
    assert "wrong  background" in pamid.check(made, rig=Loaded()).summary()
    assert not [f for f in rig_findings(Stage()) if f.wrong]


class Seal(Rig):
    """A seal whose rod is moved, with a pressure behind it."""

    inputs = {"position_mm": "m", "pressure_kpa": "Pa"}
    outputs = {"force_n": "N"}
    ports = {"rod": Port("motion", "N", {"velocity": "m/s", "load": "N"})}
    states = ()
    parameters = (
        Parameter("damping_n_s_per_m", 900.0, 0.0, 1e4, source="data sheet"),
        Parameter("area_m2", 1e-5, 0.0, 1e-3, source="data sheet"),
    )
    background: Any = {
        "rod": (
            RoughMap("over_load", "load", of="load", tolerance=0.02),
            RoughMap("over_value", tolerance=0.02),
            SplitGain("ways", tolerance=0.02),
        )
    }
    period_s = 0.01

    def measure(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        speed, load = rate_of(u.position_mm), p.area_m2 * u.pressure_kpa
        along = port("rod", -p.damping_n_s_per_m * speed - load, velocity=speed, load=load)
        return {"force_n": -along}


def pressed(pressure: Array) -> Recording:
    """The seal moved to and fro at this pressure."""
    time = 0.01 * np.arange(pressure.size)
    way = 10.0 * np.sin(2.0 * time)
    force = 18.0 * np.cos(2.0 * time) + 1e-2 * pressure
    force = force + 0.1 * np.random.default_rng(3).standard_normal(time.size)
    columns = {"position_mm": way, "pressure_kpa": pressure, "force_n": force}
    return recording_of(time, columns)


LEVELS = np.random.default_rng(5)


@pytest.mark.parametrize(
    ("pressure", "values"),
    [
        (np.zeros(900), 1),
        (np.full(900, 200.0) + 0.5 * LEVELS.standard_normal(900), 1),
        (np.repeat(LEVELS.choice([0.0, 100.0, 250.0], 30), 30), 3),
        (np.repeat(LEVELS.choice([0.0, 100.0, 250.0, 300.0, 400.0], 30), 30), None),
        (200.0 + 100.0 * np.sin(0.05 * np.arange(900)), None),
        (1000.0 + 100.0 * np.sin(0.05 * np.arange(900)), None),
    ],
    ids=["zero", "held, with noise", "three levels", "five levels", "sine", "far from zero"],
)
def test_a_curve_over_a_few_values_is_left_out(pressure: Array, values: int | None) -> None:
    """It would bend freely between them; curves over what moves, and plain gains, stay."""
    recording = pressed(pressure)
    split = split_recordings(Seal(), [recording], [])
    left = [] if values is None else [("rod", "over_load", "load", values)]
    assert [(t.port, t.name, t.signal, t.values) for t in split.left_out] == left
    names = [term.name for term in split.rig.background["rod"]]
    assert names == ["over_load"][len(left) :] + ["over_value", "ways"]
    assert len(Seal().background["rod"]) == 3  # the rig itself is as it was
    said = pamid.check(recording, rig=Seal()).summary()
    assert ("over_load at port rod is left out" in said) == bool(left)
