"""The pictures of the answers: port shares, regimes, missing term, free form, ranking, comparison,
gap budget, worst held-out window, free run.

Each function returns a `Drawing`, or None where the run does not hold what it shows. Titles are
built from the numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from pamid.base.arrays import Array
from pamid.base.errors import join_words
from pamid.base.metrics import adjusted_share, independent_samples
from pamid.base.schemas.diagnosis_file import Candidate, DiagnosisFile
from pamid.base.share_words import chance_text
from pamid.base.units import split_column
from pamid.diagnosis.verdict.verdict_words import chance_figure, free_families
from pamid.report import formatting
from pamid.report.captions import (
    SPELLING,
    at_port,
    causes_label,
    closest,
    has_joint_model,
    missing_term,
    model_label,
    over_channels,
    regime_label,
    taken_up,
)
from pamid.report.channel_errors import (
    HIDES_OTHERS,
    MODEL_NAMES,
    ChannelErrors,
    WorstWindow,
    headline,
    models_of,
    whole_recording,
    worst_window,
)
from pamid.report.formatting import (
    capital,
    channel_label,
    channel_unit,
    effect_label,
    percent,
    port_label,
    with_unit_text,
)
from pamid.report.load import Residual, RunData
from pamid.report.samples import FREE_RUNS
from pamid.report.style import (
    Drawing,
    Look,
    annotate,
    axis,
    bar,
    channel_axis,
    colour,
    dot,
    finish,
    label,
    level,
    line,
    name_rows,
    upright,
    write,
)

MOST_CANDIDATES = 12
MOST_CURVES = 4  # that a reader can tell apart by colour and line
_LEFT_END = -0.5  # a candidate that is worse than this is drawn at the edge, with an arrow
_NOTHING = 0.005
_LONG, _LONG_NARROW = 34, 22  # letters of a model's name next to its bar
_POINTS, _FREE_POINTS = 1500, 500  # of a trace that is drawn
_MOST_DOTS, _PARTS, _FEWEST, _NARROWEST = 1200, 16, 3, 0.03
_DASHES = ("-", (0, (5, 2)), (0, (1, 1.5)), (0, (4, 1.5, 1, 1.5)))
NO_SIGNALS = ("time", "recording", "missing")
MODEL_LINES: dict[str, tuple[str, float, Any]] = {
    "data_sheet": ("data_sheet", 1.1, (0, (4, 2))),
    "refitted": ("refitted", 1.5, "-"),
    "network": ("with_network", 1.5, (0, (1, 1.2))),
    "cause": ("with_cause", 1.7, "-"),
    "free_run": ("refitted", 1.5, "-"),
    "cause_free_run": ("with_cause", 1.7, "-"),
}


# ---- where ---------------------------------------------------------------------------------------


def ports_drawing(diagnosis: DiagnosisFile) -> Drawing | None:
    """Bars: the share of the gap that enters at each port [%]."""
    where = diagnosis.where
    if where is None or not where.ports:
        return None
    ordered = sorted(((item.port, item.share) for item in where.ports), key=lambda item: -item[1])
    large = [entry for entry in ordered if abs(entry[1]) >= _NOTHING or entry[0] == where.port]
    shares, small = ordered, [entry for entry in ordered if entry not in large]
    if len(small) >= 3:  # shares that round to zero have a common row
        shares = [*large, (f"{len(small)} other ports", sum(share for _, share in small))]
    alike = where.inseparable_from(where.port)

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        for row, (port, share) in enumerate(shares):
            named, doubtful = port == where.port, port in alike
            role = "with_cause" if named else "faint" if doubtful else "data_sheet"
            edge = {"edgecolor": colour("data_sheet"), "linewidth": 0.9 if doubtful else 0.0}
            bar(axes, row, 100.0 * share, role, 0.62, **edge)
            note = f" (or {label(port_label(where.port), 16)})" if doubtful else ""
            _value(axes, 100.0 * share, row, f"{percent(share)}{'' if narrow else note}")
        name_rows(axes, [port_label(port) for port, _ in shares])
        axes.set_xlim(min(0.0, 100.0 * min(share for _, share in shares)), 118.0)
        axes.set_xticks(range(0, 101, 25))
        finish(axes, "share of the structural gap [%]", lines="x")

    height = 0.62 + 0.3 * len(shares)
    first, at_named = ordered[0], [entry for entry in ordered if entry[0] == where.port]
    if at_named and at_named[0][1] < first[1]:
        title = (
            f"{percent(first[1])} of the gap might enter{at_port(first[0])}; the verdict names the "
            f"{port_label(where.port)} port, with {percent(at_named[0][1])}"
        )
    else:
        (port, share), *others = at_named + [entry for entry in ordered if entry[0] != where.port]
        tail = f", {percent(others[0][1])}{at_port(others[0][0])}" if others else ""
        title = f"{percent(share)} of the gap enters{at_port(port)}{tail}"
    return Drawing("ports", title, draw, height, height)


def regimes_drawing(diagnosis: DiagnosisFile) -> Drawing | None:
    """Pairs of bars: each regime's share of the gap and of the time [%]."""
    regimes = [
        (regime, regime.share_of_gap, regime.share_of_time)
        for regime in (diagnosis.where.regimes if diagnosis.where is not None else ())
        if regime.share_of_gap is not None and regime.share_of_time is not None
    ]
    if not regimes:
        return None

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        for row, (_, of_gap, of_time) in enumerate(regimes):
            for name, share, role, offset in (
                ("of the gap", of_gap, "with_cause", -0.17),
                ("of the time", of_time, "data_sheet", 0.17),
            ):
                bar(axes, row + offset, 100.0 * share, role, 0.3, label="" if row else name)
                _value(axes, 100.0 * share, row + offset, percent(share))
        # the signal, and below it the range
        names = [
            f"{port_label(regime.signal)}\n"
            f"{formatting.span(regime.low, regime.high, formatting.unit_label(regime.unit))}"
            for regime, _, _ in regimes
        ]
        name_rows(axes, names, 26)
        axes.set_xlim(0.0, 118.0)
        axes.set_xticks(range(0, 101, 25 if not narrow else 50))
        finish(axes, "share [%]", lines="x", legend=2)

    best, of_gap, of_time = regimes[0]
    title = (
        f"{percent(of_gap)} of the gap lies in {percent(of_time)} of the time: {regime_label(best)}"
    )
    height = 0.85 + 0.46 * len(regimes)
    return Drawing("regimes", title, draw, height, height)


# ---- which ---------------------------------------------------------------------------------------


def missing_drawing(run: RunData) -> Drawing | None:
    """Points and binned medians: the missing value over the signal that describes it best."""
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
        look = {"markeredgewidth": 0.0, "alpha": 0.45, "label": "slice of a recording"}
        dot(axes, x[::every], y[::every], "refitted", 3.2, **look)
        medians = {"marker": "o", "markersize": 4.0, "label": "median"}
        line(axes, centres, middles, "with_cause", 1.8, **medians)
        level(axes)
        missing = axis("missing", channel_unit(stems["missing"]))
        finish(axes, channel_axis(signal), missing, legend=2, ticks=5 if narrow else 9)

    title = f"{port_label(signals[0])} alone accounts for {percent(share)} of what is missing"
    return Drawing("missing", capital(title + at_port(term.port)), draw, 2.8, 2.8)


def binned(x: Array, y: Array) -> tuple[Array, Array, float]:
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


def free_form_drawing(diagnosis: DiagnosisFile) -> Drawing | None:
    """Nonparametric curve of the first family over its signal, with the 95 % band."""
    forms = diagnosis.unknown.free_forms if diagnosis.unknown is not None else ()
    curve = forms[0].curve if forms else None
    if curve is None or not curve.x:
        return None
    if not len(curve.x) == len(curve.y) == len(curve.low) == len(curve.high):
        return None  # of a file that was changed
    x, y, low, high = (np.asarray(v) for v in (curve.x, curve.y, curve.low, curve.high))
    turn = int(np.argmax(x)) + 1  # where a loop has come to its upper end
    over = "time since the step" if curve.signal == "time" else curve.signal

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        look: Look = {"color": colour("with_cause"), "alpha": 0.18, "linewidth": 0.0}
        for half, name in ((slice(0, turn), formatting.INTERVAL), (slice(turn, None), "")):
            axes.fill_between(x[half], low[half], high[half], label=name, **look)
        line(axes, x, y, "with_cause", 1.8, label=label(curve.shown))
        level(axes)
        finish(
            axes,
            axis(port_label(over), formatting.unit_label(curve.signal_unit)),
            axis(curve.shown, formatting.unit_label(curve.unit)),
            legend=2,
            ticks=5 if narrow else 9,
        )

    title = capital(f"{taken_up(forms[0])}: {free_families(diagnosis, SPELLING)}")
    return Drawing("free-form", title, draw, 2.8, 2.8)


def ranking_drawing(
    diagnosis: DiagnosisFile, places: Mapping[str, str] = MappingProxyType({})
) -> Drawing | None:
    """Points with 95 % intervals: the part of the held-out error each candidate removes [%], best
    first. places: by effect, the figure of the page that its row leads to."""
    shown = [entry for entry in diagnosis.ranking if entry.shrinkage is not None][:MOST_CANDIDATES]
    if not shown:
        return None
    named = {cause.effect for cause in diagnosis.causes}
    alike = set(diagnosis.tied) - named
    right = 100.0 * max(1.0, *((entry.high or entry.shrinkage or 0.0) for entry in shown))
    lows = (entry.shrinkage or 0.0 if entry.low is None else entry.low for entry in shown)
    left = 100.0 * min(0.0, *(max(_LEFT_END, low) for low in lows)) - 3.0

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        column, names = right + (4 if narrow else 2), []
        for row, entry in enumerate(shown):
            role = "refitted" if entry.effect in alike else "muted"
            _candidate(axes, entry, row, "with_cause" if entry.effect in named else role)
            chance = "" if entry.probability is None else chance_figure(entry.probability)
            write(axes, column, row, chance)
            look_alike = " (look-alike)" if entry.effect in alike and not narrow else ""
            names.append(f"{effect_label(entry.effect)}{look_alike}")
        upright(axes)
        write(axes, column, -0.85, "P" if narrow else "probability", "muted", 8.0)
        name_rows(axes, names, 34 if narrow else 48)
        for row, name in enumerate(axes.get_yticklabels()):
            name.set_gid(f"name{row}")
        axes.set_xlim(left, right + (20.0 if narrow else 13.0))
        ticks = range(-50, 101, 50 if narrow else 25)
        axes.set_xticks([tick for tick in ticks if left <= tick <= right])
        axes.spines["bottom"].set_bounds(left, right)
        what = "error removed" if narrow else f"held-out error removed{over_channels(diagnosis)}"
        notes = [] if narrow else ["line: 95 % interval"]
        notes += [] if all(entry.converged for entry in shown) else ["open: not converged"]
        finish(axes, "\n".join(filter(None, (f"{what} [%]", ", ".join(notes)))), lines="x")

    height = 1.0 + 0.27 * len(shown)
    tips, leads = [], []
    for row, entry in enumerate(shown):
        text = (
            f"{effect_label(entry.effect)} removes {percent(entry.shrinkage)} of the held-out "
            f"error{over_channels(diagnosis)}"
            f"{formatting.interval_tail(formatting.percent_span(entry.low, entry.high))}"
        )
        if entry.probability is not None:
            text += f", probability {chance_text(entry.probability)}"
        if not entry.converged:
            text += f"; {formatting.not_converged('its fit', entry.why)}"
        parts = [f"{part}{row}" for part in ("name", "line", "point")]
        tips += [(part, formatting.sentence(text)) for part in parts]
        leads += [(part, places[entry.effect]) for part in parts if entry.effect in places]
    title = _ranking_title(diagnosis)
    return Drawing("ranking", title, draw, height, height, tips=tuple(tips), leads=tuple(leads))


def _candidate(axes: Axes, candidate: Candidate, row: int, role: str) -> None:
    assert candidate.shrinkage is not None
    if candidate.low is not None and candidate.high is not None:
        low = max(candidate.low, _LEFT_END)
        if candidate.high > low:
            ends: Look = {"solid_capstyle": "butt", "gid": f"line{row}"}
            line(axes, [100.0 * low, 100.0 * candidate.high], [row, row], role, 1.8, **ends)
    if candidate.shrinkage < _LEFT_END:
        axes.plot(100.0 * _LEFT_END, row, marker="<", color=colour(role), markersize=5)
        return
    look: Look = {
        "markeredgecolor": colour(role),
        "markeredgewidth": 1.3,
        "markerfacecolor": colour(role if candidate.converged else "paper"),
        "gid": f"point{row}",
    }
    dot(axes, 100.0 * candidate.shrinkage, row, role, **look)


def _ranking_title(diagnosis: DiagnosisFile) -> str:
    """The best candidate against the runner-up, of another family where possible; for verdicts
    without a cause, how far the best falls short."""
    if not diagnosis.causes:
        best = closest(diagnosis) or diagnosis.ranking[0]
        tail = {
            "unknown-effect": "not enough to be named",
            "no-structural-gap": "no effect is needed",
        }.get(diagnosis.verdict, "these recordings do not suffice to confirm it")
        return (
            f"The most probable candidate, {effect_label(best.effect)}, removes "
            f"{percent(best.shrinkage)} of the held-out error{over_channels(diagnosis)}; {tail}"
        )
    named = {cause.effect for cause in diagnosis.causes}
    families = {cause.family for cause in diagnosis.causes}
    others = [candidate for candidate in diagnosis.ranking if candidate.effect not in named]
    different = [
        other
        for other in others
        if other.family not in families
        and other.effect not in diagnosis.tied
        and not other.set_aside
    ]
    first, second = effect_label(diagnosis.causes[0].effect), next(iter(different or others), None)
    if second is None:
        return capital(f"{first} is the only candidate that was refitted")
    return capital(f"{first} is named; the best of the others is {effect_label(second.effect)}")


def comparison_drawing(diagnosis: DiagnosisFile) -> Drawing | None:
    """Lines over the held-out windows: the loss of the reference and of the confidence set [noise
    floors] of the first step that has a set."""
    step = next((candidate for candidate in diagnosis.comparison if candidate.tied), None)
    if step is None or len(step.reference_losses) < 2:
        return None

    def draw(figure: Figure, narrow: bool) -> None:
        axes = figure.subplots()
        windows = range(1, len(step.reference_losses) + 1)
        axes.set_yscale("log")
        name = "refitted model" if step.reference == "baseline" else step.reference
        look = {"marker": "o", "markersize": 3.5}
        line(axes, windows, step.reference_losses, "refitted", 1.6, label=name, **look)
        for entry, dashes in zip(step.tied[:MOST_CURVES], _DASHES, strict=False):
            look = {"marker": "o", "markersize": 3.0, "label": effect_label(entry.effect)}
            line(axes, windows, entry.losses, "with_cause", 1.4, dashes, **look)
        axes.xaxis.set_major_locator(MaxNLocator(6 if narrow else 12, integer=True))
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: formatting.short(value, 1)))
        legend = 2 if narrow else 3
        finish(axes, "held-out window [-]", "error [noise floors]", legend=legend)

    first, *others = step.tied
    fewer = sum(a < b for a, b in zip(first.losses, step.reference_losses, strict=True))
    title = (
        f"{effect_label(first.effect)} lowers the error in {fewer} of {len(first.losses)} held-out "
        f"windows, by {percent(first.removes.share)} of the gap"
    )
    if others:
        names = join_words(effect_label(candidate.effect) for candidate in others)
        title += f"; {names} cannot be separated from it"
    return Drawing("comparison", capital(title), draw, 2.6, 2.9)


# ---- how far -------------------------------------------------------------------------------------


def budget_drawing(
    rows: tuple[ChannelErrors, ...], diagnosis: DiagnosisFile | None
) -> Drawing | None:
    """Bars per channel: held-out MAE of every model [channel's unit]."""
    rows = tuple(row for row in rows if row.known())
    if not rows:
        return None
    fields = models_of([row.known() for row in rows])
    columns = min(3, len(rows))
    deep = -(-len(rows) // columns)

    def draw(figure: Figure, narrow: bool) -> None:
        shape = (len(rows), 1) if narrow else (deep, columns)
        for position, axes in enumerate(figure.subplots(*shape, squeeze=False).flat):
            if position >= len(rows):
                axes.set_visible(False)
                continue
            row, known = rows[position], rows[position].known()
            for at, field in enumerate(fields):
                if field in known:
                    bar(axes, at, known[field], field, 0.66)
                    _value(axes, known[field], at, formatting.short(known[field]))
                else:
                    write(axes, 0.0, at, f" {formatting.DASH}", "muted", 8.0, clip_on=True)
            axes.set_xlim(0.0, 1.32 * max(known.values()) or 1.0)
            axes.locator_params(axis="x", nbins=4)
            finish(axes, channel_axis(row.channel, " MAE", 22), lines="x")
            first = position % shape[1] == 0
            name_rows(
                axes, [_model_name(name, diagnosis, narrow) if first else "" for name in fields]
            )

    each = 0.62 + 0.24 * len(fields)
    tall, narrow_tall = deep * each + 0.1, len(rows) * each + 0.1
    return Drawing("budget", _budget_title(rows, diagnosis), draw, tall, narrow_tall)


def _budget_title(rows: tuple[ChannelErrors, ...], diagnosis: DiagnosisFile | None) -> str:
    """ "Coulomb friction takes the held-out angle error from 0.52 to 0.11 deg"."""
    row = headline(rows)
    if row is None or row.refitted is None:
        return "Held-out error of each model"
    what, unit_text = channel_label(row.channel), channel_unit(row.channel)
    if diagnosis is not None and has_joint_model(diagnosis) and row.with_cause and row.refitted > 0:
        single = len(diagnosis.causes) == 1
        verb = ("raise" if row.with_cause > row.refitted else "take") + "s" * single
        act = f"{causes_label(diagnosis)} {'' if single else 'together '}{verb}"
        errors = (row.refitted, row.with_cause)
    elif row.data_sheet is None:
        error = with_unit_text(row.refitted, unit_text)
        return f"The refitted model errs by {error} in {what}, held out"
    else:
        act, errors = "Refitting changes", (row.data_sheet, row.refitted)
    both = formatting.with_common_unit(errors, unit_text, " to ")
    text = capital(f"{act} the held-out {what} error from {both}")
    if row.noise_floor is not None:
        text += f"; the noise floor is {with_unit_text(row.noise_floor, unit_text)}"
    return text


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
    time, measured = residual.columns["time_s"][window.rows], residual.columns[channel][window.rows]
    samples = ((kind, residual.of(channel, kind)) for kind in kinds)
    traces = {kind: trace[window.rows] for kind, trace in samples if trace is not None}

    def draw(figure: Figure, narrow: bool) -> None:
        above, below = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [1.7, 1.0]})
        line(above, *_thinned(time, measured, most), "ink", 2.2, label="measured")
        level(below, 0.0, "ink", 0.8)
        for kind, trace in traces.items():
            role, width, dashes = MODEL_LINES[kind]
            name = _model_name(role, run.diagnosis, narrow)
            line(above, *_thinned(time, trace, most), role, width, dashes, label=name)
            if window.mae.get(kind, 0.0) <= HIDES_OTHERS * window.mae["refitted"]:
                line(below, *_thinned(time, measured - trace, most), role, width, dashes)
        for axes in (above, below):
            axes.margins(x=0.0)
        when = axis(f"time{run.recording_words(window.recording)}", "s")
        finish(below, when, axis("error", channel_unit(channel)), ticks=5 if narrow else 9)
        finish(above, "", channel_axis(channel, "", 22), legend=2 if narrow else 4)
        figure.align_ylabels((above, below))

    name = "window-network" if "network" in kinds else "window"
    return Drawing(name, _window_title(run, channel, window, kinds), draw, 3.3, 3.5)


def _window_title(run: RunData, channel: str, window: WorstWindow, kinds: tuple[str, ...]) -> str:
    """ "Worst held-out window: the angle error falls from 1.20 to 0.210 deg with dead time"."""
    part = "held-out" if window.held_out else "fitted"
    what, unit_text = channel_label(channel), channel_unit(channel)
    before = window.mae["refitted"]
    for kind in reversed(kinds):
        if kind in ("cause", "network") and kind in window.mae:
            added = causes_label(run.diagnosis) if run.diagnosis is not None else "the causes"
            if kind == "network":
                both = run.network_on_causes(channel)
                added = f"{added} and the network" if both else "the network"
            change = "falls" if window.mae[kind] < before else "grows"
            return (
                f"Worst {part} window: the {what} error {change} from {formatting.short(before)} "
                f"to {with_unit_text(window.mae[kind], unit_text)} with {added}"
            )
    return (
        f"Worst {part} window: the refitted model errs by {with_unit_text(before, unit_text)} "
        f"in {what}"
    )


def free_run_drawing(run: RunData, residual: Residual, channel: str) -> Drawing | None:
    """Measured and modelled traces over the whole recording of the worst window, each model run
    from an estimated state, and their errors below [channel's unit] over time [s]."""
    worst = worst_window(residual, channel)
    whole = None if worst is None else whole_recording(residual, channel, worst.recording)
    if whole is None:
        return None
    unit_text = channel_unit(channel)
    title = (
        f"Free run over the whole recording: the {channel_label(channel)} error is "
        f"{with_unit_text(whole.mae['free_run'], unit_text)} on average"
    )
    if "cause_free_run" in whole.mae and run.diagnosis is not None:
        error = with_unit_text(whole.mae["cause_free_run"], unit_text)
        title += f", {error} with {causes_label(run.diagnosis)}"
    kinds = tuple(kind for kind in FREE_RUNS if kind in whole.mae)
    drawing = window_drawing(run, residual, channel, whole, kinds, _FREE_POINTS)
    return replace(drawing, name="free-run", title=title)


def _model_name(field: str, diagnosis: DiagnosisFile | None, narrow: bool) -> str:
    """Label of a model at its bar or in a legend; too long a cause is called "cause"."""
    name = model_label(field, diagnosis)
    if field == "with_cause" and len(name) > (_LONG_NARROW if narrow else _LONG):
        name = MODEL_NAMES[field]
    return label(name, _LONG)


def _value(axes: Axes, x: float, row: float, text: str) -> None:
    annotate(axes, text, (max(x, 0.0), row), (4, 0))


def _thinned(time: Array, values: Array, most: int) -> tuple[Array, Array]:
    """About so many points that keep every extreme: first, lowest, highest of each stretch."""
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
