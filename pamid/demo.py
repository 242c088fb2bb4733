"""A virtual joint with something withheld: what `pamid demo` diagnoses without being told.

The seed draws one effect from a short list, mistunes the parameters of the rig by 10 to 20 % and adds sensor noise.
What was drawn goes into `withheld.json`, which nothing but the final comparison reads.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pamid.excitation import aprbs
from pamid.library import effects, rig_named
from pamid.recording import read_recording, write_recording
from pamid.run import write_json
from pamid.virtual import split_spec, virtual_rig

RIG = "one-dof"
PERIOD_S, AMPLITUDE_DEG, HOLD_S = 0.003, 40.0, (0.4, 1.6)
#: effects that a minute of motion brings to light clearly, with their size
EFFECTS = (
    "coulomb-friction:torque_n_m=0.4",
    "dead-time:delay_s=0.024",
    "valve-dead-band:dead_band=0.08",
    "leak:share=0.03",
    "flow-mismatch:mismatch=0.3",
    "end-stop:limit_rad=0.5",
)
#: parameters of the rig that are off, each by 10 to 20 % up or down
MISTUNED = ("damping_m2_s", "scale", "conductance_in_m3_per_s_pa", "conductance_out_m3_per_s_pa", "viscous_n_m_s")
OFF_BY = (0.10, 0.20)


@dataclass(frozen=True)
class Withheld:
    """spec: the effect as `--effect` takes it; factors: parameter of the rig -> true value over data-sheet value."""

    effect: str
    family: str
    spec: str
    factors: dict[str, float]


def draw_withheld(seed: int) -> Withheld:
    """The effect and the mistuned parameters of a seed."""
    random = np.random.default_rng(seed)
    spec = EFFECTS[int(random.integers(len(EFFECTS)))]
    off = random.uniform(*OFF_BY, len(MISTUNED)) * random.choice([-1.0, 1.0], len(MISTUNED))
    name = split_spec(spec)[0]
    factors = {key: round(1.0 + float(x), 4) for key, x in zip(MISTUNED, off, strict=True)}
    return Withheld(name, effects()[name].family, spec, factors)


def write_demo_recording(folder: Path, withheld: Withheld, *, seed: int, duration_s: float) -> Path:
    """excitation.csv, rec.csv (with its TOML) and withheld.json into `folder`; returns the path of rec.csv."""
    reference = aprbs(duration_s, PERIOD_S, AMPLITUDE_DEG, HOLD_S, seed=seed)
    time = PERIOD_S * np.arange(reference.size)
    excitation, recording = folder / "excitation.csv", folder / "rec.csv"
    write_recording(excitation, time, {"reference_deg": reference})
    sheet = {p.outside_name: p.value for p in rig_named(RIG).parameters}
    hidden = {key: sheet[key] * factor for key, factor in withheld.factors.items()}
    made = virtual_rig(RIG, read_recording(excitation), (withheld.spec,), {}, hidden, 1.0, seed)
    truth: dict[str, Any] = {
        "schema": "pamid.withheld/1", "seed": seed, "effect": withheld.effect, "family": withheld.family,
        "as_simulated": made.effects, "parameters": hidden, "over_data_sheet": withheld.factors,
    }
    write_json(folder / "withheld.json", truth)
    write_recording(recording, time, made.columns, made.meta)
    return recording
