"""The gap budget: what the data sheet leaves, what retuned parameters leave, the noise floor, and
how far a black box without physics would get on the same windows."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pamid.base.metrics import seen_mean
from pamid.base.progress import Progress
from pamid.diagnosis.contender import Contender, contender_from
from pamid.diagnosis.serialise import grey_box_of, grey_box_plain
from pamid.estimation.grey_box import GreyBox, fit_model
from pamid.model.bound_parameter import Sizes
from pamid.parallel.jobs import Work, WorkerPool
from pamid.parallel.store import Plain
from pamid.simulation.data_split import DataSplit
from pamid.simulation.replay import Replay, replay_track

Array = NDArray[np.float64]

POINTS = 120  # per window: the network sees the replay thinned to this
ITERATIONS = 30
INPUTS = 12  # of the network, at most
NOTHING_LEFT = 1.05  # floors of error below which a network is not asked
NO_GAP = 0.10  # a structural gap below this share of the floor is none


@dataclass(frozen=True)
class Budget:
    """Mean absolute errors per held-out window and channel (SI): data sheet, refitted baseline,
    floor, black box."""

    model: GreyBox
    baseline: Contender
    data_sheet: Array
    floor: Array
    black_box: Array

    @property
    def sizes(self) -> Sizes:
        return self.model.assembly.sizes

    def excess(self, absolutes: Array, rows: NDArray[np.bool_]) -> float:
        """Error above the floor, in floors, summed over channels."""
        floor = seen_mean(self.floor[rows])
        return float(np.nansum(np.maximum(seen_mean(absolutes[rows]) / floor - 1.0, 0.0)))

    def shrinkage(self, absolutes: Array, rows: NDArray[np.bool_] | NDArray[np.intp]) -> float:
        """1 - error/baseline error, channels weighed by their floors."""
        floor = seen_mean(self.floor)
        before = np.nansum(seen_mean(self.baseline.absolutes[rows]) / floor)
        return float(1.0 - np.nansum(seen_mean(absolutes[rows]) / floor) / before)

    def channel_losses(self, absolutes: Array) -> Array:
        """One loss per window: channels added in units of their floors."""
        return np.asarray(np.nansum(absolutes / seen_mean(self.floor), axis=1))


def gap_budget(evidence: DataSplit, *, seed: int, pool: WorkerPool, progress: Progress) -> Budget:
    """Fit the baseline (parameters and background), replay it, and set the floor and the ceiling
    beside it."""
    model = pool.one(_Baseline(evidence, progress), seed)
    progress("black box on what is left")
    return Budget(
        model,
        contender_from(model.assembly, model.fit, model.held_out),
        _losses(model.data_sheet),
        _losses(model.floor),
        pool.one(_BlackBox(model), seed),
    )


@dataclass(frozen=True, eq=False)
class _Baseline(Work[int, GreyBox]):
    """Items are seeds."""

    what = "fitting"
    evidence: DataSplit
    progress: Progress = field(compare=False)

    def __call__(self, item: int) -> Plain:
        return grey_box_plain(fit_model(self.evidence, seed=item, progress=self.progress))

    def restored(self, item: int, found: Plain) -> GreyBox:
        return grey_box_of(self.evidence, found)


@dataclass(frozen=True, eq=False)
class _BlackBox(Work[int, Array]):
    """Items are seeds."""

    what = "black box"
    model: GreyBox

    def __call__(self, item: int) -> Plain:
        m = self.model
        training = [
            replay_track(m.assembly, m.fit.p, t, m.fit.stepping, m.evidence.noise)
            for t in m.evidence.tracks(m.assembly)
        ]
        return {"left": black_box(training, list(m.held_out), item, seen_mean(_losses(m.floor)))}

    def restored(self, item: int, found: Plain) -> Array:
        left: Array = found["left"]
        return left


def _losses(replays: tuple[Replay, ...]) -> Array:
    return np.concatenate([r.losses(1) for r in replays])


def black_box(training: list[Replay], held_out: list[Replay], seed: int, floor: Array) -> Array:
    """Mean absolute error per held-out window and channel after an Elman network has been put on
    the residual.

    One network per channel, started afresh in every window as the replay is; its inputs are the
    rig's inputs and the model's outputs with their rates, of many their leading principal
    components. Trained on the windows the parameters were fitted on. Where it does harm on what was
    held out, or where next to nothing is left above the floor (per channel), the error without it
    stands.
    """
    from pamid.networks.elman import Elman
    from pamid.networks.training import train

    rows_in = [w for r in training for w in _windows(r)]
    rows_out = [w for r in held_out for w in _windows(r)]
    stacked = np.concatenate([x for x, _, _ in rows_in])
    centre, spread = stacked.mean(axis=0), stacked.std(axis=0)
    use = spread > 1e-9 * (np.abs(centre) + 1e-12)
    turn = np.diag(0.5 / (spread + 1e-300))[:, use]
    if turn.shape[1] > INPUTS:
        turn = turn @ np.linalg.svd((stacked - centre) @ turn, full_matrices=False)[2][:INPUTS].T
    inputs, unseen = ([(x - centre) @ turn for x, _, _ in rows] for rows in (rows_in, rows_out))
    result = np.empty((len(rows_out), training[0].model.shape[1]))
    for c in range(result.shape[1]):
        without = np.array([np.abs(y[scored, c]).mean() for _, y, scored in rows_out])
        result[:, c] = without
        if seen_mean(without) < NOTHING_LEFT * floor[c]:
            continue
        having = [i for i, (_, y, _) in enumerate(rows_in) if not np.isnan(y[0, c])]
        target = [rows_in[i][1][:, c] for i in having]
        scale = np.concatenate(target).std() + 1e-300
        network = Elman(turn.shape[1], 8)
        done = train(
            network,
            [inputs[i] for i in having],
            [t / (2.0 * scale) for t in target],
            iterations=ITERATIONS,
            seed=seed,
        )
        guesses = [network.simulate(done.weights, x) for x in unseen]
        left = np.array(
            [
                np.minimum(np.abs((y[:, c] - 2.0 * scale * g)[scored]).mean(), 1e300)
                for g, (_, y, scored) in zip(guesses, rows_out, strict=True)
            ]
        )
        if seen_mean(left) < seen_mean(without):
            result[:, c] = left
    return result


def _windows(r: Replay) -> list[tuple[Array, Array, NDArray[np.bool_]]]:
    """(inputs, residual, scored) per window, thinned."""
    out = []
    for w in r.windows:
        step = max(1, (w.stop - w.start) // POINTS)
        model = r.model[w.start : w.stop]
        rate = np.gradient(model, axis=0) if len(model) > 2 else np.zeros_like(model)
        x = np.concatenate([r.track.u[w.start : w.stop], model, rate], axis=1)[::step]
        left = np.where(r.seen, r.residual[w.start : w.stop], np.nan)[::step]
        out.append(
            (
                np.ascontiguousarray(x),
                np.ascontiguousarray(left),
                r.scored[w.start : w.stop][::step],
            )
        )
    return out
