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
from numpy.typing import NDArray

from pamid.model.assembly import Assembly
from pamid.simulation.free_runs import choose_stepping
from pamid.simulation.initial_state import WindowStart
from pamid.simulation.tracks import Track
from pamid.simulation.windows import Runner, Window, cut

Array = NDArray[np.float64]

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

    Parameters
    ----------
    assembly
        Model, at its data sheet.
    tracks
        Recordings with known parameters in place.
    noise
        Of the sensors, per channel (SI).
    most_s
        Time looked at, s.
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
    times = [_time_in(runners[place], window, noise) for place, window in looked_at]
    return min([most_s, *times])


def _time_in(runner: Runner, window: Window, noise: Array) -> float:
    """The time of a window; infinite where errors do not grow within it."""
    track, n = runner.track, runner.start_states
    if n == 0:
        return np.inf
    weight = np.where(track.seen, 1.0 / noise, 0.0)
    memory = runner.memory(track.p)
    x = WindowStart.of(runner, memory, window, track.p, weight, memory.x[:n]).from_readings()
    runner.enter(memory, x)
    Y, J, _ = runner.run(memory, window, track.p, True, weight)
    size = np.sqrt((J.reshape(*Y.shape, -1)[:, :, :n] ** 2).sum(axis=1))
    size = np.maximum.accumulate(size[:, size[0] > 0.0])
    later = np.arange(2, len(size))
    # a model that has run away shows no number: it has grown, too
    grown = ~(size[later] < GROWTH_LIMIT * size[later // 2]).all(axis=1)
    return float(later[grown][0] * track.period_s) if grown.any() else np.inf
