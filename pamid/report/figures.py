"""The pictures of the three answers: port shares, regimes, ranking, missing term, gap budget, worst
held-out window.

Each function returns a `Drawing`, or None where the run does not hold what it shows. Titles are
built from the numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pamid.base.metrics import adjusted_share, independent_samples
from pamid.base.units import split_column
from pamid.report import formatting
from pamid.report.captions import (
    budget_title,
    candidate_order,
    candidate_tip,
    free_run_title,
    missing_title,
    model_label,
    over_channels,
    ports_title,
    ranking_title,
    regimes_title,
    window_title,
)
from pamid.report.channel_errors import (
    MODEL_NAMES,
    ChannelErrors,
    WorstWindow,
    whole_recording,
    worst_window,
)
from pamid.report.load import Residual, RunData
from pamid.report.missing_term import missing_term
from pamid.report.reading import FloatArray
from pamid.report.samples import FREE_RUNS
from pamid.report.style import Drawing, bare, colour, grid, label, legend_above
from pamid.schemas.diagnosis_file import Candidate, DiagnosisFile, Regime, Where

MOST_CANDIDATES = 12
_LEFT_END = -0.5  # a candidate that is worse than this is drawn at the edge, with an arrow
_NOTHING = 0.005
_HUGE = 4.0
_LONG, _LONG_NARROW = 34, 22  # letters of a model's name beside its bar
_POINTS, _FREE_POINTS = 1500, 500  # of a trace that is drawn
_MOST_DOTS, _PARTS, _FEWEST, _NARROWEST = 1200, 16, 3, 0.03
NO_SIGNALS = ("time", "recording", "missing")
MODEL_LINES = {
    "data_sheet": ("data_sheet", 1.1, (0, (4, 2))),
    "refitted": ("refitted", 1.5, "-"),
    "network": ("with_network", 1.5, (0, (1, 1.2))),
    "cause": ("with_cause", 1.7, "-"),
    "free_run": ("refitted", 1.5, "-"),
    "cause_free_run": ("with_cause", 1.7, "-"),
}


def ports_drawing(diagnosis: DiagnosisFile) -> Drawing | None:
    """Bars: the share of the gap that enters at each port [%]."""
    where = diagnosis.where
    if where is None or not where.ports:
        return None
    shares = _large_shares(where)
    alike = where.inseparable_from(where.port)

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        for row, (port, share) in enumerate(shares):
            named, doubtful = port == where.port, port in alike
            axes.barh(
                row,
                100.0 * share,
                height=0.62,
                color=colour("with_cause" if named else "faint" if doubtful else "data_sheet"),
                edgecolor=colour("data_sheet"),
                linewidth=0.9 if doubtful else 0.0,
            )
            note = f" (or {label(formatting.port_label(where.port), 16)})" if doubtful else ""
            _value(axes, 100.0 * share, row, f"{formatting.percent(share)}{'' if narrow else note}")
        _rows(axes, [formatting.port_label(port) for port, _ in shares])
        axes.set_xlim(min(0.0, 100.0 * min(share for _, share in shares)), 118.0)
        axes.set_xticks(range(0, 101, 25))
        axes.set_xlabel("share of the structural gap [%]")

    height = 0.62 + 0.3 * len(shares)
    return Drawing("ports", ports_title(where), draw, height, height)


def regimes_drawing(diagnosis: DiagnosisFile) -> Drawing | None:
    """Pairs of bars: each regime's share of the gap and of the time [%]."""
    regimes = [
        regime
        for regime in (diagnosis.where.regimes if diagnosis.where is not None else ())
        if regime.share_of_gap is not None and regime.share_of_time is not None
    ]
    if not regimes:
        return None

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        for row, regime in enumerate(regimes):
            pair = (
                (regime.share_of_gap, "with_cause", -0.17),
                (regime.share_of_time, "data_sheet", 0.17),
            )
            for (share, role, offset), name in zip(
                pair, ("of the gap", "of the time"), strict=True
            ):
                assert share is not None
                axes.barh(
                    row + offset,
                    100.0 * share,
                    height=0.3,
                    color=colour(role),
                    linewidth=0.0,
                    label="" if row else name,
                )
                _value(axes, 100.0 * share, row + offset, formatting.percent(share))
        _rows(axes, [_regime_name(regime) for regime in regimes], 26)
        axes.set_xlim(0.0, 118.0)
        axes.set_xticks(range(0, 101, 25 if not narrow else 50))
        axes.set_xlabel("share [%]")
        legend_above(axes, 2)

    height = 0.85 + 0.46 * len(regimes)
    return Drawing("regimes", regimes_title(regimes), draw, height, height)


def _regime_name(regime: Regime) -> str:
    """The signal, and below it the range."""
    return f"{formatting.port_label(regime.signal)}\n{formatting.span(regime.low, regime.high, formatting.unit_label(regime.unit))}"  # noqa: E501


def missing_drawing(run: RunData) -> Drawing | None:
    """Points and binned medians: the missing value [port's unit] over the signal that describes it
    best [its unit]."""
    term = missing_term(run.diagnosis)
    if term is None or run.missing is None:
        return None
    stems = {split_column(name)[0]: name for name in run.missing}
    named = (s for s in stems if s not in NO_SIGNALS and s in term.formula)
    variables = term.variables or sorted(named, key=term.formula.index)
    signals = [
        *(v for v in variables if v in stems),
        *(s for s in stems if s not in NO_SIGNALS),
    ]
    if not signals:
        return None
    signal, x, y = stems[signals[0]], run.missing[stems[signals[0]]], run.missing[stems["missing"]]
    centres, middles, share = binned(x, y)
    share = adjusted_share(share, centres.size, independent_samples(x, y))

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        every = -(-x.size // _MOST_DOTS)
        axes.plot(
            x[::every],
            y[::every],
            linestyle="none",
            marker="o",
            markersize=3.2,
            markeredgewidth=0.0,
            color=colour("refitted"),
            alpha=0.45,
            label="slice of a recording",
        )
        axes.plot(
            centres,
            middles,
            color=colour("with_cause"),
            linewidth=1.8,
            marker="o",
            markersize=4.0,
            label="median",
        )
        axes.axhline(0.0, color=colour("muted"), linewidth=0.7)
        axes.set_xlabel(
            formatting.axis_label(
                label(formatting.channel_label(signal)), label(formatting.channel_unit(signal))
            )
        )
        axes.set_ylabel(
            formatting.axis_label("missing", label(formatting.channel_unit(stems["missing"])))
        )
        axes.xaxis.set_major_locator(MaxNLocator(5 if narrow else 9))
        grid(axes, "y")
        legend_above(axes, 2)

    return Drawing("missing", missing_title(term.port, signals[0], share), draw, 2.8, 2.8)


def binned(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Medians of x and y in parts of about equal count, none too narrow to be seen, and the share
    of the variance of y that lies between the parts."""
    edges = [x.min()]
    for edge in np.quantile(x, np.linspace(0.0, 1.0, _PARTS + 1))[1:]:
        if edge - edges[-1] > _NARROWEST * np.ptp(x):
            edges.append(edge)
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 1)
    parts = [
        part for k in range(len(edges)) if (part := np.flatnonzero(place == k)).size >= _FEWEST
    ]
    between = sum(part.size * (y[part].mean() - y.mean()) ** 2 for part in parts) / y.size
    share = float(between / y.var()) if y.var() > 0.0 else 0.0
    return (
        np.array([np.median(x[part]) for part in parts]),
        np.array([np.median(y[part]) for part in parts]),
        share,
    )


def ranking_drawing(
    diagnosis: DiagnosisFile, places: Mapping[str, str] = MappingProxyType({})
) -> Drawing | None:
    """Points with 95 % intervals: the part of the held-out error each candidate removes [%], best
    first. places: by effect, the figure of the page that its row leads to."""
    shown = [
        candidate for candidate in candidate_order(diagnosis) if candidate.shrinkage is not None
    ][:MOST_CANDIDATES]
    if not shown:
        return None
    named = {cause.effect for cause in diagnosis.causes}
    alike = set(diagnosis.tied) - named

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        right = max(1.0, *((entry.high or entry.shrinkage or 0.0) for entry in shown))
        left = min(
            0.0,
            *(
                max(_LEFT_END, entry.low if entry.low is not None else entry.shrinkage or 0.0)
                for entry in shown
            ),
        )
        for row, entry in enumerate(shown):
            role = (
                "with_cause"
                if entry.effect in named
                else "refitted"
                if entry.effect in alike
                else "muted"
            )
            _candidate(axes, entry, row, role)
            axes.text(
                100.0 * right + (4 if narrow else 2),
                row,
                _chance(entry),
                va="center",
                fontsize=8.5,
                color=colour("ink"),
                clip_on=False,
            )
        axes.axvline(0.0, color=colour("muted"), linewidth=0.7)
        axes.text(
            100.0 * right + (4 if narrow else 2),
            -0.85,
            "P" if narrow else "probability",
            va="center",
            fontsize=8.0,
            color=colour("muted"),
            clip_on=False,
        )
        _rows(
            axes, [_candidate_name(entry, alike, narrow) for entry in shown], 34 if narrow else 48
        )
        for row, name in enumerate(axes.get_yticklabels()):
            name.set_gid(f"name{row}")
        axes.set_xlim(100.0 * left - 3.0, 100.0 * right + (20.0 if narrow else 13.0))
        ticks = [
            tick
            for tick in range(-50, 101, 50 if narrow else 25)
            if 100.0 * left - 3.0 <= tick <= 100.0 * right
        ]
        axes.set_xticks(ticks)
        axes.spines["bottom"].set_bounds(100.0 * left - 3.0, 100.0 * right)
        what = (
            "error removed [%]"
            if narrow
            else f"held-out error removed{over_channels(diagnosis)} [%]"
        )
        failed = not all(entry.converged for entry in shown)
        notes = ([] if narrow else ["line: 95 % interval"]) + (
            ["open: not converged"] if failed else []
        )
        axes.set_xlabel(f"{what}\n{', '.join(notes)}" if notes else what)

    height = 1.0 + 0.27 * len(shown)
    parts = [
        (f"{part}{row}", entry)
        for row, entry in enumerate(shown)
        for part in ("name", "line", "point")
    ]
    tips = tuple((part, candidate_tip(candidate, diagnosis)) for part, candidate in parts)
    leads = tuple(
        (part, places[candidate.effect]) for part, candidate in parts if candidate.effect in places
    )
    title = ranking_title(diagnosis)
    return Drawing("ranking", title, draw, height, height, tips=tips, leads=leads)


def budget_drawing(
    rows: tuple[ChannelErrors, ...], diagnosis: DiagnosisFile | None
) -> Drawing | None:
    """Bars per channel: held-out MAE of every model [channel's unit]."""
    rows = tuple(row for row in rows if row.known())
    if not rows:
        return None
    fields = [name for name in MODEL_NAMES if any(name in row.known() for row in rows)]
    columns = min(3, len(rows))
    deep = -(-len(rows) // columns)

    def draw(figure: Figure, narrow: bool) -> None:
        shape = (len(rows), 1) if narrow else (deep, columns)
        grid_of_axes = figure.subplots(*shape, squeeze=False)
        for position, axes in enumerate(grid_of_axes.flat):
            if position >= len(rows):
                axes.set_visible(False)
                continue
            _budget(axes, rows[position], fields)
            names = [_model_name(field, diagnosis, narrow) for field in fields]
            _rows(axes, names if position % shape[1] == 0 else [""] * len(names))

    each = 0.62 + 0.24 * len(fields)
    return Drawing(
        "budget", budget_title(rows, diagnosis), draw, deep * each + 0.1, len(rows) * each + 0.1
    )


def window_drawing(
    run: RunData,
    residual: Residual,
    channel: str,
    window: WorstWindow,
    kinds: tuple[str, ...],
    most: int = _POINTS,
) -> Drawing:
    """Measured and modelled traces over the worst window, and their errors below [channel's unit]
    over time [s]; most: points of a trace."""
    diagnosis = run.diagnosis
    unit_text, what = formatting.channel_unit(channel), formatting.channel_label(channel)
    time, measured = residual.columns["time_s"][window.rows], residual.columns[channel][window.rows]
    samples = ((kind, residual.of(channel, kind)) for kind in kinds)
    traces = {kind: trace[window.rows] for kind, trace in samples if trace is not None}

    def draw(figure: Figure, narrow: bool) -> None:
        above, below = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [1.7, 1.0]})
        above.plot(
            *_thinned(time, measured, most), color=colour("ink"), linewidth=2.2, label="measured"
        )
        below.axhline(0.0, color=colour("ink"), linewidth=0.8)
        for kind, trace in traces.items():
            role, width, dashes = MODEL_LINES[kind]
            name = _model_name(role, diagnosis, narrow)
            above.plot(
                *_thinned(time, trace, most),
                color=colour(role),
                linewidth=width,
                linestyle=dashes,
                label=name,
            )
            # else nothing else could be read
            if window.mae.get(kind, 0.0) <= _HUGE * window.mae["refitted"]:
                below.plot(
                    *_thinned(time, measured - trace, most),
                    color=colour(role),
                    linewidth=width,
                    linestyle=dashes,
                )
        above.set_ylabel(formatting.axis_label(label(what, 22), label(unit_text)))
        below.set_ylabel(formatting.axis_label("error", label(unit_text)))
        below.set_xlabel(
            formatting.axis_label(label(f"time{run.recording_words(window.recording)}"), "s")
        )
        for axes in (above, below):
            grid(axes, "y")
            axes.margins(x=0.0)
        below.xaxis.set_major_locator(MaxNLocator(5 if narrow else 9))
        figure.align_ylabels((above, below))
        legend_above(above, 2 if narrow else 4)

    name = "window-network" if "network" in kinds else "window"
    return Drawing(name, window_title(run, channel, window, kinds), draw, 3.3, 3.5)


def free_run_drawing(run: RunData, residual: Residual, channel: str) -> Drawing | None:
    """Measured and modelled traces over the whole recording of the worst window, each model run
    from one estimated state, and their errors below [channel's unit] over time [s]."""
    worst = worst_window(residual, channel)
    whole = None if worst is None else whole_recording(residual, channel, worst.recording)
    if whole is None:
        return None
    kinds = tuple(kind for kind in FREE_RUNS if kind in whole.mae)
    title = free_run_title(channel, whole, run.diagnosis)
    drawing = window_drawing(run, residual, channel, whole, kinds, _FREE_POINTS)
    return replace(drawing, name="free-run", title=title)


def _large_shares(where: Where) -> list[tuple[str, float]]:
    """Shares from the largest on; three or more that round to zero share one row."""
    ordered = sorted(((item.port, item.share) for item in where.ports), key=lambda item: -item[1])
    large = [entry for entry in ordered if abs(entry[1]) >= _NOTHING or entry[0] == where.port]
    small = len(ordered) - len(large)
    if small < 3:
        return ordered
    return [
        *large,
        (
            f"{small} other ports",
            sum(share for port, share in ordered if (port, share) not in large),
        ),
    ]


def _model_name(field: str, diagnosis: DiagnosisFile | None, narrow: bool) -> str:
    """Label of a model at its bar or in a legend; too long a cause is called "cause"."""
    name = model_label(field, diagnosis)
    if field == "with_cause" and len(name) > (_LONG_NARROW if narrow else _LONG):
        name = MODEL_NAMES[field]
    return label(name, _LONG)


def _candidate(axes: Axes, candidate: Candidate, row: int, role: str) -> None:
    assert candidate.shrinkage is not None
    ink = colour(role)
    if candidate.low is not None and candidate.high is not None:
        low = max(candidate.low, _LEFT_END)
        if candidate.high > low:
            axes.plot(
                [100.0 * low, 100.0 * candidate.high],
                [row, row],
                color=ink,
                linewidth=1.8,
                solid_capstyle="butt",
                gid=f"line{row}",
            )
    if candidate.shrinkage < _LEFT_END:
        axes.plot(100.0 * _LEFT_END, row, marker="<", color=ink, markersize=5)
    else:
        axes.plot(
            100.0 * candidate.shrinkage,
            row,
            marker="o",
            markersize=5.0,
            markeredgecolor=ink,
            markeredgewidth=1.3,
            markerfacecolor=ink if candidate.converged else colour("paper"),
            linestyle="none",
            gid=f"point{row}",
        )


def _chance(candidate: Candidate) -> str:
    if candidate.probability is None:
        return ""
    return formatting.chance(candidate.probability).replace("above ", "> ").replace("below ", "< ")


def _candidate_name(candidate: Candidate, alike: set[str], narrow: bool) -> str:
    name = formatting.effect_label(candidate.effect)
    return f"{name} (look-alike)" if candidate.effect in alike and not narrow else name


def _budget(axes: Axes, row: ChannelErrors, fields: list[str]) -> None:
    known = row.known()
    unit_text = formatting.channel_unit(row.channel)
    for position, field in enumerate(fields):
        if field not in known:
            axes.text(
                0.0,
                position,
                f" {formatting.DASH}",
                va="center",
                fontsize=8.0,
                color=colour("muted"),
            )
            continue
        axes.barh(position, known[field], height=0.66, color=colour(field), linewidth=0.0)
        _value(axes, known[field], position, formatting.short(known[field]))
    axes.set_xlim(0.0, 1.32 * max(known.values()) or 1.0)
    axes.locator_params(axis="x", nbins=4)
    axes.set_xlabel(
        formatting.axis_label(
            f"{label(formatting.channel_label(row.channel), 22)} MAE", label(unit_text)
        )
    )


def _rows(axes: Axes, names: list[str], longest: int = 34) -> None:
    """Names next to the rows 0, 1, ... from the top."""
    lines = ["\n".join(label(line, longest) for line in name.split("\n")) for name in names]
    axes.set_yticks(range(len(names)), lines)
    axes.set_ylim(len(names) - 0.4, -0.6)
    grid(axes)
    bare(axes)


def _value(axes: Axes, x: float, row: float, text: str) -> None:
    axes.annotate(
        text,
        (max(x, 0.0), row),
        xytext=(4, 0),
        textcoords="offset points",
        va="center",
        fontsize=8.5,
        color=colour("ink"),
    )


def _thinned(time: FloatArray, values: FloatArray, most: int) -> tuple[FloatArray, FloatArray]:
    """At most about so many points that keep every extreme: first, lowest and highest of each
    stretch."""
    size = values.size
    if size <= most:
        return time, values
    stretch = -(-size // (most // 2))
    keep = []
    for start in range(0, size, stretch):
        part = values[start : start + stretch]
        if np.isfinite(part).any():
            keep += sorted({start + int(np.nanargmin(part)), start + int(np.nanargmax(part))})
    keep = sorted({0, *keep, size - 1})
    return time[keep], values[keep]
