"""Expressions as LLVM IR text: a straight-line function per group of equations.

Every function has the same signature, seven addresses: states, cells, past cells, inputs,
parameters, ticks, out. `out` receives the values and, for derivatives, the non-zero
partials row by row. A value is a double, or a vector of doubles, an element per hypothesis
(`ValueType`).
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pamid.engine.symbolic.derivative import gradients
from pamid.engine.symbolic.expression import Expr, plain, substitute, symbol, walk
from pamid.engine.symbolic.operators import OPERATORS

SPACES = ("state", "cell", "past", "input", "parameter", "tick")
_ARRAY = {space: i for i, space in enumerate(SPACES)} | {
    "derived": SPACES.index("parameter"),
    "rise": SPACES.index("input"),
}
LONG_MODULE, PART = 3000, 200  # operations: of a module that is written in parts, and of a part
IN_PARTS = "; in parts"  # its first line
LANES = 8  # sensitivity columns handled at once; matrices are padded to a multiple of it


@dataclass(frozen=True)
class ValueType:
    """The LLVM type of a value: double, or a vector of so many lanes.

    functions: of vectors, instead of the scalar functions of these names that operators call;
    shared: spaces whose arrays hold a single value for all lanes.
    """

    lanes: int = 1
    functions: tuple[tuple[str, str], ...] = ()
    shared: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        return "double" if self.lanes == 1 else f"<{self.lanes} x double>"

    @property
    def truth(self) -> str:
        return "i1" if self.lanes == 1 else f"<{self.lanes} x i1>"

    @property
    def alignment(self) -> str:
        """Alignment of a load or a store: NumPy aligns no array to a whole vector."""
        return "" if self.lanes == 1 else ", align 8"

    def constant(self, value: float) -> str:
        # the bits of the double: LLVM refuses a decimal that is not exact
        bits = f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}"
        return bits if self.lanes == 1 else f"<{', '.join([f'double {bits}'] * self.lanes)}>"

    def line(self, scalar: str) -> str:
        """An operator's line of IR, which the table has for doubles, for this type."""
        if self.lanes == 1:
            return scalar
        line = scalar.replace("double", self.name).replace("select i1", f"select {self.truth}")
        for name, function in self.functions:
            line = line.replace(f"@{name}(", f"@{function}(")
        return line.replace(".f64(", f".v{self.lanes}f64(")


SCALAR = ValueType()


def part_of(groups: list[list[Expr]]) -> int | None:
    """Operations of a part where these groups of equations are to be written in parts, else
    None."""
    return PART if sum(len(walk(roots)) for roots in groups) > LONG_MODULE else None


def declarations(part: int | None) -> str:
    """Declarations of the functions that a module may call."""
    lines = [] if part is None else [IN_PARTS]
    lines += ["declare <8 x double> @llvm.fmuladd.v8f64(<8 x double>, <8 x double>, <8 x double>)"]
    for operator in OPERATORS.values():
        for name in re.findall(r"call double @([\w.]+)\(", " ".join(operator.llvm)):
            lines.append(f"declare double @{name}({', '.join(['double'] * operator.arity)})")
    return "\n".join(lines)


def function_text(
    name: str,
    roots: list[Expr],
    index: Callable[[str, str], int],
    part: int | None = None,
    kind: ValueType = SCALAR,
) -> str:
    """LLVM IR of a function that stores `roots` to out[0], out[1], ...

    index(space, name) is the place of a symbol in its array. part: operations of a part; None is
    a single part. Parts exchange values in memory and share no registers, because LLVM's time to
    allocate registers grows faster than the function. kind: of the values in all arrays but those
    that lanes share, which hold doubles.
    """
    order = walk(roots)
    # constants and symbols are at hand everywhere
    computed = [node for node in order if node.op not in ("const", "symbol")]
    parts = {node: 0 if part is None else k // part for k, node in enumerate(computed)}
    writer = _FunctionWriter(index, parts, roots, kind)
    for node in order:
        writer.write(node)
    for i, root in enumerate(roots):
        writer.store(writer.value(root), f"%b{len(SPACES)}, i64 {i}")
    return writer.text(name)


class _FunctionWriter:
    """Lines of a function, as nodes are written in sequence.

    names, truths: the registers of the present part that hold a node, or whether it is not zero;
    stored: places on the stack of nodes that later parts need.
    """

    def __init__(
        self,
        index: Callable[[str, str], int],
        parts: dict[Expr, int],
        roots: list[Expr],
        kind: ValueType,
    ) -> None:
        self.index, self.parts, self.kind = index, parts, kind
        self.lines: list[str] = []
        self.names: dict[Expr, str] = {}
        self.truths: dict[Expr, str] = {}
        self.stored: dict[Expr, int] = {}
        self.count, self.now = 0, 0
        self.last = max(parts.values(), default=0)
        # by another part; results are stored at the end
        self.wanted = {a for node, k in parts.items() for a in node.args if parts.get(a, k) != k}
        self.wanted |= {root for root in roots if parts.get(root, self.last) != self.last}

    def fresh(self, line: str) -> str:
        self.count += 1
        self.lines.append(f"%v{self.count} = {line}")
        return f"%v{self.count}"

    def value(self, node: Expr) -> str:
        """The register that holds a node, loaded where the present part has none."""
        if node.op == "const":
            return self.kind.constant(node.value)
        if node not in self.names:
            if node.op == "symbol":
                space, what = node.value
                place = f"%b{_ARRAY[space]}, i64 {self.index(space, what)}"
                self.names[node] = (
                    self._spread(place)
                    if space in self.kind.shared
                    else self._load(place, self.kind)
                )
            else:
                self.names[node] = self._load(f"%kept, i64 {self.stored[node]}", self.kind)
        return self.names[node]

    def _load(self, place: str, kind: ValueType) -> str:
        at = self.fresh(f"getelementptr {kind.name}, ptr {place}")
        return self.fresh(f"load {kind.name}, ptr {at}{kind.alignment}")

    def _spread(self, place: str) -> str:
        """A double in every lane."""
        name, lanes = self.kind.name, self.kind.lanes
        first = self.fresh(
            f"insertelement {name} poison, double {self._load(place, SCALAR)}, i64 0"
        )
        return self.fresh(
            f"shufflevector {name} {first}, {name} poison, <{lanes} x i32> zeroinitializer"
        )

    def store(self, register: str, place: str) -> None:
        at = self.fresh(f"getelementptr {self.kind.name}, ptr {place}")
        self.lines.append(f"store {self.kind.name} {register}, ptr {at}{self.kind.alignment}")

    def write(self, node: Expr) -> None:
        """Write the code of a node into the part that it belongs to."""
        if node not in self.parts:
            if not self.last:  # symbols are loaded where they are first met
                self.value(node)
            return
        self._enter(self.parts[node])
        kind = self.kind
        if node.op == "where":
            condition = node.args[0]
            if condition not in self.truths:
                zero = "0.0" if kind == SCALAR else "zeroinitializer"
                compared = f"fcmp one {kind.name} {self.value(condition)}, {zero}"
                self.truths[condition] = self.fresh(compared)
            truth = self.truths[condition]
            yes, no = (f"{kind.name} {self.value(a)}" for a in node.args[1:])
            self.names[node] = self.fresh(f"select {kind.truth} {truth}, {yes}, {no}")
        else:
            a = [self.value(x) for x in node.args]
            operator, last = OPERATORS[node.op], ""
            for line in operator.llvm:
                last = self.fresh(kind.line(line).format(*a, last=last))
            if operator.is_comparison:
                # stored next to the 1.0 or 0.0 that arithmetic sees: `where` selects by it directly
                self.truths[node] = last
                unit, zero = (f"{kind.name} {kind.constant(v)}" for v in (1.0, 0.0))
                last = self.fresh(f"select {kind.truth} {last}, {unit}, {zero}")
            self.names[node] = last
        if node in self.wanted:
            self.stored[node] = len(self.stored)
            self.store(self.names[node], f"%kept, i64 {self.stored[node]}")

    def _enter(self, part: int) -> None:
        if part == self.now:
            return
        self.now = part
        self.names.clear()
        self.truths.clear()
        # a branch that is always taken, which LLVM does not know: it would join the parts again
        self.lines += [f"br i1 %always, label %part{part}, label %end", f"part{part}:"]

    def text(self, name: str) -> str:
        arguments = ", ".join(f"i64 %a{i}" for i in range(len(SPACES) + 1))
        head = [f"define void @{name}({arguments}) {{"]
        head += [f"%b{i} = inttoptr i64 %a{i} to ptr" for i in range(len(SPACES) + 1)]
        if not self.last:
            return "\n".join([*head, *self.lines, "ret void", "}"])
        head.append(f"%always = icmp ne i64 %a{len(SPACES)}, 0")
        head.append(f"%kept = alloca {self.kind.name}, i64 {max(len(self.stored), 1)}")
        return "\n".join([*head, *self.lines, "br label %end", "end:", "ret void", "}"])


def extract_derived(
    groups: list[list[Expr]], known: Sequence[Expr] = ()
) -> tuple[list[list[Expr]], list[Expr]]:
    """Replace what depends on parameters only by symbols of the space "derived"; returns these
    expressions too. known: the first of them."""
    every = [root for group in groups for root in group]
    nodes = walk(every)
    fixed: set[Expr] = set()
    for node in nodes:
        if node.value[0] == "parameter" if node.op == "symbol" else fixed.issuperset(node.args):
            fixed.add(node)
    # only the uppermost of such nodes: those below are computed on the way to them
    top = {node: symbol("derived", str(i)) for i, node in enumerate(known)}

    def take(node: Expr) -> None:
        if node.args and node in fixed and node not in top:
            top[node] = symbol("derived", str(len(top)))

    for node in nodes:
        if node not in fixed:
            for argument in node.args:
                take(argument)
    for root in every:
        take(root)
    new = iter(substitute(every, top))
    return [[next(new) for _ in group] for group in groups], list(top)


def with_partials(
    roots: list[Expr],
    column: Callable[[str, str], int],
    parameters: frozenset[str] | None = None,
    spaces: tuple[str, ...] = SPACES,
) -> tuple[list[Expr], list[int], list[int]]:
    """Roots followed by their non-zero partials by symbols of these spaces, and the sparse pattern
    of these: row pointers and columns."""
    values, pointer, columns = list(roots), [0], []
    for gradient in gradients(roots, parameters):
        partials = [(s.value, d) for s, d in gradient.items() if s.value[0] in spaces]
        entries = sorted(((column(*place), d) for place, d in partials), key=lambda e: e[0])
        columns += [c for c, _ in entries]
        values += [d for _, d in entries]
        pointer.append(len(columns))
    return plain(values), pointer, columns


def product_text(name: str, pointer: list[int], columns: list[int], rows_of_S: int) -> str:
    """LLVM IR of D = P S for a fixed sparsity: addresses of the partials, S and D, and the padded
    column count.

    pointer, columns: the pattern of `with_partials`; entries of columns >= rows_of_S belong to
    parameters and are left to the caller. A pass over the columns, eight at a time, rows written
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
