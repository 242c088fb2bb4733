"""Which port of a rig leads to which, read from its own equations: what a block diagram shows.

Every port is cut, as in `isolability`. A port follows another where its value holds what leaves the
other, or a state whose rate, through further states, does.
"""

from __future__ import annotations

from collections.abc import Iterable

from pamid.model.isolability import Cut, unknowns_of
from pamid.model.rig import Rig
from pamid.model.trace import Traced, trace
from pamid.schemas.rig_map import MappedPort, RigMap


def rig_map(rig: Rig, outputs: Iterable[str]) -> RigMap:
    """Ports of the rig in its own order, the places of a port taken together, each with the ports
    that it leads to; outputs: those that were measured.

    FileError where the rig's equations cannot be traced."""
    traced = trace(rig, lambda port, place: [("cut", Cut(port, place))], {})
    port_of = {passage.where: passage.port for passage in traced.passages}
    behind = {
        name: {port_of[cut] for cut in cuts} for name, cuts in _cuts_behind_states(traced).items()
    }
    before: dict[str, set[str]] = {name: set() for name in rig.ports}
    for passage in traced.passages:
        for space, name in unknowns_of(passage.value):
            before[passage.port] |= {port_of[name]} if space == "cut" else behind.get(name, set())
    return RigMap(
        name=rig.name,
        inputs=tuple(rig.inputs),
        outputs=tuple(outputs),
        ports=tuple(
            MappedPort(
                port=name,
                group=rig.group_of(name),
                kind=port.kind,
                unit=port.unit,
                leads_to=tuple(
                    other for other in rig.ports if name in before[other] and other != name
                ),
            )
            for name, port in rig.ports.items()
        ),
    )


def _cuts_behind_states(traced: Traced) -> dict[str, set[str]]:
    """State -> the cuts that its rate holds, its own or through the rates of other states."""
    own = {name: unknowns_of(rate) for name, rate in traced.rates.items()}
    found = {}
    for name in own:
        seen, waiting, cuts = {name}, [name], set()
        while waiting:
            for space, other in own.get(waiting.pop(), frozenset()):
                if space == "cut":
                    cuts.add(other)
                elif other not in seen:
                    seen.add(other)
                    waiting.append(other)
        found[name] = cuts
    return found
