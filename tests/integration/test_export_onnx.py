"""ONNX files against what they stand for: onnxruntime over long runs, the reference evaluator
sample by sample."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported import run_cell, run_whole
from identified_runs import (
    PERIOD_S,
    RANGES,
    SEEN,
    fitted_run,
    joint_recording,
    put_network,
    random_network,
)

from pamid.base.errors import FileError, UsageError
from pamid.base.files import sha256_of
from pamid.base.units import as_column, split_column, to_si
from pamid.networks.anfis import Anfis
from pamid.networks.correction.identified_model import (
    Identified,
    load_identified,
    simulate_identified,
)
from pamid.networks.elman import Elman
from pamid.networks.narx import Narx
from pamid.networks.network import Network
from pamid.networks.trained_network import TrainedNetwork
from pamid.recording.recording import Recording
from pamid.simulation.excitation.aprbs import aprbs

onnx = pytest.importorskip("onnx", reason="pip install 'pamid[onnx]'")
pytest.importorskip("onnxruntime", reason="pip install 'pamid[verify]'")

from pamid.exports.exporting import export_model  # noqa: E402
from pamid.exports.onnx_graph import Graph  # noqa: E402
from pamid.exports.onnx_model import onnx_bytes, run_and_cell  # noqa: E402

LONG = 6000  # samples: 18 s at 3 ms
CLOSE = 1e-9  # of each channel's span
LOOP = tuple(name for name in RANGES if name not in SEEN[1:] and name != "command")


def outputs_of(model: Identified, u: np.ndarray) -> np.ndarray:
    """What the export has to give: inputs and outputs in the units of their columns."""
    si = np.stack([to_si(u[:, i], split_column(n)[1]) for i, n in enumerate(model.inputs)], axis=1)
    Y = simulate_identified(model, si)
    return np.stack(
        [Y[:, i] / to_si(1.0, split_column(n)[1]) for i, n in enumerate(model.outputs)], axis=1
    )


def assert_close(found: np.ndarray, wanted: np.ndarray, share: float = CLOSE) -> None:
    span = np.ptp(wanted, axis=0)
    assert (span > 0.0).all() and np.isfinite(wanted).all()
    worst = (np.abs(found - wanted) / span).max()
    assert worst < share, f"off by {worst:.2e} of the span"


# ---- networks by themselves --------------------

NETWORKS: list[Network] = [
    Elman(5, 10),
    Elman(5, 1),
    Narx(5, 10),
    Narx(5, 4, 0, 1, 1),
    Narx(5, 4, 1, 2, 1),
    Anfis(5, 2),
]


@pytest.fixture(scope="module")
def signals() -> np.ndarray:
    """18 s of what a network in the control loop is given, beyond its scaling's range at times."""
    drawn = [aprbs(20.0, PERIOD_S, 1.1, seed=k)[:LONG] for k in range(len(LOOP))]
    low, high = np.array([RANGES[n] for n in LOOP]).T
    return np.ascontiguousarray(0.5 * (low + high) + 0.5 * (high - low) * np.stack(drawn, axis=1))


def network_onnx_bytes(trained: TrainedNetwork) -> tuple[bytes, bytes]:
    """Run and cell of a network."""
    network = trained.network
    memory = network.memory_size
    low, high = (np.array(ends) for ends in (trained.input_scaling.low, trained.input_scaling.high))
    (bottom,), (top,) = trained.output_scaling.low, trained.output_scaling.high

    def nodes(g: Graph, inputs: str, state: str) -> tuple[str, str]:
        before, samples = g.parts(state, [memory, 1]) if memory else ("", state)
        scaled = g.add(
            "Div",
            g.add("Mul", g.number(2.0), g.add("Sub", inputs, g.array(low))),
            g.array(high - low),
        )
        given = g.add("Sub", scaled, g.number(1.0))
        first = g.add("Equal", samples, g.number(0.0))
        value, after = network.onnx_nodes(g, trained.weights, given, before, first)
        share = g.add("Mul", g.number(0.5), g.add("Add", value, g.number(1.0)))
        output = g.add("Add", g.number(bottom), g.add("Mul", share, g.number(top - bottom)))
        counted = g.add("Add", samples, g.number(1.0))
        return output, g.joined([after, counted] if memory else [counted])

    about = {"inputs": trained.input_names, "outputs": [trained.output_name]}
    return run_and_cell(network.kind, nodes, np.zeros(memory + 1), about)


@pytest.mark.parametrize("network", NETWORKS, ids=repr)
def test_a_network(network, signals):
    trained = random_network(network, LOOP, "angle_deg", 2.0)
    wanted = trained.predict(dict(zip(LOOP, signals.T, strict=True)))[:, None]
    run, cell = network_onnx_bytes(trained)
    first, between = run_whole(run, signals[:41])
    rest, _ = run_whole(run, signals[41:], between)  # a run may be cut anywhere
    assert_close(np.concatenate([first, rest]), wanted, 1e-12)
    np.testing.assert_allclose(run_cell(cell, signals[:60]), wanted[:60], rtol=0.0, atol=1e-12)


# ---- what a run found --------------------


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> tuple[Path, Recording]:
    folder = tmp_path_factory.mktemp("joint")
    recording = joint_recording(folder)
    fitted_run(folder / "run", recording.path, ("coulomb-friction",))
    return folder / "run", recording


def commands(recording: Recording, samples: int = 400) -> np.ndarray:
    return np.stack([recording.signal("command"), np.zeros(len(recording))], axis=1)[:samples]


NETWORKS_OF_RUNS: list[tuple[Network, str, dict[str, Any]]] = [
    (Elman(3, 4), "angle_deg", {}),
    (Narx(3, 3, 2, 2, 5), "force_1_n", {}),
    (Anfis(3, 3), "pressure_2_kpa", {}),
    (
        Elman(3, 4),
        "missing_nm",
        {"enters": {"port": "joint"}, "parameters": {"viscous_n_m_s": 0.05}},
    ),
    (Narx(3, 3, 2, 2, 5), "missing_n", {"enters": {"port": "muscle_2"}, "parameters": {}}),
]


@pytest.mark.parametrize(("network", "output", "about"), NETWORKS_OF_RUNS, ids=repr)
def test_a_model_with_a_network(found, network, output, about):
    folder, recording = found
    put_network(folder, random_network(network, SEEN, output, 2.0), **about)
    model, u = load_identified(folder), commands(recording)
    run, cell = onnx_bytes(model)
    wanted = outputs_of(model, u)
    assert np.abs(wanted - outputs_of(load_identified(folder, which="refitted"), u)).max() > 0.1
    assert_close(run_whole(run, u)[0], wanted)
    np.testing.assert_allclose(run_cell(cell, u[:8]), wanted[:8], rtol=1e-12, atol=1e-12)


def test_what_the_numbers_mean(found, tmp_path):
    folder, _ = found
    model = load_identified(folder, which="refitted")
    files = export_model(model, "onnx", tmp_path / "joint.onnx").files
    assert [path.name for path in files] == ["joint.onnx", "joint-cell.onnx"]
    for path in files:
        content = onnx.load(path)
        told = {p.key: p.value for p in content.metadata_props}
        assert (told["rig"], told["network"], told["fit_sha256"]) == (
            "one-dof",
            "",
            sha256_of(folder / "fit.json"),
        )
        assert (
            json.loads(told["effects"]) == ["coulomb-friction"]
            and json.loads(told["dt_s"]) == PERIOD_S
        )
        assert json.loads(told["inputs"]) == [
            {"name": "command", "unit": ""},
            {"name": "external_torque_nm", "unit": "N m"},
        ]
        assert json.loads(told["outputs"])[:2] == [
            {"name": "angle_deg", "unit": "deg"},
            {"name": "pressure_1_kpa", "unit": "kPa"},
        ]
        assert len(json.loads(told["start"])) == sum(json.loads(told["state"]).values())
        kinds = {
            v.type.tensor_type.elem_type for v in (*content.graph.input, *content.graph.output)
        }
        assert kinds == {onnx.TensorProto.DOUBLE}
    rest = as_column("pressure_1_kpa", model.start[2] - 101325.0)
    u = np.zeros((2, 2))
    assert run_whole((tmp_path / "joint.onnx").read_bytes(), u)[0][0, 1] == pytest.approx(rest)


def test_what_cannot_be_written_is_refused(found, tmp_path, monkeypatch):
    folder, _ = found
    put_network(folder, random_network(Elman(5, 3), LOOP, "angle_deg", 2.0), model="loop")
    with pytest.raises(UsageError, match="its control loop"):
        export_model(load_identified(folder), "onnx", tmp_path / "a.onnx")
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(FileError, match=r"pip install 'pamid\[onnx\]'"):
        export_model(load_identified(folder, which="refitted"), "onnx", tmp_path / "a.onnx")
    assert not list(tmp_path.iterdir())
