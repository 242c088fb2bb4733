"""Which columns of a recording are sent, not measured: they may stand still, jump, and sit at their
limits, which would be faults of a sensor.

By the rig, where it knows the column; else by a word of the name (`target_rpm`), or by the values:
what is held changes by jumps with standstills between, and by more than a converter's step. A
sensor that froze stands still now and then, and moves from sample to sample between.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pamid.ingest.channel_words import says_sent
from pamid.model.rig import Rig
from pamid.recording.file_checks import TINY
from pamid.recording.noise import quantisation_step
from pamid.recording.recording import Recording, match_column

STEPPED = 0.9  # of the time a column stands still between jumps: it is sent
ALONE = 0.9  # of the changes have a standstill before and after
OF_ONE_STEP = 0.5  # of the changes at most: else it is a coarse sensor that creeps
FEWEST_CHANGES = 5
REGULAR = 0.8  # of the standstills last equally long: `sampled_slowly`
# how columns begin that are sent, beside the words of `says_sent`
SENT = ("command", "reference", "setpoint", "external")


def sent_columns(recording: Recording, rig: Rig | None) -> set[str]:
    """The rig's inputs and references; of what it does not know, what is called so or held."""
    columns = recording.columns
    if rig is None:
        return {name for name, values in columns.items() if _seems_sent(name, values)}
    sent = {match_column(columns, one) for one in (*rig.inputs, *(k.reference for k in rig.loops))}
    known = sent | {match_column(columns, one) for one in rig.outputs}
    beside = {n for n, values in columns.items() if n not in known and _seems_sent(n, values)}
    return beside | {name for name in sent if name is not None}


def _seems_sent(name: str, values: NDArray[np.float64]) -> bool:
    called = name.startswith(SENT) or says_sent(name)
    return called or _stands(values) or held_by_jumps(values)


def _stands(values: NDArray[np.float64]) -> bool:
    return 0.0 < float(np.mean(values[1:] != values[:-1])) < 1.0 - STEPPED


def held_by_jumps(values: NDArray[np.float64]) -> bool:
    """Do the values (n,) jump from one standstill to the next, after times that differ, and by more
    than one step of a converter? (After equal times: a sensor that is sampled more slowly.)"""
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
    return float(np.mean(jumps <= small)) < OF_ONE_STEP
