"""Free runs: a model over every whole recording, each from an estimated state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pamid.base.arrays import Array
from pamid.base.csv_table import table_bytes
from pamid.base.units import from_si, split_column, with_unit
from pamid.engine.program import Stepping
from pamid.model.assembly import Assembly
from pamid.simulation.data_split import DataSplit, Span
from pamid.simulation.replay import WHOLE, Replay, replay_track

OVER_RECORDINGS = "in free runs of the fitted model over the recordings"


def free_runs(e: DataSplit, assembly: Assembly, p: Array, stepping: Stepping) -> tuple[Replay, ...]:
    """A model at parameters p (SI) over every whole recording; of an excerpt, over every stretch.
    In the order of the rows of residual.csv."""
    # Over fitted and held-out parts in a single run: a new start at the seam would hide a drift.
    tracks = replace(e, fit=whole_spans(e)).tracks(assembly)
    return tuple(replay_track(assembly, p, t, stepping, e.noise, per_run=WHOLE) for t in tracks)


def whole_spans(e: DataSplit) -> tuple[Span, ...]:
    """Fitted and held-out spans, by recording and in order of time; adjacent ones are joined."""
    place = {id(r): k for k, r in enumerate(e.recordings)}
    whole: list[Span] = []
    for s in sorted((*e.fit, *e.held_out), key=lambda s: (place[id(s.recording)], s.start)):
        if whole and whole[-1].recording is s.recording and whole[-1].stop == s.start:
            whole[-1] = replace(whole[-1], stop=s.stop)
        else:
            whole.append(s)
    return tuple(whole)


def free_run_csv(e: DataSplit, models: Mapping[str, tuple[Replay, ...]]) -> bytes:
    """free-run.csv as bytes, with the rows of residual.csv. models: free runs by the kind of trace
    that names their columns; blank where a run became unstable."""
    places = {id(r): float(k) for k, r in enumerate(e.recordings)}
    spans = whole_spans(e)
    header = ["time_s", "recording"]
    columns = [
        np.concatenate([s.recording.time[s.start : s.stop] for s in spans]),
        np.concatenate([np.full(s.stop - s.start, places[id(s.recording)]) for s in spans]),
    ]
    for kind, runs in models.items():
        outputs = np.concatenate([np.where(r.finite, r.model, np.nan) for r in runs])
        for channel, y in zip(e.channels, outputs.T, strict=True):
            stem, unit = split_column(channel)
            header.append(with_unit(f"{stem}_{kind}", unit))
            columns.append(from_si(y, unit))
    formats = ["%.12g"] + ["%.9g"] * (len(header) - 1)
    return table_bytes(header, np.column_stack(columns), formats, blank=True)
