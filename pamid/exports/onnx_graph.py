"""ONNX graphs node by node: names, constants, subgraphs, and equations as nodes.

Everything is float64. A number is a tensor of shape (1,), so that numbers split from a vector, or
joined to a vector, need no reshaping. Subgraphs see the names around them. Each constant is in the
outermost graph, once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pamid.engine.symbolic.expression import Expr, walk
from pamid.engine.symbolic.operators import OPERATORS, is_comparison

Symbol = tuple[str, str]
Shape = tuple[int | str, ...]

OPSET, IR = 18, 9


@dataclass
class Graph:
    """Nodes under construction; `inside` begins a subgraph."""

    nodes: list[Any] = field(default_factory=list)
    constants: dict[tuple[Any, ...], Any] = field(default_factory=dict)
    count: list[int] = field(default_factory=lambda: [0])

    def inside(self) -> Graph:
        return Graph([], self.constants, self.count)

    def fresh(self, stem: str) -> str:
        self.count[0] += 1
        return f"{stem}_{self.count[0]}"

    def add(self, op: str, *inputs: str, **attributes: Any) -> str:
        """Add a node with a single output and return its name."""
        (output,) = self.several(op, 1, *inputs, **attributes)
        return output

    def several(self, op: str, outputs: int, *inputs: str, **attributes: Any) -> list[str]:
        """Add a node with several outputs and return their names."""
        from onnx import helper

        names = [self.fresh(op.lower()) for _ in range(outputs)]
        self.nodes.append(helper.make_node(op, list(inputs), names, **attributes))
        return names

    def named(self, name: str, value: str) -> str:
        """Give a value this name."""
        from onnx import helper

        self.nodes.append(helper.make_node("Identity", [value], [name]))
        return name

    def array(self, values: ArrayLike, dtype: Any = np.float64) -> str:
        """Constant tensor."""
        from onnx import numpy_helper

        content = np.array(values, dtype, order="C")
        key = (content.tobytes(), content.shape, content.dtype.str)
        if key not in self.constants:
            self.constants[key] = numpy_helper.from_array(content, self.fresh("constant"))
        return str(self.constants[key].name)

    def number(self, value: float) -> str:
        return self.array([value])

    def index(self, *values: int) -> str:
        return self.array(values, np.int64)

    # ---- vectors --------------------------------------------------------------------------------

    def joined(self, parts: Iterable[str]) -> str:
        """Numbers and vectors as a single vector."""
        names = list(parts)
        return names[0] if len(names) == 1 else self.add("Concat", *names, axis=0)

    def parts(self, vector: str, sizes: Iterable[int]) -> list[str]:
        """Split a vector into vectors of these sizes, in order; none of them empty."""
        lengths = list(sizes)
        if len(lengths) == 1:
            return [vector]
        return (
            self.several("Split", len(lengths), vector, self.index(*lengths), axis=0)
            if lengths
            else []
        )

    def numbers(self, vector: str, count: int) -> list[str]:
        return self.parts(vector, [1] * count)

    def choose(self, condition: str, yes: str, no: str) -> str:
        return self.add("Where", condition, yes, no)


def graph_of(
    body: Graph,
    name: str,
    inputs: Mapping[str, Shape],
    outputs: Mapping[str, Shape],
    types: Mapping[str, int] | None = None,
    *,
    outermost: bool = False,
) -> Any:
    """Finished GraphProto with the shapes of its inputs and outputs.

    Parameters
    ----------
    body
        Nodes of the graph.
    name
        Name of the graph.
    inputs, outputs
        Shape by name.
    types
        Element types other than double, by name.
    outermost
        True for the outermost graph, which holds the used constants.
    """
    from onnx import TensorProto, helper

    kinds = types or {}

    def infos(shapes: Mapping[str, Shape]) -> list[Any]:
        return [
            helper.make_tensor_value_info(n, kinds.get(n, TensorProto.DOUBLE), s)
            for n, s in shapes.items()
        ]

    used = _used(body.nodes) if outermost else set()
    return helper.make_graph(
        body.nodes,
        name,
        infos(inputs),
        infos(outputs),
        initializer=[c for c in body.constants.values() if c.name in used],
    )


def _used(nodes: Iterable[Any]) -> set[str]:
    """All inputs of nodes and their subgraphs."""
    names: set[str] = set()
    for node in nodes:
        names.update(node.input)
        for attribute in node.attribute:
            names |= _used(attribute.g.node) | {o.name for o in attribute.g.output}
    return names


def model_bytes(graph: Any, about: Mapping[str, str]) -> bytes:
    """Checked model, with `about` as its metadata."""
    from importlib.metadata import version

    from onnx import checker, helper

    model = helper.make_model(
        graph,
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR,
        producer_name="pamid",
        producer_version=version("pamid"),
    )
    helper.set_model_props(model, dict(about))
    checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString(deterministic=True))


class Values:
    """Equations as nodes of a graph; every shared part occurs once.

    symbols: the tensor of every symbol; around: enclosing values, whose parts are reused if they
    contain no changed symbol.
    """

    def __init__(
        self, graph: Graph, symbols: Mapping[Symbol, str], around: Values | None = None
    ) -> None:
        self.graph, self.symbols, self.around = graph, dict(symbols), around
        self._tensors: dict[Expr, str] = {}
        self._truths: dict[Expr, str] = {}
        self._changed: dict[Expr, bool] = {}

    def know(self, symbol: Symbol, tensor: str) -> None:
        """Define a symbol, before its first use."""
        self.symbols[symbol] = tensor

    def __call__(self, root: Expr) -> str:
        """Tensor of an expression."""
        for node in walk([root]):
            if node not in self._tensors and not is_comparison(node.op) and self._in_graph(node):
                self._tensors[node] = self._made(node)
        return self._at(root)

    def _in_graph(self, node: Expr) -> bool:
        """True if it belongs to this graph, not to the enclosing values."""
        if self.around is None:
            return True
        if node not in self._changed:
            self._changed[node] = (
                node.value in self.symbols
                if node.op == "symbol"
                else any(self._in_graph(a) for a in node.args)
            )
        return self._changed[node]

    def _at(self, node: Expr) -> str:
        if self.around is not None and not self._in_graph(node):
            return self.around(node)
        if node not in self._tensors:  # a comparison used as a number
            self._tensors[node] = self.graph.add("Cast", self._truth(node), to=11)  # double
        return self._tensors[node]

    def _made(self, node: Expr) -> str:
        if node.op == "const":
            return self.graph.number(node.value)
        if node.op == "symbol":
            return self.symbols[node.value]
        if node.op == "where":
            return self.graph.choose(
                self._truth(node.args[0]), self._at(node.args[1]), self._at(node.args[2])
            )
        return self.graph.add(OPERATORS[node.op].onnx, *(self._at(a) for a in node.args))

    def _truth(self, node: Expr) -> str:
        """Boolean of a comparison, or of any number (true unless 0)."""
        if self.around is not None and not self._in_graph(node):
            return self.around._truth(node)
        if node not in self._truths:
            if is_comparison(node.op):
                self._truths[node] = self.graph.add(
                    OPERATORS[node.op].onnx, *(self(a) for a in node.args)
                )
            else:
                equal = self.graph.add("Equal", self(node), self.graph.number(0.0))
                self._truths[node] = self.graph.add("Not", equal)
        return self._truths[node]
