"""LLVM IR of equations for several hypotheses side by side: a value is a vector, with a lane for
each.

The text is written as for a single hypothesis (`pamid.engine.llvm_ir`). LLVM lowers square roots,
absolute values and rounding to vector instructions, and calls the C library lane by lane for
logarithms and powers. exp, tanh, sin and cos, which most models have, are vector code
(`pamid.engine.simd`).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

from llvmlite import ir

from pamid.engine.llvm_ir import IN_PARTS, ValueType, function_text, part_of
from pamid.engine.simd import FAR_ANGLE, LANES, Vectors
from pamid.engine.symbolic.expression import Expr

_FUNCTIONS = {"llvm.exp.f64": "exp", "tanh": "tanh", "llvm.sin.f64": "sin", "llvm.cos.f64": "cos"}
HYPOTHESES = ValueType(
    LANES,
    tuple((name, f"lanes_{vector}") for name, vector in _FUNCTIONS.items()),
    ("input", "rise", "tick"),
)


def lane_module_text(
    groups: dict[str, list[Expr]],
    index: Callable[[str, str], int],
    shared: tuple[str, ...] = HYPOTHESES.shared,
) -> str:
    """A module with a function per group, of this name, whose values are vectors; shared: spaces
    with a single value for all lanes."""
    part, kind = part_of(list(groups.values())), replace(HYPOTHESES, shared=shared)
    functions = [function_text(n, g, index, part, kind) for n, g in groups.items()]
    text = "\n".join([_vector_functions(), *functions])
    # intrinsics that the text calls and does not declare
    calls = re.findall(r'call (<\d+ x double>) @"?(llvm\.\w+\.v\d+f64)"?\(([^)]*)\)', text)
    arguments = {name: (kind, values.count(kind)) for kind, name, values in calls}
    declarations = (
        f"declare {kind} @{name}({', '.join([kind] * count)})"
        for name, (kind, count) in sorted(arguments.items())
    )
    return "\n".join([*([] if part is None else [IN_PARTS]), *declarations, text])


@cache
def _vector_functions() -> str:
    writers: dict[str, Callable[[Vectors, Any], None]] = {
        "lanes_exp": lambda v, a: v.builder.ret(v.exp(a)),
        "lanes_tanh": lambda v, a: v.builder.ret(v.tanh_to_zero(a)),
        "lanes_sin": lambda v, a: _circle_function(v, a, 0, "sin"),
        "lanes_cos": lambda v, a: _circle_function(v, a, 1, "cos"),
    }
    module = ir.Module()
    vector = ir.VectorType(ir.DoubleType(), LANES)
    functions = []
    for name, write in writers.items():
        function = ir.Function(module, ir.FunctionType(vector, [vector]), name)
        # Inlined into the equations, because a call per operation would spill all vector
        # registers.
        function.linkage = "internal"
        function.attributes.add("alwaysinline")
        write(Vectors(ir.IRBuilder(function.append_basic_block())), function.args[0])
        functions.append(str(function))
    for name in ("sin", "cos"):
        kind = HYPOTHESES.name
        functions.append(
            # Kept out of line: the rare branch would otherwise grow every function that takes a
            # sine.
            f"define internal {kind} @far_{name}({kind} %a) noinline cold {{\n"
            f"%v = call {kind} @llvm.{name}.v{LANES}f64({kind} %a)\nret {kind} %v\n}}"
        )
    return "\n".join(functions)


def _circle_function(v: Vectors, a: Any, which: int, name: str) -> None:
    """sin or cos by vectors, or by the C library where a lane is far from zero or not finite."""
    b = v.builder
    far = ir.Function(b.module, b.function.function_type, f"far_{name}")
    near = v.all_within(a, FAR_ANGLE)
    with b.if_then(b.not_(near)):
        b.ret(b.call(far, [a]))
    b.ret(v.sin_and_cos(a)[which])
