"""A cart on its rail with friction that its model lacks, recorded in a moment and diagnosed in two
seconds."""

from pathlib import Path

import numpy as np
from virtual_recordings import virtual_recording

from pamid.model.registry import effects, rig_named
from pamid.recording.recording import read_recording, write_recording
from pamid.simulation.data_split import DataSplit, split_recordings

RIG = str(Path(__file__).parents[2] / "data" / "rigs" / "cart.py")
FEW = ("coulomb-friction", "viscous-friction", "quadratic-drag", "dead-time", "linear-stiffness")
PERIOD_S = 0.01


def record_cart(
    folder: Path, planted: tuple[str, ...] = ("coulomb-friction",), seconds: float = 9.0
) -> Path:
    """Recording of a cart that is pushed to and fro, with these effects; its path."""
    random, count = np.random.default_rng(3), round(seconds / 0.3)
    push = np.repeat(random.choice([-1.0, 1.0], count) * random.uniform(2.0, 6.0, count), 30)
    sent, path = {"force_n": push}, folder / "rec.csv"
    write_recording(folder / "push.csv", PERIOD_S * np.arange(len(push)), sent)
    return virtual_recording(RIG, sent, PERIOD_S, *planted, true={"mass_kg": 1.2}, path=path).path


def cart_evidence(recording: Path) -> DataSplit:
    return split_recordings(rig_named(RIG), [read_recording(recording)], [])


def others() -> list[str]:
    """Options that leave all but a few effects out of the catalogue."""
    return [word for name in effects() if name not in FEW for word in ("--without", name)]
