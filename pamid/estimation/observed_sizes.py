"""Magnitudes of values and signals at the ports on the recordings, from states estimated on them.

A free run of the data sheet from the rig's start is a poor guide where the start is not that of
the recording, where the parameters are guesses or where the inputs rest. The states at the window
starts are therefore estimated from the measurements (moving-horizon estimation). The model runs
from these, window by window, never far from the machine.

A model may have no flow at all at a port, such as a shut valve or an undriven joint. The size there
is the constant value that would move an output as far as it was recorded to move.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pamid.engine.program import Stepping
from pamid.engine.symbolic.vocabulary import Expr, Number
from pamid.estimation.multiple_shooting import initial_states
from pamid.estimation.problem import Problem, careful_stepping
from pamid.estimation.weights import Weights
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment
from pamid.model.bound_parameter import Sizes
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter
from pamid.simulation.data_split import DataSplit
from pamid.simulation.free_runs import longest_time, port_probes, port_sizes, sizes_of
from pamid.simulation.replay import run_windows
from pamid.simulation.windows import Runner


def observed_sizes(evidence: DataSplit) -> Sizes:
    """Sizes (SI) by port and signal over the fitted part, at the data sheet's parameters, and the
    correlation time of the recordings. Where the model cannot follow them, from its free runs."""
    plain = Assembly(evidence.rig, outputs=evidence.channels)
    p, probes = plain.values(), port_probes(plain)
    problem = Problem(plain, evidence.tracks(plain), ())
    time = {("", "timescale"): evidence.correlation_s} | longest_time(
        [len(t) * t.period_s for t in problem.tracks]
    )
    if not probes:
        return time
    stepping = careful_stepping(problem, p)
    # Sensor noise only: residuals of a fit do not exist yet.
    weights = Weights(evidence.noise, np.ones_like(evidence.noise))
    starts = initial_states(problem, p, weights, stepping)
    program = plain.program_with({f"{where}.{n}": x for (_, where, n), x in probes.items()})
    tables = [
        run_windows(program, plain, p, track, problem.windows(track), x, stepping)
        for track, x in zip(problem.tracks, starts, strict=True)
    ]
    sizes = sizes_of(list(probes), [t[:, t.shape[1] - len(probes) :] for t in tables])
    if all((port, name) in sizes for port, _, name in probes):
        return sizes | time
    runs = [(t.u, Runner(plain, t, Stepping()).parameters(p), t.period_s) for t in problem.tracks]
    sizes = port_sizes(plain, runs) | sizes | time
    pushed = {
        (name, "value"): _push_that_moves(evidence, name, starts, stepping)
        for name in ports_without_size(evidence, sizes)
    }
    return sizes | {key: size for key, size in pushed.items() if size}


class Push(Effect):
    """A constant added to the value, by which outputs are differentiated."""

    name = "push"
    family = "push"
    kinds = ()
    parameters = (Parameter("push", 0.0, low=-1.0, high=1.0, null=0.0),)

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Number:
        return value + p.push


def _push_that_moves(
    evidence: DataSplit, port: str, starts: tuple[np.ndarray, ...], stepping: Stepping
) -> float:
    """The least constant value (SI) at a port that would move any output over the windows as far as
    it was recorded to move. 0 where it moves none.

    starts: of every track, the rig's states at its windows' starts.
    """
    pushed = Assembly(
        evidence.rig, (Attachment(Push(), (port,), "push"),), outputs=evidence.channels
    )
    problem = Problem(pushed, evidence.tracks(pushed), ())
    place, p = len(pushed.parameters) - 1, pushed.values()
    moved, slope = (np.zeros(len(evidence.channels)) for _ in range(2))
    for track, x in zip(problem.tracks, starts, strict=True):
        runner = Runner(pushed, track, stepping, free=(place,))
        values = runner.parameters(p)
        windows = problem.windows(track)
        runs = runner.run_windows(runner.memory(values), windows, x, values, True)
        for window, run in zip(windows, runs, strict=True):
            if not run.fine:
                return 0.0
            y = track.y[window.start : window.stop]
            # Relative to the window's first sample, because the window's start is estimated and
            # explains the level.
            moved += np.nansum((y - y[:1]) ** 2, axis=0)
            slope += (run.JY[:, :, 0] ** 2).sum(axis=0)
    needed = np.sqrt(moved[slope > 0.0] / slope[slope > 0.0])
    needed = needed[np.isfinite(needed) & (needed > 0.0)]
    # The smallest push: an output that the port hardly reaches would need an absurd push.
    return float(needed.min(initial=np.inf)) if needed.size else 0.0


def ports_without_size(evidence: DataSplit, sizes: Sizes) -> list[str]:
    """Ports whose value no recording moves and the rig states no size for: effects there are sized
    by 1 SI unit, which may be far off."""
    rig = evidence.rig
    return [
        name
        for name, port in rig.ports.items()
        if (name, "value") not in sizes and "value" not in port.size
    ]
