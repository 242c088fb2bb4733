"""Matching of channels or recorded columns to the columns of a rig, by name and unit.

Raw logs and recordings use the same matcher.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import NamedTuple, TypeVar

from pamid.base.units import NONE, Dimension, quantity_of, split_column, unit
from pamid.ingest.channel_words import meanings, number, plain_words

# scores of a pair; names in a robot's log have scores between (`pamid.ingest.robot_names`)
SAME_NAME, SHARED_WORD, SAME_MEANING, SAME_UNIT = 1.0, 0.7, 0.5, 0.3
UNSCALED = 0.4  # reduction for the raw signal of a sensor or an amplifier
RAW = (unit("V").dimension, unit("A").dimension)
RATIO = unit(NONE).dimension
DRIVEN = 0.25  # command of a drive, for the quantity that the drive applies
SET_POINT = 0.45  # set-point of a drive, for the quantity that the drive produces
APPLIED = ("voltage", "current", "power", "force", "torque")

Candidate = TypeVar("Candidate", bound=Hashable)


class ColumnFit(NamedTuple):
    """Fit of a channel to a column: score from 0 to 1, reason ("name", "word" or "unit"), and
    whether a gain is needed (scaled)."""

    score: float
    by: str
    scaled: bool


NO_FIT = ColumnFit(0.0, "", False)


def column_fit(stem: str, dimension: Dimension | None, wanted: str) -> ColumnFit:
    """Fit of a channel called `stem` with this dimension (None: unknown) to a column of a rig."""
    wanted_stem, wanted_symbol = split_column(wanted)
    same = dimension in (None, unit(wanted_symbol).dimension)
    if not same and (dimension not in RAW or wanted_symbol == NONE):
        return NO_FIT
    given, wanted_number = number(stem), number(wanted_stem)
    if given and wanted_number and given != wanted_number:
        return NO_FIT
    recorded_meanings, sought = meanings(stem), meanings(wanted_stem)
    if ("reference" in recorded_meanings) != ("reference" in sought):
        return NO_FIT
    score, by = 0.0, ""
    if stem == wanted_stem:
        score, by = SAME_NAME, "name"
    elif dimension is None and recorded_meanings and sought and not recorded_meanings & sought:
        return NO_FIT  # without a unit, the speed of a shoulder must not become its angle
    elif plain_words(stem) & plain_words(wanted_stem):
        score, by = SHARED_WORD, "word"
    elif recorded_meanings & sought:
        score, by = SAME_MEANING, "word"
    elif dimension is not None and same and wanted_symbol != NONE:
        score, by = SAME_UNIT, "unit"
    if (
        not same
        and by == "word"
        and score == SAME_MEANING
        and recorded_meanings & sought == {"reference"}
    ):
        return NO_FIT  # set-points of different quantities differ: a goal current is not an angle
    if not same:
        score = max(score - UNSCALED, 0.0) if by in ("name", "word") else 0.0
    return ColumnFit(score, by, not same)


def _duty_fit(stem: str, dimension: Dimension | None, percent: bool, wanted: str) -> ColumnFit:
    """Fit of a command without a unit, or in percent, to the quantity that a drive, a heater or an
    amplifier applies: the two differ by a gain."""
    wanted_stem, wanted_symbol = split_column(wanted)
    if dimension != RATIO or quantity_of(wanted_symbol) not in APPLIED:
        return NO_FIT
    if "command" in meanings(stem) or plain_words(stem) & plain_words(wanted_stem):
        return ColumnFit(DRIVEN, "word", True)
    return ColumnFit(DRIVEN, "unit", True) if percent else NO_FIT


def _drive_fit(stem: str, dimension: Dimension | None, wanted: str) -> ColumnFit:
    """Fit of the set-point, voltage or current of a drive to the force or torque that it
    produces."""
    wanted_stem, wanted_symbol = split_column(wanted)
    same = wanted_symbol != NONE and dimension == unit(wanted_symbol).dimension
    if same and "reference" in meanings(stem):
        return ColumnFit(SET_POINT, "word", False)
    electric = dimension in RAW and meanings(stem) & {"voltage", "current"}
    drives = electric and meanings(wanted_stem) & {"force", "torque"}
    return ColumnFit(DRIVEN, "word", True) if drives else NO_FIT


def pair_fit(
    stem: str, dimension: Dimension | None, wanted: str, sent: bool = False, percent: bool = False
) -> ColumnFit:
    """Fit of a channel called `stem` to a column of a rig.

    dimension: None if unknown; percent: whether its unit is a ratio; sent: whether the column is a
    required input, which a drive applies.
    """
    fit = column_fit(stem, dimension, wanted)
    if not sent:
        return fit
    return max(
        fit, _duty_fit(stem, dimension, percent, wanted), _drive_fit(stem, dimension, wanted)
    )


def recorded_fit(name: str, wanted: str, sent: bool = False) -> ColumnFit:
    """Fit of a recorded column to a column of a rig."""
    stem, symbol = split_column(name)
    return pair_fit(stem, unit(symbol).dimension, wanted, sent, symbol != NONE)


def best_pairs(scores: Mapping[tuple[str, Candidate], float]) -> dict[str, Candidate]:
    """Column of the rig -> candidate, each at most once. The best fits are assigned first; of equal
    fits the first one."""
    pairs: dict[str, Candidate] = {}
    for (column, given), score in sorted(scores.items(), key=lambda pair: -pair[1]):
        if score > 0.0 and column not in pairs and given not in pairs.values():
            pairs[column] = given
    return pairs
