"""Inputs that change no output of the data sheet's model by more than its noise."""

from __future__ import annotations

import numpy as np

from pamid.base.units import from_si, split_column
from pamid.checks.channel_quality import QualityIssue
from pamid.checks.sheet_comparison import SheetComparison, recorded_columns
from pamid.model.rig import Rig
from pamid.recording.noise import noise_level
from pamid.recording.recording import Recording
from pamid.simulation.input_effects import IDLE_CURE, idle_text, input_effects
from pamid.simulation.tracks import stated_noise


def idle_input_issues(recording: Recording, rig: Rig, e: SheetComparison) -> list[QualityIssue]:
    """Findings on inputs that move in the recording, but whose term has no effect."""
    noise = np.maximum(noise_level(e.y), stated_noise(rig, e.names))
    issues = []
    for name, change in input_effects(
        e.simulate, e.u, e.inputs, e.model if e.ran else None
    ).items():
        values = e.u[:, e.inputs.index(name)]
        if text := idle_text(name, values, change, e.names, noise):
            symbol = split_column(name)[1]
            low, high = (float(from_si(x, symbol)) for x in (values.min(), values.max()))
            issues.append(
                QualityIssue(
                    "idle-input",
                    recorded_columns((name,), recording),
                    "advice",
                    f"in the data sheet's model of rig {rig.name!r} {text}",
                    IDLE_CURE,
                    (),
                    {"low": low, "high": high, "most_of_noise": float((change / noise).max())},
                )
            )
    return issues
