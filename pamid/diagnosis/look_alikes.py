"""Which effects these recordings cannot tell apart: measured on the refitted models' own
predictions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pamid.diagnosis.contender import Contender
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.simulation.data_split import DataSplit

Array = NDArray[np.float64]


def distance(one: Contender, other: Contender, noise: Array) -> float:
    """RMS difference of two models' held-out predictions, in noise standard deviations (worst
    channel)."""
    gaps = [
        ((a.model - b.model) / noise)[a.scored]
        for a, b in zip(one.replays, other.replays, strict=True)
    ]
    return float(np.sqrt((np.concatenate(gaps) ** 2).mean(axis=0)).max())


def alike(
    evidence: DataSplit, baseline: Contender, one: Contender, other: Contender, settings: Settings
) -> bool:
    """Do two models say the same on these recordings?"""
    apart = distance(one, other, evidence.noise)
    reach = min(distance(one, baseline, evidence.noise), distance(other, baseline, evidence.noise))
    return apart < max(settings.alike_share * reach, settings.alike_noise)


def look_alike_classes(
    evidence: DataSplit,
    baseline: Contender,
    contenders: list[Contender],
    settings: Settings = DEFAULT,
) -> list[list[str]]:
    """Classes of two and more, by single linkage, in the order of the contenders."""
    classes: list[list[Contender]] = []
    for c in contenders:
        near = [k for k in classes if any(alike(evidence, baseline, c, m, settings) for m in k)]
        merged = [m for k in near for m in k] + [c]
        classes = [k for k in classes if k not in near] + [merged]
    return [[m.attached[-1].label for m in k] for k in classes if len(k) > 1]
