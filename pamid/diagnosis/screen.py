"""Screening: a few Gauss-Newton steps per candidate send it on or not. It never decides."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pamid.assembly import Assembly
from pamid.attaching import Attachment
from pamid.binding import Sizes
from pamid.diagnosis.contest import Contender, set_within_bounds, transferred
from pamid.effect import Hints
from pamid.engine.program import Stepping
from pamid.errors import PamidError
from pamid.evidence import Evidence
from pamid.fitting import Fit, Problem, fit, free_parameters
from pamid.greybox import model_with

Array = NDArray[np.float64]

SCREEN_S = 10.0        # of the fitted recordings, in all: more would change the cost of screening, not its outcome
STEPS = 2              # from the best of the starting points, after one step from each of them
MOST = 8               # candidates refitted, beside the best of every further family
LEAST = 6              # candidates refitted in any case
FEW = 24                # with no more candidates than these all are: the runners-up belong into the answer


@dataclass(frozen=True)
class Screened:
    """A candidate with its best start. gain: drop of the training cost (nats) against the baseline, steps taken."""

    attachment: Attachment
    assembly: Assembly | None
    first: dict[str, float]
    gain: float
    why: str = ""


def starting_points(assembly: Assembly, attachment: Attachment, hints: Hints) -> list[dict[str, float]]:
    """Typical values, one variation per parameter that declares `tries`, and what the effect makes of the hints."""
    own = {b.key: b for b in assembly.parameters if b.owner == attachment.label}
    points: list[dict[str, float]] = [{}]
    points += [{key: value} for key, b in own.items() for value in b.tries]
    for hinted in attachment.effect.starts(hints):
        points.append({f"{attachment.label}:{name}": value * _si(attachment, name) for name, value in hinted.items()})
    return points


def _si(attachment: Attachment, name: str) -> float:
    return next(q.factor for q in attachment.effect.parameters if q.name == name)


@dataclass(frozen=True, eq=False)
class Ground:
    """What candidates are screened against: the baseline over the first part of every fitted recording.

    stops: where that part ends, starts: states at its windows, per track; cost: the baseline's there, after as many
    steps as a candidate is given.
    """

    baseline: Contender
    stops: tuple[int, ...]
    starts: tuple[Array, ...]
    cost: float

    @classmethod
    def of(cls, baseline: Contender) -> Ground:
        problem, base = baseline.fit.problem, baseline.fit
        share = SCREEN_S / sum(len(t) * t.period_s for t in problem.tracks)
        stops, starts = [], []
        for track, x in zip(problem.tracks, base.starts, strict=True):
            windows = problem.windows(track)
            few = min(max(3, round(share * len(windows))), len(windows))
            k = next(k for k in range(few, len(windows) + 1)  # a part is cut as the whole was, or it is the whole
                     if len(problem.windows(track.part(0, windows[k - 1].stop))) == k)
            stops.append(windows[k - 1].stop)
            starts.append(x[:k])
        short = replace(problem, tracks=tuple(t.part(0, s) for t, s in zip(problem.tracks, stops, strict=True)))
        again = fit(short, p=base.p, starts=tuple(starts), weights=base.weights, pulls=base.pulls,
                    stepping=base.stepping, iterations=1 + STEPS, probe=True)
        return cls(baseline, tuple(stops), tuple(starts), again.cost)

    def problem(self, evidence: Evidence, assembly: Assembly) -> Problem:
        tracks = tuple(t.part(0, s) for t, s in zip(evidence.tracks(assembly), self.stops, strict=True))
        return Problem(assembly, tracks, free_parameters(assembly, tracks))


def screen(evidence: Evidence, ground: Ground, attachment: Attachment, sizes: Sizes, hints: Hints) -> Screened:
    """Gain of one candidate after one step from each of its starting points and some more from the best of them, from
    the baseline's solution."""
    baseline = ground.baseline
    try:
        assembly = model_with(evidence, (*baseline.attached, attachment), sizes)
        problem = ground.problem(evidence, assembly)
    except PamidError as error:
        return Screened(attachment, None, {}, -np.inf, str(error))
    unstable = Screened(attachment, assembly, {}, -np.inf, "unstable at every starting value")
    best, found, stepping = unstable, None, None
    for first in starting_points(assembly, attachment, hints):
        p = transferred(assembly, baseline.assembly, baseline.fit.p)
        set_within_bounds(assembly, p, first)
        done = _probed(ground, problem, p, ground.starts, 1, stepping)
        stepping = done.stepping
        if ground.cost - done.cost > best.gain:
            best, found = Screened(attachment, assembly, first, ground.cost - done.cost), done
    if found is None:
        return unstable
    done = _probed(ground, problem, found.p, found.starts, STEPS, stepping)
    return replace(best, gain=max(best.gain, ground.cost - done.cost))


def _probed(ground: Ground, problem: Problem, p: Array, starts: tuple[Array, ...], steps: int,
            stepping: Stepping | None) -> Fit:
    base = ground.baseline.fit
    return fit(problem, p=p, starts=starts, weights=base.weights, pulls=base.pulls, iterations=steps, probe=True,
               stepping=stepping)


def sent_on(rig_family: dict[str, str], screened: list[Screened], most: int) -> list[Screened]:
    """The most promising ones: up to `most` by gain, where these are many those that gain at least a tenth of the first
    and six in any case; and the best of every further family that gains a fifth of the first."""
    usable = sorted((s for s in screened if s.assembly is not None and np.isfinite(s.gain)),
                    key=lambda s: (-s.gain, s.attachment.label))
    if not usable or (most >= MOST and len(usable) <= FEW):
        return usable
    top = usable[0].gain
    kept = [s for i, s in enumerate(usable[:most]) if i < LEAST or s.gain > 0.1 * top]
    families = {rig_family[s.attachment.label] for s in kept}
    for s in usable if most >= MOST else []:
        family = rig_family[s.attachment.label]
        if family not in families and s.gain > max(1.0, 0.2 * top):
            kept.append(s)
            families.add(family)
    return kept
