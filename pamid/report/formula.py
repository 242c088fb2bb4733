"""Formula of an unknown effect from diagnosis.json as MathML.

formula  = [name [unit] =] sum          term   = factor ("*" factor | "/" factor | factor)*
sum      = ["+" | "-"] term (("+" | "-") term)*      factor = atom ["^" number]
atom     = number | number unit | name | name "(" sum ")" | "(" sum ")" | "|" sum "|"
"""

from __future__ import annotations

import re

from markupsafe import Markup

from pamid.report.formatting import unit_label
from pamid.report.markup import Part, tag
from pamid.report.mathml import fenced, math_html, name, number_html, operator

_DECIMAL = r"\d+\.?\d*(?:e[+-]?\d+)?"
_TOKEN = re.compile(
    rf"\s*(?:(?P<size>\({_DECIMAL} [^()\d+|^][^()|^]*\))|(?P<number>{_DECIMAL})|(?P<name>[A-Za-z]\w*)|"  # noqa: E501
    r"(?P<unit>\[[^\]]*\])|(?P<sign>[-+*/^()|=]))"
)
_DEEPEST_BRACKET = 20
_UNITY = ("number", "1")
_POWERS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


class FormulaError(ValueError):
    """The text is not a formula."""


def formula_html(text: str) -> Markup:
    """The formula set; FormulaError where it is none."""
    return _Reader(text).formula()


def formula_text(text: str) -> str:
    """The formula in a line of prose: signs apart, powers raised, a constant by itself."""
    shown = re.sub(rf"({_DECIMAL}) 1(?= [-+]|$)", r"\1", text)
    shown = re.sub(r"(?<=[^\s=]) -(?=[\d.])", " − ", shown)
    shown = re.sub(r"(?<=[^\s=]) \+(?=[\d.])", " + ", shown)
    shown = re.sub(r"\^(\d+)", lambda found: found[1].translate(_POWERS), shown)
    unit, bracket, formula = shown.rpartition("]")  # a unit may hold a sign, too
    return unit + bracket + formula.replace("-", "−")


class _Reader:
    def __init__(self, text: str) -> None:
        self._text, self._depth, self._bars, self._at = text, 0, 0, 0
        self._tokens: list[tuple[str, str]] = []
        place = 0
        while place < len(text.rstrip()):
            match = _TOKEN.match(text, place)
            if match is None:
                raise FormulaError(f"unexpected {text[place : place + 10]!r}")
            self._tokens.append((str(match.lastgroup), str(match[str(match.lastgroup)])))
            place = match.end()

    def formula(self) -> Markup:
        row: list[Markup] = []
        if [kind for kind, _ in self._tokens[:2]] == ["name", "unit"] and self._tokens[2:3] == [
            ("sign", "=")
        ]:
            unit = unit_label(self._tokens[1][1][1:-1])
            row.append(tag("mrow", name(self._tokens[0][1]), tag("mtext", f" [{unit or '-'}]")))
            row.append(operator("="))
            self._at = 3
        row.append(self._sum())
        if self._at != len(self._tokens):
            raise FormulaError(f"unexpected {self._tokens[self._at][1]!r}")
        return math_html([row], self._text)

    def _peek(self) -> tuple[str, str]:
        return self._tokens[self._at] if self._at < len(self._tokens) else ("end", "")

    def _take(self, *signs: str) -> str:
        """The next token if it is any of these signs, else ""."""
        kind, text = self._peek()
        if kind != "sign" or text not in signs:
            return ""
        self._at += 1
        return text

    def _sum(self) -> Markup:
        self._depth += 1
        if self._depth > _DEEPEST_BRACKET:
            raise FormulaError("nested too deeply")
        parts: list[Part] = []
        sign = self._take("+", "-")
        while True:
            if sign == "-" or (sign and parts):
                parts.append(
                    operator("−" if sign == "-" else "+", form="infix" if parts else "prefix")
                )
            parts.append(self._term())
            sign = self._take("+", "-")
            if not sign:
                break
        self._depth -= 1
        return tag("mrow", parts)

    def _term(self) -> Markup:
        term = self._factor()
        # a constant is written as a number times 1
        if self._at and self._tokens[self._at - 1][0] == "number" and self._peek() == _UNITY:
            self._at += 1
        while True:
            kind, text = self._peek()
            # another factor may begin without a sign between
            begins = kind in ("number", "name", "size") or text == "("
            begins = begins or (text == "|" and not self._bars)
            if self._take("/"):
                term = tag("mfrac", term, self._factor())
            elif self._take("*") or begins:
                term = tag("mrow", term, operator("⋅"), self._factor())
            else:
                return term

    def _factor(self) -> Markup:
        base = self._atom()
        if self._take("^"):
            kind, text = self._peek()
            if kind != "number":
                raise FormulaError("an exponent is a number")
            self._at += 1
            return tag("msup", base, tag("mn", text))
        return base

    def _atom(self) -> Markup:
        kind, text = self._peek()
        self._at += 1
        if kind == "number":
            return number_html(float(text), digits=4)
        if kind == "size":
            number, _, unit = text[1:-1].partition(" ")
            return number_html(float(number), unit_label(unit), digits=4)
        if kind == "name":
            return tag("mrow", name(text), self._bracketed()) if self._take("(") else name(text)
        if text == "(":
            return self._bracketed()
        if text == "|":
            self._bars += 1
            inside = self._sum()
            self._bars -= 1
            return self._closed("|", inside)
        raise FormulaError(f"unexpected {text!r}" if text else "it breaks off")

    def _bracketed(self) -> Markup:
        bars, self._bars = self._bars, 0
        inside = self._sum()
        self._bars = bars
        return self._closed("(", inside)

    def _closed(self, begin: str, inside: Markup) -> Markup:
        close = ")" if begin == "(" else "|"
        if not self._take(close):
            raise FormulaError(f"{close!r} is missing")
        return fenced(begin + close, inside)
