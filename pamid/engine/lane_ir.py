"""LLVM IR of equations for several hypotheses side by side: a value is a vector, one lane each.

The text is written as for one hypothesis (`pamid.engine.llvm_ir`). LLVM lowers square roots,
absolute values and rounding to vector instructions, and calls the C library lane by lane for sines,
logarithms and powers. exp and tanh, which nearly every model has, are vector code
(`pamid.engine.simd`).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from llvmlite import ir

from pamid.engine.llvm_ir import IN_PARTS, ValueType, function_text, part_of
from pamid.engine.simd import LANES, Vectors
from pamid.symbolic.expression import Expr

HYPOTHESES = ValueType(LANES, (("llvm.exp.f64", "lanes_exp"), ("tanh", "lanes_tanh")))


def lane_module_text(groups: dict[str, list[Expr]], index: Callable[[str, str], int]) -> str:
    """A module with one function per group, of this name, whose values are vectors."""
    part = part_of(list(groups.values()))
    functions = [function_text(n, g, index, part, HYPOTHESES) for n, g in groups.items()]
    text = "\n".join([_vector_functions(), *functions])
    return "\n".join([*([] if part is None else [IN_PARTS]), *_declarations(text), text])


def _declarations(text: str) -> list[str]:
    """Intrinsics that a text calls and does not declare."""
    calls = re.findall(r"call (<\d+ x double>) @(llvm\.\w+\.v\d+f64)\(([^)]*)\)", text)
    arguments = {name: (kind, values.count(kind)) for kind, name, values in calls}
    return [
        f"declare {kind} @{name}({', '.join([kind] * count)})"
        for name, (kind, count) in sorted(arguments.items())
    ]


def _vector_functions() -> str:
    module = ir.Module()
    kind = ir.FunctionType(*[(v := ir.VectorType(ir.DoubleType(), LANES)), [v]])
    writers: dict[str, Callable[[Vectors, Any], Any]] = {
        "lanes_exp": Vectors.exp,
        "lanes_tanh": Vectors.tanh_to_zero,
    }
    functions = []
    for name, write in writers.items():
        function = ir.Function(module, kind, name)
        function.linkage = "internal"
        function.attributes.add("alwaysinline")
        builder = ir.IRBuilder(function.append_basic_block())
        builder.ret(write(Vectors(builder), function.args[0]))
        functions.append(str(function))
    return "\n".join(functions)
