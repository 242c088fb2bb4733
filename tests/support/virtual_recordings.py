"""What a virtual machine records of what it is sent."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.model.rig import Rig
from pamid.recording.recording import Recording, read_recording, recording_of, write_recording
from pamid.simulation.virtual_rig import simulate_virtual_rig


def virtual_recording(
    rig: str | Rig,
    sent: Mapping[str, NDArray[Any]],
    period_s: float,
    *effects: str,
    true: dict[str, float] | None = None,
    noise: float = 1.0,
    seed: int = 1,
    path: Path | None = None,
) -> Recording:
    """Of a machine with these effects whose parameters are the data sheet's but for the true ones,
    its noise by seed. With a path, as a file there."""
    time = period_s * np.arange(len(next(iter(sent.values()))))
    made = simulate_virtual_rig(rig, recording_of(time, sent), effects, {}, true or {}, noise, seed)
    if path is None:
        return recording_of(time, made.columns, made.meta)
    write_recording(path, time, made.columns, made.meta)
    return read_recording(path)
