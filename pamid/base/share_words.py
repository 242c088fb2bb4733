"""Shares, probabilities and spans of time as people read them: the same on the terminal, in the
files and on the page."""

from __future__ import annotations

import math


def percent_text(share: float) -> str:
    """0.784 -> "78 %"; shares below 1 % keep a digit, and none is rounded up to 100 %."""
    value = 100.0 * share
    if 0.0 < abs(value) < 1.0 or 99.0 < value < 100.0:
        text = f"{math.copysign(math.floor(abs(value) * 10.0 + 1e-9) / 10.0, value):.1f}"
    else:
        text = f"{value:.0f}"
    return f"{'0' if text in ('-0', '0.0', '-0.0') else text} %"


def percents_text(low: float, high: float) -> str:
    """ "74 to 82 %"."""
    return f"{percent_text(low).removesuffix(' %')} to {percent_text(high)}"


def chance_text(probability: float) -> str:
    """Two digits; never a certainty: "above 0.99", "below 0.01"."""
    if probability > 0.99:
        return "above 0.99"
    return "below 0.01" if probability < 0.01 else f"{probability:.2f}"


def minutes_text(minutes: float) -> str:
    """How long an experiment takes: 8.0 -> "8 min", 0.0017 -> "0.1 s"."""
    return f"{minutes:.2g} min" if minutes >= 1.0 else f"{60.0 * minutes:.2g} s"
