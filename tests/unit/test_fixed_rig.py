"""A rig of which no parameter is fitted."""

from dataclasses import replace
from pathlib import Path

import pytest
from small_cart import FEW, RIG, record_cart

from pamid.diagnosis.pipeline import diagnose
from pamid.diagnosis.verdict.verdict_figures import diagnosis_file
from pamid.estimation.grey_box import fit_model
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import read_recording
from pamid.simulation.data_split import DataSplit, split_recordings

TRUE_MASS_KG = 1.2  # of `record_cart`


def evidence_of(recording: Path) -> DataSplit:
    rig = rig_named(RIG)
    rig.parameters = tuple(
        replace(p, value=TRUE_MASS_KG if p.name == "mass_kg" else p.value, fitted=False)
        for p in rig.parameters
    )
    rig.background = {}
    return split_recordings(rig, [read_recording(recording)], [])


@pytest.mark.parametrize("planted", [(), ("coulomb-friction",), ("coulomb-friction", "dead-time")])
def test_a_rig_without_fitted_parameters_is_diagnosed(planted, tmp_path):
    evidence = evidence_of(record_cart(tmp_path, planted))
    model = fit_model(evidence)
    assert model.fit.converged and not model.fit.problem.free
    found = diagnose(evidence, {name: effects()[name] for name in FEW})
    result = diagnosis_file(found)
    assert {c.effect for c in result.causes} == set(planted)
