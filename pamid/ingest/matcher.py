"""How well a channel or a recorded column fits a column of a rig, by name and unit, and the best
assignment of one to the other: one matcher for raw logs and for recordings."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import NamedTuple, TypeVar

from pamid.base.units import NONE, Dimension, quantity_of, split_column, unit
from pamid.ingest.channel_words import meanings, number, plain_words

# how well a pair fits; a robot's names have scores between (`pamid.ingest.robot_names`)
SAME_NAME, SHARED_WORD, SAME_MEANING, SAME_UNIT = 1.0, 0.7, 0.5, 0.3
UNSCALED = 0.4  # less for a sensor's or an amplifier's own signal
RAW = (unit("V").dimension, unit("A").dimension)
RATIO = unit(NONE).dimension
DRIVEN = 0.25  # what is sent to a drive, for what the drive then applies
SET_POINT = 0.45  # a drive's own set-point, for what it then makes
APPLIED = ("voltage", "current", "power", "force", "torque")

Given = TypeVar("Given", bound=Hashable)


class ColumnFit(NamedTuple):
    """score: from 0, not at all, to 1; by: "name", "word" or "unit"; scaled: a gain has to stand
    between them."""

    score: float
    by: str
    scaled: bool


NO_FIT = ColumnFit(0.0, "", False)


def column_fit(stem: str, dimension: Dimension | None, wanted: str) -> ColumnFit:
    """How well what is called `stem` and measures this dimension (None: nobody says it) fits a
    column of a rig."""
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
        return NO_FIT  # where no unit says it, the speed of a shoulder is not its angle
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
        return NO_FIT  # a set-point is a role: a goal current is not a wanted angle
    if not same:
        score = max(score - UNSCALED, 0.0) if by in ("name", "word") else 0.0
    return ColumnFit(score, by, not same)


def _duty_fit(stem: str, dimension: Dimension | None, percent: bool, wanted: str) -> ColumnFit:
    """A command without a unit, or in percent, for what a drive, a heater or an amplifier then
    applies: a gain stands between the two."""
    wanted_stem, wanted_symbol = split_column(wanted)
    if dimension != RATIO or quantity_of(wanted_symbol) not in APPLIED:
        return NO_FIT
    if "command" in meanings(stem) or plain_words(stem) & plain_words(wanted_stem):
        return ColumnFit(DRIVEN, "word", True)
    return ColumnFit(DRIVEN, "unit", True) if percent else NO_FIT


def _drive_fit(stem: str, dimension: Dimension | None, wanted: str) -> ColumnFit:
    """The set-point of a drive, or the voltage or current that is sent to it, for the force or
    torque that it makes."""
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
    """How well what is called `stem` fits a column of a rig.

    dimension: None where nobody says it; percent: its unit is a ratio; sent: the rig needs the
    column, and it is what a drive applies.
    """
    fit = column_fit(stem, dimension, wanted)
    if not sent:
        return fit
    return max(
        fit, _duty_fit(stem, dimension, percent, wanted), _drive_fit(stem, dimension, wanted)
    )


def recorded_fit(name: str, wanted: str, sent: bool = False) -> ColumnFit:
    """How well a recorded column fits one of a rig."""
    stem, symbol = split_column(name)
    return pair_fit(stem, unit(symbol).dimension, wanted, sent, symbol != NONE)


def best_pairs(scores: Mapping[tuple[str, Given], float]) -> dict[str, Given]:
    """Column of the rig -> what fits it, each once; best fits first, and of equal ones those that
    come first."""
    pairs: dict[str, Given] = {}
    for (column, given), score in sorted(scores.items(), key=lambda pair: -pair[1]):
        if score > 0.0 and column not in pairs and given not in pairs.values():
            pairs[column] = given
    return pairs
