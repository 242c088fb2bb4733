"""Effects of the general catalogue: no unit and no sign of a coordinate is special to them, and
planted ones come back with their parameters."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conformance_rules import drawn, own, run
from effect_bench import carts, inputs_of, recorded, tanks

from pamid.base.errors import FileError
from pamid.diagnosis.candidate_model import candidate_from, refit
from pamid.diagnosis.ranges import WIDER
from pamid.diagnosis.screening import ScreeningBaseline, advance, screen
from pamid.diagnosis.search import WIDENINGS
from pamid.diagnosis.starting_hints import gather_hints, spatial_periods
from pamid.estimation.grey_box import fit_model
from pamid.model.assembly import Assembly
from pamid.model.attachment import Addition, attach, attachments
from pamid.model.bound_parameter import parameters_of
from pamid.model.registry import effects, rig_named
from pamid.model.rig import Rig
from pamid.simulation.free_runs import port_sizes

BENCH: dict[str, Callable[..., Rig]] = {
    "signal-dependent-friction": carts,
    "signal-dependent-yield": carts,
    "yielding-friction": carts,
    "directional-friction": carts,
    "directional-damping": carts,
    "cogging": carts,
    "maxwell-slip-hysteresis": carts,
    "bouc-wen-hysteresis": carts,
    "hardening-hysteresis": carts,
    "coupling-play": carts,
    "signal-hysteresis@ruler": carts,
    "signal-hysteresis@amplifier": carts,
    "play@ruler": carts,
    "play@amplifier": carts,
    "full-wave-rectification": carts,
    "gain-drift@amplifier": carts,
    "gain-drift@ruler": carts,
    "asymmetric-saturation@amplifier": carts,
    "asymmetric-saturation@ruler": carts,
    "asymmetric-dead-zone@amplifier": carts,
    "asymmetric-dead-zone@ruler": carts,
    "orifice-loss@upper_balance": tanks,
    "leak@upper_balance": tanks,
    "overflow-into-store": tanks,
    "overflow@upper_balance": tanks,
    "second-store@upper_balance": tanks,
    "growing-loss@upper_balance": tanks,
    "pwm-quantisation": carts,
    "dead-time@amplifier": carts,
    "external-vibration": carts,
    "one-sided-end-stop": carts,
}
each = pytest.mark.parametrize("label", BENCH)
SAMPLES = 1500


@cache
def assembled(label: str, length: float = 1.0, force: float = 1.0, time: float = 1.0) -> Assembly:
    rig = BENCH[label](length, force, time)
    plain = Assembly(rig)
    sizes = port_sizes(
        plain, [(inputs_of(rig, SAMPLES, length, force), plain.values(), rig.period_s)]
    )
    return Assembly(rig, (attach(rig, label, effects()),), sizes=sizes)


# ---- units and signs --------------------


@each
def test_no_unit_is_special(label):
    """In other units the same effect, given in the sizes of its port, does the same; powers of two
    round alike."""
    length, force, time = 2.0**10, 2.0**-7, 2.0**-6
    one, other = assembled(label), assembled(label, length, force, time)
    for seed in range(3):
        p, q = drawn(one, np.random.default_rng(seed)), other.values()
        for i in own(one):
            q[i] = p[i] * (other.parameters[i].high / one.parameters[i].high)
        y = run(one, inputs_of(one.rig, SAMPLES), p)[0]
        z = run(other, inputs_of(other.rig, SAMPLES, length, force), q)[0]
        np.testing.assert_allclose(z / length, y, rtol=0.0, atol=1e-9 * np.abs(y).max())


def swapped(a: str, b: str) -> Callable[[dict[str, float]], dict[str, float]]:
    return lambda p: p | {a: p[b], b: p[a]}


def negated(a: str) -> Callable[[dict[str, float]], dict[str, float]]:
    return lambda p: p | {a: -p[a]}


TURNED: dict[str, Callable[[dict[str, float]], dict[str, float]]] = {
    "directional-friction": swapped("forward", "backward"),
    "directional-damping": swapped("forward", "backward"),
    "cogging": negated("cosine"),
    "full-wave-rectification": negated("fold"),
    "external-vibration": lambda p: p | {"sine": -p["sine"], "cosine": -p["cosine"]},
    "asymmetric-saturation": lambda p: p | {"upper": -p["lower"], "lower": -p["upper"]},
    "asymmetric-dead-zone": swapped("above", "below"),
    "one-sided-end-stop": lambda p: p | {"upper": -p["lower"], "lower": -p["upper"]},
}


@pytest.mark.parametrize("label", [k for k, bench in BENCH.items() if bench is carts])
def test_no_sign_of_the_coordinate_is_special(label):
    """With positions and forces counted the other way, parameters within the bounds do the same."""
    assembly = assembled(label)
    places = {assembly.parameters[i].key.split(":")[1]: i for i in own(assembly)}
    turned = TURNED.get(label.split("@")[0], dict)
    u = inputs_of(assembly.rig, SAMPLES)
    for seed in range(3):
        p = drawn(assembly, np.random.default_rng(seed))
        q = p.copy()
        for name, value in turned({name: p[i] for name, i in places.items()}).items():
            bound = assembly.parameters[places[name]]
            assert bound.low <= value <= bound.high
            q[places[name]] = value
        y, z = run(assembly, u, p)[0], run(assembly, u * [-1.0, 1.0], q)[0]
        np.testing.assert_allclose(z, -y, rtol=0.0, atol=1e-9 * np.abs(y).max())


# ---- planted --------------------

CARTS = {"mass": 1.6, "damping": 3.6}
TANKS = {"fill": 0.33, "outlet": 0.14}
# what is planted, and how near (share of it) each parameter has to come back
PLANTED: dict[str, tuple[dict[str, float], float]] = {
    "signal-dependent-friction": ({"base": 0.4, "slope": 1.5}, 0.05),
    "signal-dependent-yield": ({"base": 0.4, "slope": 1.5, "speed": 0.03}, 0.05),
    "yielding-friction": ({"level": 1.1, "speed": 0.03}, 0.05),
    "directional-friction": ({"forward": 0.5, "backward": 1.2}, 0.05),
    "directional-damping": ({"forward": 0.8, "backward": 3.0}, 0.1),
    "cogging": ({"sine": 0.8, "cosine": -0.5, "period": 0.061}, 0.05),
    "maxwell-slip-hysteresis": ({"level": 2.0, "reach": 0.05}, 0.1),
    "bouc-wen-hysteresis": ({"level": 3.0, "reach": 0.04, "shape": 0.6}, 0.1),
    "hardening-hysteresis": ({"level": 3.0, "reach": 0.3, "stiffens_over": 0.3}, 0.1),
    "coupling-play": ({"half_gap": 0.003}, 0.05),
    "one-sided-end-stop": ({"stiffness": 400.0, "upper": 0.05}, 0.1),
    "signal-hysteresis@ruler": ({"share": 0.1, "reach": 0.1}, 0.1),
    "play@ruler": ({"half_gap": 0.01}, 0.05),
    "play@amplifier": ({"half_gap": 0.9}, 0.05),
    "full-wave-rectification": ({"fold": 1.0}, 0.05),
    "gain-drift@amplifier": ({"change": -0.2, "time_constant": 8.0}, 0.1),
    "asymmetric-saturation@amplifier": ({"upper": 4.0, "lower": -7.0, "share": 1.0}, 0.05),
    "asymmetric-dead-zone@amplifier": ({"above": 0.6, "below": 2.0}, 0.05),
    "orifice-loss@upper_balance": ({"loss": 0.05, "ambient": 0.0}, 0.2),
    "second-store@upper_balance": ({"share": 0.35, "time_constant": 12.0}, 0.15),
    "growing-loss@upper_balance": ({"loss": 0.04, "power": 3.0}, 0.25),
    "overflow-into-store": ({"gain": 2.0, "level": 0.9, "share": 0.6}, 0.1),
}


@pytest.mark.parametrize("label", PLANTED)
def test_a_planted_effect_comes_back(label):
    values, near = PLANTED[label]
    rig, specimen = (carts(), CARTS) if BENCH[label] is carts else (tanks(), TANKS)
    names = {b.key.split(":")[1]: b.name for b in assembled(label).parameters if b.owner}
    spec = f"{label}:" + ",".join(f"{names[name]}={value}" for name, value in values.items())
    evidence = recorded(rig, spec, specimen, 8000)
    base = fit_model(evidence)
    candidate = candidate_from(base.assembly, base.fit, base.held_out)
    reference = ScreeningBaseline.of(candidate)
    tried = screen(
        evidence,
        reference,
        Addition((attach(rig, label, effects()),)),
        base.assembly.sizes,
        gather_hints(evidence, candidate),
    )
    tried = advance(evidence, reference, tried)
    assert tried.assembly is not None and tried.gain > 0.0
    done = refit(evidence, tried.assembly, base.fit, first=tried.first)
    left, before = (np.sqrt(np.mean(f.residuals[0] ** 2, axis=0)) for f in (done, base.fit))
    assert np.all(left < 1.5 * evidence.noise), (left / evidence.noise, before / evidence.noise)
    assert np.any(before > 2.0 * left), before / left
    for name, value in values.items():
        found = done.p[tried.assembly.keys[f"{label}:{name}"]]
        assert abs(found - value) < near * max(abs(value), 0.1), (name, found)


# ---- the lines over a position --------------------


def test_lines_over_the_position_are_found_at_any_speed():
    time = 0.002 * np.arange(20000)
    x = 0.3 * np.sin(2.1 * time) + 0.2 * np.sin(0.7 * time + 1.0)
    ripple = np.sin(2.0 * np.pi * x / 0.037)
    drift = 0.5 * np.cos(0.9 * time)
    for gap in (ripple, np.cumsum(ripple) * 0.02, np.sign(np.gradient(x)) * ripple):
        cut = [(x[k : k + 500], (gap + drift)[k : k + 500, None]) for k in range(0, len(time), 500)]
        assert spatial_periods(cut)[0] == pytest.approx(0.037, rel=0.02)
    assert spatial_periods([(np.ones(100), np.zeros((100, 1)))]) == ()


# ---- where they attach --------------------


def test_a_signal_may_stand_in_for_another():
    rig = carts()
    label = "signal-dependent-friction"
    slope = next(b for b in assembled(label).parameters if b.key == f"{label}:slope")
    sizes = assembled(label).sizes
    assert slope.value == pytest.approx(0.1 * sizes["guide", "value"] / sizes["guide", "current"])
    ports = rig.ports["guide"]
    without = {k: v for k, v in rig.ports.items() if k != "guide"} | {
        "guide": type(ports)("motion", "", ("position", "velocity"))
    }
    rig.ports = without  # type: ignore[misc]
    assert label not in {a.label for a in attachments(rig, effects().values())}


def test_two_parts_are_played_by_two_ports():
    rig = tanks()
    assert attach(rig, "overflow-into-store", effects()).ports == ("upper_balance", "lower_balance")
    rig.ports = {"lower_balance": rig.ports["lower_balance"]}  # type: ignore[misc]
    with pytest.raises(
        FileError, match="offering stored and downstream; and another offering upstream"
    ):
        attach(rig, "overflow-into-store", effects())


def test_what_spills_is_caught_to_its_share():
    assembly = assembled("overflow-into-store")
    keys = assembly.keys
    u = inputs_of(assembly.rig, SAMPLES)
    p = assembly.values()
    p[keys["outlet"]] = 0.0
    p[keys["overflow-into-store:level"]] = 0.5
    p[keys["overflow-into-store:share"]] = 1.0
    plain = p.copy()
    plain[keys["overflow-into-store:gain"]] = 0.0
    spilling, kept = run(assembly, u, p)[0], run(assembly, u, plain)[0]
    assert np.max(kept[:, 0] - spilling[:, 0]) > 0.05
    np.testing.assert_allclose(spilling.sum(axis=1), kept.sum(axis=1), rtol=1e-9)


@pytest.mark.parametrize(
    "name", ["cascaded-tanks", "dc-motor", "servo-pendulum", "thermal-block", "two-masses"]
)
def test_no_number_of_a_joint_with_muscles_is_tried_on_another_machine(name):
    """Where an effect may act, its bounds follow the recordings: none is a number of seconds, of
    volts or of newtons."""
    rig = rig_named(name)
    fixed = [
        f"{a.label}:{p.name} in {p.unit}"
        for a in attachments(rig, effects().values())
        for p in parameters_of(a.effect, rig.ports[a.ports[0]])
        if p.unit not in ("", "1") and not p.size
    ]
    assert not fixed


def test_a_dead_time_acts_as_far_as_its_range_may_be_widened():
    """What is kept of the past would otherwise end it at the first guess of a range."""
    assembly, u = assembled("dead-time@amplifier"), inputs_of(carts(), SAMPLES)
    place = assembly.keys["dead-time@amplifier:delay"]
    widest = WIDER**WIDENINGS * assembly.parameters[place].high
    late, there = assembly.values(), assembly.values()
    late[place], there[place] = widest, 0.0
    assembly = replace(assembly, ranges={"dead-time@amplifier:delay": (0.0, widest)})
    samples = round(widest / assembly.rig.period_s)
    shifted = u.copy()
    shifted[samples:, 0] = u[:-samples, 0]
    shifted[:samples, 0] = u[0, 0]
    y, z = run(assembly, u, late)[0], run(assembly, shifted, there)[0]
    np.testing.assert_allclose(y, z, rtol=0.0, atol=1e-6 * np.abs(z).max())


def test_general_parameters_keep_the_names_and_widen_the_bounds():
    for name in ("bouc-wen-hysteresis", "maxwell-slip-hysteresis"):
        effect = effects()[name]
        home = effect.parameters_at("actuator-force")[0]
        general = effect.parameters_at("motion")[0]
        assert home.name == general.name == "level"
        assert home.high < 0.5 < general.high
        assert effect.family_at("motion") == "hysteresis"
        assert effect.family_at("actuator-force") == "muscle-hysteresis"


def test_a_leak_is_as_fast_as_its_store_unless_an_outflow_is_offered():
    """A share of an outflow has no time in it, a share of the store is one per unit of time."""
    leak = effects()["leak"]
    of_outflow, of_store = (
        leak.parameters_at("rate", offered)[0]
        for offered in ({"stored", "outflow"}, {"stored", "downstream"})
    )
    assert (of_outflow.name, of_outflow.size, of_outflow.high) == ("share", "", 0.2)
    assert (of_store.name, of_store.size) == ("share", "value/stored")
    fastest = [
        assembled("leak@upper_balance", time=time).parameters[-2].high for time in (1.0, 256.0)
    ]
    assert fastest[0] == pytest.approx(256.0 * fastest[1], rel=1e-6)
    assert fastest[0] > BENCH["leak@upper_balance"]().parameters[0].value  # than it is filled
