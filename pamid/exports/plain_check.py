"""Check of a written model file in its simulator, against the file that it was made of.

Both are run on the held-out data of the run.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.base.result_file import need_result
from pamid.base.run_folder import DIAGNOSIS_FILE, FIT_FILE, RESIDUAL_FILE
from pamid.base.schemas.command_files import PlainChannel, PlainMujoco, PlainSettings
from pamid.base.schemas.diagnosis_file import DiagnosisFile
from pamid.base.schemas.fit_file import FitFile
from pamid.base.units import size_from_si, size_to_si, split_column, to_si
from pamid.networks.correction.identified_model import Identified
from pamid.networks.correction.residual_data import residual_columns, scored_windows, spans_of
from pamid.rigs.simulators.mechanism import Mechanism
from pamid.rigs.simulators.mujoco_file import MujocoFile, open_mujoco
from pamid.rigs.simulators.plain_mujoco import PlainModel, RecordedStretch

#: largest ratio to the stated error for an acceptable file
REACHED = 1.2
#: integrators and divisors of the file's step that are tried if the file's settings miss that,
#: cheapest first
TRIED_SETTINGS = tuple(
    (integrator, part) for part in (1, 2, 4, 8) for integrator in ("implicitfast", "RK4")
)
NEARLY = 1.1  # ratio to the smallest error up to which settings tie with the best
MOST_PAST_S = 2.0  # of the inputs before a stretch, for delays


@dataclass(frozen=True)
class PlainCheck:
    """A new model file in its simulator.

    errors  of the old and the new file on held-out data, and the first settings that reach the
            stated errors, else the best tried ones
    spread  of the measurement, by channel in its unit
    """

    errors: PlainMujoco
    spread: Mapping[str, float]

    @property
    def is_worse(self) -> bool:
        """True if the new file has larger errors than the old file, over all channels."""
        before, now = (
            sum(getattr(e, name) / self.spread[c] for c, e in self.errors.channels.items())
            for name in ("before", "now")
        )
        return not now <= before

    @property
    def worst_words(self) -> str:
        """Text on the channel with the largest increase."""
        increase = {
            name: c.now / max(c.before, 1e-300) if np.isfinite(c.now) else float("inf")
            for name, c in self.errors.channels.items()
        }
        name = max(increase, key=lambda channel: increase[channel])
        c = self.errors.channels[name]
        return (
            f"in MuJoCo ({settings_words(self.errors)}) its held-out errors are larger than those "
            f"of the original file: {name} {c.now:.4g} instead of {c.before:.4g}"
        )


def settings_words(settings: PlainSettings) -> str:
    """Step and integrator as text."""
    return f"{1e3 * settings.timestep_s:g} ms, {settings.integrator}"


def plain_check(
    model: Identified, mechanism: Mechanism, new: MujocoFile, new_mechanism: Mechanism
) -> PlainCheck | None:
    """Run the old file and the new file on the held-out part of the model's run.

    Parameters
    ----------
    model
        Identified model.
    mechanism
        Mechanism of the old file.
    new, new_mechanism
        The new file and its mechanism.

    Returns
    -------
    PlainCheck or None
        None if the run holds nothing out or has no residual.csv, or if the model was not read from
        a run.
    """
    if model.folder is None or not (model.folder / RESIDUAL_FILE).exists():
        return None
    fit = need_result(model.folder / FIT_FILE, FitFile, also=("noise",))
    horizon, stated = _stated(model, fit)
    stretches = list(_stretches(model.folder, fit, mechanism, horizon))
    if not stretches:
        return None
    units = {c: split_column(c)[1] for c in stretches[0].readings}
    noise = {c: size_to_si(fit.noise.get(c, 0.0), units[c]) for c in units}
    spread = {c: _spread(stretches, c) for c in units}
    noise = {c: max(value, 1e-6 * spread[c]) for c, value in noise.items()}
    linear = tuple(model.equations.linear)

    def errors(
        file: MujocoFile, m: Mechanism, settings: PlainSettings | None = None
    ) -> dict[str, float]:
        return PlainModel(file, m, settings=settings, linear=linear).errors(stretches, noise)

    before = errors(open_mujoco(mechanism.path), mechanism)
    model_settings = PlainModel(new, new_mechanism).settings
    now = errors(new, new_mechanism)
    wanted = {c: size_to_si(stated[c], units[c]) for c in units if c in stated}
    tried = [(model_settings, now)]
    while not _reached(tried[-1][1], wanted) and len(tried) <= len(TRIED_SETTINGS):
        integrator, part = TRIED_SETTINGS[len(tried) - 1]
        settings = PlainSettings(timestep_s=model_settings.timestep_s / part, integrator=integrator)
        tried.append((settings, errors(new, new_mechanism, settings)))
    reached = _reached(tried[-1][1], wanted)
    # the cheapest of several that tie
    least = NEARLY * min(_total(errors_there, spread) for _, errors_there in tried)
    best, nearest = next(
        (settings, errors_there)
        for settings, errors_there in tried
        if (_reached(errors_there, wanted) if reached else _total(errors_there, spread) <= least)
    )
    shown = [c for c in units if not np.isnan(now[c])]
    plain = PlainMujoco(
        timestep_s=model_settings.timestep_s,
        integrator=model_settings.integrator,
        channels={
            c: PlainChannel(
                before=size_from_si(before[c], units[c]),
                now=size_from_si(now[c], units[c]),
                stated=stated.get(c),
                best=size_from_si(nearest[c], units[c]),
            )
            for c in shown
        },
        best=best,
        reached=reached if wanted else None,
    )
    spread = {c: size_from_si(spread[c], units[c]) for c in shown}
    return PlainCheck(plain, spread)


def _total(errors: Mapping[str, float], spread: Mapping[str, float]) -> float:
    return sum(errors[c] / size for c, size in spread.items() if not np.isnan(errors[c]))


def _reached(errors: Mapping[str, float], wanted: Mapping[str, float]) -> bool:
    return all(errors[c] <= REACHED * value for c, value in wanted.items())


def _spread(stretches: Sequence[RecordedStretch], column: str) -> float:
    values = np.concatenate([s.readings[column][s.scored] for s in stretches])
    values = values[~np.isnan(values)]
    return float(np.std(values)) or 1.0


# ---- what the run states, and what it held out ---------------------------------------------------


def _stated(model: Identified, fit: FitFile) -> tuple[float, dict[str, float]]:
    """Prediction horizon from an estimated state (0: a single window), and the stated errors.

    The errors are those on held-out data by channel, in the channel's unit.
    """
    assert model.folder is not None
    path = model.folder / DIAGNOSIS_FILE
    if not path.exists():
        rows = {c: row.get("refitted") for c, row in fit.mae.items()}
        return 0.0, {c: float(v) for c, v in rows.items() if v is not None}
    diagnosis = need_result(path, DiagnosisFile)
    labels = tuple(a.label for a in model.effects)
    horizon = diagnosis.horizon_s or 0.0
    if model.chosen:
        ranked = next((c for c in diagnosis.ranking if (c.effect,) == labels), None)
        held = ranked.held_out if ranked else {}
        return horizon, {c: h.mae_after for c, h in held.items() if h.mae_after is not None}
    kind = "mae_with_cause" if labels else "mae_refitted"
    errors = {c: getattr(reach, kind) for c, reach in diagnosis.how_far.items()}
    return horizon, {c: float(v) for c, v in errors.items() if v is not None}


def _stretches(
    folder: Path, fit: FitFile, mechanism: Mechanism, horizon_s: float
) -> Iterator[RecordedStretch]:
    """Runs over held-out data, with as many windows each as the horizon has."""
    columns = residual_columns(folder / RESIDUAL_FILE)
    inputs = {c: u for c, u in mechanism.inputs.items() if c in columns}
    if lacking := [c for c in mechanism.inputs if c not in columns and fit.inputs is not None
                   and c in fit.inputs]:  # fmt: skip
        raise FileError(
            f"{folder / RESIDUAL_FILE} lacks the column {lacking[0]!r}.", code="damaged"
        )
    readings = [c for c in fit.channels if c in columns and c in mechanism.outputs]
    si = {c: to_si(columns[c], split_column(c)[1]) for c in (*inputs, *readings)}
    time, window = columns["time_s"], columns["window"]
    for span in spans_of(columns):
        begin, end = span.rows.start, span.rows.stop
        if span.part != 1 or end - begin <= 2:
            continue
        period = float(np.median(np.diff(time[begin:end])))
        groups = _groups(window[begin:end], period, horizon_s)
        for first, opening, warm, last in groups:
            a, b = begin + first, begin + last
            # the first row from which time continues without a gap, in the same recording
            steps, usual = np.diff(time[: a + 1]), np.median(np.diff(time[a : a + 3]))
            broken = np.abs(steps - usual) > 0.5 * usual
            broken |= np.diff(columns["recording"][: a + 1]) != 0
            unbroken = int(np.max(np.flatnonzero(broken), initial=-1)) + 1
            past = max(unbroken, a - round(MOST_PAST_S / period))
            scored = np.ones(b - a, bool)
            scored[:warm] = False
            rows = {c: si[c][a:b] for c in readings}
            if np.isnan(np.concatenate([rows[c][:opening] for c in readings])).all():
                continue
            yield RecordedStretch(
                time[a:b] - time[a],
                {c: si[c][a:b] for c in inputs},
                {c: si[c][past:a] for c in inputs},
                rows,
                scored,
                opening,
            )


def _groups(
    window: Array, period_s: float, horizon_s: float
) -> Iterator[tuple[int, int, int, int]]:
    """(first sample, samples for the start, unscored samples, end) of every run.

    A window's start is estimated on its unscored samples; that of several windows on the whole
    first.
    """
    windows = scored_windows(window)
    if not windows:
        return
    longest = max(end - first for first, _, end in windows) * period_s
    per_run = max(1, round(horizon_s / longest)) if np.isfinite(horizon_s) else len(windows)
    for k in range(0, len(windows), per_run):
        first, scored, end = windows[k]
        last = windows[min(k + per_run, len(windows)) - 1][2]
        yield first, (end if per_run > 1 else scored) - first, scored - first, last
