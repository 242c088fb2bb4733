"""Several effects: forward selection with a backward check.

Step k adds to the model M_(k-1) the effect that lowers the bootstrapped held-out log loss most,

    j* = argmin_j L(M_(k-1) + e_j),    all parameters refitted jointly each time,

among effects of other families whose ports still have latent evidence; a logistic function
(calibration.json, "further") decides whether it is kept. Then an earlier effect whose removal costs
less than the share `worth` of the gap is dropped, and the first is replaced by one of its rivals
where the pair fits better: chosen alone, it had to account for what the second explains, too.

Efroymson (1960), Multiple regression analysis, in Mathematical Methods for Digital Computers;
Miller (2002), Subset Selection in Regression, sections 3.2 to 3.5 (forward, backward, replacement).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pamid.diagnosis.candidate_model import CandidateModel, in_errors, transferred
from pamid.diagnosis.judgement import calibration, decades, within
from pamid.diagnosis.port_evidence import PortEvidence, locate
from pamid.diagnosis.search import RefitStart, Refitting, Search, run_round, with_finer_steps
from pamid.estimation.grey_box import model_with
from pamid.model.attachment import Attachment


@dataclass(frozen=True)
class ForwardStep:
    """The effect tried beside those already found, all on the windows that choose.

    removed, of_left: what it removes, in shares of the gap and of what the others leave; gain: log
    squared error per channel, sure: in standard errors; margin: standard errors by which it beats
    the next of another family; at_port: latent evidence at its port over the largest one;
    unexplained: that one, nats per sample; probability of being real; taken: is it added
    to the model?
    """

    effect: str
    family: str
    removed: float
    of_left: float
    gain: float
    sure: float
    margin: float
    at_port: float
    unexplained: float
    probability: float = 0.0
    taken: bool = False

    def features(self) -> dict[str, float]:
        """As the logistic function takes them."""
        return {
            "removed": decades(self.removed, 1e-3, 1.0),
            "of_left": within(self.of_left, -0.2, 1.0),
            "gain": within(self.gain, -0.2, 2.0),
            "sure": within(self.sure, 0.0, 20.0) / 10.0,
            "margin": within(self.margin, 0.0, 10.0) / 10.0,
            "at_port": self.at_port,
            "unexplained": decades(self.unexplained, 1e-2, 1e2),
        }


@dataclass(frozen=True, eq=False)
class ForwardSelection:
    """The model with every effect that was added; after: the latent evidence that is left at the
    ports; forward_steps: the effects that were tried beside the first, in order."""

    best: CandidateModel
    after: PortEvidence
    forward_steps: tuple[ForwardStep, ...] = ()


def select_forward(
    search: Search, ranking: tuple[CandidateModel, ...], located: PortEvidence
) -> ForwardSelection:
    """The first of the ranking and the effects that forward selection adds to it."""
    chosen = search.settings
    best, steps = with_finer_steps(search, ranking[0]), list[ForwardStep]()
    while True:
        search.progress(f"looking where something is missing beside {best.label}")
        leaders = [k[0] for k in located.classes]
        after = locate(search.evidence, best, search.pool, leaders, settings=chosen)
        helped = search.budget.shrinkage(best.absolutes, search.chosen) > chosen.worth
        # too little to look into: a share of what was missing at first, within fixed bounds
        little = max(
            min(chosen.further_share * located.most, chosen.further_always * best.samples),
            chosen.further_never * best.samples,
        )
        if len(best.attached) == chosen.effects_most or after.most < little or not helped:
            break
        more = _candidates(search, best, located, after)
        if not more:
            break
        steps.append(_step(search, best, more, located, after))
        if not steps[-1].taken:
            break
        best = with_finer_steps(
            search, _best_first(search, ranking, _backward_check(search, more[0]))
        )
    return ForwardSelection(best, after, tuple(steps))


def _candidates(
    search: Search, best: CandidateModel, located: PortEvidence, after: PortEvidence
) -> list[CandidateModel]:
    """Refitted models with one more effect, of another family and where something is still missing,
    best first."""
    taken = {search.family(a) for a in best.attached}
    least = search.settings.further_ports * after.most
    open_ports = {port for k in located.classes for port in k if after.gains[k[0]] > least}
    others = [
        a for a in search.candidates if search.family(a) not in taken and open_ports & set(a.ports)
    ]
    more = run_round(search, best, others).models if others else []
    losses = search.losses(more).mean(axis=1) if more else []
    return [more[i] for i in sorted(range(len(more)), key=lambda i: (losses[i], more[i].label))]


def _step(
    search: Search,
    best: CandidateModel,
    more: list[CandidateModel],
    located: PortEvidence,
    after: PortEvidence,
) -> ForwardStep:
    newest = more[0]
    other = next((c for c in more if c.family != newest.family), best)
    losses = search.losses([best, newest, other])
    gain, margin = losses[0] - losses[1], losses[2] - losses[1]
    gap, left = search.excess(search.budget.baseline), search.excess(best)
    removed = left - search.excess(newest)
    ports = set(newest.attached[-1].ports)
    here = max(after.gains[k[0]] for k in located.classes if ports & set(k))
    found = ForwardStep(
        newest.attached[-1].label,
        newest.family,
        removed / max(gap, 1e-9),
        removed / max(left, 1e-9),
        float(gain.mean()) / newest.squares.shape[1],
        in_errors(gain),
        in_errors(margin),
        here / after.most,
        after.most / best.samples,
    )
    line = calibration().lines["further"]
    probability = line.probability(found.features())
    taken = probability >= line.yes and found.removed >= search.settings.further_least
    return replace(found, probability=probability, taken=taken)


def _backward_check(search: Search, best: CandidateModel) -> CandidateModel:
    """The model less the first earlier effect whose removal costs less than `worth` of the gap; the
    model itself where every one is needed."""
    worth = search.settings.worth * search.excess(search.budget.baseline)
    for a in best.attached[:-1]:
        smaller = refitted_with(search, tuple(k for k in best.attached if k is not a), best)
        lost = search.excess(smaller) - search.excess(best)
        if smaller.finite and lost < worth:
            return smaller
    return best


def _best_first(
    search: Search, ranking: tuple[CandidateModel, ...], best: CandidateModel
) -> CandidateModel:
    """The first effect chosen again, among itself and its rivals, beside those added since."""
    if len(best.attached) < 2 or best.attached[0] is not ranking[0].attached[-1]:
        return best
    taken = {search.family(a) for a in best.attached[1:]}
    rivals = [c for c in ranking[1:] if c.family not in taken][: search.settings.rivals]
    options = [
        best,
        *(refitted_with(search, (*r.attached, *best.attached[1:]), r, best) for r in rivals),
    ]
    stable = [c for c in options if c.finite]
    return stable[int(np.argmin(search.losses(stable).mean(axis=1)))]


def refitted_with(
    search: Search, attached: tuple[Attachment, ...], *found: CandidateModel
) -> CandidateModel:
    """A model with these effects, refitted from what these others have found, the last of them
    first."""
    assembly = model_with(search.evidence, attached, search.budget.sizes)
    p = transferred(assembly, *((c.assembly, c.fit.p) for c in found))
    work = Refitting(
        search.evidence, search.budget.baseline.fit, search.budget.sizes, search.settings
    )
    return search.pool.one(work, RefitStart(attached, p, assembly=assembly))
