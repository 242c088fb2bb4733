"""Does the cause hold elsewhere? Errors before and after on every held-out recording that was made
under other conditions than those the parameters were fitted on: another inertia or pressure,
controller, loop or amplitude."""

from __future__ import annotations

from typing import Any

import numpy as np

from pamid.base.units import column_size
from pamid.diagnosis.tournament import Diagnosis
from pamid.simulation.data_split import Span

AMPLITUDE_FACTOR = 1.5  # ratio of an output's spreads from which on they are other amplitudes


def transfer(d: Diagnosis) -> list[dict[str, Any]]:
    """One entry per held-out recording under other conditions: the head of its sha256, what differs
    and, per channel, the errors in its unit and the shrinkage, by windows that had no part in the
    choice."""
    if d.cause is None:
        return []
    out, at, left = [], 0, d.reported(d.cause)
    for span, before in zip(d.evidence.held_out, d.budget.baseline.replays, strict=True):
        rows = np.arange(at, at + len(before.windows))
        at += len(before.windows)
        new = differences(d, span)
        if not new or not len(rows):
            continue
        entry: dict[str, Any] = {"recording": span.recording.sha256[:12], "differs": new}
        for i, channel in enumerate(d.evidence.channels):
            if not span.recording.has(channel):
                continue
            was, now = (
                d.budget.baseline.absolutes[rows, i].mean(),
                left[rows, i].mean(),
            )
            entry[channel] = {
                "mae_refitted": column_size(channel, was),
                "mae_with_cause": column_size(channel, now),
                "shrinkage": float(1.0 - now / was),
            }
        out.append(entry)
    return out


def differences(d: Diagnosis, span: Span) -> dict[str, Any]:
    """What this recording has that no fitted recording had: values known for it, loop, controller,
    amplitude."""
    fitted = [s.recording for s in d.evidence.fit]
    own = span.recording
    new: dict[str, Any] = {
        k: v for k, v in own.known.items() if all(r.known.get(k) != v for r in fitted)
    }
    if all(r.loop != own.loop for r in fitted):
        new["loop"] = own.loop
    if own.controller and all(r.controller != own.controller for r in fitted):
        new["controller"] = {
            k: v for k, v in own.controller.items() if all(r.controller.get(k) != v for r in fitted)
        }
    channel = next((c for c in d.evidence.channels if all(r.has(c) for r in (own, *fitted))), None)
    if channel is None:
        return new
    spread = own.si(channel)[span.start : span.stop].std()
    ratios = [
        spread / max(s.recording.si(channel)[s.start : s.stop].std(), 1e-300)
        for s in d.evidence.fit
    ]
    if all(not 1.0 / AMPLITUDE_FACTOR < r < AMPLITUDE_FACTOR for r in ratios):
        new["amplitude"] = float(min(ratios, key=lambda r: abs(np.log(r))))
    return new
