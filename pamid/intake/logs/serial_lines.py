"""Conversion of the lines of a serial monitor to rows of a table: `12:33:01.123 -> 512,3.2`,
`u:1.2,angle:3.4`, `t=0.01 u=1.2`."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable

from pamid.intake.logs.dialect import DELIMITERS, SAMPLE, SHARE_OF_ROWS, looks_like_unit
from pamid.intake.logs.text_cells import classify

_SECONDS_TEXT = re.compile(r"\d{1,12}\.\d{1,12}")
ARROW, LONGEST_STAMP = "->", 40
#: bounded lengths, so that the time of a match is linear in the length of the line
_NUMBER = r"[+-]?(?:\d{1,40}(?:\.\d{0,40})?|\.\d{1,40})(?:[eE][+-]?\d{1,4})?|nan|inf"
_LABELLED = re.compile(
    rf"(?P<label>[^\W\d][\w./\[\]-]{{0,60}})[ \t]?[:=][ \t]?(?P<value>{_NUMBER})(?=[\s,;]|$)"
    r"(?:[ \t](?P<unit>[^\s,;:=\d]{1,12})(?=[\s,;]|$))?"
)


def as_table(text: str) -> tuple[str, str]:
    """(text as rows of cells, note about the conversion); the unchanged text and "" if it is not
    the output of a serial monitor."""
    stamps, notes = list[str](), list[str]()
    lines = text.split("\n", SAMPLE)[:SAMPLE]
    if _most(_is_stamped(line) for line in lines if line.strip()):
        parts = [line.partition(ARROW) for line in text.split("\n") if _is_stamped(line)]
        stamps = [stamp.strip() for stamp, _, _ in parts]
        text = "\n".join(rest.strip() for _, _, rest in parts) + "\n"
        lines = text.split("\n", SAMPLE)[:SAMPLE]
        notes.append("every line begins with a time and ->")
    ((labels, count),) = Counter(map(_labels, filter(str.strip, lines))).most_common(1) or [((), 0)]
    if labels and count >= SHARE_OF_ROWS * sum(map(bool, map(str.strip, lines))):
        rows = text.split("\n")
        if not stamps and _most(map(_leading_stamp, filter(str.strip, rows[:SAMPLE]))):
            stamps = [_leading_stamp(row) for row in rows]
            notes.append("every line begins with a time")
        times = [[stamp] for stamp in stamps] or [[] for _ in rows]
        # names with the units behind the numbers, if all lines agree
        matches = [
            list(_LABELLED.finditer(line)) for line in rows[:SAMPLE] if _labels(line) == labels
        ]
        units = [{line[place]["unit"] or "" for line in matches} for place in range(len(labels))]
        names = [
            f"{label} [{unit}]" if len(symbol) == 1 and unit and looks_like_unit(unit) else label
            for label, symbol in zip(labels, units, strict=True)
            for unit in (min(symbol),)
        ]
        table = [["time", *names] if stamps else names]
        for time, row in zip(times, rows, strict=False):
            if _labels(row) == labels:
                table.append([*time, *(match["value"] for match in _LABELLED.finditer(row))])
        left = sum(map(bool, map(str.strip, rows))) - len(table) + 1
        notes.append("every number follows its name")
        if left:
            notes.append(f"{left} other lines are left out")
        return "".join(";".join(row) + "\n" for row in table), "; ".join(notes)
    if not stamps:
        return text, ""
    rows = text.split("\n")[:-1]
    mark = next((m for m in DELIMITERS if _most(m in row for row in rows[:SAMPLE])), "\t")
    rows = [re.sub(r"\s+", "\t", row.strip()) if mark == " " else row for row in rows]
    mark = "\t" if mark == " " else mark
    return "".join(f"{s}{mark}{row}\n" for s, row in zip(stamps, rows, strict=True)), notes[0]


def _leading_stamp(line: str) -> str:
    """Time at the beginning of a line, before the first name, or "": "2025-03-04 10:00:00,020 INFO
    cmd=1", "[12.345678] cmd=1"."""
    first = _LABELLED.search(line)
    words = line[: first.start() if first else 0].split()[:2]
    texts = [text.strip("[](),;") for text in (" ".join(words), *words[:1])]
    return next(
        (text for text in texts if classify(text) == "d" or _SECONDS_TEXT.fullmatch(text)), ""
    )


def _is_stamped(line: str) -> bool:
    stamp, arrow, _ = line.partition(ARROW)
    return bool(arrow) and len(stamp) <= LONGEST_STAMP and classify(stamp) in "nd"


def _labels(line: str) -> tuple[str, ...]:
    """Names of the numbers of a line."""
    return tuple(match["label"] for match in _LABELLED.finditer(line))


def _most(checks: Iterable[object]) -> bool:
    """Whether nearly all checks are true, and there are any."""
    results = [bool(check) for check in checks]
    return bool(results) and sum(results) >= SHARE_OF_ROWS * len(results)
