"""Rig + effects = one flat system of equations, checked here and never while solving."""

from __future__ import annotations

import math
import traceback
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.effect import Effect, Signals
from pamid.engine.lowering import Cell, lower, tick
from pamid.engine.program import Program, build_program
from pamid.equations import EquationError, Expr, clip, expression, symbol
from pamid.errors import FileError, PamidError, nearest
from pamid.parameter import Parameter
from pamid.rig import Loop, Port, Rig
from pamid.units import NONE, quantity_of, quotient, to_si

Array = NDArray[np.float64]
Sizes = dict[tuple[str, str], float]


@dataclass(frozen=True)
class Attachment:
    """An effect at one or more ports of a rig. `label` is how it is reported: the name, or name@port."""

    effect: Effect
    ports: tuple[str, ...]
    label: str
    place: str = ""

    def acts_at(self, port: str, place: str) -> bool:
        return port in self.ports and self.place in ("", place)


@dataclass(frozen=True)
class Bound:
    """A parameter in its place: key in the equations, name outside, SI numbers."""

    key: str
    owner: str           # "" the rig, "background", or an attachment's label
    name: str
    unit: str
    factor: float        # SI = factor x outside
    value: float
    low: float
    high: float
    spread: float        # of the prior, SI; of the logarithm where log
    log: bool
    null: float | None
    fitted: bool
    tries: tuple[float, ...]
    source: str


class Names:
    """Attribute access to symbols with an error that offers the nearest name."""

    def __init__(self, values: dict[str, Any], what: str) -> None:
        self._values, self._what = values, what

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        try:
            return self._values[name]
        except KeyError:
            raise EquationError(f"there is no {self._what} {name!r}; there are: {', '.join(self._values) or 'none'}",
                                nearest(name, list(self._values))) from None


def _size(port: Port, name: str, what: str, sizes: Sizes) -> float:
    """Magnitude of a signal (or a quotient, "value/velocity/velocity") at a port; 1 where nobody knows."""
    top, *below = (sizes.get((name, s)) or port.size.get(s) or 1.0 for s in what.split("/"))
    return float(top / math.prod(below))


def _unit(port: Port, what: str) -> str:
    top, *below = map(port.unit_of, what.split("/"))
    found = quotient(top, *below) if below else top
    return "" if found == NONE else found


def bind(parameter: Parameter, owner: str, port: Port | None, port_name: str, sizes: Sizes) -> Bound:
    """A parameter with its size and unit taken from the port it acts at."""
    unit, scale, label = parameter.unit, 1.0, parameter.label or parameter.name
    if parameter.size and port is not None:
        unit = _unit(port, parameter.size)
        scale = _size(port, port_name, parameter.size, sizes)
    if port is not None:
        label = label.replace("{value}", quantity_of(port.unit).replace(" ", "_").replace("dimensionless", "value"))
    factor = 1.0 if parameter.size else parameter.factor
    shown = Parameter(parameter.name, parameter.value, unit=unit, label=label, low=parameter.low, high=parameter.high)
    si = factor * scale
    spread = parameter.prior_spread * (1.0 if parameter.log else si)
    return Bound(f"{owner}:{parameter.name}" if owner else parameter.name, owner, shown.outside_name, unit,
                 to_si(1.0, unit) if unit else 1.0, parameter.value * si, parameter.low * si, parameter.high * si,
                 spread, parameter.log, None if parameter.null is None else parameter.null * si, parameter.fitted,
                 tuple(t * si for t in parameter.tries), parameter.source)


def nuisance_owner(term: Effect, place: str) -> str:
    """Owner of a background term's parameters: background.force_map_1."""
    return f"background.{term.name}_{place}" if place else f"background.{term.name}"


@dataclass(frozen=True)
class Passage:
    """A value on its way through a port."""

    port: str
    place: str
    value: Expr
    signals: tuple[tuple[str, Any], ...]
    result: Expr

    @property
    def where(self) -> str:
        return f"{self.port}_{self.place}" if self.place else self.port


@dataclass(frozen=True, eq=False)
class Assembly:
    """A rig with effects attached.

    sizes       magnitudes of signals at ports, for effects' parameters (see `pamid.simulation.port_sizes`)
    background  whether the rig's tolerance-sized nuisance terms take part
    controller  the [controller] table of a recording: the command is then computed, not read
    outputs     only these outputs of the rig (empty: all): what a recording lacks need not be computed
    """

    rig: Rig
    attachments: tuple[Attachment, ...] = ()
    background: bool = False
    controller: tuple[tuple[str, float], ...] = ()
    sizes: Sizes = field(default_factory=dict)
    outputs: tuple[str, ...] = ()

    # ---- parameters ----------------------------------------------------------------------------------------------

    @cached_property
    def parameters(self) -> tuple[Bound, ...]:
        bound = [bind(p, "", None, "", self.sizes) for p in self.rig.parameters]
        for port_name, place, term in self._nuisance():
            owner = nuisance_owner(term, place)
            bound += [bind(p, owner, self.rig.ports[port_name], port_name, self.sizes) for p in term.parameters]
        for a in self.attachments:
            port = self.rig.ports[a.ports[0]]
            bound += [bind(p, a.label, port, a.ports[0], self.sizes) for p in a.effect.parameters]
        return tuple(bound)

    def _nuisance(self) -> list[tuple[str, str, Effect]]:
        """(port, place, term): a copy of every background term at every place of its port."""
        if not self.background:
            return []
        listed = {k: v if isinstance(v, tuple) else (v,) for k, v in self.rig.background.items()}
        return [(name, place, term) for name, terms in listed.items() for term in terms
                for place in self.rig.ports[name].places or ("",)]

    @cached_property
    def keys(self) -> dict[str, int]:
        return {b.key: i for i, b in enumerate(self.parameters)}

    def values(self, known: dict[str, float] | None = None) -> Array:
        """Parameter vector (SI): data-sheet values, then `known` given by outside name or key (outside units)."""
        p = np.array([b.value for b in self.parameters])
        for name, value in (known or {}).items():
            i = self.index_of(name)
            p[i] = value * self.parameters[i].factor
        return p

    def index_of(self, name: str) -> int:
        """Place of a parameter given as outside name, `label:outside_name` or key."""
        for i, b in enumerate(self.parameters):
            if name in (b.key, b.name if not b.owner else f"{b.owner}:{b.name}"):
                return i
        names = [b.name if not b.owner else f"{b.owner}:{b.name}" for b in self.parameters]
        raise FileError(f"rig {self.rig.name!r} has no parameter {name!r}",
                        nearest(name, names) or f"parameters: {', '.join(names)}")

    def start(self, p: Array) -> Array:
        """Initial state of a recording at parameters p, states of effects included (zero)."""
        own = {b.key: float(p[i]) for i, b in enumerate(self.parameters) if not b.owner}
        given = self.rig.start(Names(own, "parameter"))
        begin = {s.name: given.get(s.name, s.start) for s in self.rig.states}
        return np.array([begin.get(name, 0.0) for name in self.program.states])

    # ---- equations -----------------------------------------------------------------------------------------------

    @cached_property
    def traced(self) -> Traced:
        return _Tracer(self).run()

    @cached_property
    def program(self) -> Program:
        return self.program_with({})

    def program_with(self, extra: dict[str, Expr]) -> Program:
        """Compiled equations with further outputs, in the order of `extra`, after the rig's own."""
        t = self.traced
        outputs = {**{k: t.outputs[k] for k in self.outputs or t.outputs}, **extra}
        lowered = lower(t.rates, outputs, t.cells)
        return build_program(lowered, t.inputs, tuple(self.keys), tuple(outputs))


@dataclass(frozen=True)
class Traced:
    """Equations of an assembly as expressions."""

    rates: dict[str, Expr]
    outputs: dict[str, Expr]
    cells: tuple[Cell, ...]
    inputs: tuple[str, ...]
    passages: tuple[Passage, ...]


class _Tracer:
    def __init__(self, assembly: Assembly) -> None:
        self.a = assembly
        self.rig = assembly.rig
        self.passages: dict[tuple[str, str], Passage] = {}
        self.own_rates: dict[str, Expr] = {}
        self.inputs = list(self.rig.inputs)
        self.cells: list[Cell] = []

    def run(self) -> Traced:
        x = Names({s.name: symbol("state", s.name) for s in self.rig.states}, "state")
        p = Names({q.name: symbol("parameter", q.name) for q in self.rig.parameters}, "parameter")
        columns: dict[str, Expr] = {c: symbol("input", c) for c in self.rig.inputs}
        if self.a.controller:
            for loop in self.rig.loops:
                self.inputs.remove(loop.command)
                columns[loop.command] = symbol("cell", loop.command)
        u = Names(columns, "input")
        rates = self._call("rates", x, u, p, [s.name for s in self.rig.states])
        outputs = self._call("measure", x, u, p, list(self.rig.outputs))
        if self.a.controller:
            for loop in self.rig.loops:
                self._close(loop, outputs)
        self._every_port_used()
        return Traced({**rates, **self.own_rates}, outputs, tuple(self.cells), tuple(self.inputs),
                      tuple(self.passages.values()))

    def _call(self, method: str, x: Names, u: Names, p: Names, wanted: list[str]) -> dict[str, Expr]:
        where_ = f"rig {self.rig.name!r}, {method}()"
        try:
            found = getattr(self.rig, method)(x, u, p, self.port)
        except PamidError as error:
            raise FileError(f"{where_}: {error}", error.hint) from error
        except Exception as error:
            line = traceback.extract_tb(error.__traceback__)[-1].lineno
            raise FileError(f"{where_}, line {line}: {type(error).__name__}: {error}",
                            "only + - * / and the functions of pamid.equations work on signals") from error
        if not isinstance(found, dict):
            raise FileError(f"{where_} returned {type(found).__name__}, not a dict of name: expression")
        missing, strange = [w for w in wanted if w not in found], [k for k in found if k not in wanted]
        if strange:
            raise FileError(f"{where_} returned the unknown name {strange[0]!r}",
                            nearest(strange[0], wanted) or f"names: {', '.join(wanted)}")
        if missing:
            raise FileError(f"{where_} returned nothing for {', '.join(map(repr, missing))}")
        return {w: expression(found[w]) for w in wanted}

    def port(self, name: str, value: Any, place: str = "", **signals: Any) -> Expr:
        """Pass a value through a port, once; the same value again is the same passage."""
        if name not in self.rig.ports:
            raise EquationError(f"there is no port {name!r}; ports: {', '.join(self.rig.ports)}",
                                nearest(name, list(self.rig.ports)))
        port, place = self.rig.ports[name], str(place)
        if (place or port.places) and place not in port.places:
            raise EquationError(f"port {name!r} has no place {place!r}",
                                f"places: {', '.join(port.places) or 'none'}")
        lacking = [s for s in port.signals if s not in signals]
        if lacking:
            raise EquationError(f"port {name!r} promises the signal {lacking[0]!r} but is not given it",
                                f"write port({name!r}, value, {lacking[0]}=...)")
        value = expression(value)
        known = tuple((k, v if callable(v) and not isinstance(v, Expr) else expression(v)) for k, v in signals.items())
        before = self.passages.get((name, place))
        if before is not None:
            plain = [kv for kv in known if isinstance(kv[1], Expr)]
            if before.value is not value or plain != [kv for kv in before.signals if isinstance(kv[1], Expr)]:
                raise EquationError(f"two different values pass through port {name!r} {place}".rstrip(),
                                    "a value passes through its port exactly once; give the other one its own port")
            return before.result
        result = value
        offered = {"time": tick("time"), "period": tick("period"), **dict(known)}
        for owner, effect in self._effects_at(name, place):
            result = self._apply(owner, effect, name, place, result, offered)
        self.passages[name, place] = Passage(name, place, value, known, result)
        return result

    def _effects_at(self, name: str, place: str) -> list[tuple[str, Effect]]:
        nuisance = [(nuisance_owner(term, at), term) for n, at, term in self.a._nuisance() if (n, at) == (name, place)]
        attached = [(a.label, a.effect) for a in sorted(self.a.attachments, key=lambda a: a.label)
                    if a.acts_at(name, place)]
        return nuisance + attached

    def _apply(self, owner: str, effect: Effect, name: str, place: str, value: Expr,
               offered: dict[str, Any]) -> Expr:
        where_ = f"effect {effect.name!r} at port {name!r} of {self.rig.name!r}"
        at = Signals({**offered, "place": place}, where_)
        p = Names({q.name: symbol("parameter", f"{owner}:{q.name}") for q in effect.parameters}, "parameter")
        prefix = f"{owner}.{name}{place}."
        z = Names({s.name: symbol("state", prefix + s.name) for s in effect.states}, "state")
        try:
            result = effect.act(value, at, p, z)
        except PamidError as error:
            raise FileError(f"{where_}: {error}", error.hint) from error
        except Exception as error:
            line = traceback.extract_tb(error.__traceback__)[-1].lineno
            raise FileError(f"{where_}, act(), line {line}: {type(error).__name__}: {error}",
                            "only + - * / and the functions of pamid.equations work on signals") from error
        after, rates = result if isinstance(result, tuple) else (result, {})
        if set(rates) != {s.name for s in effect.states}:
            raise FileError(f"{where_}: act() gives rates for {sorted(rates)}, its states are "
                            f"{[s.name for s in effect.states]}")
        self.own_rates |= {prefix + k: expression(v) for k, v in rates.items()}
        return expression(after)

    def _close(self, loop: Loop, outputs: dict[str, Expr]) -> None:
        """PD with filtered derivative on the measured reading, as section [controller] of a recording says."""
        c = dict(self.a.controller)
        unit = f"{loop.reading.rsplit('_', 1)[-1]}"
        noise = f"noise_{loop.reading}"
        self.inputs += [loop.reference, noise]
        scale = to_si(1.0, unit)
        error = (symbol("input", loop.reference) - outputs[loop.reading] - symbol("input", noise)) / scale
        last, slope = f"{loop.command}.error", f"{loop.command}.slope"
        period = tick("period")
        raw = (error - symbol("past", last)) / period
        filtered = symbol("past", slope)
        new_slope = filtered + (raw - filtered) * period / (c["derivative_filter_s"] + period)
        limit = c["command_limit"]
        kp, kd = c[f"kp_per_{unit}"], c[f"kd_s_per_{unit}"]
        self.cells += [
            Cell(slope, new_slope, 0.0 * error, sampled=True),
            Cell(last, error, error, sampled=True),
            Cell(loop.command, clip(kp * error + kd * symbol("cell", slope), -limit, limit),
                 clip(kp * error, -limit, limit), sampled=True),
        ]

    def _every_port_used(self) -> None:
        for name, port in self.rig.ports.items():
            for place in port.places or ("",):
                if (name, place) not in self.passages:
                    at = f" at place {place!r}" if place else ""
                    raise FileError(f"rig {self.rig.name!r} declares the port {name!r} but never passes a value "
                                    f"through it{at}", f"write ... = port({name!r}, value, ...) in rates or measure, "
                                    "or drop the port")


# ---- where effects can go ----------------------------------------------------------------------------------------


def fits(effect: type[Effect], port: Port) -> bool:
    """Can the effect act at this port?"""
    home = port.kind in effect.kinds or (port.general and port.kind in effect.general_kinds)
    offered = set(port.signals) | ({"position"} if "velocity" in port.signals else set())
    return home and effect.unit in ("", port.unit) and set(effect.signals) <= offered


def attachments(rig: Rig, effects: Iterable[type[Effect]]) -> list[Attachment]:
    """Every way in which effects can be attached to the rig; a special case stays away where its general form fits."""
    known = list(effects)
    found: list[Attachment] = []
    for effect in known:
        parents = [e for e in known if e is not effect and issubclass(effect, e)]
        ports = [n for n, port in rig.ports.items()
                 if fits(effect, port) and not any(fits(parent, port) for parent in parents)]
        if effect.everywhere and ports:
            found.append(Attachment(effect(), tuple(ports), effect.name))
        elif len(ports) == 1:
            found.append(Attachment(effect(), (ports[0],), effect.name))
        else:
            found += [Attachment(effect(), (n,), f"{effect.name}@{n}") for n in ports]
    return found


def attach(rig: Rig, spec: str, effects: dict[str, type[Effect]]) -> Attachment:
    """The attachment named `effect`, `effect@port` or `effect@port_place`."""
    name, _, at = spec.partition("@")
    if name not in effects:
        raise FileError(f"unknown effect {name!r}", nearest(name, list(effects)) or "see pamid effects")
    possible = [a for a in attachments(rig, effects.values()) if a.effect.name == name]
    if not possible:
        needs = f"a port of kind {' or '.join((*effects[name].kinds, *effects[name].general_kinds))}"
        signals = f" offering {', '.join(effects[name].signals)}" if effects[name].signals else ""
        raise FileError(f"effect {name!r} finds no place on rig {rig.name!r}: it needs {needs}{signals}; the rig has "
                        + ", ".join(f"{n} ({q.kind})" for n, q in rig.ports.items()))
    if not at:
        if len(possible) > 1:
            raise FileError(f"effect {name!r} fits several ports of rig {rig.name!r}",
                            "say which: " + ", ".join(a.label for a in possible))
        return possible[0]
    for a in possible:
        for port in a.ports:
            if at == port:
                return Attachment(a.effect, (port,), spec)
            for place in rig.ports[port].places:
                if at == f"{port}_{place}":
                    return Attachment(a.effect, (port,), spec, place)
    raise FileError(f"effect {name!r} cannot act at {at!r} of rig {rig.name!r}",
                    "it fits: " + ", ".join(port for a in possible for port in a.ports))

