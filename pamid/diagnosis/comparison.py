"""Comparison of models by their errors on the same held-out windows.

With the mean absolute error e_wc of a model in window w and channel c, and the noise floor f_c,

    loss_w        = sum_c e_wc / f_c
    share removed = sum_w (loss_w(reference) - loss_w(model)) / sum_w (loss_w(baseline) - floor)

The share refers to the gap between the baseline and the noise floor. Its standard error is that of
the paired ratio to the reference's loss above the floor, by a circular block bootstrap over
windows. An effect that removes the same share in every window is therefore certain although the
windows differ. Diebold and Mariano (1995), JBES 13:253, for paired losses; Politis and Romano
(1992) for the bootstrap. A model need not be true to be compared: no true model may be among the
candidates (M-open, Bernardo and Smith 1994, Bayesian Theory, ch. 6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.metrics import few_entries_factor, seen_mean
from pamid.base.schemas.diagnosis_file import GapShare
from pamid.diagnosis.budget import Budget
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.estimation.intervals import NORMAL_95

ALIKE_NOISE = 0.5  # standard deviations of the noise: no sensor shows less
LEAST_ERROR = 1e-6  # standard error of a share, for losses that are equal to rounding


NOTHING = GapShare(share=0.0, low=0.0, high=0.0, standard_errors=0.0)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Held-out errors of models, paired window by window, in shares of the gap of the baseline."""

    budget: Budget
    seed: int

    def loss(self, model: CandidateModel) -> Array:
        """A loss per held-out window, in noise floors."""
        return self.budget.channel_losses(model.absolutes)

    @cached_property
    def gap(self) -> Array:
        """Loss of the baseline above the noise floor, per window."""
        floor = self.budget.channel_losses(self.budget.floor)
        return self.loss(self.budget.baseline) - floor

    def removed(
        self,
        model: CandidateModel,
        reference: CandidateModel | None = None,
        losses: Array | None = None,
    ) -> GapShare:
        """Share of the gap that a model removes, by default against the baseline.

        losses: of the model, where they are reported by windows that had no part in its choice.
        """
        before = self.loss(reference or self.budget.baseline)
        gap = before - self.budget.channel_losses(self.budget.floor)
        after = self.loss(model) if losses is None else losses
        # A share of no gap is undefined, and a single window has no spread to judge it by.
        if self.gap.sum() <= 0.0 or gap.sum() <= 0.0 or len(before) < 2:
            return NOTHING
        # The bootstrap runs on the ratio to what the reference leaves: numerator and denominator
        # then vary together from window to window, and a proportional gain has nearly no error.
        scale = float(gap.sum() / self.gap.sum())
        share, error = (scale * x for x in paired_ratio(before - after, gap, self.seed))
        reach = NORMAL_95 * error
        return GapShare(
            share=min(share, 1.0),
            low=min(share - reach, 1.0),
            high=min(share + reach, 1.0),
            standard_errors=share / error,
        )

    def shrinkage(self, model: CandidateModel) -> tuple[float, float, float]:
        """Share of the baseline's held-out error that a model removes, with its 95 % interval."""
        before = self.loss(self.budget.baseline)
        if len(before) < 2:
            return 0.0, 0.0, 0.0
        return error_removed(before, self.loss(model), self.seed)

    def is_material(self, model: CandidateModel, reference: CandidateModel) -> bool:
        """Whether a model removes a material share of the gap beyond its reference, by enough
        standard errors."""
        settings, removed = self.budget.settings, self.removed(model, reference)
        return removed.share >= settings.material_share and removed.z >= settings.standard_errors

    def is_tied(self, model: CandidateModel, best: CandidateModel) -> bool:
        """Whether the windows cannot separate a model from the best."""
        settings, lead = self.budget.settings, self.removed(best, model)
        return lead.z < settings.tie_errors or lead.share < settings.tie_margin

    def floors(self, model: CandidateModel) -> float:
        """Error over the noise floor, worst channel."""
        floor = seen_mean(self.budget.floor)
        return float(np.nanmax(seen_mean(model.absolutes) / floor))

    def at_floor(self, model: CandidateModel) -> bool:
        """Whether a model is at the noise floor in every channel, or in their sum, within the
        margin.

        Shares are taken of the sum. Where channels below their floors cancel the excess of another
        channel, less than the margin of a channel is left, and a share of it means nothing.
        """
        margin = self.budget.settings.floor_margin
        excess = self.loss(model) - self.budget.channel_losses(self.budget.floor)
        return self.floors(model) < 1.0 + margin or float(excess.mean()) < margin

    def ordered(self, models: Sequence[CandidateModel]) -> list[CandidateModel]:
        """The lowest held-out loss first; among equal ones by name."""
        return sorted(models, key=lambda c: (float(self.loss(c).sum()), c.label))

    def predict_the_same(self, models: Sequence[CandidateModel]) -> bool:
        """Whether the recordings cannot separate any of these models from the first of them.

        With predictions y_i and noise s_c of channel c, over the held-out samples that are scored,

            D(i, j) = max_c sqrt(mean_t ((y_i - y_j) / s_c)^2),

        i and j predict the same where D(i, j) < max(a min(D(i, 0), D(j, 0)), b): 0 is the baseline,
        a and b are the setting `alike_share` and ALIKE_NOISE. Refitted parameters absorb part of
        the difference, as in the T-criterion: Atkinson and Fedorov (1975), Biometrika 62:57.
        """
        # Predictions are compared, not losses: two models may have equal losses and still err in
        # different places.
        noise, base = self.budget.model.evidence.noise, self.budget.baseline

        def distance(i: CandidateModel, j: CandidateModel) -> float:
            gaps = [
                ((a.model - b.model) / noise)[a.scored] for a, b in zip(i.runs, j.runs, strict=True)
            ]
            return float(np.sqrt((np.concatenate(gaps) ** 2).mean(axis=0)).max())

        first, *others = models
        share, reach = self.budget.settings.alike_share, distance(first, base)
        return all(
            distance(first, c) < max(share * min(reach, distance(c, base)), ALIKE_NOISE)
            for c in others
        )

    def confidence_set(
        self, models: Sequence[CandidateModel], reference: CandidateModel
    ) -> list[CandidateModel]:
        """A model per family, the best first: the material ones that tie with the best.

        Within a family the simplest member that is not worse stands for it. Empty where no model
        removes a material share.
        """
        # Ties are counted against the best material model only. Ties among the others would chain
        # models that are far apart.
        material = [c for c in self.ordered(models) if self.is_material(c, reference)]
        tied = [c for c in material if c is material[0] or self.is_tied(c, material[0])]
        leaders: dict[frozenset[str], CandidateModel] = {}
        for c in tied:
            leaders.setdefault(families_of(c), c)
        return [self.simplest(c, tied) for c in leaders.values()]

    def simplest(self, best: CandidateModel, models: Sequence[CandidateModel]) -> CandidateModel:
        """The model with the fewest parameters among those of the same families that tie with
        the best of them."""
        # The family is the finding. Its law with an extra parameter wins on noise alone, so that
        # parsimony decides within it.
        family = [c for c in models if families_of(c) == families_of(best)]
        tied = [c for c in family if c is best or self.is_tied(c, best)]
        return min(tied, key=lambda c: c.free_count, default=best)


def families_of(model: CandidateModel) -> frozenset[str]:
    """Families of a model's effects."""
    return frozenset(a.family(model.assembly.rig) for a in model.attached)


def paired_ratio(numerator: Array, denominator: Array, seed: int) -> tuple[float, float]:
    """Ratio of two sums over windows (n,), n >= 2, and its bootstrap standard error."""
    rows = resamples(len(numerator), seed)
    above, below = numerator[rows].sum(axis=1), denominator[rows].sum(axis=1)
    # of a gap near the noise floor some draws hold none
    error = float((above / below)[below > 0.0].std()) * few_entries_factor(len(numerator))
    return float(numerator.sum() / denominator.sum()), max(error, LEAST_ERROR)


def error_removed(before: Array, after: Array, seed: int) -> tuple[float, float, float]:
    """Share of an error that is removed, with its 95 % interval, from errors per window before and
    after (n,), n >= 2."""
    share, error = paired_ratio(before - after, before, seed)
    return share, share - NORMAL_95 * error, min(share + NORMAL_95 * error, 1.0)


DRAWS, BLOCK_WINDOWS = 1000, 2  # resamples, and neighbouring windows that are drawn together


@lru_cache(maxsize=16)  # the same for every model that is compared
def resamples(count: int, seed: int) -> NDArray[np.intp]:
    """Bootstrap rows (draws x count) in blocks of neighbouring windows, the last a neighbour of
    the first: the circular block bootstrap of Politis and Romano (1992). Of few windows each is
    drawn by itself: of two, blocks of two are always both."""
    block = min(BLOCK_WINDOWS, max(1, count // 3))
    random = np.random.default_rng(seed)
    starts = random.integers(0, count, size=(DRAWS, -(-count // block)))
    rows = ((starts[:, :, None] + np.arange(block)) % count).reshape(DRAWS, -1)[:, :count]
    rows.flags.writeable = False
    return rows
