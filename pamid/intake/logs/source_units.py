"""Units of raw logs: their names and spellings, in terms of the units of columns.

A mark ("barg", "kPa(a)", "psia") distinguishes gauge and absolute pressure. An ambiguous word is
refused with advice.
"""

from __future__ import annotations

import ast
import contextlib
import re
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.errors import FileError, nearest
from pamid.base.units import NONE, Dimension, from_si, kindred_units, quantity_of, unit

STANDARD_ATMOSPHERE_KPA = 101.325
PRESSURE_DIMENSION = unit("Pa").dimension

#: names of a unit in logs -> its size, as a number of a unit of columns
_NAMES: dict[str, tuple[float, str]] = {
    "gram g": (1.0, "g"),
    "pound lb lbs": (453.59237, "g"),
    "meter m metre": (1.0, "m"),
    "inch": (0.0254, "m"),
    "foot ft": (0.3048, "m"),
    "liter l L litre": (1.0, "l"),
    "second s sec": (1.0, "s"),
    "minute min": (1.0, "min"),
    "hour h hr": (1.0, "h"),
    "day": (24.0, "h"),
    "hertz Hz": (1.0, "Hz"),
    "ampere A amp": (1.0, "A"),
    "kelvin K": (1.0, "K"),
    "degree_Celsius degC celsius": (1.0, "degC"),
    "degree_Fahrenheit degF fahrenheit": (1.0, "degF"),
    "radian rad": (1.0, "rad"),
    "degree deg": (1.0, "deg"),
    "gon": (0.9, "deg"),
    "revolution rev turn": (360.0, "deg"),
    "rpm RPM": (1.0, "rpm"),
    "one": (1.0, NONE),
    "percent pct": (1.0, "percent"),
    "permille": (0.1, "percent"),
    "newton N": (1.0, "N"),
    "kilopond kp kgf": (9.80665, "N"),
    "pound_force lbf": (4.4482216152605, "N"),
    "pascal Pa": (1.0, "Pa"),
    "bar": (1.0, "bar"),
    "atmosphere atm": (101325.0, "Pa"),
    "torr Torr mmHg": (133.32236842105263, "Pa"),
    "psi": (6894.757293168361, "Pa"),
    "at": (98066.5, "Pa"),
    "joule J": (1.0, "J"),
    "watt W": (1.0, "W"),
    "volt V": (1.0, "V"),
    "ohm": (1.0, "Ohm"),
}
_SIZES = {name: size for names, size in _NAMES.items() for name in names.split()}
_PREFIXES = {
    "": 1.0,
    **dict.fromkeys(("mega", "M"), 1e6),
    **dict.fromkeys(("kilo", "k"), 1e3),
    **dict.fromkeys(("hecto", "h"), 1e2),
    **dict.fromkeys(("deci", "d"), 1e-1),
    **dict.fromkeys(("centi", "c"), 1e-2),
    **dict.fromkeys(("milli", "m"), 1e-3),
    **dict.fromkeys(("micro", "u"), 1e-6),
    **dict.fromkeys(("nano", "n"), 1e-9),
}

_COUNTS = (
    "count counts cnt cnts tick ticks inc incs increments lsb digits digit raw bits adc pulses"
)
#: words that are not units or are ambiguous, with the remedy
_ADVICE = {
    **dict.fromkeys(
        _COUNTS.split(),
        "A count has no fixed size. Give scale, the column's unit per count; for an encoder with "
        "4-fold evaluation that is 360 / (4 * lines) degrees.",
    ),
    "grad": "It is a degree in some languages and 1/400 turn in others. Write deg or gon.",
    "in": "Write inch.",
    "''": "Write inch.",
    "c": "Write degC.",
    "f": "Write degF.",
}
#: spelling in logs=spelling here, in this order
_SPELLINGS = (
    "VDC=V VAC=V °C=degC ℃=degC °F=degF °=deg µ=u μ=u Ω=ohm ²=2 ³=3 ⁻=- ¹=1 ·=* ⋅=* ×=* %=percent "
    "U/min=rpm ^=**"
)
_PREFIXED = "kPa MPa hPa mbar ms us mm cm kg mrad kN mV mA"
_MARK = re.compile(
    r"(?P<unit>.*?[a-z2])[ _]?\(?(?:(?P<gauge>g|gauge|rel\.?|ü)|(?P<absolute>a|abs\.?|absolute?))\)?",  # noqa: E501
    re.IGNORECASE,
)
_GRAMMAR = re.compile(r"(?:[A-Za-z_]+|1)(?:\*\*-?[1-9])?")


@dataclass(frozen=True)
class SourceUnit:
    """A unit of a log: SI value = value * factor + offset. `pressure` is "gauge" or "absolute" if
    the unit states it, otherwise ""."""

    text: str
    factor: float
    offset: float
    dimension: Dimension  # exponents of kg, m, s, A, K, rad
    pressure: str = ""


@lru_cache(maxsize=256)
def read_unit(text: str) -> SourceUnit:
    """Unit from a text: "bar", "°C", "N·m", "kPa(a)", "U/min", "m/s^2"; "" and "1" mean none.

    Raises FileError (code "unit") if it cannot be read, with advice for common words.
    """
    bare = text.strip().strip("[]").strip()
    if bare.casefold() in _ADVICE:
        raise FileError(
            f"{bare!r} is not accepted as a unit.", _ADVICE[bare.casefold()], code="unit"
        )
    match = _MARK.fullmatch(bare)
    if match is not None:  # before the products: "bar(g)" is not bar times gram
        with contextlib.suppress(FileError):
            marked = _measured(
                text, match["unit"].strip(), "gauge" if match["gauge"] else "absolute"
            )
            if marked.dimension == PRESSURE_DIMENSION:
                return marked
    return _measured(text, bare, "")


def is_readable(text: str) -> bool:
    """Whether `read_unit` accepts this text."""
    try:
        read_unit(text)
    except FileError:
        return False
    return True


def in_unit(values: Array, source: SourceUnit, symbol: str, atmosphere_pa: float = 0.0) -> Array:
    """Convert values from the source's unit to pamid's unit `symbol`, and subtract atmosphere_pa
    (Pa).

    Raises FileError (code "unit") if the two measure different quantities.
    """
    require_same_quantity(source, symbol)
    target = unit(symbol)
    if source.factor == target.factor and source.offset == target.offset and not atmosphere_pa:
        return values
    return np.asarray(
        from_si(values * source.factor + (source.offset - atmosphere_pa), symbol), dtype=np.float64
    )


def require_same_quantity(source: SourceUnit, symbol: str) -> None:
    """Raise FileError (code "unit") if the source's unit and pamid's `symbol` measure different
    quantities."""
    if source.dimension == unit(symbol).dimension:
        return
    if (
        source.dimension == unit("1/s").dimension
        and unit(symbol).dimension == unit("rad/s").dimension
    ):
        hint = "For turns per minute write rpm, for turns per second rev/s."
    elif source.text.strip() in ("", NONE):
        hint = f"Give the unit of the source, as {', '.join((symbol, *kindred_units(symbol)[:3]))}."
    elif source.dimension == unit(NONE).dimension:
        hint = f"Give scale, {symbol} per {source.text}, in place of unit; for example scale = 15."
    elif symbol == NONE:
        hint = (
            "Add the unit to the name of the signal, as in [signals.temperature_degc]. For a "
            "sensor's raw signal give scale (column's unit per unit of the source) and no unit."
        )
    else:
        hint = (
            "If it is a sensor's raw signal, give scale (column's unit per unit of the source) "
            "and offset instead."
        )
    raise FileError(
        f"{source.text!r} is not a unit of the quantity of {symbol!r} ({quantity_of(symbol)}).",
        hint,
        code="unit",
    )


def _measured(text: str, bare: str, pressure: str) -> SourceUnit:
    """The unit of a product: names, single-digit exponents, `*`, `/` and parentheses."""
    plain = _normal(bare)
    words = [word for word in re.split(r"[\s*/()]+", plain.replace("**", "^")) if word]
    no_unit = FileError(
        f"{text!r} is not a unit.", "For example bar, kPa, deg, rad/s, N*m, 1/min.", code="unit"
    )
    if not all(_GRAMMAR.fullmatch(word.replace("^", "**")) for word in words):
        raise no_unit
    plain = re.sub(r"(?<=\w)\s+(?=\w)|(?<=[\w)])\s*(?=\()|(?<=\))\s*(?=\w)", "*", plain)
    # a name may be a keyword of Python, such as "as"
    source = re.sub(r"[A-Za-z_]+", r"_\g<0>", plain.strip())
    try:
        tree = ast.parse(source, mode="eval").body
        factor, dimension = _size(tree)
        # in a product a degree is a difference
        offset = unit(_named(tree.id[1:])[1]).offset if isinstance(tree, ast.Name) else 0.0
    except LookupError as error:
        wrong = error.args[0]
        hint = nearest(wrong, _names()) or "For example bar, kPa, deg, rad/s, N*m, percent."
        raise FileError(
            f"{text!r} is not a known unit: {wrong!r} is unknown.", hint, code="unit"
        ) from None
    except (SyntaxError, ValueError, ArithmeticError, RecursionError, MemoryError):
        raise no_unit from None
    return SourceUnit(text, factor, offset, tuple(dimension.tolist()), pressure)


def _size(node: ast.expr) -> tuple[float, NDArray[np.int64]]:
    """SI size and dimension of a product. LookupError for an unknown name, ValueError for what is
    not a product."""
    match node:
        case ast.Constant():  # 1
            return 1.0, np.zeros(len(PRESSURE_DIMENSION), np.int64)
        case ast.Name():
            count, symbol = _named(node.id[1:])
            return count * unit(symbol).factor, np.array(unit(symbol).dimension)
        case ast.BinOp(op=ast.Pow()):
            size, dimension = _size(node.left)
            power = int(ast.literal_eval(node.right))
            return size**power, power * dimension
        case ast.BinOp(op=ast.Mult() | ast.Div()):
            (size, dimension), (other_size, other) = _size(node.left), _size(node.right)
            if isinstance(node.op, ast.Mult):
                return size * other_size, dimension + other
            return size / other_size, dimension - other
    raise ValueError("this is no product")


def _named(word: str) -> tuple[float, str]:
    """Size of a name that may have a prefix or a plural s; LookupError where there is none."""
    for prefix, scale in _PREFIXES.items():
        for suffix in ("", "s"):
            name = word.removeprefix(prefix).removesuffix(suffix)
            if word != prefix + name + suffix or (suffix and len(name) == 1):
                continue
            if name in _SIZES:
                count, symbol = _SIZES[name]
                if prefix and unit(symbol).offset:
                    raise ValueError(f"{symbol} takes no prefix")
                return scale * count, symbol
    raise LookupError(word)


def _normal(text: str) -> str:
    """Unit symbol as Python writes a product: "Nm" is N*m, "m/s2" is m/s**2."""
    for spelling in _SPELLINGS.split():
        written, meant = spelling.split("=")
        text = text.replace(written, meant)
    words = frozenset(_names())
    for word in re.findall(r"\b[A-Z][a-z]{3,}\b", text):
        small = word.lower()  # only that may be a unit: "Volts"
        if word not in words and words & {small, small.removesuffix("s")}:
            text = re.sub(rf"\b{word}\b", small, text)
    text = re.sub(r"\b(k|m|c)?N([cm]?m)\b", r"\1N*\2", text)
    text = re.sub(r"([A-Za-z])(-?[1-9])\b", r"\1**\2", text)
    return text or "one"


def _names() -> list[str]:
    """Names of units, for suggestions."""
    return [*_PREFIXED.split(), *_SIZES]
