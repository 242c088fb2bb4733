"""From recordings to a fitted model with its replays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import ConvergenceError
from pamid.base.parallel.jobs import WorkerPool
from pamid.base.progress import Progress, Settled, silent
from pamid.base.units import NONE, column_size, split_column
from pamid.estimation.baseline_repair import (
    Refit,
    repaired,
    without_harmful_background,
)
from pamid.estimation.intervals import bootstrap, estimates
from pamid.estimation.multiple_shooting import ITERATIONS
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
from pamid.simulation.data_split import DataSplit
from pamid.simulation.replay import Replay, channel_mae, noise_floors, replay_track
from pamid.simulation.tracks import Track

COARSE = 0.2  # noise standard deviations by which doubled sub-steps may change an output
# of that change: largest share after doubling once more; a method of order 1 leaves half
SETTLING = 0.75


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
    refit = Refit(evidence, assembly, fitted, replays)
    if earlier is None:
        # Not with an earlier posterior: the data sheet is then no longer the prior that the fit
        # has to beat.
        refit = repaired(without_harmful_background(refit), sheet, seed)
    if refit.fit is not fitted:
        evidence, assembly, fitted = refit.evidence, refit.assembly, refit.fit
        held = evidence.tracks(assembly, held_out=True)
        replays, change = rechecked(assembly, fitted, held, evidence.noise)
    progress("noise floor")
    floor = noise_floors(assembly, fitted.p, replays, fitted.stepping, evidence.noise, seed)
    require_predictable(evidence, floor, (*tracks, *held))
    if draws:
        values = (f"{b.full_name} {e.value:.4g}" for b, e in estimates(fitted).items())
        progress(Settled(f"fitted, intervals follow: {', '.join(values)}"))
    return GreyBox(
        evidence,
        assembly,
        fitted,
        change,
        replays,
        sheet,
        floor,
        bootstrap(fitted, draws, seed=seed, pool=pool, progress=progress) if draws else None,
        earlier,
        refit.remark,
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
