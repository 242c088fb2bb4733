"""Connections between the ports of a rig, read from its equations, for a block diagram.

Every port is cut, as in `isolability`. A port follows another where its value holds the value that
leaves the other, or a state whose rate, through further states, does.
"""

from __future__ import annotations

from collections.abc import Iterable

from pamid.base.schemas.rig_map import MappedPort, RigMap
from pamid.engine.symbolic.vocabulary import Expr
from pamid.model.isolability import cut_rig, unknowns_of
from pamid.model.rig import Rig


def rig_map(rig: Rig, outputs: Iterable[str]) -> RigMap:
    """Ports of the rig in its order, the places of a port taken together, each with the ports
    that it leads to; outputs: those that were measured. A port that leads to none of them is left
    out, as that of a sensor that was not recorded.

    FileError where the rig's equations cannot be traced."""
    traced = cut_rig(rig)
    port_of = {passage.where: passage.port for passage in traced.passages}
    before: dict[str, set[str]] = {name: set() for name in rig.ports}

    def sources(value: Expr) -> set[str]:
        """Ports that a value holds, at once or through the rates of states."""
        ports, passed, waiting = set[str](), set[str](), [*unknowns_of(value)]
        while waiting:
            space, name = waiting.pop()
            if space == "cut":
                ports.add(port_of[name])
            elif name in traced.rates and name not in passed:
                passed.add(name)
                waiting += unknowns_of(traced.rates[name])
        return ports

    for passage in traced.passages:
        before[passage.port] |= sources(passage.value)
    outputs = tuple(outputs)
    waiting = [port for name in outputs for port in sources(traced.outputs[name])]
    seen: set[str] = set()
    while waiting:
        port = waiting.pop()
        if port not in seen:
            seen.add(port)
            waiting += before[port]
    return RigMap(
        name=rig.name,
        inputs=tuple(rig.inputs),
        outputs=outputs,
        ports=tuple(
            MappedPort(
                port=name,
                group=rig.group_of(name),
                kind=port.kind,
                unit=port.unit,
                leads_to=tuple(
                    other
                    for other in rig.ports
                    if name in before[other] and other != name and other in seen
                ),
            )
            for name, port in rig.ports.items()
            if name in seen
        ),
    )
