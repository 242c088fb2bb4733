"""What every virtual machine here is made of: its clock, its inputs, its sensors.

Plain numpy, nothing of pamid: the truth may share no line with what is to find it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

NOTHING = "nothing"
Columns = dict[str, np.ndarray]
Rates = Callable[[list[float], list[float], float], Sequence[float]]
Control = Callable[[list[float], list[float]], list[float]]


@dataclass(frozen=True)
class Stranger:
    """A machine: what its rig lacks, what would be a right answer, and its recordings.

    families: those of which one is right; none where nothing is missing (`lacks` is NOTHING) or
    where no effect of the catalogue is. ports: where, of the rig's. records: of the machine with
    what its rig lacks times 1.0, or 0.0: its ordinary roughness alone. at_rest: nothing moves then.
    """

    name: str
    lacks: str
    families: tuple[str, ...]
    ports: tuple[str, ...]
    rig: str
    records: Callable[[float], list[Columns]]
    at_rest: bool = False

    @property
    def can_be_whole(self) -> bool:
        return self.lacks != NOTHING and not self.at_rest


def free_run(
    rates: Rates,
    start: Sequence[float],
    inputs: np.ndarray,
    period_s: float,
    fine: int,
    held: bool = True,
    control: Control | None = None,
) -> np.ndarray:
    """States at every sample (samples x states), by Runge-Kutta in `fine` steps a sample.

    inputs: samples x inputs, held over the sample or linear to the next. With `control` they are
    what is wanted; it makes of a row and the states what is sent, which is written over them.
    """
    rows = np.asarray(inputs, float).reshape(len(inputs), -1).tolist()
    x, h, seen = list(map(float, start)), period_s / fine, []
    for k, row in enumerate(rows):
        seen.append(x)
        if control is not None:
            row = rows[k] = control(row, x)
            inputs.reshape(len(inputs), -1)[k] = row
        after = row if held else rows[min(k + 1, len(rows) - 1)]
        for i in range(fine):
            t = (k + i / fine) * period_s

            def at(
                y: list[float],
                share: float,
                row: list[float] = row,
                after: list[float] = after,
                t: float = t,
                i: int = i,
            ) -> Sequence[float]:
                part = (i + share) / fine
                u = [a + part * (b - a) for a, b in zip(row, after, strict=True)]
                return rates(y, u, t + share * h)

            k1 = at(x, 0.0)
            k2 = at([a + 0.5 * h * b for a, b in zip(x, k1, strict=True)], 0.5)
            k3 = at([a + 0.5 * h * b for a, b in zip(x, k2, strict=True)], 0.5)
            k4 = at([a + h * b for a, b in zip(x, k3, strict=True)], 1.0)
            x = [
                a + h / 6.0 * (b + 2.0 * c + 2.0 * d + e)
                for a, b, c, d, e in zip(x, k1, k2, k3, k4, strict=True)
            ]
    return np.array(seen)


# ---- inputs --------------------------------------------------------------------------------------


def levels(
    random: np.random.Generator, samples: int, hold: tuple[int, int], low: float, high: float
) -> np.ndarray:
    """Random levels, each held for a random number of samples."""
    out = np.empty(samples)
    k = 0
    while k < samples:
        n = int(random.integers(hold[0], hold[1] + 1))
        out[k : k + n] = random.uniform(low, high)
        k += n
    return out


def multisine(
    random: np.random.Generator, time: np.ndarray, low_hz: float, high_hz: float, lines: int
) -> np.ndarray:
    """Sines of random phase, evenly spread, of unit standard deviation."""
    wave = sum(
        np.sin(2.0 * np.pi * f * time + random.uniform(0.0, 2.0 * np.pi))
        for f in np.linspace(low_hz, high_hz, lines)
    )
    return np.asarray(wave / np.std(wave))


def swept(time: np.ndarray, low_hz: float, high_hz: float) -> np.ndarray:
    """A sine whose frequency rises in a straight line over the record."""
    whole = time[-1]
    return np.sin(2.0 * np.pi * (low_hz + 0.5 * (high_hz - low_hz) * time / whole) * time)


def clock(samples: int, period_s: float) -> np.ndarray:
    """Times of the samples, s."""
    return np.arange(samples) * period_s


# ---- sensors and roughness -----------------------------------------------------------------------


def quantised(signal: np.ndarray, step: float) -> np.ndarray:
    """As a converter reads it."""
    return np.round(np.asarray(signal) / step) * step


def read(
    random: np.random.Generator,
    signal: np.ndarray,
    noise: float,
    step: float = 0.0,
    drift: float = 0.0,
) -> np.ndarray:
    """A sensor's reading: white noise, a zero that walks by `drift` over the record, steps."""
    n = len(signal)
    walk = drift * np.sin(np.linspace(0.0, 2.2, n))
    seen = signal + random.normal(0.0, noise, n) + walk
    return quantised(seen, step) if step else seen


def rough(
    random: np.random.Generator, low: float, high: float, share: float
) -> Callable[[float], float]:
    """A factor about 1 that waves smoothly by `share` (one standard deviation) over a map."""
    phase = random.uniform(0.0, 2.0 * np.pi, 3)
    weight = random.normal(0.0, 1.0, 3)
    weight *= share * np.sqrt(2.0) / np.linalg.norm(weight)
    turns = 2.0 * np.pi * np.array([0.6, 1.3, 2.1]) / (high - low)
    parts = list(zip(weight.tolist(), turns.tolist(), phase.tolist(), strict=True))

    def factor(value: float) -> float:
        return 1.0 + sum(w * float(np.sin(k * value + p)) for w, k, p in parts)

    return factor
