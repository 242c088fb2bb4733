"""Sampling period in the text around a table: "# Fs = 1000 Hz", "Sample Interval,2e-3,s",
"SampleTime[ms];20"."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from pamid.intake.logs.channel_words import TIME_WORDS
from pamid.intake.logs.source_units import read_unit

_RATE = r"fs|f_s|(?:sampl(?:e|ing)|abtast|scan|acquisition|logging|daq)[ _-]?(?:rate|freq\w*)"
_PERIOD = (
    r"dt|ts|t_s|delta[ _]?[tx]|(?:time|x)[ _-]?(?:increment|step|interval)"
    r"|(?:sampl(?:e|ing)|abtast|scan|logging)[ _-]?(?:interv\w*|period\w*|time|zeit)"
)
_MICRO_SIGNS = str.maketrans("µμ", "uu")
_PER_S = {"": 1.0, "k": 1e3, "m": 1e6}
_STATED = re.compile(
    rf"(?<![\w.])(?:(?P<rate>{_RATE})|(?P<period>{_PERIOD}))[ \t]*"
    r"(?:[\[(](?P<before>[^\])\d]{1,20})[\])])?[\"']?[ \t]*[:=;,\t]?[ \t]*[\"']?"
    r"(?P<number>\d{1,12}(?:[.,]\d{1,12})?(?:e[+-]?\d{1,3})?)"
    r"(?:[ \t\"';,\[(]*(?P<behind>[a-zµμ/1]{1,16}))?",
    re.IGNORECASE,
)
_HERTZ = re.compile(r"(?P<prefix>[km]?)(?:hz|sa?/s|sps|samples?/s(?:ec|econd)?)|1/s", re.IGNORECASE)
AGREE_TO = 0.01  # largest relative difference of a stated period from the clock


@dataclass(frozen=True)
class StatedPeriod:
    """A sampling period in s, and the words of the log that state it."""

    period_s: float
    quote: str

    def agrees(self, period_s: float) -> bool:
        """Whether a period equals the stated period."""
        return abs(period_s / self.period_s - 1.0) < AGREE_TO


def stated_period(lines: Iterable[str]) -> StatedPeriod | None:
    """Period that lines of text state; None if none is stated, with several, or with a duration
    without unit."""
    matches = [match for line in lines for match in _STATED.finditer(line)]
    stated = [item for item in map(_read, matches) if item is not None]
    return stated[0] if stated and all(stated[0].agrees(item.period_s) for item in stated) else None


def _read(match: re.Match[str]) -> StatedPeriod | None:
    number, symbol = float(match["number"].replace(",", ".")), match["before"] or match["behind"]
    hertz = _HERTZ.fullmatch((symbol or "").strip())
    lasting = TIME_WORDS.get((symbol or "").strip().lower().translate(_MICRO_SIGNS), "")
    end = match.end("behind") if (hertz or lasting) and not match["before"] else match.end("number")
    quote = match.string[match.start() : end]
    if number == 0.0 or not (hertz or lasting or match["rate"]):
        return None
    if lasting:
        return StatedPeriod(float(f"{number * read_unit(lasting).factor:.12g}"), quote)
    return StatedPeriod(1.0 / (number * _PER_S[hertz["prefix"].lower() if hertz else ""]), quote)
