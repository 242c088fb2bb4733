"""Equations as plain Python functions, for comparisons with solvers that want a callable."""

import math
from collections.abc import Callable
from typing import Any

from pamid.symbolic.expression import Expr, walk

_CALLS = {
    "sqrt": "sqrt",
    "exp": "exp",
    "log": "log",
    "tanh": "tanh",
    "sin": "sin",
    "cos": "cos",
    "abs": "abs",
    "floor": "floor",
    "min": "min",
    "max": "max",
}
_INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/", "pow": "**", "lt": "<", "le": "<="}


def transcribed(
    roots: list[Expr], arrays: dict[str, tuple[str, list[str]]]
) -> Callable[..., list[float]]:
    """Expressions as a Python function f(x, u, p) -> list; every node one line, computed once."""
    names: dict[int, str] = {}
    lines = []
    for node in walk(roots):
        a = [names[id(x)] for x in node.args]
        if node.op == "const":
            names[id(node)] = repr(float(node.value))
            continue
        if node.op == "symbol":
            array, order = arrays[node.value[0]]
            names[id(node)] = f"{array}[{order.index(node.value[1])}]"
            continue
        if node.op in _INFIX:
            value = f"{a[0]} {_INFIX[node.op]} {a[1]}"
        elif node.op == "neg":
            value = f"-{a[0]}"
        elif node.op == "where":
            value = f"{a[1]} if {a[0]} else {a[2]}"
        else:
            value = f"{_CALLS[node.op]}({', '.join(a)})"
        names[id(node)] = f"v{len(lines)}"
        lines.append(f"    v{len(lines)} = {value}")
    body = "\n".join(
        ["def f(x, u, p):", *lines, f"    return [{', '.join(names[id(r)] for r in roots)}]"]
    )
    space: dict[str, Any] = {
        **{k: getattr(math, k) for k in ("sqrt", "exp", "log", "tanh", "sin", "cos", "floor")}
    }
    exec(body, space)
    return space["f"]  # type: ignore[no-any-return]
