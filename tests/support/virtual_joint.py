"""Virtual recordings of the one-dof rig, written and read back as a user's would be."""

from pathlib import Path

import numpy as np

from pamid.recording.recording import Recording, read_recording, write_recording
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.virtual_rig import simulate_virtual_rig

PERIOD_S = 0.003
KNOWN = {"inertia_kg_m2": 0.0896}
#: a specimen that differs from its data sheet by 5-30 %
SPECIMEN = {
    "damping_m2_s": 7.5e-4,
    "scale": 1.1,
    "conductance_in_m3_per_s_pa": 4.2e-9,
    "conductance_out_m3_per_s_pa": 3.5e-9,
    "critical_ratio": 0.38,
    "viscous_n_m_s": 0.08,
    "contraction_0": 0.104,
    "dead_volume_cm3": 7.0,
    "polytropic": 1.15,
}


def excitation(path: Path, seconds: float, seed: int = 1, amplitude_deg: float = 35.0) -> Path:
    """A reference for the closed loop."""
    reference = aprbs(seconds, PERIOD_S, amplitude_deg, seed=seed)
    write_recording(path, np.arange(len(reference)) * PERIOD_S, {"reference_deg": reference})
    return path


def record(
    path: Path,
    seconds: float = 12.0,
    *,
    seed: int = 1,
    known: dict[str, float] | None = None,
    hidden: dict[str, float] | None = None,
    effects: tuple[str, ...] = (),
    columns: tuple[str, ...] = (),
    stated: dict[str, float] | None = None,
) -> Recording:
    """A recording at `path`; columns: only these; stated: what its TOML says is known (default:
    what is)."""
    source = read_recording(excitation(path.with_name(f"{path.stem}-reference.csv"), seconds, seed))
    made = simulate_virtual_rig(
        "one-dof",
        source,
        effects,
        KNOWN if known is None else known,
        SPECIMEN if hidden is None else hidden,
        1.0,
        seed,
    )
    kept = {k: v for k, v in made.columns.items() if not columns or k in columns}
    meta = made.meta if stated is None else {**made.meta, "known": stated}
    write_recording(path, source.time, kept, meta)
    return read_recording(path)
