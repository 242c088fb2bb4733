"""Starting values from the gap.

The strongest lines of its spectrum, and over the position where a motion port of the general
catalogue offers it; the range of the signals at a port; the plateaus on which a reading rests, and
its extremes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.engine.symbolic.expression import const, substitute
from pamid.engine.symbolic.vocabulary import EquationError, Expr
from pamid.model.effect import Hints
from pamid.recording.noise import plateaus
from pamid.simulation.data_split import DataSplit
from pamid.simulation.replay import Replay, run_windows
from pamid.simulation.windows import Window

SLOWEST_LINE = 0.3  # per correlation time: a slower line of the gap is drift, and no vibration
# points of the spectrum: over which it is averaged, for a line to stand out; of a line's skirts
SPECTRUM_SMOOTH, SKIRTS = 401, 60
SPECTRUM_LINES = 3  # offered to an effect
# parts of the range travelled, for the spectrum over the position; periods within it, for a line to
# differ from a trend
SPATIAL_BINS, FEWEST_PERIODS = 4096, 2.0


def gather_hints(evidence: DataSplit, base: CandidateModel) -> dict[str, Hints]:
    """Hints by port, from the windows of a model's fit, its held-out replays, and the
    recordings."""
    peaks = spectrum_peaks(list(base.replays), evidence.noise)
    reach, periods = _reach(base), _periods(evidence, base)
    rests: dict[str, set[tuple[float, float]]] = {}
    ends: dict[str, set[tuple[float, float]]] = {}
    for port, scale, y in _readings(evidence.channels, base):
        zero, slope = scale
        spacing, level = plateaus(y)
        if spacing > 0.0:
            there = (spacing / abs(slope), (level - zero) / slope)
            rests.setdefault(port, set()).add(there)
        low, high = sorted((float(end) - zero) / slope for end in (y.min(), y.max()))
        ends.setdefault(port, set()).add((low, high))
    rig = base.assembly.rig
    return {
        port: Hints(
            peaks,
            reach.get(port, {}),
            periods.get(port, ()),
            evidence.timescale_s,
            tuple(sorted(rests.get(port, ()))),
            rig.period_s,
            tuple(sorted(ends.get(port, ()))),
        )
        for port in rig.ports
    }


def _readings(
    channels: tuple[str, ...], base: CandidateModel
) -> Iterator[tuple[str, tuple[float, float], Array]]:
    """Readings with an output that is a straight line over them: port, zero and slope of that line,
    and the recorded output in each recording (SI)."""
    traced = base.assembly.traced
    lines = [
        (q.port, channels.index(name), scale)
        for q in traced.passages
        for name, output in traced.outputs.items()
        if name in channels and (scale := _scale(output, q.result))
    ]
    for track in base.fit.problem.tracks:
        for port, channel, scale in lines:
            if track.seen[channel]:
                yield port, scale, track.y[:, channel]


def _scale(output: Expr, reading: Expr) -> tuple[float, float] | None:
    """Zero and slope of an output that is a straight line over a reading, else None. A sensor that
    counts above the room's temperature has its slope in kelvin."""
    try:
        at = [substitute([output], {reading: const(x)})[0] for x in (0.0, 1.0, 2.0)]
    except EquationError:  # not defined there, as a reciprocal is not at zero: no straight line
        return None
    if any(value.op != "const" for value in at):
        return None
    zero, at_unit, two = (value.value for value in at)
    slope = at_unit - zero
    # Three points distinguish a straight line from a curve with a single bend.
    straight = math.isclose(zero + two, 2.0 * at_unit)
    return (zero, slope) if straight and slope != 0.0 else None


def _reach(base: CandidateModel) -> dict[str, dict[str, float]]:
    """Largest magnitudes where windows begin: there the states are near those of the recording;
    later on a model without a limit runs past it."""
    assembly, fit = base.assembly, base.fit
    wanted = {
        f"{q.where}.{name}": (q.port, name, value)
        for q in assembly.traced.passages
        for name, value in q.signals
        if isinstance(value, Expr)
    }
    program = assembly.program_with({key: value for key, (_, _, value) in wanted.items()})
    places = [
        (t, fit.problem.windows(t), x) for t, x in zip(fit.problem.tracks, fit.starts, strict=True)
    ]
    places += [(r.track, list(r.windows), r.entered) for r in base.replays]
    seen = [
        run_windows(
            program,
            assembly,
            fit.p,
            track,
            [Window(w.start, w.start + 1) for w in windows],
            x,
            fit.stepping,
        )
        for track, windows, x in places
    ]
    most = np.abs(np.concatenate(seen)).max(axis=0)[len(program.outputs) - len(wanted) :]
    reach: dict[str, dict[str, float]] = {}
    for (port, name, _), far in zip(wanted.values(), most, strict=True):
        there = reach.setdefault(port, {})
        there[name] = max(there.get(name, 0.0), float(far))
    return reach


def spectrum_peaks(before: list[Replay], noise: Array) -> tuple[float, ...]:
    """Strongest lines of the gap, Hz, resolved to a fraction of 1/duration."""
    # Resolution is inverse to the duration, so that the longest recording locates a line best.
    b = max(before, key=lambda r: len(r.track))
    r = (b.residual / noise) * np.hanning(len(b.track))[:, None]
    n = 1 << (4 * len(b.track) - 1).bit_length()  # padded: at least four points per 1/duration
    power = (np.abs(np.fft.rfft(r, n, axis=0)) ** 2).sum(axis=1)
    axis = np.fft.rfftfreq(n, b.track.period_s)
    power[axis * b.track.timescale_s < SLOWEST_LINE] = 0.0
    # odd; of a short recording all there is
    contrast = _contrast(power, min(SPECTRUM_SMOOTH, len(power) - 1 + len(power) % 2))
    peaks = []
    for _ in range(SPECTRUM_LINES):
        # Contrast alone picks narrow lines in an empty band, power alone picks broad humps.
        k = int(np.argmax(contrast * np.sqrt(power)))
        peaks.append(float(axis[1] * (k + _off_centre(power[max(0, k - 1) : k + 2]))))
        contrast[max(0, k - SKIRTS) : k + SKIRTS] = 0.0  # the line with the window's skirts
    return tuple(peaks)


def _off_centre(power: Array) -> float:
    """Offset of a line's top from the middle of three points, in their distance.

    From the parabola through the logarithms, which a Hann window's line nearly is (Gasior and
    Gonzalez 2004, AIP Conference Proceedings 732:276).
    """
    if len(power) < 3 or not (power > 0.0).all():
        return 0.0
    before, top, after = np.log(power)
    bend = before - 2.0 * top + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0.0 else 0.0


def _periods(evidence: DataSplit, base: CandidateModel) -> dict[str, tuple[float, ...]]:
    """Spatial periods of the fit's residual, by general motion port that offers a position."""
    assembly, fit = base.assembly, base.fit
    wanted: dict[str, tuple[str, Expr]] = {}
    for q in assembly.traced.passages:
        port, x = assembly.rig.ports[q.port], dict(q.signals).get("position")
        if port.kind == "motion" and port.general and isinstance(x, Expr):
            wanted[q.where] = (q.port, x)
    if not wanted:
        return {}
    positions = base.along_fit([x for _, x in wanted.values()])
    recorded = [_recorded(evidence.channels, base, x) for _, x in wanted.values()]
    parts: list[tuple[Array, Array]] = []  # of every window: positions and weighted residual
    joints = np.cumsum([len(t) for t in fit.problem.tracks])[:-1]
    by_track = np.split(positions, joints)
    for t, x, left in zip(fit.problem.tracks, by_track, fit.residuals, strict=True):
        for k, channel in enumerate(recorded):
            if channel is not None:
                x[:, k] = np.where(np.isfinite(t.y[:, channel]), t.y[:, channel], x[:, k])
        for w in fit.problem.windows(t):
            # A missing sample counts as no gap, which weakens a line but does not shift it.
            r = np.nan_to_num(left[w.start : w.stop] / evidence.noise)
            parts.append((x[w.start : w.stop], r))
    return {
        port: spatial_periods([(x[:, k], r) for x, r in parts])
        for k, (port, _) in enumerate(wanted.values())
    }


def _recorded(channels: tuple[str, ...], base: CandidateModel, position: Expr) -> int | None:
    """The channel that reads this position without a scale, if any does.

    A missing effect acted at the position of the machine, not at that of a model without it. A
    model that is off by a part of a period smears every line.
    """
    traced = base.assembly.traced
    read = {q.result: q.value for q in traced.passages}
    for k, name in enumerate(channels):
        shown = traced.outputs[name]
        if position in (shown, read.get(shown)):
            return k
    return None


def spatial_periods(parts: list[tuple[Array, Array]]) -> tuple[float, ...]:
    """Periods of the strongest lines of a gap over the position, strongest first (its unit).

    parts: positions (samples) and gap (samples x channels), window by window. Up to two
    integrations in time lie between a force and its effect on a reading, and an odd number of them
    turns with the direction. The gap and its first and second difference are therefore averaged
    over the position, once plainly and once with the sign of the motion. The contrasts of all these
    spectra are added.
    """
    x = np.concatenate([x for x, _ in parts])
    low, span = float(x.min()), float(np.ptp(x))
    if not (np.isfinite(span) and span > 0.0) or min(len(x) for x, _ in parts) < 5:
        return ()
    total = np.zeros(2 * SPATIAL_BINS + 1)
    for order in range(3):
        where, turns, gaps = [], [], []
        for x, r in parts:
            d = np.diff(r, order, axis=0)
            rows = slice((order + 1) // 2, (order + 1) // 2 + len(d))
            where.append(x[rows])
            turns.append(np.sign(np.gradient(x))[rows])
            gaps.append(d - d.mean(axis=0))
        at = (SPATIAL_BINS * (np.concatenate(where) - low) / span).astype(np.int64)
        at = np.minimum(at, SPATIAL_BINS - 1)
        gap, turn = np.concatenate(gaps), np.concatenate(turns)
        for channel in np.hstack([gap, gap * turn[:, None]]).T:
            total += _spatial_contrast(at, channel)
    frequency = np.arange(len(total)) / (4.0 * span)
    step = np.median(np.concatenate([np.abs(np.diff(x)) for x, _ in parts]))
    total[(frequency < FEWEST_PERIODS / span) | (2.0 * frequency * step > 1.0)] = 0.0
    periods = []
    for _ in range(SPECTRUM_LINES):
        k = int(np.argmax(total))
        if total[k] <= 0.0:
            break
        periods.append(float(1.0 / frequency[k]))
        total[max(0, k - 8) : k + 9] = 0.0
    return tuple(periods)


def _contrast(power: Array, width: int) -> Array:
    """Power against the mean around it: a broad hump, however strong, is no line."""
    around = np.convolve(power, np.ones(width) / width, "same")
    return np.asarray(power / (around + 1e-12 * power.max() + 1e-300))


def _spatial_contrast(at: NDArray[np.int64], values: Array) -> Array:
    """Power over spatial frequency, in quarters of 1/range, against its surroundings."""
    bins = SPATIAL_BINS
    # The mean count in the denominator shrinks bins with few samples, which would dominate the
    # spectrum by their noise.
    count = np.bincount(at, minlength=bins)
    mean = np.bincount(at, values, bins) / (count + max(1.0, count.mean()))
    power = np.abs(np.fft.rfft(mean * np.hanning(bins), 4 * bins)) ** 2
    return _contrast(power, 201)[: 2 * bins + 1]
