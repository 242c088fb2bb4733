"""Building blocks of a network's ONNX graph: nodes of operators, called by their ONNX names,
between named tensors. `pamid.exports.onnx_graph.Graph` is such a graph."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol

from numpy.typing import ArrayLike


class OnnxNodes(Protocol):
    """A float64 graph under construction; a value is the name of a tensor, a number is (1,)."""

    def add(self, op: str, *inputs: str, **attributes: Any) -> str:
        """A node with a single output."""

    def array(self, values: ArrayLike) -> str:
        """A constant tensor."""

    def number(self, value: float) -> str:
        """A constant number."""

    def index(self, *values: int) -> str:
        """Constant whole numbers, as indices and shapes."""

    def joined(self, parts: Iterable[str]) -> str:
        """Numbers and vectors as a single vector."""

    def parts(self, vector: str, sizes: Iterable[int]) -> list[str]:
        """A vector cut into vectors of these sizes, in order; none of them empty."""

    def choose(self, condition: str, yes: str, no: str) -> str:
        """Either of two tensors."""


def affine(g: OnnxNodes, matrix: ArrayLike, vector: str, added: str) -> str:
    """matrix (rows, columns) @ vector (columns,) + added (rows,)."""
    return g.add("Add", g.add("MatMul", g.array(matrix), vector), added)
