"""Blind cases with MuJoCo as the truth: does `pamid diagnose` name what the model file lacks?

    python benchmarks/mujoco_cases.py --cases 40 --seed 1 --output FOLDER [--joints 1 2 7]

Every case is an arm that MuJoCo simulates (`mujoco_truth.py`) with one planted difference or none,
a log of it, and a model file that lacks the difference and has every mass 10 to 20 % off. `pamid
diagnose` is given the two and nothing else, under names that say nothing. What was planted stands
in FOLDER/labels.json, which is opened after the last diagnosis. The same command again goes on
where it was interrupted.

What is right was decided by physics, before anything was run:

    planted       right answer                          family                  port
    frictionloss  a torque against the motion of a      friction                JOINT
                  joint
    backlash      an inertia behind a gap, the sensor   flexible-transmission   JOINT_transmission
                  on the motor's side
    spring        the same behind a spring              flexible-transmission   JOINT_transmission
    delay         the command arrives late              command-timing          JOINT_drive_command
    armature      nothing is missing: a parameter of    no structural gap, the true value within
                  the rig reaches it                    the parameter's interval
    payload       one joint: nothing is missing, mass   no structural gap, both within their
                  and armature of the link together     intervals
                  are the link with its load; several
                  joints: they are not quite, since
                  the load's inertia couples the        no structural gap, or an unknown one: no
                  joints where an armature does not     effect of the catalogue is right
    nothing       nothing but masses                    no structural gap

A family counts as named where the verdict names it among its causes, as leading where it is first
in the ranking; the joint is right where the port of that cause belongs to the planted joint. An
alarm is a verdict that names an effect where none is right. No case is left out as too small to
see; "floors" says how many noise floors the refitted model leaves, in the worst channel. The noise
of the torque is no part of these, so that a machine without a gap leaves some as well. "within"
counts the true masses and armatures within their 95 % intervals, "worst off" is the furthest; in an
arm of servos, whose torque nothing tells, masses, dampings and gains are known to a common factor
only, which is taken out of "worst off" by the gain of the first.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mujoco_truth import KINDS, Machine, Planted, arm, draw_planted, misjudged, model_text, record

BLOCKS = (1, 2, 1, 7, 2, 7)  # joints of one case of every kind after the other
SECONDS = {1: 40.0, 2: 40.0, 7: 40.0}
FAMILIES = {
    "frictionloss": "friction",
    "backlash": "flexible-transmission",
    "spring": "flexible-transmission",
    "delay": "command-timing",
}
CAUSED = ("explained", "partly-explained", "ambiguous")  # verdicts that name a cause
PAMID = Path(sys.executable).with_name("pamid")


def main() -> int:
    """Make the cases, diagnose them, open the labels and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--joints", type=int, nargs="*", default=[1, 2, 7])
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=KINDS, help="only these")
    parser.add_argument("--score-only", action="store_true")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    chosen = [
        number
        for number in range(options.cases)
        if BLOCKS[number // len(KINDS) % len(BLOCKS)] in options.joints
        and kind_of(options.seed, number) in options.kinds
    ]
    # in an order of their own, so that the share done by any moment is not a share of some kinds
    for number in np.random.default_rng([options.seed, 5]).permutation(chosen).tolist():
        make_case(options.output, options.seed, number)
        if not options.score_only:
            diagnose_case(folder_of(options.output, number))
    labels = json.loads((options.output / "labels.json").read_text())
    print_table([score(options.output, labels[str(n)], n) for n in chosen])
    return 0


def kind_of(seed: int, number: int) -> str:
    """What is planted in a case: every kind once in a block, in an order of its own."""
    block, place = divmod(number, len(KINDS))
    return KINDS[np.random.default_rng([seed, block]).permutation(len(KINDS))[place]]


def folder_of(output: Path, number: int) -> Path:
    """Where a case stands; its name says nothing."""
    return output / "cases" / f"case-{number:03d}"


# ---- making --------------------------------------------------------------------------------------


def make_case(output: Path, seed: int, number: int) -> None:
    """Model and log of a case, and its label in labels.json, unless they are there."""
    folder, labels = folder_of(output, number), output / "labels.json"
    known = json.loads(labels.read_text()) if labels.exists() else {}
    if str(number) in known and (folder / "rec.csv").exists():
        return
    block, kind = number // len(KINDS), kind_of(seed, number)
    random = np.random.default_rng([seed, number, 7])
    joints = BLOCKS[block % len(BLOCKS)]
    machine = arm(joints, random)
    planted = draw_planted(kind, machine, random)
    columns, amplitude = record(machine, planted, SECONDS[joints], 1000 * seed + number)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "model.xml").write_text(model_text(misjudged(machine, random)))
    table = np.column_stack(list(columns.values()))
    np.savetxt(
        folder / "rec.csv", table, "%.9g", ",", header=",".join(columns), comments="", newline="\n"
    )
    known[str(number)] = {
        "kind": kind,
        "joints": joints,
        "servo": bool(machine.links[0].kp),
        "velocities": machine.velocities,
        "amplitude": amplitude,
        "joint": machine.links[planted.link].joint if planted else "",
        "size": planted.size if planted else 0.0,
        "ratio": planted.ratio if planted else 0.0,
        "parameters": true_parameters(machine, planted),
    }
    labels.write_text(json.dumps(known, indent=1) + "\n")


def true_parameters(machine: Machine, planted: Planted | None) -> dict[str, float]:
    """Values that masses and armatures of the rig have to take, by name in fit.json; without a
    payload on several joints, whose machine the rig's parameters do not reach."""
    found = {}
    for i, link in enumerate(machine.links):
        mass, armature = link.mass, link.armature
        if planted and planted.link == i and planted.kind == "armature":
            armature *= planted.size
        if planted and planted.link == i and planted.kind == "payload":
            if len(machine.links) > 1:
                return {}
            # the same moment of gravity, and the same inertia about the joint
            mass += planted.size * link.length / (0.5 * link.length)
            whole = link.about_joint + planted.size * link.length**2
            armature += whole - link.about_joint * mass / link.mass
        found[f"{link.body}_mass_kg"] = mass
        found[f"{link.joint}_armature_kg_m2"] = armature
    return found


# ---- diagnosing ----------------------------------------------------------------------------------


def diagnose_case(folder: Path) -> None:
    """Run `pamid diagnose` in a folder that holds model.xml and rec.csv, unless it has been run."""
    run = folder / "run"
    if (run / "diagnosis.json").exists():
        return
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    words = ["diagnose", "rec.csv", "--rig", "model.xml", "--output", "run", "--jobs", "1"]
    if run.exists():
        words.append("--resume")
    single = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [str(PAMID), *words],
        cwd=folder,
        env={**os.environ, **single},
        capture_output=True,
        text=True,
        check=False,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    with (folder / "cost.txt").open("a") as cost:  # a line for every part of an interrupted run
        cost.write(f"{spent:.1f}\n")
    (folder / "said.txt").write_text(done.stdout + done.stderr)
    print(f"{folder.name}: {spent:.0f} s CPU, exit code {done.returncode}", flush=True)


# ---- scoring -------------------------------------------------------------------------------------


def score(output: Path, label: dict[str, Any], number: int) -> dict[str, Any]:
    """What came of a case, beside its label."""
    folder = folder_of(output, number)
    at = folder / "run" / "diagnosis.json"
    row: dict[str, Any] = {"case": number, **label, "done": at.exists()}
    if not at.exists():
        return row
    found = json.loads(at.read_text())
    family = FAMILIES.get(label["kind"], "")
    causes = found["causes"] if found["verdict"] in CAUSED else []
    ranking = found["ranking"]
    ours = [c for c in causes if c["family"] == family]
    at_joint = [c for c in (ours or causes[:1]) if belongs(c["port"], label["joint"])]
    how_far = found["how_far"].values()
    floors = [c["mae_refitted"] / c["noise_floor"] for c in how_far if c["noise_floor"]]
    fitted = found["parameters"]
    gain = next((e for name, e in fitted.items() if "_drive_kp" in name), None)
    factor = gain["prior"] / gain["value"] if gain else 1.0
    within = [
        fitted[name]["low"] <= true <= fitted[name]["high"]
        for name, true in label["parameters"].items()
        if name in fitted
    ]
    cost = folder / "cost.txt"
    return {
        **row,
        "family": family,
        "verdict": found["verdict"],
        "causes": [f"{c['effect']} ({c['port']})" for c in causes],
        "leader": ranking[0]["effect"] if ranking else "",
        "leader_port": ranking[0]["port"] if ranking else "",
        "named": bool(ours),
        "leads": bool(ranking) and ranking[0]["family"] == family,
        "joint_right": bool(at_joint),
        "leader_joint_right": bool(ranking) and belongs(ranking[0]["port"], label["joint"]),
        "alarm": not family and bool(causes),
        "quiet": found["verdict"] == "no-structural-gap",
        "floors": max(floors, default=0.0),
        "within": f"{sum(within)}/{len(within)}",
        "all_within": all(within),
        "off": max(
            (
                abs(factor * fitted[name]["value"] / true - 1.0)
                for name, true in label["parameters"].items()
                if name in fitted
            ),
            default=0.0,
        ),
        "cpu_s": sum(map(float, cost.read_text().split())) if cost.exists() else 0.0,
    }


def belongs(port: str, joint: str) -> bool:
    """Is a port a joint's, or of its actuator or sensors? Their names begin with its own."""
    return bool(joint) and any(
        part == joint or part.startswith(f"{joint}_") for part in port.replace(",", " ").split()
    )


def print_table(rows: Sequence[dict[str, Any]]) -> None:
    """One line per case, then the shares by number of joints, as counts."""
    done = [r for r in rows if r["done"]]
    for r in done:
        answer = "; ".join(r["causes"]) or f"leads {r['leader']} ({r['leader_port']})"
        print(
            f"{r['case']:3d} {r['joints']} joints {'servo' if r['servo'] else 'motor'} "
            f"{r['kind']:12s} {r['joint'] or '-':9s} {r['size']:8.4g} | {mark(r):5s} "
            f"{r['verdict']:18s} {answer:60s} floors {r['floors']:7.2f} "
            f"within {r['within']:5s} worst off {100 * r['off']:5.2f} % {r['cpu_s']:5.0f} s"
        )
    left = len(rows) - len(done)
    print(f"\n{len(done)} of {len(rows)} cases diagnosed{f', {left} not yet' if left else ''}")
    header = ("joints", "cases", "named", "leads", "joint of named", "joint of leading", "alarms")
    print(" | ".join((*header, "no gap said", "all true within", "CPU s, median")))
    for joints in (*sorted({r["joints"] for r in done}), None):
        print(" | ".join(_line(joints, [r for r in done if joints in (None, r["joints"])])))


def mark(row: dict[str, Any]) -> str:
    """ok, first (only the ranking is led by it), wrong, or what came where nothing is missing."""
    if not row["family"]:
        return "ALARM" if row["alarm"] else "ok"
    if row["named"]:
        return "ok" if row["joint_right"] else "joint"
    return "first" if row["leads"] else "MISS"


def _line(joints: int | None, rows: Sequence[dict[str, Any]]) -> Iterable[str]:
    missing = [r for r in rows if r["family"]]
    none = [r for r in rows if not r["family"]]
    judged = [r for r in none if r["parameters"]]

    def share(of: Sequence[dict[str, Any]], what: str) -> str:
        return f"{sum(bool(r[what]) for r in of)}/{len(of)}"

    return (
        str(joints or "all"),
        str(len(rows)),
        share(missing, "named"),
        share(missing, "leads"),
        share([r for r in missing if r["named"]], "joint_right"),
        share([r for r in missing if r["leads"]], "leader_joint_right"),
        share(none, "alarm"),
        share(none, "quiet"),
        share(judged, "all_within"),
        f"{np.median([r['cpu_s'] for r in rows]) if rows else 0.0:.0f}",
    )


if __name__ == "__main__":
    sys.exit(main())
