"""Inputs between two samples: held, or linear to the next sample.

A converter sends a zero-order hold; a measured or filtered input moves between samples. A straight
line through its samples follows it to second order, where the hold lags by half a sample. The rig
states which (`between = {"drive_v": "linear"}`), and a recording's TOML may override it for its
inputs ([between]); the default is held. Its [free] releases parameters that the rig holds.

An output may depend on an input of the same instant, as a current on the voltage. Most logs send
the command of a row and then read; `between = {"current_a": "before"}` states that a reading of a
row is taken before: the command of the row before still acts on it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace

from pamid.base.errors import FileError, nearest
from pamid.model.rig import Rig, with_declared
from pamid.recording.file_checks import BEFORE
from pamid.recording.recording import Recording, match_column

HELD, LINEAR = "held", "linear"


def between_of(rig: Rig, column: str) -> str:
    """ "held" or "linear": the course of this input between two samples."""
    return rig.between.get(column, HELD)


def other(way: str) -> str:
    return HELD if way == LINEAR else LINEAR


def stated(rig: Rig, ways: Mapping[str, str]) -> Rig:
    """The rig with these inputs held or linear, in place of its choice; the same rig where
    nothing changes."""
    if all(between_of(rig, column) == way for column, way in ways.items()):
        return rig
    return with_declared(rig, between={**rig.between, **ways})


def released(rig: Rig, free: Mapping[str, float]) -> Rig:
    """The rig with these held parameters fitted, with these standard deviations as priors (in the
    unit of the name). A name of `Rig.on_request` frees a group, with a prior of so many spreads.
    FileError for a name that it does not have."""
    if not free:
        return rig
    names = (*(p.outside_name for p in rig.parameters), *rig.on_request)
    for name, deviation in free.items():
        if name not in names or not deviation > 0.0:
            raise FileError(
                f"[free] {name} = {deviation:g}: "
                + ("give a standard deviation above 0" if name in names else "no such parameter"),
                nearest(name, names) or f"parameters of rig {rig.name!r}: {', '.join(names)}",
                code="free",
            )
    added = {
        p.name: replace(p, spread=free[name] * p.spread)
        for name in rig.on_request
        if name in free
        for p in rig.on_request[name]
    }
    held = [
        replace(p, fitted=True, log=False, spread=free[p.outside_name])
        if p.outside_name in free
        else p
        for p in rig.parameters
        if p.name not in added
    ]
    return with_declared(rig, parameters=(*held, *added.values()))


def as_fitted(rig: Rig, keys: Collection[str]) -> Rig:
    """The rig with those parameters of `Rig.on_request` that a fitted model has, by their keys."""
    known = {p.name for p in rig.parameters}
    groups = rig.on_request.values()
    added = [p for group in groups for p in group if p.name in keys and p.name not in known]
    return with_declared(rig, parameters=(*rig.parameters, *added)) if added else rig


def as_recorded(rig: Rig, recordings: Iterable[Recording]) -> Rig:
    """The rig in the form that the recordings need, unless it has a form. Inputs are held or
    linear, outputs read before the command of their row, and parameters released, as the
    recordings' TOML files state. FileError where two of them differ."""
    recordings = list(recordings)
    if rig.forms is not None and not rig.form:
        rig = rig.forms.suiting(recordings) or rig
    rig = released(rig, {name: sd for r in recordings for name, sd in r.free.items()})
    ways: dict[str, str] = {}
    by: dict[str, Recording] = {}
    for recording in recordings:
        for column in (*rig.inputs, *rig.outputs):
            match = match_column(recording.columns, column) if recording.between else None
            if (way := recording.between.get(match or "")) is None:
                continue
            if (way == BEFORE) != (column in rig.outputs):
                raise FileError(
                    f"{recording.path}: [between] {column} is {way!r}.",
                    f'Inputs of rig {rig.name!r} are "held" or "linear"; only its outputs may be '
                    '"before".',
                    code="toml",
                )
            if ways.setdefault(column, way) != way:
                raise FileError(
                    f"[between] {column} is {ways[column]!r} in {by[column].path}, but {way!r} in "
                    f"{recording.path}.",
                    "Fit recordings of the same kind together, or state it in the rig alone.",
                )
            by[column] = recording
    return stated(rig, ways)
