"""Exact partial derivatives of expressions, sparse forward mode over the graph."""

from __future__ import annotations

from pamid.symbolic.expression import ONE, div, mul, power, sub, unary, walk
from pamid.symbolic.vocabulary import ZERO, Expr, cos, sign, sin, where

Gradient = dict[Expr, Expr]


def _local(node: Expr) -> tuple[Expr, ...]:
    """Partial derivative of the node with respect to each of its arguments."""
    a = node.args[0]
    match node.op:
        case "neg":
            return (-ONE,)
        case "sqrt":
            return (div(0.5, node),)
        case "exp":
            return (node,)
        case "log":
            return (div(1.0, a),)
        case "tanh":
            return (sub(1.0, node * node),)
        case "sin":
            return (cos(a),)
        case "cos":
            return (-sin(a),)
        case "abs":
            return (sign(a),)
        case "floor":
            return (ZERO,)
    b = node.args[1]
    match node.op:
        case "add":
            return (ONE, ONE)
        case "sub":
            return (ONE, -ONE)
        case "mul":
            return (b, a)
        case "div":
            return (div(1.0, b), -div(node, b))
        case "pow":
            slope = mul(b, power(a, b - 1.0))
            return (slope, ZERO if b.op == "const" else mul(node, unary("log", a)))
        case "min":
            return (where(a < b, 1.0, 0.0), where(a < b, 0.0, 1.0))
        case "max":
            return (where(a > b, 1.0, 0.0), where(a > b, 0.0, 1.0))
        case "lt" | "le":
            return (ZERO, ZERO)
    raise AssertionError(f"no derivative for {node.op}")


def _select(condition: Expr, left: Gradient, right: Gradient) -> Gradient:
    keys = list(left) + [k for k in right if k not in left]
    return {k: where(condition, left.get(k, ZERO), right.get(k, ZERO)) for k in keys}


SPACES = ("state", "cell", "past", "parameter")


def gradients(roots: list[Expr], parameters: frozenset[str] | None = None) -> list[Gradient]:
    """For each root the derivative by every state, cell and parameter below it (zeros left out).

    parameters: only by these (default: by all).
    """
    table: dict[Expr, Gradient] = {}
    for node in walk(roots):
        if node.op == "symbol":
            space, name = node.value
            moves = space in SPACES and (
                space != "parameter" or parameters is None or name in parameters
            )
            table[node] = {node: ONE} if moves else {}
        elif node.op == "const":
            table[node] = {}
        elif node.op == "where":
            table[node] = _select(node.args[0], table[node.args[1]], table[node.args[2]])
        else:
            total: Gradient = {}
            if any(table[a] for a in node.args):
                for argument, slope in zip(node.args, _local(node), strict=True):
                    for key, inner in table[argument].items():
                        term = mul(slope, inner)
                        total[key] = total[key] + term if key in total else term
            table[node] = total
    return [{k: v for k, v in table[r].items() if v is not ZERO} for r in roots]
