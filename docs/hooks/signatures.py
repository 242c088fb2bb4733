"""A picture of every effect's signature, drawn from the effect's own equation.

The effect is attached, at its typical size, to the first machine of a list that it fits; the
machine is moved through its range, and what leaves the effect's port is drawn beside what
enters it. A picture is kept under the digest of all that it is made of.
"""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from conformance_rules import STEPPING, Case, assembled, cases, excitation, rig_of
from matplotlib.figure import Figure

from pamid.engine.sampled_inputs import SampledInputs
from pamid.engine.symbolic.expression import Expr
from pamid.model.assembly import Array
from pamid.model.trace import Passage

ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / "build" / "signatures"
#: which machine shows an effect: first those whose signals have both signs
MACHINES = (
    "servo-pendulum",
    "dc-motor",
    "two-masses",
    "cylinder-bench",
    "cascaded-tanks",
    "one-dof",
    "carts",
    "muscles",
)
#: what the change is drawn over at a port that offers it, the most telling first
OVER = ("velocity", "position", "pressure", "stored", "drawn", "upstream", "level", "load")
#: effects known by where the coordinate is, not by how fast it moves
BY_POSITION = ("stiffness", "end-stop", "gravity", "cogging", "hysteresis", "elasticity")
SHOWN = 500  # samples
BEFORE, AFTER = "#8a8f98", "#d95f0e"


@dataclass(frozen=True)
class Seen:
    """What passed through an effect's port: before and after it, and what the change is drawn
    over, SI, one value per sample."""

    time_s: Array
    before: Array
    after: Array
    over: Array
    over_name: str
    over_unit: str
    unit: str
    machine: str
    port: str


def chosen_cases() -> dict[str, Case]:
    """Effect -> the case that shows it."""
    found: dict[str, Case] = {}
    order = {name: k for k, name in enumerate(MACHINES)}

    def place(case: Case) -> tuple[int, int]:
        """Early machines first; a signal that is sent has both signs more often than one read."""
        kind = rig_of(case.rig).ports[case.attachment.ports[0]].kind
        return order.get(Path(case.rig).stem, len(order)), kind == "reading"

    for case in sorted(cases(), key=place):
        found.setdefault(case.attachment.effect.name, case)
    return found


def seen(case: Case) -> Seen:
    """Run the machine with the effect at its typical size."""
    rig, assembly = rig_of(case.rig), assembled(case)
    passage = next(
        q
        for q in assembly.traced.passages
        if q.port in case.attachment.ports and q.result is not q.value
    )
    over_name, over = _over(case, passage)
    port = rig.ports[passage.port]
    over_unit = port.unit_of(over_name) if over else port.unit
    program = assembly.program_with({"before": passage.value, "after": passage.result, **over})
    p = assembly.values()
    memory = program.memory(assembly.start(p), stepping=STEPPING, period_s=rig.period_s)
    y, _, _ = program.run(
        memory, SampledInputs(excitation(case.rig), rig.period_s), p, stepping=STEPPING
    )
    added = y[:, -(2 + len(over)) :][-2 * SHOWN :]
    before, after = added[:, 0], added[:, 1]
    return Seen(
        rig.period_s * np.arange(len(added)),
        before,
        after,
        added[:, 2] if over else before,
        over_name,
        over_unit,
        port.unit,
        rig.name,
        passage.where,
    )


def _over(case: Case, passage: Passage) -> tuple[str, dict[str, Expr]]:
    """The signal over which the change is drawn; what enters the port where none is offered."""
    offered = {name: value for name, value in passage.signals if isinstance(value, Expr)}
    effect = case.attachment.effect.name
    order = OVER[1:] + OVER[:1] if any(word in effect for word in BY_POSITION) else OVER
    wanted = [name for name in order if name in offered]
    kind = rig_of(case.rig).ports[passage.port].kind
    if kind in ("command", "reading", "flow") or not wanted:
        return "what enters", {}
    return wanted[0], {"over": offered[wanted[0]]}


def drawn(what: Seen) -> bytes:
    """The picture as SVG: before and after over time; the change over the signal beside it."""
    with matplotlib.rc_context({"svg.hashsalt": "pamid", "svg.fonttype": "none", "font.size": 9}):
        figure = Figure(figsize=(8.0, 2.7), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(3, 2))
        some = slice(-SHOWN, None)
        left.plot(what.time_s[some], what.before[some], color=BEFORE, lw=2.2, label="enters")
        left.plot(what.time_s[some], what.after[some], color=AFTER, lw=1.2, label="leaves")
        left.set(xlabel="time [s]", ylabel=f"{what.port} [{what.unit or '-'}]")
        left.legend(loc="upper right", frameon=False)
        through = what.over_name == "what enters"
        right.plot(
            what.over, what.after if through else what.after - what.before, color=AFTER, lw=0.9
        )
        if through:
            right.plot(what.over, what.over, color=BEFORE, lw=0.6, ls=":")
        right.set(
            xlabel=f"{what.over_name} [{what.over_unit or '-'}]",
            ylabel=f"{'leaves' if through else 'what the effect adds'} [{what.unit or '-'}]",
        )
        for axes in (left, right):
            axes.spines[["top", "right"]].set_visible(False)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def pictures(names: Iterable[str]) -> dict[str, tuple[bytes, str]]:
    """Effect -> its picture and the machine and port that it was drawn at. What nothing has
    changed since is taken from `build/signatures`."""
    KEPT.mkdir(parents=True, exist_ok=True)
    made = {}
    shown = chosen_cases()
    for name in names:
        case = shown[name]
        file = KEPT / f"{name}-{_digest(case)}.svg"
        if not file.is_file():
            what = seen(case)
            file.write_bytes(_told(drawn(what), what))
        picture = file.read_bytes()
        told = re.search(rb"<!-- at (.*?) of (.*?) -->", picture)
        assert told is not None
        made[name] = picture, f"`{told[1].decode()}` of the rig `{told[2].decode()}`"
    return made


def _told(picture: bytes, what: Seen) -> bytes:
    return picture + f"<!-- at {what.port} of {what.machine} -->\n".encode()


def _digest(case: Case) -> str:
    """Of the files that a picture is made of."""
    effect = case.attachment.effect
    files = [Path(__file__), ROOT / "pamid" / "effects" / f"{effect.name.replace('-', '_')}.py"]
    rig = Path(case.rig)
    files.append(
        rig if rig.suffix else ROOT / "pamid" / "rigs" / f"{case.rig.replace('-', '_')}.py"
    )
    return hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()[:12]
