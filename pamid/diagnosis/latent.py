"""Where something is missing: the evidence for a latent value at each port, and how the ports share it.

A port at which a small, slow value explains every channel wins over one that has to follow each sensor's error by
itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from math import factorial
from typing import Any

import numpy as np

from pamid.diagnosis.contest import Contender
from pamid.diagnosis.smoother import Smoother
from pamid.evidence import Evidence
from pamid.rig import Rig

ALIKE = 0.98                # ports with this share of another one's evidence: these recordings do not tell them apart
PLAYERS = 2                 # ports whose joint evidence is computed
CROWDED = 20                # ports from which on only outstanding ones are looked at closely
OUTSTANDING = 0.15          # of the largest evidence with the parameters held

Run = Callable[[Callable[[str], Any], list[str]], list[Any]]


@dataclass(frozen=True)
class Located:
    """Log evidence gained (nats) by a latent value at each port.

    classes: ports about which these recordings say the same, the leading one first, strongest class first; worth: each
    class's Shapley value (nats), by its leading port.
    """

    gains: dict[str, float]
    classes: tuple[tuple[str, ...], ...]
    worth: dict[str, float]
    smoothers: dict[str, Smoother]

    def shares(self, rig: Rig, named: str = "") -> dict[str, float]:
        """Every port group's share of the whole: the groups of a class divide its worth unless one is named."""
        out = {rig.group_of(name): 0.0 for name in rig.ports}
        for members in self.classes:
            groups = list(dict.fromkeys(rig.group_of(name) for name in members))
            groups = [named] if named in groups else groups
            for group in groups:
                out[group] += self.worth.get(members[0], 0.0) / len(groups)
        total = sum(out.values())
        return {k: v / total if total > 0.0 else 1.0 / len(out) for k, v in out.items()}

    @property
    def most(self) -> float:
        """The largest evidence, nats."""
        return max(self.gains.values(), default=0.0)

    @property
    def port(self) -> str:
        """The port with the largest evidence."""
        return self.classes[0][0]


def locate(evidence: Evidence, base: Contender, run: Run, ports: list[str] | None = None) -> Located:
    """Evidence for a latent value at every port, and Shapley values of the classes of ports.

    run(work, items) does the jobs. With `ports` only these are tried, and nothing is shared out. Joint evidence is
    computed for the leading classes only.
    """
    plain = Smoother(evidence, base, ())
    names = ports or list(evidence.rig.ports)
    smoothers = {name: Smoother(evidence, base, (name,)) for name in names}
    twins = {name: next(k for k in names if smoothers[k].assembly.program is smoothers[name].assembly.program)
             for name in names}     # a value enters the equations there as it does here
    own = [name for name in names if twins[name] == name]
    found_at = _found_at(plain, smoothers, own, run)
    gains = {name: found_at[twins[name]] for name in names}
    classes: dict[str, list[str]] = {}
    for name in sorted(names, key=lambda k: -gains[k]):
        leader = next((k for k in classes if gains[name] >= ALIKE * gains[k]), name)
        classes.setdefault(leader, []).append(name)
    found = tuple(tuple(k) for k in classes.values())
    if ports is not None:
        return Located(gains, found, {}, smoothers)
    players = [leader for leader in classes if gains[leader] > 0.0][:PLAYERS]
    value: dict[frozenset[str], float] = {frozenset(): 0.0} | {frozenset((k,)): gains[k] for k in players}
    for size in range(2, len(players) + 1):
        for members in combinations(players, size):
            joint = _gained(Smoother(evidence, base, members).best, plain.best)
            value[frozenset(members)] = max([joint, *(value[frozenset(members) - {m}] for m in members)])
    return Located(gains, found, shapley(players, value), smoothers)


def _found_at(plain: Smoother, smoothers: dict[str, Smoother], names: list[str], run: Run) -> dict[str, float]:
    """Evidence gained at each of these ports. Of many only those that stand out with the parameters held are looked at
    with the parameters moving."""
    rough: dict[str, float] = {}
    if len(names) > CROWDED:
        rough = dict(zip(names, run(lambda name: _gained(smoothers[name].rough, plain.rough), names), strict=True))
    most = max(rough.values(), default=0.0)
    near = [name for name in names if not rough or rough[name] >= OUTSTANDING * most]
    full = dict(zip(near, run(lambda name: _gained(smoothers[name].best, plain.best), near), strict=True))
    share = max(full.values()) / most if most > 0.0 else 0.0
    return {name: full.get(name, share * rough.get(name, 0.0)) for name in names}


def _gained(found: tuple[float, float, float], nothing: tuple[float, float, float]) -> float:
    """Log evidence beyond that without a latent value; 0 where neither path can be followed."""
    return max(found[0] - nothing[0], 0.0) if np.isfinite(found[0]) and np.isfinite(nothing[0]) else 0.0


def shapley(players: list[str], value: dict[frozenset[str], float]) -> dict[str, float]:
    """Shapley value of every player of a game given by the worth of every coalition."""
    n = len(players)
    out = {}
    for one in players:
        others = [q for q in players if q != one]
        out[one] = sum(factorial(k) * factorial(n - k - 1) / factorial(n)
                       * (value[frozenset((*c, one))] - value[frozenset(c)])
                       for k in range(n) for c in combinations(others, k))
    return out
