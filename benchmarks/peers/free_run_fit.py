"""A grey-box fit by the error of the free run over a whole record, and free runs.

First as `pamid fit` does it, in windows that begin where they like. Then the windows are tied
together, tighter in every round, until the states go through without a jump and the cost is that of
one free run (multiple shooting with its continuity as a constraint: Bock (1983)). The first samples
of the record count with the sensor's noise, so that the run begins where a test run may begin: at
the state that they show.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pamid.engine.program import Stepping
from pamid.estimation.grey_box import model_with
from pamid.estimation.multiple_shooting import fit
from pamid.estimation.observed_sizes import observed_sizes
from pamid.estimation.problem import Fit, FitStart, Problem, free_parameters
from pamid.estimation.robust_fit import fit_robustly
from pamid.estimation.weights import Weights
from pamid.model.assembly import Assembly
from pamid.model.registry import rig_named
from pamid.recording.recording import read_recording
from pamid.simulation.data_split import DataSplit, Span, split_recordings
from pamid.simulation.initial_state import WindowStart
from pamid.simulation.tracks import Track
from pamid.simulation.virtual_rig import attach_specs
from pamid.simulation.windows import Runner, Window, cut

Array = NDArray[np.float64]

#: of what a state may depart from where it was carried to, per round: from the usual to nothing
TIES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-5)
PIECES = 8  # windows behind the first samples
STEPS = 60


@dataclass(frozen=True, eq=False)
class Anchored(Problem):
    """A fit whose first window is the samples that show the start."""

    start_samples: int = 0

    def windows(self, track: Track) -> list[Window]:
        n = self.start_samples
        rest = cut(len(track) - n, (len(track) - n) // PIECES)
        return [Window(0, n), *(Window(w.start + n, w.stop + n) for w in rest)]


def evidence(rig: str, record: Path) -> DataSplit:
    """The whole record, to fit; nothing of it is held out."""
    recording = read_recording(record)
    split = split_recordings(rig_named(rig), [recording], [])
    whole = (Span(split.recordings[0], 0, len(recording)),)
    return replace(split, fit=whole, held_out=whole)


def fit_free_run(rig: str, effects: tuple[str, ...], record: Path, start_samples: int) -> Fit:
    """The rig with these effects, fitted to the record's free run."""
    split = evidence(rig, record)
    attached = tuple(a for a, _ in attach_specs(split.rig, effects))
    assembly = model_with(split, attached, observed_sizes(split))
    tracks = split.tracks(assembly)
    found = fit_robustly(Problem(assembly, tracks, free_parameters(assembly, tracks)))
    starts: tuple[Array, ...] | None = None
    for tie in TIES:
        sigma = np.maximum(
            np.sqrt(np.mean(np.concatenate(found.residuals) ** 2, axis=0)), found.problem.noise
        )
        problem = Anchored(assembly, tracks, found.problem.free, start_samples=start_samples)
        weight = np.ones(PIECES + 1)
        weight[0] = float(np.max(sigma / problem.noise) ** 2)
        tried = fit(
            replace(problem, importance=weight),
            FitStart(
                p=found.p,
                starts=starts,
                weights=Weights(sigma, np.ones_like(sigma)),
                stepping=found.stepping,
                continuity=tuple(1.0 / (tie * t.jump) ** 2 for t in tracks),
            ),
            iterations=STEPS,
            tolerance=1e-3,
        )
        if not tried.residuals:
            break
        found, starts = tried, tried.starts
    return found


@dataclass(frozen=True, eq=False)
class Free:
    """A model that runs freely: p its parameters, noise of its one output, carried the state where
    a few samples do not show it (SI); track: of a recording that it fits."""

    assembly: Assembly
    p: Array
    stepping: Stepping
    track: Track
    noise: Array
    carried: Array

    def run(self, columns: dict[str, Array], y0: Array, period_s: float) -> Array:
        """Free run (samples,) on inputs (SI, by column) from the state that the first samples y0 of
        the one output show."""
        u = np.column_stack([columns[name] for name in self.assembly.traced.inputs])
        y = np.zeros((len(u), 1))  # nothing of it is looked at behind y0
        y[: len(y0), 0] = y0
        track = replace(self.track, u=u, y=y, period_s=period_s, first=0, lead=0)
        runner = Runner(self.assembly, track, self.stepping)
        p = runner.parameters(self.p)
        memory = runner.memory(p)
        first = Window(0, len(y0))
        x, usable = WindowStart.of(
            runner, memory, first, p, 1.0 / self.noise, self.carried
        ).estimate(steps=30)
        runner.enter(memory, x if usable else self.carried)
        Y, _, _ = runner.run(memory, Window(0, len(u)), p, False)
        return np.asarray(Y[:, 0])


def free(found: Fit) -> Free:
    """The fitted model; what first samples do not show stays where the fitted record began."""
    problem = found.problem
    return Free(
        problem.assembly,
        found.p,
        found.stepping,
        problem.tracks[0],
        problem.noise,
        found.starts[0][0],
    )
