"""The pictures of a trial: targets, reliability, confusion, strata."""

from __future__ import annotations

import textwrap

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pamid.report.formatting import count, effect_label, percent
from pamid.report.style import (
    Drawing,
    annotate,
    bar,
    bare,
    colour,
    dot,
    finish,
    label,
    line,
    name_rows,
    write,
)
from pamid.report.trial_results import (
    Trial,
    reached_text,
    signs,
    stratum_label,
)
from pamid.trial.figure_table import TITLES

SERIES = {"family_first": ("refitted", -0.16, "o"), "false_alarm": ("with_cause", 0.16, "s")}


def trial_drawings(trial: Trial) -> list[Drawing]:
    """The drawings that the content of this trial allows."""
    every = (targets_drawing, reliability_drawing, confusion_drawing, strata_drawing)
    return [drawing for draw in every if (drawing := draw(trial)) is not None]


def targets_drawing(trial: Trial) -> Drawing | None:
    """Points with 95 % intervals: every rate that has a target [%], and the target."""
    shown = [score for score in trial.scored if score.reached is not None and score.row.unit == "%"]
    if not shown:
        return None

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        for row, score in enumerate(shown):
            role = "with_network" if score.reached else "with_cause"
            if score.low is not None and score.high is not None:
                ends = [score.low, score.high]
                line(axes, ends, [row, row], role, 1.8, solid_capstyle="butt")
            line(axes, [score.row.target] * 2, [row - 0.36, row + 0.36], "ink", 2.0)
            face = colour(role if score.reached else "paper")
            dot(axes, score.value, row, role, 5.5, markeredgewidth=1.3, markerfacecolor=face)
            write(axes, 103.0, row, score.texts[1])
        titles = [label(score.row.title.removeprefix("... "), 60) for score in shown]
        titles = [textwrap.fill(title, 24 if narrow else 60) for title in titles]
        name_rows(axes, titles, 60)
        _percent_axis(axes, narrow)
        interval = "" if narrow else "line: 95 % interval, "
        note = f"{interval}bar: target, open: missed"
        finish(axes, f"share of the cases [%]\n{note}", lines="x")

    missed = [
        f"{score.row.title.removeprefix('... ')} ({score.texts[1]}, target {signs(score.texts[4])})"
        for score in trial.scored
        if score.reached is False
    ]
    more = f" and {len(missed) - 2} more" if len(missed) > 2 else ""
    named = f"; missed: {', '.join(missed[:2])}{more}" if missed else ""
    tall, narrow_tall = 0.85 + 0.28 * len(shown), 0.85 + 0.42 * len(shown)
    return Drawing("targets", f"{reached_text(trial)}{named}", draw, tall, narrow_tall)


def reliability_drawing(trial: Trial) -> Drawing | None:
    """Share of right answers with 95 % intervals and counts, over the probability stated [-]."""
    if not trial.file.reliability:
        return None

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        line(axes, [0.0, 1.0], [0.0, 1.0], "muted", 0.9, (0, (4, 3)), label="as stated")
        for bin_ in trial.file.reliability:
            right = bin_.right
            line(axes, [bin_.said] * 2, [right.low, right.high], "refitted", 1.6)
            top = max(right.high, right.share or 0.0)
            look = {"ha": "center", "va": "baseline"}
            number = count(right.of)
            annotate(axes, number, (bin_.said, top), (0, 5), "muted", 8.0, **look)
        stated = [bin_.said for bin_ in trial.file.reliability]
        shares = [bin_.right.share or 0.0 for bin_ in trial.file.reliability]
        name = "share right, 95 % interval, number of answers"
        line(axes, stated, shares, "refitted", 1.2, marker="o", markersize=5.0, label=name)
        axes.set_xlim(-0.02, 1.02)
        axes.set_ylim(-0.02, 1.1)
        across = "probability stated for the first candidate [-]"
        finish(axes, across, "share that was right [-]", legend=1 if narrow else 2)

    score, title = trial.of("ece"), "Stated probabilities against the share that was right"
    if score is not None and score.value is not None:
        aim = f" (target {signs(score.texts[4])})" if score.row.target is not None else ""
        title = f"Stated probabilities are off by {score.texts[1]} on average{aim}"
    return Drawing("reliability", title, draw, 3.4, 3.4)


def confusion_drawing(trial: Trial) -> Drawing | None:
    """Cases [count] by planted family and answer; the shade is the share of the row."""
    rows = {family: row for family, row in trial.file.confusion.items() if sum(row.values()) > 0}
    answers = list(rows) + sorted({name for row in rows.values() for name in row} - set(rows))
    if len(rows) * len(answers) <= 1:
        return None  # a single cell: the text has it

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        size, longest = (6.0, 16) if narrow else (8.0, 24)
        for y, (family, row) in enumerate(rows.items()):
            total = sum(row.values())
            for x, answer in enumerate(answers):
                if cases := row.get(answer, 0.0):
                    role = "with_network" if answer == family else "with_cause"
                    shade = 0.15 + 0.6 * cases / total
                    bar(axes, y, 1.0, role, 1.0, left=x - 0.5, alpha=shade)
                    write(axes, x, y, count(cases), size=size, ha="center")
        columns, lines = (
            [label(effect_label(name), longest) for name in names] for names in (answers, rows)
        )
        axes.set_xticks(range(len(answers)), columns, rotation=90, fontsize=size)
        axes.set_yticks(range(len(rows)), lines, fontsize=size)
        axes.set_xlim(-0.5, len(answers) - 0.5)
        axes.set_ylim(len(rows) - 0.5, -0.5)
        planted = "planted [cases]" if narrow else "planted family [cases]"
        finish(axes, "answer [cases]", planted, lines="")

    totals = {family: sum(row.values()) for family, row in rows.items()}
    right = sum(row.get(family, 0.0) for family, row in rows.items())
    title = (
        f"{count(right)} of {count(sum(totals.values()))} visible single faults are given their "
        "family"
    )
    wrong = [
        (cases, family, answer)
        for family, row in rows.items()
        for answer, cases in row.items()
        if answer != family and cases > 0
    ]
    if wrong:
        cases, family, answer = max(wrong, key=lambda item: item[0])
        title += (
            f"; most often mistaken: {effect_label(family)} for {effect_label(answer)}, "
            f"{count(cases)} of {count(totals[family])}"
        )
    return Drawing("confusion", title, draw, 1.9 + 0.27 * len(rows), 1.4 + 0.2 * len(rows))


def strata_drawing(trial: Trial) -> Drawing | None:
    """Points with 95 % intervals: family first, and false alarms [%], by condition."""
    shown = [
        (name, key, rates)
        for name, bins in trial.file.strata.items()
        for key, rates in bins.items()
        if any(rates[series].of for series in SERIES)
    ]
    if not shown:
        return None
    places, before = [0.0], shown[0][0]
    for name, _, _ in shown[1:]:
        places.append(places[-1] + (1.0 if name == before else 1.7))
        before = name

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        for series, (role, offset, marker) in SERIES.items():
            for place, (_, _, rates) in zip(places, shown, strict=True):
                rate, at = rates[series], place + offset
                if rate.share is not None:
                    line(axes, [100.0 * rate.low, 100.0 * rate.high], [at, at], role)
                    dot(axes, 100.0 * rate.share, at, role, 4.5, marker=marker)
            line(axes, [], [], role, marker=marker, markersize=4.5, label=TITLES[series])
        axes.set_yticks(places, [label(stratum_label(name, key)) for name, key, _ in shown])
        axes.set_ylim(places[-1] + 0.6, places[0] - 0.7)
        bare(axes)
        _percent_axis(axes, narrow)
        what = "share of the cases [%], number of cases at the right"
        for place, (_, _, rates) in zip(places, shown, strict=True):
            counts = " / ".join(count(rates[series].of) for series in SERIES)
            write(axes, 103.0, place, counts, "muted", 8.0)
        finish(
            axes,
            "share of cases [%]" if narrow else what,
            lines="x",
            legend=1 if narrow else 2,
        )

    height = 0.95 + 0.26 * (places[-1] + 1.0)
    return Drawing("strata", _strata_title(trial), draw, height, height + 0.2)


def _strata_title(trial: Trial) -> str:
    """ "The family is named first in 61 % (visibility 1.1 to 1.3) to 98 % (visibility ≥ 2) of the
    visible faults"."""
    shares = [
        (rates["family_first"].share, stratum_label(name, key))
        for name, bins in trial.file.strata.items()
        for key, rates in bins.items()
        if rates["family_first"].share is not None
    ]
    if not shares:
        return "No visible single fault in any stratum"
    (low, worst), (high, best) = min(shares), max(shares)
    shown = percent(low)
    if shown == percent(high):
        return f"The family is named first in {shown} of the visible faults, in every stratum"
    return (
        f"The family is named first in {shown} ({worst}) to {percent(high)} ({best}) of the "
        "visible faults"
    )


def _percent_axis(axes: Axes, narrow: bool) -> None:
    axes.set_xlim(-1.0, 118.0 if narrow else 112.0)
    axes.set_xticks(range(0, 101, 50 if narrow else 20))
    axes.spines["bottom"].set_bounds(0.0, 100.0)
