"""Excitations for two experiments that a random signal cannot replace."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from pamid.base.errors import UsageError
from pamid.model.registry import RigLike, name_of, resolved_rig, rig_named
from pamid.model.rig import Rig
from pamid.recording.recording import Recording, recording_of
from pamid.rigs.muscle_experiments import (
    PULSES_S,
    RELEASE_DEG,
    RELEASE_S,
    gravity_test,
    muscle_pulses,
    nothing_sent,
)
from pamid.rigs.simulators.compiled_rig import CompiledMechanism
from pamid.rigs.simulators.safe_excitation import SafeExcitation, safe_excitation


def release_excitation(
    rig: RigLike,
    release: Sequence[float] = RELEASE_DEG,
    *,
    payload_kg: float | None = None,
    clamped: Sequence[str] = (),
    duration_s: float = RELEASE_S,
    period_s: float | None = None,
) -> Recording:
    """Excitation for a free swing: the rig is released with its muscles vented.

    Parameters
    ----------
    release
        Angle per joint, in the unit of its reading.
    payload_kg
        Payload, kg.
    clamped
        Joints that do not move.
    duration_s, period_s
        Duration and sampling period, s. Default of the period: the rig's.

    Returns
    -------
    Recording
        States all of this as known.

    Raises
    ------
    UsageError
        The rig does not swing, or has no such joint or range.
    """
    bench_rig = _made(rig)
    period = bench_rig.period_s if period_s is None else period_s
    if not 0.0 < period < duration_s < np.inf:
        raise UsageError(
            f"A period of {period:g} s in {duration_s:g} s gives no recording.",
            "Give a period above 0 and a longer duration.",
        )
    known = gravity_test(bench_rig, release, clamped, payload_kg)
    columns = nothing_sent(bench_rig, round(duration_s / period))
    return _excitation(bench_rig, columns, period, "release", known)


def pulse_excitation(
    rig: RigLike,
    *,
    muscles: Sequence[str] = (),
    level: float = 1.0,
    period_s: float | None = None,
) -> Recording:
    """Excitation that vents and fills the muscles in turn in pulses of 30 to 500 ms.

    Parameters
    ----------
    muscles
        Muscles to pulse. Default: all.
    level
        Duty, 0 to 1, sent past the controller.
    period_s
        Sampling period, s. Default: the rig's.

    Raises
    ------
    UsageError
        A muscle does not exist, or the period is longer than the shortest pulse.
    """
    bench_rig = _made(rig)
    period = bench_rig.period_s if period_s is None else period_s
    if not 0.0 < period <= PULSES_S[0]:
        raise UsageError(f"The period is {period:g} s; the shortest pulse lasts {PULSES_S[0]:g} s.")
    columns = muscle_pulses(bench_rig, muscles, level, period)
    return _excitation(bench_rig, columns, period, "pulses", {})


def within_limits(
    rig: RigLike,
    columns: Mapping[str, ArrayLike],
    period_s: float,
    *,
    centres: Mapping[str, float] | None = None,
    speed_limits: Mapping[str, float] | None = None,
) -> SafeExcitation | None:
    """An excitation within the limits of a MuJoCo or URDF model: run there, moved and made smaller
    until it keeps ranges, speeds and forces, and no bodies touch. None where the rig is no such
    model, or none of the columns is a command of it.

    columns: samples every period_s by column, in its unit; centres: what they swing about where
    that is not 0; speed_limits: joint -> rad/s or m/s, in addition to those that a URDF states.
    DataError (code "no-room") where nothing of it is left, UsageError for a joint that is not
    there.
    """
    bench_rig = _made(rig)
    if not isinstance(bench_rig, CompiledMechanism) or not set(columns) & set(bench_rig.inputs):
        return None
    values = {name: np.asarray(column, dtype=np.float64) for name, column in columns.items()}
    return safe_excitation(bench_rig.mechanism, values, period_s, centres, speed_limits)


def _made(rig: RigLike) -> Rig:
    named = resolved_rig(rig)
    if named is None:
        raise UsageError("There is no rig.", "Name the rig that is to be excited.")
    return rig_named(named)


def _excitation(
    rig: Rig, columns: dict[str, np.ndarray], period: float, name: str, known: dict[str, float]
) -> Recording:
    about = {"rig": name_of(rig), "loop": "open", "sampling_period_s": period}
    time = period * np.arange(len(next(iter(columns.values()))))
    return recording_of(time, columns, {"recording": about, "known": known}, name=name)
