"""The section of the page in which every sample can be looked at: plots with a common time axis and
cursor, and the buttons next to the answers that lead to a place in them.

Nothing of it shows without scripts or in print: there the still pictures stand.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from markupsafe import Markup

from pamid.base.arrays import Array
from pamid.base.errors import join_words
from pamid.base.run_files import repeats_refit
from pamid.report import formatting
from pamid.report.captions import model_label
from pamid.report.channel_errors import FIELDS, HIDES_OTHERS, ChannelErrors, headline
from pamid.report.formatting import channel_label, channel_unit
from pamid.report.highlights import Highlight, highlights_of
from pamid.report.load import Residual, RunData
from pamid.report.markup import paragraphs, tag
from pamid.report.page import asset
from pamid.report.samples import (
    MOST_VALUES,
    SAMPLE_LEVELS,
    TRACE_KINDS,
    Stretch,
    channels_of,
    has,
    inputs_of,
    packed,
    packed_times,
    stretches_of,
)

MEASURED = "measured"
#: kind of trace -> the role its colour goes by, its dashes [px]; in the order they are drawn
LOOKS: dict[str, tuple[str, tuple[int, ...]]] = {
    MEASURED: ("ink", ()),
    "data_sheet": ("data-sheet", (6, 3)),
    "loop": ("black-box", (10, 3)),
    "loop_network": ("black-box", (2, 2)),
    "refitted": ("refitted", ()),
    "network": ("with-network", (3, 2)),
    "cause": ("with-cause", ()),
    "free_run": ("refitted", (2, 2)),
    "cause_free_run": ("with-cause", (2, 2)),
}
_FREE = {"free_run": "refitted", "cause_free_run": "cause"}  # the model that runs freely
_IN_LOOP = {"loop": "refitted, closed loop", "loop_network": "with network, closed loop"}
_MOVING = (
    "Drag across a plot to enlarge a stretch of time, down to single samples; double-click to see "
    "all of it again. After a click into a plot the wheel and the keys +, −, ← and → work, too; on "
    "a screen to touch, two fingers enlarge, a single finger moves. A bar on top: held out; grey: "
    "not scored, while a window finds its start."
)


@dataclass(frozen=True)
class Traces:
    """The section, "" if nothing was sampled, and the places that its plots can be sent to."""

    section: Markup = Markup("")
    places: tuple[Highlight, ...] = field(default=())

    def buttons(self, answer: str) -> Markup:
        """The places that this answer speaks of."""
        named = [
            (number, place) for number, place in enumerate(self.places) if place.answer == answer
        ]
        if not named:
            return Markup("")
        buttons = [
            tag("button", place.label, type="button", data_place=str(number))
            for number, place in named
        ]
        lead = "Look at the worst windows:" if answer == "how far" else "Look at the samples:"
        return tag("p", tag("span", lead), buttons, class_="show scripted")


def traces_scripts() -> tuple[str, ...]:
    """Scripts of the plots: the library with its licence, then pamid's."""
    library, licence, player = (
        asset(name) for name in ("uplot.iife.min.js", "uplot.LICENSE", "traces.js")
    )
    return f"/*\n{licence.strip()}\n*/\n{library.strip()}\n", player


def traces_of(run: RunData, rows: tuple[ChannelErrors, ...]) -> Traces:
    """Samples of residual.csv, as many as a page holds; empty without a modelled channel."""
    residual = run.residual
    if residual is None or not (channels := channels_of(residual)):
        return Traces()
    first = headline(rows)
    channels.sort(key=lambda name: first is None or name != first.channel)
    plots = [_plot(name, [MEASURED, *_models(residual, name)], True) for name in channels]
    plots[1:1] = [_plot(name, [MEASURED], False) for name in inputs_of(residual)]
    stretches = stretches_of(residual, MOST_VALUES // sum(len(plot["kinds"]) for plot in plots))
    if not stretches:
        return Traces()
    places = highlights_of(run, residual, channels[0], stretches)
    drawn = {kind for plot in plots for kind in plot["kinds"]}
    kinds = {}
    for kind, (role, dash) in LOOKS.items():
        if kind not in drawn:
            continue
        # not drawn at first: a free run, a loop without its network, or a model whose error in the
        # leading channel would hide the others
        error = getattr(first, FIELDS[kind]) if first is not None and kind in FIELDS else None
        refitted = first.refitted if first is not None else None
        hides = error is not None and refitted is not None and error > HIDES_OTHERS * refitted
        off = hides or kind in _FREE or (kind in _IN_LOOP and "loop_network" not in drawn)
        kinds[kind] = {"name": _kind_label(kind, run), "role": role, "dash": dash, "off": off}
    plan = {
        "plots": plots,
        "kinds": kinds,
        "recordings": [_recording(run, stretch) for stretch in stretches],
        "places": [asdict(place) for place in places],
    }
    without = "The plots of all samples need scripts; the pictures above do not."
    section = tag(
        "div",
        paragraphs([_MOVING], "note scripted"),
        tag("noscript", paragraphs([without], "note")),
        tag("div", class_="plots scripted"),
        paragraphs(_exactness(residual, stretches, channels), "note scripted"),
        _blocks(residual, stretches, plots),
        id="samples",
        data_plan=json.dumps(plan, ensure_ascii=False, separators=(",", ":")),
    )
    return Traces(section, tuple(places))


def _plot(column: str, kinds: Sequence[str], modelled: bool) -> dict[str, Any]:
    return {
        "name": channel_label(column),
        "unit": channel_unit(column),
        "column": column,
        "kinds": [kind for kind in LOOKS if kind in kinds],
        "modelled": modelled,
    }


def _models(residual: Residual, channel: str) -> list[str]:
    return [kind for kind in TRACE_KINDS if has(residual, channel, kind)]


def _kind_label(kind: str, run: RunData) -> str:
    if kind in FIELDS:
        return model_label(FIELDS[kind], run.diagnosis)
    if kind in _FREE:
        return f"{_kind_label(_FREE[kind], run)}, free run"
    return _IN_LOOP.get(kind, kind)


def _recording(run: RunData, stretch: Stretch) -> dict[str, Any]:
    number = stretch.recording
    return {
        "number": number,
        "name": formatting.clean(run.recording_name(number)) or f"recording {number + 1}",
        "samples": stretch.rows.size,
        "windows": [[first, last, int(held)] for first, last, held in stretch.windows],
    }


def _blocks(
    residual: Residual, stretches: Sequence[Stretch], plots: list[dict[str, Any]]
) -> list[Markup]:
    """The samples as blocks of text that no browser runs, named by recording, plot and kind."""
    blocks = {}
    for stretch in stretches:
        name = f"samples-{stretch.recording}"
        blocks[f"{name}-time"] = packed_times(residual.columns["time_s"][stretch.rows])
        for number, plot in enumerate(plots):
            for kind in plot["kinds"]:
                values = _values(residual, plot["column"], kind)[stretch.rows]
                blocks[f"{name}-{number}-{kind}"] = packed(values)
    return [
        tag(
            "script",
            Markup(content.text),
            type="text/plain",
            id=name,
            data_offset=repr(content.offset),
            data_step=repr(content.step),
        )
        for name, content in blocks.items()
    ]


def _values(residual: Residual, column: str, kind: str) -> Array:
    """A trace as it is drawn, that of the causes only where their model ran."""
    values = residual.columns[column] if kind == MEASURED else residual.of(column, kind)
    part, refitted = residual.columns["part"], residual.of(column, "refitted")
    assert values is not None
    if kind == "cause" and refitted is not None and repeats_refit(part, values, refitted):
        return np.where(part == 0, np.nan, values)
    return values


def _exactness(residual: Residual, stretches: Sequence[Stretch], channels: list[str]) -> list[str]:
    """Note on the resolution of the numbers and on omitted samples."""
    exact = []
    for channel in channels:
        kinds = (MEASURED, *_models(residual, channel))
        traces = [_values(residual, channel, kind) for kind in kinds]
        span = max(float(np.nanmax(trace) - np.nanmin(trace)) for trace in traces)
        exact.append(
            f"{channel_label(channel)} "
            f"{formatting.with_unit_text(0.5 * span / SAMPLE_LEVELS, channel_unit(channel), 2)}"
        )
    texts = [
        "Every sample is here, in 65535 steps over the span of its trace, so that a value is off "
        f"by at most: {join_words(exact)}."
    ]
    if any(stretch.cut for stretch in stretches):
        texts.append(
            "The recordings are too long for a page: a part of what was fitted is left out; "
            "residual.csv has all of it."
        )
    return texts
