"""Structural isolability: ports that a set of sensors can separate, by the rig's equations.

Every port is cut at every place: the value that leaves it is an unknown, with the equation cut =
f(states, inputs, other cuts) + fault. A state and its rate are an unknown with an equation; every
measured output adds an equation. The sensors check the part with more equations than unknowns
(Dulmage and Mendelsohn, Canad. J. Math. 10, 1958, 517). A fault hides behind another if it leaves
that part once the other's equation is taken away (Krysander, Aslund and Nyberg, IEEE Trans. SMC-A
38, 2008, 197).

A single place is at fault at a time and parameters count as known. The analysis uses only the
occurrence of unknowns in equations, in any regime; gains, noise and the form of an effect do not
count. It is thus a bound for an effect of unknown form, and a known form may separate ports that
hide here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import combinations
from operator import attrgetter

import numpy as np

from pamid.base.errors import UsageError, nearest
from pamid.base.schemas.diagnosis_file import Sensor
from pamid.engine.symbolic.expression import symbol, symbols
from pamid.engine.symbolic.vocabulary import Expr
from pamid.model.effect import Effect
from pamid.model.rig import Rig
from pamid.model.trace import Passage, Traced, trace

Unknown = tuple[str, str]  # (space, name) of a state or a cut
MOST_SENSORS = 5


@dataclass(frozen=True)
class Isolability:
    """Structural isolability of a set of outputs; names in the order of the rig's ports.

    groups         port groups (`Rig.group_of`) of the places in each class of `places`, singletons
                   included, less what is part of a larger set; they overlap where a group has
                   ports or places in several classes
    unseen         port groups none of whose places can be checked
    sensors        further sensors (or a sensor at each place of a port), outputs of the rig first,
                   best first
    redundancy     equations beyond the unknowns in the checked part: independent checks that the
                   outputs allow
    places         classes of port places (muscle_1) that cannot be separated where any of them is
                   at fault
    unseen_places  port places that cannot be checked
    """

    groups: tuple[tuple[str, ...], ...]
    unseen: tuple[str, ...]
    sensors: tuple[Sensor, ...]
    redundancy: int
    places: tuple[tuple[str, ...], ...]
    unseen_places: tuple[str, ...]


@lru_cache(maxsize=8)  # a diagnosis needs it when it judges and when it reports
def isolability(rig: Rig, outputs: tuple[str, ...]) -> Isolability:
    """Structural isolability of these outputs of the rig; a sensor that is not there is nowhere
    listed. UsageError."""
    for name in outputs:
        if name not in rig.outputs:
            raise UsageError(
                f"rig {rig.name!r} has no output {name!r}",
                nearest(name, rig.outputs) or f"outputs: {', '.join(rig.outputs)}",
            )
    view, where = _View(rig, cut_rig(rig), outputs), attrgetter("where")
    return Isolability(
        view.groups,
        view.unseen,
        tuple(_splits(view)),
        view.structure.redundancy,
        view.classes(where),
        view.unseen_by(where),
    )


# ---- structure ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Structure:
    """A system of equations, each the set of the unknowns in it."""

    equations: tuple[frozenset[Unknown], ...]

    def checked(self, without: frozenset[int] = frozenset()) -> frozenset[int]:
        """The over-determined part of the system less some equations: all that an alternating path
        reaches from an equation left over by a largest matching."""
        rows = [i for i in range(len(self.equations)) if i not in without]
        owner, over = self._matched(rows)
        reached = set(over)
        while over:
            for i in {owner[v] for v in self.equations[over.pop()]} - reached:
                reached.add(i)
                over.append(i)
        return frozenset(reached)

    def _matched(self, rows: list[int]) -> tuple[dict[Unknown, int], list[int]]:
        """The equation matched to each unknown, and the equations left over."""
        # loads half of scipy, which a worker process need not do
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import maximum_bipartite_matching

        column = {v: k for k, v in enumerate(sorted({v for i in rows for v in self.equations[i]}))}
        if not column:
            return {}, rows
        indices = [column[v] for i in rows for v in sorted(self.equations[i])]
        indptr = np.cumsum([0, *(len(self.equations[i]) for i in rows)])
        graph = csr_array((np.ones(len(indices)), indices, indptr), shape=(len(rows), len(column)))
        match = maximum_bipartite_matching(graph, perm_type="column").tolist()
        unknowns = list(column)
        return (
            {unknowns[k]: i for i, k in zip(rows, match, strict=True) if k >= 0},
            [i for i, k in zip(rows, match, strict=True) if k < 0],
        )

    @cached_property
    def part(self) -> frozenset[int]:
        """The over-determined part of the whole."""
        return self.checked()

    def hidden_by(self, i: int) -> frozenset[int]:
        """Equations that can no longer be checked where equation i is in doubt, itself included."""
        return self.part - self.checked(frozenset({i}))

    @property
    def redundancy(self) -> int:
        """Equations beyond the unknowns in the over-determined part."""
        return len(self.part) - len({v for i in self.part for v in self.equations[i]})


class _Cut(Effect):
    """Puts a symbol in the place of whatever passes through a port."""

    def __init__(self, unknown: Expr) -> None:
        self.unknown = unknown

    def act(self, value: Expr, at: object, p: object, z: object) -> Expr:
        return self.unknown


def cut_rig(rig: Rig, space: str = "cut", name: str = "{0}_{1}") -> Traced:
    """The equations with a symbol for what leaves each port; name: of a port and a place."""

    def cut(port: str, place: str) -> list[tuple[str, Effect]]:
        return [(space, _Cut(symbol(space, name.format(port, place) if place else port)))]

    return trace(rig, cut, {})


@lru_cache(maxsize=1024)  # of an arm of seven joints an equation has thousands of nodes
def unknowns_of(root: Expr) -> frozenset[Unknown]:
    """The states and cuts that an expression holds."""
    return frozenset(s for s in symbols([root]) if s[0] in ("state", "cut"))


def _cuts(root: Expr) -> set[str]:
    return {name for space, name in unknowns_of(root) if space == "cut"}


# ---- ports -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _View:
    """A cut rig seen through some outputs, and through direct measurements of what leaves some
    ports (`measured`)."""

    rig: Rig
    traced: Traced
    outputs: tuple[str, ...]
    measured: tuple[str, ...] = ()

    @cached_property
    def passages(self) -> tuple[Passage, ...]:
        """Those that a state or a measured output depends on, in the order of the rig's ports."""
        by_name = {p.where: p for p in self.traced.passages}
        waiting = [*self.traced.rates.values(), *(self.traced.outputs[o] for o in self.outputs)]
        ports: set[str] = set()
        while waiting:
            new = _cuts(waiting.pop()) - ports
            ports |= new
            waiting += [by_name[n].value for n in new]
        return tuple(
            by_name[p.where]
            for name in self.rig.ports
            for p in self.traced.passages
            if p.port == name and p.where in ports
        )

    @cached_property
    def structure(self) -> Structure:
        """The passages' equations, in their order, then those of states, outputs and direct
        measurements."""
        return Structure(
            (
                *(unknowns_of(p.value) | {("cut", p.where)} for p in self.passages),
                *(
                    unknowns_of(rate) | {("state", name)}
                    for name, rate in self.traced.rates.items()
                ),
                *(unknowns_of(self.traced.outputs[o]) for o in self.outputs),
                *(frozenset({("cut", p.where)}) for p in self.passages if p.port in self.measured),
            )
        )

    @cached_property
    def _classes(self) -> list[list[Passage]]:
        """Visible passages, those together that hide behind each other: for single equations it
        goes both ways."""
        visible = [i for i in range(len(self.passages)) if i in self.structure.part]
        hidden = dict.fromkeys(self.structure.hidden_by(i) for i in visible)
        return [[p for i, p in enumerate(self.passages) if i in h] for h in hidden]

    def classes(self, name: Callable[[Passage], str]) -> tuple[tuple[str, ...], ...]:
        """The names in each class of passages, less what is part of a larger set."""
        order = list(dict.fromkeys(map(name, self.passages)))
        by_passages = dict.fromkeys(frozenset(map(name, passages)) for passages in self._classes)
        return tuple(
            tuple(sorted(f, key=order.index))
            for f in by_passages
            if not any(f < other for other in by_passages)
        )

    def group(self, passage: Passage) -> str:
        return self.rig.group_of(passage.port)

    @cached_property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        return self.classes(self.group)

    def unseen_by(self, name: Callable[[Passage], str]) -> tuple[str, ...]:
        """Names of which no passage is checked."""
        seen = {name(p) for i, p in enumerate(self.passages) if i in self.structure.part}
        return tuple(dict.fromkeys(name(p) for p in self.passages if name(p) not in seen))

    @cached_property
    def unseen(self) -> tuple[str, ...]:
        return self.unseen_by(self.group)


# ---- further sensors ---------------------------------------------------------------------------


def _further(view: _View) -> list[tuple[str, _View]]:
    """The outputs not measured yet, those that a port returns taken together; then what leaves
    each port."""
    sensors: dict[tuple[str, ...], list[str]] = {}
    for name in view.rig.outputs:
        if name not in view.outputs:
            cuts = _cuts(view.traced.outputs[name])
            ports = {p.port for p in view.traced.passages if p.where in cuts}
            sensors.setdefault(tuple(sorted(ports)) or (name,), []).append(name)
    outputs = [
        (" and ".join(s), replace(view, outputs=(*view.outputs, *s))) for s in sensors.values()
    ]
    cut = dict.fromkeys(p.port for p in view.passages)
    return outputs + [
        (f"the value at port {port}", replace(view, measured=(port,))) for port in cut
    ]


def _pairs(groups: Sequence[tuple[str, ...]]) -> set[tuple[str, str]]:
    return {pair for group in groups for pair in combinations(group, 2)}


def _splits(view: _View) -> list[Sensor]:
    """Sensors that bring something, outputs first, each kind by the pairs of port groups taken
    apart or shown."""
    splits: list[tuple[bool, int, Sensor]] = []
    for name, there in _further(view):
        apart = tuple(
            g for g in view.groups if not any(set(g) <= set(other) for other in there.groups)
        )
        shows = tuple(g for g in view.unseen if g not in there.unseen)
        if apart or shows:
            gain = len(_pairs(view.groups) - _pairs(there.groups)) + len(shows)
            sensor = Sensor(sensor=name, splits=apart)
            splits.append((there.outputs == view.outputs, -gain, sensor))
    return [split for *_, split in sorted(splits, key=lambda f: f[:2])[:MOST_SENSORS]]
