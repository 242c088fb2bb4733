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


def times_text(ratio: float) -> str:
    """How many times the first is the second, in two digits and no power of ten: 1.36 -> "1.4",
    7312 -> "7300", 4.2e7 -> "42 million"."""
    if not math.isfinite(ratio):
        return "?"
    for size, name in ((1e9, " thousand million"), (1e6, " million")):
        if abs(ratio) >= 0.995 * size:
            return f"{_two_digits(ratio / size)}{name}"
    return _two_digits(ratio)


def _two_digits(value: float) -> str:
    return f"{float(f'{value:.2g}'):.10g}"


def minutes_text(minutes: float) -> str:
    """How long an experiment takes: 8.0 -> "8 min", 0.0017 -> "0.1 s", 150 -> "2.5 h"."""
    if minutes >= 120.0:
        return f"{_two_digits(minutes / 60.0)} h"
    return f"{_two_digits(minutes)} min" if minutes >= 1.0 else f"{_two_digits(60.0 * minutes)} s"
