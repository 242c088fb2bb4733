"""From recordings to a fitted model with its replays.

A model that lacks an effect distorts its parameters, or the tolerance-sized terms of its
background. Where the refit predicts held-out recordings worse than the data sheet, it is first
repeated from starts drawn from the priors. It is then repeated with the determined parameters
alone, the others held at the data sheet. Background terms that have moved and make the prediction
worse are dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import ConvergenceError
from pamid.base.metrics import seen_mean
from pamid.base.parallel.jobs import WorkerPool
from pamid.base.progress import Progress, Settled, silent
from pamid.base.units import NONE, column_size, split_column
from pamid.estimation.intervals import background_pull, bootstrap, estimates
from pamid.estimation.multiple_shooting import ITERATIONS, fit
from pamid.estimation.observed_sizes import observed_sizes
from pamid.estimation.posterior import EarlierPosterior
from pamid.estimation.problem import Fit, Problem, free_parameters
from pamid.estimation.restart import (
    escape_local_minimum,
    fit_from_draws,
    fit_from_shorter_windows,
    is_failed,
    refound,
    reweighted,
)
from pamid.estimation.robust_fit import FIRST_STEPS, ROUNDS, fit_in_stages, fit_robustly
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment
from pamid.model.bound_parameter import Sizes
from pamid.model.effect import Effect
from pamid.model.rig import Rig, background_by_port, with_declared
from pamid.simulation.data_split import DataSplit
from pamid.simulation.replay import Replay, channel_mae, noise_floors, replay_track
from pamid.simulation.tracks import Track

COARSE = 0.2  # noise standard deviations by which doubled sub-steps may change an output
# of that change: largest share after doubling once more; a method of order 1 leaves half
SETTLING = 0.75
# times the held-out error of the data sheet, or of the model without a background term: below it
# the two differ by chance
WORSE = 1.1
# posterior over prior standard deviation of a parameter that the recordings determine
DETERMINED = 0.5
# tolerances: a background term that stands nearer cannot do harm
LEAST_PULL = 0.3
TRIAL_STEPS = 3  # of a refit without a term, which begins where that with it has ended


@dataclass(frozen=True, eq=False)
class GreyBox:
    """A fitted model with its replays.

    recheck: change of the outputs by doubled sub-steps, in noise standard deviations; remark:
    sentences on the repair of a refit that predicts held-out data worse than the data sheet. The
    rig of the evidence is the fitted rig, without dropped background terms.
    """

    evidence: DataSplit
    assembly: Assembly
    fit: Fit
    recheck: float
    held_out: tuple[Replay, ...]
    data_sheet: tuple[Replay, ...]
    floor: tuple[Replay, ...]
    draws: Array | None = None
    earlier: EarlierPosterior | None = None
    remark: str = ""


def model_with(evidence: DataSplit, attached: tuple[Attachment, ...], sizes: Sizes) -> Assembly:
    """The model that is fitted and compared: rig, background, these effects, the measured
    channels."""
    return Assembly(
        evidence.rig, attached, background=True, sizes=sizes, outputs=evidence.channels
    ).for_fitting()


def fit_model(
    evidence: DataSplit,
    attached: tuple[Attachment, ...] = (),
    *,
    seed: int = 0,
    draws: int = 0,
    progress: Progress = silent,
    earlier: EarlierPosterior | None = None,
    pool: WorkerPool | None = None,
) -> GreyBox:
    """Fit the rig (with effects) to the evidence; integration refined until doubled sub-steps
    change nothing.

    earlier: what another fit has left known of the same rig; it takes the place of the data sheet's
    prior. draws: of the bootstrap; pool: who does them (default: this process).
    """
    if earlier is not None:
        earlier.require_new(evidence)
    # Effects state their ranges in multiples of what passes a port, so that sizes come before any
    # assembly with effects.
    sizes = observed_sizes(evidence)
    assembly = model_with(evidence, attached, sizes)
    tracks, held = evidence.tracks(assembly), evidence.tracks(assembly, held_out=True)
    problem = Problem(assembly, tracks, free_parameters(assembly, tracks))
    if earlier is not None:
        problem = replace(problem, prior=earlier.prior(problem))
    # a rig that is stepped may touch things, after which its motion is different
    touching = assembly.program.keeps_slopes
    progress("fitting")
    fitted = escape_local_minimum(
        fit_in_stages(problem, progress=_counting(progress)), evidence.noise
    )
    # and a model that starts far off is trapped by windows in which it falls another way
    if touching or not fitted.converged or not refound(fitted):
        progress("fitting from shorter windows")
        fitted = fit_from_shorter_windows(fitted)
    if is_failed(fitted):
        progress("fitting from other starts")
        fitted = fit_from_draws(fitted, evidence.noise, seed)
    replays, change = rechecked(assembly, fitted, held, evidence.noise)
    for _ in range(3):
        if change <= COARSE or not settles(assembly, fitted, held, evidence.noise, change):
            break
        progress("refining the integration step")
        finer = fitted.stepping.doubled()
        fitted = escape_local_minimum(
            fit_robustly(problem, p=fitted.p, stepping=finer), evidence.noise
        )
        replays, change = rechecked(assembly, fitted, held, evidence.noise)
    alone = replace(assembly, attachments=())  # a data sheet lists no effects
    sheet = tuple(
        replay_track(alone, alone.data_sheet(), t, fitted.stepping, evidence.noise)
        for t in evidence.tracks(alone, held_out=True)
    )
    model = GreyBox(evidence, assembly, fitted, change, replays, sheet, (), earlier=earlier)
    if earlier is None:
        # Not with an earlier posterior: the data sheet is then no longer the prior that the fit
        # has to beat.
        model = repaired(without_harmful_background(model), seed)
    if model.fit is not fitted:
        evidence, assembly, fitted = model.evidence, model.assembly, model.fit
        held = evidence.tracks(assembly, held_out=True)
        replays, change = rechecked(assembly, fitted, held, evidence.noise)
    progress("noise floor")
    floor = noise_floors(assembly, fitted.p, replays, fitted.stepping, evidence.noise, seed)
    require_predictable(evidence, floor, (*tracks, *held))
    if draws:
        values = (f"{b.full_name} {e.value:.4g}" for b, e in estimates(fitted).items())
        progress(Settled(f"fitted, intervals follow: {', '.join(values)}"))
    return replace(
        model,
        recheck=change,
        held_out=replays,
        floor=floor,
        draws=bootstrap(fitted, draws, seed=seed, pool=pool, progress=progress) if draws else None,
    )


def restarted(model: GreyBox, fitted: Fit, seed: int) -> GreyBox:
    """The model with a fit of it from other values, continued with weights that follow its
    residuals."""
    noise = model.evidence.noise
    fitted = reweighted(fitted, noise)
    held = tuple(r.full_track for r in model.held_out)
    replays, change = rechecked(model.assembly, fitted, held, noise)
    return replace(
        model,
        fit=fitted,
        recheck=change,
        held_out=replays,
        floor=noise_floors(model.assembly, fitted.p, replays, fitted.stepping, noise, seed),
        remark="The first fit had ended in a local minimum and was repeated from other values.",
    )


def require_predictable(
    evidence: DataSplit, floor: Sequence[Replay], tracks: Sequence[Track]
) -> None:
    """Raise ConvergenceError where the noise floor of a channel exceeds all that it moves by.

    floor: replays of the model as the truth; tracks: by which the channels' ranges are measured.
    """
    # A floor above the whole range means that no comparison of models could be decided.
    ranges = np.max([np.nan_to_num(np.ptp(t.y, axis=0)) for t in tracks], axis=0)
    errors = channel_mae(list(floor))
    beyond = [k for k in range(len(errors)) if errors[k] > ranges[k] > 0.0]
    if not beyond:
        return
    worst = max(beyond, key=lambda k: errors[k] / ranges[k])
    name = evidence.channels[worst]
    unit = split_column(name)[1]
    symbol = "" if unit == NONE else f" {unit}"
    window = floor[0].windows[0]
    raise ConvergenceError(
        f"The error of an estimated state grows to "
        f"{column_size(name, errors[worst]):.3g}{symbol} in {name} within "
        f"{(window.stop - window.start) * floor[0].track.period_s:.3g} s, but {name} moves by only "
        f"{column_size(name, ranges[worst]):.3g}{symbol}: even the true model cannot predict it",
        "Check units and signs of the inputs, and the rig's masses, stiffness and damping. If the "
        "machine is that unstable, sample it faster.",
        code="unpredictable",
    )


def _counting(progress: Progress) -> Callable[[int, float], None]:
    """Report the steps done out of the largest number of all rounds. Every round begins anew, and
    most fits need fewer."""
    most = (FIRST_STEPS, *[ITERATIONS] * (ROUNDS - 1))
    at = [0, 0]  # round, step before

    def report(step: int, cost: float) -> None:
        if step < at[1]:
            at[0] = min(at[0] + 1, len(most) - 1)
        at[1] = step
        done = sum(most[: at[0]]) + step
        progress(f"fitting {done}/{sum(most)}: round {at[0] + 1}, cost {cost:.5g}")

    return report


def settles(
    assembly: Assembly, fitted: Fit, held: tuple[Track, ...], noise: Array, change: float
) -> bool:
    """Whether finer steps would reduce the change of the held-out replays by doubled steps
    (`change`, see `rechecked`).

    They would not where doubling once more changes as much. A simulator with contacts leads
    elsewhere at every length of its step, and a fit with finer steps would not be better.
    """
    if assembly.program.ordered:
        return True
    finer = replace(fitted, stepping=fitted.stepping.doubled())
    return not rechecked(assembly, finer, held, noise)[1] > SETTLING * change


def rechecked(
    assembly: Assembly, fitted: Fit, held: tuple[Track, ...], noise: Array
) -> tuple[tuple[Replay, ...], float]:
    """Held-out replays, and their change by doubled sub-steps: worst channel, in noise standard
    deviations or in quarters of the model's residual, whichever is larger. A step finer than the
    model's error is of no use."""
    once = tuple(replay_track(assembly, fitted.p, t, fitted.stepping, noise) for t in held)
    twice = [replay_track(assembly, fitted.p, t, fitted.stepping.doubled(), noise) for t in held]
    change = []
    # a model that runs away: the change is no number, not small
    with np.errstate(over="ignore", invalid="ignore"):
        for a, b in zip(once, twice, strict=True):
            left = np.sqrt((a.residual[a.scored] ** 2).mean(axis=0))
            moved = np.sqrt(((a.model - b.model)[a.scored] ** 2).mean(axis=0))
            change.append((moved / np.maximum(noise, 0.25 * left)).max())
    return once, float(max(change))


# ---- repair of a refit that predicts worse than the data sheet ----------------------------------


def with_fit(model: GreyBox, fitted: Fit, remark: str = "") -> GreyBox:
    """The model with another fit, replayed over the held-out part; without replays where it has
    failed. remark: a sentence on its repair."""
    tracks = model.evidence.tracks(model.assembly, held_out=True) if fitted.residuals else ()
    replays = tuple(
        replay_track(model.assembly, fitted.p, t, fitted.stepping, model.evidence.noise)
        for t in tracks
    )
    return replace(model, fit=fitted, held_out=replays, remark=remark)


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


def repaired(refit: GreyBox, seed: int) -> GreyBox:
    """Return the refit, or the best attempt to mend a refit that predicts worse than the data
    sheet. seed: of the starts drawn from the priors."""
    sheet = refit.data_sheet
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


def _from_draws(refit: GreyBox, seed: int) -> GreyBox | None:
    drawn = fit_from_draws(refit.fit, refit.evidence.noise, seed)
    remark = "The refit began at values drawn from the priors."
    return None if drawn is refit.fit else with_fit(refit, drawn, remark)


def _with_held(refit: GreyBox, _: int) -> GreyBox | None:
    # A parameter that the recordings leave open costs nothing to move, so that it absorbs first
    # what the model lacks.
    loose = undetermined_parameters(refit.fit)
    if not loose:
        return None
    names = ", ".join(refit.assembly.parameters[i].full_name for i in loose)
    remark = f"The recordings do not determine {names}; the fit holds the data-sheet values."
    return with_fit(refit, fit_held(refit.fit, loose), remark)


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


def without_harmful_background(refit: GreyBox) -> GreyBox:
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


def _without(refit: GreyBox, term: Effect, iterations: int) -> GreyBox:
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
    return with_fit(replace(refit, evidence=evidence, assembly=assembly), fitted)


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
