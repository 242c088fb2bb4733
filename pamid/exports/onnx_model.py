"""An identified model as ONNX in float64.

There is a single sample, and a whole run as a Scan over it.

    <stem>-cell.onnx   inputs (nu,), state (n,) -> outputs (ny,), next_state (n,)
    <stem>.onnx        inputs (T, nu), state (n,) -> outputs (T, ny), last_state (n,)

Inputs and outputs are in the units of their columns, in the order of the metadata. The metadata
also hold the initial state ("start"). A run may be cut anywhere: the last state of each part is the
first of the next.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.exports.onnx_graph import Graph, graph_of, model_bytes
from pamid.exports.onnx_step import Sampled
from pamid.exports.step import step_of
from pamid.networks.correction.identified_model import Identified

#: a graph, its inputs (nu,) and state (n,) -> outputs (ny,) and next state (n,)
Nodes = Callable[[Graph, str, str], tuple[str, str]]

ONNX_SCHEMA = "pamid.onnx/1"


def onnx_bytes(model: Identified) -> tuple[bytes, bytes]:
    """Run and cell of a model.

    UsageError if its network needs the control loop; FileError if onnx is not installed.
    """
    try:
        import onnx  # noqa: F401
    except ImportError:
        raise FileError(
            "ONNX files are written with the package onnx, which is not installed.",
            "pip install 'pamid[onnx]'",
            code="missing-extra",
        ) from None
    network = None if model.network is None else model.network.trained
    in_matrices = network is not None and network.network.in_matrices
    sample = Sampled(step_of(model), network if in_matrices else None)
    s = sample.step
    about = {
        "rig": model.name,
        "effects": [a.label for a in model.effects],
        "dt_s": s.period_s,
        "network": "" if network is None else network.network.kind,
        "inputs": [{"name": v.name, "unit": v.unit} for v in s.inputs],
        "outputs": [{"name": v.name, "unit": v.unit} for v in s.outputs],
        "state": sample.sizes,
        "states": list(s.states),
        "fit_sha256": model.sha256,
    }
    return run_and_cell(model.name, sample.nodes, sample.start, about)


def run_and_cell(
    name: str, nodes: Nodes, start: Array, about: Mapping[str, Any]
) -> tuple[bytes, bytes]:
    nu, n, ny = len(about["inputs"]), len(start), len(about["outputs"])
    metadata = {"schema": ONNX_SCHEMA, **about, "start": start.tolist()}
    words = {
        key: value if isinstance(value, str) else json.dumps(value)
        for key, value in metadata.items()
    }

    single = Graph()
    for output, value in zip(
        ("outputs", "next_state"), nodes(single, "inputs", "state"), strict=True
    ):
        single.named(output, value)
    cell = graph_of(
        single,
        name,
        {"inputs": (nu,), "state": (n,)},
        {"outputs": (ny,), "next_state": (n,)},
        outermost=True,
    )

    outer = Graph()
    inside = outer.inside()
    outputs, following = nodes(inside, "sample", "before")
    once = graph_of(
        inside, "sample", {"before": (n,), "sample": (nu,)}, {following: (n,), outputs: (ny,)}
    )
    last, every = outer.several("Scan", 2, "state", "inputs", body=once, num_scan_inputs=1)
    outer.named("last_state", last)
    outer.named("outputs", every)
    run = graph_of(
        outer,
        name,
        {"inputs": ("samples", nu), "state": (n,)},
        {"outputs": ("samples", ny), "last_state": (n,)},
        outermost=True,
    )
    return model_bytes(run, words), model_bytes(cell, words)
