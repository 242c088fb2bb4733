"""A raw log as the PC of a test bench writes it, made from a recording: `python data/bench_log.py
REC.csv LOG.csv`.

Semicolons and decimal commas, Windows encoding, a preamble, German names, a row of units, absolute
pressures in bar, and a clock in milliseconds that is read when the PC gets round to it: 0.5 ms late
on average, sometimes several.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd

SEED = 5
LATE_MS = 0.5
ATMOSPHERE_KPA = 101.325
#: column of the recording -> name and unit in the log, factor and offset, digits
COLUMNS = {
    "reference_deg": ("Sollwinkel", "°", 1.0, 0.0, 3),
    "angle_deg": ("Winkel", "°", 1.0, 0.0, 3),
    "pressure_1_kpa": ("Druck Muskel 1", "bar", 0.01, ATMOSPHERE_KPA, 4),
    "pressure_2_kpa": ("Druck Muskel 2", "bar", 0.01, ATMOSPHERE_KPA, 4),
    "command": ("Stellgröße", "-", 1.0, 0.0, 4),
}
PREAMBLE = ("Prüfstand Gelenk 1", "Messung 17;geregelt", "")


def main(recording: Path, log: Path) -> None:
    """Write the log of a recording of the rig one-dof."""
    table = pd.read_csv(recording)
    late = np.random.default_rng(SEED).exponential(LATE_MS, len(table))
    stamps = np.maximum.accumulate(1000.0 * table["time_s"].to_numpy() + late)
    cells = [[f"{stamp:.3f}" for stamp in stamps]]
    for column, (_, _, factor, offset, digits) in COLUMNS.items():
        cells.append(
            [f"{value:.{digits}f}" for value in factor * (table[column].to_numpy() + offset)]
        )
    names, units = zip(*((name, unit) for name, unit, *_ in COLUMNS.values()), strict=True)
    rows = [
        *PREAMBLE,
        ";".join(("Zeit", *names)),
        ";".join(("ms", *units)),
        *(";".join(row).replace(".", ",") for row in zip(*cells, strict=True)),
    ]
    log.write_bytes("".join(f"{row}\r\n" for row in rows).encode("cp1252"))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
