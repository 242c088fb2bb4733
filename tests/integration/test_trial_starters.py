"""The machines behind the starter rigs: healthy ones are their rigs, every fault shows and
vanishes, and the questions stay the same."""

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from middle_draws import MIDDLE

import pamid
from pamid.base.arrays import Array
from pamid.base.units import unit
from pamid.model.attachment import attachments
from pamid.model.registry import catalogue_rig, effects
from pamid.recording.recording import TIME, Recording, read_recording, write_recording
from pamid.trial.cases import cases_sha256, draw_cases
from pamid.trial.conditions import StarterConditions
from pamid.trial.faults import NAMELESS
from pamid.trial.logger import Readout
from pamid.trial.machine import machine_named, machine_names
from pamid.trial.starter_machine import StarterMachine, draw_map

SEED = 5
STARTERS = [name for name in machine_names() if isinstance(machine_named(name), StarterMachine)]
FAULTS = [(name, fault) for name in STARTERS for fault in machine_named(name).faults]


def machine(name: str) -> StarterMachine:
    found = machine_named(name)
    assert isinstance(found, StarterMachine)
    return found


@cache
def signal(name: str) -> dict[str, Array]:
    own = machine(name)
    plain = StarterConditions("open", "all", 1.0, 0.0, 0.6 * own.seconds, 1.0)
    sent: dict[str, Array] = own.excitation(plain, lambda *_: {}, SEED, SEED)
    return sent


@cache
def constants(name: str) -> dict[str, float]:
    random = np.random.default_rng(SEED)
    return {k: draw(random) for k, draw in machine(name).parameters.items()}


def recorded(
    name: str, planted: dict[str, dict[str, float]], *, noise: float = 0.0, steps: int = 0
) -> dict[str, Array]:
    own = machine(name)
    random = np.random.default_rng(SEED)
    flat = tuple(draw_map(random, 0.0, span) for span in own.maps)
    exact = dict.fromkeys(own.log, 0.0)
    readout = Readout(noise, SEED, steps=steps)
    return own.record((constants(name), flat, exact), planted, signal(name), readout)


@cache
def healthy(name: str) -> dict[str, Array]:
    return recorded(name, {})


def change(name: str, one: dict[str, Array], other: dict[str, Array]) -> float:
    """RMS difference in standard deviations of the noise, in the reading of the largest."""
    own = machine(name)
    return max(
        float(np.sqrt(np.mean((one[c] - other[c]) ** 2))) / own.log[c].noise
        for c in one
        if c in own.log and own.log[c].noise > 0.0
    )


def sizes(name: str, fault: str) -> dict[str, float]:
    return machine(name).plant(fault, MIDDLE)[1]


@pytest.mark.parametrize("name", STARTERS)
def test_a_healthy_machine_is_its_rig(name, tmp_path):
    """Signs, units and conventions: the rig with the machine's own constants makes the same
    recording, to a few times the noise."""
    rig = catalogue_rig(name)
    columns = healthy(name)
    meta = {"recording": {"rig": name, "sampling_period_s": machine(name).period_s}}
    path = tmp_path / "healthy.csv"
    write_recording(path, columns[TIME], {k: v for k, v in columns.items() if k != TIME}, meta)
    source: Recording = read_recording(path)
    true = {
        p.name: constants(name)[p.name] / unit(p.unit).factor for p in rig.parameters if p.fitted
    }
    made = pamid.simulate(source, name, parameters=true, noise=0.0)
    for column in machine(name).logged:
        noise = machine(name).log[column].noise
        apart = made.columns[column] - columns[column]
        assert np.sqrt(np.mean(apart**2)) < 2.0 * noise, column
        assert np.ptp(columns[column]) > 50.0 * noise, "there is something to reproduce"


@pytest.mark.parametrize(("name", "fault"), FAULTS)
def test_a_fault_shows_and_vanishes(name, fault):
    planted = sizes(name, fault)
    assert change(name, healthy(name), recorded(name, {fault: planted})) > 2.0
    none = dict.fromkeys(machine(name).faults[fault].amounts, 0.0)
    without = recorded(name, {fault: {**planted, **none}})
    assert all(np.array_equal(without[c], healthy(name)[c]) for c in without)


@pytest.mark.parametrize(("name", "fault"), FAULTS)
def test_a_fault_is_what_the_catalogue_calls_it(name, fault):
    rig, planted = catalogue_rig(name), machine(name).faults[fault]
    if fault.startswith(NAMELESS):
        assert planted.port in {rig.group_of(p) for p in rig.ports} and not planted.exact
        return
    name_of, _, port = fault.partition("@")
    assert port == planted.port and name_of in planted.exact
    ways = [a for a in attachments(rig, effects().values()) if a.effect.name in planted.exact]
    assert (planted.family, planted.port) in {(a.family(rig), a.group(rig)) for a in ways}


@pytest.mark.parametrize("name", STARTERS)
def test_two_faults_never_set_the_same_size(name):
    own = machine(name)
    drawn = {fault: sizes(name, fault) for fault in own.faults}
    for one, other in combinations(own.faults.values(), 2):
        if one.family != other.family:
            own.planted({f.name: drawn[f.name] for f in (one, other)})


@pytest.mark.parametrize("name", [n for n in STARTERS if machine(n).clock])
def test_readings_stamped_early_are_those_to_come(name):
    own, still = machine(name), healthy(name)
    fault = f"clock-skew@{own.clock}"
    early = recorded(name, {fault: {"early_s": 2.0 * own.period_s, "skew_ppm": 0.0}})
    for column in own.logged:
        assert early[column][:-2] == pytest.approx(still[column][2:], abs=1e-6)
        assert not np.array_equal(early[column][-2:], np.repeat(still[column][-1], 2))
    assert all(np.array_equal(early[column], still[column]) for column in own.sent)


DIGESTS: dict[str, str] = {
    "cascaded-tanks": "1f5d60f50fbd2fc4",
    "cylinder-bench": "67eb792dd82582c6",
    "damper-bench": "abc0ae137c5faac0",
    "dc-motor": "def1601883ba5983",
    "servo-pendulum": "4265e9062f023748",
    "thermal-block": "17416d7e32a9a96b",
    "two-masses": "0c50a121cbc64fd6",
}


@pytest.mark.parametrize("name", STARTERS)
def test_the_questions_are_the_same_everywhere(name):
    """But for `removed`, which follows the catalogue."""
    asked = [replace(c, removed=()) for c in draw_cases("test", 30, 0, name)]
    assert cases_sha256(asked).startswith(DIGESTS[name])


@pytest.mark.parametrize("name", STARTERS)
def test_a_bare_case_is_the_same_machine_and_a_tool_that_knows_no_tolerances(name):
    (told,), (bare,) = (draw_cases("calibration", 1, 3, name, bare=b) for b in (False, True))
    assert (bare.planted, bare.conditions, bare.seed) == (told.planted, told.conditions, told.seed)
    assert bare.sha256 != told.sha256
    assert bare.label()["bare"] is True and "bare" not in told.label()
    assert bare.tools_rig.background == {} != told.tools_rig.background
    assert catalogue_rig(name).background, "the catalogue's own keeps them"
