"""Faults that can be planted in a machine made of a rig: every effect of the catalogue wherever it
fits, and effects outside the catalogue."""

from __future__ import annotations

from dataclasses import replace

from pamid.base.errors import UsageError
from pamid.model.attachment import Attachment, attachments, fits
from pamid.model.registry import effects
from pamid.model.rig import Rig
from pamid.trial.faults import NAMELESS, Draw, Fault, around, between
from pamid.trial.own_forms import FORM_BEND, FORM_SETTLING, FORM_SKEW, NAMELESS_EFFECTS

TIMES_TYPICAL, WAY = "times", "way"  # of what is planted: times the typical size, and which way


def _signed(low: float, high: float) -> Draw:
    return lambda random: float(random.choice((-1.0, 1.0))) * float(random.uniform(low, high))


FORM_DRAWS: dict[str, Draw] = {
    FORM_BEND: _signed(0.2, 0.4),
    FORM_SKEW: _signed(0.03, 0.1),
    FORM_SETTLING: between(0.3, 1.5),  # sampling periods
}


def planted_places(rig: Rig) -> dict[str, Attachment]:
    """Everything that can be planted, by the name of its fault: effect@port, or nameless:word@port.
    UsageError if nothing fits."""
    known = {
        f"{a.effect.name}@{a.label.partition('@')[2] or a.group(rig)}": a
        for a in attachments(rig, effects().values())
    }
    nameless = {
        f"{NAMELESS}{kind.name}@{port}": Attachment(kind(), (port,), f"{kind.name}@{port}")
        for kind in NAMELESS_EFFECTS.values()
        for port, at in rig.ports.items()
        if fits(kind, replace(at, general=True))
    }
    if not known or not nameless:
        raise UsageError(
            f"Nothing can be planted in rig {rig.name!r}: no effect fits its ports.",
            "Add ports; `pamid rigs` shows those of other rigs.",
        )
    return known | nameless


def fault_of(rig: Rig, name: str, a: Attachment) -> Fault:
    """Sizes of a fault as multiples of the typical value at its port on that rig."""
    if name.startswith(NAMELESS):
        return Fault(name, "", a.group(rig), {TIMES_TYPICAL: around(1.0)}, (TIMES_TYPICAL,))
    others = {
        p.name: around(1.0, 0.7, 1.4)
        for p in a.effect.parameters_at(rig.ports[a.ports[0]].kind)
        if p.null is None
    }
    draws = {TIMES_TYPICAL: around(1.0), WAY: _signed(1.0, 1.0), **FORM_DRAWS, **others}
    return Fault(
        name, a.family(rig), a.group(rig), draws, (TIMES_TYPICAL,), frozenset((a.effect.name,))
    )
