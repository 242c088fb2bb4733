"""Time over which a model multiplies the errors of its state.

A fit follows the derivatives of a window's outputs by the state at its start. Where errors grow
exponentially, as in an undamped arm, the outputs soon depend on that state nonlinearly, and the
misfit has many minima (Ribeiro, Tiels, Umenberger, Schoen and Aguirre 2020, Automatica 121). With

    a_j(t) = max over t' <= t of |W dy(t')/dx_j|

for a state x_j that the readings show at once, growth is separated from a power of time by a
doubling: a_j(2 t)/a_j(t) is 2^k for t^k, whatever the units, and exp(lambda t) for exp(lambda t).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pamid.base.arrays import Array
from pamid.model.assembly import Assembly
from pamid.simulation.free_runs import choose_stepping
from pamid.simulation.initial_state import WindowStart
from pamid.simulation.tracks import Track
from pamid.simulation.windows import Runner, cut

# of the errors over twice the time: more than t^4 gives, and errors grow 1000-fold over the whole
GROWTH_LIMIT = 30.0
PLACES = 12  # windows looked at, evenly spread over all recordings


def growth_time_s(
    assembly: Assembly, tracks: Sequence[Track], noise: Array, most_s: float
) -> float:
    """Longest time (s), up to `most_s`, within which errors grow by less than `GROWTH_LIMIT`
    from its first half to its end.

    Every window looked at begins in the state that its readings show. The shortest time of all is
    returned: a fit is lost where any window has no minimum to be found.

    assembly: at its data sheet; tracks: with known parameters in place; noise: of the sensors, per
    channel (SI).
    """
    windows = [
        (place, window)
        for place, track in enumerate(tracks)
        for window in cut(len(track), max(2, round(most_s / track.period_s)))
    ]
    chosen = np.unique(np.linspace(0, len(windows) - 1, PLACES).round().astype(int))
    looked_at = [windows[k] for k in chosen]
    runners = {}
    for place in {place for place, _ in looked_at}:
        t = tracks[place]
        step = choose_stepping(assembly, t.u, t.p, t.period_s, assembly.start(t.p))
        runners[place] = Runner(assembly, t, step)
    times = [most_s]
    for place, window in looked_at:
        runner = runners[place]
        track, n = runner.track, runner.start_states
        if n == 0:
            continue
        weight = np.where(track.seen, 1.0 / noise, 0.0)
        memory = runner.memory(track.p)
        start = WindowStart.of(runner, memory, window, track.p, weight, memory.x[:n])
        runner.enter(memory, start.from_readings())
        Y, J, _ = runner.run(memory, window, track.p, True, weight)
        size = np.sqrt((J.reshape(*Y.shape, -1)[:, :, :n] ** 2).sum(axis=1))
        size = np.maximum.accumulate(size[:, size[0] > 0.0])
        later = np.arange(2, len(size))
        # a model that has run away shows no number: it has grown, too
        grown = ~(size[later] < GROWTH_LIMIT * size[later // 2]).all(axis=1)
        if grown.any():
            times.append(float(later[grown][0] * track.period_s))
    return min(times)
