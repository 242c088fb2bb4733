"""Ranges of an effect's parameters: wider where a fit ends at a guess, mirrored where it ends at
nothing.

A range in multiples of a typical magnitude is a guess. Where a fit ends at its upper end (or at the
lower end of a factor that makes the equation softer) the effect is fitted again over a wider range.
Only a parameter that still ends there is at its bound. A range between two numbers without a unit
(a share of 0 .. 1) is physics and stays.

An effect whose amount may not be negative and that ends at nothing may act with the opposite sign:
a bench that moves a part and reads the force sees friction with that sign.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.estimation.intervals import estimates
from pamid.estimation.problem import Fit
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment
from pamid.model.bound_parameter import Bound, Range

WIDER = 4.0  # by which a range is widened


def widened(assembly: Assembly, fitted: Fit) -> Assembly | None:
    """The model with wider ranges for the parameters of its effects that ended at a guess; None
    without such parameters. The lower end of a factor stays where it keeps an equation from growing
    stiff."""
    ranges = {
        b.key: (b.low, b.high * WIDER)
        if end == "high"
        else (b.low / WIDER if b.log else b.low * WIDER, b.high)
        for a in assembly.attachments
        for b, end, _ in _at_guesses(assembly, fitted, a.label)
        if not _is_limit(b, end)
    }
    return replace(assembly, ranges={**assembly.ranges, **ranges}) if ranges else None


def with_ranges_of(assembly: Assembly, *others: Assembly) -> Assembly:
    """The model with the ranges to which those of its parameters were widened in others."""
    ranges = {key: r for other in others for key, r in other.ranges.items() if key in assembly.keys}
    return replace(assembly, ranges={**assembly.ranges, **ranges}) if ranges else assembly


def at_bounds(
    model: CandidateModel, settings: Settings = DEFAULT, label: str = ""
) -> tuple[str, ...]:
    """Outside names of the parameters of an effect (default: the last) that press against a bound
    which physics did not set.

    The lower end of a factor is not such a bound: it keeps an equation from growing stiff, and a
    parameter there (friction that gives next to nothing before it slips) is at the limit of its
    form.
    """
    ended = _at_guesses(model.assembly, model.fit, label)
    return tuple(
        b.name for b, end, pressed in ended if pressed > settings.pressed and not _is_limit(b, end)
    )


def at_limits(model: CandidateModel, a: Attachment) -> dict[str, str]:
    """Parameters of an effect that ended at a bound where it is an effect of another family, by
    their names outside, with that family."""
    limits = {f"{a.label}:{name}": family for name, family in a.effect.limits.items()}
    return {
        b.name: limits[b.key]
        for b, e in estimates(model.fit).items()
        if b.key in limits and e.at_bound == "low"
    }


def _is_limit(bound: Bound, end: str) -> bool:
    return end == "low" and bound.log and not bound.softens


def _at_guesses(assembly: Assembly, fitted: Fit, label: str = "") -> list[tuple[Bound, str, float]]:
    """Parameters at the end of a range that is a guess, that end, and the slope there (nats per
    prior spread)."""
    # A fit that has blown up has no meaningful end.
    if not fitted.residuals or not assembly.attachments:
        return []
    owner = label or assembly.attachments[-1].label
    held = fitted.held if fitted.held.size else [0.0] * len(fitted.problem.free)
    return [
        (b, e.at_bound, abs(float(g)))
        for (b, e), g in zip(estimates(fitted).items(), held, strict=True)
        if b.owner == owner and e.at_bound
        # a guess is a multiple of a typical magnitude, and not the amount nothing
        if b.sized and (b.high > 0.0 if e.at_bound == "high" else b.low != 0.0)
    ]


def vanished(model: CandidateModel, label: str) -> tuple[str, ...]:
    """The amounts of an effect of the model, by their names outside, where all of them ended at
    nothing: the model is that without it. Empty where any did not; those that define it, where
    they did: the model is that of a plainer effect."""
    defining = {
        f"{label}:{name}" for a in model.attached if a.label == label for name in a.effect.defining
    }
    amounts = [
        (bound, float(value))
        for bound, value in zip(model.assembly.parameters, model.fit.p, strict=True)
        if bound.owner == label and bound.null is not None
    ]
    # a fit puts a parameter that presses against its bound exactly there
    gone = [bound for bound, value in amounts if value == bound.null]
    # A single amount at nothing is usual, for instance a force in a single direction, unless the
    # effect is defined by it.
    if len(gone) < len(amounts):
        gone = [bound for bound in gone if bound.key in defining]
    return tuple(bound.name for bound in gone)


def amount_z(model: CandidateModel, label: str) -> float:
    """The largest amount of an effect of the model, in its standard deviations from nothing;
    inf of an effect without a fitted amount."""
    f = model.fit
    free = list(f.problem.free)
    scale, deviation = f.problem.scale, np.sqrt(np.maximum(f.covariance.diagonal(), 1e-30))
    nothing = f.p.copy()
    amounts = []
    for k, i in enumerate(free):
        b = model.assembly.parameters[i]
        if b.owner == label and b.null is not None:
            nothing[i] = b.null
            amounts.append(k)
    away = np.abs(scale.inside(f.p[free]) - scale.inside(nothing[free])) / deviation
    return float(away[amounts].max()) if amounts else math.inf


def mirrored(model: CandidateModel) -> dict[str, Range]:
    """Ranges in which the amounts of the model's last effect have the opposite sign; empty where
    they may have either, or where the fit has not ended at nothing."""
    labels = model.additions[-1].labels
    amounts = [
        (b, e)
        for b, e in estimates(model.fit).items()
        if b.owner in labels and b.sized and b.null == b.low == 0.0
    ]
    if not amounts or any(e.at_bound != "low" for _, e in amounts):
        return {}
    return {b.key: (-b.high, 0.0) for b, _ in amounts}
