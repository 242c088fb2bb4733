"""Look-alikes: effects that these recordings cannot tell apart, by their models' predictions.

With predictions y_i and noise s_c of channel c, over the held-out samples that are scored,

    D(i, j) = max_c sqrt(mean_t ((y_i - y_j) / s_c)^2),

i and j are alike where D(i, j) < max(a min(D(i, 0), D(j, 0)), b): 0 is the baseline, a and b are
the setting `alike_share` and ALIKE_NOISE. Refitted parameters absorb what they can of the
difference, as in the T-criterion for discrimination between models: Atkinson and Fedorov (1975),
Biometrika 62:57.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.settings import Settings
from pamid.simulation.data_split import DataSplit

Array = NDArray[np.float64]

ALIKE_NOISE = 0.5  # standard deviations of the noise: no sensor shows less


def distance(one: CandidateModel, other: CandidateModel, noise: Array) -> float:
    """RMS difference of two models' held-out predictions, in noise standard deviations (worst
    channel)."""
    gaps = [
        ((a.model - b.model) / noise)[a.scored] for a, b in zip(one.runs, other.runs, strict=True)
    ]
    return float(np.sqrt((np.concatenate(gaps) ** 2).mean(axis=0)).max())


def alike(
    evidence: DataSplit,
    baseline: CandidateModel,
    one: CandidateModel,
    other: CandidateModel,
    settings: Settings,
) -> bool:
    """Do two models predict the same of these recordings? See the head of the module."""
    difference = distance(one, other, evidence.noise)
    reach = min(distance(one, baseline, evidence.noise), distance(other, baseline, evidence.noise))
    return difference < max(settings.alike_share * reach, ALIKE_NOISE)


def all_alike(
    evidence: DataSplit,
    baseline: CandidateModel,
    models: Sequence[CandidateModel],
    settings: Settings,
) -> bool:
    """Do all these models predict the same as the first of them?"""
    return all(alike(evidence, baseline, models[0], c, settings) for c in models[1:])
