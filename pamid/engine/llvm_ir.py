"""Expressions as LLVM IR text: one straight-line function per group of equations.

Every function has the same signature, seven addresses: states, cells, past cells, inputs,
parameters, ticks, out. `out` receives the values and, where derivatives are asked for, the non-zero
partials row by row.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable

from pamid.symbolic.derivative import gradients
from pamid.symbolic.expression import Expr, plain, substitute, symbol, walk
from pamid.symbolic.operators import OPERATORS

SPACES = ("state", "cell", "past", "input", "parameter", "tick")
_ARRAY = {space: i for i, space in enumerate(SPACES)} | {
    "derived": SPACES.index("parameter"),
    "rise": SPACES.index("input"),
}
LANES = 8  # sensitivity columns handled at once; matrices are padded to a multiple of it


def declarations() -> str:
    """What the functions of a module may call."""
    found = ["declare <8 x double> @llvm.fmuladd.v8f64(<8 x double>, <8 x double>, <8 x double>)"]
    for operator in OPERATORS.values():
        for name in re.findall(r"call double @([\w.]+)\(", " ".join(operator.llvm)):
            found.append(f"declare double @{name}({', '.join(['double'] * operator.arity)})")
    return "\n".join(found)


def _constant(value: float) -> str:
    # the bits of the double: LLVM refuses a decimal that is not exactly one
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
            place = fresh(f"getelementptr double, ptr %b{_ARRAY[space]}, i64 {index(space, what)}")
            names[node] = fresh(f"load double, ptr {place}")
        elif node.op == "where":
            names[node] = fresh(f"select i1 {truth(node.args[0])}, double {a[1]}, double {a[2]}")
        else:
            operator, last = OPERATORS[node.op], ""
            for line in operator.llvm:
                last = fresh(line.format(*a, last=last))
            if operator.is_comparison:
                # kept beside the 1.0 or 0.0 that arithmetic sees: `where` selects by it directly
                truths[node] = last
                last = fresh(f"select i1 {last}, double {_constant(1.0)}, double {_constant(0.0)}")
            names[node] = last
    for i, root in enumerate(roots):
        place = fresh(f"getelementptr double, ptr %b{len(SPACES)}, i64 {i}")
        lines.append(f"store double {names[root]}, ptr {place}")
    return "\n".join([*lines, "ret void", "}"])


def extract_derived(groups: list[list[Expr]]) -> tuple[list[list[Expr]], list[Expr]]:
    """Replace what depends on parameters only by symbols of the space "derived"; returns these
    expressions too."""
    every = [root for group in groups for root in group]
    nodes = walk(every)
    fixed: dict[Expr, bool] = {}
    for node in nodes:
        fixed[node] = (
            node.value[0] == "parameter"
            if node.op == "symbol"
            else all(fixed[a] for a in node.args)
        )
    # only the uppermost of such nodes: those below are computed on the way to them
    top: dict[Expr, Expr] = {}

    def take(node: Expr) -> None:
        if node.args and fixed[node] and node not in top:
            top[node] = symbol("derived", str(len(top)))

    for node in nodes:
        if not fixed[node]:
            for argument in node.args:
                take(argument)
    for root in every:
        take(root)
    new = iter(substitute(every, top))
    return [[next(new) for _ in group] for group in groups], list(top)


def with_partials(
    roots: list[Expr], column: Callable[[str, str], int], parameters: frozenset[str] | None = None
) -> tuple[list[Expr], list[int], list[int]]:
    """Roots followed by their non-zero partials, and the sparse pattern of these: row pointers and
    columns."""
    values, pointer, columns = list(roots), [0], []
    for gradient in gradients(roots, parameters):
        entries = sorted(((column(*s.value), d) for s, d in gradient.items()), key=lambda e: e[0])
        columns += [c for c, _ in entries]
        values += [d for _, d in entries]
        pointer.append(len(columns))
    return plain(values), pointer, columns


def product_text(name: str, pointer: list[int], columns: list[int], rows_of_S: int) -> str:
    """LLVM IR of D = P S for a fixed sparsity: addresses of the partials, S and D, and the padded
    column count.

    pointer, columns: the pattern of `with_partials`; entries of columns >= rows_of_S belong to
    parameters and are left to the caller. One pass over the columns, eight at a time, rows written
    out.
    """
    lines = [
        f"define void @{name}(i64 %pa, i64 %sa, i64 %da, i64 %n) {{",
        "entry:",
        "%p = inttoptr i64 %pa to ptr",
        "%s = inttoptr i64 %sa to ptr",
        "%d = inttoptr i64 %da to ptr",
    ]
    # rows of S that nothing reads are never loaded; each of the others once for all rows of D
    used = sorted({c for c in columns if c < rows_of_S})
    entries = [
        [(e, columns[e]) for e in range(pointer[i], pointer[i + 1]) if columns[e] < rows_of_S]
        for i in range(len(pointer) - 1)
    ]
    for e, _ in (pair for row in entries for pair in row):
        lines += [
            f"%q{e} = getelementptr double, ptr %p, i64 {e}",
            f"%w{e} = load double, ptr %q{e}",
            f"%i{e} = insertelement <8 x double> poison, double %w{e}, i64 0",
            f"%v{e} = shufflevector <8 x double> %i{e}, <8 x double> poison, <8 x i32> "
            "zeroinitializer",
        ]
    lines += [f"%so{c} = mul i64 %n, {c}" for c in used]
    lines += [f"%do{i} = mul i64 %n, {i}" for i in range(len(entries))]
    lines += ["br label %loop", "loop:", "%k = phi i64 [0, %entry], [%next, %loop]"]
    for c in used:
        lines += [
            f"%sk{c} = add i64 %so{c}, %k",
            f"%sp{c} = getelementptr double, ptr %s, i64 %sk{c}",
            f"%S{c} = load <8 x double>, ptr %sp{c}, align 8",
        ]
    for i, row in enumerate(entries):
        value = "zeroinitializer"
        for e, c in row:
            lines.append(
                f"%r{e} = call <8 x double> @llvm.fmuladd.v8f64(<8 x double> %v{e}, <8 x double> "
                f"%S{c}, <8 x double> {value})"
            )
            value = f"%r{e}"
        lines += [
            f"%dk{i} = add i64 %do{i}, %k",
            f"%dp{i} = getelementptr double, ptr %d, i64 %dk{i}",
            f"store <8 x double> {value}, ptr %dp{i}, align 8",
        ]
    return "\n".join(
        [
            *lines,
            f"%next = add i64 %k, {LANES}",
            "%more = icmp slt i64 %next, %n",
            "br i1 %more, label %loop, label %exit",
            "exit:",
            "ret void",
            "}",
        ]
    )
