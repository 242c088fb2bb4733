"""Screening: a few Gauss-Newton steps per candidate select those worth a refit.

All candidates take the first steps, from each of their starting points. Those that can still be
refitted take further ones (successive halving: Jamieson and Talwalkar 2016, AISTATS, PMLR 51:240).
A candidate's gain is the drop of the fit's cost (negative log posterior, nats) over the part of the
recordings where the baseline is worst, against the baseline after as many steps. It only selects
the refits, and the refit on held-out windows decides.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import zip_longest
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

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
from pamid.diagnosis.starting_hints import GapHints
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
from pamid.model.step_rig import StepRig
from pamid.simulation.data_split import DataSplit
from pamid.simulation.tracks import Track
from pamid.simulation.windows import Window

Array = NDArray[np.float64]

CHANCE = 0.05  # probability of a gain by chance, which is distributed as chi square
FEWEST_SCREENED = 3  # windows of every recording
# typical sizes: an effect is also started as a trace of itself, next to the baseline, where the
# cost falls wherever the effect helps
TRACE = 0.1
ADVANCED = 2  # times as many candidates as are refitted take the further steps
SCAN_GAIN = 0.1  # share of the cost that pulses remove before their shape is scanned
# cost ratio to the data sheet's parameters, from which on a baseline is screened from these
SHEET_ADVANTAGE = 1.05


@dataclass(frozen=True)
class ScreenedCandidate:
    """A candidate with its best start.

    gain: drop of the training cost (nats) against the baseline after these steps; p, starts,
    stepping: their end (parameters in SI, states at the windows screened per track); rival: the
    candidate from another start with a larger promise; promised: the gain that the linear model
    predicts.
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
    def prospect(self) -> float:
        """Gain that further steps may reach, by the linear model."""
        return max(self.gain, self.rival.promised if self.rival else -np.inf)

    @property
    def by_chance(self) -> bool:
        """Whether as many parameters gain as much in one of twenty cases by chance."""
        count = sum(
            b.fitted and b.owner in self.added.labels
            for b in (self.assembly.parameters if self.assembly else ())
        )
        return self.usable and self.prospect < chdtri(count, CHANCE)

    @property
    def usable(self) -> bool:
        """Whether it stayed stable."""
        return self.assembly is not None and bool(np.isfinite(self.gain))

    @property
    def ended(self) -> tuple[Assembly, Array]:
        """Its model, and the parameters (SI) to which screening has led: of a usable one."""
        assert self.assembly is not None and self.p is not None
        return self.assembly, self.p


def starting_points(
    assembly: Assembly, added: Addition, hints: GapHints
) -> tuple[list[dict[str, float]], list[dict[str, float]]]:
    """Starting values: typical ones, a trace of them, and one variation per parameter that declares
    `tries`; then those that the effect makes of the hints. At several ports all begin alike.

    A trace leaves the model next to the baseline, where the cost falls along the effect's gradient
    wherever the effect helps.
    """
    bounds = {b.key: b for b in assembly.parameters if b.owner in added.labels}
    slight = {
        key: b.null + TRACE * (b.value - b.null) for key, b in bounds.items() if b.null is not None
    }
    points = [{}, slight]
    varied: dict[tuple[str, int], dict[str, float]] = {}
    for key, b in bounds.items():
        for k, value in enumerate(b.tries):
            varied.setdefault((key.removeprefix(f"{b.owner}:"), k), {})[key] = value
    points += varied.values()
    started = [
        [
            {f"{a.label}:{name}": value for name, value in start.items()}
            for start in a.effect.starts(hints.at(a.ports[0]))
        ]
        for a in added.members
    ]
    hinted = []
    for starts in zip_longest(*started, fillvalue={}):
        first = {key: value for start in starts for key, value in start.items()}
        hinted += [first, slight | first]
    # of an effect without a null its trace is itself
    return _distinct(points), _distinct(hinted)


def _distinct(points: list[dict[str, float]]) -> list[dict[str, float]]:
    return [point for i, point in enumerate(points) if point not in points[:i]]


@dataclass(frozen=True, eq=False)
class ScreeningBaseline:
    """Reference for screening: the baseline over the part of every fitted recording where it fits
    worst.

    spans: begin and end of that part, per track; starts: states at its windows, per track; p:
    parameters from which the baseline does best there, its own or the data sheet's (a gap can drive
    a fit into a corner that no effect leads out of); cost: the baseline's, after as many steps as a
    candidate takes; held: whether the background stays as fitted. Among many candidates it does,
    which makes a step several times as cheap.
    """

    baseline: CandidateModel
    spans: tuple[tuple[int, int], ...]
    starts: tuple[Array, ...]
    p: Array
    cost: float
    held: bool
    settings: Settings

    @classmethod
    def of(
        cls, baseline: CandidateModel, candidates: int = 0, settings: Settings = DEFAULT
    ) -> ScreeningBaseline:
        problem, base = baseline.fit.problem, baseline.fit
        length = settings.screen_further if baseline.attached else settings.screen_length
        share = (
            length
            * problem.tracks[0].timescale_s
            / sum(len(t) * t.period_s for t in problem.tracks)
        )
        spans, starts = [], []
        for track, x, r in zip(problem.tracks, base.starts, base.residuals, strict=True):
            # Where the baseline fits worst the missing effect acts most, and a part is much
            # cheaper than the whole.
            windows = problem.windows(track)
            losses = np.array(
                [np.nansum((r[w.start : w.stop] * base.weights.root) ** 2) for w in windows]
            )
            first, last = _worst_run(
                problem,
                track,
                windows,
                losses,
                max(FEWEST_SCREENED, round(share * len(windows))),
            )
            spans.append((windows[first].start, windows[last].stop))
            starts.append(x[first : last + 1])
        # Background terms are many. Held at their fit they cost nothing, at the price that a
        # candidate cannot trade with them.
        held = candidates > settings.held_background_from
        short = _short(problem, tuple(spans), held)
        sheet, stepping = problem.assembly.values(), _screened_by(base)
        costs = [
            fit(
                short,
                p=p,
                starts=tuple(starts),
                weights=base.weights,
                continuity=base.continuity,
                stepping=stepping,
                iterations=settings.probe_steps + settings.screen_steps,
                probe=True,
            ).cost
            for p in (base.p, sheet)
        ]
        p = base.p if costs[0] <= SHEET_ADVANTAGE * costs[1] else sheet
        return cls(baseline, tuple(spans), tuple(starts), p, min(costs), held, settings)

    @cached_property
    def stepping(self) -> Stepping:
        return _screened_by(self.baseline.fit)

    @cached_property
    def frozen(self) -> FrozenJacobian | None:
        """The baseline's Jacobian along these parts, for chord steps of the candidates; None of a
        rig that is stepped, whose slopes are reused (`known`)."""
        base = self.baseline.fit
        if isinstance(base.problem.assembly.rig, StepRig):
            return None
        short = _short(base.problem, self.spans, self.held)
        return FrozenJacobian.of(short, self.p, self.starts, base.weights, self.stepping)

    @cached_property
    def known(self) -> tuple[KnownSlopes | None, ...]:
        """Slopes of a simulator's steps along these parts, as a start for the candidates."""
        base = self.baseline.fit
        return known_along(
            replace(
                base,
                problem=_short(base.problem, self.spans, self.held),
                p=self.p,
                starts=self.starts,
            ),
            self.stepping,
        )

    def extended_model(self, evidence: DataSplit, added: Addition, sizes: Sizes) -> Assembly:
        """The baseline with a candidate; ranges widened for the baseline stay wide."""
        assembly = model_with(evidence, (*self.baseline.attached, *added.members), sizes)
        return with_ranges_of(assembly, self.baseline.assembly)

    def problem(self, evidence: DataSplit, assembly: Assembly) -> Problem:
        tracks = tuple(
            t.part(*s) for t, s in zip(evidence.tracks(assembly), self.spans, strict=True)
        )
        return Problem(
            assembly, tracks, _free(assembly, free_parameters(assembly, tracks), self.held)
        )


def _screened_by(base: Fit) -> Stepping:
    """The stepping of the fit; where a step is expensive no finer one than the recordings need."""
    expensive = base.problem.assembly.program.keeps_slopes
    return careful_stepping(base.problem, base.p) if expensive else base.stepping


def _short(problem: Problem, spans: tuple[tuple[int, int], ...], held: bool) -> Problem:
    """The fit's problem over these parts of its tracks."""
    return replace(
        problem,
        tracks=tuple(t.part(*s) for t, s in zip(problem.tracks, spans, strict=True)),
        free=_free(problem.assembly, problem.free, held),
    )


def _free(assembly: Assembly, places: tuple[int, ...], held: bool) -> tuple[int, ...]:
    """Those of these parameters that a screening moves."""
    return tuple(i for i in places if not held or not assembly.parameters[i].nuisance)


def _worst_run(
    problem: Problem, track: Track, windows: list[Window], losses: Array, few: int
) -> tuple[int, int]:
    """First and last of the `few` (or somewhat more) windows in a row with the largest loss, such
    that this part alone is cut into the same windows; all windows where there is none."""
    for count in range(min(few, len(windows)), len(windows)):
        # sums of the loss over every run of so many windows, the largest first
        for first in np.argsort(-np.convolve(losses, np.ones(count), "valid"), kind="stable"):
            last = int(first) + count - 1
            if len(problem.windows(track.part(windows[first].start, windows[last].stop))) == count:
                return int(first), last
    return 0, len(windows) - 1


def screen(
    evidence: DataSplit,
    reference: ScreeningBaseline,
    added: Addition,
    sizes: Sizes,
    hints: GapHints,
) -> ScreenedCandidate:
    """Gain of one candidate after the first steps from the best of its starting points."""
    baseline, steps = reference.baseline, reference.settings.probe_steps
    try:
        assembly = reference.extended_model(evidence, added, sizes)
        problem = reference.problem(evidence, assembly)
    except PamidError as error:
        return ScreenedCandidate(added, None, {}, -np.inf, str(error))
    # The baseline's states fit its own error. They are the best guess where the candidate reads
    # states the same way.
    starts = window_starts_from(baseline.fit, assembly).starts and reference.starts
    # A chord step with the baseline's Jacobian needs no derivatives. It is good enough to rank
    # starting points near the baseline.
    by_chords = _Probe(reference, problem, reference.frozen)
    exact = replace(by_chords, frozen=None)
    points, hinted = starting_points(assembly, added, hints)
    points += _scanned_at_null(reference, evidence, problem, starts, added)
    # an effect beyond a limit has many minima, which few steps or outdated derivatives miss
    more = steps + reference.settings.screen_steps
    probes = [(first, by_chords, steps) for first in points]
    probes += [(first, exact, more) for first in hinted]
    ends = []
    for first, probing, count in probes:
        p = transferred(assembly, (baseline.assembly, reference.p))
        set_within_bounds(assembly, p, first)
        probed = probing(p, starts, count, reference.stepping)
        # the baseline's integration steps are too long for this effect
        if not np.isfinite(probed.fit.cost):
            probed = probing(p, starts, count, None)
        ends.append(_screened(reference, added, first, *probed))
    best = max(ends, key=lambda s: s.gain)
    if not np.isfinite(best.gain):
        return ScreenedCandidate(added, assembly, {}, -np.inf, "unstable at every starting value")
    # an outdated Jacobian may lead away from the better starting point, of which it promises most
    rival = max(ends, key=lambda s: s.promised)
    better = rival is not best and np.isfinite(rival.gain) and rival.promised > best.gain
    return replace(best, rival=rival if better else None)


def advance(
    evidence: DataSplit, reference: ScreeningBaseline, screened: ScreenedCandidate
) -> ScreenedCandidate:
    """A candidate after further steps with exact derivatives, where they lower its cost."""
    added, (assembly, _) = screened.added, screened.ended
    exact = _Probe(reference, reference.problem(evidence, assembly), None)
    steps, best = reference.settings.screen_steps, replace(screened, rival=None)
    fits: list[Fit] = []
    for start in (screened, *filter(None, [screened.rival])):
        assert start.p is not None
        exact_fit = exact(start.p, start.starts, steps, start.stepping)
        further = _screened(reference, added, start.first, *exact_fit)
        best = further if further.gain > best.gain else best
        fits.append(exact_fit.fit)
    # A scan starts at the best end only: each scan costs as many runs as its grid has values.
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
    evidence: DataSplit,
    problem: Problem,
    starts: tuple[Array, ...] | None,
    added: Addition,
) -> list[dict[str, float]]:
    """Starting points at the best values of parameters that are scanned where all else of the
    effect is amounts, which are projected out as they are at their null."""
    assembly, base = problem.assembly, reference.baseline.fit
    wanted = _wanted(assembly, added)
    if not wanted or starts is None or _shaping(problem, added):
        return []
    tracks = evidence.tracks(assembly)
    p = transferred(assembly, (reference.baseline.assembly, reference.p))
    part = ScanPart(problem, p, starts, base.weights, reference.stepping, SCAN_SAMPLES)
    all_of_it = Problem(assembly, tracks, problem.free)
    fitted = transferred(assembly, (reference.baseline.assembly, base.p))
    whole = ScanPart(all_of_it, fitted, base.starts, base.weights, reference.stepping)
    return [
        {assembly.parameters[i].key: value}
        for i in wanted
        for value in scanned_values(part, whole, i)
    ]


def _wanted(assembly: Assembly, added: Addition) -> list[int]:
    """Places of the candidate's parameters that are scanned."""
    return [
        i
        for i, b in enumerate(assembly.parameters)
        if b.owner in added.labels and b.scan[1] and b.fitted
    ]


def _shaping(problem: Problem, added: Addition) -> bool:
    """Whether the candidate has further parameters that are not amounts, which have no influence at
    the null of these."""
    free = [problem.assembly.parameters[i] for i in problem.free]
    return any(b.owner in added.labels and b.null is None and not b.scan[1] for b in free)


def _scanned_with_effect(
    reference: ScreeningBaseline, added: Addition, fitted: Fit, probe: _Probe
) -> Fit:
    """The fit, or a better one from another value of a scanned parameter.

    For a parameter that shows only together with the effect's other amounts, such as the ticks of a
    duty with its pulses. Only where these amounts reduce the cost.
    """
    problem, settings = fitted.problem, reference.settings
    helps = fitted.cost < (1.0 - SCAN_GAIN) * reference.cost
    wanted = _wanted(problem.assembly, added)
    if not helps or not _shaping(problem, added):
        return fitted
    best = fitted
    for i in wanted:
        where = ScanPart(
            problem,
            fitted.p,
            fitted.starts,
            fitted.weights,
            fitted.stepping,
            SCAN_SAMPLES,
            with_effect=True,
        )
        for value in scanned_values(where, where, i):
            p = fitted.p.copy()
            p[i] = value
            steps = settings.probe_steps + settings.screen_steps
            done = probe(p, fitted.starts, steps, fitted.stepping).fit
            best = done if done.cost < best.cost else best
    return best


class _Probed(NamedTuple):
    """A fit of a few steps, and the cost that one undamped step from its start was expected to
    reach."""

    fit: Fit
    predicted_cost: float


@dataclass(frozen=True)
class _Probe:
    """Fits of a few steps each: chord steps with the baseline's Jacobian, or exact ones where
    `frozen` is None."""

    reference: ScreeningBaseline
    problem: Problem
    frozen: FrozenJacobian | None

    def __call__(
        self,
        p: Array,
        starts: tuple[Array, ...] | None,
        steps: int,
        stepping: Stepping | None,
    ) -> _Probed:
        """So many steps from p (SI) and these window starts."""
        base = self.reference.baseline.fit
        continuity = window_starts_from(base, self.problem.assembly).continuity
        if self.frozen is None or starts is None:
            exact = fit(
                self.problem,
                p=p,
                starts=starts,
                weights=base.weights,
                continuity=continuity,
                known=self.reference.known,
                iterations=steps,
                probe=True,
                stepping=stepping,
            )
            return _Probed(exact, exact.cost)
        shooting, begun = begin_chords(
            self.problem,
            self.frozen,
            p=p,
            starts=starts,
            weights=base.weights,
            continuity=continuity,
            stepping=stepping or careful_stepping(self.problem, p),
        )
        if not begun.point.normal.fine:
            return _Probed(shooting.fit(begun), np.inf)
        predicted = shooting.predicted_cost(begun.point)
        return _Probed(shooting.fit(iterate(shooting, begun, steps)), predicted)


def by_gain(screened: Iterable[ScreenedCandidate]) -> list[ScreenedCandidate]:
    """The largest gain, or the prospect of it, first; among equal ones by name."""
    return sorted(screened, key=lambda s: (-s.prospect, s.added.label))


def advancing(
    family_of: dict[str, str], screened: list[ScreenedCandidate], reference: ScreeningBaseline
) -> list[ScreenedCandidate]:
    """Return the candidates that take further steps: twice as many leaders as are refitted and, on
    top of the baseline, the best of every further family.

    The family counts whatever its first steps gained: an end stop shows its gain only once its
    steps have found the limit.
    """
    return _leaders(family_of, screened, reference, ADVANCED, -np.inf)


def promising(
    family_of: dict[str, str], screened: list[ScreenedCandidate], reference: ScreeningBaseline
) -> list[ScreenedCandidate]:
    """Return the candidates to refit: the leaders by gain and, on top of the baseline, the best of
    every further family that helps.

    Over the short windows of a screen the gain of the right family may be a hundredth of the
    largest: a free pendulum restarts from an estimated state before friction has slowed it.
    """
    return _leaders(family_of, screened, reference, 1, 0.0)


def _leaders(
    family_of: dict[str, str],
    screened: list[ScreenedCandidate],
    reference: ScreeningBaseline,
    times: int,
    least: float,
) -> list[ScreenedCandidate]:
    """The first by gain, and the best of every further family that gains more than `least`."""
    settings, first_round = reference.settings, not reference.baseline.attached
    usable = by_gain(s for s in screened if s.usable)
    count = times * (settings.refits if first_round else settings.refits_further)
    chosen = usable[:count]
    families = {family_of[s.added.label] for s in chosen}
    for s in usable[count:] if first_round else []:
        family = family_of[s.added.label]
        if family not in families and s.prospect > least:
            chosen.append(s)
            families.add(family)
    return chosen
