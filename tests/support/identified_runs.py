"""Run folders with a model in them, as `pamid fit` and `pamid train-residual` leave them, made in a
second."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from virtual_joint import record

from pamid.base.json_file import read_json, write_json
from pamid.base.run_folder import Run
from pamid.estimation.fit_files import fit_json
from pamid.estimation.grey_box import GreyBox, fit_model
from pamid.model.registry import rig_named
from pamid.networks.network import Network
from pamid.networks.scaling import Scaling
from pamid.networks.trained_network import TrainedNetwork, save_network
from pamid.recording.recording import Recording, read_recording
from pamid.simulation.data_split import split_recordings
from pamid.simulation.virtual_rig import attach_specs

PERIOD_S = 0.003
SEEN = ("command", "angle_refitted_deg", "pressure_1_refitted_kpa")
RANGES = {
    "command": (-1.0, 1.0),
    "angle_refitted_deg": (-40.0, 40.0),
    "pressure_1_refitted_kpa": (100.0, 600.0),
    "reference_deg": (-40.0, 40.0),
    "command_loop": (-1.0, 1.0),
    "angle_loop_deg": (-40.0, 40.0),
    "velocity_loop_deg_per_s": (-200.0, 200.0),
    "acceleration_loop_deg_per_s2": (-4e3, 4e3),
}


def fitted_run(
    folder: Path, recording: Path, effects: tuple[str, ...] = (), rig: str = "one-dof"
) -> GreyBox:
    """A run in `folder` of a fit to this recording; the model it found."""
    run = Run.create(
        folder,
        command="fit",
        seed=0,
        inputs=[recording, recording.with_suffix(".toml")],
        options={"rig": rig, "effects": list(effects)},
    )
    made = rig_named(rig)
    model = fit_model(
        split_recordings(made, [read_recording(recording)], []),
        tuple(a for a, _ in attach_specs(made, effects)),
    )
    write_json(run.path("fit.json"), fit_json(model, 0))
    run.finish()
    return model


def joint_recording(folder: Path) -> Recording:
    """12 s of a joint with dry friction in its control loop."""
    return record(folder / "rec.csv", effects=("coulomb-friction:torque_n_m=0.4",))


def random_network(
    network: Network, inputs: tuple[str, ...], output: str, size: float, seed: int = 3
) -> TrainedNetwork:
    """A network with random weights whose output is of about this size, in the output's unit."""
    weights = 0.25 * np.random.default_rng(seed).standard_normal(network.n_weights)
    low, high = zip(*(RANGES[name] for name in inputs), strict=True)
    return TrainedNetwork(
        network, weights, inputs, output, Scaling(low, high), Scaling((-size,), (size,)), PERIOD_S
    )


def put_network(folder: Path, trained: TrainedNetwork, **about: Any) -> None:
    """The network in a run; about: what train-residual adds to network.json."""
    save_network(folder, trained)
    told = {"enters": "output", "model": "replay", "mae": {}, "notes": [], **about}
    (folder / "network.json").write_text(
        json.dumps(read_json(folder / "network.json") | told), encoding="utf-8"
    )
