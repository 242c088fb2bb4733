"""Logger between the sensors of a machine and the recording.

A plain logger samples evenly, its noise is white, and every column has a fine converter. Real ones
do worse: noise has a memory, the clock jitters, a gauge is read in coarse steps through a
calibration table, and recording starts while the machine is already moving.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pamid.base.arrays import Array

CORRELATIONS = (0.3, 0.95)
JITTERS = (0.02, 0.3)  # log-uniform
WARM_UPS = (0.05, 0.2)  # share of the recording
GAUGE_SHARE = 0.5  # of the recordings
GAUGE_STEPS = (50.0, 500.0)  # log-uniform: a float gauge in a tank up to a 9-bit converter
GAUGE_BENDS = (0.2, 0.6)


@dataclass(frozen=True)
class Logger:
    """The logger of a case; plain by default.

    correlation  of the noise of a reading with that of the sample before
    jitter       standard deviation of the sampling instants, share of the sampling period
    warm_up_s    time that the machine runs before the recording starts, s
    gauge        which reading has a coarse gauge: its place among the readings, 0 to 1
    gauge_steps  resolution of that gauge: steps over the range of the reading; 0 for no gauge
    gauge_bend   calibration curve: slope at the upper end minus slope at the lower end, in mean
                 slopes
    """

    correlation: float = 0.0
    jitter: float = 0.0
    warm_up_s: float = 0.0
    gauge: float = 0.0
    gauge_steps: float = 0.0
    gauge_bend: float = 0.0

    def noise(self, random: np.random.Generator, shape: int | tuple[int, int]) -> Array:
        """Noise of unit variance along the first axis: x[k] = a x[k-1] + sqrt(1 - a^2) w[k]."""
        white = random.standard_normal(shape)
        if self.correlation == 0.0:
            return white
        # the first sample has unit variance already: the noise is stationary from the start
        fresh = np.sqrt(1.0 - self.correlation**2)
        coloured = white.copy()
        for k in range(1, len(white)):
            coloured[k] = self.correlation * coloured[k - 1] + fresh * white[k]
        return coloured

    def delays(self, random: np.random.Generator, count: int) -> Array:
        """Delay of each sample in sampling periods, within three standard deviations, so that
        samples keep their order."""
        if self.jitter == 0.0:
            return np.zeros(count)
        return self.jitter * np.clip(random.standard_normal(count), -3.0, 3.0)

    def gauged(self, readings: list[str]) -> str:
        """The reading with the coarse gauge; "" if there is none."""
        if self.gauge_steps == 0.0 or not readings:
            return ""
        return readings[min(int(self.gauge * len(readings)), len(readings) - 1)]

    def read_by_gauge(self, x: Array, low: float, high: float) -> Array:
        """A reading behind the gauge: converted in even steps along the calibration curve

            g(s) = s + bend s (s - 1) / 2,  s = (x - low) / (high - low),

        and turned back by its inverse, so that the steps of the reading are uneven. Beyond its
        range the curve goes on in straight lines."""
        half = 0.5 * self.gauge_bend
        s = (x - low) / (high - low)
        inside = np.clip(s, 0.0, 1.0)
        below, above = np.minimum(s, 0.0), np.maximum(s - 1.0, 0.0)
        curve = (
            inside + half * inside * (inside - 1.0) + (1.0 - half) * below + (1.0 + half) * above
        )
        step = 1.0 / self.gauge_steps
        shown = np.floor(curve / step + 0.5) * step
        inside = np.clip(shown, 0.0, 1.0)
        below, above = np.minimum(shown, 0.0), np.maximum(shown - 1.0, 0.0)
        root = np.sqrt((1.0 - half) ** 2 + 4.0 * half * inside)
        inverse = 2.0 * inside / (1.0 - half + root) + below / (1.0 - half) + above / (1.0 + half)
        return np.asarray(low + (high - low) * inverse)


PLAIN_LOGGER = Logger()


@dataclass(frozen=True)
class Readout:
    """How a run is read: factor of the sensors' usual noise, seed of the noise, logger, and steps
    of the integration per sample, 0 for the machine's usual number."""

    noise: float = 0.0
    seed: int = 0
    logger: Logger = PLAIN_LOGGER
    steps: int = 0


def draw_logger(random: np.random.Generator, seconds: float) -> Logger:
    """A logger: coloured noise, jittering clock, start in motion; half with a coarse gauge."""
    u = random.random(7)
    low, high = GAUGE_BENDS
    return Logger(
        correlation=_even(CORRELATIONS, u[0]),
        jitter=_log_even(JITTERS, u[1]),
        warm_up_s=seconds * _even(WARM_UPS, u[2]),
        gauge=float(u[3]),
        gauge_steps=_log_even(GAUGE_STEPS, u[5]) if u[4] < GAUGE_SHARE else 0.0,
        gauge_bend=float(np.sign(u[6] - 0.5)) * _even((low, high), abs(2.0 * u[6] - 1.0)),
    )


def _even(between: tuple[float, float], u: float) -> float:
    low, high = between
    return float(low + (high - low) * u)


def _log_even(between: tuple[float, float], u: float) -> float:
    low, high = between
    return float(low * (high / low) ** u)
