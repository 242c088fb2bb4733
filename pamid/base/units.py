"""Units: the suffixes of column and parameter names, and their conversion to SI.

A name ends in its unit: `angle_deg`, `pressure_1_kpa`, `inertia_kg_m2`, `kd_s_per_deg`. A symbol is
the same unit as people write it: "deg", "kPa", "kg m2", "s/deg". Grammar of a symbol: factors
separated by a space, `*` or a dot, a digit after a factor is its exponent, with or without `^`, `/`
before what divides ("N s/m/A" is "N s/(m A)"), parentheses around a denominator of several factors.
Factors may be run together where a single reading makes sense: "Nm" is "N m", "Nms/rad" is "N m
s/rad". An angle counts as a separate dimension here, so that "rad/s" and "Hz", or "N m" and "N
m/rad", are never taken for each other.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from pamid.base.errors import FileError, nearest

Dimension = tuple[int, ...]  # exponents of kg, m, s, A, K, rad
Factors = list[tuple[str, int]]  # units with their exponents

NONE = "1"
_DIMENSIONLESS: Dimension = (0, 0, 0, 0, 0, 0)

#: symbol -> (factor to SI, offset to SI, exponents of kg m s A K rad)
_ATOMS: dict[str, tuple[float, float, Dimension]] = {
    "kg": (1.0, 0.0, (1, 0, 0, 0, 0, 0)),
    "g": (1e-3, 0.0, (1, 0, 0, 0, 0, 0)),
    "m": (1.0, 0.0, (0, 1, 0, 0, 0, 0)),
    "cm": (1e-2, 0.0, (0, 1, 0, 0, 0, 0)),
    "mm": (1e-3, 0.0, (0, 1, 0, 0, 0, 0)),
    "um": (1e-6, 0.0, (0, 1, 0, 0, 0, 0)),
    "l": (1e-3, 0.0, (0, 3, 0, 0, 0, 0)),
    "ml": (1e-6, 0.0, (0, 3, 0, 0, 0, 0)),
    "s": (1.0, 0.0, (0, 0, 1, 0, 0, 0)),
    "ms": (1e-3, 0.0, (0, 0, 1, 0, 0, 0)),
    "us": (1e-6, 0.0, (0, 0, 1, 0, 0, 0)),
    "min": (60.0, 0.0, (0, 0, 1, 0, 0, 0)),
    "h": (3600.0, 0.0, (0, 0, 1, 0, 0, 0)),
    "Hz": (1.0, 0.0, (0, 0, -1, 0, 0, 0)),
    "kHz": (1e3, 0.0, (0, 0, -1, 0, 0, 0)),
    "rad": (1.0, 0.0, (0, 0, 0, 0, 0, 1)),
    "mrad": (1e-3, 0.0, (0, 0, 0, 0, 0, 1)),
    "deg": (0.017453292519943295, 0.0, (0, 0, 0, 0, 0, 1)),
    "rpm": (0.10471975511965977, 0.0, (0, 0, -1, 0, 0, 1)),  # 2 pi / 60
    "N": (1.0, 0.0, (1, 1, -2, 0, 0, 0)),
    "mN": (1e-3, 0.0, (1, 1, -2, 0, 0, 0)),
    "kN": (1e3, 0.0, (1, 1, -2, 0, 0, 0)),
    "Pa": (1.0, 0.0, (1, -1, -2, 0, 0, 0)),
    "kPa": (1e3, 0.0, (1, -1, -2, 0, 0, 0)),
    "hPa": (1e2, 0.0, (1, -1, -2, 0, 0, 0)),
    "MPa": (1e6, 0.0, (1, -1, -2, 0, 0, 0)),
    "mbar": (1e2, 0.0, (1, -1, -2, 0, 0, 0)),
    "bar": (1e5, 0.0, (1, -1, -2, 0, 0, 0)),
    "J": (1.0, 0.0, (1, 2, -2, 0, 0, 0)),
    "kJ": (1e3, 0.0, (1, 2, -2, 0, 0, 0)),
    "W": (1.0, 0.0, (1, 2, -3, 0, 0, 0)),
    "kW": (1e3, 0.0, (1, 2, -3, 0, 0, 0)),
    "A": (1.0, 0.0, (0, 0, 0, 1, 0, 0)),
    "mA": (1e-3, 0.0, (0, 0, 0, 1, 0, 0)),
    "V": (1.0, 0.0, (1, 2, -3, -1, 0, 0)),
    "mV": (1e-3, 0.0, (1, 2, -3, -1, 0, 0)),
    "kV": (1e3, 0.0, (1, 2, -3, -1, 0, 0)),
    "Ohm": (1.0, 0.0, (1, 2, -3, -2, 0, 0)),
    "K": (1.0, 0.0, (0, 0, 0, 0, 1, 0)),
    "degC": (1.0, 273.15, (0, 0, 0, 0, 1, 0)),
    "degF": (1.0 / 1.8, 273.15 - 32.0 / 1.8, (0, 0, 0, 0, 1, 0)),
    "percent": (1e-2, 0.0, _DIMENSIONLESS),
}
_BY_TOKEN: dict[str, str] = {symbol.lower(): symbol for symbol in _ATOMS} | {"pct": "percent"}

#: SI symbol -> quantity; the first entry of a dimension is its canonical SI symbol
_QUANTITIES: tuple[tuple[str, str], ...] = (
    (NONE, "dimensionless"),
    ("s", "time"),
    ("Hz", "frequency"),
    ("m", "position"),
    ("m2", "area"),
    ("m3", "volume"),
    ("m/s", "velocity"),
    ("m/s2", "acceleration"),
    ("m3/s", "flow"),
    ("rad", "angle"),
    ("rad/s", "angular velocity"),
    ("rad/s2", "angular acceleration"),
    ("N", "force"),
    ("N m", "torque"),
    ("Pa", "pressure"),
    ("Pa/s", "pressure rate"),
    ("kg", "mass"),
    ("kg/s", "mass flow"),
    ("kg m2", "moment of inertia"),
    ("V", "voltage"),
    ("A", "current"),
    ("Ohm", "resistance"),
    ("K", "temperature"),
    ("W", "power"),
    ("N/m", "stiffness"),
    ("N m/rad", "rotational stiffness"),
    ("N s/m", "damping"),
    ("N m s/rad", "rotational damping"),
    ("m3/(s Pa)", "sonic conductance"),
)
_RARE = ("us", "ms", "um")  # parts of products in which nobody measures
_DISPLAY = {"rad": "deg", "rad/s": "deg/s", "rad/s2": "deg/s2", "Pa": "kPa", "Pa/s": "kPa/s"}
_NO_BRACKETS = str.maketrans("()", "  ")
_FACTOR = re.compile(r"([A-Za-z]+|1)(?:\^?(\d+)|\^-(\d+))?")
_OTHER_SPELLINGS = {
    "**": "^",
    "·": " ",
    "⋅": " ",
    "×": " ",
    "⁻": "^-",
    "¹": "1",
    "²": "2",
    "³": "3",
    "°C": "degC",
    "°F": "degF",
    "°": "deg",
    "Ω": "Ohm",
    "µ": "u",
    "μ": "u",
    "%": "percent",
}


@dataclass(frozen=True)
class Unit:
    """A unit: SI value = value * factor + offset. `dimension` holds the exponents of kg, m, s, A,
    K, rad."""

    symbol: str
    suffix: str
    factor: float
    offset: float
    quantity: str
    dimension: Dimension


@lru_cache(maxsize=1024)
def unit(symbol: str) -> Unit:
    """The unit written as `symbol`, e.g. "kPa", "N m/rad", "m3/(s Pa)"; "" and "1" mean none.
    FileError if unknown."""
    text = " ".join(symbol.split()) or NONE
    above, below = _split_fraction(text)
    words = [word for word in re.split(r"[\s/()]+", text) if word and word != NONE]
    if not all(word.rstrip("0123456789") in _ATOMS for word in words):
        text = _join_symbol(above, below)  # as pamid writes it
    factor, offset = 1.0, 0.0
    for sign, part in ((1, above), (-1, below)):
        for atom, exponent in part:
            scale, shift, _ = _ATOMS[atom]
            factor *= scale ** (sign * exponent)
            offset += shift
    if offset and len(above) + len(below) > 1:
        offset = 0.0  # in a product a degree Celsius is a difference of temperature
    dimension = _dimension([*above, *((atom, -n) for atom, n in below)])
    known = dict(_QUANTITIES)
    alike = (name for symbol, name in _QUANTITIES if _dimension_of(symbol) == dimension)
    quantity = known.get(text) or next(alike, text)
    suffix = _join_symbol(above, below).lower().translate(_NO_BRACKETS).replace("/", " per ")
    suffix = "_".join(suffix.removeprefix(NONE).split())
    return Unit(text, suffix, factor, offset, quantity, dimension)


def is_unit(symbol: str) -> bool:
    """True if `symbol` can be read as a unit."""
    try:
        unit(symbol)
    except FileError:
        return False
    return True


@lru_cache(maxsize=1 << 15)
def split_column(name: str) -> tuple[str, str]:
    """Split a name into what it is and its unit symbol: "angle_deg" -> ("angle", "deg"), "command"
    -> ("command", "1").

    The longest ending that reads as a unit counts ("inertia_kg_m2" -> "kg m2", "kd_s_per_deg" ->
    "s/deg", "torque_nm" -> "N m"); a name without such an ending is kept whole and has no unit.
    """
    words = name.split("_")
    for first in range(1, len(words)):
        symbol = _read_suffix([word.lower() for word in words[first:]])
        if symbol and any(words[:first]):
            return "_".join(words[:first]), symbol
    return name, NONE


def suffix_of(symbol: str) -> str:
    """The name ending of a unit: "N m/rad" -> "n_m_per_rad", "1/deg" -> "per_deg"; "" for none."""
    return unit(symbol).suffix


def with_unit(stem: str, symbol: str) -> str:
    """The full name of a signal or parameter: ("angle", "deg") -> "angle_deg"; without unit the
    stem itself."""
    suffix = suffix_of(symbol)
    return f"{stem}_{suffix}" if suffix else stem


def named_with(name: str, symbol: str) -> str:
    """The name with this unit at its end, written once: ("mass", "kg") and ("mass_kg", "kg") are
    both "mass_kg"."""
    written = split_column(name)[1]
    if NONE in (written, symbol or NONE) or not _same_size(written, symbol):
        return with_unit(name, symbol)
    return name


def si_symbol(symbol: str) -> str:
    """The SI unit of the same quantity, "bar" -> "Pa", "cm2" -> "m2"; "" where it has no name."""
    si = unit(symbol)
    if si.dimension == _DIMENSIONLESS:
        return ""
    names = (known for known, _ in _QUANTITIES if _dimension_of(known) == si.dimension)
    return next(names, symbol if si.factor == 1.0 and not si.offset else "")


def _same_size(symbol_a: str, symbol_b: str) -> bool:
    a, b = unit(symbol_a), unit(symbol_b)
    close = abs(a.factor - b.factor) <= 1e-12 * abs(b.factor)
    return a.dimension == b.dimension and close and a.offset == b.offset


def divided_name(name: str) -> str:
    """Probable intended name for a name that multiplies by time: "speed_m_s" means metre seconds,
    and "speed_m_per_s" was meant; "" where that is no quantity either."""
    stem, written = split_column(name)
    above, below = _split_fraction(written)
    moved = [(atom, n) for atom, n in above if unit(atom).dimension == unit("s").dimension]
    factors = [factor for factor in above if factor not in moved]
    if below or not moved or not factors:
        return ""
    meant = _join_symbol(factors, moved)
    named, unnamed = (
        any(_dimension_of(known) == unit(symbol).dimension for known, _ in _QUANTITIES)
        for symbol in (meant, written)
    )
    return with_unit(stem, meant) if named and not unnamed else ""


def check_named_unit(name: str, symbol: str) -> None:
    """FileError where a parameter's name ends in a unit and `symbol`, stated in addition,
    differs."""
    stem, written = split_column(name)
    if written == NONE or _same_size(written, symbol or NONE):
        return
    raise FileError(
        f"parameter {name!r} ends in {written!r}, but its unit is stated as {symbol or 'none'!r}",
        f"Drop unit={symbol!r}, which is in the name already, or call it "
        f"{with_unit(stem, symbol)!r} or {stem!r}.",
        code="unit",
    )


def to_si(value: Any, symbol: str) -> Any:
    """Convert a number or array from `symbol` to SI (radians, pascals, metres, kelvin ...)."""
    kind = unit(symbol)
    if kind.factor == 1.0 and kind.offset == 0.0:
        return value
    return value * kind.factor + kind.offset if kind.offset else value * kind.factor


def from_si(value: Any, symbol: str) -> Any:
    """Convert a number or array from SI to `symbol`."""
    kind = unit(symbol)
    if kind.factor == 1.0 and kind.offset == 0.0:
        return value
    return (value - kind.offset) / kind.factor if kind.offset else value / kind.factor


def as_column(name: str, value: float) -> float:
    """An SI value in the unit of the column `name`: ("angle_deg", pi) -> 180."""
    return float(from_si(float(value), split_column(name)[1]))


def size_to_si(value: Any, symbol: str) -> Any:
    """Convert a difference, an error or a spread to SI: where a scale has its zero does not count
    (1 degC is 1 K)."""
    return value * unit(symbol).factor


# least duration (s) of each unit, with the factor from seconds; 0 has no unit
_DURATIONS = (
    (3e4, 1.0 / 3600.0, "h"),
    (1.0, 1.0, "s"),
    (1e-3, 1e3, "ms"),
    (1e-300, 1e6, "us"),
    (0.0, 1.0, "s"),
)


def size_from_si(value: Any, symbol: str) -> Any:
    """Convert a difference, an error or a spread from SI to `symbol`."""
    return value / unit(symbol).factor


def column_size(name: str, value: float) -> float:
    """An SI error or spread in the unit of the column `name`: ("temperature_degc", 2.0) -> 2."""
    return float(size_from_si(float(value), split_column(name)[1]))


def duration_text(seconds: float, digits: int = 3) -> str:
    """A duration or delay in the unit that fits it: 0.0032 -> "3.2 ms", 160.0 -> "160 s"."""
    size = abs(seconds)
    factor, symbol = next((f, u) for least, f, u in _DURATIONS if size >= least)
    return f"{seconds * factor:.{digits}g} {symbol}"


def compatible(symbol_a: str, symbol_b: str) -> bool:
    """True if values in the first unit can be converted to the other."""
    return unit(symbol_a).dimension == unit(symbol_b).dimension


def quantity_of(symbol: str) -> str:
    """Quantity of a unit: "N m" -> "torque"; a unit without a quantity gives its symbol."""
    return unit(symbol).quantity


def quotient(symbol: str, *below: str) -> str:
    """The symbol of a unit divided by others: ("N", "m/s") -> "N s/m", ("Pa/s", "Pa") ->
    "1/s", ("degC", "s") -> "K/s", for a degree in a quotient is a difference."""
    powers: dict[str, int] = {}
    for sign, text in ((1, symbol), *((-1, other) for other in below)):
        above, under = _split_fraction(text or NONE)
        for way, part in ((sign, above), (-sign, under)):
            for atom, exponent in part:
                plain = "K" if atom == "degC" else atom
                powers[plain] = powers.get(plain, 0) + way * exponent
    return _join_symbol(
        [(a, n) for a, n in powers.items() if n > 0], [(a, -n) for a, n in powers.items() if n < 0]
    )


def display_unit(symbol: str) -> str:
    """The unit people read: "rad" -> "deg", "Pa" -> "kPa"; every other unit as it is."""
    return _DISPLAY.get(symbol, symbol)


def unit_label(symbol: str) -> str:
    """The symbol as it is shown, "" of a plain number."""
    return "" if symbol == NONE else symbol


def known_symbols() -> tuple[str, ...]:
    """Every unit that products, powers and quotients are made of: "kg", "mm", "rpm" ..."""
    return tuple(_ATOMS)


def suffixes_for(symbol: str) -> tuple[str, ...]:
    """The single-word suffixes a column of the same quantity may carry: "deg" -> ("deg", "mrad",
    "rad")."""
    words = (atom.lower() for atom in _ATOMS if compatible(atom, symbol))
    return tuple(sorted(word for word in words if _read_suffix([word])))


@lru_cache(maxsize=256)
def kindred_units(symbol: str) -> tuple[str, ...]:
    """Other units of the same quantity: "deg/s" -> ("rpm", "rad/s", "mrad/s" ...), by exchanging
    a factor for another of its kind; none of the same size twice."""
    here = unit(symbol)
    above, below = _split_fraction(symbol or NONE)
    names = [atom for atom in (*_ATOMS, NONE) if compatible(atom, symbol)]
    for k, (old, power) in enumerate([*above, *below]):
        for atom in _ATOMS:
            if atom not in (old, *_RARE) and compatible(atom, old):
                factors = [*above, *below]
                factors[k] = (atom, power)
                names.append(_join_symbol(factors[: len(above)], factors[len(above) :]))
    symbols: dict[tuple[float, float], str] = {(here.factor, here.offset): symbol}
    for name in names:
        symbols.setdefault((unit(name).factor, unit(name).offset), name)
    return tuple(symbols.values())[1:]


@lru_cache(maxsize=64)
def _dimension_of(symbol: str) -> Dimension:
    above, below = _split_fraction(symbol)
    return _dimension([*above, *((atom, -n) for atom, n in below)])


def _dimension(factors: Factors) -> Dimension:
    powers = ([n * exponent for exponent in _ATOMS[atom][2]] for atom, n in factors)
    return tuple(map(sum, zip(_DIMENSIONLESS, *powers, strict=True)))


def _split_fraction(text: str) -> tuple[Factors, Factors]:
    """Factors above and below the line, with their exponents."""
    for spelling, plain in _OTHER_SPELLINGS.items():
        text = text.replace(spelling, plain)
    text = re.sub(r"/\s*\(([^()/]+)/([^()/]+)\)", r" \2/\1", text)  # N m/(rad/s)
    above, *rest = text.split("/")
    parts = [(1, above)]
    for below in rest:
        below = below.strip()
        if below.startswith("(") and below.endswith(")"):
            below = below[1:-1]
        parts.append((-1, below))
    # every factor as it is written, with 1 above the line and -1 below it
    written = [(way, w) for way, part in parts for w in part.replace("*", " ").split() or [""]]
    readings = [[(way, _factors(word, text)) for way, word in written]]
    for k, (way, options) in enumerate(readings[0]):
        if len(options) > 1:  # run together: every way to take it apart
            readings = [
                [*r[:k], (way, [option]), *r[k + 1 :]] for r in readings for option in options
            ]
    spelled = [[(way, factor[0]) for way, factor in reading] for reading in readings]

    def rank(reading: list[tuple[int, Factors]]) -> tuple[bool, bool, int]:
        dimension = _dimension([(atom, way * n) for way, part in reading for atom, n in part])
        known = any(dimension == _dimension_of(symbol) for symbol, _ in _QUANTITIES)
        torque = any([a for a, _ in part[:2]] == ["N", "m"] for _, part in reading)
        return not known, not torque, sum(len(part) for _, part in reading)

    # that of a known quantity, else that with a torque in it, else that of the fewest units
    factors = spelled[0] if len(spelled) == 1 else min(spelled, key=rank)
    signed = [(atom, way * power) for way, part in factors for atom, power in part]
    return [(a, n) for a, n in signed if n > 0], [(a, -n) for a, n in signed if n < 0]


def _factors(word: str, text: str) -> list[Factors]:
    """The ways to read a word as factors; FileError where there is none."""
    match = _FACTOR.fullmatch(word)
    letters = match.group(1) if match else ""
    if word == NONE:
        return [[]]
    # units of different quantities run together, or a unit that stays whole; the first is named
    # after a person, or a mass: "hmm" is no product
    options = [
        atoms
        for atoms in ([[letters]] if letters in _ATOMS else _splits(letters))
        if len({_ATOMS[atom][2] for atom in atoms}) == len(atoms)
        and (len(atoms) == 1 or any(c.isupper() for c in atoms[0]) or atoms[0] in ("kg", "g"))
    ]
    if match is None or not options:
        hint = nearest(letters or word, _ATOMS) or "Known units: " + ", ".join(_ATOMS) + "."
        raise FileError(f"{text!r} is not a unit: {word!r} is unknown.", hint, code="unit")
    power = int(match.group(2) or 1) if not match.group(3) else -int(match.group(3))
    return [[*((atom, 1) for atom in atoms[:-1]), (atoms[-1], power)] for atoms in options]


def _splits(letters: str) -> list[list[str]]:
    """Every way to cut letters into units."""
    whole = [[letters]] if letters in _ATOMS else []
    cuts = [k for k in range(1, len(letters)) if letters[:k] in _ATOMS]
    return whole + [[letters[:k], *rest] for k in cuts for rest in _splits(letters[k:])]


def _read_suffix(words: list[str]) -> str:
    """The symbol spelt by the words of a suffix, or "" when they are no unit.

    What follows a `per` divides, however many there are: "mm_per_s_per_v" is mm/(s V).
    """
    groups: list[list[str]] = [[]]
    for word in words:
        if word == "per":
            groups.append([])
        else:
            groups[-1].append(word)
    if not all(groups[1:]):
        return ""
    above = _read_words(groups[0])
    below = _read_words([word for group in groups[1:] for word in group], divides=True)
    if above is None or below is None:
        return ""
    if above and len(groups) > 2:  # "m_per_s_per_s" divides twice by the same
        below = [(atom, sum(n for a, n in below if a == atom)) for atom in dict(below)]
    # "mass_g_kg" is a mass called g in kg, not a product of two masses
    kinds = [_ATOMS[atom][2] for atom, _ in above + below]
    if len(set(kinds)) < len(kinds):
        return ""
    return _join_symbol(above, below)


def _read_words(words: list[str], *, divides: bool = False) -> Factors | None:
    factors: Factors = []
    for word in words:
        match = _FACTOR.fullmatch(word)
        if word == "nm":
            factors += [("N", 1), ("m", 1)]
        # a name may end in an h, and kv is a velocity gain; a rate has "per_h"
        elif (
            match is None
            or match.group(1) not in _BY_TOKEN
            or (word in ("h", "kv") and not divides)
        ):
            return None
        else:
            factors.append((_BY_TOKEN[match.group(1)], int(match.group(2) or 1)))
    return factors


def _join_symbol(above: Factors, below: Factors) -> str:
    top = " ".join(f"{atom}{power if power > 1 else ''}" for atom, power in above) or NONE
    bottom = " ".join(f"{atom}{power if power > 1 else ''}" for atom, power in below)
    if not bottom:
        return top
    return f"{top}/({bottom})" if len(below) > 1 else f"{top}/{bottom}"
