"""Does a signal stay at levels and jump between them, as what is sent does and no sensor?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pamid.recording.file_checks import TINY
from pamid.recording.noise import quantisation_step

ALONE = 0.9  # of the changes have a standstill before and after
MAX_SMALLEST_STEPS = 0.5  # of the changes at most: else it is a coarse sensor that creeps
FEWEST_CHANGES = 5
REGULAR = 0.8  # of the standstills last equally long: a sensor that is sampled more slowly
STANDING_STILL = 0.9  # of the time it stands still between jumps
WIDE_STEP = 0.05  # of its range: what moves in steps goes so far


def held_by_jumps(values: NDArray[np.float64]) -> bool:
    """Do the values (n,) jump between standstills, after times that differ, and by more
    than a step of a converter? (After equal times: a sensor that is sampled more slowly.)"""
    values = values / max(float(np.abs(values).max()), TINY)  # the largest numbers have no sums
    steps = np.abs(np.diff(values))
    moved = np.flatnonzero(steps > 0.0)
    if moved.size < FEWEST_CHANGES:
        return False
    alone = np.diff(moved, prepend=-2) > 1
    alone &= np.append(np.diff(moved), 2) > 1
    pauses = np.diff(moved)
    if np.mean(alone) < ALONE or np.mean(pauses == np.median(pauses)) >= REGULAR:
        return False
    jumps = steps[moved]
    small = 1.5 * max(quantisation_step(values), float(jumps.min()))
    return float(np.mean(jumps <= small)) < MAX_SMALLEST_STEPS


def stands(values: NDArray[np.float64]) -> bool:
    """Do the values (n,) mostly stay, and change now and then?"""
    changed = values[1:] != values[:-1]
    return bool(changed.size) and 0.0 < float(np.mean(changed)) < 1.0 - STANDING_STILL


def moves_in_steps(values: NDArray[np.float64]) -> bool:
    """Does a signal mostly stay, and go far where it goes? What was sent does; a slow sensor of few
    bits stays as well, and goes by a bit. values (n,) without NaN."""
    if not stands(values):
        return False
    moves = np.abs(np.diff(values))
    return bool(np.median(moves[moves > 0.0]) > WIDE_STEP * np.ptp(values))
