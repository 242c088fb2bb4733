"""Columns, notes and text of `pamid generate-aprbs`, from its arguments."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.api.exciting import pulse_excitation, release_excitation, within_limits
from pamid.api.options.exciting import SEEDED, ExcitationArguments
from pamid.base.errors import FileError, PamidError, UsageError, nearest
from pamid.base.schemas.excitation_file import SignalCoverage
from pamid.base.units import NONE, split_column
from pamid.model.registry import rig_named
from pamid.model.rig import Rig
from pamid.recording.recording import Recording
from pamid.rigs.muscle_experiments import PULSES_S, RELEASE_DEG, RELEASE_S, held_pressure
from pamid.rigs.simulators.safe_excitation import SafeExcitation
from pamid.simulation.excitation.aprbs import coverage
from pamid.simulation.excitation.experiments import (
    at_rest,
    bounds_of,
    excitable,
    external_columns,
    held_level,
    rest_level,
    usual_centre,
    usual_half,
)
from pamid.simulation.excitation.waveforms import SIGNAL_SETTINGS, draw, plan_for

DUTY = 0.3  # default largest duty of a staircase, whose purpose is small commands


@dataclass(frozen=True)
class PlannedExcitation:
    """Columns of an excitation with their description.

    about      entries of the JSON
    sentences  lines for people
    meta       tables of the TOML next to the excitation
    shown      fields of a `report.excitation_figure.ExcitedColumn` per column
    """

    columns: dict[str, NDArray[Any]]
    about: dict[str, Any]
    sentences: list[str]
    meta: dict[str, Any] = field(default_factory=dict)
    shown: list[dict[str, Any]] = field(default_factory=list)


def with_rig_defaults(request: ExcitationArguments) -> ExcitationArguments:
    """Options with the rig's defaults for period, hold times and length.

    The three go together: a slower rig has longer hold times, and needs a longer excitation.
    """
    try:
        rig = rig_named(request.rig)
    except PamidError:
        # columns named by hand need no rig
        if request.column is None:
            raise
        rig = Rig()
    slower = rig.hold_s[1] / Rig.hold_s[1]
    usual: dict[str, Any] = {"period": rig.period_s}
    if request.experiment == "aprbs" and slower != 1.0:
        settings = SIGNAL_SETTINGS[request.signal]
        if "hold_s" in settings:
            usual["hold"] = (
                rig.hold_s
                if request.signal == "aprbs"
                else tuple(slower * hold for hold in settings["hold_s"])
            )
        usual["duration"] = slower * settings.get("duration_s", 0.0) or None
    missing = {name: value for name, value in usual.items() if getattr(request, name) is None}
    return replace(request, **missing)


def planned_excitation(request: ExcitationArguments) -> PlannedExcitation:
    """Build the excitation that arguments with the defaults of their rig describe."""
    plan = {"aprbs": _signals, "valve-pulses": _pulses, "gravity-test": _gravity}
    return plan[request.experiment](request)


# ---- signals -----------------------------------------------------------------------------------


def _signals(request: ExcitationArguments) -> PlannedExcitation:
    signal, period, limit = request.signal, request.period_s, request.rate_limit
    options: dict[str, Any] = {
        "duration_s": request.duration,
        "hold_s": request.hold,
        "levels": request.levels,
        "band_hz": request.band,
        "sweep": request.sweep,
        "periods": request.periods,
    }
    plan = plan_for(
        signal,
        period,
        rate_limit=limit,
        seed=request.seed,
        **{name: value for name, value in options.items() if name in SIGNAL_SETTINGS[signal]},
    )
    sending = _sending(request)
    amplitudes, offsets = sending.amplitudes, sending.offsets
    sent = draw(plan, amplitudes, offsets, sending.ramped, sending.rests)
    columns = {column: item.samples for column, item in sent.items()}
    safe = _within_limits(request, columns, offsets)
    if safe is not None:
        columns = {column: safe.columns[column] for column in sent}
    each, lines, shown = [], [], []
    for column, item in sent.items():
        unit = split_column(column)[1]
        reach = _reach(safe, column, offsets[column], amplitudes[column])
        excited = columns[column][item.turn]
        covers = coverage(excited, period, span=reach)
        same = [n for n in SignalCoverage.model_fields if n not in ("changes", "sentences")]
        changes = None
        if covers.changes is not None:
            changes = {
                "size_edges": [0.0, 0.25, 0.5, 0.75, 1.0],
                "pace_edges_hz": covers.changes.edges_hz,
                "share_of_time": covers.changes.share,
            }
        each.append(
            {
                "column": column,
                "unit": unit,
                "range": list(reach),
                **item.settings,
                "coverage": {
                    **{name: getattr(covers, name) for name in same},
                    "changes": changes,
                    "sentences": covers.sentences(),
                },
            }
        )
        shown.append(
            {
                "column": column,
                "unit": unit,
                "samples": excited,
                "covers": covers,
                "rate_limit": limit,
                "band_hz": plan.settings.get("band_hz"),
            }
        )
        lines += [f"  {column}:"] if len(sent) > 1 else []
        lines += [f"  {sentence}" for sentence in covers.sentences()]
        if column in sending.ramped:
            lines += [f"  {column} is imposed: ramps connect its levels."]
    lines += [f"  {sentence}" for sentence in (*sending.notes, *(safe.sentences() if safe else ()))]
    samples = len(next(iter(columns.values())))
    held: dict[str, Any] = {name: np.full(samples, at) for name, at in sending.held.items()}
    meta: dict[str, Any] = {}
    if signal == "torque-loops":
        rig, pressure = rig_named(request.rig), request.pressure
        held = at_rest(rig, samples)
        meta = _meta(request, {} if pressure is None else held_pressure(rig, pressure))
    settings = {name: value for name, value in plan.settings.items() if name != "duration_s"}
    # a single column stands at the top level, several in a list
    alone = each[0] if len(each) == 1 else {}
    about: dict[str, Any] = {
        "signal": signal,
        "loop": "open" if meta else request.loop,
        **(
            {key: alone[key] for key in ("column", "unit", "range")} if alone else {"columns": each}
        ),
        **settings,
        "rate_limit_per_s": limit,
        **({"seed": request.seed} if signal in SEEDED else {}),
        **({"known": meta["known"]} if "known" in meta else {}),
        **_clock(request, columns),
        **({"coverage": alone["coverage"]} if alone else {}),
    }
    if safe is not None:
        about["limits"] = safe.limits.as_json()
    return PlannedExcitation({**held, **columns}, about, lines, meta, shown)


def _within_limits(
    request: ExcitationArguments, columns: dict[str, NDArray[Any]], offsets: Mapping[str, float]
) -> SafeExcitation | None:
    """Excitation within the limits of the rig, if it is a model that states limits."""
    safe, speeds = None, request.speed_limit
    if request.limits:
        try:
            safe = within_limits(
                request.rig, columns, request.period_s, centres=offsets, speed_limits=speeds
            )
        except FileError:
            if request.column is None:
                raise  # a column named by hand needs no rig
    if speeds and safe is None:
        raise UsageError("--speed-limit needs a MuJoCo or URDF model, and excludes --no-limits.")
    return safe


def _reach(
    safe: SafeExcitation | None, column: str, centre: float, amplitude: float
) -> tuple[float, float]:
    """Lowest and highest value of a column after the limits were applied."""
    for command in safe.limits.commands if safe else ():
        if command.column == column:
            centre, amplitude = centre + command.shift, command.factor * amplitude
    return centre - amplitude, centre + amplitude


@dataclass(frozen=True)
class _Sending:
    """Columns to drive, each value in the unit of its column.

    amplitudes, offsets, rests  amplitude, centre and first value of each column
    held                        value of each constant input
    ramped                      columns with ramps between the levels
    notes                       sentences for people
    """

    amplitudes: dict[str, float]
    offsets: dict[str, float]
    rests: dict[str, float]
    held: dict[str, float]
    ramped: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def _columns(request: ExcitationArguments) -> tuple[dict[str, float | None], Rig | None]:
    """Columns to excite with their default amplitudes, and the rig if the columns belong to it."""
    named = request.column
    try:
        rig = rig_named(request.rig)
    except PamidError:
        if named is None:
            raise
        return {named: None}, None
    if request.signal == "torque-loops":
        return dict(external_columns(rig)), None
    if named is not None and named not in (*rig.inputs, *(q.reference for q in rig.loops)):
        return {named: None}, None
    excited = excitable(rig, request.loop) if named is None else (named,)
    usual = {name: usual_half(rig, name) for name in excited}
    if request.signal == "staircase" and request.loop == "open" and rig.loops:
        duties = [name for name in usual if split_column(name)[1] == NONE]
        usual |= {name: min(usual[name] or DUTY, DUTY) for name in duties}
    return usual, rig


def _sending(request: ExcitationArguments) -> _Sending:
    """Columns to drive and their ranges."""
    given, offset = request.amplitude, request.offset
    columns, rig = _columns(request)
    for name in given:
        if name and name not in columns:
            raise UsageError(
                f"--amplitude {name}: the columns are {', '.join(columns)}.", nearest(name, columns)
            )
    limits, notes = rig or Rig(), list[str]()
    amplitudes, centres = {}, {}
    for name, usual in columns.items():
        amplitude = given.get(name, given.get("", usual))
        if amplitude is None:
            raise UsageError(
                f"{name} needs an --amplitude: the rig states no default for it.",
                f"Write --amplitude {name}=A, in the unit of the column, and --offset for its "
                f'centre; or state excited = {{"{name}": A}} and centre in the rig.',
            )
        low, high = bounds_of(limits, name)
        centre = usual_centre(limits, name, amplitude) if offset is None else offset
        allowed = f"+-{high:g}" if low == -high else f"{low:g} .. {high:g}"
        # sums of decimal fractions miss a bound by their last digit
        slack = 1e-9 * amplitude
        if centre - amplitude < low - slack or centre + amplitude > high + slack:
            reach = max(centre + amplitude, amplitude - centre)
            raise UsageError(
                f"{name} lies within {allowed}; amplitude and offset reach {reach:g}.",
                "Give both in the unit of the column, as the rig's limits are.",
            )
        if offset is None and centre != (stated := limits.centre.get(name, 0.0)):
            notes.append(
                f"{name}: centre moved from {stated:g} to {centre:g} to stay within {allowed}."
            )
        amplitudes[name], centres[name] = amplitude, centre
    rests = {name: rest_level(limits, name, centres[name], amplitudes[name]) for name in amplitudes}
    held, remarks = _held(limits, amplitudes) if request.signal != "torque-loops" else ({}, [])
    return _Sending(amplitudes, centres, rests, held, limits.ramped, (*notes, *remarks))


def _held(rig: Rig, excited: Collection[str]) -> tuple[dict[str, float], list[str]]:
    """Required inputs of the rig that are not excited, with their constant value, and notes."""
    held, notes = dict[str, float](), list[str]()
    for name in rig.inputs:
        if name in {*rig.optional, *(q.command for q in rig.loops), *excited}:
            continue
        level = held_level(rig, name)
        if level is None:
            notes.append(
                f"{name} is not excited and left out. Add it as recorded, or state "
                f'centre = {{"{name}": ...}} in the rig.'
            )
        else:
            held[name] = level
            notes.append(f"{name} is not excited: it stays at {level:g}.")
    return held, notes


# ---- tests of the muscles and of the links -----------------------------------------------------


def _pulses(request: ExcitationArguments) -> PlannedExcitation:
    sent = pulse_excitation(
        request.rig, muscles=request.muscle, level=request.level, period_s=request.period
    )
    pulsed = list(request.muscle or rig_named(request.rig).actuators)
    lengths = ", ".join(f"{1e3 * s:g}" for s in PULSES_S)
    lines = [
        f"  Muscle {' then '.join(pulsed)}: vented and filled again for {lengths} ms at a duty of "
        f"{request.level:g}.",
        f"  A fit would hold out the last 30 %, the pulses of muscle {pulsed[-1]}. Record another "
        "order for --held-out.",
    ]
    return _experiment(request, sent, {"muscles": pulsed, "level": request.level}, lines)


def _gravity(request: ExcitationArguments) -> PlannedExcitation:
    sent = release_excitation(
        request.rig,
        request.release or RELEASE_DEG,
        payload_kg=request.payload,
        clamped=request.clamped,
        duration_s=RELEASE_S if request.duration is None else request.duration,
        period_s=request.period,
    )
    lines = [
        "  Nothing is sent: "
        + ", ".join(f"{name} = {value:g}" for name, value in sent.known.items())
        + ".",
        "  Cannot show: valves, and the properties of the muscles that depend on pressure.",
        "  A fit would hold out the last 30 %, the end of the swing. Record another release for "
        "--held-out.",
    ]
    return _experiment(request, sent, {"known": sent.known}, lines)


def _experiment(
    request: ExcitationArguments, sent: Recording, details: dict[str, Any], lines: list[str]
) -> PlannedExcitation:
    """Excitation of an experiment, with its JSON entries."""
    ranges = [
        {"column": name, "unit": split_column(name)[1], "range": [float(v.min()), float(v.max())]}
        for name, v in sent.columns.items()
    ]
    about = {
        "experiment": request.experiment,
        "loop": "open",
        "columns": ranges,
        **details,
        **_clock(request, sent.columns),
    }
    return PlannedExcitation(sent.columns, about, lines, _meta(request, sent.known))


def _meta(request: ExcitationArguments, known: dict[str, float]) -> dict[str, Any]:
    about = {"rig": request.rig, "loop": "open", "sampling_period_s": request.period_s}
    return {"recording": about, **({"known": known} if known else {})}


def _clock(request: ExcitationArguments, columns: dict[str, NDArray[Any]]) -> dict[str, Any]:
    return {"sampling_period_s": request.period_s, "samples": len(next(iter(columns.values())))}
