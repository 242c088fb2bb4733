"""A reading that is rounded before the logger's noise: its step is read off, states follow it on
the average."""

import numpy as np
import pytest
from small_cart import RIG, cart_evidence, record_cart

from pamid.diagnosis.candidate_model import candidate_from, refit, replayed
from pamid.diagnosis.starting_hints import gather_hints
from pamid.engine.program import Stepping
from pamid.engine.sampled_inputs import SampledInputs
from pamid.estimation.grey_box import fit_model, model_with
from pamid.model.assembly import Assembly
from pamid.model.attachment import attach
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import read_recording, write_recording

STEP_M = 0.02


def test_slopes_are_those_of_the_value_behind_it():
    rig = rig_named(RIG)
    rounded = attach(rig, "quantisation@sensor", effects())
    u = np.repeat([3.0, -3.0, 4.0, -4.0], 50)[:, None]
    outputs, slopes = [], []
    for assembly in (Assembly(rig), Assembly(rig, (rounded,))):
        p = assembly.values(
            {"quantisation@sensor:quantum_m": STEP_M} if assembly.attachments else {}
        )
        columns = np.full(len(p), -1, np.int64)
        columns[: len(rig.parameters)] = np.arange(len(rig.parameters))
        stepping = Stepping(1)
        memory = assembly.program.memory(
            assembly.start(p), len(rig.parameters), stepping=stepping, period_s=0.01
        )
        y, s, bad = assembly.program.run(
            memory, SampledInputs(u, 0.01), p, stepping=stepping, columns=columns
        )
        assert bad == -1
        outputs.append(y[:, 0])
        slopes.append(s)
    plain, stepped = outputs
    levels = stepped / STEP_M
    assert np.mean(np.abs(levels - np.round(levels)) < 1e-9) > 0.8  # but for the risers
    assert 0.3 * STEP_M < np.abs(stepped - plain).max() <= 0.5 * STEP_M + 1e-12
    np.testing.assert_array_equal(slopes[0], slopes[1])


@pytest.mark.parametrize("share", [1 / 30, 1 / 80])
def test_the_step_stays_where_it_was_read_and_takes_the_error_with_it(tmp_path, share):
    told = read_recording(record_cart(tmp_path, planted=()))
    place, random = told.columns["position_m"], np.random.default_rng(2)
    step = float(np.ptp(place)) * share
    rough = step * np.round(place / step) + 0.02 * step * random.normal(size=len(place))
    write_recording(tmp_path / "rough.csv", told.time, told.columns | {"position_m": rough})
    evidence = cart_evidence(tmp_path / "rough.csv")
    model = fit_model(evidence)
    base = candidate_from(model.assembly, model.fit, model.held_out)
    effect = attach(evidence.rig, "quantisation@sensor", effects())
    (start,) = effect.effect.starts(gather_hints(evidence, base)["sensor"])
    assembly = model_with(evidence, (effect,), model.assembly.sizes)
    first = {f"{effect.label}:{name}": value for name, value in start.items()}
    found = replayed(evidence, assembly, refit(evidence, assembly, model.fit, first=first))
    quantum = found.fit.p[assembly.index_of(f"{effect.label}:quantum")]
    assert quantum == pytest.approx(step, rel=0.2 * share)
    assert found.absolutes.mean() < 0.35 * base.absolutes.mean()
