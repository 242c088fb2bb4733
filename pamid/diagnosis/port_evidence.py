"""Where something is missing: the evidence for a latent value at each port, and how the ports share
it.

A port at which a small, slow value explains every channel wins over one that has to follow each
sensor's error by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import combinations
from math import factorial

import numpy as np

from pamid.base.errors import PamidError
from pamid.diagnosis.contender import Contender
from pamid.diagnosis.smoother import Smoother
from pamid.model.rig import Rig
from pamid.parallel.jobs import Failed, Work, WorkerPool
from pamid.parallel.result_store import Plain
from pamid.simulation.data_split import Evidence

# ports with this share of another one's evidence: these recordings do not tell them apart
ALIKE = 0.98
PLAYERS = 2  # ports whose joint evidence is computed
CROWDED = 20  # ports from which on only outstanding ones are looked at closely
OUTSTANDING = 0.15  # of the largest evidence with the parameters held

Ports = tuple[str, ...]
Found = tuple[float, float, float]  # log evidence, size, time constant


@dataclass(frozen=True)
class Located:
    """Log evidence gained (nats) by a latent value at each port.

    classes: ports about which these recordings say the same, the leading one first, strongest class
    first; worth: each class's Shapley value (nats), by its leading port.
    """

    gains: dict[str, float]
    classes: tuple[tuple[str, ...], ...]
    worth: dict[str, float]
    smoothers: dict[str, Smoother] = field(compare=False, repr=False)

    def shares(self, rig: Rig, named: str = "") -> dict[str, float]:
        """Every port group's share of the whole: the groups of a class divide its worth unless one
        is named."""
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


@dataclass(frozen=True, eq=False)
class _Smoothing(Work[Ports, Found]):
    """The log evidence for latent values at ports (none: of the model as it is) with their most
    likely size and time constant; moving: do the parameters?"""

    what = "looking for what is missing at"
    evidence: Evidence
    base: Contender
    moving: bool
    smoothers: dict[Ports, Smoother] = field(default_factory=dict, compare=False, repr=False)

    def smoother(self, ports: Ports) -> Smoother:
        return self.smoothers.setdefault(ports, Smoother(self.evidence, self.base, ports))

    def __call__(self, item: Ports) -> Plain:
        smoother = self.smoother(item)
        return {"found": smoother.best if self.moving else smoother.rough}

    def restored(self, item: Ports, found: Plain) -> Found:
        evidence, size, time_s = found["found"]
        return evidence, size, time_s

    def name(self, item: Ports) -> str:
        return " and ".join(item) or "no port"


def locate(
    evidence: Evidence, base: Contender, pool: WorkerPool, ports: list[str] | None = None
) -> Located:
    """Evidence for a latent value at every port, and Shapley values of the classes of ports.

    With `ports` only these are tried, and nothing is shared out. Joint evidence is computed for the
    leading classes only.
    """
    work = _Smoothing(evidence, base, True)
    names = ports or list(evidence.rig.ports)
    smoothers = {name: work.smoother((name,)) for name in names}
    twins = {
        name: next(
            k for k in names if smoothers[k].assembly.program is smoothers[name].assembly.program
        )
        for name in names
    }  # a value enters the equations there as it does here
    own = [name for name in names if twins[name] == name]
    known: dict[Ports, Found] = {}
    found_at = _found_at(work, own, pool, known)
    gains = {name: found_at[twins[name]] for name in names}
    classes: dict[str, list[str]] = {}
    for name in sorted(names, key=lambda k: -gains[k]):
        leader = next((k for k in classes if gains[name] >= ALIKE * gains[k]), name)
        classes.setdefault(leader, []).append(name)
    found = tuple(tuple(k) for k in classes.values())
    if ports is not None:
        return Located(gains, found, {}, smoothers)
    players = [leader for leader in classes if gains[leader] > 0.0][:PLAYERS]
    value: dict[frozenset[str], float] = {frozenset(): 0.0} | {
        frozenset((k,)): gains[k] for k in players
    }
    for size in range(2, len(players) + 1):
        together = list(combinations(players, size))
        for members, joint in zip(together, _gains(work, together, pool, known), strict=True):
            value[frozenset(members)] = max(
                [joint, *(value[frozenset(members) - {m}] for m in members)]
            )
    return Located(gains, found, shapley(players, value), smoothers)


def _found_at(
    work: _Smoothing, names: list[str], pool: WorkerPool, known: dict[Ports, Found]
) -> dict[str, float]:
    """Evidence gained at each of these ports. Of many only those that stand out with the parameters
    held are looked at with the parameters moving."""
    rough: dict[str, float] = {}
    if len(names) > CROWDED:
        held = replace(work, moving=False)
        rough = dict(zip(names, _gains(held, [(name,) for name in names], pool, {}), strict=True))
    most = max(rough.values(), default=0.0)
    near = [name for name in names if not rough or rough[name] >= OUTSTANDING * most]
    full = dict(zip(near, _gains(work, [(name,) for name in near], pool, known), strict=True))
    share = max(full.values()) / most if most > 0.0 else 0.0
    return {name: full.get(name, share * rough.get(name, 0.0)) for name in names}


def _gains(
    work: _Smoothing, items: list[Ports], pool: WorkerPool, known: dict[Ports, Found]
) -> list[float]:
    """Log evidence beyond that without a latent value; 0 where neither path can be followed, or the
    job failed.

    known: what was found without one, if it was.
    """
    wanted = items if () in known else [(), *items]
    results = pool.run(work, wanted)
    found = dict(zip(wanted, results, strict=True))
    nothing = known[()] if () in known else found[()]
    if isinstance(nothing, Failed):
        raise PamidError(f"{nothing.job} failed: {nothing.why}", code="jobs")
    known[()] = nothing
    return [
        max(f[0] - nothing[0], 0.0)
        if not isinstance(f, Failed) and np.isfinite([f[0], nothing[0]]).all()
        else 0.0
        for f in (found[ports] for ports in items)
    ]


def shapley(players: list[str], value: dict[frozenset[str], float]) -> dict[str, float]:
    """Shapley value of every player of a game given by the worth of every coalition."""
    n = len(players)
    out = {}
    for one in players:
        others = [q for q in players if q != one]
        out[one] = sum(
            factorial(k)
            * factorial(n - k - 1)
            / factorial(n)
            * (value[frozenset((*c, one))] - value[frozenset(c)])
            for k in range(n)
            for c in combinations(others, k)
        )
    return out
