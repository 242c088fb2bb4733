"""What a stranger gets: virtual machines with equations of their own, rigs written from the docs.

    python benchmarks/strangers/run.py --output FOLDER [--only NAME ...] [--whole] [--stated]

Every machine (`machines.py`) has equations of its own, in plain numpy, as measured machines have:
sensors with noise, steps and a zero that walks, maps that are rough by 1 to 3 %, inputs that are
not quite what is logged, one thing that its rig lacks, or none. Its rig (`rigs/`) was written from
README, CONTRIBUTING, docs/tutorials/own-rig.md, data/rigs/README.md and what `pamid check` prints,
with parameters 10 to 30 % off, and without `background` or `size`. `pamid diagnose` is given the
first recording, the second as `--held-out`, and the rig, in a folder whose name says nothing, one
machine after the other. With `--whole` nothing is missing in any of them, and zeros are not off:
what is left is their ordinary roughness. With `--stated` every rig states the tolerances that
`pamid check` proposes for it. `--resume` keeps what has been diagnosed, `--table` only
prints.

How an answer is counted:

    right     a cause of a planted family is named, at a port of the machine's list; where nothing
              is missing: no structural gap; outside the catalogue: an unknown effect
    honest    the planted family is among those that cannot be told apart, or the answer is open
              (unknown-effect, cannot-tell), or the family is right and the port is not
    missed    something is missing, and the answer is that nothing is
    wrong     causes are named, and the planted family is none of them, or there is none
    refused   no answer: an error, or recordings that are refused for the rig
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from machines import STRANGERS
from virtual import NOTHING, Columns, Stranger

from pamid.model.port_guide import mapped_ports, stated_roughness
from pamid.model.registry import rig_named

HERE = Path(__file__).resolve().parent
PAMID = Path(sys.executable).with_name("pamid")
NAMED = ("explained", "partly-explained")


@dataclass(frozen=True)
class Answer:
    """A diagnosis beside what was planted."""

    name: str
    lacks: str
    verdict: str
    counted: str
    causes: str
    leader: str
    place: int  # of the planted family in the ranking, 0 where it is not in it, -1 where none is
    port: bool
    removes: float  # share of the held-out error, of all channels
    cpu_s: float


def main() -> int:
    """Write the recordings, diagnose one after the other, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", choices=[s.name for s in STRANGERS])
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--resume", action="store_true", help="keep what has been diagnosed")
    parser.add_argument("--table", action="store_true", help="only print what is there")
    parser.add_argument("--whole", action="store_true", help="machines that lack nothing")
    parser.add_argument("--stated", action="store_true", help="rigs state their tolerances")
    options = parser.parse_args()
    answers = []
    for number, planned in enumerate(STRANGERS, 1):
        stranger = whole(planned) if options.whole else planned
        chosen = not options.only or stranger.name in options.only
        if not chosen or (options.whole and not planned.can_be_whole):
            continue
        folder = options.output / f"machine-{number:02d}"
        if not options.table and not (options.resume and (folder / "cost.txt").exists()):
            shutil.rmtree(folder, ignore_errors=True)
            write_machine(folder, stranger)
            if options.stated:
                state_tolerances(folder / stranger.rig)
            diagnose_machine(folder, stranger)
        if (folder / "cost.txt").exists():
            answers.append(read_answer(folder, stranger))
            print(line(answers[-1]), flush=True)
    print(summary(answers))
    return 0


def whole(stranger: Stranger) -> Stranger:
    """The same machine with nothing missing."""
    return replace(
        stranger, lacks=NOTHING, families=(), ports=(), records=lambda _: stranger.records(0.0)
    )


# ---- making and asking ---------------------------------------------------------------------------


def write_machine(folder: Path, stranger: Stranger) -> None:
    """Rig and recordings of a machine: rec-1.csv, rec-2.csv."""
    folder.mkdir(parents=True)
    shutil.copy(HERE / "rigs" / stranger.rig, folder / stranger.rig)
    for number, columns in enumerate(stranger.records(1.0), 1):
        write_recording(folder / f"rec-{number}.csv", columns)


def state_tolerances(path: Path) -> None:
    """Add to a rig file the tolerances that `pamid check` proposes for it."""
    rig = rig_named(str(path))
    mapped = mapped_ports(rig)
    if mapped:
        line = f"{type(rig).__name__}.{stated_roughness(rig, *mapped)}"
        path.write_text(f"{path.read_text()}\n\nfrom pamid import RoughMap\n\n{line}\n")


def write_recording(path: Path, columns: Columns) -> None:
    """As a logger prints it: six digits, of the time nine."""
    table = np.column_stack(list(columns.values()))
    formats = ["%.9g", *["%.6g"] * (len(columns) - 1)]
    np.savetxt(path, table, formats, ",", header=",".join(columns), comments="", newline="\n")


def diagnose_machine(folder: Path, stranger: Stranger) -> None:
    """Run `pamid diagnose` there; what it prints goes to said.txt, what it costs to cost.txt."""
    words = ["diagnose", "rec-1.csv", "--held-out", "rec-2.csv", "--rig", f"./{stranger.rig}"]
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [str(PAMID), *words, "--jobs", "1", "--output", "run"],
        cwd=folder,
        env={**os.environ, **single},
        capture_output=True,
        text=True,
        check=False,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    (folder / "said.txt").write_text(done.stdout + done.stderr)
    (folder / "cost.txt").write_text(f"{spent:.1f}\n")


# ---- counting ------------------------------------------------------------------------------------


def read_answer(folder: Path, stranger: Stranger) -> Answer:
    """What was said of a machine, and how it counts."""
    cost = float((folder / "cost.txt").read_text())
    at = folder / "run" / "diagnosis.json"
    if not at.exists():
        return Answer(stranger.name, stranger.lacks, "-", "refused", "", "", 0, False, 0.0, cost)
    found = json.loads(at.read_text())
    causes, ranking = found["causes"], found["ranking"]
    ours = [c for c in causes if c["family"] in stranger.families]
    at_port = any(set(c["port"].split(", ")) & set(stranger.ports) for c in ours)
    first = next((i for i, r in enumerate(ranking, 1) if r["family"] in stranger.families), 0)
    first = first if stranger.families else -1
    shrunk = [c["shrinkage"] for c in found["how_far"].values() if c["shrinkage"] is not None]
    return Answer(
        stranger.name,
        stranger.lacks,
        found["verdict"],
        counted(stranger, found["verdict"], bool(ours), at_port),
        "; ".join(described(c) for c in causes),
        described(ranking[0]) if ranking else "",
        first,
        at_port,
        float(np.mean(shrunk)) if causes and shrunk else 0.0,
        cost,
    )


def counted(stranger: Stranger, verdict: str, family: bool, port: bool) -> str:
    """right, honest, missed or wrong (see the top of this file)."""
    named = verdict in NAMED or verdict == "ambiguous"
    if named and not family:
        return "wrong"
    if family:
        return "right" if port and verdict in NAMED else "honest"
    if verdict == "no-structural-gap":
        return "right" if stranger.lacks == NOTHING else "missed"
    outside = not stranger.families and stranger.lacks != NOTHING
    return "right" if outside and verdict == "unknown-effect" else "honest"


def described(entry: dict[str, Any]) -> str:
    """An effect at its port with its probability."""
    p = entry.get("probability")
    return f"{entry['effect'].split('@')[0]}@{entry['port']}" + ("" if p is None else f" P {p:.2f}")


def line(answer: Answer) -> str:
    """One line of the table."""
    said = answer.causes or f"({answer.leader})"
    place = f"{answer.place}." if answer.place > 0 else "-"
    return (
        f"| {answer.name:14s} | {answer.lacks:50s} | {answer.verdict:17s} | {answer.counted:7s} "
        f"| {said:48s} | {place:3s} | {'yes' if answer.port else '-':3s} "
        f"| {100.0 * answer.removes:3.0f} % | {answer.cpu_s:4.0f} |"
    )


def summary(answers: list[Answer]) -> str:
    """Counts over all machines."""
    counts = Counter(a.counted for a in answers)
    known = [a for a in answers if a.place >= 0]
    leads = sum(a.place == 1 for a in known)
    words = [f"{kind} {counts[kind]}" for kind in ("right", "honest", "missed", "wrong", "refused")]
    cpu = sorted(a.cpu_s for a in answers)
    return (
        f"\n{len(answers)} machines: {', '.join(words)}; the planted family first in the ranking "
        f"{leads} of {len(known)}; "
        f"CPU {sum(cpu):.0f} s, median {cpu[len(cpu) // 2] if cpu else 0:.0f} s"
    )


if __name__ == "__main__":
    sys.exit(main())
