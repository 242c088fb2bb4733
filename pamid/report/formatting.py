"""Names, numbers and units as people read them; the same on page, figures and terminal."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from pamid.base.errors import join_words
from pamid.base.schemas.estimates import Estimate
from pamid.base.share_words import percent_text
from pamid.base.units import NONE, split_column

#: names of people and letters that a hyphenated effect name has lost
_PROPER = {
    "coulomb": "Coulomb",
    "stribeck": "Stribeck",
    "lugre": "LuGre",
    "maxwell": "Maxwell",
    "bouc wen": "Bouc-Wen",
    "prandtl ishlinskii": "Prandtl-Ishlinskii",
    "dahl": "Dahl",
    "pwm": "PWM",
    "aprbs": "APRBS",
}
_SUPERSCRIPTS = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]+")
_POWER = re.compile(r"(?<=[A-Za-z])\d")
_PREFIXED = ("m", "s", "V", "A")  # units that are written in thousandths or millionths
_MILLI, _MICRO = 0.1, 1e-4
MINUS, DASH, SPACE = "\u2212", "\u2013", "\u00a0"
INTERVAL = f"95{SPACE}% interval"


def clean(text: str) -> str:
    """A line without control characters or direction marks, fit for anywhere on a page."""
    return " ".join(_CONTROL.sub(" ", text).split())


def effect_label(name: str) -> str:
    """ "coulomb-friction@joint_2" -> "Coulomb friction at joint 2"; "play@a + play@b" -> "play at a
    and b"."""
    several = [part.partition("@") for part in clean(name).split(" + ")]
    if len(several) > 1 and len({stem for stem, _, _ in several}) == 1:
        return effect_label(f"{several[0][0]}@{join_words(port for _, _, port in several)}")
    if len(several) > 1:
        return " + ".join(effect_label("".join(item)) for item in several)
    stem, _, port = several[0]
    words = stem.replace("-", " ").replace("_", " ")
    for plain, proper in _PROPER.items():
        words = re.sub(rf"\b{plain}\b", proper, words)
    return f"{words} at {port.replace('_', ' ')}" if port else words


def port_label(name: str) -> str:
    """ "joint_2" -> "joint 2"."""
    return clean(name).replace("_", " ")


def channel_label(name: str) -> str:
    """ "pressure_1_kpa" -> "pressure 1"."""
    return clean(split_column(name)[0]).replace("_", " ")


def channel_unit(name: str) -> str:
    """ "pressure_1_kpa" -> "kPa"; "" without unit."""
    return unit_label(split_column(name)[1])


def unit_label(symbol: str) -> str:
    """ "kg m2" -> "kg m²"; "" if there is no unit."""
    symbol = clean(symbol)
    if symbol in ("", NONE):
        return ""
    return _POWER.sub(lambda power: power.group().translate(_SUPERSCRIPTS), symbol)


def axis_label(what: str, unit_text: str) -> str:
    """ "angle", "deg" -> "angle [deg]"; a quantity without unit gets "[-]"."""
    return f"{what} [{unit_text or '-'}]"


def number(value: float | None, digits: int = 3) -> str:
    """`digits` significant digits, powers of ten where the number is very small or large; a dash
    for None."""
    if value is None:
        return DASH
    if not math.isfinite(value):
        return "?"
    if value == 0.0:
        return "0"
    mantissa, _, power = f"{value:.{digits - 1}e}".partition("e")
    exponent = int(power)
    if -4 <= exponent < 6:
        text = f"{value:.{max(digits - 1 - exponent, 0)}f}"
        return text.replace("-", MINUS)
    return f"{mantissa.replace('-', MINUS)}{SPACE}×{SPACE}10{superscript(exponent)}"


def superscript(exponent: int) -> str:
    """-8 -> "⁻⁸"."""
    return str(exponent).translate(_SUPERSCRIPTS)


def short(value: float | None, digits: int = 3) -> str:
    """As `number`, without zeros at the end: for sentences and bars, which align nothing."""
    text = number(value, digits)
    head, times, power = text.partition(f"{SPACE}×")
    return (head.rstrip("0").rstrip(".") if "." in head else head) + times + power


def with_unit_text(value: float | None, unit_text: str, digits: int = 3) -> str:
    """ "0.52 deg"; a length, time, voltage or current that is small in its thousandths or
    millionths: "0.405 µm"."""
    if value is None or not unit_text:
        return short(value, digits)
    factor, unit_text = _scaled_unit(unit_text, value)
    return f"{short(factor * value, digits)}{SPACE}{unit_text}"


def with_common_unit(values: Sequence[float], unit_text: str, between: str) -> str:
    """ "5.98 → 2.63 mm": the unit is that of the largest."""
    if values and unit_text:
        factor, unit_text = _scaled_unit(unit_text, *values)
        values = [factor * value for value in values]
    text = between.join(short(value) for value in values)
    return with_unit(text, unit_text)


def _scaled_unit(unit_text: str, *values: float) -> tuple[float, str]:
    """Factor and unit for display: (1e6, "µm") for micrometres."""
    largest = max(map(abs, values))
    if unit_text not in _PREFIXED or not 0.0 < largest < _MILLI:
        return 1.0, unit_text
    return (1e6, f"µ{unit_text}") if largest < _MICRO else (1e3, f"m{unit_text}")


def with_unit(figure: str, unit_text: str) -> str:
    """A figure and its unit on a line."""
    return f"{figure}{SPACE}{unit_text}" if unit_text else figure


def unbroken(text: str) -> str:
    """A figure and its unit stay on the same line."""
    return text.replace(" ", SPACE)


def parameter_text(name: str, estimate: Estimate) -> str:
    """ "torque 0.41 N m (95 % interval 0.38 to 0.44 N m)", in the same unit; an interval without
    width is left out."""
    value, low, high, unit_text = estimate.value, estimate.low, estimate.high, channel_unit(name)
    if low is not None and low == high:
        low = high = None
    known = [bound for bound in (value, low, high) if bound is not None]
    if unit_text:
        factor, unit_text = _scaled_unit(unit_text, *known)
        value = factor * value
        low, high = (None if bound is None else factor * bound for bound in (low, high))
    interval = interval_tail(span(low, high, unit_text))
    return f"{channel_label(name)} {with_unit_text(value, unit_text)}{interval}"


def bound_text(estimate: Estimate) -> str:
    """ "at its lower bound"; "" within the bounds."""
    side = "lower" if estimate.at_bound == "low" else "upper"
    return f"at its {side} bound" if estimate.at_bound else ""


def percent(share: float | None) -> str:
    """`percent_text` as the page sets it; a dash for None."""
    if share is None:
        return DASH
    return percent_text(share).replace(" ", SPACE).replace("-", MINUS)


def span(low: float | None, high: float | None, unit_text: str = "", digits: int = 3) -> str:
    """ "0.38 to 0.44 N m"; open sides are "above" and "below"; a dash where both are open."""
    if low is None and high is None:
        return DASH
    factor, unit_text = _scaled_unit(
        unit_text, *(bound for bound in (low, high) if bound is not None)
    )
    low, high = (None if bound is None else factor * bound for bound in (low, high))
    if low is None or high is None:
        side, bound = ("below", high) if low is None else ("above", low)
        return with_unit(f"{side} {short(bound, digits)}", unit_text)
    first, last = (number(bound, digits).partition(f"{SPACE}×") for bound in (low, high))
    if first[1] and first[2] == last[2]:  # a common power of ten is enough
        return with_unit(f"({first[0]} to {last[0]}){''.join(last[1:])}", unit_text)
    return with_unit(f"{short(low, digits)} to {short(high, digits)}", unit_text)


def interval_tail(interval: str) -> str:
    """ " (95 % interval 74 to 82 %)"; "" if there is none."""
    return "" if interval == DASH else f" ({INTERVAL} {interval})"


def percent_span(low: float | None, high: float | None) -> str:
    """ "74 to 82 %"."""
    if low is None or high is None:
        return DASH
    return f"{percent(low).removesuffix(f'{SPACE}%')} to {percent(high)}"


def count(value: float | None) -> str:
    """A whole number."""
    return DASH if value is None else f"{value:.0f}"


def not_converged(what: str, why: str) -> str:
    """ "the fit did not converge: iterations used up", the wording of all pages and pictures."""
    return f"{what} did not converge: {clean(why) or 'no reason given'}"


def sentence(text: str) -> str:
    """With a capital first letter and a full stop."""
    text = capital(text.strip())
    return text + ("" if not text or text.endswith((".", "!", "?", ":")) else ".")


def capital(text: str) -> str:
    """With a capital first letter: a heading or a title."""
    return text[:1].upper() + text[1:]
