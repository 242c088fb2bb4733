"""Several recordings in a log, as the loops of a MAT file, the runs of a TDMS file or the
episodes of a JSON log.

Their channel names differ in a single part, for which a mapping has `*`: `loops/*/angle` stands for
`loops/1/angle`, `loops/2/angle` ..., and each becomes a recording.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pamid.base.errors import FileError, listed
from pamid.intake.logs.channels import ANY, Channel, Log
from pamid.intake.logs.guessed_clock import guess_clock

_ENDING_NUMBER = re.compile(r"(.*?)(\d+)")
SAME_PERIOD = 1e-3  # largest relative difference of the periods of equal clocks
OTHER_LENGTH = 0.02  # relative difference in length from which on runs are separate recordings


def merged_parts(log: Log) -> tuple[Log, str]:
    """The log with a channel, named with `*`, for the channels of all parts, and a sentence about
    them; the unchanged log and "" if it is a single recording."""
    families: dict[tuple[str, ...], dict[str, dict[str, Channel]]] = {}
    for channel in log.channels:
        for family, key, pattern in _places(channel.name):
            families.setdefault(family, {}).setdefault(key, {})[pattern] = channel
    # the family with the most channels: part -> name with `*` -> channel
    parts: dict[str, dict[str, Channel]] = {}
    most = 0
    for members in families.values():
        whole = {key: part for key, part in members.items() if len(part) > 1}
        alike = len(whole) > 1 and len({frozenset(part) for part in whole.values()}) == 1
        count = sum(map(len, whole.values()))
        if alike and count > most and _are_recordings(list(whole.values())):
            parts, most = whole, count
    if not parts:
        return log, ""
    inside = {id(channel) for part in parts.values() for channel in part.values()}
    others = [channel for channel in log.channels if id(channel) not in inside]
    longest = max(parts.values(), key=lambda part: max(_lengths(part.values())))
    merged = [replace(channel, name=name) for name, channel in longest.items()]
    text = f"{len(parts)} parts: {ANY} stands for {listed(parts)}; each becomes a recording"
    return replace(log, channels=(*merged, *others)), text


def log_per_part(log: Log, sources: Iterable[str], where: str) -> list[Log]:
    """A log per part if sources have a `*`, with channels named with `*`; else the log itself.

    `where` names the mapping in errors. Raises FileError if no channel fits a source, or if a part
    has no such channel.
    """
    names = {channel.name for channel in log.channels}
    patterns = [s for s in dict.fromkeys(sources) if ANY in s and s not in names]
    if not patterns:
        return [log]
    # channels by the text of the `*`, in the order of the log
    fits: dict[str, dict[str, Channel]] = {}
    for pattern in patterns:
        before, _, after = pattern.partition(ANY)
        text = re.compile(re.escape(before) + "([^/]+)" + re.escape(after))
        matched = ((text.fullmatch(channel.name), channel) for channel in log.channels)
        fits[pattern] = {match[1]: channel for match, channel in matched if match}
        if not fits[pattern]:
            raise FileError(
                f"{where}: {pattern!r} fits no channel of {log.path}.",
                f"Its channels are: {listed(sorted(names))}.",
                code="missing-channel",
            )
    keys = list(dict.fromkeys(key for members in fits.values() for key in members))
    for key in keys:
        for pattern, members in fits.items():
            if key not in members:
                raise FileError(
                    f"{log.path}: part {key!r} has no {pattern.replace(ANY, key, 1)!r}.",
                    f"Every part needs {listed(patterns)}. Otherwise map this part separately.",
                    code="missing-channel",
                )
    logs = []
    for key in keys:
        named = [replace(members[key], name=pattern) for pattern, members in fits.items()]
        logs.append(replace(log, part=key, channels=(*named, *log.channels)))
    return logs


def _places(name: str) -> list[tuple[tuple[str, ...], str, str]]:
    """(family, key, name with `*` for the key) for each place of a name that may identify a part.

    Such a place is a group, the number at the end of a group, or that at the end of the name.
    """
    groups = name.split("/")
    places = []
    for depth, group in enumerate(groups):
        before, after = groups[:depth], groups[depth + 1 :]
        match = _ENDING_NUMBER.fullmatch(group)
        if match and match[1]:
            family = ("number", *before, *([match[1]] if after else []))
            places.append((family, match[2], "/".join([*before, match[1] + ANY, *after])))
        if after:
            places.append((("group", *before), group, "/".join([*before, ANY, *after])))
    return places


def _lengths(channels: Iterable[Channel]) -> set[int]:
    return {channel.values.size for channel in channels}


def _are_recordings(parts: Sequence[Mapping[str, Channel]]) -> bool:
    """Whether these parts are separate recordings, not channels of a single recording.

    They are if the numbers of rows differ or each has a clock, and if the stamps do not overlap or
    the runs have different lengths.
    """
    if all(channel.stamps is None for part in parts for channel in part.values()):
        if any(len(_lengths(part.values())) > 1 for part in parts):
            return False
        if len({max(_lengths(part.values())) for part in parts}) > 1:
            return True
        clocks = [guess_clock(list(part.values())).source for part in parts]
        values = [clock.values for clock in clocks if clock is not None]
        # time1, p1, time2, p2: each channel of a recording may have a copy of the stamps
        alone = any("/" in name for name in parts[0]) or not all(
            np.array_equal(values[0], stamps, equal_nan=True) for stamps in values[1:]
        )
        return len(values) == len(parts) and alone
    if any(channel.stamps is None for part in parts for channel in part.values()):
        return False
    runs = [next(iter(part.values())).stamps for part in parts]
    stamps = [np.asarray(run) for run in runs if run is not None and run.size > 1]
    if len(stamps) < len(parts):
        return False
    spans = sorted((float(run[0]), float(run[-1])) for run in stamps)
    if all(span[1] < other[0] for span, other in zip(spans, spans[1:], strict=False)):
        return True
    periods = [float(np.median(np.diff(run))) for run in stamps]
    longest, lasting = max(periods), [high - low for low, high in spans]
    like = longest - min(periods) <= SAME_PERIOD * longest
    like = like and spans[-1][0] - spans[0][0] < longest  # begun together: no clock is absolute
    return like and max(lasting) - min(lasting) > OTHER_LENGTH * max(lasting)
