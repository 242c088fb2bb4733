"""Candidate models of the comparison, the baseline among them: all fitted on the same windows with
the same weights, and compared on windows that no fit has seen."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pamid.base.metrics import few_entries_factor, seen_mean
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.engine.known_slopes import KnownSlopes
from pamid.engine.program import Stepping
from pamid.estimation.multiple_shooting import begin, fit
from pamid.estimation.problem import Fit, Problem, free_parameters
from pamid.estimation.robust_fit import fit_robustly
from pamid.estimation.weights import residual_weights
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment
from pamid.simulation.data_split import DataSplit
from pamid.simulation.replay import Replay, replay_track, run_windows
from pamid.simulation.windows import Runner
from pamid.symbolic.vocabulary import Expr

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CandidateModel:
    """A model that was fitted and replayed. squares, absolutes: mean loss per held-out window and
    channel (SI), NaN where a channel was not recorded."""

    assembly: Assembly
    fit: Fit
    replays: tuple[Replay, ...] = field(repr=False)
    squares: Array = field(repr=False)
    absolutes: Array = field(repr=False)

    @cached_property
    def fitted_squares(self) -> Array:
        """Mean squared residual per window of the fit and channel (SI), at least that of the least
        error as of held-out windows; empty where the fit failed."""
        problem = self.fit.problem
        means = np.concatenate(
            [
                [(r[w.start : w.stop] ** 2).mean(axis=0) for w in problem.windows(t)]
                for t, r in zip(problem.tracks, self.fit.residuals, strict=True)
            ]
        )
        return np.maximum(means, self.replays[0].least_error ** 2)

    def along_fit(self, wanted: list[Expr]) -> Array:
        """Values of further expressions of the model's equations, in SI, at every sample of the
        fit's windows (samples x wanted)."""
        extra = {f"{k}:wanted": e for k, e in enumerate(wanted)}
        program, fit = self.assembly.program_with(extra), self.fit
        rows = [
            run_windows(program, self.assembly, fit.p, t, fit.problem.windows(t), x, fit.stepping)
            for t, x in zip(fit.problem.tracks, fit.starts, strict=True)
        ]
        return np.concatenate(rows)[:, len(program.outputs) - len(wanted) :]

    @cached_property
    def slopes_along_replays(self) -> tuple[tuple[KnownSlopes | None, ...], ...]:
        """Per replay: see `slopes_along`."""
        f = self.fit
        return tuple(
            slopes_along(Runner(self.assembly, r.track, f.stepping, f.problem.free), f.p, r)
            for r in self.replays
        )

    @cached_property
    def drawn_losses(self) -> dict[tuple[Any, ...], Array]:
        """Log losses on resampled windows that have been computed: see `bootstrap_losses`."""
        return {}

    @property
    def attached(self) -> tuple[Attachment, ...]:
        return self.assembly.attachments

    @property
    def label(self) -> str:
        return " + ".join(a.label for a in self.attached) or "baseline"

    @property
    def finite(self) -> bool:
        return (
            bool(self.fit.residuals)
            and all(r.finite for r in self.replays)
            and not bool(np.isinf(self.squares).any())
        )

    @property
    def family(self) -> str:
        return self.attached[-1].family(self.assembly.rig)

    @property
    def group(self) -> str:
        """The port (group) under which the last effect is reported."""
        return self.attached[-1].group(self.assembly.rig)

    @property
    def samples(self) -> int:
        """Held-out samples that are scored."""
        return sum(int(r.scored.sum()) for r in self.replays)

    @property
    def free_count(self) -> int:
        return len(self.fit.problem.free)


def slopes_along(runner: Runner, p: Array, r: Replay) -> tuple[KnownSlopes | None, ...]:
    """Slopes along a replay of what steps by itself, by its states alone and by the parameters,
    too, for smoothings along it to begin with; none of equations."""
    found = []
    for own in (replace(runner, free=()).keeping(), runner.keeping()):
        if own.known is not None:
            values = own.parameters(p)
            memory = own.memory(values)
            for window, x in zip(r.windows, r.entered, strict=True):
                own.enter(memory, x)
                if not own.run(memory, window, values, True)[2]:
                    memory = own.memory(values)
        found.append(own.known)
    return tuple(found)


def replayed(evidence: DataSplit, assembly: Assembly, fitted: Fit) -> CandidateModel:
    """Replay a fitted model over everything held out."""
    tracks = evidence.tracks(assembly, held_out=True)
    return candidate_from(
        assembly,
        fitted,
        tuple(replay_track(assembly, fitted.p, t, fitted.stepping, evidence.noise) for t in tracks),
    )


def candidate_from(assembly: Assembly, fitted: Fit, replays: tuple[Replay, ...]) -> CandidateModel:
    return CandidateModel(
        assembly,
        fitted,
        replays,
        np.concatenate([r.losses(2) for r in replays]),
        np.concatenate([r.losses(1) for r in replays]),
    )


def transferred(assembly: Assembly, *found: tuple[Assembly, Array]) -> Array:
    """The assembly's data-sheet values with the parameters it shares with other models taken from
    theirs; where several have one, the last."""
    out = assembly.values()
    for source, p in found:
        for key in source.keys.keys() & assembly.keys.keys():
            out[assembly.keys[key]] = p[source.keys[key]]
    return out


def set_within_bounds(assembly: Assembly, p: Array, first: dict[str, float]) -> None:
    """Put starting values (SI, by parameter key) into p, clipped to their bounds."""
    for key, value in first.items():
        bound = assembly.parameters[assembly.keys[key]]
        p[assembly.keys[key]] = min(max(value, bound.low), bound.high)


class Beginning(NamedTuple):
    """Where the windows of a fit begin: states per track (None: to be estimated), and how firmly
    they are tied to the window before."""

    starts: tuple[Array, ...] | None
    continuity: tuple[Array, ...]


def begun_from(base: Fit, assembly: Assembly) -> Beginning:
    """The windows' states that another model's fit has found, unless this model reads the size of a
    state of which the other reads the sign: a fit then never leaves the signs that the other's
    readings seemed to show, and they are estimated anew."""
    if set(assembly.even_states) - set(base.problem.assembly.even_states):
        return Beginning(None, ())
    return Beginning(base.starts, base.continuity)


def known_along(fitted: Fit, stepping: Stepping | None = None) -> tuple[KnownSlopes | None, ...]:
    """Slopes of what steps by itself where a fit has ended, for fits of other models of the same
    rig along the same tracks; none of equations, which are differentiated at little cost. stepping:
    of these fits (default: what the recordings ask for)."""
    if not fitted.problem.assembly.program.keeps_slopes or not fitted.starts:
        return ()
    shooting, _ = begin(
        fitted.problem,
        p=fitted.p,
        starts=fitted.starts,
        weights=fitted.weights,
        stepping=stepping,
        continuity=fitted.continuity,
        probe=True,
    )
    return shooting.known


def refit(
    evidence: DataSplit,
    assembly: Assembly,
    base: Fit,
    *,
    p: Array | None = None,
    first: dict[str, float] | None = None,
    known: tuple[KnownSlopes | None, ...] = (),
    settings: Settings = DEFAULT,
) -> Fit:
    """Fit all parameters jointly from p (default: the data sheet); `first`: further starting values
    (SI) by key; known: slopes along the tracks, where the rig is stepped (`known_along`).

    First with the baseline's weights, then with those of its own residuals. Where the model
    explains the gap these are smaller, and its parameters follow the recordings more and their
    priors less.
    """
    tracks = evidence.tracks(assembly)
    problem = Problem(assembly, tracks, free_parameters(assembly, tracks))
    p = assembly.values() if p is None else p.copy()
    typical = p.copy()
    set_within_bounds(assembly, p, first or {})
    begun = begun_from(base, assembly)
    if begun.starts is None:  # either sign may be found: from a trace of the effect, or from all
        found = [fit_robustly(problem, p=q) for q in (p, typical)]
        return max(
            found, key=lambda f: float(np.log(f.weights.root).sum()) if f.residuals else -np.inf
        )
    done = fit(
        problem,
        p=p,
        starts=begun.starts,
        weights=base.weights,
        continuity=begun.continuity,
        known=known,
        exact=False,
        iterations=settings.refit_iterations,
        tolerance=settings.refit_tolerance,
    )
    for _ in range(settings.reweight_rounds):
        if not done.residuals:
            break
        own = residual_weights(done.residuals, evidence.noise, problem.window)
        if (own.root < settings.reweight_factor * done.weights.root).all():
            break
        done = fit(
            problem,
            p=done.p,
            starts=done.starts,
            weights=own,
            stepping=done.stepping,
            known=done.known,
            exact=False,
            iterations=settings.refit_iterations,
            tolerance=settings.refit_tolerance,
        )
    if any(done.known) and done.residuals:  # to its end, by steps that are made
        done = fit(
            problem,
            p=done.p,
            starts=done.starts,
            weights=done.weights,
            stepping=done.stepping,
            continuity=done.continuity,
            known=tuple(k and k.without_foretelling() for k in done.known),
            iterations=settings.refit_iterations,
            tolerance=settings.refit_tolerance,
        )
    return done


@lru_cache(maxsize=16)  # the same for every model that is compared
def resamples(count: int, draws: int, seed: int, block: int) -> NDArray[np.intp]:
    """Bootstrap rows (draws x count) in runs of `block` neighbouring windows, the last one a
    neighbour of the first: the circular block bootstrap of Politis and Romano (1992). Of few
    windows each is drawn by itself: of two, runs of two are always both."""
    block = min(block, max(1, count // 3))
    random = np.random.default_rng(seed)
    starts = random.integers(0, count, size=(draws, -(-count // block)))
    rows = ((starts[:, :, None] + np.arange(block)) % count).reshape(draws, -1)[:, :count]
    rows.flags.writeable = False
    return rows


def bootstrap_losses(
    models: list[CandidateModel],
    asked: NDArray[np.bool_],
    seed: int,
    settings: Settings = DEFAULT,
) -> Array:
    """Log losses on resampled windows, models x draws (paired: the same windows for all).

    One draw is L = 1/2 sum_c [log s_c(held out) + log s_c(fitted)], with s_c the mean squared
    residual of channel c over the resampled windows: up to a constant, the negative log likelihood
    per sample of Gaussian residuals whose variance is profiled out. The held-out windows that are
    asked count and those of the fit, too: an effect adds few parameters to many samples, so its
    gain where it was fitted is hardly optimistic. Of few held-out windows the draws lie farther
    apart (`few_entries_factor`). Efron and Tibshirani (1993), An Introduction to the Bootstrap;
    blocks after Kuensch (1989), Ann. Stat. 17.
    """
    return np.stack([_bootstrap_loss(c, asked, seed, settings) for c in models])


def _bootstrap_loss(
    model: CandidateModel, asked: NDArray[np.bool_], seed: int, settings: Settings
) -> Array:
    """Of one model (draws,), computed once."""
    draws, block = settings.bootstrap_draws, settings.bootstrap_block
    key = asked.tobytes(), seed, draws, block
    if key not in model.drawn_losses:
        count, trained = int(asked.sum()), model.fitted_squares
        held = _drawn_means(model.squares[asked], resamples(count, draws, seed, block))
        unseen = np.log(held).sum(axis=1)
        wider = few_entries_factor(count)
        if wider > 1.0:
            unseen = unseen.mean() + wider * (unseen - unseen.mean())
        seen = _drawn_means(trained, resamples(len(trained), draws, seed + 1, block))
        model.drawn_losses[key] = 0.5 * (unseen + np.log(seen).sum(axis=1))
    return model.drawn_losses[key]


def log_evidence(fitted: Fit, correlated: Array, noise: Array) -> float:
    """Laplace's approximation (MacKay 1992, Neural Computation 4:415), up to a constant:

        log Z = -1/2 sum_c n_c / tau_c (log sigma_c^2 + S_c / sigma_c^2)
                - 1/2 |s|^2 + 1/2 log det C

    with n_c residuals of mean square S_c in channel c, the parameters s in prior spreads around the
    data sheet, their covariance C. sigma_c^2 is S_c, or the noise where that is more: a model that
    leaves little is judged by what it leaves, not by what another one left. correlated: tau,
    samples per independent one, the same for all models that are compared; noise: per channel (SI).
    0 where it cannot be told.
    """
    if not fitted.residuals:
        return 0.0
    free = list(fitted.problem.free)
    s = fitted.problem.scale.inside(fitted.p[free])
    count, squares = fitted.left
    variance = np.maximum(squares, noise**2)
    misfit = float(np.nansum(count / correlated * (np.log(variance) + squares / variance)))
    sign, volume = np.linalg.slogdet(fitted.covariance) if free else (1.0, 0.0)
    found = -0.5 * (misfit + float(s @ s)) + (0.5 * float(volume) if sign > 0 else 0.0)
    return found if np.isfinite(found) else 0.0


def in_errors(draws: Array) -> float:
    """Mean of bootstrap draws in their standard deviations."""
    return float(draws.mean() / max(draws.std(), 1e-6))


def _drawn_means(squares: Array, rows: NDArray[np.intp]) -> Array:
    """Mean per draw and channel; where no window of a draw has recorded a channel, its mean over
    all windows; 1 (log loss 0) where none has at all."""
    found = seen_mean(squares[rows], axis=1)
    if np.isnan(found).any():
        overall = seen_mean(squares)
        overall = np.where(np.isnan(overall), 1.0, overall)
        found = np.where(np.isnan(found), overall, found)
    return found
