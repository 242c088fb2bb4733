"""Attachments of effects to ports of a rig, and their names."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from os.path import commonprefix

from pamid.base.errors import FileError, nearest
from pamid.model.effect import Effect
from pamid.model.rig import Port, Rig


@dataclass(frozen=True)
class Attachment:
    """An effect at ports of a rig. `label` is how it is reported: the name, or
    name@port."""

    effect: Effect
    ports: tuple[str, ...]
    label: str
    place: str = ""

    def group(self, rig: Rig) -> str:
        """The name of its port as it is reported; of several, what their names have in common
        (muscle_11 and muscle_12: muscle_1)."""
        groups = [rig.group_of(name) for name in self.ports]
        return commonprefix(groups).rstrip("_") or groups[0]

    def family(self, rig: Rig) -> str:
        """The effect's family at the port where it acts."""
        return self.effect.family_at(rig.ports[self.ports[0]].kind)

    def acts_at(self, port: str, place: str) -> bool:
        return port in self.ports and self.place in ("", place)


@dataclass(frozen=True)
class Addition:
    """Contribution of a candidate to a model: an effect, or the same effect in several joints.

    Each joint has separate parameters: the joints of a robot all rub, but not alike.
    """

    members: tuple[Attachment, ...]

    @property
    def effect(self) -> Effect:
        return self.members[0].effect

    @property
    def label(self) -> str:
        return " + ".join(self.labels)

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of its members, the owners of its parameters."""
        return tuple(a.label for a in self.members)

    @property
    def ports(self) -> tuple[str, ...]:
        return tuple(port for a in self.members for port in a.ports)

    def group(self, rig: Rig) -> str:
        """The names of its ports as they are reported: "shoulder + elbow"."""
        return " + ".join(dict.fromkeys(a.group(rig) for a in self.members))

    def family(self, rig: Rig) -> str:
        return self.members[0].family(rig)


# kinds of ports at which an effect acts everywhere: all joints of a robot rub; stores, sensors and
# commands have their faults separately
JOINT_KINDS = ("motion",)


# Kinds at which an effect only changes a value that passes: at several of them it costs little more
# than at a single port. Behind flexible transmissions the equations of all joints change.
VALUE_KINDS = ("command", "reading")
FEWEST_ALIKE = 3  # ports of such a kind at which an effect is first tried together


def wholes_of(rig: Rig, additions: Iterable[Addition]) -> list[Addition]:
    """The same effect at all commands, or all readings, of a unit, where each is an addition."""
    groups: dict[tuple[str, str, str], list[Attachment]] = {}
    for added in additions:
        port = rig.ports[added.ports[0]]
        if len(added.ports) == 1 and port.kind in VALUE_KINDS and not port.kin:
            groups.setdefault((added.effect.name, port.kind, port.unit), []).extend(added.members)
    return [Addition(tuple(g)) for g in groups.values() if len(g) >= FEWEST_ALIKE]


def additions_of(rig: Rig, attached: Iterable[Attachment]) -> list[Addition]:
    """Attachments as candidates add them: the same effect at joints of the same unit is a single
    addition. Ports that are kin are tried separately and, with common parameters, together.
    """
    groups: dict[tuple[str, ...], list[Attachment]] = {}
    for a in attached:
        port = rig.ports[a.ports[0]]
        alone = len(a.ports) > 1 or port.kin or port.kind not in JOINT_KINDS
        key = (a.label,) if alone else (a.effect.name, port.kind, port.unit)
        groups.setdefault(key, []).append(a)
    return [Addition(tuple(members)) for members in groups.values()]


def is_home(effect: type[Effect], port: Port) -> bool:
    """Whether the effect acts at ports of this kind."""
    return port.kind in effect.kinds or (port.general and port.kind in effect.general_kinds)


def lacking_signals(effect: type[Effect], port: Port) -> set[tuple[str, ...]]:
    """Further signals that the port would have to offer, by part of the effect; only () where a
    part has all of them."""
    offered = set(port.signals) | ({"position"} if "velocity" in port.signals else set())
    offered |= {s for s in effect.stand_ins if effect.offered_as(s, offered) in offered}
    every = set()
    for role in effect.roles or ((),):
        lacking = {*effect.signals, *role} - offered
        if "velocity" in lacking:  # a position follows from it
            lacking.discard("position")
        every.add(tuple(sorted(lacking)))
    return {()} if () in every else every


def fits(effect: type[Effect], port: Port) -> bool:
    """Whether the effect can act at this port."""
    home = is_home(effect, port) and effect.suits_unit(port.unit)
    return home and () in lacking_signals(effect, port)


def attachments(rig: Rig, effects: Iterable[type[Effect]]) -> list[Attachment]:
    """Every way in which effects can be attached to the rig: at every port separately and, with
    common parameters, at ports that are kin. A special case stays away where its general form fits.
    """
    known = list(effects)
    result: list[Attachment] = []
    for effect in known:
        parents = [e for e in known if e is not effect and issubclass(effect, e)]
        ports = [
            n
            for n, port in rig.ports.items()
            if fits(effect, port) and not any(fits(parent, port) for parent in parents)
        ]
        if effect.roles:
            result += _together(effect, rig, ports)
        elif effect.everywhere and ports:
            result.append(Attachment(effect(), tuple(ports), effect.name))
        elif len(ports) == 1:
            result.append(Attachment(effect(), (ports[0],), effect.name))
        else:
            result += [Attachment(effect(), (n,), f"{effect.name}@{n}") for n in ports]
            for name in filter(None, dict.fromkeys(rig.ports[n].kin for n in ports)):
                kin = tuple(n for n in ports if rig.ports[n].kin == name)
                if len(kin) > 1:
                    result.append(Attachment(effect(), kin, f"{effect.name}@{name}"))
    return result


def needed_port(effect: type[Effect]) -> str:
    """The port that an effect takes, in words: "a transmission port offering stretch"."""
    kinds = " or ".join(dict.fromkeys((*effect.kinds, *effect.general_kinds)))
    needed = [
        " and ".join(dict.fromkeys((*effect.signals, *role))) for role in effect.roles or ((),)
    ]
    article = "an" if kinds.startswith("a") else "a"
    passed = f" in {effect.unit}" if effect.unit else ""
    passed += f" not in {' or '.join(effect.excluded_units)}" if effect.excluded_units else ""
    offered = f" offering {'; and another offering '.join(needed)}" if needed[0] else ""
    return f"{article} {kinds} port{passed}{offered}"


def _together(effect: type[Effect], rig: Rig, ports: list[str]) -> list[Attachment]:
    """A copy at all ports that play a part, in the order of the parts; none where a part is
    left."""
    cast = [[n for n in ports if set(role) <= set(rig.ports[n].signals)] for role in effect.roles]
    if not all(cast):
        return []
    order = tuple(dict.fromkeys(n for part in cast for n in part))
    return [Attachment(effect(), order, effect.name)]


def attach(rig: Rig, spec: str, effects: dict[str, type[Effect]]) -> Attachment:
    """The attachment named `effect`, `effect@port` or `effect@port_place`."""
    name, _, at = spec.partition("@")
    if name not in effects:
        raise FileError(
            f"unknown effect {name!r}", nearest(name, list(effects)) or "see pamid effects"
        )
    possible = [a for a in attachments(rig, effects.values()) if a.effect.name == name]
    if not possible:
        raise FileError(
            f"effect {name!r} fits no port of rig {rig.name!r}: it needs "
            f"{needed_port(effects[name])}; the rig has "
            + ", ".join(f"{n} ({q.kind})" for n, q in rig.ports.items())
        )
    if not at:
        if len(possible) > 1:
            raise FileError(
                f"effect {name!r} fits several ports of rig {rig.name!r}",
                "say which: " + ", ".join(a.label for a in possible),
            )
        return possible[0]
    for a in possible:
        if a.label == spec:
            return a
    for a in possible:
        for port in a.ports:
            if at == port:
                return Attachment(a.effect, (port,), spec)
            for place in rig.ports[port].places:
                if at == f"{port}_{place}":
                    return Attachment(a.effect, (port,), spec, place)
    raise FileError(
        f"effect {name!r} cannot act at {at!r} of rig {rig.name!r}",
        "it fits: " + ", ".join(port for a in possible for port in a.ports),
    )
