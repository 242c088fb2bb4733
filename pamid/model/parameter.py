"""A parameter of a rig or an effect: value, unit, bounds, prior, source."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from pamid.base.errors import FileError
from pamid.base.units import NONE, check_named_unit, named_with, size_to_si, split_column
from pamid.base.units import unit as unit_of


@dataclass(frozen=True)
class Parameter:
    """A numeric parameter of a model.

    The common kinds have constructors: `level`, `share`, `slope`, `width`, `time` for effects,
    `positive` and `held` for rigs as well; `with_source` adds where the numbers come from. Further
    fields are passed on by keyword.

    name       as the equations read it, `p.<name>`; a name that ends in a unit, as columns
               do ("area_cm2"), has this unit
    value      data-sheet value (prior mean); for an effect the typical size used when nothing else
               is stated
    unit       unit of value, low, high, spread and null. The equations see SI, p.area_cm2 = 5e-4
               for 5 cm2, and the outside sees `<name>_<suffix>` ("inertia" in "kg m2" ->
               inertia_kg_m2; "area_cm2" stays as it is). Without a unit, here and in the name, the
               number is used as written; "1" states that it has none although the name seems to end
               in a unit ("side_l")
    low, high  bounds
    spread     a standard deviation of the prior (default: a quarter of the range); with log=True
               a factor
    null       effects only: the value at which the effect vanishes exactly
    size       effects only: name of the port's signal ("value", "velocity", ...) that this
               parameter scales with: value, bounds and spread are then multiples of that signal's
               size and its unit is the signal's; "travel": half of the way along the position,
               wherever that is counted from; "timescale", "1/timescale", "period": of the
               correlation time of the recordings, of its inverse, of the rig's sampling period
    tries      further starting values for the fit, where a single basin is not enough
    scan       effects only: (step, count) or (step, count, power): the values
               high (1 + step k)^power, k below the count, are tried by a run each, where the
               misfit has many narrow minima; there a fit begins. The power is -1 unless stated
    at_least   effects only: (size, multiple): the range ends at this multiple of another size or
               later ("time" is the duration of the longest recording), and the prior is half as
               wide
    hard       effects only: the bounds are physics, or tell the effect from another; where a fit
               ends at such a bound it is not widened
    softens    effects only, with log=True: the equation grows softer as the value falls (a spring's
               natural frequency), so that the lower bound is widened, too; that of other factors
               stays, below which an equation grows stiff
    fitted     False: held at its value unless a fit frees it
    inner      rigs only: a coordinate without a separate meaning, such as a factor of a matrix;
               in its place the combinations (`Rig.combinations`) that hold it are reported
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
    scan: tuple[float, int] | tuple[float, int, float] = (0.0, 0)
    at_least: tuple[str, float] | None = None
    fitted: bool = True
    hard: bool = False
    softens: bool = False
    inner: bool = False
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
                "widen the bounds or correct the value",
            )
        if self.null is not None and not self.low <= self.null <= self.high:
            raise FileError(
                f"parameter {self.name!r}: its null {self.null:g} lies outside its bounds "
                f"{self.low:g} .. {self.high:g}",
                "the null must be an admissible value",
            )
        if self.log and not (self.low > 0.0 or (self.low == 0.0 and self.value > 0.0)):
            raise FileError(f"parameter {self.name!r}: a logarithmic prior needs a positive range")
        # The unit at the end of the name is that of the value. Another in `unit` is refused, as is
        # a unit that is unknown or counts from another zero.
        named = split_column(self.name)[1]
        if self.size:
            if named != NONE:
                raise FileError(
                    f"parameter {self.name!r} ends in {named!r}, but it scales with the port's "
                    f"{self.size!r} and has the port's unit",
                    f"Call it {split_column(self.name)[0]!r}.",
                    code="unit",
                )
            return
        if self.unit and self.unit != NONE:
            check_named_unit(self.name, self.unit)
        elif not self.unit and named != NONE:
            object.__setattr__(self, "unit", named)
        if unit_of(self.unit).offset:
            raise FileError(
                f"parameter {self.name!r} is in {self.unit}, whose zero differs from that of the "
                "SI unit",
                "Give it in K.",
                code="unit",
            )

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """A spread that is not stated is the same NaN in every process: what has been sent
        stays equal to what it was."""
        for name, value in state.items():
            unstated = name == "spread" and math.isnan(value)
            object.__setattr__(self, name, math.nan if unstated else value)

    @classmethod
    def level(
        cls, value: float, low: float, high: float, *, name: str = "level", **fields: Any
    ) -> Parameter:
        """Level in multiples of what passes the port; zero without the effect.

        Outside it bears the port's name: `torque_nm`, and `sine_torque_nm` for a level `sine`.
        """
        label = "{value}" if name == "level" else f"{name}_{{value}}"
        return cls(name, value, low, high, size="value", null=0.0, label=label, **fields)

    @classmethod
    def share(cls, name: str, value: float, low: float, high: float, **fields: Any) -> Parameter:
        """Dimensionless share or relative error; zero without the effect."""
        return cls(name, value, low, high, null=0.0, **fields)

    @classmethod
    def slope(
        cls, name: str, over: str, value: float, low: float, high: float, **fields: Any
    ) -> Parameter:
        """Slope of what passes the port over a signal ("velocity"), or over a product of signals
        ("velocity/velocity"); zero without the effect."""
        return cls(name, value, low, high, size=f"value/{over}", null=0.0, **fields)

    @classmethod
    def positive(
        cls,
        name: str,
        value: float,
        low: float,
        high: float,
        unit: str = "",
        *,
        factor: float,
        **fields: Any,
    ) -> Parameter:
        """Positive number known within a factor: its logarithm has the prior."""
        return cls(name, value, low, high, unit, spread=factor, log=True, **fields)

    @classmethod
    def width(cls, name: str, value: float, low: float, high: float, **fields: Any) -> Parameter:
        """Distance over which an effect sets in, known within a `factor`; with `size` a speed
        ("velocity") or a value."""
        return cls.positive(name, value, low, high, **{"size": "position", **fields})

    @classmethod
    def time(
        cls,
        value: float,
        low: float,
        high: float,
        *,
        name: str = "time_constant",
        size: str = "",
        **fields: Any,
    ) -> Parameter:
        """Time in s, or in multiples of `size` ("timescale", "period", "time").

        A level that may be zero vanishes there (null); any other is known within a `factor`.
        """
        unit = "" if size else "s"
        if low > 0.0:
            return cls.positive(name, value, low, high, unit, size=size, **fields)
        return cls(name, value, low, high, unit, size=size, null=0.0, **fields)

    @classmethod
    def held(
        cls, name: str, value: float, low: float, high: float, unit: str = "", **fields: Any
    ) -> Parameter:
        """Number that is measured beforehand, and held unless a fit releases it."""
        return cls(name, value, low, high, unit, fitted=False, **fields)

    def with_source(self, source: str) -> Parameter:
        """The same parameter, and where its numbers come from: a paper, a data sheet, an
        estimate."""
        return replace(self, source=source)

    @property
    def outside_name(self) -> str:
        """Name in files, on the command line and in JSON: the label (or name) with the unit's
        suffix."""
        return named_with(
            self.name if not self.label or "{" in self.label else self.label, self.unit
        )

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
