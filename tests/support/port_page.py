"""Writes the part of data/rigs/README.md that follows from the catalogue:
`python tests/support/port_page.py`."""

from collections.abc import Iterable
from pathlib import Path

from pamid.model.effect import KINDS, Effect
from pamid.model.port_guide import GUIDE, reachable
from pamid.model.registry import effects
from pamid.model.rig import Port

PAGE = Path(__file__).resolve().parents[2] / "data" / "rigs" / "README.md"
BEGIN = "<!-- from the catalogue: python tests/support/port_page.py -->\n"
END = "<!-- end -->\n"
#: meaning of a signal of the catalogue
SIGNALS = {
    "position": "the coordinate of the port; its zero is arbitrary",
    "velocity": "the rate of `position`; a port with `velocity` needs no `position`",
    "load": "the normal force of a sliding contact, positive",
    "level": "the quantity that increases friction, in any unit; `load`, `pressure`, `current`, "
    "`voltage` or `temperature` can also serve as `level`",
    "current": "current of a coil that stiffens a fluid or closes a brake",
    "voltage": "voltage at such a coil",
    "temperature": "temperature of the sliding contact",
    "pressure": "gauge pressure of the fluid that causes the value",
    "inertia": "mass or moment of inertia of the driven part",
    "free_fall": "acceleration of the driven part when released, for example by gravity",
    "behind": "what the port drives in a pose turned against it, as a function of an angle",
    "driven": "what the drive exerts more where it stands behind, as a function of an angle",
    "stored": "content of the store, zero where nothing leaves it: gauge pressure, level "
    "above the outlet, temperature above the surroundings",
    "upstream": "content of the store that overflows into this store; the other port offers "
    "`downstream`",
    "downstream": "content of the store that receives the overflow of this store; the other port "
    "offers `upstream`",
    "stretch": "extension or twist of a coupling: the driving side minus the driven side",
    "outflow": "flow that leaves the store by itself, in the value's unit, positive",
    "side": "1 or -1: the actuator of an opposed pair, or the direction",
    "law": "the actuator's force law, as a function of position and pressure",
    "rate": "rate of change of the reading",
    "supply": "pressure of the supply",
    "drawn": "flow that all consumers draw from the supply",
    "fill": "opening of the filling valve",
    "force": "force of the actuator that the store drives",
}


def written(page: str) -> str:
    """The page with that part as the catalogue now has it."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{page_section(effects().values())}\n\n{END}{after}"


def page_section(effects: Iterable[type[Effect]]) -> str:
    """The part of `data/rigs/README.md` that follows from the catalogue, in Markdown."""
    known, lines = list(effects), []
    for kind in KINDS:
        lines += [
            f"### `{kind}`",
            "",
            f"Passes {GUIDE[kind].passes}.",
            f"Sign: {GUIDE[kind].sign}.",
            "",
            "| the port offers | what can act there |",
            "|---|---|",
        ]
        for signals, names in reachable(Port(kind), known, any_unit=True).items():
            home = [_marked(name, kind, known) for name in names]
            offers = ", ".join(f"`{s}`" for s in signals) or "nothing"
            lines += [f"| {offers} | {', '.join(home)} |"] if home else []
        lines.append("")
    used = {s for effect in known for s in effect.signals}
    used |= {s for effect in known for role in effect.roles for s in role}
    used |= {s for effect in known for names in effect.stand_ins.values() for s in names}
    lines += ["### Signals", "", "| signal | what it is |", "|---|---|"]
    lines += [f"| `{s}` | {SIGNALS[s]} |" for s in sorted(used)]
    return "\n".join(lines)


def _marked(name: str, kind: str, effects: list[type[Effect]]) -> str:
    effect = next(e for e in effects if e.name == name)
    unit = f" (in {effect.unit})" if effect.unit else ""
    unit += f" (not in {', '.join(effect.excluded_units)})" if effect.excluded_units else ""
    mark = "" if kind in effect.kinds else "*"
    return f"`{name}`{unit}{mark}"


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
