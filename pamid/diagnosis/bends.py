"""Does an effect do more than bend a characteristic, as no machine's is straight?

A pump, an amplifier, a sensor gives a little more here and a little less there than its data sheet
says. A recording shows that as soon as its noise is small enough, and an effect with a kink (a
saturation that takes a tenth off, a reading that is off by a fiftieth on one side) follows such a
curve about as well as the curve does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.simulation.replay import run_windows

Array = NDArray[np.float64]

#: kinds of port at which effects act on a value by its own size
CHARACTERISTICS = ("command", "reading")


def bend(model: CandidateModel, label: str, settings: Settings = DEFAULT) -> float | None:
    """By what share of what passes one of a model's effects bends a characteristic, where that is
    all that it does; None where it does anything else, or where the rig states by how much its map
    may be bent there."""
    rig = model.assembly.rig
    (attached,) = (a for a in model.attached if a.label == label)
    alone = [a for a in model.attached if set(a.ports) & set(attached.ports)] == [attached]
    port = attached.ports[0]
    stated = {rig.group_of(one) for one in rig.background}
    if (
        not alone
        or len(attached.ports) > 1
        or rig.ports[port].kind not in CHARACTERISTICS
        or rig.group_of(port) in stated
    ):
        return None
    passed = [q for q in model.assembly.traced.passages if q.port == port]
    ends = [
        (f"{q.where}.{end}", x) for q in passed for end, x in (("in", q.value), ("out", q.result))
    ]
    program = model.assembly.program_with(dict(ends))
    fit = model.fit
    rows = np.concatenate(
        [
            run_windows(program, model.assembly, fit.p, t, fit.problem.windows(t), x, fit.stepping)[
                :, len(program.outputs) - 2 * len(passed) :
            ]
            for t, x in zip(fit.problem.tracks, fit.starts, strict=True)
        ]
    )
    before, after = rows[:, 0::2].ravel(), rows[:, 1::2].ravel()
    return smooth_bend(before, after, settings)


def smooth_bend(before: Array, after: Array, settings: Settings = DEFAULT) -> float | None:
    """By what share of `before` (root mean square) `after` departs from its best straight line, as
    a smooth curve over it does; None where it departs in another way (with jumps, with a memory, in
    time) or in none: a gain, an offset."""
    span = float(np.ptp(before))
    if not np.isfinite(span) or span <= 0.0:
        return None
    x = 2.0 * (before - before.min()) / span - 1.0
    # of the fifth order: as smooth as the maps of the trial, three halves and more within the range
    curve = np.polynomial.legendre.legvander(x, 5)
    changed = after - before
    left = [
        changed - basis @ np.linalg.lstsq(basis, changed, rcond=None)[0]
        for basis in (curve[:, :2], curve)
    ]
    straight, smooth = (float(np.sqrt(np.mean(r**2))) for r in left)
    passing = float(np.sqrt(np.mean(before**2)))
    # less than the root of the last bit is the arithmetic's
    nothing = straight <= np.sqrt(np.finfo(float).eps) * passing
    if nothing or smooth > settings.bend_left * straight:
        return None
    return straight / passing
