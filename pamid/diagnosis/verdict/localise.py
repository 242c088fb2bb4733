"""Place of the gap: regimes (ranges of a signal), frequency band, and windows of time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.metrics import independent_samples
from pamid.base.schemas.diagnosis_file import Regime
from pamid.base.units import (
    NONE,
    display_unit,
    from_si,
    quantity_of,
    quotient,
    size_from_si,
    split_column,
    unit_label,
)
from pamid.base.units import unit as unit_of
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.engine.symbolic.expression import symbols
from pamid.engine.symbolic.vocabulary import Expr
from pamid.model.executable import Executable
from pamid.recording.signal_filters import local_parabola, welch_power
from pamid.simulation.data_split import DataSplit
from pamid.simulation.replay import Replay, run_windows

# kinds of port whose signals state a regime, best first
REGIME_PORTS = ("motion", "actuator-force", "flow")
# kinds whose value is such a signal, too, and what it is called
VALUE_NAMES = {"flow": "flow", "actuator-force": "force"}
# name of an output's rate of change, by the output without its unit
RATE_NAMES = {"angle": "velocity", "position": "velocity"}

# regimes: quantiles of a signal between which they lie; least share of the gap beyond that of the
# time, and what a bound costs of it unless it is zero or the range's end, and a signal less plain
REGIME_BINS, REGIME_GAIN, REGIME_BOUND, REGIME_ORDER = 12, 0.15, 0.01, 0.002
# standard errors of its share of the gap by which a regime holds more of it than of the time
REGIME_ERRORS = 2.0
# stated; share of the samples that makes two of them the same
REGIMES_MOST, REGIME_OVERLAP = 4, 0.5
# correlation times: half of what measured signals are smoothed over, a segment of the spectrum
SMOOTHED, SPECTRUM_SEGMENT = 0.025, 13.0
STILL_SHARE = 0.02  # of the usual speed (95th percentile): a slower motion reverses nothing
BAND_SHARE = 0.8  # of the gap's power inside the band that is stated, its middle
WORST_WINDOWS = 3  # stated


@dataclass(frozen=True)
class _Stretch:
    """A regime with the figures of its choice: gain over its share of the time, and the samples
    inside."""

    regime: Regime
    gain: float
    inside: NDArray[np.bool_]

    def overlap(self, other: _Stretch) -> float:
        """Shared samples over all of both (Jaccard index)."""
        return float((self.inside & other.inside).sum() / (self.inside | other.inside).sum())


def regimes(
    evidence: DataSplit, base: CandidateModel, after: CandidateModel | None
) -> tuple[Regime, ...]:
    """At most a few stretches of values that hold much more of the gap of `base` than of the time,
    best first; of two that hold about the same samples only the better."""
    befores = base.replays
    # squared error per sample, in noise variances, less that with the cause or of noise alone
    excesses = []
    for i, b in enumerate(befores):
        loss = ((b.residual / evidence.noise) ** 2).sum(axis=1)
        rest = (
            ((after.replays[i].residual / evidence.noise) ** 2).sum(axis=1)
            if after
            else float(len(evidence.noise))
        )
        excesses.append((loss - rest)[b.scored])
    gap = np.concatenate(excesses)
    if gap.sum() <= 0.0:
        return ()
    inner, recorded = port_signals(base), recorded_units(evidence)
    tables = [measured_signals(evidence, r) | _followed(base, r, inner, recorded) for r in befores]
    candidates = []
    for place, (name, (_, unit)) in enumerate(tables[0].items()):
        x = np.concatenate([t[name][0][r.scored] for t, r in zip(tables, befores, strict=True)])
        stretch = _stretch(name, unit, x, gap)
        if stretch is not None:
            candidates.append((stretch.gain - REGIME_ORDER * place, stretch))
    best: list[_Stretch] = []
    for _, s in sorted(candidates, key=lambda f: -f[0]):
        new = all(s.overlap(other) <= REGIME_OVERLAP for other in best)
        if len(best) < REGIMES_MOST and new:
            best.append(s)
    return tuple(s.regime for s in best)


def _stretch(name: str, unit: str, x: Array, gap: Array) -> _Stretch | None:
    """The stretch of x with the largest share of the gap beyond its share of the time; None where
    none stands out.

    Zero is always among the edges: forwards and backwards, opening and closing. With n independent
    samples, the share of the gap in a share s of the time has the standard error
    sqrt(s (1 - s) (1 + v) / n), v the squared coefficient of variation of the gap.
    """
    edges = np.unique(
        np.concatenate(
            [
                np.quantile(x, np.linspace(0.0, 1.0, REGIME_BINS + 1)),
                [0.0] if x.min() < 0.0 < x.max() else [],
            ]
        )
    )
    if len(edges) < 4:
        return None
    count = len(edges) - 1
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, count - 1)
    energy = np.concatenate([[0.0], np.cumsum(np.bincount(place, gap, count))]) / gap.sum()
    time = np.concatenate([[0.0], np.cumsum(np.bincount(place, minlength=count))]) / len(x)
    inner = REGIME_BOUND * ((edges != 0.0) & (edges > edges[0]) & (edges < edges[-1]))
    # with c the cumulated gap less the cumulated time, the stretch from edge i to edge j holds
    # c_j - c_i more of the gap than of the time, of which its inner edges cost a little each
    worth = (energy - time - inner)[None, :] - (energy - time + inner)[:, None]
    i, j = np.unravel_index(int(np.argmax(np.triu(worth, 1))), worth.shape)
    share, spent = float(energy[j] - energy[i]), float(time[j] - time[i])
    if share - spent < REGIME_GAIN:
        return None
    varies = 1.0 + float(gap.var() / gap.mean() ** 2)
    samples = independent_samples(x, gap)
    error = np.sqrt(spent * (1.0 - spent) * varies / samples) if samples > 0.0 else np.inf
    if share - spent < REGIME_ERRORS * error:
        return None
    regime = Regime(
        signal=name,
        low=edges[i],
        high=edges[j],
        unit=unit,
        share_of_gap=min(max(share, 0.0), 1.0),
        share_of_time=spent,
    )
    return _Stretch(regime, share - spent, (place >= i) & (place < j))


# ---- signals that can state a regime -----------------------------------------------------------


def measured_signals(evidence: DataSplit, r: Replay) -> dict[str, tuple[Array, str]]:
    """Measured signals, their rates of change, and commands, in the units of their columns: name ->
    (samples, unit)."""
    out: dict[str, tuple[Array, str]] = {}
    period = r.track.period_s
    length = max(5, 2 * round(SMOOTHED * r.track.timescale_s / period) + 1)
    for i, channel in enumerate(evidence.channels):
        stem, unit = split_column(channel)
        rated = quotient(unit, "s")
        y = r.track.y[:, i] if r.seen[i] else r.model[:, i]
        smooth, rate = (local_parabola(y, length, period, order) for order in (0, 1))
        out[stem] = (from_si(smooth, unit), unit_label(unit))
        out[RATE_NAMES.get(stem, f"{stem}_rate")] = (
            size_from_si(rate, unit),
            rated,
        )
    for i, name in enumerate(evidence.rig.inputs):
        stem, unit = split_column(name)
        if name not in evidence.rig.optional:
            out[stem] = (from_si(r.track.u[:, i], unit), unit_label(unit))
    return out


def recorded_units(evidence: DataSplit) -> dict[str, str]:
    """Quantity -> unit in which it, or its integral, was first recorded. Not degC: a temperature
    inside a model may be a difference."""
    units: dict[str, str] = {}
    for symbol in (split_column(name)[1] for name in (*evidence.channels, *evidence.rig.inputs)):
        if quantity_of(symbol) == "dimensionless" or unit_of(symbol).offset:
            continue
        for recorded in (symbol, quotient(symbol, "s")):
            units.setdefault(quantity_of(recorded), recorded)
    return units


@dataclass(frozen=True)
class _PortSignals:
    """Signals at the ports of a model: its equations with these as further outputs, their names and
    units, and the name of the velocity whose sign tells a reversal."""

    program: Executable
    names: tuple[str, ...]
    units: tuple[str, ...]
    velocity: str


def port_signals(base: CandidateModel) -> _PortSignals:
    """Signals that the model offers at its ports, with their flows and efforts; the same signal
    only at its first port, and without its place where all places share it."""
    rig = base.assembly.rig
    signals: dict[Expr, tuple[str, str, list[str]]] = {}
    turning = []
    passages = [q for q in base.assembly.traced.passages if rig.ports[q.port].kind in REGIME_PORTS]
    for q in sorted(passages, key=lambda q: REGIME_PORTS.index(rig.ports[q.port].kind)):
        port = rig.ports[q.port]
        value_signals = [("value", q.value)] if port.kind in VALUE_NAMES else []
        for key, value in (*value_signals, *q.signals):
            if isinstance(value, Expr) and {space for space, _ in symbols([value])} & {
                "state",
                "input",
            }:
                quantity = VALUE_NAMES[port.kind] if key == "value" else port.called.get(key, key)
                name = f"{q.port}_{quantity}"
                first, _, places = signals.setdefault(value, (name, port.unit_of(key), []))
                places += [q.place] if q.place and name == first else []
                turning += [value] if port.kind == "motion" and key == "velocity" else []
    names = {
        value: f"{name}_{places[0]}" if len(places) == 1 else name
        for value, (name, _, places) in signals.items()
    }
    assembly = replace(base.assembly, sensitive=frozenset())
    return _PortSignals(
        assembly.program_with({f"at.{names[value]}": value for value in signals}),
        tuple(names.values()),
        tuple(unit for _, unit, _ in signals.values()),
        names[turning[0]] if turning else "",
    )


def _followed(
    base: CandidateModel,
    r: Replay,
    inner: _PortSignals,
    recorded: Mapping[str, str],
) -> dict[str, tuple[Array, str]]:
    """The signals at the ports along a replay, in the units that quantities were recorded in where
    they were (`recorded`), and the time since the last reversal."""
    outputs = run_windows(
        inner.program, base.assembly, base.fit.p, r.track, r.windows, r.entered, base.fit.stepping
    )
    table = outputs[:, outputs.shape[1] - len(inner.names) :]
    out = {}
    for name, unit, x in zip(inner.names, inner.units, table.T, strict=True):
        shown = recorded.get(quantity_of(unit or NONE), display_unit(unit))
        out[name] = (from_si(x, shown), unit_label(shown))
        if name == inner.velocity:
            # since the velocity last changed its sign; a resting velocity keeps its sign
            moving = np.abs(x) > STILL_SHARE * np.percentile(np.abs(x), 95.0)
            place = np.arange(len(x))
            direction = np.sign(x[np.maximum.accumulate(np.where(moving, place, 0))])
            turned = np.concatenate([[False], direction[1:] * direction[:-1] < 0.0])
            since = place - np.maximum.accumulate(np.where(turned, place, 0))
            out["time_since_reversal"] = (r.track.period_s * since.astype(np.float64), "s")
    return out


# ---- bands and windows -------------------------------------------------------------------------


def frequency_band(
    before: list[Replay], after: list[Replay] | None, noise: Array
) -> tuple[float, ...]:
    """Band in Hz that holds the middle (80 %) of the gap's power, by Welch's periodogram (1967)."""
    power, axis = None, None
    for i, b in enumerate(before):
        n = min(
            len(b.track),
            max(256, round(SPECTRUM_SEGMENT * b.track.timescale_s / b.track.period_s)),
        )
        axis = np.fft.rfftfreq(n, b.track.period_s)
        removable = welch_power(b.residual / noise, n).sum(axis=1)
        if after is not None:
            removable = removable - welch_power(after[i].residual / noise, n).sum(axis=1)
        removable = np.maximum(removable, 0.0)  # a cause that adds power there explains nothing
        power = removable if power is None or len(power) != len(removable) else power + removable
    if power is None or axis is None or power.sum() <= 0.0:
        return ()
    share = np.cumsum(power[1:]) / power[1:].sum()
    outside = round(0.5 * (1.0 - BAND_SHARE), 12)  # on either side
    low, high = np.searchsorted(share, [outside, 1.0 - outside])
    return float(axis[1:][low]), float(axis[1:][min(high, len(share) - 1)])


def worst_windows(before: list[Replay], budget: Budget) -> tuple[tuple[float, float], ...]:
    """The held-out windows with the largest gap, s within their recording."""
    losses = budget.channel_losses(budget.baseline.absolutes)
    spans = [
        ((b.track.first + w.start) * b.track.period_s, (b.track.first + w.stop) * b.track.period_s)
        for b in before
        for w in b.windows
    ]
    ordered = sorted(zip(losses, spans, strict=True), key=lambda e: -e[0])
    return tuple(span for _, span in ordered[:WORST_WINDOWS])
