"""Measured columns that repeat the signal of an input: exported twice, or read before the machine.

Such an echo is a scaled, shifted, slightly delayed or smoothed input with nothing but white noise
added. A stiff, fast machine looks the same. An echo is therefore only reported if the rig's model
could not follow the input so closely and so soon. The model is tried at the data sheet's parameters
and at `ECHO_DRAWS` others within `PRIOR_REACH` of their prior spreads. It runs from the state of
the first readings, because from any other state it would move there first.

    y(t) = offset + gain * F(u)(t - delay),  F: first-order lag, lag and delay up to the correlation
                                             time of u
    echo of a recording   residual below ECHO_NOISE of the noise or ECHO_CLOSE of the motion
    echo by a model       residual below LEAST_EXPLAINED of the motion, at most SOONER times as late
"""

from __future__ import annotations

import numpy as np

from pamid.base.arrays import Array
from pamid.intake.checks.findings import QualityIssue, issue
from pamid.intake.checks.sheet_comparison import (
    OPENING_SAMPLES,
    SheetComparison,
    recorded_columns,
)
from pamid.model.rig import Rig
from pamid.model.step_rig import StepRig
from pamid.recording.noise import noise_level
from pamid.recording.recording import Recording, match_column
from pamid.simulation.correlation_time import correlation_samples

ECHO_NOISE, ECHO_CLOSE = 1.5, 0.1
LEAST_EXPLAINED = 0.5  # residual over motion: more is not an echo, however large the noise
SOONER = 2.0
UNRELATED = 0.9  # residual over motion without a lag
ECHO_LAGS = 12  # tried, in geometric steps from a quarter of a sample
ECHO_DRAWS, STEPPED_DRAWS = 16, 4  # parameters tried; of a rig that steps by itself
MOST_ECHO_SAMPLES, MOST_STEPPED_ECHO = 4000, 500
PRIOR_REACH = 2.0  # prior spreads


def echoed_inputs(
    recording: Recording, rig: Rig, comparison: SheetComparison
) -> list[QualityIssue]:
    """Findings on measured columns that carry the signal of an input or a reference.

    A controller derives its command from the reading, so inputs of a closed loop are not compared.
    """
    issues = []
    for loop in rig.loops:
        reading = match_column(recording.columns, loop.reading)
        reference = match_column(recording.columns, loop.reference)
        if reading is None or reference is None or reading == reference:
            continue
        y = recording.si(reading)
        if float(np.ptp(y)) > 0.0 and np.array_equal(y, recording.si(reference)):
            issues.append(_issue(reading, reference, 0.0, rig))
    followed = any(recording.has(loop.reference) for loop in rig.loops)
    if recording.loop == "closed" or (followed and recording.loop != "open"):
        return issues
    outputs = recorded_columns(comparison.names, recording)
    inputs = recorded_columns(comparison.inputs, recording)
    for k, output in enumerate(outputs):
        y = comparison.y[:MOST_ECHO_SAMPLES, k]
        noise, motion = float(noise_level(y[:, None])[0]), float(y.std())
        least = min(max(ECHO_NOISE * noise, ECHO_CLOSE * motion), LEAST_EXPLAINED * motion)
        for j, source in enumerate(inputs):
            left, late = closest_echo(comparison.u[:MOST_ECHO_SAMPLES, j], y)
            if left <= least and not _model_echoes(comparison, j, k, SOONER * max(late, 1.0)):
                issues.append(_issue(output, source, left / motion, rig))
                break
    return issues


def closest_echo(u: Array, y: Array, latest: float = np.inf) -> tuple[float, float]:
    """RMS residual of an output after the closest echo of an input, and the delay of the echo.

    u, y: input and output (samples,). latest: largest sum of delay and lag, in samples. Returns
    residual in the unit of y; delay plus lag, in samples.
    """
    size = len(u)
    u, y = u - u[0], y - y.mean()
    if not float(np.ptp(u)) > 0.0 or not float(y.std()) > 0.0:
        return np.inf, 0.0
    most = min(correlation_samples(u)[0], latest)
    best = _delayed_residual(u, y, round(most))
    if best[0] > UNRELATED * float(y.std()):
        return best  # no short lag can turn this into an echo
    for lag in np.geomspace(0.25, max(most, 0.25), ECHO_LAGS):
        kernel = np.exp(-np.arange(min(size, int(8.0 * lag) + 2)) / lag)
        smooth = np.convolve(u, kernel / kernel.sum())[:size]
        left, delay = _delayed_residual(smooth, y, round(max(most - lag, 0.0)))
        best = min(best, (left, delay + lag))
    return best


def _delayed_residual(u: Array, y: Array, most: int) -> tuple[float, float]:
    """RMS residual after gain and offset at the best delay of 0..most samples, and that delay."""
    most = min(most, len(y) // 4)
    a, b = u - u.mean(), y - y.mean()
    size = 2 * len(b)
    product = np.fft.irfft(np.fft.rfft(b, size) * np.fft.rfft(a, size).conj(), size)[: most + 1]
    delay = int(np.argmax(np.abs(product)))
    a, b = a[: len(a) - delay], b[delay:]
    a, b = a - a.mean(), b - b.mean()
    power = float(a @ a)
    gain = float(a @ b) / power if power > 0.0 else 0.0
    return float(np.sqrt(np.mean((b - gain * a) ** 2))), float(delay)


def _model_echoes(comparison: SheetComparison, source: int, output: int, latest: float) -> bool:
    """True if the rig's model follows this input at most `latest` samples late.

    The machine may follow more closely: its gains differ from the data sheet's.
    """
    stepped = isinstance(comparison.assembly.rig, StepRig)
    size, draws = (MOST_STEPPED_ECHO, STEPPED_DRAWS) if stepped else (MOST_ECHO_SAMPLES, ECHO_DRAWS)
    u, random = comparison.u[:size, source], np.random.default_rng(0)
    low, high = comparison.y.min(axis=0), comparison.y.max(axis=0)
    for draw in range(1 + draws):
        # the data sheet, then draws in prior spreads around it, within the bounds
        p = comparison.p.copy()
        for k, b in enumerate(comparison.assembly.parameters if draw else ()):
            if b.fitted and not b.nuisance:
                off = PRIOR_REACH * b.spread * random.uniform(-1.0, 1.0)
                p[k] = np.clip(p[k] * np.exp(off) if b.log else p[k] + off, b.low, b.high)
        model = comparison.follow(p, size)
        if model is None:
            continue
        # an arm that falls soon moves by other forces than the recorded one: also try the samples
        # until the run is outside the range of the readings by more than that range
        gone = (model < 2.0 * low - high) | (model > 2.0 * high - low)
        near = int(gone.any(axis=1).argmax()) if gone.any() else len(model)
        for samples in {len(model), near if near >= OPENING_SAMPLES else len(model)}:
            y = model[:samples, output]
            if closest_echo(u[:samples], y, latest)[0] < LEAST_EXPLAINED * float(y.std()):
                return True
    return False


def _issue(output: str, source: str, share: float, rig: Rig) -> QualityIssue:
    return issue(
        "echo",
        (output, source),
        f"{output} and {source} contain the same signal: after scale, offset and delay they "
        f"differ by {100.0 * share:.2g} % of the motion, but the model of rig {rig.name!r} has "
        "dynamics between them",
        f"Export the measured column as {output}; now it seems to repeat {source}. If a controller "
        f'computes {source} from it, write loop = "closed" below [recording] in the TOML.',
        {"residual_over_motion": share},
        wrong=True,
    )
