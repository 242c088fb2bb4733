"""trial.json read into dataclasses (schema pamid.trial/1), and its findings in sentences."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pamid.base.json_file import read_json
from pamid.base.result_file import damaged, read_result
from pamid.base.schemas.trial_file import Figure, Rate, TrialFile
from pamid.base.trust import is_code
from pamid.model.registry import in_catalogue
from pamid.report import formatting
from pamid.trial.figure_table import TITLES, FigureRow, cells, rows_of
from pamid.trial.machine import machine_names

FEW_CASES = 10  # below, any share may be chance


@dataclass(frozen=True)
class Scored:
    """A row of the table with its figure and interval in the row's unit, None if there were no
    cases; cases: how many; texts: its cells as the terminal shows them."""

    row: FigureRow
    cases: int
    texts: tuple[str, ...]
    value: float | None
    low: float | None
    high: float | None

    @property
    def reached(self) -> bool | None:
        """Whether the target is reached; None without a target or a figure."""
        if self.value is None or self.row.target is None:
            return None
        return self.value >= self.row.target if self.row.upward else self.value <= self.row.target


@dataclass(frozen=True)
class Trial:
    """trial.json: as it is read, as it stands, and its rows with a figure."""

    file: TrialFile
    content: dict[str, Any]
    scored: tuple[Scored, ...]

    def of(self, key: str) -> Scored | None:
        """Row of a figure; None if it is not in the file."""
        return next((score for score in self.scored if score.row.key == key), None)


def read_trial(path: Path) -> Trial | None:
    """The trial in a file; None if there is no such file, FileError if it is damaged."""
    trial = read_result(path, TrialFile)
    if trial is None:
        return None
    known = machine_names()
    # a trial may be of any rig, or of a file: the file describes it, and nothing is looked up
    if trial.rig not in known and not in_catalogue(trial.rig) and not is_code(trial.rig):
        rigs = " or ".join([*map(repr, known), "another rig"])
        raise damaged(path, "rig", rigs, f"{trial.rig!r:.60}")
    for name in ("failed", "unseen"):
        if name not in trial.rates:
            raise damaged(path, f"rates.{name}", "a rate", "missing")
    for dimension, bins in trial.strata.items():
        for key, rates in bins.items():
            for name in TITLES:
                if name not in rates:
                    place = f"strata.{dimension}.{key}.{name}"
                    raise damaged(path, place, "an object", "missing")
    content = read_json(path)  # as it stands: what was null is null
    scored = []
    for row in rows_of(content):
        rate: Rate | Figure | None = getattr(trial, row.section).get(row.key)
        if rate is not None:
            figures = (rate.value if isinstance(rate, Figure) else rate.share, rate.low, rate.high)
            value, low, high = (None if x is None else row.factor * x for x in figures)
            scored.append(Scored(row, rate.of, cells(content, row), value, low, high))
    return Trial(trial, content, tuple(scored))


# ---- sentences ---------------------------------------------------------------------------------


def reached_text(trial: Trial) -> str:
    """ "9 of 12 targets are reached"."""
    rows = [score for score in trial.scored if score.reached is not None]
    if not rows:
        return "No case counts for a target"
    judged = [row.reached for row in rows]
    text = f"{sum(map(bool, judged))} of {len(judged)} targets "
    text += "is reached" if sum(map(bool, judged)) == 1 else "are reached"
    most = max(row.cases for row in rows)
    few = f"{most} case{'' if most == 1 else 's'}"
    return text if most >= FEW_CASES else f"{text}, on {few} at most: too few to tell"


def stratum_label(dimension: str, key: str) -> str:
    """ "inertia_kg_m2", "0.014" -> "inertia 0.014 kg m²"."""
    unit_text = formatting.channel_unit(dimension)
    return f"{formatting.channel_label(dimension)} {bin_label(dimension, key)} {unit_text}".strip()


def bin_label(dimension: str, key: str) -> str:
    """ "1.1 to 1.3", "≥ 2"; of channels "without current"."""
    shown = formatting.clean(key)
    left_out = shown.removeprefix("no-")
    if dimension == "channels" and left_out != shown:
        return f"without {formatting.channel_label(left_out)}"
    return signs(shown)


def signs(text: str) -> str:
    """Signs as they are printed: no more than, at least, minus."""
    shown = text.replace(">=", "≥").replace("<=", "≤")
    return f"{formatting.MINUS}{shown[1:]}" if shown[:1] == "-" and shown[1:] else shown
