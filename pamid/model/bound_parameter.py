"""Parameters in their place: sized by the port an effect acts at, in SI, with the names they bear
outside."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from pamid.base.units import named_with, quantity_of, quotient, to_si, unit_label
from pamid.model.effect import Effect
from pamid.model.parameter import Parameter
from pamid.model.rig import Port

Sizes = dict[tuple[str, str], float]  # (port, signal) -> typical magnitude, SI
#: sizes that belong to no port: the rig's sampling period, the correlation time of the recordings
#: and the duration of the longest
TIMES = {"period": "s", "timescale": "s", "time": "s"}
TRAVEL, TRAVELLED = "travel", "position"  # half of the way along it, whose unit it has
PERIODS = 200.0  # in a correlation time, where no recording tells it


@dataclass(frozen=True)
class Bound:
    """A parameter in its place: key in the equations, name outside, SI numbers."""

    key: str
    owner: str  # "" the rig, background.<term>, or an attachment's label
    name: str
    unit: str
    factor: float  # SI = factor x outside
    value: float
    low: float
    high: float
    spread: float  # of the prior, SI; of the logarithm where log
    log: bool
    null: float | None
    fitted: bool
    tries: tuple[float, ...]
    source: str
    sized: bool = (
        False  # value and bounds are multiples of a typical magnitude: guesses, no physics
    )
    softens: bool = False  # as in `Parameter`
    inner: bool = False  # as in `Parameter`
    scan: tuple[float, int] | tuple[float, int, float] = (0.0, 0)  # as in `Parameter`

    @property
    def full_name(self) -> str:
        """Its name outside, led by whom it belongs to where that is not the rig."""
        return f"{self.owner}:{self.name}" if self.owner else self.name

    @property
    def nuisance(self) -> bool:
        """Whether it belongs to a tolerance-sized term of the background."""
        return self.owner.startswith("background.")


def _size(port: Port, name: str, what: str, sizes: Sizes) -> float:
    """Magnitude of a signal (or a quotient, "value/velocity/velocity") at a port; 1 where nobody
    knows."""
    top, *below = (
        1.0 if s == "1" else _known_size(port, name, s, sizes) or 1.0 for s in what.split("/")
    )
    return float(top / math.prod(below))


def _known_size(port: Port, name: str, signal: str, sizes: Sizes) -> float | None:
    size = sizes.get(("", signal)) or sizes.get((name, signal)) or port.size.get(signal)
    if not size and signal == TRAVEL:  # stated of the position, for motion about its zero
        return _known_size(port, name, TRAVELLED, sizes)
    return size


def _unit(port: Port, what: str) -> str:
    if what in TIMES:
        return TIMES[what]
    if what == "1/timescale":
        return "Hz"
    top, *below = (port.unit_of(TRAVELLED if s == TRAVEL else s) for s in what.split("/"))
    unit = quotient(top, *below) if below else top
    return unit_label(unit)


def parameters_of(effect: Effect, port: Port) -> tuple[Parameter, ...]:
    """An effect's parameters at a port, sized by signals under the names that the port gives
    them."""
    offered = set(port.signals)
    return tuple(
        replace(p, size="/".join(effect.offered_as(s, offered) for s in p.size.split("/")))
        for p in effect.parameters_at(port.kind, offered)
    )


def bind(
    parameter: Parameter, owner: str, port: Port | None, port_name: str, sizes: Sizes
) -> Bound:
    """A parameter with its size and unit taken from the port it acts at."""
    unit, scale, label = parameter.unit, 1.0, parameter.label or parameter.name
    if parameter.size and port is not None:
        unit = _unit(port, parameter.size)
        scale = _size(port, port_name, parameter.size, sizes)
    if port is not None:
        label = label.replace(
            "{value}", quantity_of(port.unit).replace(" ", "_").replace("dimensionless", "value")
        )
    factor = 1.0 if parameter.size else parameter.factor
    si = factor * scale
    high, spread = parameter.high * si, parameter.prior_spread * (1.0 if parameter.log else si)
    if parameter.at_least is not None and port is not None:
        other, multiple = parameter.at_least
        high = max(high, multiple * _size(port, port_name, other, sizes))
        spread = max(spread, 0.5 * high)
    return Bound(
        f"{owner}:{parameter.name}" if owner else parameter.name,
        owner,
        named_with(parameter.name if "{" in label else label, unit),
        unit_label(unit),
        to_si(1.0, unit) if unit else 1.0,
        parameter.value * si,
        parameter.low * si,
        high,
        spread,
        parameter.log,
        None if parameter.null is None else parameter.null * si,
        parameter.fitted,
        tuple(t * si for t in parameter.tries),
        parameter.source,
        bool(parameter.size) and not parameter.hard,
        parameter.softens,
        parameter.inner,
        parameter.scan,
    )


Range = tuple[float, float]  # lowest and highest value, SI


def within(bound: Bound, given: Range | None) -> Bound:
    """The parameter with another range, where a range is given; its prior's middle goes to the
    other side of zero where the range lies there."""
    if given is None:
        return bound
    low, high = given
    middle = -bound.value if high <= 0.0 < bound.value else bound.value
    return replace(
        bound,
        low=low,
        high=high,
        value=min(max(middle, low), high),
        tries=tuple(t for t in bound.tries if low <= t <= high),
    )
