"""One sample of each kind of network as ONNX nodes, in matrices; the equations are those of
`pamid.networks`."""

from __future__ import annotations

from functools import reduce

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import DataError
from pamid.export.onnx_graph import Graph
from pamid.networks.anfis import Anfis
from pamid.networks.elman import Elman
from pamid.networks.narx import Narx
from pamid.networks.network import Network

Array = NDArray[np.float64]


def memory_size(network: Network) -> int:
    """Numbers that it carries from one sample to the next, all zero before the first."""
    if isinstance(network, Elman):
        return network.hidden
    if isinstance(network, Narx):
        return network.stride * (network.input_lags * network.inputs + network.output_lags)
    return 0


def network_nodes(
    g: Graph, network: Network, weights: Array, given: str, memory: str, first: str
) -> tuple[str, str]:
    """Scaled output (1,) and next memory (memory_size,), for scaled inputs given (m,); `first` is
    true at the first sample. Without memory that name is passed on."""
    if isinstance(network, Elman):
        return _elman(g, network, weights, given, memory)
    if isinstance(network, Narx):
        return _narx(g, network, weights, given, memory, first)
    if isinstance(network, Anfis):
        return _anfis(g, network, weights, given), memory
    raise DataError(f"A network of kind {network.kind!r} cannot be written as ONNX.")


def _affine(g: Graph, matrix: Array, vector: str, added: str) -> str:
    return g.add("Add", g.add("MatMul", g.array(matrix), vector), added)


def _elman(g: Graph, network: Elman, weights: Array, given: str, memory: str) -> tuple[str, str]:
    layers = network.layers(weights)
    seen = g.joined([memory, given])
    state = g.add("Tanh", _affine(g, layers.units[:, :-1], seen, g.array(layers.bias)))
    return _affine(g, layers.output[None], state, g.number(layers.output_bias)), state


def _narx(
    g: Graph, network: Narx, weights: Array, given: str, memory: str, first: str
) -> tuple[str, str]:
    """Memory: past inputs, sample by sample, then past outputs, the newest first."""
    layers, m = network.layers(weights), network.inputs
    reach_in, reach_out = network.input_lags * network.stride, network.output_lags * network.stride
    taps, past_inputs = given, []
    if reach_in:
        inputs, outputs = g.parts(memory, [reach_in * m, reach_out])
        inputs = g.choose(first, g.add("Tile", given, g.index(reach_in)), inputs)
        rows = [
            np.arange(m) + (lag * network.stride - 1) * m
            for lag in range(1, network.input_lags + 1)
        ]
        taps = g.joined(
            [given, g.add("Gather", inputs, g.index(*np.concatenate(rows).tolist()), axis=0)]
        )
        past_inputs = (
            [given, *g.parts(inputs, [(reach_in - 1) * m, m])[:1]] if reach_in > 1 else [given]
        )
    else:
        outputs = memory
    back = g.add(
        "Gather",
        outputs,
        g.index(*(lag * network.stride - 1 for lag in range(1, network.output_lags + 1))),
        axis=0,
    )
    driven = _affine(g, layers.feedback, back, _affine(g, layers.taps, taps, g.array(layers.bias)))
    output = _affine(g, layers.output[None], g.add("Tanh", driven), g.number(layers.output_bias))
    older = g.parts(outputs, [reach_out - 1, 1])[:1] if reach_out > 1 else []
    return output, g.joined([*past_inputs, output, *older])


def _anfis(g: Graph, network: Anfis, weights: Array, given: str) -> str:
    sets = network.membership(weights)
    inside = g.add("Max", g.add("Min", given, g.number(1.0)), g.number(-1.0))
    away = g.add("Sub", g.add("Reshape", inside, g.index(-1, 1)), g.array(sets.centre))
    scaled = g.add("Mul", away, g.array(1.0 / sets.width))
    squares = g.add("Mul", scaled, scaled)
    if network.shape == "gaussian":
        members = g.add("Exp", g.add("Mul", squares, g.number(-0.5)))
    else:
        grown = g.add("Pow", squares, g.array(sets.slope))
        members = g.add("Div", g.number(1.0), g.add("Add", grown, g.number(1.0)))
    shares = g.add("Div", members, g.add("ReduceSum", members, g.index(1), keepdims=1))
    each = g.parts(g.add("Reshape", shares, g.index(-1)), [network.sets] * network.inputs)

    def crossed(a: str, b: str) -> str:
        return g.add("Reshape", g.add("Mul", g.add("Reshape", a, g.index(-1, 1)), b), g.index(-1))

    firing = reduce(crossed, each)
    slopes, constants = network.planes(network.consequents(weights))
    rules = _affine(g, slopes, inside, g.array(constants))
    return g.add("ReduceSum", g.add("Mul", firing, rules), g.index(0), keepdims=1)
