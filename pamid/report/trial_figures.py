"""The pictures of a trial: targets, reliability, confusion, strata."""

from __future__ import annotations

import textwrap

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pamid.report import formatting
from pamid.report.formatting import effect_label
from pamid.report.style import Drawing, bare, colour, grid, label, legend_above
from pamid.report.trial_results import (
    Scored,
    Trial,
    confusion_title,
    reliability_title,
    strata_title,
    stratum_label,
    targets_title,
)
from pamid.schemas.trial_file import Rate
from pamid.trial.figure_table import TITLES

SERIES = {"family_first": ("refitted", -0.16, "o"), "false_alarm": ("with_cause", 0.16, "s")}


def trial_drawings(trial: Trial) -> list[Drawing]:
    """The drawings that the content of this trial allows."""
    drawings = [
        targets_drawing(trial),
        reliability_drawing(trial),
        confusion_drawing(trial),
        strata_drawing(trial),
    ]
    return [drawing for drawing in drawings if drawing is not None]


def targets_drawing(trial: Trial) -> Drawing | None:
    """Points with 95 % intervals: every rate that has a target [%], and the target."""
    shown = [score for score in trial.scored if score.reached is not None and score.row.unit == "%"]
    if not shown:
        return None

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        for row, entry in enumerate(shown):
            _target(axes, row, entry)
        titles = [label(entry.row.title.removeprefix("... "), 60) for entry in shown]
        axes.set_yticks(
            range(len(shown)), [textwrap.fill(title, 24 if narrow else 60) for title in titles]
        )
        axes.set_ylim(len(shown) - 0.4, -0.6)
        grid(axes)
        bare(axes)
        _percent_axis(axes, narrow)
        note = (
            "bar: target, open: missed"
            if narrow
            else "line: 95 % interval, bar: target, open: missed"
        )
        axes.set_xlabel(f"share of the cases [%]\n{note}")

    return Drawing(
        "targets", targets_title(trial), draw, 0.85 + 0.28 * len(shown), 0.85 + 0.42 * len(shown)
    )


def _target(axes: Axes, row: int, scored: Scored) -> None:
    assert scored.value is not None and scored.row.target is not None
    ink = colour("with_network" if scored.reached else "with_cause")
    if scored.low is not None and scored.high is not None:
        axes.plot(
            [scored.low, scored.high], [row, row], color=ink, linewidth=1.8, solid_capstyle="butt"
        )
    axes.plot([scored.row.target] * 2, [row - 0.36, row + 0.36], color=colour("ink"), linewidth=2.0)
    axes.plot(
        scored.value,
        row,
        marker="o",
        markersize=5.5,
        color=ink,
        markeredgewidth=1.3,
        linestyle="none",
        markerfacecolor=ink if scored.reached else colour("paper"),
    )
    axes.text(
        103.0, row, scored.texts[1], va="center", fontsize=8.5, color=colour("ink"), clip_on=False
    )


def reliability_drawing(trial: Trial) -> Drawing | None:
    """Share of right answers over the probability stated [-], with 95 % intervals and the number of
    answers."""
    if not trial.reliability:
        return None

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        axes.plot(
            [0.0, 1.0],
            [0.0, 1.0],
            color=colour("muted"),
            linewidth=0.9,
            linestyle=(0, (4, 3)),
            label="as stated",
        )
        for bin_ in trial.reliability:
            axes.plot(
                [bin_.said] * 2,
                [bin_.right.low, bin_.right.high],
                color=colour("refitted"),
                linewidth=1.6,
            )
            axes.annotate(
                formatting.count(bin_.right.of),
                (bin_.said, max(bin_.right.high, bin_.right.share or 0.0)),
                xytext=(0, 5),
                ha="center",
                textcoords="offset points",
                fontsize=8.0,
                color=colour("muted"),
            )
        stated, right = zip(
            *((bin_.said, bin_.right.share or 0.0) for bin_ in trial.reliability), strict=True
        )
        axes.plot(
            stated,
            right,
            color=colour("refitted"),
            linewidth=1.2,
            marker="o",
            markersize=5.0,
            label="share right, 95 % interval, number of answers",
        )
        axes.set_xlim(-0.02, 1.02)
        axes.set_ylim(-0.02, 1.1)
        axes.set_xlabel("probability stated for the first candidate [-]")
        axes.set_ylabel("share that was right [-]")
        grid(axes, "y")
        legend_above(axes, 1 if narrow else 2)

    return Drawing("reliability", reliability_title(trial), draw, 3.4, 3.4)


def confusion_drawing(trial: Trial) -> Drawing | None:
    """Cases [count] by planted family and answer; the shade is the share of the row."""
    rows = {family: row for family, row in trial.confusion.items() if sum(row.values()) > 0}
    if not rows:
        return None
    answers = list(rows) + sorted({name for row in rows.values() for name in row} - set(rows))
    if len(rows) * len(answers) == 1:
        return None  # one cell: the words say it

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        size = 6.0 if narrow else 8.0
        for y, (family, row) in enumerate(rows.items()):
            total = sum(row.values())
            for x, answer in enumerate(answers):
                count = row.get(answer, 0.0)
                role = "with_network" if answer == family else "with_cause"
                if count:
                    axes.barh(
                        y,
                        1.0,
                        left=x - 0.5,
                        height=1.0,
                        color=colour(role),
                        alpha=0.15 + 0.6 * count / total,
                        linewidth=0.0,
                    )
                    axes.text(
                        x,
                        y,
                        formatting.count(count),
                        ha="center",
                        va="center",
                        fontsize=size,
                        color=colour("ink"),
                    )
        longest = 16 if narrow else 24
        axes.set_xticks(
            range(len(answers)),
            [label(effect_label(name), longest) for name in answers],
            rotation=90,
            fontsize=size,
        )
        axes.set_yticks(
            range(len(rows)), [label(effect_label(name), longest) for name in rows], fontsize=size
        )
        axes.set_xlim(-0.5, len(answers) - 0.5)
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.set_xlabel("answer [cases]")
        axes.set_ylabel("planted [cases]" if narrow else "planted family [cases]")

    height = 1.9 + 0.27 * len(rows)
    return Drawing("confusion", confusion_title(trial), draw, height, 1.4 + 0.2 * len(rows))


def strata_drawing(trial: Trial) -> Drawing | None:
    """Points with 95 % intervals: family first, and false alarms [%], by condition."""
    shown = [
        (name, key, rates)
        for name, bins in trial.strata.items()
        for key, rates in bins.items()
        if any(rates[series].of for series in SERIES)
    ]
    if not shown:
        return None
    heads = [name for name, _, _ in shown]
    steps = [
        0.0,
        *(1.0 if name == before else 1.7 for before, name in zip(heads, heads[1:], strict=False)),
    ]
    places = [sum(steps[: k + 1]) for k in range(len(steps))]

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        for series, (role, offset, marker) in SERIES.items():
            for place, (_, _, rates) in zip(places, shown, strict=True):
                _point(axes, place + offset, rates[series], role, marker)
            axes.plot(
                [],
                [],
                color=colour(role),
                marker=marker,
                markersize=4.5,
                linewidth=1.5,
                label=TITLES[series],
            )
        axes.set_yticks(places, [label(stratum_label(name, key)) for name, key, _ in shown])
        axes.set_ylim(places[-1] + 0.6, places[0] - 0.7)
        grid(axes)
        bare(axes)
        _percent_axis(axes, narrow)
        axes.set_xlabel(
            "share of cases [%]"
            if narrow
            else "share of the cases [%], number of cases at the right"
        )
        for place, (_, _, rates) in zip(places, shown, strict=True):
            counts = " / ".join(formatting.count(rates[series].of) for series in SERIES)
            axes.text(
                103.0,
                place,
                counts,
                va="center",
                fontsize=8.0,
                color=colour("muted"),
                clip_on=False,
            )
        legend_above(axes, 1 if narrow else 2)

    height = 0.95 + 0.26 * (places[-1] + 1.0)
    return Drawing("strata", strata_title(trial), draw, height, height + 0.2)


def _point(axes: Axes, place: float, share: Rate, role: str, marker: str) -> None:
    if share.share is None:
        return
    axes.plot(
        [100.0 * share.low, 100.0 * share.high], [place, place], color=colour(role), linewidth=1.5
    )
    axes.plot(
        100.0 * share.share,
        place,
        marker=marker,
        markersize=4.5,
        color=colour(role),
        linestyle="none",
    )


def _percent_axis(axes: Axes, narrow: bool) -> None:
    axes.set_xlim(-1.0, 118.0 if narrow else 112.0)
    axes.set_xticks(range(0, 101, 50 if narrow else 20))
    axes.spines["bottom"].set_bounds(0.0, 100.0)
