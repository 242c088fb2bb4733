"""A trained network with everything needed to use it on signals in their units, and its two
files.

`network.json` (schema pamid.network/1) is for people and scripts: kind, sizes, names and scaling of
inputs and output, sampling period, how the training went, and the SHA-256 of `network.npz`, which
holds the weights at full precision. Loading reads strict JSON and plain arrays; no code in either
file is ever run. The same network gives the same bytes.

A kind of network is a module of this package of that name, holding a dataclass with that `kind`: a
new network is a single new file.
"""

import hashlib
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pamid.base.arrays import Array
from pamid.base.csv_table import table_bytes
from pamid.base.errors import DataError, FileError, PamidError, nearest
from pamid.base.files import WEIGHTS, read_data, write_together
from pamid.base.json_file import json_bytes, read_json
from pamid.base.npz import load_arrays
from pamid.base.run_folder import NETWORK_FILE, WEIGHTS_FILE
from pamid.base.scanned import classes_of, modules_of
from pamid.base.schemas.network_file import NetworkFile, ScaledSignal, TrainingSummary, WeightsFile
from pamid.networks.network import Network
from pamid.networks.network_training import Training, train
from pamid.networks.scaling import Scaling, check_finite, scaling_of
from pamid.networks.training_problem import TrainingOptions

Signals = Mapping[str, ArrayLike]

NETWORK_SCHEMA = "pamid.network/1"
_REMEDY = "Train the network again."


@dataclass(frozen=True)
class TrainedNetwork:
    """A network with the meaning of its numbers.

    Names carry their unit after the last underscore (`angle_deg`), as in a recording; the scalings
    are in these units and in the order of the network's inputs. `period_s` is the sampling period
    of the training, the only period for which the network is valid. `summary` describes the
    training; it is not needed to predict.
    """

    network: Network
    weights: Array
    input_names: tuple[str, ...]
    output_name: str
    input_scaling: Scaling
    output_scaling: Scaling
    period_s: float
    summary: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(set(self.input_names)) != len(self.input_names):
            raise DataError("The inputs of a trained network need different names.")
        if not (np.isfinite(self.period_s) and self.period_s > 0.0):
            raise DataError(f"The sampling period must be positive, not {self.period_s} s.")
        # refuses a wrong number of inputs
        self.network.simulate(self.weights, np.zeros((1, len(self.input_names))))

    def predict(self, inputs: Signals) -> Array:
        """The output (N,) in its unit, from a zero state, for inputs sampled every `period_s`.

        `inputs` holds an array (N,) per input name, in its unit (others are ignored). DataError
        names a signal that is missing, or a value that is not finite.
        """
        table = _columns(inputs, self.input_names)
        check_finite(table, self.input_names)
        return self.output_scaling.backward(
            self.network.simulate(self.weights, self.input_scaling.forward(table))
        )


def train_on_signals(
    network: Network,
    signals: Signals | Sequence[Signals],
    output: ArrayLike | Sequence[ArrayLike],
    *,
    output_name: str,
    period_s: float,
    options: TrainingOptions = TrainingOptions(),  # noqa: B008 (frozen)
) -> tuple[TrainedNetwork, Training]:
    """Scale, train and bind together: `signals` by name in their units, in the order of the
    network's inputs.

    Several recordings are lists of signals and of outputs; a common scaling spans them all.
    DataError as in `scaling_of` and `train`.
    """
    several = not isinstance(signals, Mapping)
    recordings: Sequence[Signals] = signals if several else [signals]  # type: ignore[assignment, list-item]
    outputs = [np.asarray(o, dtype=np.float64) for o in (output if several else [output])]  # type: ignore[union-attr]
    names = tuple(recordings[0])
    tables = [_columns(recording, names) for recording in recordings]
    # The same scaling for all recordings: with a scaling each, the same input would mean something
    # else in every file.
    input_scaling = scaling_of(np.concatenate(tables), names)
    output_scaling = scaling_of(np.concatenate(outputs), (output_name,))
    scaled = (
        [input_scaling.forward(t) for t in tables],
        [output_scaling.forward(o) for o in outputs],
    )
    training = train(network, *scaled, options)
    trained = TrainedNetwork(
        network,
        training.weights,
        names,
        output_name,
        input_scaling,
        output_scaling,
        period_s,
        training.summary,
    )
    return trained, training


def trace_csv(training: Training) -> bytes:
    """Bytes of trace.csv: a header, a row per accepted step, numbers in full precision."""
    names = list(training.trace)
    formats = ["%d" if name in ("iteration", "trials") else "%r" for name in names]
    return table_bytes(names, np.column_stack(list(training.trace.values())), formats)


def save_network(folder: Path | str, trained: TrainedNetwork) -> None:
    """Write `network.npz` and `network.json` that vouches for it, both or none."""
    content, about = network_files(trained)
    folder = Path(folder)
    write_together(
        {folder / WEIGHTS_FILE: content, folder / NETWORK_FILE: json_bytes(about, NETWORK_FILE)}
    )


def network_files(trained: TrainedNetwork, **about: Any) -> tuple[bytes, dict[str, Any]]:
    """Content of `network.npz` and of `network.json`; about: fields on the corrected quantity."""
    buffer = io.BytesIO()
    np.savez(buffer, weights=np.ascontiguousarray(trained.weights, dtype=np.float64))
    content = buffer.getvalue()
    scalings = zip(trained.input_scaling.low, trained.input_scaling.high, strict=True)
    described = NetworkFile(
        kind=trained.network.kind,
        sizes=asdict(trained.network),  # type: ignore[call-overload]
        n_weights=trained.network.n_weights,
        inputs=tuple(
            ScaledSignal(name=name, low=low, high=high)
            for name, (low, high) in zip(trained.input_names, scalings, strict=True)
        ),
        output=ScaledSignal(
            name=trained.output_name,
            low=trained.output_scaling.low[0],
            high=trained.output_scaling.high[0],
        ),
        period_s=trained.period_s,
        training=TrainingSummary(**trained.summary),
        weights=WeightsFile(file=WEIGHTS_FILE, sha256=hashlib.sha256(content).hexdigest()),
        **about,
    )
    return content, described.as_json()


def load_network(folder: Path | str) -> TrainedNetwork:
    """Read a network back; FileError where a file is missing, altered or invalid."""
    path = Path(folder) / NETWORK_FILE
    about = read_json(path)
    if not isinstance(about, dict) or about.get("schema") != NETWORK_SCHEMA:
        raise FileError(
            f"{path} is not a {NETWORK_SCHEMA}.",
            "Another version wrote it; train the network again.",
        )
    try:
        inputs, output = about["inputs"], about["output"]
        kind, kinds = str(about["kind"]), network_kinds()
        if kind not in kinds:
            raise FileError(
                f"{path}: unknown kind of network {kind!r}.", nearest(kind, kinds) or _REMEDY
            )
        network = kinds[kind](**about["sizes"])
        return TrainedNetwork(
            network=network,
            weights=_weights(
                path.parent / WEIGHTS_FILE, str(about["weights"]["sha256"]), network.n_weights
            ),
            input_names=tuple(str(input_["name"]) for input_ in inputs),
            output_name=str(output["name"]),
            input_scaling=Scaling(
                *(tuple(float(input_[end]) for input_ in inputs) for end in ("low", "high"))
            ),
            output_scaling=Scaling((float(output["low"]),), (float(output["high"]),)),
            period_s=float(about["period_s"]),
            summary=dict(about["training"]),
        )
    except FileError:
        raise
    except KeyError as missing:
        raise FileError(f"{path} lacks {missing}.", _REMEDY) from None
    except (PamidError, TypeError, ValueError) as error:
        raise FileError(f"{path} does not describe a network: {error}", _REMEDY) from None


@lru_cache
def network_kinds() -> dict[str, type[Network]]:
    """Every kind of network by its name: the classes in the files of this package, no others."""
    modules = modules_of("pamid.networks").values()
    return {kind.kind: kind for module in modules for kind in classes_of(module, Network)}


def _weights(path: Path, sha256: str, n_weights: int) -> Array:
    try:
        content = read_data(path, WEIGHTS)
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror}.", _REMEDY) from None
    # Weights and description are two files. A pair that does not belong together predicts without
    # complaint.
    if hashlib.sha256(content).hexdigest() != sha256:
        raise FileError(
            f"{path} was changed since {NETWORK_FILE} was written (its SHA-256 differs).", _REMEDY
        )
    arrays = load_arrays(path, content)
    weights = arrays.get("weights")
    if weights is None or weights.shape != (n_weights,) or weights.dtype != np.float64:
        actual = "none" if weights is None else f"{weights.dtype} {weights.shape}"
        raise FileError(
            f"{path} should hold {n_weights} float64 weights, found: {actual}.", _REMEDY
        )
    if not np.isfinite(weights).all():
        raise FileError(f"{path} holds weights that are not finite.", _REMEDY)
    return weights


def _columns(signals: Signals, names: Sequence[str]) -> Array:
    """(N, len(names)) in the order of `names`."""
    for name in names:
        if name not in signals:
            raise DataError(
                f"Signal {name!r} is missing.",
                nearest(name, signals) or f"Given: {', '.join(signals)}.",
            )
    return np.column_stack([np.asarray(signals[name], dtype=np.float64) for name in names])
