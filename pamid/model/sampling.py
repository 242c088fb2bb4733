"""The usual sampling period of a rig: that of its file, or else that of its recordings."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from pamid.model.rig import Rig, with_declared


def stated_period(rig: Rig) -> float | None:
    """The usual sampling period (s) of a rig; None where it states none."""
    return next(
        (
            float(kind.__dict__["period_s"])
            for kind in type(rig).__mro__
            if kind is not Rig and "period_s" in kind.__dict__
        ),
        None,
    )


def as_sampled(rig: Rig, periods_s: Sequence[float]) -> Rig:
    """The rig with the median of its recordings' sampling periods (s) where it states none; the
    same rig where it does, or where there is no recording."""
    if not periods_s or stated_period(rig) is not None:
        return rig
    return with_declared(rig, period_s=float(median(periods_s)))
