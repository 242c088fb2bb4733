"""A network for what a fitted model leaves over: trained on the fitted part, judged on the held-out one.

The correction is added to the model's output in the channel's unit (the first paper calls it a torque, but trains on a
difference of angles). Errors are mean absolute errors, eq. 11 of that paper.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from pamid.errors import ConvergenceError, UsageError, nearest
from pamid.leftover import MODELS, RESIDUAL_FILE, Leftover, derived, split_table
from pamid.metrics import mae
from pamid.networks.elman import Elman
from pamid.networks.store import NETWORK_FILE, TrainedNetwork, save_network, trace_csv, train_on_signals
from pamid.networks.training import Progress, Training
from pamid.run import Run, read_json, write_atomically, write_json

Array = NDArray[np.float64]

CHECKPOINT_FILE, TRACE_FILE = "checkpoint.npz", "trace.csv"
STARTUP_S = 1.0            # left out of the second pair of errors: the network starts from a zero state
NETWORKS = ("elman",)
LATER = ("anfis", "narx")


@dataclass(frozen=True, eq=False)
class Correction:
    """A trained network and its correction of the model over every row of residual.csv (0 outside its stretches).

    mae: refitted, with_network on the held-out part, and both again `_after_1_s` of every stretch; channel's unit.
    """

    leftover: Leftover
    trained: TrainedNetwork
    training: Training
    values: Array
    mae: dict[str, float]

    @property
    def interrupted(self) -> bool:
        return self.training.why == "interrupted"


def require_network(kind: str) -> None:
    """UsageError unless this version can train that kind of network."""
    if kind in LATER:
        raise UsageError(f"--network {kind}: this version trains elman networks only; {kind} comes with a later one.",
                         "Take --network elman.", code="unknown-network")
    if kind not in NETWORKS:
        raise UsageError(f"--network {kind!r}: there is no such network.",
                         nearest(kind, NETWORKS) or "Take --network elman.", code="unknown-network")


def train_correction(leftover: Leftover, *, kind: str = "elman", hidden: int = 10, iterations: int = 1000,
                     seed: int = 0, starts: int = 1, checkpoint: Path | None = None, resume: bool = False,
                     progress: Progress | None = None) -> Correction:
    """Train on part 0, judge on part 1.

    An interrupt ends the training with what it has; KeyboardInterrupt only where that is nothing. ConvergenceError
    where the training diverged at its very start; FileError for a checkpoint of another training.
    """
    require_network(kind)
    network = Elman(inputs=len(leftover.inputs), hidden=hidden)
    own, target = leftover.of_part(0), leftover.target
    with threadpool_limits(limits=1, user_api="blas"):  # the number of threads must not show in the last bits
        trained, training = train_on_signals(
            network, [leftover.signals(s) for s in own], [target[s.rows] for s in own],
            output_name=leftover.channel, period_s=leftover.period_s, iterations=iterations, seed=seed,
            starts=starts, washout=leftover.washout, checkpoint=checkpoint, resume=resume, progress=progress)
        if not len(training.trace["iteration"]):
            if training.why == "interrupted":
                raise KeyboardInterrupt
            raise ConvergenceError(f"The training did not begin: {training.why}.", "Try another --seed.")
        values = np.zeros(len(target))
        for s in leftover.stretches:
            values[s.rows] = trained.predict(leftover.signals(s))
    return Correction(leftover, trained, training, values, _held_out_mae(leftover, values))


def _held_out_mae(leftover: Leftover, correction: Array) -> dict[str, float]:
    """MAE over the scored held-out rows, without and with the correction, all and after the start-up."""
    startup = math.ceil(STARTUP_S / leftover.period_s - 1e-6)
    found = {}
    for ending, skip in (("", leftover.washout), ("_after_1_s", max(startup, leftover.washout))):
        rows = np.concatenate([np.arange(s.rows.start + skip, max(s.rows.stop, s.rows.start + skip))
                               for s in leftover.of_part(1)])
        if len(rows):  # windows may be shorter than the start-up
            measured, model = (leftover.columns[n][rows] for n in (leftover.channel, leftover.modelled))
            found[f"refitted{ending}"] = mae(measured, model)
            found[f"with_network{ending}"] = mae(measured, model + correction[rows])
    return found


# ---- files -------------------------------------------------------------------------------------------------------


def write_correction(run: Run, found: Correction) -> dict[str, Any]:
    """network.npz, network.json, trace.csv and the network's column of residual.csv; returns network.json."""
    one = found.leftover
    save_network(run.folder, found.trained)
    about = read_json(run.path(NETWORK_FILE))
    about |= {"model": one.model, "target": f"measured {one.channel} - {MODELS[one.model]}",
              "mae": {one.channel: {**found.mae, "part": "held-out"}}, "notes": list(one.notes)}
    write_json(run.path(NETWORK_FILE), about)
    write_atomically(run.path(TRACE_FILE), trace_csv(found.training))
    corrected = one.columns[one.modelled] + found.values
    table = with_column(run.path(RESIDUAL_FILE), derived(one.channel, "network"), corrected)
    write_atomically(run.path(RESIDUAL_FILE), table)
    return dict(about)


def with_column(path: Path, name: str, values: Sequence[float] | Array) -> bytes:
    """residual.csv with a network's column at its end, in place of any earlier network's; other cells unchanged."""
    names, body = split_table(path)
    earlier = {derived(c, "network") for c in names}
    keep = [i for i, column in enumerate(names) if column not in earlier]
    whole = len(keep) == len(names)
    lines = [",".join([*(names[i] for i in keep), name])]
    for line, value in zip(body, values, strict=True):
        if not whole:
            cells = line.split(",")
            line = ",".join([cells[i] for i in keep])
        lines.append(f"{line},{value:.9g}")
    return ("\n".join(lines) + "\n").encode()
