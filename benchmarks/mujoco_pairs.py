"""Two differences of one kind at two joints of an arm that MuJoCo simulates: are both named?

    python benchmarks/mujoco_pairs.py [--kinds spring backlash] [--seeds 1 2] [--output FOLDER]

Made and diagnosed as in `mujoco_cases.py`, two joints, 40 s; the model lacks both, its masses are
10 to 20 % off. Printed: at how many of the two joints the verdict names the planted family, what it
names, what leads the ranking, and CPU seconds.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
from mujoco_cases import CAUSED, FAMILIES, SECONDS, belongs, diagnose_case
from mujoco_truth import Machine, Planted, arm, draw_planted, misjudged, model_text, record

DRAWS = 50


def both_joints(kind: str, machine: Machine, random: np.random.Generator) -> tuple[Planted, ...]:
    """A difference of a kind at either link."""
    found: dict[int, Planted] = {}
    for _ in range(DRAWS):
        one = draw_planted(kind, machine, random)
        if one is not None:
            found.setdefault(one.link, one)
    return tuple(found[i] for i in sorted(found))


def make_case(folder: Path, kind: str, seed: int) -> tuple[Machine, tuple[Planted, ...]]:
    """model.xml and rec.csv."""
    random = np.random.default_rng([seed, 2, list(FAMILIES).index(kind)])
    machine = arm(2, random)
    planted = both_joints(kind, machine, random)
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "rec.csv").exists():
        columns, _ = record(machine, planted, SECONDS[2], seed)
        (folder / "model.xml").write_text(model_text(misjudged(machine, random)))
        table = np.column_stack(list(columns.values()))
        header = ",".join(columns)
        np.savetxt(folder / "rec.csv", table, "%.9g", ",", header=header, comments="")
    return machine, planted


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kinds", nargs="*", choices=[*FAMILIES], default=["spring", "backlash"])
    parser.add_argument("--seeds", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        for kind in options.kinds:
            for seed in options.seeds:
                folder = (options.output or Path(place)) / f"{kind}-{seed}"
                machine, planted = make_case(folder, kind, seed)
                diagnose_case(folder)
                print(_line(folder, machine, planted), flush=True)


def _line(folder: Path, machine: Machine, planted: tuple[Planted, ...]) -> str:
    at = folder / "run" / "diagnosis.json"
    if not at.exists():
        return f"{folder.name}: no diagnosis"
    found = json.loads(at.read_text())
    causes = found["causes"] if found["verdict"] in CAUSED else []
    ours = [c["port"] for c in causes if c["family"] == FAMILIES[planted[0].kind]]
    named = sum(any(belongs(port, machine.links[p.link].joint) for port in ours) for p in planted)
    said = "; ".join(f"{c['effect']} ({c['port']}) P {c['probability']:.2f}" for c in causes)
    leads = ", ".join(f"{r['effect']} ({r['port']})" for r in found["ranking"][:3])
    sizes = ", ".join(f"{machine.links[p.link].joint} {p.size:.4g}" for p in planted)
    spent = sum(map(float, (folder / "cost.txt").read_text().split()))
    return (
        f"{folder.name} ({sizes}): {named} of {len(planted)} named; {found['verdict']}: "
        f"{said or 'none'}; ranking {leads}; {spent:.0f} s CPU"
    )


if __name__ == "__main__":
    main()
