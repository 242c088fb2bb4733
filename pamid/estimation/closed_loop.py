"""A fitted model under its controller: its runs, their errors, its columns in a table."""

from __future__ import annotations

from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.schemas.score_file import RecordingError
from pamid.base.units import from_si, split_column, with_unit
from pamid.engine.symbolic.expression import symbol
from pamid.estimation.grey_box import GreyBox
from pamid.model.assembly import Assembly
from pamid.model.rig import Loop
from pamid.simulation.data_split import Span
from pamid.simulation.free_runs import free_run
from pamid.simulation.rig_data import Data
from pamid.simulation.scored_recording import IN_LOOP, recording_error

PERTURBED = 1e-3  # relative change of a parameter for the closed loop's perturbation band


def loop_run(g: GreyBox, r: Data, p: Array) -> dict[str, Array] | None:
    """The model under its controller over a whole recording; columns in their units.

    None where the recording has no controller or no reference. Keys: the controlled reading, its
    velocity and acceleration, and the command.
    """
    rig = g.evidence.rig
    if not r.runs_in_loop(rig):
        return None
    settings = {**rig.controller, **r.controller}
    a = Assembly(
        rig,
        g.assembly.attachments,
        background=True,
        sizes=g.assembly.sizes,
        controller=tuple(sorted(settings.items())),
    )
    t = g.assembly.keys
    values = a.values(r.known)
    for key, i in a.keys.items():
        if key in t and not any(a.index_of(k) == i for k in r.known):
            values[i] = p[t[key]]
    commands = {q.command: symbol("cell", q.command) for q in rig.loops}
    run = free_run(a, r.inputs(a), values, r.sampling_period_s, further=commands)
    # In closed loop an unstable model has no error to report: every figure would depend on when
    # the run was cut.
    if run.blown_up >= 0:
        return None
    return {n: from_si(run.outputs[:, i], split_column(n)[1]) for i, n in enumerate(run.names)}


def closed_loop_figures(g: GreyBox) -> dict[str, Any] | None:
    """MAE of the model in closed loop over the held-out part, with its band under a 0.1 % change
    of conductance-like (logarithmic) parameters. None without a recording in a closed loop."""
    runs = [("data_sheet", g.assembly.data_sheet()), ("refitted", g.fit.p)]
    for k in g.fit.problem.free:
        if g.assembly.parameters[k].log:
            nearby = g.fit.p.copy()
            # A loop hides errors of the plant. The band shows by how much a small error would have
            # to show.
            nearby[k] *= 1.0 + PERTURBED
            runs.append(("moved", nearby))
    errors: dict[str, dict[str, list[float]]] = {}
    for span in g.evidence.held_out:
        r, part = span.recording, slice(span.start, span.stop)
        for name, p in runs:
            for column, values in (loop_run(g, r, p) or {}).items():
                if column in r.values:
                    gap = np.abs(values - r.shown(column))[part]
                    errors.setdefault(column, {}).setdefault(name, []).append(float(gap.mean()))
    if not errors:
        return None
    out = {}
    for column, by in errors.items():
        refitted = float(np.mean(by["refitted"])) if by.get("refitted") else None
        moved = by.get("moved", [])
        band = (
            max((abs(m - refitted) for m in moved), default=0.0) if refitted is not None else None
        )
        out[column] = {
            "data_sheet": float(np.mean(by["data_sheet"])) if by.get("data_sheet") else None,
            "refitted": refitted,
            "band": band,
        }
    return out


def loop_errors(g: GreyBox, cause: GreyBox | None = None) -> tuple[RecordingError, ...]:
    """Errors of every model in closed loop over the held-out part, recording by recording and
    channel by channel; cause: the model with the causes."""
    models = {"data_sheet": (g, g.assembly.data_sheet()), "refitted": (g, g.fit.p)}
    models |= {"with_cause": (cause, cause.fit.p)} if cause is not None else {}
    rows = []
    for span in g.evidence.held_out:
        r, part = span.recording, slice(span.start, span.stop)
        if not r.runs_in_loop(g.evidence.rig):
            continue
        runs = {name: loop_run(model, r, p) for name, (model, p) in models.items()}
        for c in g.evidence.channels:
            if c in r.values:
                outputs = {n: None if run is None else run[c][part] for n, run in runs.items()}
                rows.append(recording_error(r.name, r.known, IN_LOOP, c, r.shown(c)[part], outputs))
    return tuple(rows)


def loop_columns(g: GreyBox, span: Span, loops: list[Loop]) -> list[Array]:
    """Angle, velocity, acceleration and command of the refitted model in closed loop over a
    span."""
    if not loops:
        return []
    run = loop_run(g, span.recording, g.fit.p)
    n, period = len(span), span.recording.sampling_period_s
    out: list[Array] = []
    for q in loops:
        if run is None:
            out += [np.zeros(n)] * 4
            continue
        out += [
            c[span.start : span.stop] for c in loop_motion(run[q.reading], run[q.command], period)
        ]
    return out


def loop_names(q: Loop, several: bool) -> list[str]:
    """Columns of a model in closed loop: reading, its velocity and acceleration, command; of
    several loops each leads with its reading's name."""
    stem, unit = split_column(q.reading)
    of = f"{stem}_" if several else ""
    return [
        with_unit(f"{stem}_loop", unit),
        with_unit(f"{of}velocity_loop", f"{unit}/s"),
        with_unit(f"{of}acceleration_loop", f"{unit}/s2"),
        f"{q.command}_loop",
    ]


def loop_motion(reading: Array, command: Array, period_s: float) -> list[Array]:
    """The values of these columns over a run, derivatives by central differences."""
    velocity = np.gradient(reading, period_s)
    return [reading, velocity, np.gradient(velocity, period_s), command]
