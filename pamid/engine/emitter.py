"""Expressions as LLVM IR text: one straight-line function per group of equations.

Every function has the same signature, seven addresses: states, cells, past cells, inputs, parameters, ticks, out.
`out` receives the values and, where derivatives are asked for, the non-zero partials row by row.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from pamid.engine.derivative import gradients
from pamid.equations import Expr, walk

SPACES = ("state", "cell", "past", "input", "parameter", "tick")
_CALLS = {"sqrt": "llvm.sqrt.f64", "exp": "llvm.exp.f64", "log": "llvm.log.f64", "sin": "llvm.sin.f64",
          "cos": "llvm.cos.f64", "floor": "llvm.floor.f64", "abs": "llvm.fabs.f64", "tanh": "tanh"}
_ARITHMETIC = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_COMPARE = {"lt": "olt", "le": "ole"}

DECLARATIONS = "\n".join(
    [f"declare double @{name}(double)" for name in _CALLS.values()]
    + ["declare double @llvm.pow.f64(double, double)"]
)


def _constant(value: float) -> str:
    return f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}"


def function_text(name: str, roots: list[Expr], index: Callable[[str, str], int]) -> str:
    """LLVM IR of one function that stores `roots` to out[0], out[1], ...

    index(space, name) is the place of a symbol in its array.
    """
    arguments = ", ".join(f"i64 %a{i}" for i in range(len(SPACES) + 1))
    lines = [f"define void @{name}({arguments}) {{"]
    lines += [f"%b{i} = inttoptr i64 %a{i} to ptr" for i in range(len(SPACES) + 1)]
    names: dict[Expr, str] = {}
    truths: dict[Expr, str] = {}
    count = 0

    def fresh(line: str) -> str:
        nonlocal count
        count += 1
        lines.append(f"%v{count} = {line}")
        return f"%v{count}"

    def truth(node: Expr) -> str:
        if node not in truths:
            truths[node] = fresh(f"fcmp one double {names[node]}, 0.0")
        return truths[node]

    for node in walk(roots):
        a = [names[x] for x in node.args]
        if node.op == "const":
            names[node] = _constant(node.value)
        elif node.op == "symbol":
            space, what = node.value
            place = fresh(f"getelementptr double, ptr %b{SPACES.index(space)}, i64 {index(space, what)}")
            names[node] = fresh(f"load double, ptr {place}")
        elif node.op in _ARITHMETIC:
            names[node] = fresh(f"{_ARITHMETIC[node.op]} contract double {a[0]}, {a[1]}")
        elif node.op in _CALLS:
            names[node] = fresh(f"call double @{_CALLS[node.op]}(double {a[0]})")
        elif node.op == "neg":
            names[node] = fresh(f"fneg double {a[0]}")
        elif node.op == "pow":
            names[node] = fresh(f"call double @llvm.pow.f64(double {a[0]}, double {a[1]})")
        elif node.op in ("min", "max"):
            flag = fresh(f"fcmp {'olt' if node.op == 'min' else 'ogt'} double {a[0]}, {a[1]}")
            names[node] = fresh(f"select i1 {flag}, double {a[0]}, double {a[1]}")
        elif node.op in _COMPARE:
            truths[node] = fresh(f"fcmp {_COMPARE[node.op]} double {a[0]}, {a[1]}")
            names[node] = fresh(f"select i1 {truths[node]}, double {_constant(1.0)}, double {_constant(0.0)}")
        elif node.op == "where":
            names[node] = fresh(f"select i1 {truth(node.args[0])}, double {a[1]}, double {a[2]}")
        else:
            raise AssertionError(f"cannot emit {node.op}")
    for i, root in enumerate(roots):
        place = fresh(f"getelementptr double, ptr %b{len(SPACES)}, i64 {i}")
        lines.append(f"store double {names[root]}, ptr {place}")
    return "\n".join([*lines, "ret void", "}"])


def with_partials(
    roots: list[Expr], column: Callable[[str, str], int]
) -> tuple[list[Expr], list[int], list[int]]:
    """Roots followed by their non-zero partials, and the sparse pattern of these: row pointers and columns."""
    values, pointer, columns = list(roots), [0], []
    for gradient in gradients(roots):
        entries = sorted(((column(*s.value), d) for s, d in gradient.items()), key=lambda e: e[0])
        columns += [c for c, _ in entries]
        values += [d for _, d in entries]
        pointer.append(len(columns))
    return values, pointer, columns
