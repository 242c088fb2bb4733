"""Files of `pamid fit`: fit.json and residual.csv."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.csv_table import table_bytes
from pamid.base.schemas import fit_file as result
from pamid.base.units import column_size, from_si, split_column, with_unit
from pamid.estimation.closed_loop import closed_loop_figures, loop_columns, loop_errors, loop_names
from pamid.estimation.grey_box import GreyBox
from pamid.estimation.identifiable_combinations import combinations_of, reported_parameters
from pamid.estimation.intervals import background_pull
from pamid.estimation.posterior import posterior_of, started_from
from pamid.estimation.problem import Fit
from pamid.estimation.quantities import reported_values
from pamid.model.assembly import Assembly
from pamid.model.between_samples import between_of
from pamid.recording.recording import Recording
from pamid.simulation.data_split import DataSplit
from pamid.simulation.replay import Replay, channel_mae, replay_track


def fit_json(
    g: GreyBox, seed: int, cause: GreyBox | None = None, notes: Sequence[str] = ()
) -> dict[str, Any]:
    """fit.json: parameters with intervals and words, errors per channel on what was held out.
    cause: the model with the causes, for its errors in closed loop; notes: sentences."""
    e = g.evidence
    figures = {
        "data_sheet": channel_mae(list(g.data_sheet)),
        "refitted": channel_mae(list(g.held_out)),
        "noise_floor": channel_mae(list(g.floor)),
    }
    combinations, ties = combinations_of(g.fit, g.draws)
    file = result.FitFile(
        rig=e.rig.name,
        effects=tuple(a.label for a in g.assembly.attachments),
        seed=seed,
        recordings=tuple(
            result.RecordingUsed(
                name=r.name,
                path=str(r.path),
                sha256=r.sha256,
                role=_role(e, r),
                samples=len(r),
                period_s=r.sampling_period_s,
                loop=r.loop,
                controller=r.controller,
                known=dict(r.known),
                lacks=tuple(e.lacking(r)),
            )
            for r in e.recordings
        ),
        channels=tuple(e.channels),
        inputs=recorded_inputs(e),
        converged=g.fit.converged,
        why=g.fit.why,
        iterations=g.fit.iterations,
        stepping=result.CheckedSteps(
            substeps=g.fit.stepping.substeps,
            implicit=g.fit.stepping.implicit,
            recheck=g.recheck,
        ),
        noise={c: column_size(c, e.noise[i]) for i, c in enumerate(e.channels)},
        parameters={
            b.full_name: e for b, e in reported_parameters(g.fit, g.draws).items() if not b.nuisance
        },
        intervals="block bootstrap" if g.draws is not None else "Jacobian",
        background={k: result.BackgroundPull(pull=v) for k, v in background_pull(g.fit).items()},
        mae={
            c: {k: column_size(c, v[i]) for k, v in figures.items()}
            for i, c in enumerate(e.channels)
        },
        closed_loop=closed_loop_figures(g),
        combinations=combinations,
        tied=ties,
        posterior=posterior_of(g.fit),
        model=fitted_model(g.assembly, g.fit),
    )
    if loops := loop_errors(g, cause):
        file = file.model_copy(update={"loops": loops})
    if noted := tuple(filter(None, [e.rig.form_note, *notes])):
        file = file.model_copy(update={"notes": noted})
    if g.earlier is not None:
        began = started_from(g.earlier, g.earlier.remarks(g.fit.problem))
        file = file.model_copy(update={"from_": began})
    return file.as_json()


def model_json(a: Assembly, fitted: Fit) -> dict[str, Any]:
    """The same as `fitted_model`, as JSON."""
    return fitted_model(a, fitted).as_json()


def fitted_model(a: Assembly, fitted: Fit) -> result.FittedModel:
    """Data that rebuild a fitted model to the last bit: its effects, every parameter (SI) by key,
    and its steps."""
    model = result.FittedModel(
        effects=tuple(attachment.label for attachment in a.attachments),
        stepping=result.Steps(substeps=fitted.stepping.substeps, implicit=fitted.stepping.implicit),
        values={
            b.key: float(v) for b, v in zip(a.parameters, reported_values(fitted), strict=True)
        },
    )
    if a.rig.form:
        model = model.model_copy(update={"form": a.rig.form})
    if not a.rig.between:
        return model
    ways = {**{column: between_of(a.rig, column) for column in a.rig.inputs}, **a.rig.between}
    return model.model_copy(update={"between": ways})


def recorded_inputs(e: DataSplit) -> tuple[str, ...]:
    """Inputs of the rig that every recording holds."""
    return tuple(n for n in e.rig.inputs if all(n in r.values for r in e.recordings))


def _role(e: DataSplit, recording: Recording) -> str:
    fit = any(s.recording is recording for s in e.fit)
    held = any(s.recording is recording for s in e.held_out)
    return "both" if fit and held else "fit" if fit else "held-out"


def residual_table(g: GreyBox, cause: GreyBox | None = None) -> tuple[list[str], Array]:
    """Header and rows of residual.csv: measured, data sheet, refitted (and the model with the
    causes) over everything."""
    e, header, rows = g.evidence, ["time_s", "recording", "part", "window"], []
    spans = [(0, s) for s in e.fit] + [(1, s) for s in e.held_out]
    fitted = [*_fitted_replays(g, g.fit.p), *g.held_out]
    sheet = [*_fitted_replays(g, g.assembly.values()), *g.data_sheet]
    with_cause = [] if cause is None else [*_fitted_replays(cause, cause.fit.p), *cause.held_out]
    for c in e.channels:
        stem, unit = split_column(c)
        header += [c, with_unit(f"{stem}_data_sheet", unit), with_unit(f"{stem}_refitted", unit)]
        header += [] if cause is None else [with_unit(f"{stem}_cause", unit)]
    inputs = list(recorded_inputs(e))
    loops = [
        q
        for q in e.rig.loops
        if all(r.loop == "closed" and q.reference in r.values for r in e.recordings)
    ]
    header += inputs + [q.reference for q in loops]
    for q in loops:
        header += loop_names(q, len(loops) > 1)
    for i, (part, s) in enumerate(spans):
        r = s.recording
        n = s.stop - s.start
        recording_number = [i for i, k in enumerate(e.recordings) if k is r][0]
        window = np.full(n, -1.0)
        for w, cutout in enumerate(fitted[i].windows):
            inside = np.arange(cutout.start, cutout.stop)
            window[inside[fitted[i].scored[inside]]] = w
        table: list[Array] = [
            r.time[s.start : s.stop],
            np.full(n, float(recording_number)),
            np.full(n, float(part)),
            window,
        ]
        for k, c in enumerate(e.channels):
            models = [sheet[i], fitted[i], *with_cause[i : i + 1]]
            table += [
                from_si(y, split_column(c)[1])
                for y in (fitted[i].track.y[:, k], *(replay.model[:, k] for replay in models))
            ]
        table += [r.shown(n_)[s.start : s.stop] for n_ in inputs + [q.reference for q in loops]]
        table += loop_columns(g, s, loops)
        rows.append(np.stack(table, axis=1))
    order = np.concatenate([np.r_[places] for places in span_rows(e)])
    table_rows = np.empty((len(order), len(header)))
    table_rows[order] = np.concatenate(rows)
    return header, table_rows


def _fitted_replays(g: GreyBox, p: Array) -> list[Replay]:
    """Replays of a model with these parameters (SI) over the fitted part."""
    return [
        replay_track(g.assembly, p, t, g.fit.stepping, g.evidence.noise)
        for t in g.evidence.tracks(g.assembly)
    ]


def span_rows(e: DataSplit) -> list[slice]:
    """Rows of residual.csv that every span holds, the fitted ones first: recording by recording, a
    recording's parts in order of time."""
    spans = (*e.fit, *e.held_out)
    place = {id(r): k for k, r in enumerate(e.recordings)}
    ordered = sorted(
        range(len(spans)), key=lambda i: (place[id(spans[i].recording)], spans[i].start)
    )
    first, rows = 0, [slice(0)] * len(spans)
    for i in ordered:
        rows[i] = slice(first, first + spans[i].stop - spans[i].start)
        first = rows[i].stop
    return rows


def residual_csv(g: GreyBox, cause: GreyBox | None = None) -> bytes:
    """residual.csv as bytes, 9 significant digits."""
    header, rows = residual_table(g, cause)
    formats = ["%.12g"] + ["%.9g"] * (len(header) - 1)
    # blank: a channel that this recording lacks
    return table_bytes(header, rows, formats, blank=True)
