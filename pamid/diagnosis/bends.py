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
    rows = model.along_fit([x for q in passed for x in (q.value, q.result)])
    before, after = rows[:, 0::2].ravel(), rows[:, 1::2].ravel()
    return smooth_bend(before, after, settings)


def smooth_bend(before: Array, after: Array, settings: Settings = DEFAULT) -> float | None:
    """By what share of `before` (root mean square) `after` departs from its best straight line, as
    a curve over it does; None where it departs in another way (with a band or a limit, in steps,
    with a memory, in time) or in none: a gain, an offset."""
    order = np.argsort(before, kind="stable")
    x, y = before[order], after[order]
    span, passing = float(x[-1] - x[0]), float(np.sqrt(np.mean(x**2)))
    if not np.isfinite(span) or span <= 0.0:
        return None
    nearest = np.sqrt(np.finfo(float).eps)  # what is nearer is the arithmetic's
    slope, level = np.polyfit(x, y, 1)
    size = float(np.sqrt(np.mean((y - slope * x - level) ** 2))) / passing
    # a memory gives two values to nearly the same one: no curve is that steep
    steps = np.maximum(np.diff(x), nearest * span)
    steepest = float(np.abs(np.diff(y - slope * x) / steps).max())
    if size <= nearest or steepest > settings.bend_slope * abs(slope):
        return None
    return size
