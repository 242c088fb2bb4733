"""Commanded columns of a recording, as opposed to measured ones.

Commands may stand still, jump, and sit at their limits, which would be faults of a sensor. The rig
decides, if it has the column. Otherwise a word of the name decides (`target_rpm`), or the values. A
held signal changes by jumps with standstills between them, and by more than a converter's step. A
frozen sensor only stands still now and then, and moves from sample to sample in between.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pamid.ingest.channel_words import names_command
from pamid.model.rig import Rig
from pamid.recording.held_signal import held_by_jumps, stands
from pamid.recording.recording import Recording, match_column

# prefixes of commanded columns, in addition to the words of `names_command`
SENT = ("command", "reference", "setpoint", "external")


def sent_columns(recording: Recording, rig: Rig | None) -> set[str]:
    """Inputs and references of the rig; of other columns those with the name or the course of a
    command."""
    columns = recording.columns
    if rig is None:
        return {name for name, values in columns.items() if _seems_sent(name, values)}
    sent = {
        match_column(columns, input_) for input_ in (*rig.inputs, *(k.reference for k in rig.loops))
    }
    known = sent | {match_column(columns, output) for output in rig.outputs}
    guessed = {n for n, values in columns.items() if n not in known and _seems_sent(n, values)}
    return guessed | {name for name in sent if name is not None}


def _seems_sent(name: str, values: NDArray[np.float64]) -> bool:
    called = name.startswith(SENT) or names_command(name)
    return called or stands(values) or held_by_jumps(values)
