"""Inputs beyond the range that their rig states, for example a valve beyond 0..1."""

from __future__ import annotations

from pamid.base.metrics import runs_of
from pamid.checks.channel_quality import QualityIssue, windows_of
from pamid.model.rig import Rig
from pamid.recording.recording import Recording, match_column

RANGE_SLACK = 0.01  # of a stated range: noise of a read-back input


def beyond_range(recording: Recording, rig: Rig) -> list[QualityIssue]:
    """Findings on inputs beyond the range that the rig states."""
    issues = []
    for name, (low, high) in rig.ranges.items():
        column = match_column(recording.columns, name)
        if column is None:
            continue
        values, slack = recording.signal(name), RANGE_SLACK * (high - low)
        out = (values < low - slack) | (values > high + slack)
        if not out.any():
            continue
        share = float(out.mean())
        issues.append(
            QualityIssue(
                "beyond-range",
                (column,),
                "advice",
                f"{name} should be within {low:g} .. {high:g} by rig {rig.name!r}, but goes "
                f"from {values.min():.4g} to {values.max():.4g}, outside for {share:.0%} of the "
                "time",
                "Check its unit and its zero; if it really goes there, widen ranges in the rig "
                "file.",
                windows_of(recording.time, *runs_of(out)),
                {"share": share, "low": float(values.min()), "high": float(values.max())},
            )
        )
    return issues
