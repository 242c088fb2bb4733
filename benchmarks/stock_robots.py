"""Stock robot files: read, compiled or stepped, and the cost of `pamid check`.

    pip download --no-deps robosuite airo-models gymnasium-robotics
    for wheel in *.whl; do unzip -q -d models "$wheel"; done
    python benchmarks/stock_robots.py --models models [--only Panda ...] [--no-check]

Prints a Markdown table with a row for every file. "Equations" is a compiled model. Where nothing
but contacts stands against it, recordings decide: "equations unless touching". A model whose geoms
touch at its reference counts as stepped. A stepped model states the first reason, and how many
there are. `check` is the processor time of the whole command in a process of its own. Nothing is
installed, and no program of the packages is run.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from pamid.base.errors import FileError
from pamid.rigs.simulators.kinds.mujoco import rig_of
from pamid.rigs.simulators.mechanism import Mechanism
from pamid.rigs.simulators.mujoco_mechanism import read_mechanism

_SUITE, _BULLET = "robosuite/models/assets/robots", "robosuite/models/assets/bullet_data"
#: the files by the name of the robot; those after the eleven robots are other forms of them
ROBOTS = {
    "Kinova3": f"{_SUITE}/kinova3/robot.xml",
    "Panda": f"{_SUITE}/panda/robot.xml",
    "IIWA": f"{_SUITE}/iiwa/robot.xml",
    "UR5e": f"{_SUITE}/ur5e/robot.xml",
    "UR5e (URDF)": "airo_models/arms/ur5e/ur5e.urdf",
    "Sawyer": f"{_SUITE}/sawyer/robot.xml",
    "Jaco": f"{_SUITE}/jaco/robot.xml",
    "xArm7": f"{_SUITE}/xarm7/robot.xml",
    "Baxter": f"{_SUITE}/baxter/robot.xml",
    "Fetch": "gymnasium_robotics/envs/assets/fetch/reach.xml",
    "Robotiq 2F85 (URDF)": "airo_models/grippers/robotiq_2f_85/urdf/robotiq_2f_85.urdf",
    "UR3e (URDF)": "airo_models/arms/ur3e/ur3e.urdf",
    "Panda (URDF)": f"{_BULLET}/panda_description/urdf/panda_arm.urdf",
    "Panda and hand (URDF)": f"{_BULLET}/panda_description/urdf/panda_arm_hand.urdf",
    "Sawyer (URDF)": f"{_BULLET}/sawyer_description/urdf/sawyer_arm.urdf",
    "Baxter (URDF)": f"{_BULLET}/baxter_description/urdf/baxter_arm.urdf",
    "Spot": f"{_SUITE}/spot/robot.xml",
    "Spot, arm": f"{_SUITE}/spot_arm/robot.xml",
}
ELEVEN = tuple(ROBOTS)[:11]
HEAD = "| robot | read | form | joints | reasons to step it, or the error | `check`, s of CPU |"
COMPILED, BY_RECORDING = "equations", "equations unless touching"
LONGEST = 110  # characters of a reason


@dataclass(frozen=True)
class StockRow:
    """A file in the table. joints: -1 where it is not read; form: "" likewise; check_s: None where
    it is not measured."""

    robot: str
    joints: int
    form: str
    remark: str
    check_s: float | None = None

    @property
    def read(self) -> bool:
        return self.joints >= 0

    @property
    def compiled(self) -> bool:
        return self.form in (COMPILED, BY_RECORDING)

    def __str__(self) -> str:
        cells = (
            self.robot,
            "yes" if self.read else "no",
            self.form,
            str(self.joints) if self.read else "",
            self.remark.replace("|", "/"),
            "" if self.check_s is None else f"{self.check_s:.1f}",
        )
        return f"| {' | '.join(cells)} |"


def stock_row(robot: str, path: Path, check: bool = False) -> StockRow:
    """Read a file and say what becomes of it."""
    try:
        mechanism = read_mechanism(path)
        rig = rig_of(mechanism)
    except FileError as error:
        return StockRow(robot, -1, "", _short(error.message.replace(str(path), path.name)))
    form = COMPILED
    if mechanism.hindrances:
        contacts_only = all(f.element == "contact" for f in mechanism.hindrances)
        # geoms that touch at the reference touch in most recordings
        avoidable = contacts_only and mechanism.contact_share < 1.0
        decided_later = getattr(rig, "forms", None) is not None and avoidable
        form = BY_RECORDING if decided_later else "stepped"
    seconds = check_seconds(path) if check else None
    return StockRow(robot, len(mechanism.joints), form, _reasons(mechanism), seconds)


def _reasons(mechanism: Mechanism) -> str:
    """The first hindrance, and the number of the others."""
    if not mechanism.hindrances:
        return ""
    first, *others = mechanism.hindrances
    return _short(str(first)) + (f" (and {len(others)} more)" if others else "")


def _short(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def check_seconds(path: Path) -> float:
    """Processor time of `pamid check` with its children."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-m", "pamid_cli", "check", str(path)],
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def table_of(models: Path, robots: dict[str, str], check: bool) -> list[StockRow]:
    """The rows of all files; a file that is not there is a row without a model."""
    rows = []
    for robot, place in robots.items():
        path = models / place
        if path.exists():
            rows.append(stock_row(robot, path, check))
        else:
            rows.append(StockRow(robot, -1, "", f"no such file: {place}"))
    return rows


def summary(rows: list[StockRow]) -> str:
    read, compiled = sum(row.read for row in rows), sum(row.compiled for row in rows)
    return f"{read} of {len(rows)} read, {compiled} of {len(rows)} as equations"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", type=Path, required=True, help="folder of unpacked wheels")
    parser.add_argument("--only", nargs="+", choices=[*ROBOTS], default=[*ROBOTS])
    parser.add_argument("--no-check", action="store_true", help="do not time `pamid check`")
    options = parser.parse_args()
    robots = {robot: ROBOTS[robot] for robot in options.only}
    rows = table_of(options.models, robots, not options.no_check)
    print("\n".join([HEAD, "|---|---|---|---:|---|---:|", *map(str, rows)]))
    eleven = [row for row in rows if row.robot in ELEVEN]
    print(f"\nThe eleven robots: {summary(eleven)}. All files: {summary(rows)}.")


if __name__ == "__main__":
    main()
