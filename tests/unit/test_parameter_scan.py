"""Parameters over which the misfit has many narrow minima: values are tried, no slope helps."""

from collections import defaultdict

import numpy as np
import pytest
from small_cart import RIG
from virtual_recordings import virtual_recording

from pamid.base.arrays import Array
from pamid.diagnosis.candidate_model import CandidateModel, candidate_from, transferred
from pamid.diagnosis.parameter_scan import SCAN_STARTS, ScanPart, scan_grid, scanned_values
from pamid.diagnosis.screening import ScreenedCandidate, ScreeningBaseline, advance, screen
from pamid.diagnosis.starting_hints import gather_hints
from pamid.estimation.grey_box import fit_model, model_with
from pamid.estimation.multiple_shooting import fit
from pamid.estimation.problem import FitStart, Problem, free_parameters
from pamid.model.attachment import Addition, Attachment, attach
from pamid.model.effect import Hints
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import Recording, recording_of
from pamid.simulation.data_split import DataSplit, split_recordings

PERIOD_M, SERVO, OVEN = 0.21, "servo-pendulum", "thermal-block"
NO_HINTS: defaultdict[str, Hints] = defaultdict(Hints)


def baseline(rig: str, made: Recording) -> tuple[DataSplit, CandidateModel]:
    """A recording as it is split, and the refitted model without any effect."""
    evidence = split_recordings(rig_named(rig), [made], [])
    model = fit_model(evidence)
    return evidence, candidate_from(model.assembly, model.fit, model.held_out)


def screened(
    evidence: DataSplit,
    base: CandidateModel,
    effect: Attachment,
    hints: defaultdict[str, Hints] = NO_HINTS,
) -> ScreenedCandidate:
    """The effect after all steps of its screening."""
    reference = ScreeningBaseline.of(base, 5)
    begun = screen(evidence, reference, Addition((effect,)), base.assembly.sizes, hints)
    return advance(evidence, reference, begun)


@pytest.fixture(scope="module")
def cogged() -> tuple[DataSplit, CandidateModel]:
    """A cart with 0.6 N of cogging, a period in 0.21 m, and its baseline."""
    random = np.random.default_rng(5)
    push = np.repeat(random.choice([-1.0, 1.0], 40) * random.uniform(0.2, 1.2, 40), 40)
    planted = f"cogging:sine_force_n=0.6,cosine_force_n=0.0,period_m={PERIOD_M}"
    sent = {"force_n": push - push.mean()}
    made = virtual_recording(RIG, sent, 0.01, planted, true={"mass_kg": 1.2})
    read = made.columns["position_m"] + 1e-3 * random.standard_normal(len(push))
    return baseline(RIG, recording_of(made.time, {**made.columns, "position_m": read}))


def scanned(evidence: DataSplit, base: CandidateModel, effect: Attachment) -> tuple[ScanPart, int]:
    """Everything that was fitted, and the place of the effect's scanned parameter."""
    assembly = model_with(evidence, (effect,), base.assembly.sizes)
    tracks = evidence.tracks(assembly)
    problem = Problem(assembly, tracks, free_parameters(assembly, tracks))
    p = transferred(assembly, (base.assembly, base.fit.p))
    (place,) = (i for i, b in enumerate(assembly.parameters) if b.scan[1])
    fit = base.fit
    return ScanPart(problem, p, fit.starts, fit.weights, fit.stepping), place


def test_the_period_is_found_without_a_hint(cogged):
    evidence, base = cogged
    effect = attach(evidence.rig, "cogging", effects())
    whole, place = scanned(evidence, base, effect)
    found = scanned_values(whole, whole, place)
    assert len(found) == SCAN_STARTS
    grid = scan_grid(whole.problem.assembly.parameters[place])
    nearest = grid[np.argmin(np.abs(1.0 / grid - 1.0 / PERIOD_M))]
    assert found[0] == pytest.approx(nearest)
    told = screened(evidence, base, effect)
    assert told.p is not None
    assert told.p[place] == pytest.approx(PERIOD_M, rel=0.02)


def test_the_step_of_a_command_is_found():
    """And what is read, not sent, is not scanned: its plateaus tell its step."""
    step_v, random = 0.4, np.random.default_rng(7)
    sent = {"voltage_v": np.repeat(random.uniform(-5.0, 5.0, 60), 40)}
    planted = f"quantisation@driver:quantum_v={step_v}"
    true = {"rotor_kg_m2": 0.006}
    evidence, base = baseline(SERVO, virtual_recording(SERVO, sent, 0.005, planted, true=true))
    effect = attach(evidence.rig, "quantisation@driver", effects())
    whole, place = scanned(evidence, base, effect)
    assert scanned_values(whole, whole, place)[0] == pytest.approx(step_v, rel=0.02)
    told = screened(evidence, base, effect)
    assert told.p is not None
    assert told.p[place] == pytest.approx(step_v, rel=0.01)
    read = attach(evidence.rig, "quantisation@encoder", effects())
    assembly = model_with(evidence, (read,), base.assembly.sizes)
    assert not any(b.fitted for b in assembly.parameters if b.owner == read.label)


def heated(power: Array, planted: str) -> Recording:
    true = {"capacity_j_per_k": 420.0}
    return virtual_recording(OVEN, {"power_w": power}, 10.0, planted, true=true)


@pytest.fixture(scope="module")
def pulsed() -> tuple[DataSplit, CandidateModel]:
    """A heater of 100 W that is on or off, its share of 120 s rounded to a twelfth, while the log
    holds what was asked for."""
    asked = np.repeat(np.random.default_rng(8).uniform(5.0, 95.0, 30), 40)
    amounts = "step=0.0833333,ripple=1,phase=0.3,full_w=100,pulse_period_s=123"
    return baseline(OVEN, heated(asked, f"pwm-quantisation:{amounts}"))


def test_the_step_of_a_duty_is_found_beside_its_pulses(pulsed):
    """At the null of the pulses what rounding leaves is lost in them."""
    evidence, base = pulsed
    effect = attach(evidence.rig, "pwm-quantisation", effects())
    told = screened(evidence, base, effect, gather_hints(evidence, base))
    assembly, p = told.ended
    found = {
        b.key.partition(":")[2]: p[i]
        for i, b in enumerate(assembly.parameters)
        if b.owner == effect.label
    }
    assert found["step"] * found["full"] == pytest.approx(100.0 / 12.0, rel=0.02)
    assert found["pulse_period"] == pytest.approx(123.0, rel=0.002)
    problem = ScreeningBaseline.of(base, 5).problem(evidence, assembly)
    assert told.starts is not None and told.stepping is not None
    start = FitStart(p=p, starts=told.starts, weights=base.fit.weights, stepping=told.stepping)
    fitted = fit(problem, start)
    # this record alone leaves a sixth of the full duty open
    full = assembly.index_of(f"{effect.label}:full")
    k = problem.free.index(full)
    deviation = assembly.parameters[full].spread * np.sqrt(fitted.covariance[k, k])
    assert abs(np.log(fitted.p[full] / 100.0)) < deviation < 0.25
    # beside the pulses as they were found the scan leads there from a duty without steps
    (place,) = (i for i, b in enumerate(assembly.parameters) if b.scan[1])
    at = p.copy()
    at[place] = 0.0
    weights = base.fit.weights
    where = ScanPart(problem, at, told.starts, weights, told.stepping, with_effect=True)
    best, *_ = scanned_values(where, where, place)
    assert best * found["full"] == pytest.approx(100.0 / 12.0, rel=0.03)


def test_a_long_delay_is_found_and_a_prior_allows_it():
    """Transport takes 80 samples here, of which no slope at a delay of a few samples knows."""
    delay_s, random = 800.0, np.random.default_rng(3)
    power = np.repeat(random.uniform(5.0, 95.0, 12), 100)
    evidence, base = baseline(OVEN, heated(power, f"dead-time@heater:delay_s={delay_s}"))
    effect = attach(evidence.rig, "dead-time@heater", effects())
    whole, place = scanned(evidence, base, effect)
    bound = whole.problem.assembly.parameters[place]
    longest_s = max(len(t) * t.period_s for t in whole.problem.tracks)
    assert bound.high == pytest.approx(0.1 * longest_s) and bound.spread == 0.5 * bound.high
    grid = scan_grid(bound)
    assert grid.max() == bound.high and grid.min() < 10.0
    told = screened(evidence, base, effect)
    assert told.p is not None
    # a part of the recording shows, of which the first 800 s were not led in
    assert told.p[place] == pytest.approx(delay_s, rel=0.05)
