"""Repair of refits that predict held-out recordings worse than the data sheet.

A model that lacks an effect distorts its parameters, or the tolerance-sized terms of its
background. Where the refit predicts held-out recordings worse than the data sheet, it is first
repeated from starts drawn from the priors. It is then repeated with the determined parameters
alone, the others held at the data sheet. Background terms that have moved and make the prediction
worse are dropped.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pamid.base.metrics import seen_mean
from pamid.estimation.intervals import background_pull
from pamid.estimation.multiple_shooting import ITERATIONS, fit
from pamid.estimation.problem import Fit, Problem, free_parameters
from pamid.estimation.restart import fit_from_draws
from pamid.estimation.robust_fit import fit_robustly
from pamid.model.assembly import Assembly
from pamid.model.effect import Effect
from pamid.model.rig import Rig, background_by_port, with_declared
from pamid.simulation.data_split import DataSplit
from pamid.simulation.replay import Replay, replay_track

# times the held-out error of the data sheet, or of the model without a background term: below it
# the two differ by chance
WORSE = 1.1
# posterior over prior standard deviation of a parameter that the recordings determine
DETERMINED = 0.5
# tolerances: a background term that stands nearer cannot do harm
LEAST_PULL = 0.3
TRIAL_STEPS = 3  # of a refit without a term, which begins where that with it has ended


@dataclass(frozen=True, eq=False)
class Refit:
    """A fitted model with its held-out replays. remark: a sentence on its repair."""

    evidence: DataSplit
    assembly: Assembly
    fit: Fit
    held_out: tuple[Replay, ...]
    remark: str = ""

    @classmethod
    def of(cls, evidence: DataSplit, assembly: Assembly, fitted: Fit, remark: str = "") -> Refit:
        """A fit, replayed over the held-out part; without replays where it has failed."""
        tracks = evidence.tracks(assembly, held_out=True) if fitted.residuals else ()
        replays = tuple(
            replay_track(assembly, fitted.p, t, fitted.stepping, evidence.noise) for t in tracks
        )
        return cls(evidence, assembly, fitted, replays, remark)


def relative_error(replays: Sequence[Replay], reference: Sequence[Replay]) -> float:
    """Held-out error over that of another model, mean over the channels; infinite where the first
    does not stay finite."""
    if not replays or not all(r.finite for r in replays):
        return np.inf
    if not all(r.finite for r in reference):
        return 0.0
    error, other = (
        seen_mean(np.concatenate([r.losses(1) for r in several]))
        for several in (replays, reference)
    )
    return float(np.nanmean(error / other))


def repaired(refit: Refit, sheet: Sequence[Replay], seed: int) -> Refit:
    """Return the refit, or the best attempt to mend a refit that predicts worse than the data
    sheet.

    sheet: held-out replays of the data sheet; seed: of the starts drawn from the priors.
    """
    # The data sheet is the reference, because a fit that predicts worse than no fit at all has a
    # wrong cause for its cost.
    if not refit.fit.residuals or relative_error(refit.held_out, sheet) <= WORSE:
        return refit
    best = refit
    for attempt in (_from_draws, _with_held):
        tried = attempt(refit, seed)
        if tried is not None and relative_error(best.held_out, tried.held_out) > WORSE:
            best = replace(tried, remark=f"{refit.remark} {tried.remark}".strip())
        if relative_error(best.held_out, sheet) <= WORSE:
            return best
    # effects are compared on top of a refit all the same: their models are refits, too
    worse = f"{relative_error(best.held_out, sheet):.1f} times"
    remark = f"The data sheet predicts better: the error of the refit is {worse} as large."
    return replace(best, remark=f"{best.remark} {remark}".strip())


def _from_draws(refit: Refit, seed: int) -> Refit | None:
    drawn = fit_from_draws(refit.fit, refit.evidence.noise, seed)
    remark = "The refit began at values drawn from the priors."
    return None if drawn is refit.fit else Refit.of(refit.evidence, refit.assembly, drawn, remark)


def _with_held(refit: Refit, _: int) -> Refit | None:
    # A parameter that the recordings leave open costs nothing to move, so that it absorbs first
    # what the model lacks.
    loose = undetermined_parameters(refit.fit)
    names = ", ".join(refit.assembly.parameters[i].full_name for i in loose)
    remark = f"The recordings do not determine {names}; the fit holds the data-sheet values."
    held = fit_held(refit.fit, loose) if loose else refit.fit
    return Refit.of(refit.evidence, refit.assembly, held, remark) if loose else None


def undetermined_parameters(fitted: Fit) -> list[int]:
    """Places of the rig's fitted parameters of which the recordings say little beyond the prior."""
    free = fitted.problem.free
    if not fitted.residuals or not free:
        return []
    left = np.sqrt(np.maximum(np.diag(fitted.covariance), 0.0))
    parameters = fitted.problem.assembly.parameters
    return [
        i
        for i, share in zip(free, left, strict=True)
        if not parameters[i].owner and not share < DETERMINED
    ]


def fit_held(fitted: Fit, places: Iterable[int]) -> Fit:
    """The fit of the same problem with these free parameters held at the data sheet."""
    problem, held = fitted.problem, frozenset(places)
    few = replace(problem, free=tuple(i for i in problem.free if i not in held))
    reduced = fit_robustly(few, p=problem.assembly.data_sheet(), stepping=fitted.stepping)
    if not reduced.residuals:
        return reduced
    # No steps, but all parameters free: the covariance then covers those that were held as well.
    whole = fit(problem, reduced.end, iterations=0)
    return replace(whole, converged=reduced.converged, why=reduced.why)


# ---- background ----------------------------------------------------------------------------------


def without_harmful_background(refit: Refit) -> Refit:
    """Return the refit without those background terms that make its held-out prediction worse."""
    best, remark = refit, ""
    if not refit.fit.residuals:
        return refit
    for name, pull in background_pull(refit.fit).items():
        if not abs(pull) > LEAST_PULL or f"background.{name}" not in best.assembly.background_terms:
            continue
        term = best.assembly.background_terms[f"background.{name}"]
        # A few steps show the sign of the change. Only a term that has to go is refitted to the
        # end.
        tried = _without(best, term, TRIAL_STEPS)
        if relative_error(best.held_out, tried.held_out) > WORSE:
            best = _without(best, term, ITERATIONS)
            remark += f"Background {name} was removed: it increased the held-out error. "
    return replace(best, remark=remark.rstrip())


def _without(refit: Refit, term: Effect, iterations: int) -> Refit:
    """The model without a background term, at all places of its port, refitted from where it is."""
    evidence = replace(refit.evidence, rig=rig_without(refit.evidence.rig, term))
    before = refit.assembly
    assembly = replace(before, rig=evidence.rig).for_fitting()
    tracks = evidence.tracks(assembly)
    problem = Problem(assembly, tracks, free_parameters(assembly, tracks))
    p = assembly.values()
    for key, place in assembly.keys.items():
        p[place] = refit.fit.p[before.keys[key]]
    fitted = fit(problem, replace(refit.fit.end, p=p), iterations=iterations)
    return Refit.of(evidence, assembly, fitted)


def rig_with_background(rig: Rig, owners: Collection[str]) -> Rig:
    """A copy of the rig with those background terms alone that these owners name."""
    for owner, term in Assembly(rig, background=True).background_terms.items():
        if owner not in owners:
            rig = rig_without(rig, term)
    return rig


def rig_without(rig: Rig, term: Effect) -> Rig:
    """A copy of the rig without this background term."""
    background = {}
    for port, terms in background_by_port(rig).items():
        left = tuple(t for t in terms if t is not term)
        if left:
            background[port] = left
    return with_declared(rig, background=background)
