"""A network for what a fitted model leaves over: trained on the fitted part, judged on the held-out
part.

The correction is added to the model's output in the channel's unit (the first paper calls it a
torque, but trains on a difference of angles). Errors are mean absolute errors, eq. 11 of that
paper.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from pamid.base.arrays import Array
from pamid.base.csv_table import header_line
from pamid.base.errors import ConvergenceError, FileError, UsageError, nearest
from pamid.base.files import TABLE, WEIGHTS, read_data, write_together
from pamid.base.json_file import json_bytes, read_json
from pamid.base.metrics import mae
from pamid.base.network_folders import (
    NETWORK_FILES,
    TRACE_FILE,
    channel_network_files,
    channel_networks,
)
from pamid.base.run_folder import NETWORK_FILE, WEIGHTS_FILE, Run
from pamid.networks.correction.residual_data import RESIDUAL_FILE, ResidualData, derived
from pamid.networks.network import Network
from pamid.networks.network_training import Training
from pamid.networks.trained_network import (
    TrainedNetwork,
    load_network,
    network_files,
    network_kinds,
    trace_csv,
    train_on_signals,
)
from pamid.networks.training_problem import TrainingOptions

CHECKPOINT_FILE = "checkpoint.npz"
# left out of the second pair of errors: the network starts from a zero state
STARTUP_S = 1.0


@dataclass(frozen=True)
class NetworkChoice:
    """The kind of network that is wanted; sizes that are not (or None) follow from its inputs.

    UsageError for an unknown kind, or a size of another kind.
    """

    kind: str = "elman"
    sizes: Mapping[str, int | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        kinds = network_kinds()
        if self.kind not in kinds:
            raise UsageError(
                f"--network {self.kind!r}: there is no such network.",
                nearest(self.kind, kinds) or f"Choose from {', '.join(kinds)}.",
                code="unknown-network",
            )
        for name in self._stated_sizes:
            owners = [kind for kind, candidate in kinds.items() if name in candidate.size_options]
            if self.kind not in owners:
                raise UsageError(
                    f"--{name} belongs to --network {' or '.join(owners)}, not to {self.kind}."
                )

    @property
    def _stated_sizes(self) -> dict[str, int]:
        return {name: size for name, size in self.sizes.items() if size is not None}

    def network(self, inputs: int, period_s: float, samples: int | None = None) -> Network:
        """The network for this many inputs and samples, sampled every `period_s`."""
        return network_kinds()[self.kind].sized(inputs, period_s, samples, **self._stated_sizes)


@dataclass(frozen=True, eq=False)
class Correction:
    """A trained network, and what becomes of the channels that it corrects.

    enters: "output", or {"port": name}; target: what it was trained on, in words; outputs:
    corrected channels over every row of residual.csv, in their units; mae: of every channel on the
    held-out part, refitted, with_cause (of a network trained on the model with the causes) and
    with_network, at a port with_output_network, too, and all again `_after_1_s` of every stretch;
    parameters: at a port those of the corrected model that were fitted, by name in its unit;
    interrupted: the training was, or that of the network it is compared with.
    """

    residual: ResidualData
    trained: TrainedNetwork
    training: Training
    enters: str | dict[str, str]
    target: str
    outputs: dict[str, Array]
    mae: dict[str, dict[str, float]]
    notes: tuple[str, ...]
    interrupted: bool
    parameters: dict[str, float] | None = None


def train_correction(
    residual: ResidualData,
    wanted: NetworkChoice = NetworkChoice(),
    options: TrainingOptions = TrainingOptions(),  # noqa: B008 (frozen)
) -> Correction:
    """Train on part 0, judge on part 1; errors as in `train_network`."""
    channel = residual.channel
    trained, training, values = train_network(residual, channel, residual.target, wanted, options)
    # outside the stretches the model stays as it is
    corrected = residual.columns[residual.modelled] + values
    errors = held_out_mae(residual, channel, **residual.models(channel), with_network=corrected)
    return Correction(
        residual,
        trained,
        training,
        "output",
        f"measured {channel} - {residual.model_words}",
        {channel: corrected},
        {channel: errors},
        residual.notes,
        interrupted=training.why == "interrupted",
    )


def train_network(
    residual: ResidualData,
    name: str,
    target: Array,
    wanted: NetworkChoice,
    options: TrainingOptions,
) -> tuple[TrainedNetwork, Training, Array]:
    """A network for `target` (rows,) over part 0, and its values over all stretches, elsewhere 0
    (rows,).

    An interrupt ends the training with what it has; KeyboardInterrupt only where that is nothing.
    ConvergenceError where the training diverged at its very start; FileError for a checkpoint of
    another training.
    """
    training_part = residual.of_part(0)
    scored = sum(s.rows.stop - s.rows.start - residual.washout for s in training_part)
    # the number of threads must not show in the last bits
    with threadpool_limits(limits=1, user_api="blas"):
        trained, training = train_on_signals(
            wanted.network(len(residual.inputs), residual.period_s, scored),
            [residual.signals(s) for s in training_part],
            [target[s.rows] for s in training_part],
            output_name=name,
            period_s=residual.period_s,
            options=replace(options, washout=residual.washout),
        )
        if not len(training.trace["iteration"]):
            if training.why == "interrupted":
                raise KeyboardInterrupt
            raise ConvergenceError(
                f"The training did not begin: {training.why}.", "Try another --seed."
            )
        values = np.zeros(len(target))
        for s in residual.stretches:
            values[s.rows] = trained.predict(residual.signals(s))
    return trained, training, values


def held_out_mae(residual: ResidualData, channel: str, **models: Array) -> dict[str, float]:
    """MAE of a channel by several models (rows,) over the scored held-out rows: by the model's
    name, and by it with `_after_1_s` where the start-up is left out, too."""
    startup = math.ceil(STARTUP_S / residual.period_s - 1e-6)
    errors: dict[str, float] = {}
    for ending, skip in (("", residual.washout), ("_after_1_s", max(startup, residual.washout))):
        rows = np.concatenate(
            [
                np.arange(s.rows.start + skip, max(s.rows.stop, s.rows.start + skip))
                for s in residual.of_part(1)
            ]
        )
        if len(rows):  # windows may be shorter than the start-up
            measured = residual.columns[channel][rows]
            errors |= {
                f"{name}{ending}": mae(measured, model[rows]) for name, model in models.items()
            }
    return errors


# ---- files -------------------------------------------------------------------------------------


def write_correction(run: Run, correction: Correction) -> dict[str, Any]:
    """network.npz, network.json, trace.csv and the corrected channels in residual.csv; returns
    network.json. An earlier network of another channel is kept next to it."""
    c = correction
    about: dict[str, Any] = {
        "enters": c.enters,
        "model": c.residual.model,
        "on": c.residual.on,
        "target": c.target,
        "mae": {channel: {**mae, "part": "held-out"} for channel, mae in c.mae.items()},
        "notes": list(c.notes),
    }
    if c.parameters is not None:
        about["parameters"] = c.parameters
    others = keep_others(run, c.enters, c.trained.output_name)
    stale = set(channel_networks(run.folder)) - others
    weights, network, trace, residual = run.claim(
        WEIGHTS_FILE, NETWORK_FILE, TRACE_FILE, RESIDUAL_FILE
    )
    weights_data, content = network_files(c.trained, **about)
    write_together(
        {
            weights: weights_data,
            network: json_bytes(content, NETWORK_FILE),
            trace: trace_csv(c.training),
            residual: with_columns(
                residual,
                {derived(channel, "network"): values for channel, values in c.outputs.items()},
                {derived(channel, "network") for channel in others},
            ),
        }
    )
    run.remove(*(file for channel in stale for file in channel_network_files(channel)))
    return content


def keep_others(run: Run, enters: str | dict[str, str], channel: str) -> set[str]:
    """Copy the run's network before the network of `channel` is written, and return the
    channels whose networks stay: those at the output. A network inside the equations moves every
    channel, and stays alone; what cannot be read is not kept."""
    try:
        if not (run.folder / NETWORK_FILE).exists():
            return set()
        earlier = read_json(run.folder / NETWORK_FILE)
        at_output = isinstance(earlier, dict) and earlier.get("enters") == "output"
        if not at_output or enters != "output":
            return set()
        before = load_network(run.folder).output_name
        others = {*channel_networks(run.folder), before} - {channel}
        if before in others:
            data = [read_data(run.folder / name, WEIGHTS) for name in NETWORK_FILES]
            files = run.claim(*channel_network_files(before))
            write_together(dict(zip(files, data, strict=True)))
    except FileError:
        return set()
    return others


def with_columns(
    path: Path,
    added: Mapping[str, Sequence[float] | Array],
    others: Collection[str] = (),
) -> bytes:
    """residual.csv with a network's columns at its end, in place of those of any earlier network
    but the ones that are kept; other cells unchanged."""
    first, *body = [line for line in read_data(path, TABLE).decode().split("\n") if line]
    names = first.split(",")
    earlier = {derived(c, "network") for c in names} - (set(others) - set(added))
    keep = [i for i, column in enumerate(names) if column not in earlier]
    lines = [header_line([*(names[i] for i in keep), *added]).rstrip("\n")]
    for line, values in zip(body, zip(*added.values(), strict=True), strict=True):
        cells = line.split(",")
        lines.append(",".join([*(cells[i] for i in keep), *(f"{value:.9g}" for value in values)]))
    return ("\n".join(lines) + "\n").encode()
