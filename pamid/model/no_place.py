"""Effects for which a rig has no place, while a rig of the catalogue for the same quantities has
a place: a motor with a single inertia has no place for play between motor and load.

A rig for the same quantities takes the same inputs, by unit, has a reading in
common, and has as many states at least. A recording of the machine could be diagnosed with either.
Rigs with a separate catalogue are left out, and so is a command without a unit, which any
machine may take.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from pamid.base.schemas.catalogue_files import NoPlaceRow
from pamid.model.attachment import attachments, needed_port
from pamid.model.effect import Effect
from pamid.model.rig import Rig


def no_place_words(row: NoPlaceRow) -> str:
    """A sentence on effects without a place, the port that they need, and the rigs that have it."""
    named = ", ".join(f"{name} ({title})" for name, title in row.effects.items())
    have = f"{' and '.join(row.rigs)} {'have' if len(row.rigs) > 1 else 'has'}"
    return f"no port for {named}: the effect needs {row.needs}, which {have}"


def no_places(
    rig: Rig, effects: Iterable[type[Effect]], others: Mapping[str, type[Rig]]
) -> list[NoPlaceRow]:
    """Return the effects that fit a rig for the same quantities and not this rig.

    rig: of the catalogue or of a file; others: rigs to compare with, by name.
    """
    known = {effect.name: effect for effect in effects}
    placed = _placed(rig, known.values())
    elsewhere: dict[str, list[str]] = {}
    for name, kind in others.items():
        other = kind()
        commanded, offered = (
            Counter(symbol for column, symbol in m.inputs.items() if column not in m.optional)
            for m in (rig, other)
        )
        # a command without a unit, which any machine may take, does not identify it
        same = commanded == offered and any(offered) == bool(rig.inputs)
        general = all(port.general for m in (rig, other) for port in m.ports.values())
        read = set(rig.outputs.values()) & set(other.outputs.values())
        holds_as_many = len(other.states) >= len(rig.states)
        if name != rig.name and general and same and read and holds_as_many:
            for effect in sorted(_placed(other, known.values()) - placed):
                elsewhere.setdefault(effect, []).append(name)
    groups: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for effect, names in elsewhere.items():
        groups.setdefault((needed_port(known[effect]), tuple(names)), []).append(effect)
    titles = {name: known[name].story()["title"].rstrip(".") for name in elsewhere}
    return [
        NoPlaceRow(
            effects={name: titles[name][:1].lower() + titles[name][1:] for name in names},
            needs=needs,
            rigs=rigs,
        )
        for (needs, rigs), names in groups.items()
    ]


def _placed(rig: Rig, effects: Iterable[type[Effect]]) -> set[str]:
    return {a.effect.name for a in attachments(rig, effects)}
