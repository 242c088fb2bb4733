"""What to measure next: the experiment that would set apart the models still in question, found by
simulating it.

The better ranked model of a pair records a virtual experiment without noise; what the other one
leaves of it is taken first as that model was fitted, then re-adjusted as far as the recordings it
was fitted to allow. The re-adjustment can only bring it nearer, so an experiment whose first figure
lies below the best second one is done with.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import DataError
from pamid.diagnosis.contender import Contender
from pamid.diagnosis.proposal import FILE, Proposal
from pamid.diagnosis.tournament import Diagnosis
from pamid.engine.program import Stepping
from pamid.estimation.multiple_shooting import fit, initial_states
from pamid.estimation.problem import Problem
from pamid.estimation.weights import Weights, residual_weights
from pamid.excitation.experiments import MOST_SAMPLES, PASS_S, Bench, Experiment, menu
from pamid.parallel.jobs import Work
from pamid.parallel.store import Plain
from pamid.recording.recording import Recording
from pamid.simulation.data_split import DataSplit
from pamid.simulation.simulate import choose_stepping, known_values, virtual_recording
from pamid.simulation.tracks import Track, track_of
from pamid.simulation.windows import Runner

Array = NDArray[np.float64]

MOST_MODELS = 3
BEYOND = 0.5  # of the recorded span: how far a rig without a loop may leave it
# share of the recorded range, times faster
WAYS = ((1.0, 1), (1.0, 2), (1.0, 4), (0.5, 1), (0.5, 2), (0.25, 1))
STRETCH_S = 10.0  # of every old recording that a re-adjustment looks at
STEPS, CALM = 3, 2e-2  # of a re-adjustment, twice
VISIBLE = 1.0  # noise standard deviations


def next_experiment(d: Diagnosis) -> Proposal | None:
    """The entry of the menu with the largest expected separation per root of its minutes; None
    where no two models are in question or none of the entries can be simulated."""
    pairs = in_question(d)
    if not pairs:
        return None
    bench = bench_of(d.evidence)
    race = []
    for e in menu(bench):
        for way in benches(d.evidence, bench, e, pairs[0][0]):
            ever_nearer = separations(d.evidence, way, e, pairs)
            race.append((next(ever_nearer), ever_nearer, way, e))
    while race:
        k = max(
            range(len(race)),
            key=lambda i: _rms(race[i][0]) / np.sqrt(race[i][3].minutes_on(race[i][2])),
        )
        apart, ever_nearer, way, e = race[k]
        nearer = next(ever_nearer, None)
        if nearer is None:
            return _proposal(d, way, e, pairs, apart) if apart.any() else None
        race[k] = (nearer, ever_nearer, way, e)
    return None


@dataclass(frozen=True, eq=False)
class Proposing(Work[Diagnosis, Proposal | None]):
    """The next experiment after a diagnosis."""

    what = "looking for the next experiment"

    def __call__(self, item: Diagnosis) -> Plain:
        found = next_experiment(item)
        return {} if found is None else vars(found)

    def restored(self, item: Diagnosis, found: Plain) -> Proposal | None:
        return (
            Proposal(
                **{
                    **found,
                    "separates": tuple(found["separates"]),
                    "settings": tuple(found["settings"]),
                }
            )
            if found
            else None
        )

    def name(self, item: Diagnosis) -> str:
        return ""


def in_question(d: Diagnosis) -> list[tuple[Contender, Contender]]:
    """Pairs of models to set apart, the better ranked one first, one model of each family: all that
    are tied against each other, else the chosen one against its nearest rivals."""
    if d.verdict == "no-structural-gap" or d.empty or not d.ranking:
        return []
    best = d.cause or d.ranking[0]
    tied = d.verdict == "ambiguous"
    firsts: dict[str, Contender] = {}
    for c in d.tied if tied else d.ranking:
        firsts.setdefault(c.family, c)
    others = [c for family, c in firsts.items() if family not in (best.family, d.ranking[0].family)]
    models = [best, *others][:MOST_MODELS]
    return [(one, other) for one, other in combinations(models, 2) if tied or one is best]


def bench_of(evidence: DataSplit) -> Bench:
    """The bench that the recordings were made on: its loop or its inputs, their range (2nd to 98th
    percentile)."""
    rig, recordings, model = evidence.rig, evidence.recordings, _like(evidence)
    period = model.sampling_period_s
    recorded = {
        name
        for name in (*recordings[0].columns, *rig.inputs, *rig.outputs)
        if all(r.has(name) for r in recordings)
    }
    held = {q.reference: q.reference if q.reference in recorded else q.reading for q in rig.loops}
    closed = (
        bool(held) and recorded >= set(held.values()) and bool(rig.controller or model.controller)
    )
    sent = [
        n
        for n in rig.inputs
        if n not in rig.optional or n in recorded and n in {q.command for q in rig.loops}
    ]
    driven = {}
    for column, like in held.items() if closed else ((n, n) for n in sent):
        low, high = np.percentile(np.concatenate([r.signal(like) for r in recordings]), [2.0, 98.0])
        driven[column] = (0.5 * float(low + high), 0.5 * float(high - low))
    longest = min(max(len(r) for r in recordings), MOST_SAMPLES) * period
    return Bench(
        rig,
        driven,
        period,
        tuple(q.command for q in rig.loops) if closed else (),
        tuple(n for n in rig.optional if n.startswith("external_")),
        _settings(evidence),
        1.0 if closed else longest / PASS_S,
    )


def _like(evidence: DataSplit) -> Recording:
    """The recording after which an experiment is set up: the first one that was commanded, if
    any."""
    commands = [q.command for q in evidence.rig.loops]
    return next(
        (r for r in evidence.recordings if all(r.has(c) for c in commands)), evidence.recordings[0]
    )


def _settings(evidence: DataSplit) -> dict[str, float]:
    """[known] of an experiment: as before, but nothing that only holds for a test without
    commands."""
    model = _like(evidence)
    return model.known if all(model.has(q.command) for q in evidence.rig.loops) else {}


def benches(evidence: DataSplit, bench: Bench, e: Experiment, model: Contender) -> list[Bench]:
    """The ways to run an experiment: as it is where a loop holds the rig, else those of several
    amplitudes and rates that leave it about where it was recorded."""
    if bench.command:
        return [bench]
    out = []
    for share, passes in WAYS:
        way = replace(
            bench, driven={k: (c, share * h) for k, (c, h) in bench.driven.items()}, passes=passes
        )
        made = [_recorded(evidence, model, way, e.signals(way), s) for s in e.settings(way)]
        if all(r is not None and _stays(evidence, r) for r in made):
            out.append(way)
    return out


def _stays(evidence: DataSplit, made: Recording) -> bool:
    for channel in evidence.channels:
        before = np.concatenate([r.signal(channel) for r in evidence.recordings if r.has(channel)])
        room = BEYOND * float(np.ptp(before))
        now = made.columns[channel]
        if now.min() < before.min() - room or now.max() > before.max() + room:
            return False
    return True


def _recorded(
    evidence: DataSplit,
    c: Contender,
    bench: Bench,
    columns: dict[str, Array],
    setting: dict[str, float],
) -> Recording | None:
    """What the model would record without noise, in its own loop where references are sent; None if
    it blows up."""
    known = {**bench.known, **setting}
    closed = any(q.reference in columns for q in bench.rig.loops)
    samples = len(next(iter(columns.values())))
    excitation = Recording(
        "experiment",
        Path(FILE),
        "",
        bench.period_s * np.arange(samples, dtype=np.float64),
        columns,
        bench.period_s,
        "closed" if closed else "open",
        known=known,
        controller=_controller(evidence) if closed else {},
    )
    model = (
        replace(
            c.assembly,
            controller=tuple(sorted(excitation.controller.items())),
            sensitive=frozenset(),
        )
        if closed
        else c.assembly
    )
    values, places = known_values(model, known)
    p = c.fit.p.copy()
    p[places] = values[places]
    try:
        return replace(
            excitation, columns=virtual_recording(model, excitation, p, noise=0.0, fineness=1)
        )
    except DataError:
        return None


def _controller(evidence: DataSplit) -> dict[str, float]:
    return {**evidence.rig.controller, **_like(evidence).controller}


# ---- how far apart -----------------------------------------------------------------------------


def separations(
    evidence: DataSplit, bench: Bench, e: Experiment, pairs: list[tuple[Contender, Contender]]
) -> Iterator[Array]:
    """RMS difference per channel of the nearest pair, in noise standard deviations: ever smaller
    over all channels together, the last one with all re-adjusted; zeros where a model cannot be
    simulated."""
    made: dict[str, list[Recording | None]] = {}
    views, apart = [], []
    for truth, other in pairs:
        if truth.label not in made:
            made[truth.label] = [
                _recorded(evidence, truth, bench, e.signals(bench), s) for s in e.settings(bench)
            ]
        tracks = tuple(
            track_of(other.assembly, r, evidence.channels, evidence.jump)
            for r in made[truth.label]
            if r is not None
        )
        view = _View(other, evidence.noise, tracks)
        if len(tracks) < len(made[truth.label]) or not view.left:
            yield np.zeros(len(evidence.channels))
            return
        views.append(view)
        apart.append(view.misfit(view.left))
        yield min(apart, key=_rms)
    for k, view in enumerate(views):
        again = view.readjusted()
        apart[k] = min(apart[k], view.misfit(again), key=_rms) if again else apart[k]
        yield min(apart, key=_rms)


def _rms(channels: Array) -> float:
    """All channels together."""
    return float(np.sqrt((channels**2).mean()))


@dataclass(frozen=True, eq=False)
class _View:
    """A model before recordings that another one made."""

    model: Contender
    noise: Array
    tracks: tuple[Track, ...]

    @cached_property
    def stepping(self) -> Stepping:
        a, found = self.model.assembly, [self.model.fit.stepping]
        for t in self.tracks:
            p = Runner(a, t, Stepping()).parameters(self.model.fit.p)
            found.append(choose_stepping(a, t.u, p, t.period_s, a.start(p)))
        return max(found, key=lambda s: (s.implicit, s.substeps))

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
            memory = runner.memory(p)
            pieces = []
            for window, x in zip(self.problem.windows(track), starts, strict=True):
                runner.enter(memory, x)
                Y, _, fine = runner.run(memory, window, p, False)
                if not fine:
                    return ()
                pieces.append(Y - track.y[window.start : window.stop])
            out.append(np.concatenate(pieces))
        return tuple(out)

    def readjusted(self) -> tuple[Array, ...]:
        """What is left after some steps of a fit to the new recordings and a stretch of the old
        ones, which counts as much as all of them."""
        f, known = self.model.fit, self.model.fit.problem.tracks
        old = [t.part(0, min(len(t), round(STRETCH_S / t.period_s))) for t in known]
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
            p=f.p,
            stepping=self.stepping,
            iterations=STEPS,
            tolerance=CALM,
            weights=residual_weights(left, self.noise, problem.window),
        )
        if done.residuals:
            left = done.residuals
            done = fit(
                problem,
                p=done.p,
                starts=done.starts,
                continuity=done.continuity,
                stepping=self.stepping,
                weights=residual_weights(left, self.noise, problem.window),
                iterations=STEPS,
                tolerance=CALM,
            )
        return done.residuals[len(old) :]


def _proposal(
    d: Diagnosis,
    bench: Bench,
    e: Experiment,
    pairs: list[tuple[Contender, Contender]],
    apart: Array,
) -> Proposal:
    names = tuple(dict.fromkeys(c.attached[0].label for pair in pairs for c in pair))
    columns, settings = e.signals(bench), tuple(s for s in e.settings(bench) if s)
    return Proposal(
        e.name,
        _why(d, e, settings, apart),
        names,
        _rms(apart),
        e.minutes_on(bench),
        columns,
        sent_with(d.evidence, bench, columns),
        settings,
    )


def sent_with(evidence: DataSplit, bench: Bench, columns: dict[str, Array]) -> dict[str, Any]:
    """What is stated beside columns sent to a bench: loop, period, rig, what is known and the
    controller's settings."""
    closed = any(q.reference in columns for q in bench.rig.loops)
    meta: dict[str, Any] = {
        "recording": {"loop": "closed" if closed else "open", "sampling_period_s": bench.period_s}
    }
    first = _like(evidence)
    if first.rig is not None:
        meta["recording"]["rig"] = first.rig
    meta |= {"known": bench.known} if bench.known else {}
    return meta | ({"controller": _controller(evidence)} if closed else {})


def _why(d: Diagnosis, e: Experiment, settings: tuple[dict[str, float], ...], apart: Array) -> str:
    """What is sent, what changes between repetitions, and where the models should part."""
    told = [e.why]
    if settings:
        told.append(
            "with "
            + " and then ".join(", ".join(f"{k} = {v:g}" for k, v in s.items()) for s in settings)
        )
    worst = int(np.argmax(apart))
    told.append(
        "simulated on the fitted models, the nearest two differ most in "
        f"{d.evidence.channels[worst]}, by "
        f"{apart[worst]:.2g} times its noise"
    )
    if apart[worst] < VISIBLE:
        told.append("nothing on the menu sets them apart clearly")
    return "; ".join(told)
