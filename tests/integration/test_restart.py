"""A fit that ended in a trap goes on from starts estimated anew; one that did not stays as it
was."""

import numpy as np
import pytest
from small_cart import RIG, cart_evidence, record_cart
from virtual_recordings import virtual_recording

from pamid.estimation.grey_box import GreyBox, fit_model
from pamid.estimation.intervals import estimates
from pamid.estimation.problem import Problem, free_parameters
from pamid.estimation.restart import TRAPPED, escape_local_minimum
from pamid.estimation.robust_fit import fit_robustly
from pamid.model.registry import rig_named
from pamid.simulation.data_split import DataSplit, split_recordings
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.virtual_rig import attach_specs

TRUE = {"mass_kg": 1.2, "coulomb-friction:force_n": 0.8}


@pytest.fixture(scope="module")
def sticking() -> DataSplit:
    """The README's cart: it sticks in some windows."""
    push = aprbs(30.0, 0.003, 3.0, (0.2, 0.8), seed=1)
    made = virtual_recording(
        RIG,
        {"force_n": push},
        0.003,
        "coulomb-friction:force_n=0.8",
        true={"mass_kg": 1.2},
        seed=2,
    )
    return split_recordings(rig_named(RIG), [made], [])


@pytest.fixture(scope="module")
def model(sticking) -> GreyBox:
    return fit_model(
        sticking, tuple(a for a, _ in attach_specs(sticking.rig, ("coulomb-friction",)))
    )


def test_friction_that_sticks_is_fitted_to_the_end(model):
    """Before, the fit ended at 1.23 kg (1.200 .. 1.260) and 0.787 N, eighty times above the error
    it can reach."""
    found = {b.full_name: e for b, e in estimates(model.fit).items()}
    for name, true in TRUE.items():
        assert found[name].value == pytest.approx(true, rel=2e-3)
        assert found[name].high - found[name].low < 0.01 * true
    left = np.concatenate([r.residual[r.scored] for r in model.held_out])
    assert float(np.abs(left).mean()) < 5e-4


def test_the_cost_falls_by_far(sticking, model):
    assembly = model.assembly
    tracks = sticking.tracks(assembly)
    trapped = fit_robustly(Problem(assembly, tracks, free_parameters(assembly, tracks)))
    free = escape_local_minimum(trapped, sticking.noise)
    assert free is not trapped and free.converged
    rms = [float(np.sqrt((f.residuals[0] ** 2).mean())) for f in (trapped, free)]
    assert rms[1] < 0.1 * TRAPPED * rms[0]


def test_a_fit_that_is_in_no_trap_stays(tmp_path):
    evidence = cart_evidence(record_cart(tmp_path))
    for effects in ((), ("coulomb-friction",)):
        model = fit_model(evidence, tuple(a for a, _ in attach_specs(evidence.rig, effects)))
        assert escape_local_minimum(model.fit, evidence.noise) is model.fit
