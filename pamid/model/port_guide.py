"""Guide to the kinds of ports: their values, signs, and the signals that let effects act there.

`pamid check RIG.py` prints it; tests/support/port_page.py writes it into data/rigs/README.md.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from pamid.engine.symbolic.expression import const, substitute, symbol, symbols
from pamid.engine.symbolic.vocabulary import EquationError, Expr
from pamid.model.assembly import Assembly
from pamid.model.attachment import attachments, is_home, lacking_signals
from pamid.model.background import ORDINARY_ROUGHNESS, RoughMap
from pamid.model.effect import Effect
from pamid.model.rig import Port, Rig, background_by_port
from pamid.model.trace import Passage

WIDTH = 110


@dataclass(frozen=True)
class KindOfPort:
    """passes: what goes through it; sign: which way it counts."""

    passes: str
    sign: str


GUIDE = {
    "command": KindOfPort(
        "the command to the machine: a voltage, a valve opening, a pressure reference",
        "as commanded; effects delay, clip, scale or shift it, whatever its sign",
    ),
    "flow": KindOfPort(
        "the volume or mass flow through a single valve or pump",
        "positive into the store that it feeds",
    ),
    "rate": KindOfPort(
        "the net flow into a store: inflow minus outflow",
        "positive when the store fills; a positive `outflow` empties it; effects subtract losses",
    ),
    "actuator-force": KindOfPort(
        "the force or torque that an actuator generates, before the mechanism",
        "along its `position`: a muscle's pull with its contraction, a cylinder's push with "
        "its stroke. Effects subtract the losses of the actuator",
    ),
    "motion": KindOfPort(
        "the net force (N) or torque (N m) that accelerates a coordinate",
        "along `position`: a positive value accelerates in positive direction. Effects subtract "
        "friction and drag along `velocity`, and stiffness along `position`",
    ),
    "transmission": KindOfPort(
        "the force or torque that a shaft, a chain or a belt transmits",
        "along `position`, as at a motion port; `inertia` is the total driven inertia",
    ),
    "reading": KindOfPort(
        "the value that a sensor measures, in the SI unit of its column",
        "as the sensor counts; `rate` is its rate of change, with the same sign",
    ),
}

IMPOSED = (
    "`position` or `velocity` here is an input: the bench imposes the motion. Pass the force on "
    "the moving part along `position`, without the driving force. A sensor of the driving force "
    "reads the negative of this value. With the wrong sign friction would accelerate "
    "the part, and its fit ends at zero"
)


#: kinds of port that a formula of the machine gives its value, and signals over which that is off
MAPPED = ("actuator-force", "flow", "motion", "rate")
ALONG = ("position", "stored", "level")
#: what a map along such a signal ("": what passes) can take up besides roughness
TAKEN_UP = {
    "": "a curvature, a dead zone or a saturation of the value",
    "position": "a stiffness, a cogging, and dry friction of a motion whose direction follows its "
    "position, such as a swing that dies away",
    "stored": "a loss or a leak that follows what is stored",
    "level": "a loss or a leak that follows the level",
}
#: kinds of port that as a rule pass a balance, and the names under which parts of it are offered
BALANCED, PARTS = ("motion", "rate"), ("load", "loss", "inflow")
RESISTING = ("position", "velocity", "stored")
TOLERANCES = "tolerances"  # the finding of a rig that states none


def stated_roughness(rig: Rig, *names: str) -> str:
    """Signals to be offered first at ports that pass a balance, with their maps; then the line of
    a rig file that states an ordinary roughness of what passes the other ports."""
    of = {name: _of(rig, name) for name in names}
    maps = {}
    for name, signal in of.items():
        along = _along(rig.ports[name])
        over = f', "{along}"' if along else ""
        share = f', of="{signal}"' if signal else ""
        maps[name] = (
            f'"{name}": RoughMap("{name}_map"{over}{share}, tolerance={ORDINARY_ROUGHNESS})'
        )
    # a balance is next to nothing where the parts of it that are rough are large
    lacking = [name for name, signal in of.items() if signal not in ("", *rig.ports[name].signals)]
    ready = ", ".join(maps[name] for name in names if name not in lacking)
    parts = [
        f"the value at port {name} is a balance: offer the rough part (the force of the motor, the "
        f"loss of a store) as load= [{rig.ports[name].unit}], and state {maps[name]}"
        for name in lacking
    ]
    return "; ".join([*parts, *([f"background = {{{ready}}}"] if ready else [])])


def _of(rig: Rig, name: str) -> str:
    """The signal of which a map at this port is a share: "" for what passes; of a balance a part of
    it, "load" where none is offered."""
    port = rig.ports[name]
    parts = [s for s in PARTS if s in port.signals and port.unit_of(s) == port.unit]
    if parts:
        return parts[0]
    balance = port.kind in BALANCED and any(
        _is_balance(q) for q in Assembly(rig).traced.passages if q.port == name
    )
    return "load" if balance else ""


def _is_balance(passage: Passage) -> bool:
    """Whether the value follows both the port's motion or store and something else: a balance
    of resistance and drive. A spring's force follows the former alone."""
    zeros = {e: const(0.0) for s, e in passage.signals if s in RESISTING and isinstance(e, Expr)}
    try:
        (rest,) = substitute([passage.value], zeros)
    except EquationError:  # not defined there: no answer
        return False
    driven = any(space in ("state", "input") for space, _ in symbols([rest]))
    return driven and rest is not passage.value


def _along(port: Port) -> str:
    """The signal that a map at this port runs along, "" for what passes."""
    return next((s for s in ALONG if s in port.signals), "")


def mapped_ports(rig: Rig) -> list[str]:
    """Ports whose value comes of a formula of the machine."""
    return [name for name, port in rig.ports.items() if port.kind in MAPPED]


def tolerance_words(rig: Rig) -> list[str]:
    """Advice for a rig without tolerances, with the line that states them; or for the tolerances of
    a balance as a whole."""
    mapped = mapped_ports(rig)
    if rig.background or not mapped:
        whole = [
            name
            for name, terms in background_by_port(rig).items()
            if _of(rig, name)
            and any(isinstance(term, RoughMap) and term.of == "value" for term in terms)
        ]
        return [
            f"the map at port {name} is a share of a balance. The balance can be near zero while "
            "its parts are large, so a rough drive looks like friction. State the map as a share "
            f"of the rough part: {stated_roughness(rig, name)}"
            for name in whole
        ]
    along = {_along(rig.ports[name]) for name in mapped}
    absorbed = "; ".join(TAKEN_UP[signal] for signal in ("", *ALONG) if signal in along)
    return [
        "the rig states no tolerances, so an error of 2 % in a force, a flow or a loss can look "
        "like a missing effect, or hide an effect. A map allows such an error, but within its "
        f"tolerance the map can absorb {absorbed}. To allow such errors: "
        f"{stated_roughness(rig, *mapped)}"
    ]


def reachable(
    port: Port, effects: Iterable[type[Effect]], *, any_unit: bool = False
) -> dict[tuple[str, ...], list[str]]:
    """Effects that could act at the port, by the further signals that it would have to offer: ()
    those that act there now. any_unit: whatever the port's unit."""
    by_signals: dict[tuple[str, ...], list[str]] = {(): []}
    for effect in effects:
        if is_home(effect, port) and (any_unit or effect.suits_unit(port.unit)):
            for signals in lacking_signals(effect, port):
                by_signals.setdefault(signals, []).append(effect.name)
    order = sorted(by_signals, key=lambda signals: (len(signals), signals))
    return {signals: sorted(by_signals[signals]) for signals in order}


def ports_of(rig: Rig, effects: Iterable[type[Effect]]) -> list[dict[str, Any]]:
    """Every port of the rig: what passes, its sign, what acts there, and what each further signal
    would let act."""
    kinds = [port.kind for port in rig.ports.values()]
    # as many ports of its kinds as the effect takes together
    known = [
        e
        for e in effects
        if sum(kind in (*e.kinds, *e.general_kinds) for kind in kinds) >= max(1, len(e.roles))
    ]
    fit = attachments(rig, known)
    # ports of motion and actuators whose position or velocity follows from inputs directly
    driven = {
        passage.port
        for passage in Assembly(rig).traced.passages
        if rig.ports[passage.port].kind in ("motion", "actuator-force")
        for name, value in passage.signals
        if name in ("position", "velocity") and isinstance(value, Expr)
        if any(space == "input" for space, _ in symbols([value]))
    }
    rows = []
    for name, port in rig.ports.items():
        more = reachable(port, known)
        more.pop(())
        rows.append(
            {
                "rig": rig.name,
                "port": name,
                "kind": port.kind,
                "unit": port.unit,
                "signals": {s: port.unit_of(s) for s in port.signals},
                "passes": GUIDE[port.kind].passes,
                "sign": GUIDE[port.kind].sign,
                "imposed": name in driven,
                "size": dict(port.size),
                "effects": sorted({a.effect.name for a in fit if name in a.ports}),
                "unlocks": [{"signals": list(s), "effects": names} for s, names in more.items()],
            }
        )
    return rows


def driven_by_speed(rig: Rig) -> dict[str, float]:
    """Ports of motion whose value grows with the `velocity` that is offered there, with the slope
    in SI, from a unit backwards to a unit forwards: at the data sheet's values, in the states of
    the start, with inputs at 0.

    What acts on a moving part opposes its motion, so that the value falls with the velocity; where
    it grows, the sign of the port is most likely wrong, and every friction would drive.
    """
    assembly = Assembly(rig)
    p = assembly.values()
    known = {symbol("parameter", b.key): const(p[i]) for i, b in enumerate(assembly.parameters)}
    known |= {symbol("state", name): const(x) for name, x in assembly.begin(p).items()}
    known |= {symbol("input", name): const(0.0) for name in assembly.traced.inputs}
    resistances = {}
    for passage in assembly.traced.passages:
        velocity = dict(passage.signals).get("velocity")
        if rig.ports[passage.port].kind != "motion" or not isinstance(velocity, Expr):
            continue
        try:
            ahead, back = (
                substitute(substitute([passage.value], {velocity: const(v)}), known)[0]
                for v in (1.0, -1.0)
            )
        except EquationError:  # not defined there: no answer
            continue
        if ahead.op == back.op == "const" and ahead.value > back.value:
            resistances[passage.port] = 0.5 * (ahead.value - back.value)
    return resistances


def driving_words(rig: Rig) -> list[str]:
    """A sentence for each port of `driven_by_speed`, and how to correct it."""
    return [
        f"The value at port {port!r} increases with the velocity (slope {slope:.3g}), so damping "
        "would accelerate the part. Pass the force that acts on the moving part along its "
        "position. A sensor of the driving force gets the negative value."
        for port, slope in driven_by_speed(rig).items()
    ]


# ---- text ----------------------------------------------------------------------------------------


def ports_text(rows: list[dict[str, Any]]) -> list[str]:
    """`ports_of` for people, as lines."""
    lines = []
    for row in rows:
        offers = ", ".join(f"{s} [{unit}]" if unit else s for s, unit in row["signals"].items())
        unit = f" [{row['unit']}]" if row["unit"] else ""
        lines.append(f"port   {row['port']}: {row['kind']}{unit}, offers {offers or 'no signals'}")
        lines += _folded("passes", row["passes"]) + _folded("sign", row["sign"])
        lines += _folded("!", IMPOSED) if row["imposed"] else []
        lines += _folded("acts", ", ".join(row["effects"]) or "nothing of the catalogue")
        for further in row["unlocks"]:
            lines += _folded(
                f"with {' and '.join(further['signals'])}", ", ".join(further["effects"])
            )
    return lines


def grouped_ports_text(rows: list[dict[str, Any]], most: int) -> list[str]:
    """`ports_of` on a few lines: like ports together, with the effects that act there.

    most: lines per group, the first included.
    """
    groups: dict[tuple[str, str, tuple[str, ...]], list[str]] = {}
    for row in rows:
        alike = row["kind"], row["unit"], tuple(row["effects"])
        groups.setdefault(alike, []).append(row["port"])
    lines = []
    for (kind, unit, effects), names in groups.items():
        at = f"{len(names)} ports, " if len(names) > 1 else ""
        shown = " .. ".join(dict.fromkeys((names[0], names[-1])))
        count = "1 effect" if len(effects) == 1 else f"{len(effects)} effects"
        lines.append(f"port   {kind}{f' [{unit}]' if unit else ''} at {at}{shown}: {count}")
        lines += cut("\n".join(_folded("acts", ", ".join(effects))), most - 1)
    return lines


def cut(text: str, most: int) -> list[str]:
    """The first lines of a text, the last of them with a sign where more follow."""
    lines = text.splitlines()
    return (
        lines
        if len(lines) <= most
        else [f"{s} .." if s is lines[most - 1] else s for s in lines[:most]]
    )


def _folded(title: str, words: str) -> list[str]:
    plain = words.replace("`", "")
    return folded(f"{title} {plain}" if title == "!" else f"{title}: {plain}", 9).splitlines()


def folded(words: str, indent: int = 0) -> str:
    """The words on lines of a terminal's width, those after the first indented by four more (by 7
    where the first is not: behind the word that leads a finding)."""
    return "\n".join(wrapped(words, indent, further=4 if indent else 7))


def wrapped(words: str, indent: int, *, further: int = 4) -> list[str]:
    """The words on lines of a terminal's width, indented; those after the first further."""
    return textwrap.wrap(
        words,
        WIDTH,
        initial_indent=" " * indent,
        subsequent_indent=" " * (indent + further),
        break_on_hyphens=False,
        break_long_words=False,
    )
