"""The table of operators: definition, derivative, and spelling in every language.

An operator is added here and nowhere else: folding of constants, derivatives, machine code, and the
exports to C, MATLAB and ONNX all read this table; `tests/unit/test_operators.py` walks it.

Four kinds of node are not operators, and every reader handles them by name: `const` and `symbol`;
`where`, whose condition is a truth value and whose derivative is a choice between two; and
`tangent`, of which `pamid.engine.symbolic.expression.plain` leaves the value. Memory operators
(play, lag, delay ...) are replaced before anything is compiled or exported, see
`pamid.engine.symbolic.memory_cells`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

# How tightly text binds; an argument that binds less tightly than its place asks needs parentheses.
CHOICE, COMPARISON, SUM, PRODUCT, POWER, ATOM = range(6)


@dataclass(frozen=True)
class Operator:
    """An operator on numbers.

    evaluate    its value for floats, to fold constants; ValueError or ArithmeticError where there
                is none
    derivative  (apply, y, *arguments) -> partial derivatives of the value y by each argument, as
                expressions or numbers; apply(name, ...) builds an expression with another operator
    llvm        lines of LLVM IR, the last its value: {0}, {1} are the arguments, {last} is the
                value of the line before; of a comparison an i1
    onnx, numpy name of the ONNX operator (opset 18) and of the NumPy function
    c, matlab   name of the function: of C99 <math.h> or MATLAB, or a function whose source is
                written along; "": the sign is used
    sign        stands before its only argument or between its two; "": plain text shows its name
    binds       how tightly the sign binds
    """

    name: str
    arity: int
    evaluate: Callable[..., float]
    derivative: Callable[..., tuple[Any, ...]]
    llvm: tuple[str, ...]
    onnx: str
    numpy: str
    c: str = ""
    matlab: str = ""
    sign: str = ""
    binds: int = ATOM
    is_comparison: bool = False


def _arithmetic(llvm: str) -> tuple[str]:
    return (f"{llvm} contract double {{0}}, {{1}}",)  # contract: a * b + c may be rounded once


def _call(name: str, arguments: int = 1) -> tuple[str]:
    return (f"call double @{name}({', '.join(f'double {{{i}}}' for i in range(arguments))})",)


def _extreme(comparison: str) -> tuple[str, str]:
    return (f"fcmp {comparison} double {{0}}, {{1}}", "select i1 {last}, double {0}, double {1}")


_TABLE = (
    Operator(
        "add",
        2,
        lambda a, b: a + b,
        lambda apply, y, a, b: (1.0, 1.0),
        llvm=_arithmetic("fadd"),
        onnx="Add",
        numpy="add",
        sign="+",
        binds=SUM,
    ),
    Operator(
        "sub",
        2,
        lambda a, b: a - b,
        lambda apply, y, a, b: (1.0, -1.0),
        llvm=_arithmetic("fsub"),
        onnx="Sub",
        numpy="subtract",
        sign="-",
        binds=SUM,
    ),
    Operator(
        "mul",
        2,
        lambda a, b: a * b,
        lambda apply, y, a, b: (b, a),
        llvm=_arithmetic("fmul"),
        onnx="Mul",
        numpy="multiply",
        sign="*",
        binds=PRODUCT,
    ),
    Operator(
        "div",
        2,
        lambda a, b: a / b,
        lambda apply, y, a, b: (1.0 / b, -(y / b)),
        llvm=_arithmetic("fdiv"),
        onnx="Div",
        numpy="divide",
        sign="/",
        binds=PRODUCT,
    ),
    Operator(
        "neg",
        1,
        lambda a: -a,
        lambda apply, y, a: (-1.0,),
        llvm=("fneg double {0}",),
        onnx="Neg",
        numpy="negative",
        sign="-",
        binds=SUM,
    ),
    Operator(
        "sqrt",
        1,
        math.sqrt,
        lambda apply, y, a: (0.5 / y,),
        llvm=_call("llvm.sqrt.f64"),
        onnx="Sqrt",
        numpy="sqrt",
        c="sqrt",
        matlab="sqrt",
    ),
    Operator(
        "exp",
        1,
        math.exp,
        lambda apply, y, a: (y,),
        llvm=_call("llvm.exp.f64"),
        onnx="Exp",
        numpy="exp",
        c="exp",
        matlab="exp",
    ),
    Operator(
        "log",
        1,
        math.log,
        lambda apply, y, a: (1.0 / a,),
        llvm=_call("llvm.log.f64"),
        onnx="Log",
        numpy="log",
        c="log",
        matlab="log",
    ),
    Operator(
        "sin",
        1,
        math.sin,
        lambda apply, y, a: (apply("cos", a),),
        llvm=_call("llvm.sin.f64"),
        onnx="Sin",
        numpy="sin",
        c="sin",
        matlab="sin",
    ),
    Operator(
        "cos",
        1,
        math.cos,
        lambda apply, y, a: (-apply("sin", a),),
        llvm=_call("llvm.cos.f64"),
        onnx="Cos",
        numpy="cos",
        c="cos",
        matlab="cos",
    ),
    Operator(
        "floor",
        1,
        math.floor,
        lambda apply, y, a: (0.0,),
        llvm=_call("llvm.floor.f64"),
        onnx="Floor",
        numpy="floor",
        c="floor",
        matlab="floor",
    ),
    Operator(
        "abs",
        1,
        abs,
        lambda apply, y, a: (
            apply("where", a > 0.0, 1.0, apply("where", a < 0.0, -1.0, 0.0)),  # 0 at 0
        ),
        llvm=_call("llvm.fabs.f64"),
        onnx="Abs",
        numpy="abs",
        c="fabs",
        matlab="abs",
    ),
    Operator(
        "tanh",
        1,
        math.tanh,
        lambda apply, y, a: (1.0 - y * y,),
        llvm=_call("tanh"),
        onnx="Tanh",
        numpy="tanh",
        c="tanh",
        matlab="tanh",
    ),
    Operator(
        "pow",
        2,
        math.pow,
        lambda apply, y, a, b: (b * a ** (b - 1.0), y * apply("log", a)),
        llvm=_call("llvm.pow.f64", 2),
        onnx="Pow",
        numpy="power",
        c="pow",
        matlab="power",
        sign="**",  # as plain text; C has no sign, and that of MATLAB is another
        binds=POWER,
    ),
    Operator(
        "min",
        2,
        min,
        lambda apply, y, a, b: (apply("where", a < b, 1.0, 0.0), apply("where", a < b, 0.0, 1.0)),
        llvm=_extreme("olt"),
        onnx="Min",
        numpy="minimum",
        c="least",
        matlab="least",
    ),
    Operator(
        "max",
        2,
        max,
        lambda apply, y, a, b: (apply("where", a > b, 1.0, 0.0), apply("where", a > b, 0.0, 1.0)),
        llvm=_extreme("ogt"),
        onnx="Max",
        numpy="maximum",
        c="greatest",
        matlab="greatest",
    ),
    Operator(
        "lt",
        2,
        lambda a, b: float(a < b),
        lambda apply, y, a, b: (0.0, 0.0),
        llvm=("fcmp olt double {0}, {1}",),
        onnx="Less",
        numpy="less",
        sign="<",
        binds=COMPARISON,
        is_comparison=True,
    ),
    Operator(
        "le",
        2,
        lambda a, b: float(a <= b),
        lambda apply, y, a, b: (0.0, 0.0),
        llvm=("fcmp ole double {0}, {1}",),
        onnx="LessOrEqual",
        numpy="less_equal",
        sign="<=",
        binds=COMPARISON,
        is_comparison=True,
    ),
)

#: every operator by its name
OPERATORS: dict[str, Operator] = {operator.name: operator for operator in _TABLE}


def is_comparison(name: str) -> bool:
    """Whether a node of this name is a comparison: true or false, counted as 1 or 0."""
    return name in OPERATORS and OPERATORS[name].is_comparison
