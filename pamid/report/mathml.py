"""Expressions as MathML, which browsers set: fractions, roots, powers, cases, names."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from markupsafe import Markup

from pamid.engine.symbolic.expression import Expr, const
from pamid.engine.symbolic.vocabulary import sign, smooth_step, stop
from pamid.report import formatting
from pamid.report.markup import Part, tag

#: how a symbol (space, name) is shown
Shown = Callable[[str, str], Markup]

_SUM, _PRODUCT, _SYMBOL = 1, 2, 3  # what binds how tightly
_RELATIONS = {"lt": "<", "le": "≤"}
_FUNCTION_NAMES = {"log": "ln"}
# written with pi
_CIRCLE = {m * math.pi**k: (m, k) for m, k in ((0.5, 1), (1.0, 1), (2.0, 1), (4.0, 1), (4.0, 2))}
_GUARD = 1e-12  # what a bristle's reach is kept above


def math_html(rows: list[list[Markup]], spoken: str) -> Markup:
    """Equations below each other, aligned at the second cell; spoken: the same in plain text."""
    return tag("math", rows_of(*rows), display="block", alttext=spoken)


def name(text: str) -> Markup:
    """A quantity by its name; a single letter is slanted."""
    return tag("mi", formatting.clean(text).replace("_", " ").replace(" ", formatting.SPACE))


def operator(text: str, **attributes: str) -> Markup:
    return tag("mo", text, **attributes)


def number_html(value: float, unit_text: str = "", digits: int = 3) -> Markup:
    """A number with its unit; powers of ten set as such."""
    head, _, power = formatting.short(abs(value), digits).partition(
        f"{formatting.SPACE}×{formatting.SPACE}10"
    )
    parts: list[Part] = [operator("−", form="prefix")] if value < 0.0 else []
    parts.append(tag("mn", head))
    if power:
        exponent = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
        whole = tag("mn", str(abs(exponent)))
        raised = tag("mrow", operator("−", form="prefix"), whole) if exponent < 0 else whole
        parts += [operator("×"), tag("msup", tag("mn", "10"), raised)]
    if unit_text:
        unit = tag("mtext", formatting.unbroken(unit_text))
        parts += [tag("mspace", width="0.2em"), unit]
    return tag("mrow", parts) if len(parts) > 1 else tag("mn", head)


def fenced(brackets: str, *parts: Markup) -> Markup:
    """Parts between brackets, separated by commas."""
    inside: list[Part] = []
    for part in parts:
        inside += [operator(",", separator="true"), part] if inside else [part]
    return tag(
        "mrow",
        operator(brackets[0], fence="true", form="prefix"),
        tag("mrow", inside),
        operator(brackets[1], fence="true", form="postfix"),
    )


def rows_of(*rows: Sequence[Markup], **attributes: str) -> Markup:
    """Rows of cells, aligned."""
    cells = [tag("mtr", [tag("mtd", cell) for cell in row]) for row in rows]
    return tag("mtable", cells, **attributes)


class Typeset:
    """Typesetter; `shown` is the notation of each symbol. functions: used ones, to explain."""

    def __init__(self, shown: Shown) -> None:
        self._shown, self.functions = shown, dict[str, None]()

    def __call__(self, node: Expr) -> Markup:
        return self._set(node)[0]

    def _set(self, node: Expr) -> tuple[Markup, int]:
        word = _word(node)
        if word is not None:
            return self._called(*word), _SYMBOL
        if node.op == "const":
            return _constant(node.value), _SYMBOL if node.value >= 0.0 else _SUM
        if node.op == "symbol":
            return self._shown(*node.value), _SYMBOL
        if node.op in ("add", "sub", "neg"):
            return self._sum(node), _SUM
        if node.op in ("mul", "div"):
            return self._product(node)
        return self._function(node), _SYMBOL

    def _called(self, function: str, arguments: tuple[Expr, ...]) -> Markup:
        self.functions[function] = None
        return tag("mrow", tag("mi", function), fenced("()", *map(self, arguments)))

    def _sum(self, node: Expr) -> Markup:
        parts: list[Part] = []
        for minus, term in _terms(node, False):
            if term.op == "const" and term.value < 0.0:
                minus, term = not minus, const(-term.value)
            body, level = self._set(term)
            if minus or parts:
                form = "infix" if parts else "prefix"
                parts.append(operator("−" if minus else "+", form=form))
            parts.append(fenced("()", body) if level == _SUM else body)
        return tag("mrow", parts)

    def _product(self, node: Expr) -> tuple[Markup, int]:
        above, below = _factors(node)
        factor = math.prod(part.value for part in above if part.op == "const")
        rest = [part for part in above if part.op != "const"]
        minus, factor = factor < 0.0, abs(factor)
        if not below and 1e-3 < factor < 1.0 and (1.0 / factor).is_integer():
            below, factor = [const(1.0 / factor)], 1.0
        product = self._factors(([const(factor)] if factor != 1.0 or not rest else []) + rest)
        product = tag("mfrac", product, self._factors(below)) if below else product
        if minus:
            return tag("mrow", operator("−", form="prefix"), product), _SUM
        return product, _PRODUCT

    def _factors(self, factors: list[Expr]) -> Markup:
        """Product of factors, with equal ones as powers."""
        parts: list[Part] = []
        for factor in dict.fromkeys(factors):
            body, level = self._set(factor)
            many = factors.count(factor)
            if level == _SUM and len(factors) > 1:
                body = fenced("()", body)
            body = tag("msup", body, tag("mn", str(many))) if many > 1 else body
            parts += [operator("⋅"), body] if parts else [body]
        return tag("mrow", parts) if len(parts) > 1 else Markup(str(parts[0]))

    def _function(self, node: Expr) -> Markup:
        args = [self(arg) for arg in node.args]
        if node.op == "sqrt":
            return tag("msqrt", args[0])
        if node.op == "exp":
            return tag("msup", tag("mi", "e"), args[0])
        if node.op == "abs":
            return fenced("||", args[0])
        if node.op == "floor":
            return fenced("⌊⌋", args[0])
        if node.op == "pow":
            base = args[0] if self._set(node.args[0])[1] == _SYMBOL else fenced("()", args[0])
            return tag("msup", base, args[1])
        if node.op in _RELATIONS:
            return tag("mrow", args[0], operator(_RELATIONS[node.op]), args[1])
        if node.op == "where":
            condition = tag("mrow", tag("mtext", f"if{formatting.SPACE}"), args[0])
            otherwise = tag("mtext", "otherwise")
            cases = rows_of((args[1], condition), (args[2], otherwise), class_="cases")
            return tag("mrow", operator("{", fence="true", form="prefix"), cases)
        return self._called(_FUNCTION_NAMES.get(node.op, node.op), node.args)


def _word(node: Expr) -> tuple[str, tuple[Expr, ...]] | None:
    """A word of the vocabulary that was spelt out; the same expression is the same object."""
    if node.op == "sub" and node.args[1].op == "play" and stop(*node.args[1].args) is node:
        return "stop", node.args[1].args
    if node.op == "where" and node.args[0].op == "lt" and sign(node.args[0].args[1]) is node:
        return "sgn", node.args[0].args[1:]
    if node.op == "bristle" and node.args[1].op == "max" and node.args[1].args[1] is const(_GUARD):
        return "bristle", (node.args[0], node.args[1].args[0])
    if node.op == "min" and node.args[0].op == "max":
        return "clip", (*node.args[0].args, node.args[1])
    if node.op == "mul" and node.args[0].op == "mul" and node.args[0].args[0].op == "min":
        inner = node.args[0].args[0].args[0]
        if inner.op == "max" and smooth_step(inner.args[0]) is node:
            return "step", inner.args[:1]
    return None


def _constant(value: float) -> Markup:
    for size, (many, exponent) in _CIRCLE.items():
        if math.isclose(value, size, rel_tol=1e-12):
            pi = tag("mi", "π")
            pi = pi if exponent == 1 else tag("msup", pi, tag("mn", str(exponent)))
            return pi if many == 1.0 else tag("mrow", tag("mn", f"{many:g}"), pi)
    return number_html(value, digits=4)


def _terms(node: Expr, minus: bool) -> list[tuple[bool, Expr]]:
    """The terms of a sum as (is it subtracted, term); a named function is a single term."""
    if node.op == "neg":
        return _terms(node.args[0], not minus)
    if node.op not in ("add", "sub") or _word(node) is not None:
        return [(minus, node)]
    return _terms(node.args[0], minus) + _terms(node.args[1], minus != (node.op == "sub"))


def _factors(node: Expr) -> tuple[list[Expr], list[Expr]]:
    """The factors of a product above and below the line; a named function is a factor."""
    if node.op == "div":
        (above, under), (below, over) = map(_factors, node.args)
        return above + over, under + below
    if node.op == "mul" and _word(node) is None:
        (above, under), (below, over) = map(_factors, node.args)
        return above + below, under + over
    return [node], []
