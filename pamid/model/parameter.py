"""A parameter of a rig or an effect: value, unit, bounds, prior, source."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pamid.base.errors import FileError
from pamid.base.units import size_to_si, suffix_of, unit


@dataclass(frozen=True)
class Parameter:
    """One number of a model.

    name       as the equations read it, `p.<name>`
    value      data-sheet value (prior mean); for an effect the typical size used when nothing else
               is said
    unit       unit of value, low, high, spread and null; with a unit the equations see SI and the
               outside sees `<name>_<suffix>` ("inertia" in "kg m2" -> inertia_kg_m2); without one
               the number is used as written
    low, high  bounds
    spread     one standard deviation of the prior (default: a quarter of the range); with log=True
               a factor
    null       effects only: the value at which the effect vanishes exactly
    size       effects only: name of the port's signal ("value", "velocity", ...) that this
               parameter scales with: value, bounds and spread are then multiples of that signal's
               size and its unit is the signal's; "timescale", "1/timescale", "period": of the
               correlation time of the recordings, of its inverse, of the rig's sampling period
    tries      further starting values for the fit, where one basin is not enough
    fitted     False: held at its value unless a fit is told otherwise
    """

    name: str
    value: float = math.nan
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    spread: float = math.nan
    log: bool = False
    null: float | None = None
    size: str = ""
    tries: tuple[float, ...] = ()
    fitted: bool = True
    label: str = ""
    source: str = ""

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise FileError(
                f"parameter name {self.name!r} is not a plain word",
                "use letters, digits and underscores",
            )
        if math.isnan(self.value):
            raise FileError(
                f"parameter {self.name!r} has no value", "give its data-sheet value or typical size"
            )
        if not self.low <= self.value <= self.high:
            raise FileError(
                f"parameter {self.name!r}: value {self.value:g} lies outside its bounds "
                f"{self.low:g} .. {self.high:g}",
                "widen the bounds or mend the value",
            )
        if self.null is not None and not self.low <= self.null <= self.high:
            raise FileError(
                f"parameter {self.name!r}: its null {self.null:g} lies outside its bounds "
                f"{self.low:g} .. {self.high:g}",
                "the null must be an admissible value",
            )
        if self.log and not (self.low > 0.0 or (self.low == 0.0 and self.value > 0.0)):
            raise FileError(f"parameter {self.name!r}: a logarithmic prior needs a positive range")
        if self.unit:
            suffix_of(self.unit)  # an unknown unit is refused here, where it is written
            if unit(self.unit).offset:
                raise FileError(
                    f"parameter {self.name!r}: {self.unit} has a zero of its own",
                    "state it in K; columns of a recording may be in degC",
                )

    @property
    def outside_name(self) -> str:
        """Name in files, on the command line and in JSON: the label (or name) with the unit's
        suffix."""
        name = self.name if not self.label or "{" in self.label else self.label
        return f"{name}_{suffix_of(self.unit)}" if self.unit and suffix_of(self.unit) else name

    @property
    def factor(self) -> float:
        """SI value = factor x value."""
        return float(size_to_si(1.0, self.unit)) if self.unit else 1.0

    @property
    def prior_spread(self) -> float:
        """Standard deviation of the prior in the parameter's unit (natural logarithm of the factor
        if log)."""
        if self.log:
            return math.log(self.spread) if self.spread > 1.0 else math.log(2.0)
        if math.isfinite(self.spread):
            return self.spread
        if math.isfinite(self.low) and math.isfinite(self.high):
            return 0.25 * (self.high - self.low)
        return max(abs(self.value), 1.0)
