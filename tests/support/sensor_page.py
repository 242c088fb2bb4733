"""Writes the tables of docs/how-to/choose-sensors.md, one for each starter rig, from what `pamid
power` says: `python tests/support/sensor_page.py` (minutes of CPU).

With names of rigs only their tables are made anew.
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
from datetime import date
from pathlib import Path
from typing import Any

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "choose-sensors.md"
BEGIN = "<!-- measured: python tests/support/sensor_page.py -->\n"
END = "<!-- end -->\n"
#: rig -> length of the experiment, s: about 20 of its longest holds, and more
RIGS = {
    "one-dof": 30,
    "dc-motor": 30,
    "geared-motor": 10,
    "linear-axis": 30,
    "servo-axis": 30,
    "servo-pendulum": 30,
    "servo": 30,
    "static-map": 30,
    "cylinder-bench": 30,
    "damper-bench": 30,
    "two-masses": 30,
    "cascaded-tanks": 2000,
    "pump-tank": 2000,
    "thermal-block": 20000,
    "thermal-two-mass": 20000,
}


def commands(rig: str) -> tuple[str, str]:
    """The two commands behind a table."""
    made = f"pamid generate-aprbs --rig {rig} --duration {RIGS[rig]} --seed 1 --output {rig}.csv"
    return made, f"pamid power --rig {rig} --excitation {rig}.csv"


def found(rig: str, folder: Path) -> dict[str, Any]:
    """What `pamid power` says (pamid.power/1)."""
    for line in commands(rig):
        words = [sys.executable, "-m", "pamid_cli", *line.split()[1:], "--json"]
        done = subprocess.run(words, cwd=folder, check=True, capture_output=True, text=True)
    said: dict[str, Any] = json.loads(done.stdout)
    return said


def section(rig: str, said: dict[str, Any]) -> str:
    """Heading, commands and table of a rig: families by sensors, the plainest first."""
    families: dict[str, list[dict[str, Any]]] = {}
    usual, seen = said["sizes"].index(1.0), said["seen"]
    for one in said["effects"]:
        if not one["failed"]:
            families.setdefault(one["family"], []).append(one)
    channels = said["channels"]

    def cell(value: float) -> str:
        return f"{value:.1f}" if value >= seen else "-"

    lines = [f"## {rig}", "", "```sh", *commands(rig), "```", ""]
    lines += [f"| family | effects | {' | '.join(f'`{c}`' for c in channels)} | all |"]
    lines += ["|---|---:|" + "---:|" * (len(channels) + 1)]
    for family, members in families.items():
        alone = [max(m["by_channel"].get(c, 0.0) for m in members) for c in channels]
        together = max(m["visible"][usual] for m in members)
        cells = " | ".join(map(cell, [*alone, together]))
        lines.append(f"| {family} | {len(members)} | {cells} |")
    return "\n".join(lines)


def row(rig: str, said: dict[str, Any]) -> str:
    """How many effects each sensor of a rig shows by itself, and all of them together."""
    usual, seen = said["sizes"].index(1.0), said["seen"]
    made = [one for one in said["effects"] if not one["failed"]]
    alone = {
        c: sum(one["by_channel"].get(c, 0.0) >= seen for one in made) for c in said["channels"]
    }
    together = sum(one["visible"][usual] >= seen for one in made)
    said_alone = ", ".join(f"`{c}` {n}" for c, n in alone.items())
    return f"| `{rig}` | {len(made)} | {said_alone} | {together} |"


def kept(text: str) -> tuple[dict[str, str], dict[str, str]]:
    """Rows and sections of the rigs that stand on the page already."""
    rows = {m[1]: m[0] for m in re.finditer(r"^\| `([\w-]+)` \|.*\|$", text, re.MULTILINE)}
    parts = re.split(r"^## ", text, flags=re.MULTILINE)[1:]
    return rows, {part.split("\n", 1)[0]: f"## {part.rstrip()}" for part in parts}


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("rigs", nargs="*", help="only these anew; the others stay as they stand")
    given = asked.parse_args()
    page = PAGE.read_text(encoding="utf-8")
    before, _, rest = page.partition(BEGIN)
    text, _, after = rest.partition(END)
    rows, parts = kept(text)
    with tempfile.TemporaryDirectory() as temporary:
        for rig in given.rigs or RIGS:
            said = found(rig, Path(temporary))
            rows[rig], parts[rig] = row(rig, said), section(rig, said)
    there = [rig for rig in RIGS if rig in parts]
    lines = ["| rig | effects that fit | shown by a sensor alone | by all together |"]
    lines += ["|---|---:|---|---:|", *(rows[rig] for rig in there)]
    when = f"Measured on {date.today():%-d %B %Y}."
    made = "\n\n".join([when, "\n".join(lines), *(parts[rig] for rig in there)])
    PAGE.write_text(f"{before}{BEGIN}\n{made}\n\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
