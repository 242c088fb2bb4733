"""Is an input held between samples, or does it lead in a straight line to the next one?

Both are tried: a short fit of the rig's parameters and of a start state for each of some windows,
with the input the one way and the other, everything else alike. What a hold and a straight line
differ by is half a sample of delay and what lies between samples; a parameter cannot make up for
it where the rig answers within few samples, and then the error says which one is right. A delay
of half a sample that the rig does not have looks alike.

    better      an error at most BETTER times the other's, smaller in SURE of the windows

Where only a way that is taken wrongly is of interest (`wrongly_taken`), two fits per input are
mostly in vain: only an input by which the error falls to first order (`ShortFit.reached`) is tried.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import PamidError
from pamid.base.metrics import motion
from pamid.base.units import NONE, split_column, to_si
from pamid.checks.short_fit import FitData, FittedWindows, ShortFit, fit_data_of
from pamid.engine.program import Program
from pamid.model.assembly import Assembly
from pamid.model.between_samples import HELD, LINEAR, between_of, other, stated
from pamid.model.rig import Rig
from pamid.model.step_rig import StepRig
from pamid.recording.recording import Recording, match_column

Array = NDArray[np.float64]

BETTER, SURE = 0.9, 0.7
# of the error, to first order: below it an input is tried; half way to BETTER, for what fits gain
# beyond the first order
MAYBE_BETTER = 0.95


@dataclass(frozen=True)
class HoldOrLine:
    """One input tried both ways.

    taken      "held" or "linear", as the rig or the recording states it; stated: whether it does
    better     the way that fits clearly better, "" where neither does
    channel    the output that shows it most; held, linear: its root mean square error over the
               windows, in its unit; windows: how many
    """

    column: str
    taken: str
    stated: bool
    better: str
    channel: str
    held: float
    linear: float
    windows: int

    @property
    def wrong(self) -> bool:
        """Does the other way than the one that is taken fit clearly better?"""
        return self.better not in ("", self.taken)

    def text(self, recording: Recording) -> str:
        """Finding and the line to write where."""
        unit = split_column(self.channel)[1]
        unit = "" if unit == NONE else f" {unit}"
        by = {HELD: self.held, LINEAR: self.linear}
        way, rest = (self.better or self.taken), other(self.better or self.taken)
        said = {HELD: "held between samples", LINEAR: "linear between samples"}
        figures = (
            f"{self.channel} {by[way]:.3g}{unit} RMS against {by[rest]:.3g} {rest}, over "
            f"{self.windows} windows"
        )
        if not self.better:
            return (
                f"{self.column} is taken as {said[self.taken]}; this recording does not tell "
                f"({figures})"
            )
        if not self.wrong:
            return f"{self.column} is {said[self.taken]}, which fits better ({figures})"
        own = match_column(recording.columns, self.column)
        return (
            f"{self.column} is taken as {said[self.taken]}, but {self.better} fits clearly better: "
            f'{figures}. Write between = {{"{self.column}": "{self.better}"}} into the rig file, '
            f'or [between] {own} = "{self.better}" into '
            f"{recording.path.with_suffix('.toml').name}"
        )


def tried_both_ways(
    recording: Recording, rig: Rig, columns: Iterable[str] | None = None
) -> list[HoldOrLine]:
    """The recording's inputs (of these, if they are named) held and linear; none where the rig
    cannot be run on it, or steps by itself once a sample, so that both are the same to it. A
    command that a controller sends is held, and is not tried.

    rig: with what the recording states (`as_recorded`).
    """
    return _both_ways(recording, rig, columns, screened=False)


def _both_ways(
    recording: Recording, rig: Rig, columns: Iterable[str] | None, screened: bool
) -> list[HoldOrLine]:
    try:
        trial = fit_data_of(recording, rig)
        names = _open_inputs(recording, rig, rig.inputs if columns is None else columns)
        if trial is None or not names:
            return []
        problem = ShortFit.of(trial, trial.rig)
        # what steps by itself is told its inputs at the begin of a step: one step a sample, and
        # both ways are one
        if isinstance(rig, StepRig) and problem.runner.stepping.substeps == 1:
            return []
        return _tried(trial, names, problem, screened)
    except (PamidError, FloatingPointError, np.linalg.LinAlgError):
        return []


def wrongly_taken(
    recording: Recording, rig: Rig, columns: Iterable[str] | None = None
) -> list[HoldOrLine]:
    """Of `tried_both_ways` those inputs that fit clearly better the other way, at a fraction of its
    cost: an input is tried where to first order it may be one."""
    return [one for one in _both_ways(recording, rig, columns, screened=True) if one.wrong]


def unstated(rig: Rig) -> list[str]:
    """Inputs of which neither rig nor recording says what they do between samples."""
    return [column for column in rig.inputs if column not in rig.between]


def _open_inputs(recording: Recording, rig: Rig, columns: Iterable[str]) -> list[str]:
    sent = {loop.command for loop in rig.loops}
    return [
        c
        for c in columns
        if c not in sent and recording.has(c) and motion(recording.signal(c)) > 0.0
    ]


def _tried(trial: FitData, names: list[str], problem: ShortFit, screened: bool) -> list[HoldOrLine]:
    """Every input the other way, or those that are worth it; where several fit better so, the best
    first and the others beside it."""
    found: dict[str, HoldOrLine] = {}
    base = trial.fitted(trial.rig, problem=problem)
    if not np.isfinite(base.error):
        return []  # the model runs away either way
    while True:
        left = [c for c in names if c not in found]
        worth = _worth_trying(trial, base, left) if screened else left
        tried = {c: compared(trial, base, c) for c in worth}
        # where it runs away the other way there is nothing to compare
        tried = {c: t for c, t in tried.items() if np.isfinite([t[0].held, t[0].linear]).all()}
        wrong = [c for c, (one, _) in tried.items() if one.wrong]
        if len(wrong) < 2:
            found |= {c: one for c, (one, _) in tried.items()}
            return [found[c] for c in names if c in found]
        best = min(wrong, key=lambda c: tried[c][1].error)
        found[best], base = tried[best]


def compared(data: FitData, base: FittedWindows, column: str) -> tuple[HoldOrLine, FittedWindows]:
    """The input the one way and the other, each from where the other one led as well."""
    taken = between_of(base.rig, column)
    other_way = stated(base.rig, {column: other(taken)})
    stepping = base.problem.runner.stepping
    turned = data.fitted(other_way, base.point, stepping=stepping)
    again = data.fitted(base.rig, turned.point, base.problem)
    here = again if again.error < base.error else base
    # an exact fit and one that runs away have no logarithm
    logs = [np.log(np.clip(fit.point.errors.mean(axis=0), 1e-300, 1e300)) for fit in (turned, here)]
    shows = int(np.argmax(np.abs(logs[0] - logs[1])))
    both = {taken: here, other(taken): turned}
    rms = {way: _rms(data, one, shows) for way, one in both.items()}
    better = next((way for way in both if _clear(both[way], both[other(way)])), "")
    return (
        HoldOrLine(
            column,
            taken,
            column in base.rig.between,
            better,
            data.names[shows],
            rms[HELD],
            rms[LINEAR],
            len(data.windows),
        ),
        turned,
    )


def _worth_trying(data: FitData, base: FittedWindows, columns: list[str]) -> list[str]:
    """Those of these inputs by which the error of the fit would to first order fall, were they
    the other way."""
    # one model serves all: in it an input that does not rise over a sample is held
    moving = stated(base.rig, dict.fromkeys(columns, LINEAR))
    program = Assembly(moving, outputs=data.names).for_fitting().program
    if not columns or not isinstance(program, Program):
        return columns
    inputs, moves = program.inputs, [program.inputs[i] for i in program.linear]
    rises = np.diff(data.track.u, axis=0, append=data.track.u[-1:])
    ways = [{c: between_of(base.rig, c) for c in moves}]
    ways += [ways[0] | {c: other(ways[0][c])} for c in columns]
    told = [
        np.column_stack(
            [data.track.u, *(rises[:, inputs.index(c)] * (way[c] == LINEAR) for c in moves)]
        )
        for way in ways
    ]
    reached = base.problem.reached(base.point, program, told)
    return [
        c
        for c, error in zip(columns, reached[1:], strict=True)
        if not error > MAYBE_BETTER * reached[0]
    ]


def _rms(data: FitData, one: FittedWindows, channel: int) -> float:
    symbol_ = split_column(data.names[channel])[1]
    mean = float(np.sqrt(one.point.errors[:, channel].mean())) / data.weight[channel]
    return mean / float(to_si(1.0, symbol_) - to_si(0.0, symbol_))


def _clear(one: FittedWindows, rest: FittedWindows) -> bool:
    """Does one fit clearly better than the other?"""
    if not np.isfinite(one.error) or one.error > BETTER * rest.error:
        return False
    smaller = one.point.errors.sum(axis=1) < rest.point.errors.sum(axis=1)
    return float(smaller.mean()) >= SURE


def figures(found: Sequence[HoldOrLine]) -> list[dict[str, object]]:
    """The same as plain data."""
    return [
        {
            "column": one.column,
            "taken": one.taken,
            "stated": one.stated,
            "better": one.better,
            "channel": one.channel,
            "rms_held": one.held,
            "rms_linear": one.linear,
            "windows": one.windows,
        }
        for one in found
    ]
