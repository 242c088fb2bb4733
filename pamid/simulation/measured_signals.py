"""Signals of a model that measured outputs tell by themselves.

The stretch of a coupling with an encoder on either side is the difference of two readings. Where
the model does not follow the machine, what was measured says how large such a signal was, and the
model's own run does not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

COMBINED = 1e-6  # of a signal: what a combination of outputs may leave of it
RUN_WINDOWS = 8  # of a run by which the combination is found


def measured_signals(outputs: Array, signals: Array, measured: Array) -> Array:
    """The signals (samples of `measured` x signals, SI) that are a constant combination of the
    outputs, and a constant, in a model's run; NaN those that are not, and where an output was not
    measured.

    outputs, signals: of the run (samples x each, SI); measured: outputs as recorded (samples x
    outputs, SI).
    """
    regressors = np.column_stack([outputs, np.ones(len(outputs))])
    weights = np.linalg.lstsq(regressors, signals, rcond=None)[0]
    left = np.abs(regressors @ weights - signals).max(axis=0)
    is_combined = left < COMBINED * np.abs(signals).max(axis=0)
    return np.where(is_combined, measured @ weights[:-1] + weights[-1], np.nan)
