"""The answer of a diagnosis, from the figures of the comparison.

    explained           causes; what remains is below a fifth of the gap, or at the noise floor
    partly-explained    causes, and a material remainder
    ambiguous           a set of causes that these recordings cannot separate
    unknown-effect      a curve at a port removes a material share, no effect of the catalogue does
    no-structural-gap   at the noise floor, or nothing at any port removes a material share
    cannot-tell         too few windows, too many causes that tie, or recordings in doubt

Every cause has a probability, a logistic function of the figures of the comparison alone.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.metrics import moving_block_interval
from pamid.base.schemas.diagnosis_file import CAUSED, GapShare
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.comparison import Comparison, families_of
from pamid.diagnosis.family_forms import FreeForm
from pamid.diagnosis.selection import Selection
from pamid.model.attachment import Attachment


@dataclass(frozen=True, eq=False)
class NamedCause:
    """An effect of the answer.

    model    model with the effect
    removes  share of the gap that it removes next to the others
    figures  features of its probability
    or_at    groups of ports at which its family does as well
    instead  families that do as well in its place
    """

    effect: Attachment
    model: CandidateModel
    removes: GapShare
    figures: dict[str, float]
    or_at: tuple[str, ...] = ()
    instead: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Answer:
    """Verdict, causes, and what remains.

    model          with the causes, the baseline without any
    material_rest  whether a material share of the gap remains
    leader         the best candidate, whatever the verdict
    """

    verdict: str
    model: CandidateModel
    causes: tuple[NamedCause, ...]
    material_rest: bool
    free_forms: tuple[FreeForm, ...] = ()
    leader: CandidateModel | None = None

    @property
    def left_over(self) -> bool:
        """Whether a material part of the gap remains, with the causes or for want of any."""
        return self.verdict == "unknown-effect" or (self.verdict in CAUSED and self.material_rest)


def answer(
    comparison: Comparison,
    selection: Selection,
    ranking: Sequence[CandidateModel],
    forms: Sequence[FreeForm],
    set_aside: Collection[str] = (),
) -> Answer:
    """Return the answer to a selection.

    forms: curves at ports that remove a material share of the remainder; ranking: models of single
    effects, the best first; set_aside: labels with a physical objection.
    """
    settings, best = comparison.budget.settings, selection.best
    causes = tuple(_cause(comparison, selection, a, ranking, set_aside) for a in best.attached)
    share_left = comparison.removed(best).rest.share
    rest = share_left >= settings.material_rest and not comparison.at_floor(best)
    leader = next((c for c in ranking if c.label not in set_aside), None)
    single = selection.instead.get(best.attached[0].label, ()) if len(best.additions) == 1 else ()
    others = [c for c in single if not _same_effect(c, best)]
    if others:
        # Families in a tie are alternatives that a measurement could separate. A long list of them
        # is no guidance, unless all predict the same: then it is the same finding under several
        # names.
        tied = [best, *others]
        if len(tied) > settings.tied_most and not comparison.predict_the_same(tied):
            verdict, causes = "cannot-tell", ()
        else:
            verdict = "ambiguous"
            causes = tuple(
                _cause(comparison, selection, a, ranking, set_aside, c)
                for c in tied
                for a in c.attached
            )
    elif causes:
        verdict = "partly-explained" if rest else "explained"
    # A share off zero that misses the required certainty is neither a cause nor proof of a
    # complete model.
    elif (
        leader is not None
        and (removed := comparison.removed(leader)).share >= settings.material_share
        and removed.low > 0.0
        and removed.z < settings.standard_errors
    ):
        verdict = "cannot-tell"
    # A curve at a port absorbs more than any equation of the catalogue: a cause exists, without a
    # name.
    elif forms:
        verdict = "unknown-effect"
    elif comparison.floors(comparison.budget.baseline) > settings.unexplained_floors:
        # nothing known explains it, but it is too large to be denied
        verdict = "cannot-tell"
    else:
        verdict = "no-structural-gap"
    if not causes:
        # The figures of the answer belong to the model it names, not to a selection that was
        # withdrawn.
        best, rest = comparison.budget.baseline, bool(forms)
    return Answer(verdict, best, causes, rest, tuple(forms), leader)


def _same_effect(candidate_model: CandidateModel, other: CandidateModel) -> bool:
    """Whether two models have the same effect at different ports, or effects of the same family."""
    names = {a.effect.name for a in candidate_model.attached}
    return names == {a.effect.name for a in other.attached} or families_of(
        candidate_model
    ) == families_of(other)


def _cause(
    comparison: Comparison,
    selection: Selection,
    a: Attachment,
    ranking: Sequence[CandidateModel],
    set_aside: Collection[str],
    model: CandidateModel | None = None,
) -> NamedCause:
    """The effect with its figures next to the others of the model (default: the selected)."""
    base, alternative = comparison.budget.baseline, model is not None
    model = model or selection.best
    added = next(k for k in model.additions if a in k.members)
    whole = selection.without.get(added.label, base)
    # an alternative counts as a whole, a cause next to the others
    below = whole if alternative else selection.without.get(a.label, base)
    rig, group = model.assembly.rig, a.group(model.assembly.rig)
    rivals = list(selection.instead.get(a.label, ()))
    if len(model.additions) == 1:
        others = (c for c in ranking if c is not model and c.label not in set_aside)
        # A single effect was compared with every candidate of the round, not only with the
        # confidence set.
        rivals = [c for c in others if comparison.is_tied(c, model)]
    placed = [
        k.group(rig)
        for c in rivals
        for other in c.additions
        for k in other.members
        if k not in model.attached
        and (k.effect.name == a.effect.name or k.family(rig) == a.family(rig))
        and not set(other.ports) & set(added.ports)
    ]
    families = [
        k.family(rig)
        for c in selection.instead.get(a.label, ())
        for k in c.attached
        if k not in model.attached
    ]
    return NamedCause(
        a,
        model,
        comparison.removed(model, below),
        # the same effect at several ports is the same finding
        features(comparison, model, whole, ranking),
        tuple(g for g in dict.fromkeys(placed) if g != group),
        tuple(f for f in dict.fromkeys(families) if f != a.family(rig)),
    )


# ---- probability -----------------------------------------------------------------------------


def features(
    comparison: Comparison,
    model: CandidateModel,
    below: CandidateModel,
    ranking: Sequence[CandidateModel],
) -> dict[str, float]:
    """Figures of the comparison from which the probability of a cause is made.

    below: the model without the cause; ranking: models of single effects, among which the next
    family is sought.
    """
    removed = comparison.removed(model, below)
    families = families_of(model)
    others = (c for c in ranking if not families_of(c) & families)
    # A second law of the same family is no competitor: the family would be named in either case.
    rival = next(others, comparison.budget.baseline)
    lead = comparison.removed(model, rival).z
    # The ratio relates to what the reference leaves above the floor. That of the worse model is the
    # larger ratio and cannot vanish.
    if comparison.loss(rival).sum() < comparison.loss(model).sum():
        lead = -comparison.removed(rival, model).z
    rest = comparison.removed(model).rest.share
    windows = len(comparison.loss(model))
    return {
        # Clipped and on logarithms: a logistic function is linear in its figures, and an extreme
        # recording would otherwise decide its weights.
        "removed": float(np.clip(removed.share, -0.2, 1.0)),
        "rest": float(np.clip(rest, 0.0, 1.0)),
        "floors": float(np.log10(np.clip(comparison.floors(model), 1.0, 1000.0))),
        "sure": signed_decades(removed.z),
        "lead": signed_decades(lead),
        "windows": float(np.log10(windows)),
    }


def probability(figures: dict[str, float]) -> float:
    """Calibrated frequency with which a cause of these figures (`features`) acts."""
    weights: dict[str, float] = _learnt()["weights"]
    return logistic(weights, figures)


def logistic(weights: dict[str, float], figures: dict[str, float]) -> float:
    """1 / (1 + exp(-constant - weights.figures))"""
    score = weights["constant"] + sum(weights[name] * value for name, value in figures.items())
    return float(1.0 / (1.0 + np.exp(-score)))


def signed_decades(value: float) -> float:
    """sign(x) log10(1 + |x|)"""
    return float(np.sign(value) * np.log10(1.0 + abs(value)))


@cache
def _learnt() -> dict[str, Any]:
    """Weights and spread learnt from calibration cases: see `pamid.trial.calibration`."""
    text = files("pamid.diagnosis").joinpath("calibration.json").read_text(encoding="utf-8")
    learnt: dict[str, Any] = json.loads(text)
    return learnt


def forecast_interval(before: Array, after: Array, seed: int) -> tuple[float, float]:
    """95 % interval of the share of the error that is removed on a fresh recording.

    before, after: losses per window (n,), n >= 2. The bootstrap interval of these windows is
    widened by the spread from recording to recording, added in squares on the logarithm of the
    error ratio. That spread was measured on the calibration cases, in proportion to the root of the
    share.
    """
    # Windows of a recording share its operating point, so that their bootstrap is too narrow for
    # a fresh recording.
    most_left, least_left = moving_block_interval(after, before, seed=seed)[::-1]
    low, high = 1.0 - most_left, min(1.0 - least_left, 1.0)
    # On logarithms the error ratio cannot become negative, and two independent spreads add in
    # squares.
    middle = np.log(max(float(after.sum() / before.sum()), 1e-9))
    edges = np.log(np.maximum([1.0 - high, 1.0 - low], 1e-9))
    other = float(_learnt()["spread"]) * np.sqrt(max(1.0 - np.exp(middle), 0.0))
    half = np.hypot(edges - middle, other)
    return float(1.0 - np.exp(middle + half[1])), float(1.0 - np.exp(middle - half[0]))
