"""The gap budget: what the data sheet leaves, what retuned parameters leave, the noise floor, and
how far a black box without physics would get on the same windows."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import ConvergenceError
from pamid.base.metrics import seen_mean
from pamid.base.progress import Progress, Settled
from pamid.base.units import column_size
from pamid.diagnosis.candidate_model import CandidateModel, candidate_from
from pamid.diagnosis.serialise import grey_box_plain, grey_box_restored
from pamid.diagnosis.settings import DEFAULT, Settings
from pamid.estimation.grey_box import GreyBox, fit_model
from pamid.model.bound_parameter import Sizes
from pamid.parallel.jobs import ObjectWork, Work, WorkerPool
from pamid.parallel.result_store import Plain
from pamid.simulation.data_split import DataSplit
from pamid.simulation.replay import Replay, replay_track

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Budget:
    """Mean absolute errors per held-out window and channel (SI): data sheet, refitted baseline,
    floor, black box; settings: of the diagnosis that it is part of."""

    model: GreyBox
    baseline: CandidateModel
    data_sheet: Array
    floor: Array
    black_box: Array
    settings: Settings = DEFAULT

    @property
    def sizes(self) -> Sizes:
        return self.model.assembly.sizes

    def excess(self, absolutes: Array, rows: NDArray[np.bool_]) -> float:
        """Error above the floor, in floors, summed over channels."""
        floor = seen_mean(self.floor[rows])
        return float(np.nansum(np.maximum(seen_mean(absolutes[rows]) / floor - 1.0, 0.0)))

    def shrinkage(
        self, absolutes: Array, rows: NDArray[np.bool_] | NDArray[np.intp] | slice = slice(None)
    ) -> float:
        """1 - error/baseline error over these held-out windows (default: all), channels weighed by
        their floors."""
        floor = seen_mean(self.floor)
        before = np.nansum(seen_mean(self.baseline.absolutes[rows]) / floor)
        return float(1.0 - np.nansum(seen_mean(absolutes[rows]) / floor) / before)

    def channel_losses(self, absolutes: Array) -> Array:
        """One loss per window: channels added in units of their floors."""
        return np.asarray(np.nansum(absolutes / seen_mean(self.floor), axis=1))

    def error_text(self) -> str:
        """Of every channel, in its unit: the error with the data sheet, refitted, the floor."""
        before, after, floor = (
            seen_mean(one) for one in (self.data_sheet, self.baseline.absolutes, self.floor)
        )
        return "; ".join(
            f"{name} {column_size(name, before[k]):.3g} -> {column_size(name, after[k]):.3g} "
            f"(floor {column_size(name, floor[k]):.3g})"
            for k, name in enumerate(self.model.evidence.channels)
        )


def gap_budget(
    evidence: DataSplit, *, seed: int, pool: WorkerPool, progress: Progress, settings: Settings
) -> Budget:
    """The baseline, fitted (parameters and background) and replayed, with the noise floor and the
    error of a black box."""
    model = pool.one(_Baseline(evidence, progress), seed)
    if not model.fit.residuals:
        raise ConvergenceError(
            f"The model could not be fitted: {model.fit.why}.",
            "check the units of the columns, and starting values and bounds of the rig",
        )
    floor = _losses(model.floor)
    budget = Budget(
        model,
        candidate_from(model.assembly, model.fit, model.held_out),
        _losses(model.data_sheet),
        floor,
        np.full_like(floor, np.nan),
        settings,
    )
    progress(Settled(f"refitted, held-out errors: {budget.error_text()}"))
    progress("black box on what is left")
    return replace(budget, black_box=pool.one(_BlackBox(model, settings), seed))


@dataclass(frozen=True, eq=False)
class _Baseline(ObjectWork[int, GreyBox]):
    """Items are seeds."""

    what = "fitting"
    evidence: DataSplit
    progress: Progress = field(compare=False)

    def result(self, item: int) -> GreyBox:
        return fit_model(self.evidence, seed=item, progress=self.progress)

    def plain_form(self, item: int, found: GreyBox) -> Plain:
        return grey_box_plain(found)

    def restored(self, item: int, found: Plain) -> GreyBox:
        return grey_box_restored(self.evidence, found)


@dataclass(frozen=True, eq=False)
class _BlackBox(Work[int, Array]):
    """Items are seeds."""

    what = "black box"
    model: GreyBox
    settings: Settings

    def __call__(self, item: int) -> Plain:
        m = self.model
        training = [
            replay_track(m.assembly, m.fit.p, t, m.fit.stepping, m.evidence.noise)
            for t in m.fit.problem.tracks
        ]
        floor = seen_mean(_losses(m.floor))
        return {"left": black_box(training, list(m.held_out), item, floor, self.settings)}

    def restored(self, item: int, found: Plain) -> Array:
        left: Array = found["left"]
        return left


def _losses(replays: tuple[Replay, ...]) -> Array:
    return np.concatenate([r.losses(1) for r in replays])


def black_box(
    training: list[Replay], held_out: list[Replay], seed: int, floor: Array, settings: Settings
) -> Array:
    """Mean absolute error per held-out window and channel after an Elman network has been put on
    the residual.

    One network per channel, started afresh in every window as the replay is; its inputs are the
    rig's inputs and the model's outputs with their rates, of many their leading principal
    components. Trained on the windows the parameters were fitted on. Where it does harm on what was
    held out, or where next to nothing is left above the floor (per channel), the error without it
    stands.
    """
    from pamid.networks.elman import Elman
    from pamid.networks.network_training import train

    rows_in, rows_out = (
        [w for r in replays for w in _windows(r, settings.black_box_samples)]
        for replays in (training, held_out)
    )
    stacked = np.concatenate([x for x, _, _ in rows_in])
    centre, spread = stacked.mean(axis=0), stacked.std(axis=0)
    use = spread > 1e-9 * (np.abs(centre) + 1e-12)
    # from physical inputs to those of the network: two standard deviations become 1, as it expects
    turn = np.diag(0.5 / (spread + 1e-300))[:, use]
    most = settings.black_box_inputs
    if turn.shape[1] > most:
        turn = turn @ np.linalg.svd((stacked - centre) @ turn, full_matrices=False)[2][:most].T
    inputs, unseen = ([(x - centre) @ turn for x, _, _ in rows] for rows in (rows_in, rows_out))
    result = np.empty((len(rows_out), training[0].model.shape[1]))
    for c in range(result.shape[1]):
        without = np.array([np.abs(y[scored, c]).mean() for _, y, scored in rows_out])
        result[:, c] = without
        if seen_mean(without) < settings.black_box_least * floor[c]:
            continue
        having = [i for i, (_, y, _) in enumerate(rows_in) if not np.isnan(y[0, c])]
        target = [rows_in[i][1][:, c] for i in having]
        scale = np.concatenate(target).std() + 1e-300
        network = Elman(turn.shape[1], settings.black_box_neurons)
        done = train(
            network,
            [inputs[i] for i in having],
            [t / (2.0 * scale) for t in target],
            iterations=settings.black_box_iterations,
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


def _windows(r: Replay, samples: int) -> list[tuple[Array, Array, NDArray[np.bool_]]]:
    """(inputs, residual, scored) per window, thinned to about so many samples."""
    out = []
    for w in r.windows:
        step = max(1, (w.stop - w.start) // samples)
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
