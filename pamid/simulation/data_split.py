"""Which samples may be used for what: parameters are fitted on one part, effects chosen on a
second, figures given on a third that neither has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import DataError, FileError
from pamid.base.metrics import motion, seen_mean
from pamid.model.assembly import Assembly
from pamid.model.between_samples import as_recorded
from pamid.model.rig import Rig
from pamid.model.sampling import as_sampled
from pamid.recording.noise import noise_level
from pamid.recording.overlap import require_apart
from pamid.recording.recording import Recording
from pamid.simulation.correlation_time import timescale_of
from pamid.simulation.error_growth import growth_time_s
from pamid.simulation.free_runs import free_run, known_values, state_spread
from pamid.simulation.idle_background import IdleTerm, without_idle_terms
from pamid.simulation.replay import Replay
from pamid.simulation.rig_data import Data, data_of
from pamid.simulation.tracks import Track, noise_of, stated_noise, track_of

Array = NDArray[np.float64]
# samples of an independent stretch: of a window on which a model is judged
STRETCH_SAMPLES = 20
FEWEST_FITTED, FEWEST_HELD_OUT = 7, 3  # stretches, over all recordings together
# samples of a recording that alone gives both; a shorter one is fitted or held out as a whole
FEWEST_SAMPLES = STRETCH_SAMPLES * (FEWEST_FITTED + FEWEST_HELD_OUT)
# tenths of a recording that are held out: its last three, or, where a part of it rests, three that
# have what was fitted before and after them, the first where a motion that dies away is still large
LAST_TENTHS, SPREAD_TENTHS = (7, 8, 9), (1, 4, 7)
# a part in which all that is sent or measured moves by less than this share of its motion in the
# rest tells next to nothing: the end of a step response, a swing that has died away
QUIET = 0.25
# correlation times before a held-out part, to find the state it begins in; a model with memories
# that no time makes forget comes from the beginning of the recording
LEAD = 10.0
# correlation times of the windows that a fit is cut into, and of the shortest that are replayed
FIT_WINDOW, REPLAY_WINDOW = 2.5, 1.7
FEW_WINDOWS, LEAST_WINDOWS = 12, 6  # wanted where the envelope counts, and to fit in any case
DEALS = 64  # ways tried to deal held-out windows out to choosing and reporting
ALIKE_DIGITS = 9  # decimals to which recordings and ways of dealing are compared
VISIBLE = 3.0  # times its noise: a signal that moves
# of the first half's motion: the rest in the second half of a motion that dies away
DECAYED = 0.5
# of a state's spread: possible error of a model in an unmeasured state, per window
STATE_JUMP = 0.01
STRETCHES = 3  # of the fitted part of a long recording, and of the held-out part
# correlation times of a stretch at least: 8 windows of a fit; 16 windows of full length to judge by
LEAST_FITTED, LEAST_HELD_OUT = 20.0, 61.0


@dataclass(frozen=True)
class Span:
    """Samples start..stop of a recording."""

    recording: Data
    start: int
    stop: int

    def __len__(self) -> int:
        return self.stop - self.start

    @property
    def seconds(self) -> float:
        return len(self) * self.recording.sampling_period_s


@dataclass(frozen=True)
class DataSplit:
    """Recordings of one rig, divided into a fitted and a held-out part.

    channels: outputs that are both fitted and held out somewhere and that move in one of the
    recordings; noise: their white noise (SI); jump: possible deviation of the rig's states from
    their prediction by the window before (SI); timescale_s: correlation time, limited by the length
    of the recordings and by the growth of state errors, the unit of every horizon; correlation_s:
    the correlation time without these limits, the unit of effects' times.
    """

    rig: Rig
    fit: tuple[Span, ...]
    held_out: tuple[Span, ...]
    channels: tuple[str, ...]
    noise: Array
    jump: Array
    timescale_s: float
    correlation_s: float
    lead_most: float = np.inf  # correlation times before a held-out part, for models with memories
    per_run: int = 1  # held-out windows that a model predicts from one estimated state
    left_out: tuple[IdleTerm, ...] = ()  # background terms that the fitted recordings leave open
    doubts: tuple[str, ...] = ()  # sentences: faults of the recordings that a fit may take up

    def tracks(self, assembly: Assembly, held_out: bool = False) -> tuple[Track, ...]:
        """Tracks for this assembly; known parameters of a recording are held in each. A held-out
        part is led in by samples before it, from which its state is found."""
        tracks, role = list[Track](), self.held_out if held_out else self.fit
        samples = sum(map(len, role))
        for span in role:
            lead = min(span.start, self._lead(assembly, span)) if held_out else 0
            first = span.start - lead
            p, known = known_values(assembly, span.recording.known)
            track = Track(
                span.recording.name,
                *self._tables(assembly, span.recording, first, span.stop),
                p,
                tuple(known),
                span.recording.sampling_period_s,
                self.jump,
                self.timescale_s,
                first,
                lead,
                len(span) / samples,
            )
            tracks.append(track)
        return tuple(tracks)

    def _tables(
        self, assembly: Assembly, recording: Data, start: int, stop: int
    ) -> tuple[Array, Array]:
        """Inputs and channels (SI) of a part of a recording. Models with the same inputs share
        them: they are most of the memory of many models."""
        inputs = (assembly.traced.inputs, *assembly.rig.optional.items())
        key = id(recording), start, stop, inputs
        if key not in self._samples:
            # of a slice: nothing of the rest of a long recording is held with it
            part = recording.slice(start, stop)
            self._samples[key] = part.inputs(assembly), part.outputs(self.channels)
        return self._samples[key]

    @cached_property
    def _samples(self) -> dict[tuple[object, ...], tuple[Array, Array]]:
        return {}

    def excerpt(self, fitted: float, held_out: float) -> DataSplit:
        """The same with evenly spread stretches of long recordings.

        The cost of a search among models then does not grow with the recordings. Every sample of a
        stretch counts fully: gradients, covariances and errors are consistent, those of a shorter
        recording. Thinned rows of a Jacobian would save a quarter of a step at most, because
        sensitivities are a recursion over all samples. Their J'r is the gradient of the full cost
        only for smooth residuals, and those of a correct model are not smooth.

        Parameters
        ----------
        fitted, held_out
            Correlation times that are fitted and held out in all, at most.
        """
        held = _stretches(self.held_out, held_out, LEAST_HELD_OUT, self.timescale_s)
        return replace(
            self,
            fit=_stretches(self.fit, fitted, LEAST_FITTED, self.timescale_s),
            held_out=held,
            lead_most=np.inf if held is self.held_out else fitted / STRETCHES,
        )

    @property
    def used_s(self) -> tuple[float, float]:
        """Duration of what is fitted and held out together, and of all recordings (s)."""
        spans = (*self.fit, *self.held_out)
        used = sum(s.seconds for s in spans)
        return used, sum(len(r) * r.sampling_period_s for r in self.recordings)

    def _lead(self, assembly: Assembly, span: Span) -> int:
        """Samples before a held-out part through which a model is led."""
        samples = self.timescale_s / span.recording.sampling_period_s
        if assembly.keeps_memories:
            return int(min(span.start, self.lead_most * samples))
        return round(LEAD * samples)

    @cached_property
    def still_inputs(self) -> frozenset[str]:
        """Inputs of the rig that are 0 in all recordings; an optional one that is missing counts
        with its default."""
        plain = Assembly(self.rig)
        moved = np.zeros(len(plain.traced.inputs), bool)
        for recording in self.recordings:
            moved |= (recording.inputs(plain) != 0.0).any(axis=0)
        return frozenset(
            name for name, moves in zip(plain.traced.inputs, moved, strict=True) if not moves
        )

    def lacking(self, recording: Data) -> list[str]:
        """Channels that other recordings have and this one has not."""
        return [c for c in self.channels if c not in recording.values]

    @property
    def held_out_rests(self) -> bool:
        """Whether everything held out hardly moves compared with the fitted part."""
        moved = [(_motion(self.held_out, c), _motion(self.fit, c)) for c in self.channels]
        return all(held < QUIET * fitted for held, fitted in moved)

    @property
    def whole_held_out(self) -> bool:
        """Whether the held-out recordings are others than the fitted ones."""
        return not {id(s.recording) for s in self.fit} & {id(s.recording) for s in self.held_out}

    @property
    def spread(self) -> list[Data]:
        """Recordings of which tenths spread over them are held out, not their end."""
        last = {id(s.recording): s.stop for s in self.held_out}
        return [r for r in self.recordings if last.get(id(r), len(r)) < len(r)]

    @property
    def recordings(self) -> list[Data]:
        return list({id(s.recording): s.recording for s in (*self.fit, *self.held_out)}.values())


def split_recordings(rig: Rig, recordings: list[Recording], held_out: list[Recording]) -> DataSplit:
    """Divide the recordings; without `held_out` the last 30 % of every recording is held out, or
    three tenths spread over it where that part, or all but that part, hardly moves. Of episodes
    shorter than `FEWEST_SAMPLES` three of ten are held out as a whole.

    DataError where the recordings cannot answer: too short in all, nothing moves, or two hold the
    same samples. An input or a channel may rest, as long as another one moves.
    """
    raw = [*recordings, *held_out]
    rig = as_sampled(as_recorded(rig, raw), [r.sampling_period_s for r in raw])
    plain = Assembly(rig)
    require_apart(tuple(rig.outputs), recordings, held_out)
    everything = [data_of(rig, r) for r in raw]
    chosen, apart = everything[: len(recordings)], everything[len(recordings) :]
    seen = {id(r): r.measured(rig) for r in everything}
    channels = tuple(
        c
        for c in rig.outputs
        if all(any(c in seen[id(r)] for r in role) for role in (chosen, apart or chosen))
    )
    if not channels:
        raise FileError(
            "no measured output is both fitted and held out",
            f"rig {rig.name!r} offers {', '.join(rig.outputs)}",
        )
    for r in everything:
        if not any(c in seen[id(r)] for c in channels):
            raise FileError(
                f"{r.path} holds nothing that is both fitted and held out: {', '.join(channels)}",
                "leave it out, or hold out a recording that has the same sensors",
            )
    moving: set[str] = set()
    for r in everything:
        moving |= require_informative(rig, r)
    channels = tuple(c for c in channels if c in moving)
    # names and order must not matter, a sum depends on its order in the last digit
    place = {id(r): _place(rig, r) for r in everything}
    if apart:
        fit = [Span(r, 0, len(r)) for r in chosen]
        held = [Span(r, 0, len(r)) for r in apart]
    else:
        fit, held = list[Span](), list[Span]()
        chosen.sort(key=lambda r: place[id(r)])
        for recording in chosen:
            if len(recording) >= FEWEST_SAMPLES:
                fitted, held_out_part = _parts(rig, recording)
                fit += fitted
                held += held_out_part
        # a third of a short episode would be no window
        episodes = [Span(r, 0, len(r)) for r in chosen if len(r) < FEWEST_SAMPLES]
        for number, episode in enumerate(episodes):
            (held if number % 10 in SPREAD_TENTHS else fit).append(episode)
    few = shortfall(list(map(len, fit)), list(map(len, held)))
    if few:
        raise DataError(
            f"{', '.join(str(r.path) for r in everything)}: {few}",
            "Record longer or add recordings: they are fitted together. At a sampling period of "
            "3 ms, 20 s or more are recommended.",
        )
    by_content = sorted(everything, key=lambda r: place[id(r)])

    def in_order(spans: list[Span]) -> tuple[Span, ...]:
        return tuple(sorted(spans, key=lambda s: (*place[id(s.recording)], s.start)))

    stated = stated_noise(rig, channels)
    # these tracks need no time scale: it is computed from them
    whole = [track_of(plain, r, channels, timescale_s=1.0) for r in by_content]
    noise = np.sqrt(seen_mean(np.stack([noise_of((t,), stated) ** 2 for t in whole])))
    spreads = np.stack([state_spread(plain, r) for r in by_content])
    known = np.isfinite(spreads)
    count = known.sum(axis=0)
    squares = (np.where(known, spreads, 0.0) ** 2).sum(axis=0) / np.maximum(count, 1)
    jump = STATE_JUMP * np.where(count, np.sqrt(squares), np.inf)
    tables = [(t.y, noise, t.period_s) for t in whole]
    # at most what leaves enough windows to fit; as far as it is that of the envelope, of either
    # part
    fitted_s, held_s = (sum(s.seconds for s in part) for part in (fit, held))
    ringing_s = min(fitted_s / FIT_WINDOW, held_s / REPLAY_WINDOW) / FEW_WINDOWS
    timescale_s = rig.timescale_s or timescale_of(
        tables, fitted_s / FIT_WINDOW / LEAST_WINDOWS, ringing_s
    )
    growth_s = growth_time_s(
        Assembly(rig, outputs=channels), whole, noise, FIT_WINDOW * timescale_s
    )
    rig, left_out = without_idle_terms(rig, [s.recording.slice(s.start, s.stop) for s in fit])
    return DataSplit(
        rig,
        in_order(fit),
        in_order(held),
        channels,
        noise,
        jump,
        min(timescale_s, growth_s / FIT_WINDOW),
        rig.timescale_s or max(timescale_s, timescale_of(tables, most_ringing_s=0.0)),
        left_out=left_out,
    )


def shortfall(fit: Sequence[int], held_out: Sequence[int]) -> str:
    """Return why these numbers of samples, one per span, are too few to fit a model and to judge
    it; empty where they are enough. What counts is the number of independent stretches over all
    recordings."""
    roles = (fit, FEWEST_FITTED), (held_out, FEWEST_HELD_OUT)
    if all(sum(n // STRETCH_SAMPLES for n in spans) >= fewest for spans, fewest in roles):
        return ""
    fitted, judged = (sum(spans) for spans, _ in roles)
    return (
        f"{fitted} fitted and {judged} held-out samples are too few to fit and judge a model. At "
        f"least {FEWEST_FITTED * STRETCH_SAMPLES} and {FEWEST_HELD_OUT * STRETCH_SAMPLES} are "
        f"needed, in stretches of {STRETCH_SAMPLES} or more"
    )


def shortfall_alone(recording: Recording) -> str:
    """Return why a recording is too short to be fitted and judged without another one; empty where
    it is not."""
    return shortfall([len(recording)], []) if len(recording) < FEWEST_SAMPLES else ""


def _parts(rig: Rig, recording: Data) -> tuple[list[Span], list[Span]]:
    """Fitted and held-out spans of a recording."""
    edges = [round(k / 10 * len(recording)) for k in range(11)]
    names = [name for name in (*rig.inputs, *rig.outputs) if name in recording.values]
    table = np.stack([recording.values[name] for name in names], axis=1)
    moving = table.std(axis=0) > VISIBLE * noise_level(table)
    edge = edges[LAST_TENTHS[0]]
    before, after = table[:edge, moving].std(axis=0), table[edge:, moving].std(axis=0)
    # every moving signal rests in one part, compared with the other
    rests = moving.any() and ((after < QUIET * before).all() or (before < QUIET * after).all())
    held = SPREAD_TENTHS if rests else LAST_TENTHS
    parts: dict[bool, list[Span]] = {False: [], True: []}
    for is_held, tenths in groupby(range(10), held.__contains__):
        tenth_spans = list(tenths)
        parts[is_held].append(Span(recording, edges[tenth_spans[0]], edges[tenth_spans[-1] + 1]))
    return parts[False], parts[True]


def _stretches(
    spans: tuple[Span, ...], most: float, least: float, timescale_s: float
) -> tuple[Span, ...]:
    """Stretches of these spans, evenly spread, of so many correlation times at most in all and at
    least each; a span that would not give such a one stays whole."""
    times = [s.seconds / timescale_s for s in spans]
    share = most / sum(times)
    if share >= 1.0:
        return spans
    stretches: list[Span] = []
    for s, long in zip(spans, times, strict=True):
        number = min(STRETCHES, int(share * long / least))
        if number == 0:
            stretches.append(s)
            continue
        length = int(share * len(s)) // number
        for first in np.linspace(s.start, s.stop - length, number).astype(int).tolist():
            stretches.append(Span(s.recording, first, first + length))
    return tuple(stretches)


def _motion(spans: Sequence[Span], channel: str) -> float:
    """Standard deviation of a channel (SI), root mean square over the spans that have it."""
    recorded = [s for s in spans if channel in s.recording.values]
    parts = [s.recording.values[channel][s.start : s.stop] for s in recorded]
    count = sum(map(len, parts))
    return float(np.sqrt(sum(len(y) * y.var() for y in parts) / count)) if count else 0.0


def _place(rig: Rig, recording: Data) -> tuple[float, str]:
    """Sort key of a recording: the times of largest motion, summed over the rig's columns. It does
    not depend on units and signs, on the order of the columns, nor on an unused one."""
    total = 0.0
    for name in sorted({*rig.inputs, *rig.outputs}):
        if (values := recording.values.get(name)) is not None:
            moved = (values - values.mean()) ** 2
            most = float(moved.max())
            if most > 0.0:
                moved = moved / most
                total += float(np.linspace(0.0, 1.0, len(moved)) @ moved / moved.sum())
    return round(total, ALIKE_DIGITS), recording.sha256


def require_informative(rig: Rig, recording: Data) -> set[str]:
    """The outputs that change in this recording. DataError where nothing in it can teach: no output
    changes; or no input does while the outputs go on moving, which neither they nor the data
    sheet's run explain."""
    inputs = [n for n in rig.inputs if n in recording.values]
    moving, still = _moving(recording, [n for n in rig.outputs if n in recording.values])
    if not moving and still is not None:
        raise still
    sent, resting = _moving(recording, inputs)
    needed = [name for name in inputs if name not in rig.optional]
    if (
        needed
        and not sent
        and resting is not None
        and not _shows_free_response(rig, recording, sorted(moving))
    ):
        raise resting
    return moving


def _moving(recording: Data, names: list[str]) -> tuple[set[str], DataError | None]:
    """Those of these signals that change, and the error of the first that does not."""
    moving, still = set(), None
    for name in names:
        if motion(recording.values[name]) > 0.0:
            moving.add(name)
        else:
            still = still or DataError(
                f"{recording.path}: {name} is constant ({recording.shown(name)[0]:g}) throughout.",
                "Record while it moves; `pamid generate-aprbs` makes an excitation that covers the "
                "range.",
                code="not-excited",
            )
    return moving, still


def _shows_free_response(rig: Rig, recording: Data, channels: list[str]) -> bool:
    """Nothing being sent, does what moves come to rest, or does the data sheet's run move as
    well?"""
    assembly = Assembly(rig)
    half = len(recording) // 2
    y = recording.outputs(channels)
    noise = noise_level(y)
    early, late = y[:half].std(axis=0), y[half:].std(axis=0)
    if not (early > VISIBLE * noise).any():
        return False
    if (late < np.maximum(DECAYED * early, VISIBLE * noise)).all():
        return True
    p, _ = known_values(assembly, recording.known)
    run = free_run(assembly, recording.inputs(assembly), p, recording.sampling_period_s)
    places = [assembly.program.outputs.index(c) for c in channels]
    moves = run.outputs[half:, places].std(axis=0)
    return run.blown_up < 0 and bool((moves > VISIBLE * noise).any())


def half_of_windows(replays: list[Replay], losses: Array) -> NDArray[np.bool_]:
    """One half of the held-out windows (True): either half reports of what the other would choose.
    losses: of the model without effects, one per window.

    Pairs of neighbouring windows go to either half together. Of many divisions into halves of one
    size, the one whose halves hold most nearly the same error and the same largest error. A
    transient in one half alone would make one of the choices blind to it. What the effects do plays
    no part.
    """
    count = sum(len(r.windows) for r in replays)
    # both parts are spread over everything held out, so that neither is of other conditions; in
    # pairs, as the bootstrap draws windows in runs of two
    run = 2 if count >= 12 else 1
    blocks = np.arange(count) // run
    alternating = blocks % 2 == 0
    many = blocks[-1] + 1 if count else 0
    if many < 4:
        return alternating
    random = np.random.default_rng(0)
    dealt = [alternating]
    for _ in range(DEALS):
        first = np.zeros(many, bool)
        # one of every two neighbouring blocks: both halves stay spread over the recordings
        for k in range(0, many - 1, 2):
            first[k + random.integers(2)] = True
        if many % 2:
            first[-1] = True
        dealt.append(first[blocks])

    def imbalance(chosen: NDArray[np.bool_]) -> float:
        first, other = losses[chosen], losses[~chosen]
        error, largest = np.log(first.mean() / other.mean()), np.log(first.max() / other.max())
        return float(abs(error) + 0.5 * abs(largest))

    # swapped halves are as balanced as before: the first dealt, whatever unit the last digit is in
    return min(dealt, key=lambda chosen: round(imbalance(chosen), ALIKE_DIGITS))
