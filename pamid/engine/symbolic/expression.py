"""Expressions: the graph beneath every equation, hash-consed so that building an expression twice
gives the same object.

`pamid.engine.symbolic.vocabulary` is the vocabulary that rigs and effects are written in; this is
what it builds.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable
from typing import Any, Union

from pamid.base.errors import PamidError
from pamid.engine.symbolic.operators import ATOM, OPERATORS, POWER, PRODUCT, SUM

Number = Union["Expr", float, int]


class EquationError(PamidError):
    """An equation cannot be traced: a Python `if` on a signal, a wrong type, a value that is not
    finite."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message, hint, code="equation", exit_code=3)


class Expr:
    """A node: `op` with `args`; leaves are constants (`value`) and symbols (`value` = (space,
    name)). reach: the symbols at or below it, a bit each."""

    __slots__ = ("args", "op", "reach", "value")
    _table: dict[tuple[Any, ...], Expr] = {}
    __array_priority__ = 1000.0

    op: str
    args: tuple[Expr, ...]
    value: Any
    reach: int

    def __new__(cls, op: str, args: tuple[Expr, ...] = (), value: Any = None) -> Expr:
        key = (op, tuple(map(id, args)), value)
        node = cls._table.get(key)
        if node is None:
            node = object.__new__(cls)
            node.op, node.args, node.value = op, args, value
            if op == "symbol":
                with _naming:  # two threads may meet a new symbol at once
                    if value not in _bits:
                        _bits[value] = 1 << len(_symbols)
                        _symbols.append(value)
                    node.reach = _bits[value]
            else:
                node.reach = _united(args)
            node = cls._table.setdefault(key, node)  # another thread may have been first
        return node

    def __bool__(self) -> bool:
        raise EquationError(
            "a Python `if`, `and`, `or`, `min`, `max` or `abs` was used on a signal",
            "write where(condition, a, b), minimum(a, b), maximum(a, b) from pamid.equations "
            "instead",
        )

    def __float__(self) -> float:
        if self.op == "const":
            return float(self.value)
        raise EquationError(
            f"the value of {text(self)} is not known before the simulation",
            "functions of math and numpy work on numbers, those of pamid.equations on signals",
        )

    def __repr__(self) -> str:
        return text(self)

    def __add__(self, other: Number) -> Expr:
        return add(self, other)

    def __radd__(self, other: Number) -> Expr:
        return add(other, self)

    def __sub__(self, other: Number) -> Expr:
        return sub(self, other)

    def __rsub__(self, other: Number) -> Expr:
        return sub(other, self)

    def __mul__(self, other: Number) -> Expr:
        return mul(self, other)

    def __rmul__(self, other: Number) -> Expr:
        return mul(other, self)

    def __truediv__(self, other: Number) -> Expr:
        return div(self, other)

    def __rtruediv__(self, other: Number) -> Expr:
        return div(other, self)

    def __pow__(self, other: Number) -> Expr:
        return power(self, other)

    def __neg__(self) -> Expr:
        return neg(self)

    def __pos__(self) -> Expr:
        return self

    def __abs__(self) -> Expr:
        return apply("abs", self)

    def __lt__(self, other: Number) -> Expr:
        return apply("lt", self, other)

    def __le__(self, other: Number) -> Expr:
        return apply("le", self, other)

    def __gt__(self, other: Number) -> Expr:
        return apply("lt", other, self)

    def __ge__(self, other: Number) -> Expr:
        return apply("le", other, self)


#: (space, name) of every symbol, in the order of their bits
_symbols: list[tuple[str, str]] = []
_bits: dict[tuple[str, str], int] = {}
_naming = threading.Lock()


def _united(nodes: Iterable[Expr]) -> int:
    """The symbols below any of these nodes; the same object where any node has all of them, which
    saves most of the memory."""
    reach = 0
    for node in nodes:
        other = node.reach
        if other is not reach and other | reach != reach:
            reach = other if other | reach == other else other | reach
    return reach


def const(value: float) -> Expr:
    """A constant node; refuses anything that is not a finite number."""
    number = float(value)
    if not math.isfinite(number):
        raise EquationError(
            f"an equation contains the constant {number}", "guard the division or the logarithm"
        )
    return Expr("const", (), 0.0 if number == 0.0 else number)


def symbol(space: str, name: str) -> Expr:
    """A leaf: `space` is any of state, cell, past, input, parameter, tick; `name` is unique inside
    it."""
    return Expr("symbol", (), (space, name))


def expression(value: Number) -> Expr:
    """`value` as a node (numbers become constants)."""
    if isinstance(value, Expr):
        return value
    try:
        return const(float(value))
    except (TypeError, ValueError):
        raise EquationError(
            f"an equation returned {value!r}, which is neither a number nor an expression",
            "rates, measure and act return expressions or numbers",
        ) from None


ZERO, ONE = const(0.0), const(1.0)


def _is(node: Expr, number: float) -> bool:
    return node.op == "const" and node.value == number


def apply(op: str, *arguments: Number) -> Expr:
    """An operator of the table, or `where`, on its arguments; simplified, and folded where all of
    them are constants."""
    simplified = _SIMPLIFIED.get(op)
    return simplified(*arguments) if simplified else _node(op, *arguments)


def _node(op: str, *arguments: Number) -> Expr:
    """The operator's node, or its value where all arguments are constants."""
    args = tuple([a if type(a) is Expr else expression(a) for a in arguments])
    for a in args:
        if a.op != "const":
            return Expr(op, args)
    values = [a.value for a in args]
    try:
        return const(OPERATORS[op].evaluate(*values))
    except (ValueError, ArithmeticError):
        raise EquationError(
            f"{op}({', '.join(map(str, values))}) is not a number",
            "guard the argument with maximum(...)" if len(args) == 1 else "guard the divisor",
        ) from None


def neg(argument: Number) -> Expr:
    a = expression(argument)
    return a.args[0] if a.op == "neg" else _node("neg", a)


def add(left: Number, right: Number) -> Expr:
    a, b = expression(left), expression(right)
    if _is(a, 0.0):
        return b
    if _is(b, 0.0):
        return a
    if b.op == "neg":
        return _node("sub", a, b.args[0])
    return _node("add", a, b)


def sub(left: Number, right: Number) -> Expr:
    a, b = expression(left), expression(right)
    if _is(b, 0.0):
        return a
    if _is(a, 0.0):
        return neg(b)
    return ZERO if a is b else _node("sub", a, b)


def mul(left: Number, right: Number) -> Expr:
    a, b = expression(left), expression(right)
    if a.op != "const" and b.op != "const":  # most products, which have nothing to simplify
        return Expr("mul", (a, b))
    if _is(a, 0.0) or _is(b, 0.0):
        return ZERO
    if _is(a, 1.0):
        return b
    if _is(b, 1.0):
        return a
    if _is(a, -1.0):
        return neg(b)
    if _is(b, -1.0):
        return neg(a)
    return _node("mul", a, b)


def div(left: Number, right: Number) -> Expr:
    a, b = expression(left), expression(right)
    if _is(b, 0.0):
        raise EquationError(
            f"{text(a)} is divided by zero", "guard the divisor with maximum(..., 1e-9)"
        )
    if _is(a, 0.0):
        return ZERO
    if b.op == "const":
        return mul(a, 1.0 / b.value)
    return _node("div", a, b)


def power(base: Number, exponent: Number) -> Expr:
    """base ** exponent; small whole exponents become products."""
    a, b = expression(base), expression(exponent)
    if b.op == "const":
        if b.value == 0.5:
            return _node("sqrt", a)
        # by repeated squaring: products are far cheaper than `pow`
        if b.value == int(b.value) and 0 <= b.value <= 8:
            result, factor, n = ONE, a, int(b.value)
            while n:
                result = mul(result, factor) if n & 1 else result
                factor, n = mul(factor, factor), n >> 1
            return result
    return _node("pow", a, b)


def where(condition: Number, a: Number, b: Number) -> Expr:
    """a where the condition holds, else b. Both sides are computed: keep both finite."""
    c, left, right = expression(condition), expression(a), expression(b)
    if left is right:
        return left
    if c.op == "const":
        return left if c.value else right
    return Expr("where", (c, left, right))


def tangent(value: Number, change: Number) -> Expr:
    """The value of the first, the derivatives of the second: for what is solved for, whose
    derivatives follow from the equations that it solves. `plain` leaves the value."""
    v, c = expression(value), expression(change)
    while v.op == "tangent":
        v = v.args[0]
    return v if v.op == c.op == "const" else Expr("tangent", (v, c))


#: operators that are simplified where they are built
_SIMPLIFIED: dict[str, Callable[..., Expr]] = {
    "add": add,
    "sub": sub,
    "mul": mul,
    "div": div,
    "neg": neg,
    "pow": power,
    "where": where,
    "tangent": tangent,
}


# ---- walking -----------------------------------------------------------------------------------


def walk(
    roots: Iterable[Expr], below: Callable[[Expr], tuple[Expr, ...]] | None = None
) -> list[Expr]:
    """Every node below `roots`, arguments first, in an order that depends on the equations only.

    below: which arguments of a node are looked at (default: all).
    """
    seen: set[Expr] = set()
    order: list[Expr] = []
    # a separate stack, for graphs that are deeper than Python's recursion may go; None stands
    # above a node whose arguments have been looked at
    stack: list[Expr | None] = []
    for root in roots:
        stack.append(root)
        while stack:
            node = stack.pop()
            if node is None:
                order.append(stack.pop())  # type: ignore[arg-type]
            elif node not in seen:
                seen.add(node)
                args = below(node) if below is not None else node.args
                waiting = [a for a in args if a not in seen]
                if waiting:
                    stack += (node, None)
                    stack += waiting[::-1]
                else:
                    order.append(node)
    return order


def rebuild(node: Expr, args: tuple[Expr, ...]) -> Expr:
    """The same operation on other arguments, simplified again."""
    if node.op in OPERATORS or node.op in _SIMPLIFIED:
        return apply(node.op, *args)
    return Expr(node.op, args, node.value)


def _on_other_arguments(node: Expr, new: dict[Expr, Expr]) -> Expr:
    """The node where some of its arguments have become others; itself where none has."""
    for argument in node.args:
        if argument in new:
            return rebuild(node, tuple([new.get(a, a) for a in node.args]))
    return node


def substitute(roots: Iterable[Expr], values: dict[Expr, Expr]) -> list[Expr]:
    """The roots with some nodes replaced."""
    roots = list(roots)
    new: dict[Expr, Expr] = {}  # of those alone that change
    for node in walk(roots):
        other = values[node] if node in values else _on_other_arguments(node, new)
        if other is not node:
            new[node] = other
    return [new.get(r, r) for r in roots]


def change_of(node: Expr) -> tuple[Expr, ...]:
    """The arguments of a node that its derivatives are made of: of `where`, the branches alone."""
    return node.args[1:] if node.op in ("tangent", "where") else node.args


def plain(roots: Iterable[Expr]) -> list[Expr]:
    """The roots for their values alone: the derivatives of `tangent` are dropped."""
    roots = list(roots)
    new: dict[Expr, Expr] = {}  # of those alone that change
    for node in walk(roots, lambda node: node.args[:1] if node.op == "tangent" else node.args):
        if node.op == "tangent":
            new[node] = new.get(node.args[0], node.args[0])
        elif (other := _on_other_arguments(node, new)) is not node:
            new[node] = other
    return [new.get(r, r) for r in roots]


def symbols(roots: Iterable[Expr]) -> set[tuple[str, str]]:
    """(space, name) of every symbol below the roots."""
    reach, names = _united(roots), set()
    while reach:
        names.add(_symbols[reach.bit_length() - 1])
        reach ^= 1 << (reach.bit_length() - 1)
    return names


# ---- printing ----------------------------------------------------------------------------------


def text(node: Expr) -> str:
    """The expression as plain text, as a user would type it."""
    return _text(node)[0]


def _text(node: Expr) -> tuple[str, int]:
    """The text, and how tightly it binds."""
    if node.op == "const":
        return (f"{node.value:.6g}", ATOM if node.value >= 0 else SUM)
    if node.op == "symbol":
        return (node.value[1], ATOM)
    operator = OPERATORS.get(node.op)
    if operator is None or not operator.sign:
        return (f"{node.op}({', '.join(text(a) for a in node.args)})", ATOM)
    if operator.arity == 1:
        inner, level = _text(node.args[0])
        return (
            f"{operator.sign}({inner})" if level < PRODUCT else f"{operator.sign}{inner}",
            operator.binds,
        )
    level = operator.binds
    (left, a), (right, b) = _text(node.args[0]), _text(node.args[1])
    left = f"({left})" if a < level else left
    regroups = b == level and node.op in ("sub", "div", "pow")  # a - (b - c) is not a - b - c
    right = f"({right})" if b < level or regroups else right
    gap = "" if level == POWER else " "
    return (f"{left}{gap}{operator.sign}{gap}{right}", level)
