"""Screening: a few Gauss-Newton steps per candidate send it on or not. It never decides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.assembly import Assembly
from pamid.attaching import Attachment
from pamid.binding import Sizes
from pamid.diagnosis.contest import Contender, set_within_bounds, transferred
from pamid.effect import Hints
from pamid.errors import PamidError
from pamid.evidence import Evidence
from pamid.fitting import Problem, fit, free_parameters
from pamid.greybox import model_with

Array = NDArray[np.float64]

STEPS = 4
MOST = 10              # candidates sent on, beside the best of every further family
FEW = 26               # with no more candidates than these all are sent on: the runners-up belong into the answer


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


def screen(evidence: Evidence, baseline: Contender, attachment: Attachment, sizes: Sizes, hints: Hints) -> Screened:
    """Gain of one candidate after a few steps from each of its starting points, from the baseline's solution."""
    try:
        assembly = model_with(evidence, (*baseline.attached, attachment), sizes)
        tracks = evidence.tracks(assembly)
        problem = Problem(assembly, tracks, free_parameters(assembly, tracks))
    except PamidError as error:
        return Screened(attachment, None, {}, -np.inf, str(error))
    best = Screened(attachment, assembly, {}, -np.inf, "unstable at every starting value")
    for first in starting_points(assembly, attachment, hints):
        p = transferred(assembly, baseline.assembly, baseline.fit.p)
        set_within_bounds(assembly, p, first)
        done = fit(problem, p=p, starts=baseline.fit.starts, weights=baseline.fit.weights, iterations=STEPS,
                   pulls=baseline.fit.pulls, tolerance=1e-2)
        gain = baseline.fit.cost - done.cost
        if gain > best.gain:
            best = Screened(attachment, assembly, first, gain)
    return best


def sent_on(rig_family: dict[str, str], screened: list[Screened]) -> list[Screened]:
    """The most promising ones: the best by gain, and the best of every family."""
    usable = sorted((s for s in screened if s.assembly is not None and np.isfinite(s.gain)),
                    key=lambda s: (-s.gain, s.attachment.label))
    if not usable:
        return []
    top = usable[0].gain
    if len(usable) <= FEW:
        return usable
    kept = usable[:MOST]
    families = {rig_family[s.attachment.label] for s in kept}
    for s in usable:
        family = rig_family[s.attachment.label]
        if family not in families and s.gain > max(1.0, 0.02 * top):
            kept.append(s)
            families.add(family)
    return kept
