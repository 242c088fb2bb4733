"""Screening: a few Gauss-Newton steps per candidate select those worth a refit.

All candidates take the first steps, from each of their starting points. The best of them take
further steps (successive halving: Jamieson and Talwalkar 2016, AISTATS, PMLR 51:240). The gain of a
candidate is the drop of the fit's cost (-2 log posterior) against the baseline. It selects
candidates for a refit; the refitted model is judged on held-out windows.
"""

from __future__ import annotations

import itertools
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import zip_longest

import numpy as np
from scipy.special import chdtri

from pamid.base.arrays import Array
from pamid.base.errors import PamidError
from pamid.diagnosis.candidate_model import (
    CandidateModel,
    known_along,
    set_within_bounds,
    transferred,
    window_starts_from,
)
from pamid.diagnosis.parameter_scan import SCAN_SAMPLES, ScanPart, scanned_values
from pamid.diagnosis.ranges import with_ranges_of
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.engine.damped_gauss_newton import iterate
from pamid.engine.known_slopes import KnownSlopes
from pamid.engine.program import Stepping
from pamid.estimation.frozen_jacobian import FrozenJacobian, begin_chords
from pamid.estimation.grey_box import model_with
from pamid.estimation.multiple_shooting import fit
from pamid.estimation.problem import Fit, Problem, careful_stepping, free_parameters
from pamid.model.assembly import Assembly
from pamid.model.attachment import Addition
from pamid.model.bound_parameter import Sizes
from pamid.model.effect import Hints
from pamid.model.step_rig import StepRig
from pamid.simulation.data_split import DataSplit

CHANCE = 0.05  # significance level of a gain, which by chance is chi-square distributed
ADVANCED = 2  # candidates with further steps per refitted candidate
SCAN_GAIN = 0.1  # share of the cost that an effect must remove before a grid search
# cost ratio above which screening starts from the data-sheet parameters, not from the fitted ones
SHEET_ADVANTAGE = 1.05


@dataclass(frozen=True)
class ScreenedCandidate:
    """A candidate after screening from its best starting point.

    first: starting values (SI) by key; gain: drop of the training cost against the baseline; why:
    reason for a failure; p, starts, stepping: end point of the steps (parameters in SI, states at
    the screened windows per track); rival: the same candidate from another starting point with a
    larger predicted gain; promised: gain predicted by the linear model.
    """

    added: Addition
    assembly: Assembly | None = field(compare=False)
    first: dict[str, float]
    gain: float
    why: str = ""
    p: Array | None = None
    starts: tuple[Array, ...] = ()
    stepping: Stepping | None = None
    rival: ScreenedCandidate | None = None
    promised: float = -np.inf

    @property
    def label(self) -> str:
        return self.added.label

    @property
    def prospect(self) -> float:
        """Gain reached, or the predicted gain of the rival if that is larger."""
        return max(self.gain, self.rival.promised if self.rival else -np.inf)

    @property
    def by_chance(self) -> bool:
        """Whether the gain is insignificant, by a chi-square test over the fitted parameters."""
        count = sum(
            b.fitted and b.owner in self.added.labels
            for b in (self.assembly.parameters if self.assembly else ())
        )
        return self.usable and self.prospect < chdtri(count, CHANCE)

    @property
    def usable(self) -> bool:
        """Whether the model was built and stayed stable."""
        return self.assembly is not None and bool(np.isfinite(self.gain))

    @property
    def ended(self) -> tuple[Assembly, Array]:
        """Model of a usable candidate, and its parameters (SI) after screening."""
        assert self.assembly is not None and self.p is not None
        return self.assembly, self.p


def starting_points(
    assembly: Assembly, added: Addition, hints: Mapping[str, Hints]
) -> tuple[list[dict[str, float]], list[dict[str, float]]]:
    """Return starting values (SI, by key) of a candidate: general ones, and those from hints.

    The general ones are the typical values, no effect, and the variations that parameters declare
    as `tries`. All ports of a candidate have the same values. Without an effect the model is the
    baseline, where the cost falls along the effect's gradient if it helps.
    """
    bounds = {b.key: b for b in assembly.parameters if b.owner in added.labels}
    absent = _absent(assembly, added)
    points = [{}, absent]
    varied: dict[tuple[str, int], dict[str, float]] = {}
    for key, b in bounds.items():
        for k, value in enumerate(b.tries):
            varied.setdefault((key.removeprefix(f"{b.owner}:"), k), {})[key] = value
    points += varied.values()
    hints_per_port = [
        [
            {f"{a.label}:{name}": value for name, value in start.items()}
            for start in a.effect.starts(hints[a.ports[0]])
        ]
        for a in added.members
    ]
    hinted = []
    for starts in zip_longest(*hints_per_port, fillvalue={}):
        first = {key: value for start in starts for key, value in start.items()}
        hinted += [first, absent | first]
    # an effect without a null is never absent, so starting points may coincide
    return _distinct(points), _distinct(hinted)


def _absent(assembly: Assembly, added: Addition) -> dict[str, float]:
    """Return the values (SI, by key) at which the candidate vanishes at all of its ports."""
    return {
        b.key: b.null for b in assembly.parameters if b.owner in added.labels and b.null is not None
    }


def _distinct(points: list[dict[str, float]]) -> list[dict[str, float]]:
    return [point for i, point in enumerate(points) if point not in points[:i]]


@dataclass(frozen=True, eq=False)
class ScreeningBaseline:
    """Reference for screening.

    p: starting parameters (SI) of the candidates; cost: lowest cost of the baseline, from its fit
    or from the data sheet, after as many steps as a candidate takes; held: whether the background
    parameters stay as fitted.

    A gap can drive the fit of the baseline into a local minimum that no effect leaves. The data
    sheet is then the better start. With many candidates the background is held, which makes a step
    several times cheaper.
    """

    baseline: CandidateModel
    p: Array
    cost: float
    held: bool
    settings: Settings

    @classmethod
    def of(
        cls, baseline: CandidateModel, candidates: int = 0, settings: Settings = DEFAULT
    ) -> ScreeningBaseline:
        base_fit = baseline.fit
        # There are many background terms. Holding them saves time, but a candidate then cannot
        # trade off against them.
        held = candidates > settings.held_background_from
        problem, stepping = _with_held(base_fit.problem, held), _screening_stepping(base_fit)
        starts = base_fit.p, problem.assembly.values()
        costs = [
            fit(
                problem,
                replace(base_fit.end, p=p, stepping=stepping),
                iterations=settings.probe_steps + settings.screen_steps,
                probe=True,
            ).cost
            for p in starts
        ]
        p = starts[costs[0] > SHEET_ADVANTAGE * costs[1]]
        return cls(baseline, p, min(costs), held, settings)

    @cached_property
    def stepping(self) -> Stepping:
        return _screening_stepping(self.baseline.fit)

    @cached_property
    def point(self) -> Fit:
        """The baseline's fit where candidates start, of the parameters that screening varies."""
        base_fit = self.baseline.fit
        problem = _with_held(base_fit.problem, self.held)
        return replace(base_fit, problem=problem, p=self.p, stepping=self.stepping)

    @cached_property
    def frozen(self) -> FrozenJacobian | None:
        """Jacobian of the baseline, for chord steps of the candidates.

        None for a stepped rig, which reuses slopes instead (`known`).
        """
        if isinstance(self.baseline.fit.problem.assembly.rig, StepRig):
            return None
        at = self.point
        return FrozenJacobian.of(at.problem, at.p, at.starts, at.weights, at.stepping)

    @cached_property
    def known(self) -> tuple[KnownSlopes | None, ...]:
        """Initial slopes of a simulator's steps, for the candidates."""
        return known_along(self.point, self.stepping)

    def problem(self, evidence: DataSplit, assembly: Assembly) -> Problem:
        tracks = evidence.tracks(assembly)
        problem = Problem(assembly, tracks, free_parameters(assembly, tracks))
        return _with_held(problem, self.held)


def _screening_stepping(base: Fit) -> Stepping:
    """Stepping of the fit; if steps are expensive, the coarsest that the recordings allow."""
    expensive = base.problem.assembly.program.keeps_slopes
    return careful_stepping(base.problem, base.p) if expensive else base.stepping


def _with_held(problem: Problem, held: bool) -> Problem:
    """The problem without its background parameters, if they are held."""
    if not held:
        return problem
    bounds = problem.assembly.parameters
    return replace(problem, free=tuple(i for i in problem.free if not bounds[i].nuisance))


def screen(
    evidence: DataSplit,
    reference: ScreeningBaseline,
    added: Addition,
    sizes: Sizes,
    hints: Mapping[str, Hints],
) -> ScreenedCandidate:
    """Take the first steps of a candidate from every starting point, and return the best."""
    baseline, steps = reference.baseline, reference.settings.probe_steps
    try:
        assembly = model_with(evidence, (*baseline.attached, *added.members), sizes)
        # ranges widened for the baseline stay wide
        assembly = with_ranges_of(assembly, baseline.assembly)
        problem = reference.problem(evidence, assembly)
    except PamidError as error:
        return ScreenedCandidate(added, None, {}, -np.inf, str(error))
    # Start from the baseline's states, unless the baseline measures the sign of a state and the
    # candidate only its magnitude.
    starts = window_starts_from(baseline.fit, assembly).starts
    # A chord step with the baseline's Jacobian needs no derivatives. It is good enough to rank
    # starting points near the baseline.
    by_chords = _Probe(reference, problem, reference.frozen)
    exact = replace(by_chords, frozen=None)
    points, hinted = starting_points(assembly, added, hints)
    points += _scanned_at_null(reference, problem, starts, added)
    # The cost of an effect that acts only beyond a limit has many minima. Few steps or an outdated
    # Jacobian would miss the best, so hinted starts take more steps with exact derivatives.
    exact_steps = steps + reference.settings.screen_steps
    probes = [(start_values, by_chords, steps) for start_values in points]
    probes += [(start_values, exact, exact_steps) for start_values in hinted]
    ends = []
    for start_values, probe, step_count in probes:
        p = transferred(assembly, (baseline.assembly, reference.p))
        set_within_bounds(assembly, p, start_values)
        fitted, predicted = probe(p, starts, step_count, reference.stepping)
        # The baseline's integration steps may be too long for this effect: choose them anew.
        if not np.isfinite(fitted.cost):
            fitted, predicted = probe(p, starts, step_count, None)
        ends.append(_screened(reference, added, start_values, fitted, predicted))
    best = max(ends, key=lambda s: s.gain)
    if not np.isfinite(best.gain):
        return ScreenedCandidate(added, assembly, {}, -np.inf, "unstable at every starting value")
    # An outdated Jacobian may lead away from a better starting point. The point with the largest
    # predicted gain is kept as a rival.
    rival = max(ends, key=lambda s: s.promised)
    better = rival is not best and np.isfinite(rival.gain) and rival.promised > best.gain
    return replace(best, rival=rival if better else None)


def advance(
    evidence: DataSplit, reference: ScreeningBaseline, screened: ScreenedCandidate
) -> ScreenedCandidate:
    """Take further steps with exact derivatives, and keep them if they lower the cost."""
    added, (assembly, _) = screened.added, screened.ended
    exact = _Probe(reference, reference.problem(evidence, assembly), None)
    steps, best = reference.settings.screen_steps, replace(screened, rival=None)
    fits: list[Fit] = []
    for start in (screened, *filter(None, [screened.rival])):
        assert start.p is not None
        exact_fit, cost = exact(start.p, start.starts, steps, start.stepping)
        further = _screened(reference, added, start.first, exact_fit, cost)
        best = further if further.gain > best.gain else best
        fits.append(exact_fit)
    # Scan from the best end point only: a scan costs a run per grid value.
    fitted = min(fits, key=lambda f: f.cost)
    scanned = _scanned_with_effect(reference, added, fitted, exact)
    if scanned is fitted:
        return best
    keys = {b.key: i for i, b in enumerate(assembly.parameters) if b.owner in added.labels}
    first = {key: float(scanned.p[i]) for key, i in keys.items()}
    return _screened(reference, added, first, scanned, scanned.cost)


def _screened(
    reference: ScreeningBaseline,
    added: Addition,
    first: dict[str, float],
    fitted: Fit,
    predicted_cost: float,
) -> ScreenedCandidate:
    return ScreenedCandidate(
        added,
        fitted.problem.assembly,
        first,
        reference.cost - fitted.cost,
        p=fitted.p,
        starts=fitted.starts,
        stepping=fitted.stepping,
        promised=reference.cost - predicted_cost,
    )


def _scanned_at_null(
    reference: ScreeningBaseline,
    problem: Problem,
    starts: tuple[Array, ...] | None,
    added: Addition,
) -> list[dict[str, float]]:
    """Return starting points at the best values of scanned parameters.

    All other parameters of the effect must have a null value, at which the effect vanishes. They
    are linearised there and projected out.
    """
    assembly, base_fit = problem.assembly, reference.baseline.fit
    scanned = _scanned_places(assembly, added)
    if not scanned or starts is None or _has_shape_parameters(problem, added):
        return []
    p = transferred(assembly, (reference.baseline.assembly, reference.p))
    set_within_bounds(assembly, p, _absent(assembly, added))
    whole = ScanPart(problem, p, starts, base_fit.weights, reference.stepping)
    part = replace(whole, most=SCAN_SAMPLES)
    keys = [assembly.parameters[i].key for i in scanned]
    # effects at several joints begin together, each at its best value
    ranked = itertools.zip_longest(*(scanned_values(part, whole, i) for i in scanned))
    return [
        {key: value for key, value in zip(keys, values, strict=True) if value is not None}
        for values in ranked
    ]


def _scanned_places(assembly: Assembly, added: Addition) -> list[int]:
    """Return the places of the candidate's parameters that are scanned."""
    return [
        i
        for i, b in enumerate(assembly.parameters)
        if b.owner in added.labels and b.scan[1] and b.fitted
    ]


def _has_shape_parameters(problem: Problem, added: Addition) -> bool:
    """Whether the candidate has parameters that are neither scanned nor amplitudes. At amplitudes
    of zero they have no influence."""
    free = [problem.assembly.parameters[i] for i in problem.free]
    return any(b.owner in added.labels and b.null is None and not b.scan[1] for b in free)


def _scanned_with_effect(
    reference: ScreeningBaseline, added: Addition, fitted: Fit, probe: _Probe
) -> Fit:
    """Return the fit, or a better fit from another value of a scanned parameter.

    Some scanned parameters have an influence only if the amounts of the effect are not zero, for
    example the ticks of a duty and its pulses. They are scanned only if the effect already reduces
    the cost.
    """
    problem, settings = fitted.problem, reference.settings
    helps = fitted.cost < (1.0 - SCAN_GAIN) * reference.cost
    scanned = _scanned_places(problem.assembly, added)
    if not helps or not _has_shape_parameters(problem, added):
        return fitted
    best = fitted
    part = ScanPart(
        problem,
        fitted.p,
        fitted.starts,
        fitted.weights,
        fitted.stepping,
        SCAN_SAMPLES,
        with_effect=True,
    )
    for i in scanned:
        for value in scanned_values(part, part, i):
            p = fitted.p.copy()
            p[i] = value
            steps = settings.probe_steps + settings.screen_steps
            refitted, _ = probe(p, fitted.starts, steps, fitted.stepping)
            best = refitted if refitted.cost < best.cost else best
    return best


@dataclass(frozen=True)
class _Probe:
    """Fits of a few steps: chord steps with the baseline's Jacobian, or exact steps if `frozen` is
    None."""

    reference: ScreeningBaseline
    problem: Problem
    frozen: FrozenJacobian | None

    def __call__(
        self,
        p: Array,
        starts: tuple[Array, ...] | None,
        steps: int,
        stepping: Stepping | None,
    ) -> tuple[Fit, float]:
        """Take `steps` steps from p (SI) and these window starts. Returns the fit, and the cost
        predicted for a single undamped step."""
        start = window_starts_from(self.reference.baseline.fit, self.problem.assembly)
        start = replace(start, p=p, starts=starts, stepping=stepping)
        if self.frozen is None or starts is None:
            exact_fit = fit(
                self.problem,
                replace(start, known=self.reference.known),
                iterations=steps,
                probe=True,
            )
            return exact_fit, exact_fit.cost
        shooting, begun = begin_chords(
            self.problem,
            self.frozen,
            replace(start, stepping=stepping or careful_stepping(self.problem, p)),
        )
        if not begun.point.normal.fine:
            return shooting.fit(begun), np.inf
        predicted = shooting.predicted_cost(begun.point)
        return shooting.fit(iterate(shooting, begun, steps)), predicted


def by_gain(screened: Iterable[ScreenedCandidate]) -> list[ScreenedCandidate]:
    """Sort by prospect, the largest first, then by name."""
    return sorted(screened, key=lambda s: (-s.prospect, s.label))


def advancing(
    kind_of: Mapping[str, Hashable], screened: list[ScreenedCandidate], reference: ScreeningBaseline
) -> list[ScreenedCandidate]:
    """Return the candidates that take further steps.

    kind_of: kind of a candidate, by label. These are twice as many leaders as are refitted. In the
    first round the best candidate of every other kind is added, whatever its gain: an end stop
    gains only after its steps have found the limit.
    """
    return _leaders(kind_of, screened, reference, ADVANCED, -np.inf)


def promising(
    kind_of: Mapping[str, Hashable], screened: list[ScreenedCandidate], reference: ScreeningBaseline
) -> list[ScreenedCandidate]:
    """Return the candidates to refit: the leaders by gain, and in the first round the best of every
    other kind that gains.

    Over short windows the right kind may gain a hundredth of the largest gain. For example, a
    free pendulum restarts from an estimated state before friction has slowed it.
    """
    return _leaders(kind_of, screened, reference, 1, 0.0)


def _leaders(
    kind_of: Mapping[str, Hashable],
    screened: list[ScreenedCandidate],
    reference: ScreeningBaseline,
    times: int,
    least: float,
) -> list[ScreenedCandidate]:
    """Leaders by gain, and the best of every other kind that gains more than `least`."""
    settings, first_round = reference.settings, not reference.baseline.attached
    usable = by_gain(s for s in screened if s.usable)
    count = times * (settings.refits if first_round else settings.refits_further)
    chosen = usable[:count]
    kinds = {kind_of[s.label] for s in chosen}
    for s in usable[count:] if first_round else []:
        kind = kind_of[s.label]
        if kind not in kinds and s.prospect > least:
            chosen.append(s)
            kinds.add(kind)
    return chosen
