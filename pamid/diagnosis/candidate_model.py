"""Candidate models of the comparison, the baseline among them: all fitted on the same windows with
the same weights, and compared on windows that no fit has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.known_slopes import KnownSlopes
from pamid.engine.program import Stepping
from pamid.engine.symbolic.vocabulary import Expr
from pamid.estimation.multiple_shooting import begin, fit
from pamid.estimation.problem import (
    Fit,
    FitStart,
    Problem,
    careful_stepping,
    free_parameters,
    most_careful,
)
from pamid.estimation.restart import REFIT_ITERATIONS, REFIT_TOLERANCE, closeness
from pamid.estimation.robust_fit import fit_robustly
from pamid.estimation.weights import residual_weights
from pamid.model.assembly import Assembly
from pamid.model.attachment import Addition, Attachment, additions_of
from pamid.simulation.data_split import DataSplit
from pamid.simulation.replay import Replay, replay_track, run_windows
from pamid.simulation.tracks import Track
from pamid.simulation.windows import Runner

# refits with the weights of a model's residuals end where none grows by this ratio
REWEIGHT_ROUNDS, REWEIGHT_FACTOR = 2, 1.2


@dataclass(frozen=True, eq=False)
class CandidateModel:
    """A model that was fitted and replayed.

    replays: with a start estimated in every window; runs: over the horizon of the comparison, the
    same where that is a single window; absolutes: mean absolute error of the runs per held-out
    window and channel (SI), NaN where a channel was not recorded.
    """

    assembly: Assembly
    fit: Fit
    replays: tuple[Replay, ...] = field(repr=False)
    runs: tuple[Replay, ...] = field(repr=False)
    absolutes: Array = field(repr=False)

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
            and all(r.finite for r in (*self.replays, *self.runs))
            and not bool(np.isinf(self.absolutes).any())
        )

    @cached_property
    def additions(self) -> tuple[Addition, ...]:
        """Its effects; the same in several joints is a single addition."""
        return tuple(additions_of(self.assembly.rig, self.attached))

    @property
    def family(self) -> str:
        return self.attached[-1].family(self.assembly.rig)

    @property
    def group(self) -> str:
        """The ports (groups) under which the last effect is reported."""
        return self.additions[-1].group(self.assembly.rig)

    @property
    def free_count(self) -> int:
        return len(self.fit.problem.free)


def slopes_along(runner: Runner, p: Array, r: Replay) -> tuple[KnownSlopes | None, ...]:
    """Slopes of a simulator's steps along a replay, by its states alone and by the parameters as
    well, as a start for smoothings. None for equations."""
    slopes = []
    for keeping in (replace(runner, free=()).keeping(), runner.keeping()):
        if keeping.known is not None:
            values = keeping.parameters(p)
            memory = keeping.memory(values)
            for window, x in zip(r.windows, r.entered, strict=True):
                keeping.enter(memory, x)
                if not keeping.run(memory, window, values, True)[2]:
                    memory = keeping.memory(values)
        slopes.append(keeping.known)
    return tuple(slopes)


def replayed(evidence: DataSplit, assembly: Assembly, fitted: Fit) -> CandidateModel:
    """Replay a fitted model over everything held out."""
    tracks = evidence.tracks(assembly, held_out=True)
    replays = tuple(
        replay_track(assembly, fitted.p, t, fitted.stepping, evidence.noise) for t in tracks
    )
    runs = replays
    if evidence.per_run > 1:
        runs = runs_of(evidence, assembly, fitted.p, fitted.stepping, tracks)
    return candidate_from(assembly, fitted, replays, runs)


def runs_of(
    evidence: DataSplit, assembly: Assembly, p: Array, stepping: Stepping, tracks: Sequence[Track]
) -> tuple[Replay, ...]:
    """Replays of held-out tracks over the horizon of the comparison."""
    return tuple(
        replay_track(assembly, p, t, stepping, evidence.noise, per_run=evidence.per_run)
        for t in tracks
    )


def window_losses(replays: Sequence[Replay]) -> Array:
    """Mean absolute error per window of all replays and channel (SI)."""
    return np.concatenate([r.losses() for r in replays])


def candidate_from(
    assembly: Assembly,
    fitted: Fit,
    replays: tuple[Replay, ...],
    runs: tuple[Replay, ...] = (),
) -> CandidateModel:
    runs = runs or replays
    return CandidateModel(assembly, fitted, replays, runs, window_losses(runs))


def transferred(assembly: Assembly, *sources: tuple[Assembly, Array]) -> Array:
    """The assembly's data-sheet values with the parameters it shares with other models taken from
    theirs; where several share it, the last."""
    out = assembly.values()
    for source, p in sources:
        for key in source.keys.keys() & assembly.keys.keys():
            out[assembly.keys[key]] = p[source.keys[key]]
    return out


def set_within_bounds(assembly: Assembly, p: Array, first: dict[str, float]) -> None:
    """Put starting values (SI, by parameter key) into p, clipped to their bounds."""
    for key, value in first.items():
        bound = assembly.parameters[assembly.keys[key]]
        p[assembly.keys[key]] = min(max(value, bound.low), bound.high)


def window_starts_from(base: Fit, assembly: Assembly) -> FitStart:
    """Start at the end of another model's fit, with its states at the window starts.

    They are estimated anew where this model reads the size of a state and the other reads its sign.
    A fit would otherwise never leave the signs of the other's readings.
    """
    known = base.problem.assembly
    # trying the signs compiles the model; most effects leave the readings as they are
    if not assembly.reads_as(known) and set(assembly.even_states) - set(known.even_states):
        return replace(base.end, starts=None, continuity=())
    return base.end


def known_along(fitted: Fit, stepping: Stepping | None = None) -> tuple[KnownSlopes | None, ...]:
    """Slopes of a simulator's steps along a fit, for fits of other models of the same rig along the
    same tracks.

    None for equations, which are differentiated at little cost. stepping: of these fits (default:
    chosen by the recordings).
    """
    if not fitted.problem.assembly.program.keeps_slopes or not fitted.starts:
        return ()
    shooting, _ = begin(
        fitted.problem,
        replace(fitted.end, stepping=stepping),
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
) -> Fit:
    """Fit all parameters jointly from p (default: the data sheet); `first`: further starting values
    (SI) by key; known: slopes along the tracks, where the rig is stepped (`known_along`).

    First with the baseline's weights, then with those of its residuals. Where the model
    explains the gap these are smaller, and its parameters follow the recordings more and their
    priors less.
    """
    tracks = evidence.tracks(assembly)
    problem = Problem(assembly, tracks, free_parameters(assembly, tracks))
    p = assembly.values() if p is None else p.copy()
    typical = p.copy()
    set_within_bounds(assembly, p, first or {})
    # Most effects are small corrections, so that the states of the base fit are a better start
    # than new estimates.
    begun = window_starts_from(base, assembly)
    # With coarser steps than the baseline's the parameters would make up for errors of integration.
    stepping = most_careful([careful_stepping(problem, p), base.stepping])
    if begun.starts is None:  # either sign may be found: from a trace of the effect, or from all
        fits = [fit_robustly(problem, p=q, stepping=stepping) for q in (p, typical)]
        return max(fits, key=closeness)

    def fitted_from(start: Array) -> Fit:
        return fit(
            problem,
            replace(begun, p=start, stepping=stepping, known=known),
            exact=False,
            iterations=REFIT_ITERATIONS,
            tolerance=REFIT_TOLERANCE,
        )

    done = fitted_from(p)
    # The base is a special case of the model: a larger cost shows that its few steps did not
    # converge. From the base's own parameters they do.
    if not done.cost <= base.cost:
        closer = transferred(assembly, (base.problem.assembly, base.p))
        set_within_bounds(assembly, closer, first or {})
        done = min(done, fitted_from(closer), key=lambda f: f.cost if f.residuals else np.inf)
    for _ in range(REWEIGHT_ROUNDS):
        if not done.residuals:
            break
        weights = residual_weights(done.residuals, evidence.noise, problem.window)
        if (weights.root < REWEIGHT_FACTOR * done.weights.root).all():
            break
        done = fit(
            problem,
            replace(done.end, weights=weights, continuity=(), known=done.known),
            exact=False,
            iterations=REFIT_ITERATIONS,
            tolerance=REFIT_TOLERANCE,
        )
    if any(done.known) and done.residuals:  # to its end, by steps that are made
        done = fit(
            problem,
            replace(done.end, known=tuple(k and k.without_prediction() for k in done.known)),
            iterations=REFIT_ITERATIONS,
            tolerance=REFIT_TOLERANCE,
        )
    return done
