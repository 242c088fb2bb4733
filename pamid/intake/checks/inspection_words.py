"""Result of an inspection, as lines of text."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from pamid.base.units import NONE
from pamid.model.port_guide import TOLERANCES, WIDTH, cut, folded, grouped_ports_text, ports_text

# kinds of issues that make a note important
DOUBTS = ("unit", "sign", "exchanged", "absolute-pressure", "offset", "gain", "far-off")
FEW_PLACES = 4  # of a check that are listed separately
SCREEN = 38  # lines of a terminal, less the prompt and the line on what to do next
# lines per group of ports and per finding, with less and less of both
DETAIL = (4, 4), (3, 3), (2, 3), (1, 2), (1, 1)
NAMED_LIKEWISE = 3  # findings of a kind that are named after the first
# names and numbers, in which like findings differ
_VARIABLE = re.compile(r"'[^']*'|[-+]?\d[\w.+-]*")


def inspection_text(summary: dict[str, Any], *, everything: bool = True) -> str:
    """Result of `inspect` as text, problems first.

    everything: True prints all of it. Otherwise a rig is shortened to a single screen, with similar
    ports and findings joined.
    """
    lines = [*_head(summary), *_not_fine(summary["findings"])]
    lines += [*ports_text(summary.get("ports", [])), *_fine(summary["findings"])]
    rows = sum(1 + len(line) // WIDTH for text in lines for line in text.splitlines())
    if everything or "samples" in summary or rows < SCREEN:
        return "\n".join([*lines, _count(summary)])
    # shorten the effects, then notes, then ports
    joined = _together(summary["findings"])
    fine = [line for text in _fine(joined) for line in cut(text, 1)]
    for port_lines, finding_lines in DETAIL:
        ports = grouped_ports_text(summary.get("ports", []), port_lines)
        notes = [line for text in _not_fine(joined) for line in cut(folded(text), finding_lines)]
        lines = [*_head(summary), *notes, *ports, *fine]
        if len(lines) < SCREEN:
            break
    else:
        room = SCREEN - len(fine) - 2
        few = cut("\n".join(ports), max(room // 2, room - 1 - len(notes)))
        lines = [*_head(summary), *cut("\n".join(notes), room - 1 - len(few)), *few, *fine]
    return "\n".join([*lines, f"{_count(summary)} (--all prints the rest)"])


def _head(summary: dict[str, Any]) -> list[str]:
    if "samples" not in summary:
        return [f"{summary['file']}:"]
    loop = f", {summary['loop']} loop" if summary["loop"] else ""
    lines = [
        f"{summary['file']}: {summary['samples']} samples, {summary['duration_s']:g} s at "
        f"{summary['sampling_period_s']:g} s{loop}"
    ]
    for name, c in summary["columns"].items():
        sizes = summary["quality"]["channels"][name]
        visible = "".join(f", {k} {sizes[k]:.2g}" for k in ("noise", "step") if sizes[k] > 0.0)
        lines.append(
            f"  {name:<22} {c['low']:>11.5g} .. {c['high']:<11.5g} "
            f"{'' if c['unit'] == NONE else c['unit']:<4} rest {c['rest_value']:.5g} for "
            f"{c['rest_s']:.3g} s{visible}"
        )
    return lines


def _not_fine(findings: Iterable[dict[str, Any]]) -> list[str]:
    """Problems, then notes, folded unless they have a command to copy, which stays on its line."""
    problems = sorted((f for f in findings if not f["ok"]), key=lambda f: bool(f["advice"]))
    lines = []
    for f in problems:
        line = f"{'note   ' if f['advice'] else 'wrong  '}{f['check']}: {f['detail']}"
        lines.append(folded(line) if f["check"] == TOLERANCES else line)
    return lines


def _fine(findings: Iterable[dict[str, Any]]) -> list[str]:
    fine: dict[str, list[str]] = {}
    for f in findings:
        if f["ok"]:
            fine.setdefault(f["check"], []).append(f["detail"])
    lines = []
    for check, details in fine.items():
        remarks = [f"at {len(details)} places"] if len(details) > FEW_PLACES else details
        lines += [folded(f"ok     {check}: {detail}") for detail in remarks]
    return lines


def _together(findings: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Join findings that only differ in names and numbers; the first names the others."""
    groups: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for f in findings:
        kind = f["check"], f["ok"], f["advice"], _VARIABLE.sub("#", f["detail"])
        groups.setdefault(kind, []).append(f)
    joined = []
    for first, *others in groups.values():
        names = [m[0] for f in others if (m := re.search(r"'[^']*'", f["detail"]))]
        shown = ", ".join(names[:NAMED_LIKEWISE]) + (" .." if len(names) > NAMED_LIKEWISE else "")
        check = f"{first['check']}, {1 + len(others)} times" if others else first["check"]
        detail = first["detail"] + (f"; likewise {shown}" if shown else "")
        joined.append({**first, "check": check, "detail": detail})
    return joined


def _count(summary: dict[str, Any]) -> str:
    wrong = sum(not f["ok"] and not f["advice"] for f in summary["findings"])
    notes = sum(not f["ok"] and f["advice"] for f in summary["findings"])
    doubtful = any(i["kind"] in DOUBTS for i in summary.get("quality", {}).get("issues", []))
    counted = f"{notes} {'note' if notes == 1 else 'notes'}; " if notes else ""
    return counted + (
        ("the rig does not explain the recording as it is" if doubtful else "nothing is wrong")
        if summary["ok"]
        else f"{wrong} {'problem' if wrong == 1 else 'problems'}"
    )
