"""Units of raw logs, read by pint and converted to the units of pamid's columns.

The registry is private. Angle is a dimension, so that rad/s and 1/s are different. A mark ("barg",
"kPa(a)", "psia") distinguishes gauge and absolute pressure. An ambiguous word is refused with
advice.
"""

from __future__ import annotations

import contextlib
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import FileError, nearest
from pamid.base.units import NONE, Dimension, from_si, kindred_units, quantity_of, unit

STANDARD_ATMOSPHERE_KPA = 101.325
PRESSURE_DIMENSION = unit("Pa").dimension
_BASES = ("kilogram", "meter", "second", "ampere", "kelvin", "radian")

_DEFINITIONS = """
mega- = 1e6 = M-
kilo- = 1e3 = k-
hecto- = 1e2 = h-
deci- = 1e-1 = d-
centi- = 1e-2 = c-
milli- = 1e-3 = m-
micro- = 1e-6 = u-
nano- = 1e-9 = n-
gram = [mass] = g
meter = [length] = m = metre
second = [time] = s = sec
ampere = [current] = A = amp
kelvin = [temperature] = K
radian = [angle] = rad
one = 1
percent = 0.01 = pct
permille = 0.001
minute = 60 * second = min
hour = 3600 * second = h = hr
day = 86400 * second
hertz = 1 / second = Hz
degree = 0.017453292519943295 * radian = deg
gon = 0.015707963267948967 * radian
revolution = 6.283185307179586 * radian = rev = turn
rpm = revolution / minute = RPM
degree_Celsius = kelvin; offset: 273.15 = degC = celsius
fahrenheit_step = 5 / 9 * kelvin
degree_Fahrenheit = 5 / 9 * kelvin; offset: 255.3722222222222 = degF = fahrenheit
liter = 0.001 * meter**3 = l = L = litre
inch = 0.0254 * meter
foot = 0.3048 * meter = ft
pound = 453.59237 * gram = lb = lbs
newton = kilogram * meter / second**2 = N
kilopond = 9.80665 * newton = kp = kgf
pound_force = 4.4482216152605 * newton = lbf
pascal = newton / meter**2 = Pa
bar = 100000 * pascal
atmosphere = 101325 * pascal = atm
torr = 133.32236842105263 * pascal = Torr = mmHg
psi = 6894.757293168361 * pascal
at = 98066.5 * pascal
joule = newton * meter = J
watt = joule / second = W
volt = watt / ampere = V
ohm = volt / ampere
"""

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
#: spelling in logs=spelling of pint, in this order
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
    """Factor, offset and dimension by pint, which gets only words, single-digit exponents, `*`, `/`
    and parentheses: its parser evaluates expressions."""
    import pint

    registry, plain = _registry(), _normal(bare)
    words = [word for word in re.split(r"[\s*/()]+", plain.replace("**", "^")) if word]
    no_unit = FileError(
        f"{text!r} is not a unit.", "For example bar, kPa, deg, rad/s, N*m, 1/min.", code="unit"
    )
    if not all(_GRAMMAR.fullmatch(word.replace("^", "**")) for word in words):
        raise no_unit
    try:
        dimension = registry.Quantity(1.0, plain).dimensionality
        powers = tuple(
            int(dimension.get(base, 0))
            for base in ("[mass]", "[length]", "[time]", "[current]", "[temperature]", "[angle]")
        )
        si = "*".join(
            f"{base}**{power}" for base, power in zip(_BASES, powers, strict=True) if power
        )
        offset, step = (
            float(registry.Quantity(value, plain).to(si).magnitude) for value in (0.0, 1.0)
        )
    except pint.UndefinedUnitError as error:
        names = error.unit_names
        wrong = names if isinstance(names, str) else next(iter(names))
        hint = nearest(wrong, _names()) or "For example bar, kPa, deg, rad/s, N*m, percent."
        raise FileError(
            f"{text!r} is not a known unit: {wrong!r} is unknown.", hint, code="unit"
        ) from None
    except Exception:  # pint raises many kinds of errors on other text
        raise no_unit from None
    return SourceUnit(text, step - offset, offset, powers, pressure)


def _normal(text: str) -> str:
    """Unit symbol in pint's grammar: "Nm" is N*m, "m/s2" is m/s**2, a degree in a product is a
    difference."""
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
    if re.search(r"[\s*/]", text):
        text = re.sub(
            r"\bdeg([CF])\b", lambda m: "kelvin" if m[1] == "C" else "fahrenheit_step", text
        )
    return text or "one"


@lru_cache(maxsize=1)
def _registry() -> Any:
    import pint

    registry: Any = pint.UnitRegistry(None)
    registry.load_definitions(_DEFINITIONS.strip().splitlines())
    return registry


def _names() -> list[str]:
    """Words of the definitions, for suggestions."""
    words = [
        name.strip()
        for line in _DEFINITIONS.strip().splitlines()
        for name in re.sub(";[^=]*", "", line).split("=")
    ]
    return [*_PREFIXED.split(), *(name for name in words if re.fullmatch(r"[A-Za-z_]+", name))]
