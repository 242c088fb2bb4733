"""Plants the general catalogue in user rigs (a stage, a tank, two tanks, two masses) and asks for
the family of each effect.

    python benchmarks/planted_general.py [--only NAME ...] [--rig NAME ...]

The rigs are those of benchmarks/rigs/, parameters off by 10 %, sensor noise, open loop. In the two
tanks and the two masses only what the first two have no port for is planted.
What the joint's own catalogue serves is in planted_truth.py. Beside "ok" and "MISS" a row may say
    alike   the planted effect ties with the one named (on a linear rig with one
    sensor a delay of
            the command and of the reading are the same thing)
    unseen  the refitted model is within 10 % of the noise floor: retuned parameters do the same, or
    it is too small
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from pamid.diagnosis.pipeline import diagnose
from pamid.diagnosis.verdict.verdict_figures import diagnosis_file
from pamid.model.attachment import attachments
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import read_recording, write_recording
from pamid.simulation.data_split import split_recordings
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.virtual_rig import simulate_virtual_rig

RIGS = Path(__file__).resolve().parent / "rigs"
# rig -> (samples, centre and amplitude of the command, hold in samples, parameters of the specimen)
SETTINGS = {
    "stage": (20000, 0.0, 0.9, (100, 600), {"mass_kg": 2.2, "spring_n_per_m": 72.0}),
    "tank": (6000, 0.45, 0.4, (40, 300), {"fill_m_per_s": 0.055, "drain": 0.027}),
    "cascade": (6000, 0.45, 0.4, (40, 300), {"fill_m_per_s": 0.055, "drain": 0.027}),
    "coupled": (20000, 0.0, 0.9, (100, 600), {"viscous_n_m_s_per_rad": 0.018}),
}
# rigs in which only these are planted
ONLY = {
    "cascade": ("", "overflow-into-store", "overflow@upper", "orifice-loss@upper"),
    "coupled": ("", "signal-dependent-friction", "coupling-play", "directional-friction"),
}
# sizes that differ from the typical ones: visible, and within the rig's reach
SIZES = {"clock-skew": "start_s=-0.006,skew_ppm=200", "quadratic-drag": "", "end-stop": ""}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=None)
    parser.add_argument("--rig", nargs="*", choices=SETTINGS, default=list(SETTINGS))
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    for name in options.rig:
        samples, centre, amplitude, hold, specimen = SETTINGS[name]
        rig_path = str(RIGS / f"{name}.py")
        rig = rig_named(rig_path)
        period = rig.period_s
        signal = aprbs(
            samples * period,
            period,
            amplitude,
            (hold[0] * period, hold[1] * period),
            seed=5,
            offset=centre,
        )
        for a in [None, *attachments(rig, effects().values())]:
            label = a.label if a else ""
            if options.only is not None and label not in options.only:
                continue
            if label not in ONLY.get(name, (label,)):
                continue
            begun = time.process_time()
            family = a.family(rig) if a else "no-structural-gap"
            with tempfile.TemporaryDirectory() as folder:
                source = Path(folder) / "excitation.csv"
                columns = {"command": signal}
                if "brake_a" in rig.inputs:
                    columns["brake_a"] = 0.5 + 0.5 * np.roll(signal, len(signal) // 3)
                write_recording(source, period * np.arange(len(signal)), columns)
                spec = f"{label}:{SIZES[label]}" if SIZES.get(label) else label
                made = simulate_virtual_rig(
                    rig_path, read_recording(source), (spec,) if label else (), {}, specimen, 1.0, 5
                )
                target = Path(folder) / "rec.csv"
                write_recording(target, period * np.arange(len(signal)), made.columns, made.meta)
                evidence = split_recordings(rig, [read_recording(target)], [])
            found = diagnosis_file(diagnose(evidence, effects(), jobs=2)).as_json()
            first = (
                found["ranking"][0]
                if found["ranking"]
                else {"effect": "-", "family": "-", "shrinkage": 0.0}
            )
            far = next(iter(found["how_far"].values()))
            word = outcome(found, label, family, first, far)
            counts[word] += 1
            print(
                f"{word:6s} {name:6s} {label or '(nothing)':32s} {family:18s} -> "
                f"{found['verdict']:18s} {first['effect']:28s} "
                f"P {first.get('probability', 0.0):.2f} {100 * first['shrinkage']:5.1f} %  "
                f"{far['mae_refitted'] / far['noise_floor']:.2f} -> "
                f"{far['mae_with_cause'] / far['noise_floor']:.2f} "
                f"floors, {time.process_time() - begun:.1f} s CPU",
                flush=True,
            )
    print(", ".join(f"{n} {word}" for word, n in counts.items()))
    return 1 if counts["MISS"] else 0


def outcome(
    found: dict[str, Any], label: str, family: str, first: dict[str, Any], far: dict[str, float]
) -> str:
    """ok, alike, unseen or MISS (see above)."""
    if first["family"] == family or (not label and found["verdict"] == family):
        return "ok"
    named = {c["effect"] for c in found["causes"]} | {first["effect"]}
    tied = {one["effect"] for step in found["comparison"] for one in step["tied"]}
    if label in named | tied:
        return "alike"
    return "unseen" if label and far["mae_refitted"] < 1.1 * far["noise_floor"] else "MISS"


if __name__ == "__main__":
    sys.exit(main())
