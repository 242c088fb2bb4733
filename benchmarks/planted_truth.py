"""Plants every effect of the catalogue in a virtual joint and asks the diagnosis for its family.

    python benchmarks/planted_truth.py [--only NAME ...] [--jobs 2]

The virtual joint has parameters off by 5-20 %, sensor noise, four times finer integration, and one
effect at the size below (chosen to be visible: several times the noise floor). A same-formula
check: it shows that the machinery works, not how well it does on a real rig; that is what the blind
trial is for. Prints a row per effect and the count.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

from pamid.diagnosis.pipeline import diagnose
from pamid.diagnosis.verdict.verdict_figures import diagnosis_file
from pamid.model.attachment import attachments
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import read_recording, write_recording
from pamid.simulation.data_split import split_recordings
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.virtual_rig import simulate_virtual_rig

MISTUNED = {
    "scale": 1.10,
    "conductance_in_m3_per_s_pa": 3.3e-9,
    "damping_m2_s": 4e-4,
    "polytropic": 1.12,
    "contraction_0": 0.103,
    "viscous_n_m_s": 0.05,
    "dead_volume_cm3": 6.5,
}

# effect -> (parameters, excitation: amplitude deg, hold s, known); what is not listed acts at its
# typical size
PLANTED: dict[str, tuple[str, dict[str, object]]] = {
    "flow-mismatch": ("mismatch=0.4", {}),
    "force-compensator": ("limit_n=720", {}),
    "chain-stretch": ("compliance_percent_per_kn=10", {}),
    "two-mass": ("", {"known": {"inertia_kg_m2": 0.0896}}),
    "backlash": ("", {"known": {"inertia_kg_m2": 0.0896}}),
    "end-stop": ("", {"amplitude": 45.0}),
    "muscle-creep": ("", {"hold": (2.0, 8.0), "seconds": 120.0}),
    "leak": ("", {"hold": (1.0, 4.0)}),
    "heat-transfer": ("", {"hold": (0.6, 3.0)}),
}


def plant(label: str, seed: int, folder: Path, seconds: float) -> Path:
    """A recording of the virtual joint with one effect (or none for "")."""
    spec, how = PLANTED.get(label, ("", {}))
    known = how.get("known", {"inertia_kg_m2": 0.014})
    duration = float(how.get("seconds", seconds))  # type: ignore[arg-type]
    low, high = how.get("hold", (0.4, 1.6))  # type: ignore[misc]
    signal = aprbs(duration, 0.003, float(how.get("amplitude", 40.0)), (low, high), seed=seed)  # type: ignore[arg-type]
    name = label.replace("@", "_") or "nothing"
    source = folder / f"{name}_excitation.csv"
    time_s = [0.003 * i for i in range(len(signal))]
    write_recording(source, time_s, {"reference_deg": signal})
    specs = (f"{label}:{spec}" if spec else label,) if label else ()
    made = simulate_virtual_rig(  # type: ignore[call-overload]
        "one-dof", read_recording(source), specs, dict(known), MISTUNED, 1.0, seed
    )
    target = folder / f"{name}.csv"
    write_recording(target, time_s, made.columns, made.meta)
    return target


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=None)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=3)
    options = parser.parse_args()
    rig, catalogue = rig_named("one-dof"), effects()
    every = {a.label: a for a in attachments(rig, catalogue.values())}
    right = 0
    labels = options.only if options.only is not None else ["", *every]
    for label in labels:
        begun = time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            recording = read_recording(plant(label, options.seed, Path(folder), options.seconds))
        evidence = split_recordings(rig, [recording], [])
        found = diagnosis_file(diagnose(evidence, catalogue, jobs=options.jobs)).as_json()
        first = (
            found["ranking"][0]
            if found["ranking"]
            else {"effect": "-", "family": "-", "shrinkage": 0.0}
        )
        if label:
            a = every[label]
            family = a.family(rig)
            good = first["family"] == family
        else:
            family, good = "no-structural-gap", found["verdict"] == "no-structural-gap"
        right += good
        causes = [(c["effect"], round(c["probability"], 2)) for c in found["causes"]]
        far = found["how_far"]["angle_deg"]
        print(
            f"{'ok ' if good else 'MISS'} {label or '(nothing)':34s} {family:22s} -> "
            f"{found['verdict']:18s} {first['effect']:30s} {first['family']:22s} "
            f"{100 * first['shrinkage']:5.1f} %  angle "
            f"{far['mae_refitted'] / far['noise_floor']:.2f} -> "
            f"{far['mae_with_cause'] / far['noise_floor']:.2f} floors, causes "
            f"{causes}, {time.process_time() - begun:.1f} s CPU",
            flush=True,
        )
    print(f"{right} of {len(labels)} right")
    return 0 if right == len(labels) else 1


if __name__ == "__main__":
    sys.exit(main())
