"""The next experiment: that which best discriminates between the models still tied.

For a pair (i, j) model i simulates the experiment without noise; the separation is the rms residual
of model j in noise standard deviations, after j was re-adjusted to it as far as the recordings that
it was fitted to allow (T-optimality, Atkinson and Fedorov 1975, Biometrika 62:57):

    T(e) = min over pairs, min_p ||y_i(e) - y_j(e; p)|| / sigma

Without re-adjustment the residual is an upper bound of T. Experiments are therefore taken in order
of that bound, and the search ends when a re-adjusted experiment exceeds the bounds of all others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.metrics import rms
from pamid.base.parallel.jobs import Work
from pamid.base.schemas.diagnosis_file import INSEPARABLE, WITHHELD, NextExperiment
from pamid.base.share_words import times_text
from pamid.diagnosis.candidate_model import CandidateModel
from pamid.diagnosis.comparison import families_of
from pamid.diagnosis.pipeline import Diagnosis
from pamid.diagnosis.planning.experiment_ways import (
    NEXT_FILES,
    Predictions,
    Way,
    carried,
    carried_texts,
    controller_of,
    drifts,
    led_away,
    predicted_text,
    reference_recording,
    ways_to_run,
)
from pamid.engine.program import Stepping
from pamid.estimation.multiple_shooting import fit, initial_states
from pamid.estimation.problem import FitStart, Problem, careful_stepping, most_careful
from pamid.estimation.weights import Weights, residual_weights
from pamid.recording.recording import write_recording
from pamid.simulation.data_split import DataSplit
from pamid.simulation.excitation.experiments import (
    MOST_EXPERIMENT_SAMPLES,
    PASS_S,
    Bench,
    commanded,
    menu,
)
from pamid.simulation.rig_data import data_of
from pamid.simulation.tracks import Track, track_of
from pamid.simulation.windows import Runner

COMPARED_MODELS = 3  # that an experiment is to set apart, at most
RECORDED_TAIL = 2.0  # per cent of the samples at either end of what was recorded: spikes
# re-adjustment to an experiment: correlation times of every old recording that it looks at,
# Gauss-Newton steps of either fit, share of the cost that ends them
OLD_STRETCH, ADJUSTING_STEPS, ADJUSTING_TOLERANCE = 16.0, 3, 0.02
VISIBLE_SEPARATION = 1.0  # standard deviations of the noise: less is no clear separation


@dataclass(frozen=True)
class Proposal:
    """An experiment to make. columns, meta: its excitation, as `write_recording` takes it."""

    experiment: NextExperiment
    columns: dict[str, Array] = field(repr=False)
    meta: dict[str, Any] = field(repr=False)

    def write(self, claim: Callable[..., list[Path]]) -> None:
        """Write the excitation once per setting, each with the TOML next to it; claim: where those
        of these names go (`Run.claim`)."""
        period_s = float(self.meta["recording"]["sampling_period_s"])
        time = period_s * np.arange(len(next(iter(self.columns.values()))), dtype=np.float64)
        settings = self.experiment.settings or ({},)
        for name, setting in zip(self.experiment.excitations, settings, strict=True):
            known = {**self.meta.get("known", {}), **setting}
            meta = {**self.meta, "known": known} if known else self.meta
            path, _ = claim(name, str(Path(name).with_suffix(".toml")))
            write_recording(path, time, self.columns, meta)


@dataclass(frozen=True)
class WithheldExperiment:
    """No experiment. why: a note for the reader."""

    why: str


def next_experiment(d: Diagnosis) -> Proposal | WithheldExperiment | None:
    """The entry of the menu with the largest expected separation per root of its minutes; None
    where no two models are in question or none of the entries can be simulated, and why there is
    none where the recordings have decided or each would lead the rig beyond them."""
    pairs = pairs_to_separate(d)
    if not pairs:
        return _decided(d)
    bench, predictions = bench_of(d.evidence), Predictions(d.evidence)
    models = models_to_keep(d, pairs)
    ways = ways_to_run(predictions, bench, menu(bench), models)
    if not ways:
        return _withheld(d, predictions, bench, models)
    for truth, _ in pairs:
        predictions.of_all(truth, ways)
    race = []
    for way in ways:
        bounds = separations(predictions, way, pairs)
        race.append((next(bounds), bounds, way))
    # best first (branch and bound): the leader's bound is tightened until another leads, or
    # until it has no tighter bound and is its value; then no other can exceed it
    while race:
        k = max(
            range(len(race)),
            key=lambda i: rms(race[i][0]) / np.sqrt(race[i][2].minutes),
        )
        separation, bounds, way = race[k]
        tighter = next(bounds, None)
        if tighter is None:
            if not separation.any():
                return None
            return _proposal(d, predictions, way, pairs, separation)
        race[k] = (tighter, bounds, way)
    return None


@dataclass(frozen=True, eq=False)
class Proposing(Work[Diagnosis, Proposal | WithheldExperiment | None]):
    """The next experiment after a diagnosis."""

    what = "looking for the next experiment"

    def __call__(self, item: Diagnosis) -> Proposal | WithheldExperiment | None:
        return next_experiment(item)

    def name(self, item: Diagnosis) -> str:
        return ""


def pairs_to_separate(d: Diagnosis) -> list[tuple[CandidateModel, CandidateModel]]:
    """Pairs of models to discriminate, the better ranked first, a model of each family: every
    pair of those that are tied, else the chosen model and each of its nearest rivals. Of causes
    only the rivals that tie with them: the others are decided."""
    ranking = [c for c in d.ranking if c.label not in d.set_aside]
    if d.verdict == "no-structural-gap" or d.silent or d.answer is None or not ranking:
        return []
    best = d.cause or ranking[0]
    tied = d.verdict == "ambiguous"
    firsts: dict[str, CandidateModel] = {}
    for c in [c.model for c in d.answer.causes] if tied else ranking:
        firsts.setdefault(c.family, c)
    # of a single cause, rivals of its family and of the leading model are no alternatives
    known = {best.family} if tied else {best.family, ranking[0].family}
    others = [
        c
        for family, c in firsts.items()
        if family not in known and (d.cause is None or tied or d.comparison.is_tied(c, best))
    ]
    models = [best, *others][:COMPARED_MODELS]
    return [(model, other) for model, other in combinations(models, 2) if tied or model is best]


def models_to_keep(
    d: Diagnosis, pairs: list[tuple[CandidateModel, CandidateModel]]
) -> list[CandidateModel]:
    """Models by which an experiment is to leave the rig where it was recorded: those in question,
    the best first, and the refitted model alone."""
    models = {c.label: c for pair in pairs for c in pair}
    return [*models.values(), d.budget.baseline]


def _decided(d: Diagnosis) -> WithheldExperiment | None:
    """Why nothing is proposed where there are causes and no other family ties with them."""
    if d.cause is None or d.silent:
        return None
    families = families_of(d.cause)
    others = [c for c in d.ranking if not families_of(c) & families and c.label not in d.set_aside]
    behind = (
        f" (the nearest, {others[0].label}, is "
        f"{times_text(d.comparison.removed(d.cause, others[0]).z)} standard errors behind)"
        if others
        else ""
    )
    remains = (
        "no candidate explains the remainder"
        if d.left_over
        else "the remainder is not a material share of the gap"
    )
    return WithheldExperiment(
        f"{WITHHELD}: no other family ties with {d.cause.label}{behind}, and {remains}."
    )


def _withheld(
    d: Diagnosis, predictions: Predictions, bench: Bench, models: list[CandidateModel]
) -> WithheldExperiment | None:
    """Why nothing is proposed: what the mildest way of an entry would do."""
    reasons = ((e.name, led_away(predictions, bench, e, models)) for e in menu(bench))
    name, away = next(((n, text) for n, text in reasons if text), ("", ""))
    if not away:
        return None
    return WithheldExperiment(
        f"{WITHHELD}: in open loop, each experiment would drive the rig beyond the "
        f"recorded range, {name} even at its smallest amplitude ({away}). Record an experiment in "
        "a position loop, or between stops that the rig may touch."
    )


def bench_of(evidence: DataSplit) -> Bench:
    """The bench that the recordings were made on: its loop or its inputs, their range but
    for its tails."""
    rig, recordings, model = evidence.rig, evidence.recordings, reference_recording(evidence)
    period = model.sampling_period_s
    recorded = set.intersection(*(set(r.values) for r in recordings))
    held = {q.reference: q.reference if q.reference in recorded else q.reading for q in rig.loops}
    closed = (
        bool(held) and recorded >= set(held.values()) and bool(rig.controller or model.controller)
    )
    driven = {}
    for column, like in held.items() if closed else ((n, n) for n in sent_inputs(evidence)):
        values = np.concatenate([r.shown(like) for r in recordings])
        low, high = np.percentile(values, [RECORDED_TAIL, 100.0 - RECORDED_TAIL])
        driven[column] = (0.5 * float(low + high), 0.5 * float(high - low))
    # as before, but nothing that only holds for a test without commands
    known = model.known if all(q.command in model.values for q in rig.loops) else {}
    longest = min(max(len(r) for r in recordings), MOST_EXPERIMENT_SAMPLES) * period
    bench = Bench(
        rig,
        driven,
        period,
        tuple(q.command for q in rig.loops) if closed else (),
        tuple(n for n in rig.optional if n.startswith("external_")),
        known,
        1.0 if closed else longest / PASS_S,
    )
    return replace(bench, carried=carried(evidence, bench))


def sent_inputs(evidence: DataSplit) -> list[str]:
    """Inputs that an experiment without a loop sends: those that are commanded, and those of a loop
    that were recorded. Not those that only drift, unless nothing else is left."""
    rig = evidence.rig
    commands = {*commanded(rig), *(q.command for q in rig.loops)}
    sent = [
        n for n in rig.inputs if n in commands and all(n in r.values for r in evidence.recordings)
    ]
    return [n for n in sent if not drifts(evidence, n)] or sent


# ---- separation ---------------------------------------------------------------------------------


def separations(
    predictions: Predictions, way: Way, pairs: list[tuple[CandidateModel, CandidateModel]]
) -> Iterator[Array]:
    """Ever tighter upper bounds of what separates the nearest pair: RMS difference per channel, in
    noise standard deviations. First pair after pair as fitted, then in sequence
    re-adjusted; the last bound is the separation. Zeros where a model cannot be simulated."""
    rivals, separation, evidence = [], [], predictions.evidence
    for truth, other in pairs:
        recordings = predictions.of(truth, way)
        tracks = tuple(
            track_of(
                other.assembly,
                data_of(evidence.rig, r),
                evidence.channels,
                evidence.jump,
                evidence.timescale_s,
            )
            for r in recordings
            if r is not None
        )
        rival = _RivalModel(other, evidence.noise, tracks)
        if len(tracks) < len(recordings) or not rival.left:
            yield np.zeros(len(evidence.channels))
            return
        rivals.append(rival)
        separation.append(rival.misfit(rival.left))
        yield min(separation, key=rms)
    for k, rival in enumerate(rivals):
        again = rival.readjusted()
        separation[k] = min(separation[k], rival.misfit(again), key=rms) if again else separation[k]
        yield min(separation, key=rms)


@dataclass(frozen=True, eq=False)
class _RivalModel:
    """A model held against recordings that another model made."""

    model: CandidateModel
    noise: Array
    tracks: tuple[Track, ...]

    @cached_property
    def stepping(self) -> Stepping:
        f = self.model.fit
        return most_careful([f.stepping, careful_stepping(self.problem, f.p)])

    @cached_property
    def problem(self) -> Problem:
        """The new recordings alone; the background stays as it was fitted."""
        bounds, f = self.model.assembly.parameters, self.model.fit
        return Problem(
            self.model.assembly,
            self.tracks,
            tuple(i for i in f.problem.free if not bounds[i].nuisance),
        )

    def misfit(self, left: tuple[Array, ...]) -> Array:
        """RMS per channel of residuals (samples x channels), in noise standard deviations."""
        return np.asarray(np.sqrt((np.concatenate(left) ** 2).mean(axis=0)) / self.noise)

    @cached_property
    def left(self) -> tuple[Array, ...]:
        """Model less recording, as the model was fitted, every window from the start that suits it
        best; () if it blows up."""
        c = self.model
        out: list[Array] = []
        alone = Weights(self.noise, np.ones_like(self.noise))
        every = initial_states(self.problem, c.fit.p, alone, self.stepping)
        for track, starts in zip(self.tracks, every, strict=True):
            runner = Runner(c.assembly, track, self.stepping)
            p = runner.parameters(c.fit.p)
            windows = self.problem.windows(track)
            runs = list(runner.run_windows(runner.memory(p), windows, starts, p, False))
            if not all(run.fine for run in runs):
                return ()
            out.append(np.concatenate([run.Y for run in runs]) - track.y)
        return tuple(out)

    def readjusted(self) -> tuple[Array, ...]:
        """Residual after some steps of a fit to the new recordings and a stretch of the old ones,
        which has the weight of all of them."""
        f, known = self.model.fit, self.model.fit.problem.tracks
        longest = OLD_STRETCH * known[0].timescale_s
        old = [t.part(0, min(len(t), round(longest / t.period_s))) for t in known]
        share = sum(map(len, known)) / sum(map(len, old))
        problem = replace(self.problem, tracks=(*old, *self.tracks))
        counts = [
            np.full(len(problem.windows(t)), share if k < len(old) else 1.0)
            for k, t in enumerate(problem.tracks)
        ]
        problem = replace(problem, importance=np.concatenate(counts))
        left = self.left
        done = fit(
            problem,
            FitStart(
                p=f.p,
                weights=residual_weights(left, self.noise, problem.window),
                stepping=self.stepping,
            ),
            iterations=ADJUSTING_STEPS,
            tolerance=ADJUSTING_TOLERANCE,
            exact=False,
        )
        if done.residuals:
            left = done.residuals
            done = fit(
                problem,
                replace(
                    done.end,
                    weights=residual_weights(left, self.noise, problem.window),
                    stepping=self.stepping,
                    known=done.known,
                ),
                iterations=ADJUSTING_STEPS,
                tolerance=ADJUSTING_TOLERANCE,
            )
        return done.residuals[len(old) :]


def _proposal(
    d: Diagnosis,
    predictions: Predictions,
    way: Way,
    pairs: list[tuple[CandidateModel, CandidateModel]],
    separation: Array,
) -> Proposal:
    bench, columns, settings = way.bench, way.columns, tuple(s for s in way.settings if s)
    models = models_to_keep(d, pairs)
    predicted = "" if bench.command else predicted_text(predictions, way, models)
    # the excitation, the changes between repetitions, and where the models should differ
    repeated = " and then ".join(", ".join(f"{k} = {v:g}" for k, v in s.items()) for s in settings)
    worst = int(np.argmax(separation))
    why = [
        way.experiment.reason(d.evidence.rig),
        f"with {repeated}" if settings else "",
        "simulated on the fitted models, the nearest two differ most in "
        f"{d.evidence.channels[worst]}, by {times_text(separation[worst])} times its noise",
        "" if separation[worst] >= VISIBLE_SEPARATION else INSEPARABLE,
    ]
    files = NEXT_FILES[: max(len(settings), 1)]
    experiment = NextExperiment(
        name=way.experiment.name,
        why="; ".join(filter(None, why)),
        separates=tuple(dict.fromkeys(c.attached[0].label for pair in pairs for c in pair)),
        expected_separation=rms(separation),
        minutes=way.minutes,
        excitation=files[0],
        excitations=files,
        settings=settings,
        cautions=tuple(filter(None, (*carried_texts(bench), predicted))),
    )
    return Proposal(experiment, columns, sent_with(d.evidence, bench, columns))


def sent_with(evidence: DataSplit, bench: Bench, columns: dict[str, Array]) -> dict[str, Any]:
    """Settings stated with columns for a bench: loop, period, rig, known values and the
    controller's settings."""
    closed = any(q.reference in columns for q in bench.rig.loops)
    meta: dict[str, Any] = {
        "recording": {"loop": "closed" if closed else "open", "sampling_period_s": bench.period_s}
    }
    first = reference_recording(evidence)
    if first.rig is not None:
        meta["recording"]["rig"] = first.rig
    meta |= {"known": bench.known} if bench.known else {}
    return meta | ({"controller": controller_of(evidence)} if closed else {})
