"""A recording that stands still for a large part of its length."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pamid.base.metrics import runs_of
from pamid.checks.channel_quality import CheckedSignal, QualityIssue, share_words

#: share of a recording: a shorter standstill is usual before an experiment or after a step
LONG_STANDSTILL = 0.4


def standstill(
    measured: Sequence[CheckedSignal], sent: Sequence[CheckedSignal]
) -> list[QualityIssue]:
    """Longest stretch in which every measured channel repeats its value, if it is long.

    Repeats carry no information. They are fitted and held out like motion, and a model at rest is
    exact there. A channel that is constant throughout is another finding.
    """
    moving = [s for s in measured if s.span > 0.0]
    if not moving:
        return []
    starts, stops = runs_of(np.logical_and.reduce([s.still for s in moving]))
    if not starts.size:
        return []
    longest = int(np.argmax(stops - starts))
    first, stop = int(starts[longest]) - 1, int(stops[longest])  # from the value that is repeated
    time, share = moving[0].time, (stop - first) / moving[0].time.size
    if share < LONG_STANDSTILL:
        return []
    driven = [s.name for s in sent if s.span > 0.0 and not s.still[first + 1 : stop].all()]
    resting = [s.name for s in (*moving, *sent) if s.span > 0.0 and s.name not in driven]
    message = (
        f"{' and '.join(resting)} {'stands' if len(resting) == 1 else 'stand'} still"
        f"{f' while {driven[0]} moves' if driven else ''} {share_words(share)}"
    )
    look = "Check the sensor and the logger there, and cut" if driven else "Cut"
    return [
        QualityIssue(
            "standstill",
            tuple(resting),
            "advice",
            message,
            f"{look} the recording to the part that moves.",
            ((float(time[first]), float(time[stop - 1])),),
            {"share": share, "longest_samples": float(stop - first)},
        )
    ]
