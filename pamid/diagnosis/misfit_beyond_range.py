"""Wrong units or signs: a refitted model whose error exceeds the spread of the signal explains
nothing, whatever lowers its error."""

from __future__ import annotations

from typing import Any

import numpy as np

from pamid.base.metrics import seen_mean
from pamid.checks.rig_consistency import compared_with_sheet
from pamid.checks.scale_slips import advice, refitted_slips, slips
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.simulation.data_split import DataSplit


def scale_doubt(
    evidence: DataSplit,
    base: CandidateModel,
    best: CandidateModel | None,
    settings: Settings = DEFAULT,
) -> dict[str, Any] | None:
    """Held-out error over the spread of the signal, by channel, where units or signs are in doubt,
    the slips of the pen that would explain it, and a sentence; None where the refitted model
    follows what was measured.

    They are in doubt where the best model still misses by more than the spread, or where the
    refitted one does and a slip sets it right. Below the spread, windows that begin where the
    recording is hide an error of the size: there a slip has to prove itself in a refit.
    """
    # of all that was recorded: what is held out may lie on a plateau
    tracks = (*base.fit.problem.tracks, *(r.track for r in base.replays))
    spread = np.nanstd(np.concatenate([t.y for t in tracks]), axis=0)

    def far(c: CandidateModel, share: float = 1.0) -> dict[str, float]:
        error = np.sqrt(seen_mean(c.squares))
        return {
            name: float(e / s)
            for name, e, s, n in zip(evidence.channels, error, spread, evidence.noise, strict=True)
            if e > max(share * s, settings.misfit_noise * n)
        }

    doubtful = far(base, 0.0)
    if not doubtful:
        return None
    refitted, left = far(base), far(best or base)
    compared = (
        (e, r)
        for r in evidence.recordings
        if (e := compared_with_sheet(r, evidence.rig)) is not None
    )
    first = next(compared, None)
    found = [] if first is None else slips(*first) if refitted else refitted_slips(*first)
    if not found and not (refitted and left):
        return None
    return {
        "error_over_spread": left or refitted or doubtful,
        "advice": advice(found),
        "slips": [{"kind": s.kind, "name": s.name, "factor": s.factor} for s in found],
    }
