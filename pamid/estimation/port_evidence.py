"""Where something is missing: the evidence for a latent value at each port, and its Shapley values.

At port g an unknown value d_g(t) is added to the model, an Ornstein-Uhlenbeck process of standard
deviation s and time constant T. Its log evidence, with the states x and parameters p integrated out
by Laplace's approximation (`pamid.estimation.smoother`), is maximised over a grid of s and T:

    v(g) = max_(s,T) log p(y | d_g ~ OU(s, T)) - log p(y | no latent value)   [nats]

The evidence penalises size and speed. A port at which a small, slow value explains every channel
has more evidence than a port whose value has to follow each sensor's error by itself. Rogers,
Worden and Cross (2020), Vibration 3:281, and Rogers and Friis (2022), Mech. Syst. Signal Process.
180:109426, for latent forces; Kass and Raftery (1995), JASA 90:773, for the scale of nats.

The two classes of ports with most evidence share what both together explain by their Shapley values
(Shapley 1953, A value for n-person games): with v(gh) of both,

    worth(g) = v(g) / 2 + (v(gh) - v(h)) / 2
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from pamid.base.errors import PamidError
from pamid.base.parallel.jobs import Failed, Work, WorkerPool
from pamid.estimation.smoother import ReplayedModel, Smoother
from pamid.model.rig import Rig
from pamid.simulation.data_split import DataSplit

# of more ports than this only those with this share of the largest evidence, computed with the
# parameters held, are looked at with the parameters moving, which is several times as slow
MANY_PORTS, OUTSTANDING = 20, 0.15

Ports = tuple[str, ...]


@dataclass(frozen=True)
class PortEvidence:
    """Log evidence gained (nats) by a latent value at each port.

    classes: ports about which these recordings agree, the leading port first, strongest class
    first; worth: each class's Shapley value (nats), by its leading port.
    """

    gains: dict[str, float]
    classes: tuple[tuple[str, ...], ...]
    worth: dict[str, float]
    smoothers: dict[str, Smoother] = field(compare=False, repr=False)

    def shares(self, rig: Rig) -> dict[str, float]:
        """Every port group's share of the Shapley values, which the groups of a class divide
        equally; without these, of the evidence."""
        out = {rig.group_of(name): 0.0 for name in rig.ports}
        for members in self.classes if self.worth else ():
            groups = dict.fromkeys(rig.group_of(name) for name in members)
            for group in groups:
                out[group] += self.worth.get(members[0], 0.0) / len(groups)
        for name, gain in self.gains.items() if not self.worth else ():
            out[rig.group_of(name)] += gain
        total = sum(out.values())
        return {k: v / total if total > 0.0 else 1.0 / len(out) for k, v in out.items()}

    @property
    def most(self) -> float:
        """The largest evidence, nats."""
        return max(self.gains.values(), default=0.0)


@dataclass(frozen=True, eq=False)
class _SmoothingWork(Work[Ports, float]):
    """The log evidence for latent values of the most likely size and time constant at ports (none:
    of the model as it is); moving: do the parameters?"""

    what = "looking for what is missing at"
    evidence: DataSplit
    base: ReplayedModel
    moving: bool
    smoothers: dict[Ports, Smoother] = field(default_factory=dict, compare=False, repr=False)

    def smoother(self, ports: Ports) -> Smoother:
        return self.smoothers.setdefault(ports, Smoother(self.evidence, self.base, ports))

    def __call__(self, item: Ports) -> float:
        smoother = self.smoother(item)
        return float((smoother.best if self.moving else smoother.rough).log_evidence)

    def name(self, item: Ports) -> str:
        return " and ".join(item) or "no port"


def locate(
    evidence: DataSplit,
    base: ReplayedModel,
    pool: WorkerPool,
    ports: list[str] | None = None,
    *,
    alike: float,
) -> PortEvidence:
    """Evidence for a latent value at every port, and Shapley values of the classes of ports.

    With `ports` only these are tried, and nothing is shared out. Joint evidence is computed for the
    leading classes only.
    """
    work = _SmoothingWork(evidence, base, True)
    names = ports or list(evidence.rig.ports)
    smoothers = {name: work.smoother((name,)) for name in names}
    twins = {
        name: next(
            k for k in names if smoothers[k].assembly.program is smoothers[name].assembly.program
        )
        for name in names
    }  # a value enters the equations there as it does here
    distinct = [name for name in names if twins[name] == name]
    known: dict[Ports, float] = {}
    evidence_at = _gains_at(work, distinct, pool, known)
    # Ports with the same equations have the same evidence, and each smoothing costs several fits.
    gains = {name: evidence_at[twins[name]] for name in names}
    classes: dict[str, list[str]] = {}
    for name in sorted(names, key=lambda k: -gains[k]):
        # Ports are sorted by evidence, so that the first class within reach is led by the
        # strongest such port.
        leader = next((k for k in classes if gains[name] >= alike * gains[k]), name)
        classes.setdefault(leader, []).append(name)
    port_classes = tuple(tuple(k) for k in classes.values())
    if ports is not None:
        return PortEvidence(gains, port_classes, {}, smoothers)
    # Shapley values of more players need the evidence of every subset, whose number doubles with
    # each.
    leaders = [leader for leader in classes if gains[leader] > 0.0][:2]
    worth = {leader: gains[leader] for leader in leaders}
    if len(leaders) == 2:
        leader_port, other = leaders
        # a latent value of size zero is free to take: more ports are never worth less, though the
        # coarse grid of sizes may say so
        joint = max(
            *_gains(work, [(leader_port, other)], pool, known), gains[leader_port], gains[other]
        )
        worth = {
            leader_port: shapley_value(gains[leader_port], gains[other], joint),
            other: shapley_value(gains[other], gains[leader_port], joint),
        }
    return PortEvidence(gains, port_classes, worth, smoothers)


def _gains_at(
    work: _SmoothingWork, names: list[str], pool: WorkerPool, known: dict[Ports, float]
) -> dict[str, float]:
    """Evidence gained at each of these ports. Of many ports only those that stand out with the
    parameters held are evaluated with the parameters moving."""
    rough: dict[str, float] = {}
    if len(names) > MANY_PORTS:
        held = replace(work, moving=False)
        gains = _gains(held, [(name,) for name in names], pool, {})
        rough = {name: max(gain, 0.0) for name, gain in zip(names, gains, strict=True)}
    most = max(rough.values(), default=0.0)
    near = [name for name in names if not rough or rough[name] >= OUTSTANDING * most]
    full = dict(zip(near, _gains(work, [(name,) for name in near], pool, known), strict=True))
    # Moving parameters may take up what was gained, not more: then they have run away.
    sound = {name: gain for name, gain in full.items() if gain >= -rough.get(name, np.inf)}
    # those without a close figure keep their rough figure, on the scale of the close ones
    share = max(sound.values(), default=most) / most if most > 0.0 else 0.0
    return {name: max(sound.get(name, share * rough.get(name, 0.0)), 0.0) for name in names}


def _gains(
    work: _SmoothingWork, items: list[Ports], pool: WorkerPool, known: dict[Ports, float]
) -> list[float]:
    """Log evidence beyond that without a latent value; -inf where the model with or without it
    becomes unstable, or the job failed. Below zero the smoothing has not converged, up to the
    coarse grid of sizes: a latent value of size zero costs nothing.

    known: the evidence without a latent value, once it has been computed.
    """
    wanted = items if () in known else [(), *items]
    results = pool.run(work, wanted)
    by_ports = dict(zip(wanted, results, strict=True))
    nothing = known[()] if () in known else by_ports[()]
    if isinstance(nothing, Failed):
        raise PamidError(f"{nothing.job} failed: {nothing.why}", code="jobs")
    known[()] = nothing
    return [
        found - nothing
        if not isinstance(found, Failed) and np.isfinite([found, nothing]).all()
        else -np.inf
        for found in (by_ports[ports] for ports in items)
    ]


def shapley_value(alone: float, other: float, joint: float) -> float:
    """Shapley value of either of two players, from the values of each alone and of both
    together."""
    return 0.5 * alone + 0.5 * (joint - other)
