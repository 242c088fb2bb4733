"""Which columns of a recording are sent, not measured: they may stand still, jump, and sit at their
limits, which would be faults of a sensor.

By the rig, where it knows the column; else by a word of the name (`target_rpm`), or by the values:
what is held changes by jumps with standstills between, and by more than a converter's step. A
sensor that froze stands still now and then, and moves from sample to sample between.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pamid.ingest.channel_words import names_command
from pamid.model.rig import Rig
from pamid.recording.held_signal import held_by_jumps, stands
from pamid.recording.recording import Recording, match_column

# how columns begin that are sent, beside the words of `names_command`
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
    called = name.startswith(SENT) or names_command(name)
    return called or stands(values) or held_by_jumps(values)
