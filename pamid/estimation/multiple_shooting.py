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

from pamid.engine.block_tridiagonal import eliminate
from pamid.engine.damped_gauss_newton import DampingRule, Iteration, LeastSquares, iterate
from pamid.engine.known_slopes import KnownSlopes
from pamid.engine.program import Stepping
from pamid.estimation.prior import terms_of_sheet
from pamid.estimation.problem import Fit, Problem, Scale, careful_stepping
from pamid.estimation.weights import Weights
from pamid.simulation.initial_state import CARRIED_INFORMATION, WindowStart
from pamid.simulation.windows import Runner

Array = NDArray[np.float64]
Progress = Callable[[int, float], None]
#: of a track's window starts: D (w,n,n), off (w-1,n,n), B (w,n,k), gx (w,n)
Blocks: TypeAlias = tuple[Array, Array, Array, Array]

ITERATIONS, TOLERANCE = 40, 1e-4
LAST_STEPS = 3  # at least, with slopes of where a fit has ended
CALM = 0.02  # squared step of the parameters in their posterior: two in a row below it end a fit


def initial_states(
    problem: Problem, p: Array, weights: Weights, stepping: Stepping
) -> tuple[Array, ...]:
    """State at the start of every window, one window after the other (moving-horizon
    estimation)."""
    out = []
    for track in problem.tracks:
        runner = Runner(problem.assembly, track, stepping)
        values = runner.parameters(p)
        memory = runner.memory(values)
        rows: list[Array] = []
        for window in problem.windows(track):
            carried = memory.x[: runner.start_states].copy()
            x, usable = WindowStart.of(
                runner,
                memory,
                window,
                values,
                1.0 / weights.sigma,
                carried,
                track.jump if rows else None,
            ).estimate()
            x = x if usable else rows[-1] if rows else carried
            runner.enter(memory, x)
            runner.run(memory, window, values, False)
            if not np.isfinite(memory.x).all():
                memory.x[:] = 0.0
                memory.x[: runner.start_states] = x
            rows.append(x)
        out.append(np.array(rows))
    return tuple(out)


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


def _joined(sums: WindowSums, weight: Array, H: Array, g: Array) -> Blocks:
    """Blocks of the window starts with the joints |L (x_(w+1) - f_w(s, x_w))|^2; the part of the
    parameters is added to H and g in place. weight: the diagonal of L'L."""
    k, n = len(g), sums.ends.shape[1]
    D, B, gx = sums.N[:, k:, k:].copy(), sums.N[:, k:, :k].copy(), sums.v[:, k:].copy()
    by_s, by_x = sums.ends[:-1, :, :k], sums.ends[:-1, :, k:]
    P, pulled, turned = weight[:, None], weight * sums.jumps, by_x.transpose(0, 2, 1)
    H += sums.N[:, :k, :k].sum(axis=0) + (by_s.transpose(0, 2, 1) @ (P * by_s)).sum(axis=0)
    g += sums.v[:, :k].sum(axis=0) - np.einsum("wnk,wn->k", by_s, pulled)
    D[:-1] += turned @ (P * by_x)
    B[:-1] += turned @ (P * by_s)
    gx[:-1] -= np.einsum("wnm,wn->wm", by_x, pulled)
    D[1:, range(n), range(n)] += weight
    B[1:] -= P * by_s
    gx[1:] += pulled
    return D, -P * by_x, B, gx


def reduced(
    normal: ShootingNormal, s: Array, scale: Scale, damping: float
) -> tuple[Array, Array, NDArray[np.bool_], list[tuple[Array, Array, Array, Array]]]:
    """Hessian H - B' T^-1 B and gradient g - B' T^-1 gx of the scaled parameters alone (Schur
    complement: window starts at their best), which of them a bound holds, and the starts' parts."""
    H, g = normal.H.copy(), normal.g.copy()
    k, parts = len(g), []
    for D, off, B, gx in normal.blocks:
        # the block-tridiagonal part solved for [B | gx]
        out, _ = eliminate(D, off, np.concatenate([B, gx[:, :, None]], axis=2), damping)
        X, x = out[:, :, :k], out[:, :, k]
        inner, right = np.einsum("wnk,wnl->kl", B, X), np.einsum("wnk,wn->k", B, x)
        H -= inner
        g -= right
        parts.append((X, x, inner, right))
    return H, g, scale.held(s, g), parts


class ShootingPoint(NamedTuple):
    """Scaled free parameters, states at the start of every window per track, and the normal
    equations there; linearised: are derivatives in these?"""

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
    """The fit's least squares over (scaled parameters, window starts). p: all parameters (SI), of
    which the free ones are replaced; runners: of the tracks, which may keep a simulator's slopes
    from point to point; probe: the last point is not differentiated."""

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

    # where a model runs away, sums of its sensitivities may overflow: that is looked for at the end
    @np.errstate(over="ignore", invalid="ignore")
    def window_sums(
        self, s: Array, starts: tuple[Array, ...], derivatives: bool
    ) -> list[WindowSums] | None:
        """Every window simulated at scaled parameters and window starts; None where the model runs
        away."""
        problem, scale, weights = self.problem, self.scale, self.weights
        k = len(problem.free)
        values = self.p.copy()
        values[list(problem.free)] = scale.outside(s)
        slope, root = scale.slope(values[list(problem.free)]), weights.root
        out: list[WindowSums] = []
        at = 0
        for i, track in enumerate(problem.tracks):
            runner = self.runners[i]
            track_values = runner.parameters(values)
            windows, n = problem.windows(track), runner.start_states
            count, unknowns, cost = len(windows), (k + n) * derivatives, 0.0
            N, v = np.empty((count, unknowns, unknowns)), np.empty((count, unknowns))
            end, ends = np.empty((count, n)), np.empty((count, n, unknowns))
            whole, left = bool(track.seen.all()), np.empty_like(track.y)
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
                # One window that runs away makes the cost infinite, so that the damping rule
                # rejects the step as a whole.
                if not run.fine:
                    return None
                important = 1.0 if problem.importance is None else float(problem.importance[at + w])
                away = left[window.start : window.stop]
                np.subtract(run.Y, track.y[window.start : window.stop], out=away)
                r = (away * root if whole else np.nan_to_num(away * root)).ravel()
                cost += important * float(r @ r)
                end[w] = run.end[:n]
                if derivatives:
                    # rows beyond the unknowns are the padding of the sensitivities
                    A = run.J
                    N[w] = important * (A.T @ A)[:unknowns, :unknowns]
                    v[w] = important * (A.T @ r)[:unknowns]
                    ends[w] = run.S[:, :unknowns]
            # Scaling after the products costs one multiplication per entry of the sums, not one per
            # sample.
            if derivatives:  # by scaled parameters, not by those in SI
                N[:, :k] *= slope[:, None]
                N[:, :, :k] *= slope
                v[:, :k] *= slope
                ends[:, :, :k] *= slope
            at += count
            out.append(WindowSums(cost, N, v, ends, starts[i][1:] - end[:-1], left))
        return out

    @np.errstate(over="ignore", invalid="ignore")
    def assembled(
        self, s: Array, tracks: list[WindowSums] | None, derivatives: bool
    ) -> ShootingNormal:
        """Cost at scaled parameters and window starts, and with derivatives the normal equations,
        of the windows simulated there."""
        problem = self.problem
        cost, H, g = (problem.prior.terms if problem.prior else terms_of_sheet)(s, problem.sheet)
        blocks: list[Blocks] = []
        if tracks is None:
            return ShootingNormal(np.inf, H, g, blocks, [], False)
        residuals = [sums.residuals for sums in tracks]
        fine = True
        for sums, weight in zip(tracks, self.continuity, strict=True):
            cost += sums.cost + float((sums.jumps**2 * weight).sum())
            if derivatives:
                blocks.append(_joined(sums, weight, H, g))
                D, _, B, _ = blocks[-1]
                fine = fine and bool(np.isfinite(B).all() and np.isfinite(D).all())
        fine = fine and bool(np.isfinite(cost) and np.isfinite(H).all())
        return ShootingNormal(cost if fine else np.inf, H, g, blocks, residuals, fine)

    def step(self, at: ShootingPoint, damping: float) -> _ShootingStep:
        """Eliminating the window starts block by block leaves the reduced system of the parameters
        (Schur complement); of these, one at a bound that the gradient would push it through
        stays."""
        H, g, held, parts = reduced(at.normal, at.s, self.scale, damping)
        ds = np.zeros(len(at.s))
        free = np.logical_not(held)
        if free.any():
            A = H[np.ix_(free, free)]
            # lambda counts twice: of the starts' own diagonal in the elimination, and here of the
            # reduced Hessian's, which scales each parameter by what is known of it once the starts
            # follow it
            A = A + damping * np.diag(np.maximum(A.diagonal(), 1e-12))
            ds[free] = -np.linalg.lstsq(A, g[free], rcond=None)[0]
        # the starts belong to the step as the bounds have cut it
        ds = np.clip(at.s + ds, self.scale.low, self.scale.high) - at.s
        return _ShootingStep(ds, [-(x + X @ ds) for X, x, _, _ in parts], H)

    def moved(self, at: ShootingPoint, step: _ShootingStep, last: bool) -> ShootingPoint:
        prior, scale = self.problem.prior, self.scale
        s = np.clip(prior.moved(at.s, step.s), scale.low, scale.high) if prior else at.s + step.s
        starts = tuple(x + d for x, d in zip(at.starts, step.starts, strict=True))
        return self.at(s, starts, not (self.probe and last))

    def settled(self, gain: float, before: ShootingPoint, after: ShootingPoint) -> bool:
        # -2 log posterior: a gain far below 1 is no evidence; of a cost beyond 1000 a share of it
        return gain < self.tolerance * (1.0 + 1e-3 * after.cost)

    def calm(self, step: _ShootingStep, damping: float) -> bool:
        # strong damping makes any step short
        return damping < 1e-2 and float(step.s @ step.H @ step.s) < CALM

    def stuck(self, at: ShootingPoint, step: _ShootingStep) -> bool:
        if float(np.abs(step.s).max(initial=0.0)) < 1e-7:
            return True
        # by slopes that were used again the cost need not fall at all, as near as this to the end
        return any(self.known) and float(step.s @ step.H @ step.s) < CALM

    @property
    def known(self) -> tuple[KnownSlopes | None, ...]:
        """Slopes that are kept, per track."""
        return tuple(runner.known for runner in self.runners)

    def exactly(self, ended: Iteration[ShootingPoint], iterations: int) -> Iteration[ShootingPoint]:
        """Continue a fit that has reused or predicted slopes, with new slopes and all steps made. A
        fit that has used up its steps is only evaluated there."""
        if not any(known and known.counts[1] for known in self.known):
            return ended
        if not ended.settled:
            if not any(known and known.counts[2] for known in self.known):
                return ended
            simulated = self._keeping([k and k.without_prediction() for k in self.known])
            return replace(ended, point=simulated.at(ended.point.s, ended.point.starts))
        exact = self._keeping([k and k.forgotten() for k in self.known])
        point = exact.at(ended.point.s, ended.point.starts)
        restarted = replace(ended, point=point, damping=self.rule.start, calm=0, settled=False)
        if not point.normal.fine:  # a predicted step was wrong
            return restarted
        return iterate(exact, restarted, max(iterations, ended.steps + LAST_STEPS))

    def _keeping(self, known: list[KnownSlopes | None]) -> MultipleShooting:
        """The same with these slopes, per track."""
        pairs = zip(self.runners, known, strict=True)
        return replace(self, runners=tuple(replace(r, known=k) for r, k in pairs))

    def resumed(self, probe: Iteration[ShootingPoint]) -> Fit:
        """The fit to which a probe comes that goes on."""
        full, point = replace(self, probe=False), probe.point
        point = point if point.linearised else full.at(point.s, point.starts)
        ended = iterate(full, replace(probe, point=point), ITERATIONS)
        return full.fit(full.exactly(ended, ITERATIONS))

    def fit(self, ended: Iteration[ShootingPoint]) -> Fit:
        s, starts, now, _ = ended.point
        p, free = self.p.copy(), list(self.problem.free)
        p[free] = self.scale.outside(s)
        result = Fit(
            self.problem,
            p,
            starts,
            self.weights,
            now.cost,
            np.eye(len(free)),
            ended.steps,
            ended.settled,
            "" if ended.settled else "iterations used up",
            self.stepping,
            self.continuity,
        )
        if self.probe:
            return result
        # Laplace's approximation: the inverse of the half Hessian of -2 log posterior, with the
        # starts marginalised (the Schur complement does that)
        H, g, held, _ = reduced(now, s, self.scale, 0.0)
        covariance: Array = np.linalg.pinv(H, hermitian=True).astype(np.float64, copy=False)
        return replace(
            result,
            covariance=covariance,
            residuals=tuple(now.residuals),
            held=np.where(held, g, 0.0),
        )


def begin(
    problem: Problem,
    *,
    p: Array | None = None,
    starts: tuple[Array, ...] | None = None,
    weights: Weights | None = None,
    tolerance: float = TOLERANCE,
    stepping: Stepping | None = None,
    continuity: tuple[Array, ...] = (),
    known: tuple[KnownSlopes | None, ...] = (),
    probe: bool = False,
) -> tuple[MultipleShooting, Iteration[ShootingPoint]]:
    """The least squares of a fit and the point where it begins; arguments as of `fit`."""
    p = problem.start() if p is None else p.copy()
    stepping = stepping or careful_stepping(problem, p)
    weights = weights or Weights(problem.noise, np.ones_like(problem.noise))
    scale = problem.scale
    s = np.clip(scale.inside(p[list(problem.free)]), scale.low, scale.high)
    starts = starts if starts is not None else initial_states(problem, p, weights, stepping)
    none = tuple(np.zeros(len(problem.assembly.rig.states)) for _ in problem.tracks)
    runners = tuple(
        Runner(problem.assembly, track, stepping, problem.free).keeping(known[i] if known else None)
        for i, track in enumerate(problem.tracks)
    )
    shooting = MultipleShooting(
        problem, p, weights, continuity or none, stepping, runners, tolerance, probe
    )
    sums = shooting.window_sums(s, starts, True)
    point = ShootingPoint(s, starts, shooting.assembled(s, sums, True), True)
    if point.normal.fine and not continuity:
        # the factor by which residuals exceed what the sensors' noise explains: by as much more the
        # states of a wrong model may depart from where they were carried to
        off = float(np.exp(-np.log(problem.noise * weights.root).mean()))
        continuity = tuple(
            np.maximum(
                CARRIED_INFORMATION * np.einsum("wii->wi", b[0]).mean(axis=0),
                1.0 / (off * t.jump) ** 2,
            )
            for b, t in zip(point.normal.blocks, problem.tracks, strict=True)
        )
        # the same runs, with another weight of where they end
        shooting = replace(shooting, continuity=continuity)
        point = point._replace(normal=shooting.assembled(s, sums, True))
    return shooting, Iteration(point, shooting.rule.start)


def fit(
    problem: Problem,
    *,
    p: Array | None = None,
    starts: tuple[Array, ...] | None = None,
    weights: Weights | None = None,
    iterations: int = ITERATIONS,
    tolerance: float = TOLERANCE,
    stepping: Stepping | None = None,
    continuity: tuple[Array, ...] = (),
    known: tuple[KnownSlopes | None, ...] = (),
    exact: bool = True,
    progress: Progress | None = None,
    probe: bool = False,
) -> Fit:
    """Levenberg-Marquardt from p (default: `Problem.start`) with fixed weights (default: the sensor
    noise).

    The priors are the problem's, whatever p is. Not converging is an outcome: `converged`, `why`.
    probe: only the cost and the parameters matter; the last step is then not differentiated and has
    no covariance. known: slopes along the same tracks of a rig that is stepped, to begin with; on
    the way they are used again where they hold. exact: it ends with those of its last point; else,
    and as a probe, it hands them on, to a fit that goes on from there.
    """
    shooting, begun = begin(
        problem,
        p=p,
        starts=starts,
        weights=weights,
        tolerance=tolerance,
        stepping=stepping,
        continuity=continuity,
        known=known,
        probe=probe,
    )
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
