"""The trial's joint: nothing shared with the tool, a sane machine when nothing is planted, faults
that act."""

from dataclasses import asdict, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from middle_draws import MIDDLE

from pamid.model.attachment import attach
from pamid.model.registry import effects, rig_named
from pamid.simulation.excitation.aprbs import aprbs
from pamid.trial.faults import FAULTS, LONG_HOLDS, Fault, Planted
from pamid.trial.kernel import static_pull
from pamid.trial.logger import Readout
from pamid.trial.machine import packed
from pamid.trial.machines import one_dof
from pamid.trial.machines.one_dof import (
    JOINT_LAYOUT,
    NOISE,
    PERIOD_S,
    SUBSTEPS,
    TO_COLUMN,
    Excitation,
    Specimen,
    draw_specimen,
    record,
)

HEAVY, LIGHT = 0.0896, 0.014  # kg m2
ONE_DOF = [name for name in FAULTS if not name.startswith("nameless:")]


def middle(fault: Fault) -> dict[str, float]:
    return fault.draw(MIDDLE)


@cache
def machine(seed: int = 3, background: float = 0.01) -> Specimen:
    return draw_specimen(np.random.default_rng(seed), background)


@cache
def reference(seconds: float = 9.0, seed: int = 1) -> Any:
    return aprbs(seconds, PERIOD_S, 35.0, seed=seed)


@cache
def healthy(inertia: float, seconds: float = 9.0) -> dict[str, Any]:
    """A closed-loop recording without noise."""
    return record(machine(), {}, Excitation(reference(seconds)), inertia, Readout())


def replayed(
    planted_: dict[str, dict[str, float]],
    inertia: float = HEAVY,
    seconds: float = 9.0,
    steps: int = 0,
) -> dict[str, Any]:
    """The commands of the healthy machine given to one with faults."""
    command = healthy(inertia, seconds)["command"]
    return record(
        machine(), planted_, Excitation(command, closed=False), inertia, Readout(steps=steps)
    )


def change(one: dict[str, Any], other: dict[str, Any]) -> np.ndarray:
    """RMS difference per channel, in standard deviations of its noise."""
    return np.array([np.sqrt(np.mean((one[c] - other[c]) ** 2)) for c in JOINT_LAYOUT.channels]) / (
        JOINT_LAYOUT.by_channel(NOISE) * JOINT_LAYOUT.by_channel(TO_COLUMN)
    )


def force_map(specimen: Specimen, muscle: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Contraction, gauge pressure and static force over the working range."""
    chi, pressure = np.meshgrid(np.linspace(0.0, 0.2, 41), np.linspace(1e5, 6e5, 26))
    m, f = one_dof.machine_record(specimen, one_dof.RADIUS), packed(**asdict(Planted()))
    force = [
        static_pull(muscle, c, p, m, f, specimen.waves, 0.0)
        for c, p in zip(chi.flat, pressure.flat, strict=True)
    ]
    return chi, pressure, np.reshape(force, chi.shape)


@pytest.mark.parametrize("seed", range(6))
def test_background_is_as_large_as_asked(seed):
    rough = machine(seed, 0.03)
    smooth = replace(rough, waves=np.zeros((2, 1, 3)))
    for muscle in (0, 1):
        chi, pressure, force = force_map(rough, muscle)
        plain = force_map(smooth, muscle)[2]
        error = force[plain > 1.0] / plain[plain > 1.0] - 1.0
        everywhere = force / plain - 1.0
        assert np.sqrt(np.mean(everywhere**2)) == pytest.approx(0.03, rel=0.05)
        assert np.abs(error).max() < 0.12
    assert not machine(seed, 0.0).waves[:, :, 0].any()
    assert max(abs(rough.drift_1), abs(rough.drift_2)) <= 0.015
    assert 0.0 < abs(rough.fill_1 / rough.fill_2 - 1.0) < 0.046 and rough.vent_1 != rough.vent_2


@pytest.mark.parametrize("inertia", [LIGHT, HEAVY])
def test_healthy_machine_follows_its_reference(inertia):
    found = healthy(inertia)
    assert list(found) == ["time_s", "reference_deg", "command", *JOINT_LAYOUT.channels]
    late = reference()[:-150]  # the loop needs 0.45 s
    settled = np.flatnonzero(
        np.array([np.ptp(late[max(0, i - 150) : i + 1]) == 0.0 for i in range(late.size)])
    )
    error = np.abs(found["angle_deg"][settled] - late[settled])
    assert settled.size > 500 and np.median(error) < 1.5
    assert np.abs(found["angle_deg"]).max() < 42.0 and np.abs(found["command"]).max() == 1.0
    for i in (1, 2):
        assert found[f"pressure_{i}_kpa"][0] == pytest.approx(550.0, abs=1.0)
        assert found[f"pressure_{i}_kpa"].min() > 80.0 and found[f"pressure_{i}_kpa"].max() < 650.0
        assert found[f"force_{i}_n"].min() > 150.0 and found[f"force_{i}_n"].max() < 1200.0


def test_the_step_is_small_enough():
    for inertia in (LIGHT, HEAVY):
        gap = (
            replayed({}, inertia)["angle_deg"]
            - replayed({}, inertia, steps=2 * SUBSTEPS)["angle_deg"]
        )
        assert np.sqrt(np.mean(gap**2)) < 0.02


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_acts_and_at_zero_does_nothing(name):
    fault = FAULTS[name]
    sizes = middle(fault)
    seconds = 40.0 if LONG_HOLDS in fault.needs else 9.0
    before = healthy(HEAVY, seconds)
    absent = replayed({name: {**sizes, **dict.fromkeys(fault.amounts, 0.0)}}, HEAVY, seconds)
    assert all(np.array_equal(absent[c], before[c]) for c in absent)
    there = change(replayed({name: sizes}, HEAVY, seconds), before)
    assert there.max() > 1.0, f"{name} does not show: {there}"


@pytest.mark.parametrize("name", FAULTS)
def test_the_loop_holds_with_any_size(name):
    random = np.random.default_rng(7)
    for inertia in (LIGHT, HEAVY):
        found = record(
            machine(),
            {name: FAULTS[name].draw(random)},
            Excitation(reference(4.0)),
            inertia,
            Readout(1.0, 1),
        )
        assert np.abs(found["angle_deg"]).max() < 60.0
        assert all(np.isfinite(column).all() for column in found.values())


def test_every_effect_of_the_rig_has_its_fault():
    assert len(ONE_DOF) == 33
    rig, catalogue = rig_named("one-dof"), effects()
    for name in ONE_DOF:
        port = attach(rig, name, catalogue).ports if name != "clock-skew" else ("angle_sensor",)
        assert FAULTS[name].port == (rig.ports[port[0]].group or port[0]), name
        assert FAULTS[name].family == catalogue[name].family, name
        assert name in FAULTS[name].exact and FAULTS[name].exact <= catalogue.keys()
    nameless = [f for n, f in FAULTS.items() if n not in ONE_DOF]
    assert len(nameless) == 6 and not any(f.exact for f in nameless)
