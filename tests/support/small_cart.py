"""A cart on its rail with friction that its model lacks, recorded in a moment and diagnosed in two
seconds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pamid.model.registry import effects, rig_named
from pamid.recording.recording import read_recording, write_recording
from pamid.simulation.data_split import DataSplit, split_recordings
from pamid.simulation.virtual_rig import simulate_virtual_rig

RIG = str(Path(__file__).parents[2] / "data" / "rigs" / "cart.py")
FEW = ("coulomb-friction", "viscous-friction", "quadratic-drag", "dead-time", "linear-stiffness")
PERIOD_S = 0.01


def record_cart(
    folder: Path, planted: tuple[str, ...] = ("coulomb-friction",), seconds: float = 9.0
) -> Path:
    """Recording of a cart that is pushed to and fro, with these effects; its path."""
    random, count = np.random.default_rng(3), round(seconds / 0.3)
    push = np.repeat(random.choice([-1.0, 1.0], count) * random.uniform(2.0, 6.0, count), 30)
    time = PERIOD_S * np.arange(len(push))
    write_recording(folder / "push.csv", time, {"force_n": push})
    made = simulate_virtual_rig(
        RIG, read_recording(folder / "push.csv"), planted, {}, {"mass_kg": 1.2}, 1.0, 1
    )
    write_recording(folder / "rec.csv", time, made.columns, made.meta)
    return folder / "rec.csv"


def cart_evidence(recording: Path) -> DataSplit:
    return split_recordings(rig_named(RIG), [read_recording(recording)], [])


def others() -> list[str]:
    """Options that leave all but a few effects out of the catalogue."""
    return [word for name in effects() if name not in FEW for word in ("--without", name)]
