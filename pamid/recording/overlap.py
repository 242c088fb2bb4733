"""Samples that stand in two recordings: a copy, whatever its name, the order and unit of its
columns, the digits it was printed with or an offset and a scale, or a stretch that two files share.

Found by content alone, as copies of text are (Manber 1994, USENIX Winter Conference; Schleimer,
Wilkerson and Aiken 2003, SIGMOD). Every measured signal is read as a sequence of (level, dwell).
Words of 2^DOUBLINGS successive ones are hashed, those with hash = 0 mod WORD_STRIDE are looked up
in all recordings at once, so that the same words are chosen wherever a copy begins; each pair of
places that share SHARED_WORDS words is then compared sample by sample. Samples at rest do not
count. Noise never repeats itself, so that the same experiment made twice on a real rig is no copy;
simulated twice without noise it is a copy.

A copy with another offset, scale or sign shares no level, but the signs of its noise. Those of the
differences are hashed in the same way, and the recordings are then compared after a straight line
has been fitted to the first over the second. Only channels that show noise or a step can prove such
a copy: without them the response to a doubled input is a scaled copy, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.errors import DataError
from pamid.base.metrics import motion, runs_of
from pamid.base.units import size_to_si, split_column, to_si
from pamid.recording.noise import MAY_BE_NOISE, is_white, noise_level, quantisation_step
from pamid.recording.recording import Recording, match_column

Places = NDArray[np.int64]
Words = tuple[NDArray[np.uint64], Places]  # hashes that are looked up, and where each begins

# steps of print to a level; odd, so that no number of the coarser print lies between two levels
STEPS_PER_LEVEL = (63, 15, 3, 1)
FEWEST_LEVELS = 100  # that a signal should visit at least, for its words to distinguish places
DOUBLINGS = 3  # a word is 8 dwells
WORD_STRIDE = 8  # of so many words a single word is looked up, chosen by its hash
SHARED_WORDS = 3  # words that two places must share to be compared
SHIFTS = 4  # ways to lay a recording upon another that are compared
# samples at which something moves, alike in both, that two experiments do not share ...
TELLING_SAMPLES = 100
# times as many, where the files differ before or after although both go on: a coarse converter
BROKEN = 10
PRINTED = 300  # values whose digits are looked at
CONVERSION_TOLERANCE = 1e-12  # of a value: conversion between units
DIFFERENCE_ORDER = 4  # of the differences whose signs are hashed: motion leaves little in them
SIGN_DOUBLINGS = 6  # a word is the signs of 64 differences
NO_SIGN = 0.01  # of the noise: smaller differences are 0
MOST_ZEROS = 0.75  # of a word's differences: a channel at rest shows nothing
LINE_SAMPLES = 64  # of a block to which a straight line is fitted
# of the noise: root mean square of what a copy differs by, around every sample. Two independent
# readings differ by sqrt(2), and a rounding that falls out differently once in a block by 0.4
COPY_SHARE = 0.25
MIX = np.uint64(0x9E3779B97F4A7C15)


@dataclass(frozen=True)
class Overlap:
    """So many samples of recording `first` from its sample `start` on are those of recording
    `second` from `again`; rescaled: apart from an offset or a scale."""

    first: int
    second: int
    start: int
    again: int
    samples: int
    rescaled: bool = False


@dataclass(frozen=True, eq=False)
class _Signal:
    values: Array  # SI
    step: float  # of its print at its largest values, SI

    @cached_property
    def noise(self) -> float:
        """Its white noise, at least that of its step, SI."""
        return float(noise_level(self.values[:, None])[0])

    @cached_property
    def shows_noise(self) -> bool:
        """Does it show noise or a step, which no other recording has?"""
        return self.noise > MAY_BE_NOISE * float(self.values.std()) and (
            quantisation_step(self.values) > 0.0 or is_white(self.values)
        )


def require_apart(
    outputs: Sequence[str], fitted: Sequence[Recording], held_out: Sequence[Recording] = ()
) -> None:
    """DataError where two recordings hold the same samples of these outputs: what was fitted is not
    held out, and nothing may count twice. It names both and the overlap in seconds."""
    recordings = [*fitted, *held_out]
    longest = max(overlaps(outputs, recordings), key=lambda o: o.samples, default=None)
    if longest is None:
        return
    first, other = recordings[longest.first], recordings[longest.second]
    crossed = longest.first < len(fitted) <= longest.second
    why = "what was fitted is not held out" if crossed else "no sample may count twice"
    seconds = longest.samples * first.sampling_period_s
    if first.path == other.path:
        message = f"{first.path} is given twice ({seconds:.4g} s): {why}"
    else:
        places = [
            f"{r.path} ({r.time[at]:.6g} .. {r.time[at + longest.samples - 1]:.6g} s)"
            for r, at in ((first, longest.start), (other, longest.again))
        ]
        message = (
            f"{places[0]} and {places[1]} hold the same measured samples, {seconds:.4g} s "
            f"of them{', apart from an offset or a scale' if longest.rescaled else ''}: {why}"
        )
    raise DataError(
        f"{message}.",
        "Give every recording once, in a single role; without --held-out, the last part of each "
        "is held out.",
        code="overlap",
    )


def overlaps(outputs: Sequence[str], recordings: Sequence[Recording]) -> Iterator[Overlap]:
    """Pairs of recordings that share samples, each with its longest common stretch. Where several
    hold the same, each is named with a single other."""
    if len(recordings) < 2:
        return
    seen: dict[tuple[str, float, int], int] = {}
    fresh = []
    for i, r in enumerate(recordings):
        first = seen.setdefault((r.sha256 or str(id(r)), float(r.time[0]), len(r)), i)
        if first != i:
            yield Overlap(first, i, 0, 0, len(r))
        else:
            fresh.append(i)
    tables = {i: _signals(recordings[i], outputs) for i in fresh}
    copies: set[tuple[int, int]] = set()
    for words_of, rescaled in ((_levels_of, False), (_signs_of, True)):
        votes = []
        for name in outputs:
            having = {i: signals[name] for i, signals in tables.items() if name in signals}
            words = words_of(having) if len(having) > 1 else {}
            if len(words) > 1:
                votes.append(_matches(words))
        if not votes:
            continue
        # shifts, place in i minus place in j, at which two recordings share words, most words first
        pairs, counts = np.unique(np.concatenate(votes), axis=0, return_counts=True)
        often = np.flatnonzero(counts >= SHARED_WORDS)
        tried: dict[tuple[int, int], int] = {}
        for row in often[np.argsort(-counts[often], kind="stable")]:
            i, j, shift = pairs[row].tolist()
            tried[i, j] = tried.get((i, j), 0) + 1
            if (i, j) in copies or tried[i, j] > SHIFTS:
                continue
            stretch = _shared(tables[i], tables[j], shift, rescaled)
            if stretch is not None:
                copies.add((i, j))
                yield Overlap(i, j, stretch[0], stretch[0] - shift, stretch[1], rescaled)


def _signals(recording: Recording, outputs: Sequence[str]) -> dict[str, _Signal]:
    """The measured signals that move, by the rig's name for them."""
    signals = {}
    for name in outputs:
        column = match_column(recording.columns, name)
        if column is None or motion(recording.columns[column]) == 0.0:
            continue
        values, symbol = recording.columns[column], split_column(column)[1]
        step = float(size_to_si(_printed_step(values), symbol))
        signals[name] = _Signal(np.asarray(to_si(values, symbol)), step)
    return signals


def _printed_step(values: Array) -> float:
    """The last digit with which the largest values were printed: 0.001 for 12.345."""
    size = np.abs(values)
    top = np.flatnonzero(size >= 10.0 ** np.floor(np.log10(size.max())))
    chosen = values[top[np.linspace(0, top.size - 1, min(PRINTED, top.size)).astype(int)]].tolist()
    last = 0
    for text in map(repr, chosen):
        mantissa, _, exponent = text.partition("e")
        decimals = mantissa.partition(".")[2]
        last = min(last, int(exponent or 0) - (0 if decimals == "0" else len(decimals)))
    return float(max(10.0**last, CONVERSION_TOLERANCE * size.max()))


def _levels_of(having: dict[int, _Signal]) -> dict[int, Words]:
    """Words of levels and dwells, in cells that all recordings of a signal share."""
    step = max(s.step for s in having.values())
    narrow = min(float(np.ptp(s.values)) for s in having.values())
    cell = step * next((m for m in STEPS_PER_LEVEL if narrow >= FEWEST_LEVELS * m * step), 1)
    words = {}
    for i, s in having.items():
        level = np.rint(s.values / cell).astype(np.int64)
        begins = np.flatnonzero(np.concatenate([[True], level[1:] != level[:-1]]))
        # the last word is cut short by the end of the file
        dwell = np.diff(begins).astype(np.uint64)
        word = (level[begins[:-1]].astype(np.uint64) * MIX ^ dwell) * MIX
        word = _hashed(word ^ (word >> np.uint64(29)), DOUBLINGS)
        sampled = np.flatnonzero(word % np.uint64(WORD_STRIDE) == 0)
        words[i] = word[sampled], begins[sampled]
    return words


def _signs_of(having: dict[int, _Signal]) -> dict[int, Words]:
    """Words of the signs of differences, of signals that show noise."""
    words = {}
    for i, s in having.items():
        if not s.shows_noise:
            continue
        d = np.diff(s.values, n=DIFFERENCE_ORDER)
        sign = np.where(np.abs(d) > NO_SIGN * s.noise, np.sign(d), 0.0).astype(np.int64)
        # a signal and its opposite have the same word
        both = [_hashed((k * sign + 2).astype(np.uint64) * MIX, SIGN_DOUBLINGS) for k in (1, -1)]
        word = np.minimum(*both)
        zeros = np.convolve(sign == 0, np.ones(1 << SIGN_DOUBLINGS), "valid")[: word.size]
        telling = zeros <= MOST_ZEROS * (1 << SIGN_DOUBLINGS)
        sampled = np.flatnonzero((word % np.uint64(WORD_STRIDE) == 0) & telling)
        words[i] = word[sampled], sampled
    return words


def _hashed(word: NDArray[np.uint64], doublings: int) -> NDArray[np.uint64]:
    """Hashes of every 2^doublings successive items."""
    for doubling in range(doublings):
        half = 1 << doubling
        word = word[:-half] * MIX + word[half:] if word.size > half else word[:0]
        word ^= word >> np.uint64(31)
    return word


def _matches(words: dict[int, Words]) -> Places:
    """(i, j, shift) for every word that recordings i < j share; of those that share a word, each
    with the next."""
    word = np.concatenate([w for w, _ in words.values()])
    place = np.concatenate([p for _, p in words.values()])
    owner = np.concatenate([np.full(len(w), i) for i, (w, _) in words.items()])
    order = np.lexsort((place, owner, word))
    word, place, owner = word[order], place[order], owner[order]
    first = np.concatenate([[True], (word[1:] != word[:-1]) | (owner[1:] != owner[:-1])])[
        : word.size
    ]
    word, place, owner = word[first], place[first], owner[first]
    at = np.flatnonzero(word[1:] == word[:-1])
    return np.stack([owner[at], owner[at + 1], place[at] - place[at + 1]], axis=1).astype(np.int64)


def _shared(
    table: dict[str, _Signal], other: dict[str, _Signal], shift: int, rescaled: bool
) -> tuple[int, int] | None:
    """First sample (of `table`) and length of the stretch with most information of those alike in
    every signal that both have; None where it has too little.

    rescaled: alike are signals of which first is a straight line over the other.
    """
    names = [n for n in table if n in other]
    start = max(0, shift)
    stop = min(len(table[names[0]].values), len(other[names[0]].values) + shift)
    size = stop - start
    same, moves = np.ones(size, bool), np.zeros(size, bool)
    for first, second in ((table[n], other[n]) for n in names):
        a, b = first.values[start:stop], second.values[start - shift : stop - shift]
        if not rescaled:
            near = 0.5 * (first.step + second.step) + CONVERSION_TOLERANCE * float(np.abs(a).max())
            same &= np.abs(a - b) <= 1.000001 * near
            moves[1:] |= np.abs(np.diff(a)) > 2.0 * near
            continue
        line = _line(a, b, first.noise)
        if line is None:
            return None
        gain, offset = line
        noise = min(first.noise, abs(gain) * second.noise)
        squares = ((a - offset - gain * b) / noise) ** 2
        # mean over half a block around every sample
        window = np.ones(min(LINE_SAMPLES // 2 + 1, size))
        counted = np.convolve(np.ones(size), window, "same")
        same &= np.convolve(squares, window, "same") / counted <= COPY_SHARE**2
        if first.shows_noise and second.shows_noise:
            moves[1:] |= np.abs(np.diff(a)) > 2.0 * COPY_SHARE * noise
    starts, stops = runs_of(same)
    levels_before = np.concatenate([[0], np.cumsum(moves)])
    count = levels_before[stops] - levels_before[starts]
    best = int(np.argmax(count)) if count.size else -1
    covers_all = best >= 0 and stops[best] - starts[best] == same.size
    if best < 0 or count[best] < (TELLING_SAMPLES if covers_all else BROKEN * TELLING_SAMPLES):
        return None
    return start + int(starts[best]), int(stops[best] - starts[best])


def _line(a: Array, b: Array, noise: float) -> tuple[float, float] | None:
    """Gain and offset of a over b in the blocks where a straight line leaves less than noise; None
    where there are none."""
    count = len(a) // LINE_SAMPLES
    if not count:
        return None
    x, y = (z[: count * LINE_SAMPLES].reshape(count, -1) for z in (b, a))
    dx, dy = (z - z.mean(axis=1, keepdims=True) for z in (x, y))
    size = (dx * dx).sum(axis=1)
    gain = (dx * dy).sum(axis=1) / np.where(size > 0.0, size, 1.0)
    left = np.sqrt(((dy - gain[:, None] * dx) ** 2).mean(axis=1))
    alike = (left < COPY_SHARE * noise) & (np.ptp(y, axis=1) > 2.0 * noise)
    if not alike.any():
        return None
    x, y = x[alike].ravel(), y[alike].ravel()
    dx = x - x.mean()
    slope = float(dx @ (y - y.mean()) / (dx @ dx))
    return slope, float(y.mean() - slope * x.mean())
