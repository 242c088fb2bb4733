"""Where the gap lies: ports, regimes, frequency band, windows of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter, welch

from pamid.diagnosis.budget import Budget
from pamid.evidence import Evidence
from pamid.residuals import Replay
from pamid.units import display_unit, from_si, split_column

Array = NDArray[np.float64]

BINS = 12
CONCENTRATED = 0.15    # a regime is told if it holds this much more of the gap than of the time


@dataclass(frozen=True)
class Regime:
    signal: str
    low: float
    high: float
    unit: str
    share_of_gap: float
    share_of_time: float


def _excess(before: Replay, after: Replay | None, noise: Array) -> Array:
    """Squared error per sample that the cause (or the noise alone) does not account for, in noise variances."""
    loss = ((before.residual / noise) ** 2).sum(axis=1)
    rest = ((after.residual / noise) ** 2).sum(axis=1) if after is not None else float(len(noise))
    return np.where(before.scored, loss - rest, 0.0)


def regime_signals(evidence: Evidence, r: Replay) -> dict[str, tuple[Array, str]]:
    """Signals a regime can be told in: what was measured, its rate of change, and what was sent."""
    out: dict[str, tuple[Array, str]] = {}
    period = r.track.period_s
    length = max(5, 2 * round(0.015 / period) + 1)
    for i, channel in enumerate(evidence.channels):
        stem, _ = split_column(channel)
        unit = display_unit(evidence.rig.outputs[channel])
        smooth = savgol_filter(r.track.y[:, i], length, 2)
        rate = savgol_filter(r.track.y[:, i], length, 2, deriv=1, delta=period)
        out[stem] = (from_si(smooth, unit), unit)
        out["velocity" if stem in ("angle", "position") else f"{stem}_rate"] = (from_si(rate, unit), f"{unit}/s")
    for i, name in enumerate(evidence.rig.inputs):
        stem, unit = split_column(name)
        if name not in evidence.rig.optional:
            out[stem] = (from_si(r.track.u[:, i], unit), "" if unit == "1" else unit)
    return out


def regimes(evidence: Evidence, before: list[Replay], after: list[Replay] | None) -> list[Regime]:
    """For each signal the stretch of values that holds much more of the gap than of the time, best first."""
    gaps = [_excess(b, after[i] if after else None, evidence.noise) for i, b in enumerate(before)]
    gap = np.concatenate([g[b.scored] for g, b in zip(gaps, before, strict=True)])
    total = gap.sum()
    if total <= 0.0:
        return []
    found = []
    tables = [regime_signals(evidence, b) for b in before]
    for name in tables[0]:
        x = np.concatenate([t[name][0][b.scored] for t, b in zip(tables, before, strict=True)])
        edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, BINS + 1)))
        if len(edges) < 4:
            continue
        place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
        energy = np.bincount(place, gap, len(edges) - 1) / total
        time = np.bincount(place, minlength=len(edges) - 1) / len(x)
        best = max(((energy[i:j].sum() - time[i:j].sum(), i, j) for i in range(len(energy))
                    for j in range(i + 1, len(energy) + 1)), key=lambda b: b[0])
        gain, i, j = best
        if gain >= CONCENTRATED:
            found.append((gain, Regime(name, float(edges[i]), float(edges[j]), tables[0][name][1],
                                       float(min(max(energy[i:j].sum(), 0.0), 1.0)), float(time[i:j].sum()))))
    return [r for _, r in sorted(found, key=lambda f: -f[0])[:4]]


def frequency_band(before: list[Replay], after: list[Replay] | None, noise: Array) -> list[float]:
    """Band in Hz that holds the middle 80 % of the gap's power."""
    power, axis = None, None
    for i, b in enumerate(before):
        n = min(len(b.track), max(256, round(8.0 / b.track.period_s)))
        axis, here = welch(b.residual / noise, 1.0 / b.track.period_s, nperseg=n, axis=0, detrend="constant")
        here = here.sum(axis=1)
        if after is not None:
            here = here - welch(after[i].residual / noise, 1.0 / b.track.period_s, nperseg=n, axis=0)[1].sum(axis=1)
        here = np.maximum(here, 0.0)
        power = here if power is None or len(power) != len(here) else power + here
    if power is None or axis is None or power.sum() <= 0.0:
        return []
    share = np.cumsum(power[1:]) / power[1:].sum()
    return [float(axis[1:][np.searchsorted(share, 0.1)]), float(axis[1:][min(np.searchsorted(share, 0.9),
                                                                           len(share) - 1)])]


def spectrum_peaks(before: list[Replay], noise: Array, count: int = 3) -> tuple[float, ...]:
    """Strongest lines of the gap, Hz, resolved to a fraction of 1/duration."""
    b = max(before, key=lambda r: len(r.track))
    r = (b.residual / noise) * np.hanning(len(b.track))[:, None]
    n = 1 << (4 * len(b.track) - 1).bit_length()
    power = (np.abs(np.fft.rfft(r, n, axis=0)) ** 2).sum(axis=1)
    axis = np.fft.rfftfreq(n, b.track.period_s)
    power[axis < 0.5] = 0.0
    smooth = np.convolve(power, np.ones(401) / 401, "same")
    contrast = power / (smooth + 1e-12 * power.max() + 1e-300)
    peaks = []
    for _ in range(count):
        k = int(np.argmax(contrast * np.sqrt(power)))
        peaks.append(float(axis[k]))
        contrast[max(0, k - 60) : k + 60] = 0.0
    return tuple(peaks)


def worst_windows(before: list[Replay], budget: Budget, count: int = 3) -> list[list[float]]:
    """The held-out windows with the largest gap, s within their recording."""
    losses, at, spans = budget.channel_losses(budget.baseline.absolutes), 0, []
    for b in before:
        for w in b.windows:
            first = b.track.first
            spans.append((float(losses[at]), [(first + w.start) * b.track.period_s,
                                              (first + w.stop) * b.track.period_s]))
            at += 1
    return [s for _, s in sorted(spans, key=lambda e: -e[0])[:count]]
