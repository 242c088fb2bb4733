"""Grey-box fit on recorded commands: multiple shooting, weighted least squares with priors, exact
Jacobians.

Unknowns are the free parameters s, in prior spreads around the data sheet, and the rig's state x_w
at the start of every window w. With y_w(s, x_w) the model's outputs over the window and f_w(s, x_w)
its state at the end, a fit minimises

    |s|^2 + sum_w |W (y_w(s, x_w) - measured)|^2 + sum_w |L (x_(w+1) - f_w(s, x_w))|^2

which is -2 log of the posterior density up to a constant. In Bock's multiple shooting continuity is
a constraint (L infinite). Here L is finite, the inverse of a state's admissible jump per window, so
that a slow drift of an integrating state does not dominate the cost. The normal equations in x_w
are block-tridiagonal and bordered by s; eliminating x_w (Bock's condensing) leaves as many
equations as there are parameters. Bock (1983), in Numerical Treatment of Inverse Problems in
Differential and Integral Equations, Birkhaeuser, 95-121; Bock and Plitt (1984), IFAC Proc. 17(2),
1603-1608.

W follows the size and correlation time of the residuals, not the sensor noise alone (see
`residual_weights`). A wrong model has large residuals that are correlated for a long time. Counted
as independent, its samples would overrule every prior.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.block_tridiagonal import eliminate
from pamid.engine.damped_gauss_newton import DampingRule, Iteration, LeastSquares, iterate
from pamid.engine.known_slopes import KnownSlopes
from pamid.engine.program import Stepping
from pamid.estimation.prior import terms_of_sheet
from pamid.estimation.problem import FIRST_START, Fit, FitStart, Problem, Scale, careful_stepping
from pamid.estimation.weights import Weights
from pamid.simulation.initial_state import CARRIED_INFORMATION, WindowStart
from pamid.simulation.windows import Runner

Progress = Callable[[int, float], None]
#: normal equations of a track's window starts: diagonal blocks D (w,n,n), off-diagonal blocks
#: (w-1,n,n), border B (w,n,k) and gradient gx (w,n)
Blocks: TypeAlias = tuple[Array, Array, Array, Array]

ITERATIONS, TOLERANCE = 40, 1e-4
MANY_UNKNOWNS = 24  # with them a run without derivatives takes a quarter of the time of one with
FAST = 0.95  # of the cost: a step that leaves less does not count against the limit
LAST_STEPS = 3  # steps allowed, at least, after the Jacobian is recomputed
CALM = 0.02  # squared step in posterior deviations; two consecutive steps below it end a fit


def initial_states(
    problem: Problem, p: Array, weights: Weights, stepping: Stepping
) -> tuple[Array, ...]:
    """Estimate the state at the start of every window, window by window (moving-horizon
    estimation)."""
    starts = []
    for track in problem.tracks:
        runner = Runner(problem.assembly, track, stepping)
        values = runner.parameters(p)
        memory = runner.memory(values)
        track_starts: list[Array] = []
        for window in problem.windows(track):
            predicted = memory.x[: runner.start_states].copy()
            x, usable = WindowStart.of(
                runner,
                memory,
                window,
                values,
                1.0 / weights.sigma,
                predicted,
                track.jump if track_starts else None,
            ).estimate()
            x = x if usable else track_starts[-1] if track_starts else predicted
            runner.enter(memory, x)
            runner.run(memory, window, values, False)
            if not np.isfinite(memory.x).all():
                memory.x[:] = 0.0
                memory.x[: runner.start_states] = x
            track_starts.append(x)
        starts.append(np.array(track_starts))
    return tuple(starts)


@dataclass
class ShootingNormal:
    """Normal equations: parameters bordering a block-tridiagonal system of window starts."""

    cost: float
    H: Array
    g: Array
    blocks: list[Blocks]  # per track
    residuals: list[Array]
    fine: bool


class WindowSums(NamedTuple):
    """Sums over the windows of a track, before they are joined.

    cost: squared residuals; N (windows, unknowns, unknowns) and v (windows, unknowns): J'J and J'r
    by (scaled parameters, window start); ends (windows, states, unknowns): derivatives of the end
    states; jumps (windows - 1, states): from the end of each window to the next start; residuals
    (samples, channels) in SI. Without derivatives N, v and ends are empty.
    """

    cost: float
    N: Array
    v: Array
    ends: Array
    jumps: Array
    residuals: Array


def _add_continuity(sums: WindowSums, weight: Array, H: Array, g: Array) -> Blocks:
    """Return the blocks of the window starts with the terms |L (x_(w+1) - f_w(s, x_w))|^2 added.

    The part of the parameters is added to H and g in place. weight: diagonal of L'L.
    """
    k, n = len(g), sums.ends.shape[1]
    D, B, gx = sums.N[:, k:, k:].copy(), sums.N[:, k:, :k].copy(), sums.v[:, k:].copy()
    by_s, by_x = sums.ends[:-1, :, :k], sums.ends[:-1, :, k:]
    P, weighted_jumps, by_xT = weight[:, None], weight * sums.jumps, by_x.transpose(0, 2, 1)
    H += sums.N[:, :k, :k].sum(axis=0) + (by_s.transpose(0, 2, 1) @ (P * by_s)).sum(axis=0)
    g += sums.v[:, :k].sum(axis=0) - np.einsum("wnk,wn->k", by_s, weighted_jumps)
    D[:-1] += by_xT @ (P * by_x)
    B[:-1] += by_xT @ (P * by_s)
    gx[:-1] -= np.einsum("wnm,wn->wm", by_x, weighted_jumps)
    D[1:, range(n), range(n)] += weight
    B[1:] -= P * by_s
    gx[1:] += weighted_jumps
    return D, -P * by_x, B, gx


def reduced(
    normal: ShootingNormal, s: Array, scale: Scale, damping: float
) -> tuple[Array, Array, NDArray[np.bool_], list[tuple[Array, Array]]]:
    """Eliminate the window starts from the normal equations (Schur complement).

    Returns
    -------
    Hessian H - B' T^-1 B and gradient g - B' T^-1 gx of the scaled parameters; mask of parameters
    held at a bound; per track T^-1 B and T^-1 gx.
    """
    H, g = normal.H.copy(), normal.g.copy()
    k, parts = len(g), []
    for D, off, B, gx in normal.blocks:
        # the block-tridiagonal part solved for [B | gx]
        solution, _ = eliminate(D, off, np.concatenate([B, gx[:, :, None]], axis=2), damping)
        X, x = solution[:, :, :k], solution[:, :, k]
        H -= np.einsum("wnk,wnl->kl", B, X)
        g -= np.einsum("wnk,wn->k", B, x)
        parts.append((X, x))
    return H, g, scale.held(s, g), parts


class ShootingPoint(NamedTuple):
    """Scaled free parameters, states at the start of every window per track, and the normal
    equations there; linearised: whether these include derivatives."""

    s: Array
    starts: tuple[Array, ...]
    normal: ShootingNormal
    linearised: bool

    @property
    def cost(self) -> float:
        return self.normal.cost


class _ShootingStep(NamedTuple):
    """Step of the scaled parameters and of every track's window starts; the reduced Hessian."""

    s: Array
    starts: list[Array]
    H: Array


@dataclass(frozen=True, eq=False)
class MultipleShooting(LeastSquares[ShootingPoint, _ShootingStep]):
    """Least-squares problem over scaled parameters and window starts.

    p: all parameters (SI), of which the free ones are replaced; continuity: diagonal of L'L per
    track; runners: a runner per track, which may reuse a simulator's slopes from point to point;
    probe: whether the derivatives at the last point are skipped.
    """

    problem: Problem
    p: Array
    weights: Weights
    continuity: tuple[Array, ...]
    stepping: Stepping
    runners: tuple[Runner, ...]
    tolerance: float
    probe: bool
    rule = DampingRule(1e-3, falls=0.2, least=1e-9, rises=10.0, most=1e7)

    @cached_property
    def scale(self) -> Scale:
        return self.problem.scale

    def at(self, s: Array, starts: tuple[Array, ...], derivatives: bool = True) -> ShootingPoint:
        sums = self.window_sums(s, starts, derivatives)
        return ShootingPoint(s, starts, self.assembled(s, sums, derivatives), derivatives)

    # If a model diverges, sums of its sensitivities may overflow. `assembled` checks them.
    @np.errstate(over="ignore", invalid="ignore")
    def window_sums(
        self, s: Array, starts: tuple[Array, ...], derivatives: bool
    ) -> list[WindowSums] | None:
        """Simulate every window and sum its products per track; None if the model diverges."""
        problem, scale, weights = self.problem, self.scale, self.weights
        k = len(problem.free)
        values = self.p.copy()
        values[list(problem.free)] = scale.outside(s)
        slope, root = scale.slope(values[list(problem.free)]), weights.root
        track_sums: list[WindowSums] = []
        first_window = 0
        for i, track in enumerate(problem.tracks):
            runner = self.runners[i]
            track_values = runner.parameters(values)
            windows, n = problem.windows(track), runner.start_states
            count, unknowns, cost = len(windows), (k + n) * derivatives, 0.0
            N, v = np.empty((count, unknowns, unknowns)), np.empty((count, unknowns))
            end_states, end_slopes = np.empty((count, n)), np.empty((count, n, unknowns))
            complete, residuals = bool(track.seen.all()), np.empty_like(track.y)
            seen_root = np.where(track.seen, root, 0.0)
            simulated = runner.run_windows(
                runner.memory(track_values),
                windows,
                starts[i],
                track_values,
                derivatives,
                seen_root,
            )
            for w, (window, run) in enumerate(zip(windows, simulated, strict=True)):
                # A single diverging window makes the cost infinite, and the damping rule rejects
                # the whole step.
                if not run.fine:
                    return None
                importance = 1.0
                if problem.importance is not None:
                    importance = float(problem.importance[first_window + w])
                window_residuals = residuals[window.start : window.stop]
                np.subtract(run.Y, track.y[window.start : window.stop], out=window_residuals)
                r = (
                    window_residuals * root if complete else np.nan_to_num(window_residuals * root)
                ).ravel()
                cost += importance * float(r @ r)
                end_states[w] = run.end[:n]
                if derivatives:
                    # rows beyond the unknowns are the padding of the sensitivities
                    A = run.J
                    N[w] = importance * (A.T @ A)[:unknowns, :unknowns]
                    v[w] = importance * (A.T @ r)[:unknowns]
                    end_slopes[w] = run.S[:, :unknowns]
            # Scaling after the products costs a multiplication per entry of the sums, not per
            # sample.
            if derivatives:  # from SI to scaled parameters
                N[:, :k] *= slope[:, None]
                N[:, :, :k] *= slope
                v[:, :k] *= slope
                end_slopes[:, :, :k] *= slope
            first_window += count
            track_sums.append(
                WindowSums(cost, N, v, end_slopes, starts[i][1:] - end_states[:-1], residuals)
            )
        return track_sums

    @np.errstate(over="ignore", invalid="ignore")
    def assembled(
        self, s: Array, tracks: list[WindowSums] | None, derivatives: bool
    ) -> ShootingNormal:
        """Assemble the cost, and with derivatives the normal equations, from the tracks' sums."""
        problem = self.problem
        cost, H, g = (problem.prior.terms if problem.prior else terms_of_sheet)(s, problem.sheet)
        blocks: list[Blocks] = []
        if tracks is None:
            return ShootingNormal(np.inf, H, g, blocks, [], False)
        residuals = [sums.residuals for sums in tracks]
        finite = True
        for sums, weight in zip(tracks, self.continuity, strict=True):
            cost += sums.cost + float((sums.jumps**2 * weight).sum())
            if derivatives:
                blocks.append(_add_continuity(sums, weight, H, g))
                D, _, B, _ = blocks[-1]
                finite = finite and bool(np.isfinite(B).all() and np.isfinite(D).all())
        finite = finite and bool(np.isfinite(cost) and np.isfinite(H).all())
        return ShootingNormal(cost if finite else np.inf, H, g, blocks, residuals, finite)

    def step(self, at: ShootingPoint, damping: float) -> _ShootingStep:
        """Solve for the damped step.

        The window starts are eliminated block by block, which leaves a reduced system of the
        parameters (Schur complement). A parameter at a bound stays if its gradient points outwards.
        """
        H, g, held, parts = reduced(at.normal, at.s, self.scale, damping)
        ds = np.zeros(len(at.s))
        free = np.logical_not(held)
        if free.any():
            A = H[np.ix_(free, free)]
            # Lambda acts twice: on the diagonal of the starts in the elimination, and here on the
            # diagonal of the reduced Hessian. The latter is the information on each parameter after
            # the starts have adapted.
            A = A + damping * np.diag(np.maximum(A.diagonal(), 1e-12))
            ds[free] = -np.linalg.lstsq(A, g[free], rcond=None)[0]
        # The starts follow the parameter step after its clipping to the bounds.
        ds = np.clip(at.s + ds, self.scale.low, self.scale.high) - at.s
        return _ShootingStep(ds, [-(x + X @ ds) for X, x in parts], H)

    def moved(self, at: ShootingPoint, step: _ShootingStep, last: bool) -> ShootingPoint:
        prior, scale = self.problem.prior, self.scale
        s = np.clip(prior.moved(at.s, step.s), scale.low, scale.high) if prior else at.s + step.s
        starts = tuple(x + d for x, d in zip(at.starts, step.starts, strict=True))
        return self.at(s, starts, self.differentiates_at_once and not (self.probe and last))

    def linearised(self, at: ShootingPoint, last: bool) -> ShootingPoint:
        return at if at.linearised or (self.probe and last) else self.at(at.s, at.starts)

    def counts(self, before: ShootingPoint, trial: ShootingPoint) -> bool:
        if trial.cost < before.cost:
            return self.probe or trial.cost > FAST * before.cost
        return self.differentiates_at_once

    @property
    def differentiates_at_once(self) -> bool:
        """Whether a point is differentiated before it is known that its step is taken."""
        unknowns = len(self.problem.free) + self.runners[0].start_states
        return unknowns < MANY_UNKNOWNS or any(self.known)

    def settled(self, gain: float, before: ShootingPoint, after: ShootingPoint) -> bool:
        # The cost is -2 log posterior, so a gain far below 1 is not significant. Above 1000, the
        # limit grows with the cost.
        return gain < self.tolerance * (1.0 + 1e-3 * after.cost)

    def calm(self, step: _ShootingStep, damping: float) -> bool:
        # under strong damping every step is short, so a short step proves nothing
        return damping < 1e-2 and float(step.s @ step.H @ step.s) < CALM

    def stuck(self, at: ShootingPoint, step: _ShootingStep) -> bool:
        if float(np.abs(step.s).max(initial=0.0)) < 1e-7:
            return True
        # So close to the optimum, a step from reused slopes may not lower the cost at all.
        return any(self.known) and float(step.s @ step.H @ step.s) < CALM

    @property
    def known(self) -> tuple[KnownSlopes | None, ...]:
        """Slopes for reuse, per track."""
        return tuple(runner.known for runner in self.runners)

    def exactly(self, ended: Iteration[ShootingPoint], iterations: int) -> Iteration[ShootingPoint]:
        """Continue a converged fit without reused slopes and predicted steps.

        A fit at its iteration limit is only re-evaluated at its last point, and only if steps were
        predicted.
        """
        if not any(known and known.counts[1] for known in self.known):
            return ended
        if not ended.settled:
            if not any(known and known.counts[2] for known in self.known):
                return ended
            simulated = self._with_slopes([k and k.without_prediction() for k in self.known])
            return replace(ended, point=simulated.at(ended.point.s, ended.point.starts))
        exact = self._with_slopes([k and k.forgotten() for k in self.known])
        point = exact.at(ended.point.s, ended.point.starts)
        restarted = replace(ended, point=point, damping=self.rule.start, calm=0, settled=False)
        if not point.normal.fine:  # a predicted step was wrong
            return restarted
        return iterate(exact, restarted, max(iterations, ended.counted + LAST_STEPS))

    def _with_slopes(self, known: list[KnownSlopes | None]) -> MultipleShooting:
        """Return the same problem with these slopes per track."""
        pairs = zip(self.runners, known, strict=True)
        return replace(self, runners=tuple(replace(r, known=k) for r, k in pairs))

    def resumed(self, probe: Iteration[ShootingPoint]) -> Fit:
        """Continue a probe as a full fit."""
        full = replace(self, probe=False)
        point = full.linearised(probe.point, last=False)
        ended = iterate(full, replace(probe, point=point), ITERATIONS)
        return full.fit(full.exactly(ended, ITERATIONS))

    def fit(self, ended: Iteration[ShootingPoint]) -> Fit:
        s, starts, normal, _ = ended.point
        p, free = self.p.copy(), list(self.problem.free)
        p[free] = self.scale.outside(s)
        result = Fit(
            self.problem,
            p,
            starts,
            self.weights,
            normal.cost,
            np.eye(len(free)),
            ended.steps,
            ended.settled,
            "" if ended.settled else "iterations used up",
            self.stepping,
            self.continuity,
            tuple(normal.residuals),
        )
        if self.probe:
            return result
        # Laplace's approximation: the inverse of the half Hessian of -2 log posterior, with the
        # starts marginalised (the Schur complement does that)
        H, g, held, _ = reduced(normal, s, self.scale, 0.0)
        covariance: Array = np.linalg.pinv(H, hermitian=True).astype(np.float64, copy=False)
        return replace(result, covariance=covariance, held=np.where(held, g, 0.0))


def begin(
    problem: Problem,
    start: FitStart = FIRST_START,
    *,
    tolerance: float = TOLERANCE,
    probe: bool = False,
) -> tuple[MultipleShooting, Iteration[ShootingPoint]]:
    """Return the least-squares problem of a fit and its starting point; arguments as of `fit`."""
    p = problem.start() if start.p is None else start.p.copy()
    stepping = start.stepping or careful_stepping(problem, p)
    weights = start.weights or Weights(problem.noise, np.ones_like(problem.noise))
    starts, continuity, known = start.starts, start.continuity, start.known
    scale = problem.scale
    s = np.clip(scale.inside(p[list(problem.free)]), scale.low, scale.high)
    if starts is None:
        starts = initial_states(problem, p, weights, stepping)
    unweighted = tuple(np.zeros(len(problem.assembly.rig.states)) for _ in problem.tracks)
    runners = tuple(
        Runner(problem.assembly, track, stepping, problem.free).keeping(known[i] if known else None)
        for i, track in enumerate(problem.tracks)
    )
    shooting = MultipleShooting(
        problem, p, weights, continuity or unweighted, stepping, runners, tolerance, probe
    )
    sums = shooting.window_sums(s, starts, True)
    point = ShootingPoint(s, starts, shooting.assembled(s, sums, True), True)
    if point.normal.fine and not continuity:
        # noise_ratio: size of the residuals over the sensor noise, correlation included. The
        # admissible jump of a state grows by the same factor.
        noise_ratio = float(np.exp(-np.log(problem.noise * weights.root).mean()))
        continuity = tuple(
            np.maximum(
                CARRIED_INFORMATION * np.einsum("wii->wi", b[0]).mean(axis=0),
                1.0 / (noise_ratio * t.jump) ** 2,
            )
            for b, t in zip(point.normal.blocks, problem.tracks, strict=True)
        )
        # the same simulations, with a new weight of the jumps between windows
        shooting = replace(shooting, continuity=continuity)
        point = point._replace(normal=shooting.assembled(s, sums, True))
    return shooting, Iteration(point, shooting.rule.start)


def fit(
    problem: Problem,
    start: FitStart = FIRST_START,
    *,
    iterations: int = ITERATIONS,
    tolerance: float = TOLERANCE,
    exact: bool = True,
    progress: Progress | None = None,
    probe: bool = False,
) -> Fit:
    """Fit the free parameters by Levenberg-Marquardt steps with fixed weights.

    A fit that does not converge is returned as well; see `converged` and `why`.

    tolerance: gain of the cost below which the fit has converged. exact: the fit ends with newly
    computed slopes; otherwise, or for a probe, the slopes are returned for reuse in a later fit.
    iterations: steps that count at most; those by which the cost falls fast do not, but in a probe.
    probe: the last step has no derivatives and no covariance.
    """
    shooting, begun = begin(problem, start, tolerance=tolerance, probe=probe)
    if not begun.point.normal.fine:
        return Fit(
            problem,
            shooting.p,
            begun.point.starts,
            shooting.weights,
            np.inf,
            np.eye(len(problem.free)),
            0,
            False,
            "the model became unstable at its starting parameters",
            shooting.stepping,
        )
    ended = iterate(shooting, begun, iterations, progress)
    if probe or not exact:
        return replace(shooting.fit(ended), known=shooting.known)
    return shooting.fit(shooting.exactly(ended, iterations))
