"""The gap budget: held-out errors of the data sheet and of the refitted model, and the noise
floor."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import ConvergenceError
from pamid.base.metrics import seen_mean
from pamid.base.parallel.jobs import Work, WorkerPool
from pamid.base.progress import Progress, Settled
from pamid.base.units import column_size
from pamid.diagnosis.candidate_model import CandidateModel, candidate_from, runs_of, window_losses
from pamid.diagnosis.settings import Settings
from pamid.estimation.grey_box import WORSE, GreyBox, fit_model
from pamid.estimation.problem import SHORTEST
from pamid.estimation.restart import refound
from pamid.model.bound_parameter import Sizes
from pamid.simulation.data_split import DataSplit
from pamid.simulation.replay import WHOLE, noise_floors

HORIZONS = (8, 4, 2)  # windows that a run covers, where it cannot cover a whole recording


@dataclass(frozen=True)
class Budget:
    """Mean absolute errors per held-out window and channel (SI): data sheet, refitted baseline,
    floor.

    evidence: with the horizon of these errors; settings: of the diagnosis.
    """

    model: GreyBox
    evidence: DataSplit
    baseline: CandidateModel
    data_sheet: Array
    floor: Array
    settings: Settings

    @property
    def sizes(self) -> Sizes:
        return self.model.assembly.sizes

    @property
    def short(self) -> Array | None:
        """Errors of the baseline with a start estimated in every window; None where these are the
        errors of the budget."""
        return None if self.evidence.per_run == 1 else window_losses(self.baseline.replays)

    @property
    def horizon_s(self) -> float:
        """Longest time over which the model predicts from an estimated state, s."""
        return max(
            (windows[-1].stop - windows[0].start) * r.track.period_s
            for r in self.baseline.runs
            for k in range(0, len(r.windows), r.per_run)
            if (windows := r.windows[k : k + r.per_run])
        )

    def shrinkage(self, absolutes: Array) -> float:
        """1 - error/baseline error, channels weighed by their floors."""
        # Channels have different units. In units of their floors, a volt and a newton count by
        # what the sensor can resolve.
        floor = seen_mean(self.floor)
        before = np.nansum(seen_mean(self.baseline.absolutes) / floor)
        return float(1.0 - np.nansum(seen_mean(absolutes) / floor) / before)

    def channel_losses(self, absolutes: Array) -> Array:
        """A loss per window: channels added in units of their floors."""
        return np.asarray(np.nansum(absolutes / seen_mean(self.floor), axis=1))

    def error_text(self) -> str:
        """Text of every channel's error in its unit: with the data sheet, refitted, and the
        floor."""
        before, after, floor = (
            seen_mean(errors) for errors in (self.data_sheet, self.baseline.absolutes, self.floor)
        )
        return "; ".join(
            f"{name} {column_size(name, before[k]):.3g} -> {column_size(name, after[k]):.3g} "
            f"(floor {column_size(name, floor[k]):.3g})"
            for k, name in enumerate(self.model.evidence.channels)
        )


def gap_budget(
    evidence: DataSplit, *, seed: int, pool: WorkerPool, progress: Progress, settings: Settings
) -> Budget:
    """The baseline, fitted (parameters and background) and replayed, with the noise floor."""
    # Parameters are fitted before the gap is measured. An error of a data sheet is not a missing
    # effect.
    model = pool.one(_Baseline(evidence, progress), seed)
    # Every share of the gap is relative to the baseline, so that nothing can be compared without.
    if not model.fit.residuals:
        raise ConvergenceError(
            f"The model could not be fitted: {model.fit.why}.",
            "check the units of the columns, and starting values and bounds of the rig",
        )
    return budget_of(model, seed=seed, progress=progress, settings=settings)


def budget_of(model: GreyBox, *, seed: int, progress: Progress, settings: Settings) -> Budget:
    """The budget of a fitted baseline, over the horizon of the comparison."""
    budget = _over_horizon(model, seed, settings)
    progress(Settled(f"refitted, held-out errors: {budget.error_text()}"))
    return budget


@dataclass(frozen=True, eq=False)
class _Baseline(Work[int, GreyBox]):
    """Items are seeds."""

    what = "fitting"
    evidence: DataSplit
    progress: Progress = field(compare=False)

    def __call__(self, item: int) -> GreyBox:
        """The fit over the longest windows, halved in turn, in which it is found again from the
        data sheet; over the longest where it is found in none.

        The fits of candidates begin like that. Over windows too long for the baseline they end in
        local minima, each in another, and their costs compare those.
        """
        longest = model = fit_model(self.evidence, seed=item, progress=self.progress)
        while model.fit.residuals:
            if refound(model.fit):
                return model
            if 0.5 * model.fit.problem.window < SHORTEST:
                break
            self.progress("fitting over shorter windows")
            shorter = replace(self.evidence, timescale_s=0.5 * model.evidence.timescale_s)
            model = fit_model(shorter, seed=item, progress=self.progress)
        return longest


def _over_horizon(model: GreyBox, seed: int, settings: Settings) -> Budget:
    """The budget over the horizon that the settings state, else the longest that the model's start
    allows.

    A run may cover as many windows as the noise of its estimated start is not amplified: its noise
    floor stays within `horizon_floor` of that of single windows. A model that forgets its initial
    state, or preserves it, runs over whole recordings. Where the longer horizon shows no more of
    the gap (`horizon_gain`), single windows are kept: they are more independent.
    """
    # Windows of the fit are the fallback: every model that could be fitted is finite over them.
    short = _budget_of(model, 1, seed, settings)
    if short is None:
        raise AssertionError("replays of single windows are those of the fit")
    if settings.horizon_s > 0.0:
        windows = settings.horizon_s / short.horizon_s  # that is a single window
        stated = _budget_of(model, round(min(max(windows, 1.0), WHOLE)), seed, settings)
        if stated is None:
            raise ConvergenceError(
                f"The refitted model diverges within {settings.horizon_s:.4g} s of a held-out "
                "recording.",
                "Give a shorter horizon, or no horizon: pamid then chooses the horizon.",
            )
        return stated
    # The longest horizon first: an error of the equations shows more the longer a run is.
    for per_run in (WHOLE, *HORIZONS):
        longer = _budget_of(model, per_run, seed, settings)
        if longer is None:
            continue
        floor, floor_short = seen_mean(longer.floor), seen_mean(short.floor)
        if np.nanmax(floor / floor_short) > settings.horizon_floor or errors_add_up(longer, short):
            continue
        # Both errors are divided by their respective floors, because the floor grows with the
        # horizon as well.
        visible = np.nanmean(seen_mean(longer.baseline.absolutes) / floor)
        visible_short = np.nanmean(seen_mean(short.baseline.absolutes) / floor_short)
        return longer if visible > settings.horizon_gain * visible_short else short
    return short


def errors_add_up(longer: Budget, short: Budget) -> bool:
    """Whether the refit predicts worse than the data sheet over a longer horizon alone: then small
    errors of its parameters add up there, as in the angle of a motor."""

    def times_worse(budget: Budget) -> float:
        return float(
            np.nanmean(seen_mean(budget.baseline.absolutes) / seen_mean(budget.data_sheet))
        )

    return times_worse(longer) > WORSE >= times_worse(short)


def _budget_of(model: GreyBox, per_run: int, seed: int, settings: Settings) -> Budget | None:
    """The budget over runs of so many windows; None where any of them diverges."""
    evidence = replace(model.evidence, per_run=per_run)
    if per_run == 1:
        runs, sheet, floor = model.held_out, model.data_sheet, model.floor
    else:
        a, p, stepping = model.assembly, model.fit.p, model.fit.stepping
        noise = evidence.noise
        alone = replace(a, attachments=())
        runs = runs_of(evidence, a, p, stepping, [r.full_track for r in model.held_out])
        sheet_tracks = [r.full_track for r in model.data_sheet]
        sheet = runs_of(evidence, alone, alone.data_sheet(), stepping, sheet_tracks)
        if not all(r.finite for r in runs):
            return None
        floor = noise_floors(a, p, runs, stepping, noise, seed)
        if not all(r.finite for r in floor):
            return None
    return Budget(
        model,
        evidence,
        candidate_from(model.assembly, model.fit, model.held_out, runs),
        window_losses(sheet),
        window_losses(floor),
        settings,
    )
