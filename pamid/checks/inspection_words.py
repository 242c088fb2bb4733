"""What an inspection found, as lines of text."""

from __future__ import annotations

from typing import Any

from pamid.base.units import NONE
from pamid.model.port_guide import TOLERANCES, folded, ports_text

# kinds of issues after which a note is no small matter
DOUBTS = ("unit", "sign", "exchanged", "absolute-pressure", "offset", "gain", "far-off")
FEW_PLACES = 4  # of one check that are told one by one


def inspection_text(said: dict[str, Any]) -> str:
    """What `inspect` found, for people: problems first."""
    lines = []
    if "samples" in said:
        loop = f", {said['loop']} loop" if said["loop"] else ""
        lines.append(
            f"{said['file']}: {said['samples']} samples, {said['duration_s']:g} s at "
            f"{said['sampling_period_s']:g} s{loop}"
        )
        lines += [
            f"  {name:<22} {c['low']:>11.5g} .. {c['high']:<11.5g} "
            f"{'' if c['unit'] == NONE else c['unit']:<4} rest {c['rest_value']:.5g} for "
            f"{c['rest_s']:.3g} s{_texture(said['quality']['channels'][name])}"
            for name, c in said["columns"].items()
        ]
    else:
        lines.append(f"{said['file']}:")
    for title, chosen in (
        ("wrong  ", lambda f: not f["ok"] and not f["advice"]),
        ("note   ", lambda f: not f["ok"] and f["advice"]),
    ):
        lines += [_told(title, f) for f in said["findings"] if chosen(f)]
    lines += ports_text(said.get("ports", []))
    fine: dict[str, list[str]] = {}
    for f in said["findings"]:
        if f["ok"]:
            fine.setdefault(f["check"], []).append(f["detail"])
    for check, details in fine.items():
        told = [f"at {len(details)} places"] if len(details) > FEW_PLACES else details
        lines += [folded(f"ok     {check}: {detail}") for detail in told]
    wrong = sum(not f["ok"] and not f["advice"] for f in said["findings"])
    notes = sum(not f["ok"] and f["advice"] for f in said["findings"])
    doubtful = any(i["kind"] in DOUBTS for i in said.get("quality", {}).get("issues", []))
    counted = f"{notes} {'note' if notes == 1 else 'notes'}; " if notes else ""
    lines.append(
        counted
        + (
            ("the rig does not explain the recording as it is" if doubtful else "nothing is wrong")
            if said["ok"]
            else f"{wrong} {'problem' if wrong == 1 else 'problems'}"
        )
    )
    return "\n".join(lines)


def _told(title: str, f: dict[str, Any]) -> str:
    """A finding; folded where nothing in it is a command to copy, which has to stay on a line."""
    told = f"{title}{f['check']}: {f['detail']}"
    return folded(told) if f["check"] == TOLERANCES else told


def _texture(channel: dict[str, float]) -> str:
    """Noise and step of a column, where they show."""
    return "".join(
        f", {what} {channel[what]:.2g}" for what in ("noise", "step") if channel[what] > 0.0
    )
