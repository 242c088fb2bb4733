"""Zero-order or first-order hold of the inputs between samples.

Both are tried. Each trial is a short fit of the rig's parameters, with a start state for each of
some windows. The two trials differ in this input alone. A zero-order and a first-order hold differ
by a delay of half a sample, and by the course between samples. If the rig answers within a few
samples, no parameter can make up for this difference, so the error decides. An unmodelled delay of
half a sample looks the same.

    better      an error at most BETTER times the other's, smaller in SURE of the windows

Two fits per input would mostly be in vain where only a wrong hold is reported. An input is then
only tried if the error falls to first order (`ShortFit.first_order_errors`).
"""

from __future__ import annotations

from collections.abc import Iterable

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
from pamid.schemas.check_file import BetweenSamples

Array = NDArray[np.float64]

BETTER, SURE = 0.9, 0.7
# share of the error, to first order, below which an input is tried. Half way to BETTER, because a
# fit gains more than the first-order prediction.
MAYBE_BETTER = 0.95


class InputHold(BetweenSamples):
    """One input with both holds; taken: the hold that the rig or the recording states."""

    @property
    def wrong(self) -> bool:
        """True if the hold that is not in use fits clearly better."""
        return self.better not in ("", self.taken)

    def text(self, recording: Recording) -> str:
        """Finding, with the line that corrects it."""
        unit = split_column(self.channel)[1]
        unit = "" if unit == NONE else f" {unit}"
        by = {HELD: self.rms_held, LINEAR: self.rms_linear}
        way, rest = (self.better or self.taken), other(self.better or self.taken)
        descriptions = {HELD: "held between samples", LINEAR: "linear between samples"}
        figures = (
            f"{self.channel} {by[way]:.3g}{unit} RMS against {by[rest]:.3g} {rest}, over "
            f"{self.windows} windows"
        )
        if not self.better:
            return (
                f"{self.column} is taken as {descriptions[self.taken]}; this recording cannot "
                f"decide ({figures})"
            )
        if not self.wrong:
            return f"{self.column} is {descriptions[self.taken]}, which fits better ({figures})"
        recorded_column = match_column(recording.columns, self.column)
        return (
            f"{self.column} is taken as {descriptions[self.taken]}, but {self.better} fits clearly "
            f'better: {figures}. Write between = {{"{self.column}": "{self.better}"}} into the rig '
            f'file, or [between] {recorded_column} = "{self.better}" into '
            f"{recording.path.with_suffix('.toml').name}"
        )


def compare_holds(
    recording: Recording,
    rig: Rig,
    columns: Iterable[str] | None = None,
    *,
    screened: bool = False,
) -> list[InputHold]:
    """Compare both holds of the recording's inputs.

    The list is empty if the rig cannot run on the recording. It is also empty for a rig that steps
    by itself once a sample, because both holds are the same there. A command of a controller is
    held, and is not tried.

    Parameters
    ----------
    recording
        Recording to fit.
    rig
        Rig, with the values that the recording states (`as_recorded`).
    columns
        Inputs to try; None tries all of them.
    screened
        Only try inputs by which the error may fall to first order, at a fraction of the cost.
    """
    held = {loop.command for loop in rig.loops}
    try:
        trial = fit_data_of(recording, rig)
        names = [
            c
            for c in (rig.inputs if columns is None else columns)
            if c not in held and recording.has(c) and motion(recording.signal(c)) > 0.0
        ]
        if trial is None or not names:
            return []
        problem = ShortFit.of(trial, trial.rig)
        # a rig that steps by itself gets its inputs at the beginning of a step, so that with one
        # step a sample both holds are the same
        if isinstance(rig, StepRig) and problem.runner.stepping.substeps == 1:
            return []
        return _compare_inputs(trial, names, problem, screened)
    except (PamidError, FloatingPointError, np.linalg.LinAlgError):
        return []


def misstated_holds(recording: Recording, rig: Rig) -> list[InputHold]:
    """Inputs whose hold neither the rig nor the recording states, and that fit clearly better with
    the other hold."""
    unstated = [column for column in rig.inputs if column not in rig.between]
    return [hold for hold in compare_holds(recording, rig, unstated, screened=True) if hold.wrong]


def _compare_inputs(
    trial: FitData, names: list[str], problem: ShortFit, screened: bool
) -> list[InputHold]:
    """Compare the inputs one by one.

    If several fit better with the other hold, the best one is corrected first, and the remaining
    inputs are compared with this correction in place.
    """
    outcomes: dict[str, InputHold] = {}
    base = trial.fitted(trial.rig, problem=problem)
    if not np.isfinite(base.error):
        return []  # the model runs away with both holds
    while True:
        left = [c for c in names if c not in outcomes]
        worth = _worth_trying(trial, base, left) if screened else left
        tried = {c: _compare_hold(trial, base, c) for c in worth}
        # a run that diverges with the other hold leaves nothing to compare
        tried = {
            c: t for c, t in tried.items() if np.isfinite([t[0].rms_held, t[0].rms_linear]).all()
        }
        wrong = [c for c, (outcome, _) in tried.items() if outcome.wrong]
        if len(wrong) < 2:
            outcomes |= {c: outcome for c, (outcome, _) in tried.items()}
            return [outcomes[c] for c in names if c in outcomes]
        best = min(wrong, key=lambda c: tried[c][1].error)
        outcomes[best], base = tried[best]


def _compare_hold(
    data: FitData, base: FittedWindows, column: str
) -> tuple[InputHold, FittedWindows]:
    """Both holds of an input, each also fitted from the end point of the other, and the fit with
    the hold that is not in use; base: the fit with the hold in use."""
    assumed = between_of(base.rig, column)
    other_way = stated(base.rig, {column: other(assumed)})
    stepping = base.problem.runner.stepping
    turned = data.fitted(other_way, base.point, stepping=stepping)
    refit = data.fitted(base.rig, turned.point, base.problem)
    best_fit = refit if refit.error < base.error else base
    # an exact fit and one that runs away have no logarithm
    logs = [
        np.log(np.clip(fit.point.errors.mean(axis=0), 1e-300, 1e300)) for fit in (turned, best_fit)
    ]
    shows = int(np.argmax(np.abs(logs[0] - logs[1])))
    both = {assumed: best_fit, other(assumed): turned}
    symbol = split_column(data.names[shows])[1]
    rms = {
        way: float(np.sqrt(fit.point.errors[:, shows].mean()) / data.weight[shows])
        / float(to_si(1.0, symbol) - to_si(0.0, symbol))
        for way, fit in both.items()
    }
    better = next((way for way in both if _clear(both[way], both[other(way)])), "")
    outcome = InputHold(
        column=column,
        taken="held" if assumed == HELD else "linear",
        stated=column in base.rig.between,
        better=better,
        channel=data.names[shows],
        rms_held=rms[HELD],
        rms_linear=rms[LINEAR],
        windows=len(data.windows),
    )
    return outcome, turned


def _worth_trying(data: FitData, base: FittedWindows, columns: list[str]) -> list[str]:
    """Inputs whose other hold would reduce the error of the fit to first order."""
    # one model serves all holds, because an input that does not rise over a sample is held
    moving = stated(base.rig, dict.fromkeys(columns, LINEAR))
    program = Assembly(moving, outputs=data.names).for_fitting().program
    if not columns or not isinstance(program, Program):
        return columns
    inputs, moves = program.inputs, [program.inputs[i] for i in program.linear]
    rises = np.diff(data.track.u, axis=0, append=data.track.u[-1:])
    ways = [{c: between_of(base.rig, c) for c in moves}]
    ways += [ways[0] | {c: other(ways[0][c])} for c in columns]
    alternatives = [
        np.column_stack(
            [data.track.u, *(rises[:, inputs.index(c)] * (way[c] == LINEAR) for c in moves)]
        )
        for way in ways
    ]
    reached = base.problem.first_order_errors(base.point, program, alternatives)
    return [
        c
        for c, error in zip(columns, reached[1:], strict=True)
        if not error > MAYBE_BETTER * reached[0]
    ]


def _clear(fit: FittedWindows, rest: FittedWindows) -> bool:
    """True if the first fit is clearly better than the second."""
    if not np.isfinite(fit.error) or fit.error > BETTER * rest.error:
        return False
    smaller = fit.point.errors.sum(axis=1) < rest.point.errors.sum(axis=1)
    return float(smaller.mean()) >= SURE
