"""How alike a recorded signal and a model's are, whatever their levels, units and trends."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pamid.recording.noise import noise_level

Array = NDArray[np.float64]

BLIND_NOISE = 5.0  # times the noise: what a reading strays beyond the zero where it ends
BLIND_SHARE = 0.1  # of the time the model is on the side that the reading never shows
CORRELATION_BLOCKS = 20


def shapes(table: Array) -> Array:
    """Every column block by block, without level and trend: (columns, blocks, samples)."""
    size = max(50, len(table) // CORRELATION_BLOCKS)
    size = min(size, len(table))
    blocks = table[: len(table) // size * size].T.reshape(table.shape[1], -1, size)
    slope = np.linspace(-1.0, 1.0, size)
    slope /= np.sqrt(slope @ slope)
    level = blocks - blocks.mean(axis=2, keepdims=True)
    return np.asarray(level - (level @ slope)[:, :, None] * slope)


def correlation(a: Array, b: Array) -> float:
    """Of two arrays without level, 0 where one of them rests."""
    size = math.sqrt(float((a * a).sum()) * float((b * b).sum()))
    return float((a * b).sum()) / size if size > 0.0 else 0.0


def blind_sides(y: Array, model: Array) -> Array:
    """Per column: 1 or -1 where a reading shows this side of zero alone, though the model goes to
    both, and the model's size runs more like it than the model or its opposite; 0 elsewhere."""
    edge = BLIND_NOISE * noise_level(y)
    way = np.where((y > -edge).all(axis=0), 1.0, np.where((y < edge).all(axis=0), -1.0, 0.0))
    sides = [np.mean(way * side * model > edge, axis=0) for side in (1.0, -1.0)]
    ours, theirs, sizes = shapes(y), shapes(model), shapes(np.abs(model))
    like, sized = (
        np.array([correlation(a, b) for a, b in zip(ours, other, strict=True)])
        for other in (theirs, sizes)
    )
    return np.where((np.minimum(*sides) >= BLIND_SHARE) & (way * sized > np.abs(like)), way, 0.0)
