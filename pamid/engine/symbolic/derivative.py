"""Exact partial derivatives of expressions: sparse forward mode over the graph.

By the chain rule dy = sum_i (dy/da_i) da_i for every node y with arguments a_i, once per node, in
an order in which arguments come first; only what is not zero is kept. Griewank and Walther (2008),
Evaluating Derivatives, 2nd ed., ch. 3.
"""

from __future__ import annotations

from pamid.engine.symbolic.expression import ONE, ZERO, Expr, apply, change_of, mul, walk, where
from pamid.engine.symbolic.operators import OPERATORS

Gradient = dict[Expr, Expr]


DERIVED_SPACES = ("state", "cell", "past", "parameter")


def gradients(roots: list[Expr], parameters: frozenset[str] | None = None) -> list[Gradient]:
    """For each root the derivative by every state, cell and parameter below it (zeros left out).

    parameters: only by these (default: by all).
    """
    table: dict[Expr, Gradient] = {}
    for node in walk(roots, change_of):
        if node.op == "symbol":
            space, name = node.value
            moves = space in DERIVED_SPACES and (
                space != "parameter" or parameters is None or name in parameters
            )
            table[node] = {node: ONE} if moves else {}
        elif node.op == "const":
            table[node] = {}
        elif node.op == "tangent":
            table[node] = table[node.args[1]]
        elif node.op == "where":
            # The branch that is taken. Where the condition itself turns there may be a jump, which
            # has no derivative: nothing is added for it.
            condition, left, right = node.args[0], table[node.args[1]], table[node.args[2]]
            keys = list(left) + [k for k in right if k not in left]
            table[node] = {k: where(condition, left.get(k, ZERO), right.get(k, ZERO)) for k in keys}
        else:
            total: Gradient = {}
            if any(table[a] for a in node.args):
                slopes = OPERATORS[node.op].derivative(apply, node, *node.args)
                for argument, slope in zip(node.args, slopes, strict=True):
                    for key, inner in table[argument].items():
                        term = mul(slope, inner)
                        total[key] = total[key] + term if key in total else term
            table[node] = total
    return [{k: v for k, v in table[r].items() if v is not ZERO} for r in roots]
