"""Errors where the first paper has them: recording by recording, each with its inertia, replayed
and in closed loop, never only pooled. The row and table of `pamid score` and `pamid report`
alike."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from pamid.base.schemas.score_file import RecordingError
from pamid.report import formatting
from pamid.report.channel_errors import FIELDS, MODEL_NAMES, aligned, models_of
from pamid.report.formatting import channel_label, channel_unit, count, number
from pamid.report.load import RunData
from pamid.report.page import table
from pamid.simulation.scored_recording import IN_LOOP, REPLAYED, recording_error

COMPARISON_NAMES = {REPLAYED: "replay", IN_LOOP: "closed loop"}
#: what is written behind a channel's name in residual.csv -> model, by comparison
ENDINGS = {
    REPLAYED: FIELDS,
    IN_LOOP: {"loop": "refitted", "loop_network": "with_network"},
}


def held_out_errors(run: RunData) -> tuple[RecordingError, ...]:
    """Rows of a run, from the held-out part of its residual.csv; in closed loop those of fit.json
    and of the network. None without residual.csv."""
    rows = tuple(_rows(run))
    if run.fit is None or run.fit.loops is None:
        return rows
    networks = {
        (row.recording, row.channel): row
        for row in rows
        if row.comparison == IN_LOOP and "with_network" in row.mae
    }
    loops = []
    for row in run.fit.loops:
        if row.channel not in run.fit.channels:
            continue
        if other := networks.get((row.recording, row.channel)):
            added = {
                "mae": {**row.mae, "with_network": other.mae["with_network"]},
                "rms": {**row.rms, "with_network": other.rms["with_network"]},
            }
            row = row.model_copy(update=added)
        loops.append(row)
    return (*(row for row in rows if row.comparison == REPLAYED), *loops)


def _rows(run: RunData) -> Iterator[RecordingError]:
    residual, fit = run.residual, run.fit
    if residual is None or fit is None:
        return
    columns = residual.columns
    held = columns["part"] == 1
    named = run.diagnosis is None or bool(run.diagnosis.causes)
    for k in np.unique(columns["recording"][held]).astype(int).tolist():
        if not 0 <= k < len(fit.recordings):
            continue
        recording = fit.recordings[k]
        rows = held & (columns["recording"] == k)
        for comparison in ENDINGS:
            scored = rows & (columns["window"] >= 0) if comparison == REPLAYED else rows
            for channel in fit.channels:
                measured = columns.get(channel)
                if measured is None:
                    continue
                seen = scored & np.isfinite(measured)
                models: dict[str, NDArray[np.float64] | None] = {
                    name: trace[seen]
                    for kind, name in ENDINGS[comparison].items()
                    if (trace := residual.of(channel, kind)) is not None
                    and (name != "with_cause" or named)
                }
                # a loop that could not be simulated stands as zeros
                still = comparison == IN_LOOP and not any(np.any(v) for v in models.values())
                if models and seen.any() and not still:
                    yield recording_error(
                        recording.name, recording.known, comparison, channel, measured[seen], models
                    )


def known_words(known: Mapping[str, float]) -> str:
    """inertia_kg_m2 0.0896, payload_kg 2."""
    return ", ".join(f"{name} {value:g}" for name, value in known.items())


def recording_errors_table(rows: Sequence[RecordingError]) -> Markup:
    """The rows as a table of a page: MAE, and RMS in parentheses."""
    models = models_of([row.mae for row in rows])
    heads = ["recording", "known", "comparison", "channel", "unit", "samples"]
    heads += [f"{MODEL_NAMES[name]}: MAE (RMS)" for name in models]
    body = [
        [
            formatting.clean(row.recording),
            formatting.clean(known_words(row.known)) or formatting.DASH,
            COMPARISON_NAMES.get(row.comparison, formatting.clean(row.comparison)),
            channel_label(row.channel),
            channel_unit(row.channel) or "-",
            count(row.samples),
            *(_cell(row, name) for name in models),
        ]
        for row in rows
    ]
    return table(heads, body, range(5, len(heads)))


def recording_errors_text(rows: Sequence[RecordingError]) -> str:
    """The same in plain text, columns aligned; the samples are left out."""
    models = models_of([row.mae for row in rows])
    names = [MODEL_NAMES[name] for name in models]
    lines = [["MAE (RMS)", "known", "comparison", "channel", *names]]
    lines += [
        [
            row.recording,
            known_words(row.known) or "-",
            COMPARISON_NAMES.get(row.comparison, row.comparison),
            f"{channel_label(row.channel)} [{channel_unit(row.channel) or '-'}]",
            *(_cell(row, name) for name in models),
        ]
        for row in rows
    ]
    return aligned(lines, 4)


def _cell(row: RecordingError, model: str) -> str:
    if model not in row.mae:
        return formatting.DASH
    error, root = row.mae[model], row.rms[model]
    return "unstable" if error is None else f"{number(error)} ({number(root)})"
