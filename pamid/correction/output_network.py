"""A network for what a fitted model leaves over: trained on the fitted part, judged on the held-out
one.

The correction is added to the model's output in the channel's unit (the first paper calls it a
torque, but trains on a difference of angles). Errors are mean absolute errors, eq. 11 of that
paper.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from pamid.base.errors import ConvergenceError, UsageError, nearest
from pamid.base.files import write_together
from pamid.base.json_file import json_bytes
from pamid.base.metrics import mae
from pamid.base.run_folder import Run
from pamid.correction.residual_data import MODELS, RESIDUAL_FILE, Leftover, derived, split_table
from pamid.networks.anfis import Anfis
from pamid.networks.batch import engine_on
from pamid.networks.elman import Elman
from pamid.networks.narx import Narx
from pamid.networks.network import Network
from pamid.networks.store import (
    NETWORK_FILE,
    WEIGHTS_FILE,
    TrainedNetwork,
    network_files,
    trace_csv,
    train_on_signals,
)
from pamid.networks.training import Progress, Training

Array = NDArray[np.float64]

CHECKPOINT_FILE, TRACE_FILE = "checkpoint.npz", "trace.csv"
HIDDEN = 10  # units of a network whose --hidden is not given: the first paper's
# left out of the second pair of errors: the network starts from a zero state
STARTUP_S = 1.0
MOST_RULES, MOST_SETS = 64, 5  # of an ANFIS whose --sets are not given
# between the taps of a NARX network: 10 samples at 3 ms, where this was measured
TAP_S = 0.03
SIZES: dict[str, tuple[str, ...]] = {"elman": ("hidden",), "anfis": ("sets",), "narx": ("hidden",)}


@dataclass(frozen=True)
class Wanted:
    """The kind of network that is asked for; sizes that are not (None) follow from its inputs.

    UsageError for an unknown kind, or a size of another kind.
    """

    kind: str = "elman"
    hidden: int | None = None
    sets: int | None = None

    def __post_init__(self) -> None:
        if self.kind not in SIZES:
            raise UsageError(
                f"--network {self.kind!r}: there is no such network.",
                nearest(self.kind, SIZES) or f"Take one of {', '.join(SIZES)}.",
                code="unknown-network",
            )
        for name in ("hidden", "sets"):
            owners = [kind for kind, sizes in SIZES.items() if name in sizes]
            if getattr(self, name) is not None and self.kind not in owners:
                raise UsageError(
                    f"--{name} belongs to --network {' or '.join(owners)}, not to {self.kind}."
                )

    def network(self, inputs: int, period_s: float, samples: int | None = None) -> Network:
        """The network for this many inputs, sampled every `period_s`; without --hidden of the
        paper's 10 units as many as this number of samples decides."""
        if self.kind == "anfis":
            return Anfis(inputs, _usual_sets(inputs) if self.sets is None else self.sets)

        def of(hidden: int) -> Network:
            if self.kind == "elman":
                return Elman(inputs, hidden)
            return Narx(inputs, hidden, stride=max(1, round(TAP_S / period_s)))

        if self.hidden is not None:
            return of(self.hidden)
        fewer = (of(hidden) for hidden in range(HIDDEN, 0, -1))
        return next((one for one in fewer if samples is None or one.n_weights <= samples), of(1))


def _usual_sets(inputs: int) -> int:
    """As many sets as make at most `MOST_RULES` rules."""
    if 2**inputs > MOST_RULES:
        raise UsageError(
            f"An ANFIS of {inputs} inputs has at least {2**inputs} rules, more than {MOST_RULES}.",
            "Name fewer with --inputs, or ask for them with --sets 2.",
        )
    return max(sets for sets in range(2, MOST_SETS + 1) if sets**inputs <= MOST_RULES)


@dataclass(frozen=True, eq=False)
class Correction:
    """A trained network and its correction of the model over every row of residual.csv (0 outside
    its stretches).

    mae: refitted, with_network on the held-out part, and both again `_after_1_s` of every stretch;
    channel's unit.
    """

    leftover: Leftover
    trained: TrainedNetwork
    training: Training
    values: Array
    mae: dict[str, float]

    @property
    def interrupted(self) -> bool:
        return self.training.why == "interrupted"


class Course(TypedDict, total=False):
    """How a network is trained: which one (default: Elman), where (cpu or a device that torch
    sees), and what goes to `networks.training.train`."""

    wanted: Wanted
    device: str
    independent: bool
    iterations: int
    seed: int
    starts: int
    threads: int
    checkpoint: Path | None
    resume: bool
    progress: Progress | None


def train_correction(leftover: Leftover, **course: Unpack[Course]) -> Correction:
    """Train on part 0, judge on part 1; errors as in `train_network`."""
    trained, training, values = train_network(leftover, leftover.channel, leftover.target, **course)
    return Correction(
        leftover,
        trained,
        training,
        values,
        held_out_mae(
            leftover,
            leftover.channel,
            refitted=leftover.columns[leftover.modelled],
            with_network=leftover.columns[leftover.modelled] + values,
        ),
    )


def train_network(
    leftover: Leftover, name: str, target: Array, **course: Unpack[Course]
) -> tuple[TrainedNetwork, Training, Array]:
    """A network for `target` (rows,) over part 0, and its values over all stretches, elsewhere 0
    (rows,).

    An interrupt ends the training with what it has; KeyboardInterrupt only where that is nothing.
    ConvergenceError where the training diverged at its very start; FileError for a checkpoint of
    another training.
    """
    own = leftover.of_part(0)
    scored = sum(s.rows.stop - s.rows.start - leftover.washout for s in own)
    network = course.pop("wanted", Wanted()).network(
        len(leftover.inputs), leftover.period_s, scored
    )
    engine = engine_on(course.pop("device", "cpu"), network)
    # the number of threads must not show in the last bits
    with threadpool_limits(limits=1, user_api="blas"):
        trained, training = train_on_signals(
            network,
            [leftover.signals(s) for s in own],
            [target[s.rows] for s in own],
            output_name=name,
            period_s=leftover.period_s,
            washout=leftover.washout,
            engine=engine,
            **course,
        )
        if not len(training.trace["iteration"]):
            if training.why == "interrupted":
                raise KeyboardInterrupt
            raise ConvergenceError(
                f"The training did not begin: {training.why}.", "Try another --seed."
            )
        values = np.zeros(len(target))
        for s in leftover.stretches:
            values[s.rows] = trained.predict(leftover.signals(s))
    return trained, training, values


def held_out_mae(leftover: Leftover, channel: str, **models: Array) -> dict[str, float]:
    """MAE of a channel by several models (rows,) over the scored held-out rows: by the model's
    name, and by it with `_after_1_s` where the start-up is left out, too."""
    startup = math.ceil(STARTUP_S / leftover.period_s - 1e-6)
    found: dict[str, float] = {}
    for ending, skip in (("", leftover.washout), ("_after_1_s", max(startup, leftover.washout))):
        rows = np.concatenate(
            [
                np.arange(s.rows.start + skip, max(s.rows.stop, s.rows.start + skip))
                for s in leftover.of_part(1)
            ]
        )
        if len(rows):  # windows may be shorter than the start-up
            measured = leftover.columns[channel][rows]
            found |= {
                f"{name}{ending}": mae(measured, model[rows]) for name, model in models.items()
            }
    return found


# ---- files -------------------------------------------------------------------------------------


def write_correction(run: Run, found: Correction) -> dict[str, Any]:
    """network.npz, network.json, trace.csv and the network's column of residual.csv; returns
    network.json."""
    one = found.leftover
    about = {
        "enters": "output",
        "model": one.model,
        "target": f"measured {one.channel} - {MODELS[one.model]}",
        "mae": {one.channel: {**found.mae, "part": "held-out"}},
        "notes": list(one.notes),
    }
    return write_network(
        run,
        found.trained,
        found.training,
        about,
        {one.channel: one.columns[one.modelled] + found.values},
    )


def write_network(
    run: Run,
    trained: TrainedNetwork,
    training: Training,
    about: dict[str, Any],
    corrected: dict[str, Array],
) -> dict[str, Any]:
    """network.npz, network.json with `about` in it, trace.csv and the corrected channels (rows,) in
    residual.csv; returns network.json."""
    weights, network, trace, residual = run.claim(
        WEIGHTS_FILE, NETWORK_FILE, TRACE_FILE, RESIDUAL_FILE
    )
    content, whole = network_files(trained, **about)
    write_together(
        {
            weights: content,
            network: json_bytes(whole, NETWORK_FILE),
            trace: trace_csv(training),
            residual: with_columns(
                residual,
                {derived(channel, "network"): values for channel, values in corrected.items()},
            ),
        }
    )
    return whole


def with_columns(path: Path, added: Mapping[str, Sequence[float] | Array]) -> bytes:
    """residual.csv with a network's columns at its end, in place of any earlier network's; other
    cells unchanged."""
    names, body = split_table(path)
    earlier = {derived(c, "network") for c in names}
    keep = [i for i, column in enumerate(names) if column not in earlier]
    whole = len(keep) == len(names)
    lines = [",".join([*(names[i] for i in keep), *added])]
    for line, values in zip(body, zip(*added.values(), strict=True), strict=True):
        if not whole:
            cells = line.split(",")
            line = ",".join([cells[i] for i in keep])
        lines.append(",".join([line, *(f"{value:.9g}" for value in values)]))
    return ("\n".join(lines) + "\n").encode()
