"""Expressions as lines of a program in C or MATLAB; every shared part is a named local."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field

from pamid.engine.symbolic.expression import Expr, symbols, walk
from pamid.engine.symbolic.operators import ATOM, CHOICE, COMPARISON, OPERATORS, SUM, Operator
from pamid.exports.step import SampleStep

Symbol = tuple[str, str]

# longest part that is written in place, without a name
_LONGEST_PART = 90


@dataclass(frozen=True)
class Dialect:
    """Differences between the target languages.

    assign, truth, choice   format strings; truth: of a comparison as a number
    element                 an element of an array (its name and index from 0)
    choice_binds            precedence of a choice
    function                name of an operator as a function, "" if it is written with its sign
    """

    assign: str
    truth: str
    unequal: str
    choice: str
    choice_binds: int
    function: Callable[[Operator], str]
    element: Callable[..., str]


C = Dialect(
    "const double {} = {};",
    "{} ? 1.0 : 0.0",
    "!=",
    "{} ? {} : {}",
    CHOICE,
    lambda o: o.c,
    lambda array, *at: f"{array}{''.join(f'[{k}]' for k in at)}",
)
MATLAB = Dialect(
    "{} = {};",
    "double({})",
    "~=",
    "choose({}, {}, {})",
    ATOM,
    lambda o: o.matlab,
    lambda array, *at: f"{array}({', '.join(str(k + 1) for k in at)})",
)


#: reserved words of the two languages and of the exported programs
_RESERVED = frozenset(
    re.findall(
        r"\w+",
        """
    auto break case char const continue default do double else enum extern float for goto if inline int long register
    restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
    function end elseif otherwise parfor persistent global try catch classdef spmd
    m s u x y p d f h n J time fresh begin past next model choose delayed state cells lines heads
    double zeros ones pi i j e eps inf nan size length mod
""",  # noqa: E501
    )
)


def identifier(name: str, occupied: Iterable[str] = ()) -> str:
    """`name` as a word of C and MATLAB that is not occupied: "dead-time:delay_s" ->
    "dead_time_delay_s"."""
    word = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")[:50] or "v"
    word = f"v{word}" if word[0].isdigit() else word
    functions = (name for o in OPERATORS.values() for name in (o.c, o.matlab))
    used = {*_RESERVED, *functions, *occupied}
    unique, n = word, 2
    while unique in used or re.fullmatch(r"k\d+", unique):  # k12 is the name of a part
        unique, n = f"{word}_{n}", n + 1
    return unique


def identifiers(names: Iterable[str]) -> list[str]:
    """A unique word for each of the names."""
    unique: list[str] = []
    for name in names:
        unique.append(identifier(name, unique))
    return unique


@dataclass
class Statements:
    """Lines that compute some expressions.

    roots: all requested expressions; words: name of every symbol.
    """

    dialect: Dialect
    roots: list[Expr]
    words: dict[Symbol, str]
    lines: list[str] = field(default_factory=list)
    # text and its precedence
    _parts: dict[Expr, tuple[str, int]] = field(default_factory=dict)
    _truths: dict[Expr, str] = field(default_factory=dict)
    _uses: Counter[Expr] = field(init=False)
    _names: dict[Expr, str] = field(default_factory=dict)
    _count: int = 0

    def __post_init__(self) -> None:
        self._uses = Counter(a for node in walk(self.roots) for a in node.args)
        self._uses.update(self.roots)

    def value(self, root: Expr) -> str:
        """Text of an expression; its prerequisites are added to the lines."""
        for node in walk([root]):
            if node not in self._parts:
                self._parts[node] = self._part(node)
        return self._parts[root][0]

    def stored(self, targets: dict[str, Expr]) -> list[str]:
        """All lines, with those that store values at their places."""
        for target, value in targets.items():
            formula = self.value(value)  # may add lines of its own before
            self.lines.append(f"{target} = {formula};")
        return self.lines

    def name(self, root: Expr, name: str) -> None:
        """Give an expression's value a name."""
        self._names.setdefault(root, name)
        text = self.value(root)
        if text != name:
            self.lines.append(self.dialect.assign.format(name, text))

    def _part(self, node: Expr) -> tuple[str, int]:
        if node.op == "const":
            return repr(node.value), (ATOM if node.value >= 0.0 else SUM)
        if node.op == "symbol":
            return self.words[node.value], ATOM
        text, level = self._written(node)
        if node not in self._names and self._uses[node] == 1 and len(text) <= _LONGEST_PART:
            return text, level
        if node not in self._names:
            self._names[node] = f"k{self._count}"
            self._count += 1
        name = self._names[node]
        self.lines.append(self.dialect.assign.format(name, text))
        self._truths[node] = f"{name} {self.dialect.unequal} 0.0"
        return name, ATOM

    def _written(self, node: Expr) -> tuple[str, int]:
        if node.op == "where":
            condition, a, b = node.args
            truth = (
                self._truths.get(condition)
                or f"{self._at(condition, SUM)} {self.dialect.unequal} 0.0"
            )
            text = self.dialect.choice.format(
                truth, self._at(a, COMPARISON), self._at(b, COMPARISON)
            )
            return text, self.dialect.choice_binds
        operator = OPERATORS[node.op]
        function = self.dialect.function(operator)
        if function:
            return f"{function}({', '.join(self._at(a, CHOICE) for a in node.args)})", ATOM
        if operator.arity == 1:
            return f"{operator.sign}{self._at(node.args[0], ATOM)}", operator.binds
        level = operator.binds
        left, right = self._at(node.args[0], level), self._at(node.args[1], level + 1)
        text = f"{left} {operator.sign} {right}"
        if not operator.is_comparison:
            return text, level
        self._truths[node] = text
        return self.dialect.truth.format(text), self.dialect.choice_binds

    def _at(self, node: Expr, level: int) -> str:
        """Text of an argument, in parentheses if its place needs a higher precedence."""
        text, precedence = self._parts[node]
        return text if precedence >= level else f"({text})"


class ModelFunctions:
    """Bodies of functions with the equations of a sample step, in which every used symbol is a
    local.

    parameters: the place of each; derived, cells: names of their arrays.
    """

    def __init__(
        self, step: SampleStep, dialect: Dialect, parameters: list[str], derived: str, cells: str
    ) -> None:
        self.step, self.dialect, self.cells = step, dialect, cells
        element, names = dialect.element, [v.name for v in step.parameters]
        places: dict[Symbol, str] = {("tick", t): t for t in ("time", "begin", "fresh")}
        places |= {("state", n): element("x", i) for i, n in enumerate(step.states)}
        places |= {("input", v.name): element("u", i) for i, v in enumerate(step.inputs)}
        places |= {("parameter", n): at for n, at in zip(names, parameters, strict=True)}
        places |= {("derived", str(i)): element(derived, i) for i in range(len(step.derived))}
        for space in ("cell", "past"):
            places |= {(space, c.name): element(cells, i) for i, c in enumerate(step.updates)}
        # a tick, or a quantity derived from the parameters, is used from its place
        named = [s for s in places if s[0] not in ("tick", "derived")]
        words = identifiers(f"past_{name}" if space == "past" else name for space, name in named)
        self.places, self.words = places, {**places, **dict(zip(named, words, strict=True))}

    def updated(self, delayed: Callable[[str, int, str, str], str]) -> list[str]:
        """Cells, in sequence. delayed: line with the value of a delay line, from the
        cell's name, the line's number, the value and the seconds."""
        cells, element = self.step.updates, self.dialect.element
        work = self._begun(
            [e for c in cells for e in (c.value, c.seconds)], {("cell", c.name) for c in cells}
        )
        for c in cells:
            word = self.words["cell", c.name]
            if c.line < 0:
                work.name(c.value, word)
                continue
            value, seconds = work.value(c.value), work.value(c.seconds)
            work.lines.append(delayed(word, c.line, value, seconds))
        for i, c in enumerate(cells):
            work.lines.append(f"{element(self.cells, i)} = {self.words['cell', c.name]};")
        return work.lines

    def stored(self, array: str, values: Iterable[Expr]) -> list[str]:
        """Lines that store values in an array."""
        targets = {self.dialect.element(array, i): value for i, value in enumerate(values)}
        return self._begun(list(targets.values())).stored(targets)

    def slopes(self) -> list[str]:
        """Rates, and their derivatives by the states."""
        element = self.dialect.element
        targets = {element("f", i): rate for i, rate in enumerate(self.step.rates)}
        targets |= {element("J", row, column): v for row, column, v in self.step.slopes}
        return self._begun(list(targets.values())).stored(targets)

    def _begun(self, roots: list[Expr], written: Collection[Symbol] = ()) -> Statements:
        """Statements with the locals that the roots use, without those that they define."""
        used = symbols(roots) - set(written)
        locals_ = [
            self.dialect.assign.format(self.words[s], place)
            for s, place in self.places.items()
            if s in used and self.words[s] != place
        ]
        return Statements(self.dialect, roots, self.words, locals_)
