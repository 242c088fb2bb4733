"""From recordings to a fitted model and its figures: what `pamid fit` writes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.progress import Progress, silent
from pamid.base.units import as_column, from_si, split_column, with_unit
from pamid.engine.program import Stepping
from pamid.estimation.gauss_newton import Fit, Problem, fit_robustly, free_parameters
from pamid.estimation.identifiable_combinations import Combination, combinations_of
from pamid.estimation.intervals import background_pull, bootstrap, estimates
from pamid.estimation.posterior import Posterior, posterior_of, started_from
from pamid.estimation.quantities import agreed
from pamid.estimation.restart import freed
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment
from pamid.model.bound_parameter import Sizes
from pamid.model.rig import Loop
from pamid.parallel.jobs import WorkerPool
from pamid.recording.recording import Recording
from pamid.schemas import fit as result
from pamid.simulation.data_split import Evidence, Span
from pamid.simulation.replay import Replay, channel_mae, noise_floor, replay
from pamid.simulation.simulate import choose_stepping, input_table, port_sizes
from pamid.simulation.windows import Runner, Track
from pamid.symbolic.expression import symbol

Array = NDArray[np.float64]

COARSE = 0.2  # noise standard deviations by which doubled sub-steps may change an output
PERTURBED = 1e-3  # relative change of a parameter for the closed loop's perturbation band


@dataclass(frozen=True, eq=False)
class GreyBox:
    """A fitted model with its replays. recheck: change of the outputs by doubled sub-steps, in
    noise sd."""

    evidence: Evidence
    assembly: Assembly
    fit: Fit
    recheck: float
    held_out: tuple[Replay, ...]
    data_sheet: tuple[Replay, ...]
    floor: tuple[Replay, ...]
    draws: Array | None = None
    earlier: Posterior | None = None


def model_with(evidence: Evidence, attached: tuple[Attachment, ...], sizes: Sizes) -> Assembly:
    """The model that is fitted and compared: rig, background, these effects, the measured
    channels."""
    return Assembly(
        evidence.rig, attached, background=True, sizes=sizes, outputs=evidence.channels
    ).for_fitting()


def fit_model(
    evidence: Evidence,
    attached: tuple[Attachment, ...] = (),
    *,
    seed: int = 0,
    draws: int = 0,
    jobs: int = 1,
    progress: Progress = silent,
    earlier: Posterior | None = None,
    pool: WorkerPool | None = None,
) -> GreyBox:
    """Fit the rig (with effects) to the evidence; integration refined until doubled sub-steps
    change nothing.

    earlier: what another fit has left known of the same rig; it takes the place of the data sheet's
    prior. draws: of the bootstrap; pool: who does them (default: `jobs` processes of this machine).
    """
    if earlier is not None:
        earlier.require_new(evidence)
    plain = Assembly(evidence.rig)
    sizes = port_sizes(
        plain,
        [
            (t.u, Runner(plain, t, Stepping()).parameters(plain.values()), t.period_s)
            for t in evidence.tracks(plain)
        ],
    )
    assembly = model_with(evidence, attached, sizes)
    tracks, held = evidence.tracks(assembly), evidence.tracks(assembly, held_out=True)
    problem = Problem(assembly, tracks, free_parameters(assembly, tracks))
    if earlier is not None:
        problem = replace(problem, prior=earlier.prior(problem))
    progress("fitting")
    fitted = freed(
        fit_robustly(
            problem, progress=lambda i, cost: progress(f"fitting, step {i}, cost {cost:.5g}")
        ),
        evidence.noise,
    )
    replays, change = rechecked(assembly, fitted, held, evidence.noise)
    for _ in range(3):
        if change <= COARSE:
            break
        progress("refining the integration step")
        fitted = freed(fit_robustly(problem, stepping=fitted.stepping.doubled()), evidence.noise)
        replays, change = rechecked(assembly, fitted, held, evidence.noise)
    progress("noise floor")
    floor = tuple(
        noise_floor(assembly, fitted.p, r, fitted.stepping, evidence.noise, seed + i)
        for i, r in enumerate(replays)
    )
    sheet = tuple(
        replay(assembly, assembly.values(), t, fitted.stepping, evidence.noise) for t in held
    )
    return GreyBox(
        evidence,
        assembly,
        fitted,
        change,
        replays,
        sheet,
        floor,
        bootstrap(fitted, draws, seed=seed, jobs=jobs, pool=pool) if draws else None,
        earlier,
    )


def rechecked(
    assembly: Assembly, fitted: Fit, held: tuple[Track, ...], noise: Array
) -> tuple[tuple[Replay, ...], float]:
    """Held-out replays, and by how much doubled sub-steps change them: worst channel, in noise
    standard deviations or in quarters of what the model leaves, whichever is larger (a step finer
    than the model is wrong buys nothing)."""
    once = tuple(replay(assembly, fitted.p, t, fitted.stepping, noise) for t in held)
    twice = [replay(assembly, fitted.p, t, fitted.stepping.doubled(), noise) for t in held]
    change = []
    # a model that runs away: the change is no number, not small
    with np.errstate(over="ignore", invalid="ignore"):
        for a, b in zip(once, twice, strict=True):
            left = np.sqrt((a.residual[a.scored] ** 2).mean(axis=0))
            moved = np.sqrt(((a.model - b.model)[a.scored] ** 2).mean(axis=0))
            change.append((moved / np.maximum(noise, 0.25 * left)).max())
    return once, float(max(change))


def fit_json(g: GreyBox, seed: int) -> dict[str, Any]:
    """fit.json: parameters with intervals and words, errors per channel on what was held out."""
    e = g.evidence
    figures = {
        "data_sheet": channel_mae(list(g.data_sheet)),
        "refitted": channel_mae(list(g.held_out)),
        "noise_floor": channel_mae(list(g.floor)),
    }
    told, ties = combinations_of(g.fit, g.draws)
    found = result.FitFile(
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
                lacks=tuple(e.lacking(r)),
            )
            for r in e.recordings
        ),
        channels=tuple(e.channels),
        converged=g.fit.converged,
        why=g.fit.why,
        iterations=g.fit.iterations,
        stepping=result.CheckedSteps(
            substeps=g.fit.stepping.substeps,
            implicit=g.fit.stepping.implicit,
            recheck=g.recheck,
        ),
        noise={c: as_column(c, e.noise[i]) for i, c in enumerate(e.channels)},
        parameters={
            x.name: result.FitParameter(
                value=x.value,
                low=x.low,
                high=x.high,
                prior=x.prior,
                unit=x.bound.unit,
                word=x.word,
                at_bound=x.at_bound,
                strain=x.strain,
                source=x.bound.source,
            )
            for x in estimates(g.fit, g.draws)
            if not x.bound.nuisance
        },
        intervals="block bootstrap" if g.draws is not None else "Jacobian",
        background={k: result.BackgroundPull(pull=v) for k, v in background_pull(g.fit).items()},
        mae={
            c: {k: as_column(c, v[i]) for k, v in figures.items()} for i, c in enumerate(e.channels)
        },
        closed_loop=closed_loop_figures(g),
        combinations={c.name: _combination(c) for c in told},
        tied=tuple(
            result.Tie(parameters=t.parameters, directions=t.directions, known=t.known)
            for t in ties
        ),
        posterior=posterior_of(g.fit),
        model=fitted_model(g.assembly, g.fit),
    )
    if g.earlier is not None:
        began = started_from(g.earlier, g.earlier.remarks(g.fit.problem))
        found = found.model_copy(update={"from_": began})
    return found.as_json()


def _combination(c: Combination) -> result.Combination:
    return result.Combination(
        value=c.value,
        low=c.low,
        high=c.high,
        prior=c.prior,
        unit=c.unit,
        word=c.word,
        members=c.members,
        declared=c.declared,
    )


def model_json(a: Assembly, fitted: Fit) -> dict[str, Any]:
    """The same as `fitted_model`, as JSON."""
    return fitted_model(a, fitted).as_json()


def fitted_model(a: Assembly, fitted: Fit) -> result.FittedModel:
    """What rebuilds a fitted model to the last bit: its effects, every parameter (SI) by key, and
    its steps."""
    return result.FittedModel(
        effects=tuple(one.label for one in a.attachments),
        stepping=result.Steps(substeps=fitted.stepping.substeps, implicit=fitted.stepping.implicit),
        values={b.key: float(v) for b, v in zip(a.parameters, agreed(fitted), strict=True)},
    )


def _role(e: Evidence, recording: Recording) -> str:
    fit = any(s.recording is recording for s in e.fit)
    held = any(s.recording is recording for s in e.held_out)
    return "both" if fit and held else "fit" if fit else "held-out"


# ---- the model in its own loop -----------------------------------------------------------------


def loop_run(g: GreyBox, r: Recording, p: Array) -> dict[str, Array] | None:
    """The model under its own controller over a whole recording; columns in their own units.

    None where the recording has no controller or no reference. Keys: the controlled reading, its
    velocity and acceleration, and the command.
    """
    rig = g.evidence.rig
    if r.loop != "closed" or not rig.loops or not all(r.has(q.reference) for q in rig.loops):
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
    u = input_table(a, r)
    step = choose_stepping(a, u, values, r.sampling_period_s, a.start(values))
    program = a.program_with({q.command: symbol("cell", q.command) for q in rig.loops})
    memory = program.memory(a.start(values), stepping=step, period_s=r.sampling_period_s)
    Y, _, bad = program.run(memory, u, values, period_s=r.sampling_period_s, stepping=step)
    if bad >= 0:
        return None
    return {n: from_si(Y[:, i], split_column(n)[1]) for i, n in enumerate(program.outputs)}


def closed_loop_figures(g: GreyBox) -> dict[str, result.LoopError] | None:
    """MAE of the model in its own loop over the held-out part, with the band a 0.1 % change of
    conductance-like (logarithmic) parameters moves it by; None where no recording was made in a
    closed loop."""
    runs = {"data_sheet": g.assembly.values(), "refitted": g.fit.p}
    errors: dict[str, dict[str, list[float]]] = {}
    for span in g.evidence.held_out:
        for name, p in runs.items():
            _collect(errors, name, loop_run(g, span.recording, p), span)
        for k in g.fit.problem.free:
            if g.assembly.parameters[k].log:
                nearby = g.fit.p.copy()
                nearby[k] *= 1.0 + PERTURBED
                _collect(errors, "moved", loop_run(g, span.recording, nearby), span)
    if not errors:
        return None
    out = {}
    for column, by in errors.items():
        refitted = float(np.mean(by["refitted"])) if by.get("refitted") else None
        moved = by.get("moved", [])
        band = (
            max((abs(m - refitted) for m in moved), default=0.0) if refitted is not None else None
        )
        out[column] = result.LoopError(
            data_sheet=float(np.mean(by["data_sheet"])) if by.get("data_sheet") else None,
            refitted=refitted,
            band=band,
        )
    return out


def _collect(
    errors: dict[str, dict[str, list[float]]], name: str, found: dict[str, Array] | None, span: Span
) -> None:
    if found is None:
        return
    for column, values in found.items():
        if span.recording.has(column):
            gap = np.abs(values - span.recording.signal(column))[span.start : span.stop]
            errors.setdefault(column, {}).setdefault(name, []).append(float(gap.mean()))


# ---- residual.csv ------------------------------------------------------------------------------


def residual_table(g: GreyBox, cause: tuple[Replay, ...] = ()) -> tuple[list[str], Array]:
    """Header and rows of residual.csv: measured, data sheet, refitted (and with the cause) over
    everything."""
    e, header, rows = g.evidence, ["time_s", "recording", "part", "window"], []
    spans = [(0, s) for s in e.fit] + [(1, s) for s in e.held_out]
    fitted = [replay(g.assembly, g.fit.p, t, g.fit.stepping, e.noise) for t in e.tracks(g.assembly)]
    sheet = [
        replay(g.assembly, g.assembly.values(), t, g.fit.stepping, e.noise)
        for t in e.tracks(g.assembly)
    ]
    fitted += g.held_out
    sheet += g.data_sheet
    for c in e.channels:
        stem, unit = split_column(c)
        header += [c, with_unit(f"{stem}_data_sheet", unit), with_unit(f"{stem}_refitted", unit)]
        header += [with_unit(f"{stem}_cause", unit)] if cause else []
    inputs = [n for n in e.rig.inputs if all(r.has(n) for r in e.recordings)]
    loops = [
        q
        for q in e.rig.loops
        if all(r.loop == "closed" and r.has(q.reference) for r in e.recordings)
    ]
    header += inputs + [q.reference for q in loops]
    for q in loops:
        header += loop_names(q, len(loops) > 1)
    for i, (part, s) in enumerate(spans):
        r = s.recording
        n = s.stop - s.start
        own = [i for i, k in enumerate(e.recordings) if k is r][0]
        window = np.full(n, -1.0)
        for w, cutout in enumerate(fitted[i].windows):
            inside = np.arange(cutout.start, cutout.stop)
            window[inside[fitted[i].scored[inside]]] = w
        table: list[Array] = [
            r.time[s.start : s.stop],
            np.full(n, float(own)),
            np.full(n, float(part)),
            window,
        ]
        for k, c in enumerate(e.channels):
            table += [
                from_si(y, split_column(c)[1])
                for y in (fitted[i].track.y[:, k], sheet[i].model[:, k], fitted[i].model[:, k])
            ]
            if cause:
                after = cause[i - len(e.fit)].model[:, k] if part else fitted[i].model[:, k]
                table.append(from_si(after, split_column(c)[1]))
        table += [r.signal(n_)[s.start : s.stop] for n_ in inputs + [q.reference for q in loops]]
        table += _loop_columns(g, s, loops)
        rows.append(np.stack(table, axis=1))
    return header, np.concatenate(rows)


def _loop_columns(g: GreyBox, span: Span, loops: list[Loop]) -> list[Array]:
    """Angle, velocity, acceleration and command of the refitted model in its own loop over a
    span."""
    if not loops:
        return []
    found = loop_run(g, span.recording, g.fit.p)
    n, period = span.stop - span.start, span.recording.sampling_period_s
    out: list[Array] = []
    for q in loops:
        if found is None:
            out += [np.zeros(n)] * 4
            continue
        out += [
            c[span.start : span.stop]
            for c in loop_motion(found[q.reading], found[q.command], period)
        ]
    return out


def loop_names(q: Loop, several: bool) -> list[str]:
    """Columns of a model in its own loop: reading, its velocity and acceleration, command; of
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


def residual_csv(g: GreyBox, cause: tuple[Replay, ...] = ()) -> bytes:
    """residual.csv as bytes, 9 significant digits."""
    header, rows = residual_table(g, cause)
    line = ",".join(["%.12g"] + ["%.9g"] * (len(header) - 1)) + "\n"
    body = (line * len(rows)) % tuple(rows.ravel().tolist())
    if np.isnan(rows).any():
        body = body.replace("nan", "")  # a channel that this recording lacks
    return (",".join(header) + "\n" + body).encode()
