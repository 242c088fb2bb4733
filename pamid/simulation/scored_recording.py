"""Errors of models in a channel of a recording: the row that `pamid fit`, `pamid score` and
`pamid report` share."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pamid.base.arrays import Array
from pamid.base.metrics import mae, rms
from pamid.base.schemas.score_file import RecordingError

REPLAYED, IN_LOOP = "replay", "loop"


def recording_error(
    recording: str,
    known: Mapping[str, float],
    comparison: str,
    channel: str,
    measured: Array,
    models: Mapping[str, Array | None],
) -> RecordingError:
    """A row from the scored samples (n,) of a channel, in its unit; a model that became unstable
    is None or not finite."""
    stable = {
        name: values if values is not None and bool(np.isfinite(values).all()) else None
        for name, values in models.items()
    }
    return RecordingError(
        recording=recording,
        known=dict(known),
        comparison=comparison,
        channel=channel,
        samples=len(measured),
        mae={n: None if v is None else mae(measured, v) for n, v in stable.items()},
        rms={n: None if v is None else rms(measured, v) for n, v in stable.items()},
    )
