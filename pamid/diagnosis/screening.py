"""Screening: a few Gauss-Newton steps per candidate send it on or not. It never decides."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import PamidError
from pamid.diagnosis.contender import Contender, set_within_bounds, transferred
from pamid.diagnosis.starting_hints import Clues
from pamid.engine.program import Stepping
from pamid.estimation.grey_box import model_with
from pamid.estimation.multiple_shooting import fit
from pamid.estimation.problem import Fit, Problem, free_parameters
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment
from pamid.model.bound_parameter import Sizes
from pamid.model.effect import Hints
from pamid.simulation.data_split import DataSplit
from pamid.simulation.tracks import Track
from pamid.simulation.windows import Window

Array = NDArray[np.float64]

# of the fitted recordings, in all: more would change the cost of screening, not its outcome
SCREEN_S = 10.0
LATER_S = 6.0  # ... beside effects that are already found
SLIGHT = 0.1  # of the typical size
FIRST_STEPS, STEPS = 2, 4  # from each of the starting points; from the best of them
MOST = 8  # candidates refitted, beside the best of every further family
LEAST = 6  # candidates refitted in any case
CROWDED = 60  # candidates from which on they are screened with the background held
# with no more candidates than these all are: the runners-up belong into the answer
FEW = 24


@dataclass(frozen=True)
class Screened:
    """A candidate with its best start. gain: drop of the training cost (nats) against the baseline,
    steps taken."""

    attachment: Attachment
    assembly: Assembly | None
    first: dict[str, float]
    gain: float
    why: str = ""


def starting_points(
    assembly: Assembly, attachment: Attachment, hints: Hints
) -> list[tuple[dict[str, float], int]]:
    """Starting values, each with the steps it is given: typical ones, a trace of them, one
    variation per parameter that declares `tries`, and what the effect makes of the hints.

    A trace leaves the model next to the baseline: from there the way leads down wherever an effect
    helps. An effect that asks for hints acts beyond a limit or at one frequency only: a start has
    to settle before it can be judged.
    """
    own = {b.key: b for b in assembly.parameters if b.owner == attachment.label}
    slight = {
        key: b.null + SLIGHT * (b.value - b.null) for key, b in own.items() if b.null is not None
    }
    points = [({}, FIRST_STEPS), (slight, FIRST_STEPS)]
    points += [({key: value}, FIRST_STEPS) for key, b in own.items() for value in b.tries]
    for hinted in attachment.effect.starts(hints):
        first = {f"{attachment.label}:{name}": value for name, value in hinted.items()}
        points += [(first, FIRST_STEPS + STEPS), (slight | first, FIRST_STEPS + STEPS)]
    return points


@dataclass(frozen=True, eq=False)
class Ground:
    """What candidates are screened against: the baseline over the part of every fitted recording
    where it is worst.

    spans: where that part begins and ends, starts: states at its windows, per track; p: parameters
    from which the baseline does best there, its own or the data sheet's (a gap can drive a fit into
    a corner that no effect leads out of); cost: the baseline's, after as many steps as a candidate
    is given; held: is the background kept as it was fitted? Among many candidates it is, which
    makes a step several times as cheap.
    """

    baseline: Contender
    spans: tuple[tuple[int, int], ...]
    starts: tuple[Array, ...]
    p: Array
    cost: float
    held: bool

    @classmethod
    def of(cls, baseline: Contender, candidates: int = 0) -> Ground:
        problem, base = baseline.fit.problem, baseline.fit
        share = (LATER_S if baseline.attached else SCREEN_S) / sum(
            len(t) * t.period_s for t in problem.tracks
        )
        spans, starts = [], []
        for track, x, r in zip(problem.tracks, base.starts, base.residuals, strict=True):
            windows = problem.windows(track)
            losses = np.array(
                [np.nansum((r[w.start : w.stop] * base.weights.root) ** 2) for w in windows]
            )
            first, last = _worst_run(
                problem, track, windows, losses, max(3, round(share * len(windows)))
            )
            spans.append((windows[first].start, windows[last].stop))
            starts.append(x[first : last + 1])
        held = candidates > CROWDED
        short = replace(
            problem,
            tracks=tuple(t.part(*s) for t, s in zip(problem.tracks, spans, strict=True)),
            free=_free(problem.assembly, problem.free, held),
        )
        sheet = problem.assembly.values()
        costs = [
            fit(
                short,
                p=p,
                starts=tuple(starts),
                weights=base.weights,
                continuity=base.continuity,
                stepping=base.stepping,
                iterations=FIRST_STEPS + STEPS,
                probe=True,
            ).cost
            for p in (base.p, sheet)
        ]
        p = base.p if costs[0] <= 1.05 * costs[1] else sheet
        return cls(baseline, tuple(spans), tuple(starts), p, min(costs), held)

    def problem(self, evidence: DataSplit, assembly: Assembly) -> Problem:
        tracks = tuple(
            t.part(*s) for t, s in zip(evidence.tracks(assembly), self.spans, strict=True)
        )
        return Problem(
            assembly, tracks, _free(assembly, free_parameters(assembly, tracks), self.held)
        )


def _free(assembly: Assembly, places: tuple[int, ...], held: bool) -> tuple[int, ...]:
    """Of these parameters those that a screening moves."""
    return tuple(i for i in places if not held or not assembly.parameters[i].nuisance)


def _worst_run(
    problem: Problem, track: Track, windows: list[Window], losses: Array, few: int
) -> tuple[int, int]:
    """First and last of the `few` (or somewhat more) windows in a row with the largest loss. A part
    has to be cut as the whole was; where none is, it is the whole."""
    for count in range(min(few, len(windows)), len(windows)):
        for first in np.argsort(-np.convolve(losses, np.ones(count), "valid"), kind="stable"):
            last = int(first) + count - 1
            if len(problem.windows(track.part(windows[first].start, windows[last].stop))) == count:
                return int(first), last
    return 0, len(windows) - 1


def screen(
    evidence: DataSplit, ground: Ground, attachment: Attachment, sizes: Sizes, clues: Clues
) -> Screened:
    """Gain of one candidate after a few steps from each of its starting points and some more from
    the best of them."""
    baseline = ground.baseline
    try:
        assembly = model_with(evidence, (*baseline.attached, attachment), sizes)
        problem = ground.problem(evidence, assembly)
    except PamidError as error:
        return Screened(attachment, None, {}, -np.inf, str(error))
    unstable = Screened(attachment, assembly, {}, -np.inf, "unstable at every starting value")
    best, found = unstable, None
    for first, steps in starting_points(assembly, attachment, clues.at(attachment.ports[0])):
        p = transferred(assembly, (baseline.assembly, ground.p))
        set_within_bounds(assembly, p, first)
        done = _probed(ground, problem, p, ground.starts, steps, baseline.fit.stepping)
        # the baseline's integration steps are too long for this effect
        if not np.isfinite(done.cost):
            done = _probed(ground, problem, p, ground.starts, steps, None)
        if ground.cost - done.cost > best.gain:
            best, found = Screened(attachment, assembly, first, ground.cost - done.cost), done
    if found is None:
        return unstable
    done = _probed(ground, problem, found.p, found.starts, STEPS, found.stepping)
    return replace(best, gain=max(best.gain, ground.cost - done.cost))


def _probed(
    ground: Ground,
    problem: Problem,
    p: Array,
    starts: tuple[Array, ...],
    steps: int,
    stepping: Stepping | None,
) -> Fit:
    base = ground.baseline.fit
    return fit(
        problem,
        p=p,
        starts=starts,
        weights=base.weights,
        continuity=base.continuity,
        iterations=steps,
        probe=True,
        stepping=stepping,
    )


def sent_on(
    rig_family: dict[str, str], screened: list[Screened], most: int, crowded: bool = False
) -> list[Screened]:
    """The most promising ones, all of few: up to `most` by gain, where these are many those that
    gain at least a tenth of the first and six in any case; and the best of every further family
    that gains a fifth of the first."""
    usable = sorted(
        (s for s in screened if s.assembly is not None and np.isfinite(s.gain)),
        key=lambda s: (-s.gain, s.attachment.label),
    )
    if not usable or (most >= MOST and len(usable) <= FEW and not crowded):
        return usable
    top = usable[0].gain
    kept = [s for i, s in enumerate(usable[:most]) if i < LEAST or s.gain > 0.1 * top]
    families = {rig_family[s.attachment.label] for s in kept}
    for s in usable if most >= MOST else []:
        family = rig_family[s.attachment.label]
        if family not in families and s.gain > max(1.0, 0.2 * top):
            kept.append(s)
            families.add(family)
    return kept
