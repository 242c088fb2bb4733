"""How large values and signals at the ports were on the recordings, from states estimated on them.

A free run of the data sheet from the rig's own start says little where the start is not that of the
recording, where the parameters are guesses or where the inputs rest. The states in which windows
begin are therefore estimated from what was measured (moving-horizon estimation), and the model runs
from these, window by window, never far from the machine.
"""

from __future__ import annotations

import numpy as np

from pamid.engine.program import Stepping
from pamid.estimation.multiple_shooting import careful_stepping, initial_states
from pamid.estimation.problem import Problem
from pamid.estimation.weights import Weights
from pamid.model.assembly import Assembly
from pamid.model.bound_parameter import Sizes
from pamid.simulation.data_split import DataSplit
from pamid.simulation.free_runs import longest_time, port_probes, port_sizes, sizes_of
from pamid.simulation.replay import run_windows
from pamid.simulation.windows import Runner


def observed_sizes(evidence: DataSplit) -> Sizes:
    """Sizes (SI) by port and signal over what is fitted, at the data sheet's parameters, and the
    correlation time of the recordings. Where the model cannot follow them, from its free runs."""
    plain = Assembly(evidence.rig, outputs=evidence.channels)
    p, probes = plain.values(), port_probes(plain)
    problem = Problem(plain, evidence.tracks(plain), ())
    time = {("", "timescale"): evidence.timescale_s} | longest_time(
        [len(t) * t.period_s for t in problem.tracks]
    )
    if not probes:
        return time
    stepping = careful_stepping(problem, p)
    weights = Weights(evidence.noise, np.ones_like(evidence.noise))
    starts = initial_states(problem, p, weights, stepping)
    program = plain.program_with({f"{where}.{n}": x for (_, where, n), x in probes.items()})
    tables = [
        run_windows(program, plain, p, track, problem.windows(track), x, stepping)
        for track, x in zip(problem.tracks, starts, strict=True)
    ]
    found = sizes_of(list(probes), [t[:, t.shape[1] - len(probes) :] for t in tables])
    if all((port, name) in found for port, _, name in probes):
        return found | time
    runs = [(t.u, Runner(plain, t, Stepping()).parameters(p), t.period_s) for t in problem.tracks]
    return port_sizes(plain, runs) | found | time


def unsized(evidence: DataSplit, sizes: Sizes) -> list[str]:
    """Ports whose value no recording moves and the rig states no size for: effects there are sized
    by 1 SI unit, which may be far off."""
    rig = evidence.rig
    return [
        name
        for name, port in rig.ports.items()
        if (name, "value") not in sizes and "value" not in port.size
    ]
