"""Running a rig's equations once on symbols, its effects at their ports; every rule about ports is
checked here."""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from pamid.base.errors import FileError, PamidError, nearest
from pamid.base.units import size_to_si
from pamid.engine.symbolic.expression import substitute, symbol, symbols
from pamid.engine.symbolic.memory_cells import Cell, tick
from pamid.engine.symbolic.vocabulary import (
    FUNCTIONS_HINT,
    EquationError,
    Expr,
    clip,
    expression,
    rate_of,
)
from pamid.model.effect import Effect, Signals
from pamid.model.rig import Loop, Rig
from pamid.recording.file_checks import BEFORE

#: (port, place) -> the effects that act there, with the owner of each effect's parameters, in order
EffectsAt = Callable[[str, str], list[tuple[str, Effect]]]


@contextmanager
def _named_errors(where_: str, method: str = "") -> Iterator[None]:
    """FileError that names the place in a user's equations for any error in the block."""
    try:
        yield
    except PamidError as error:
        if error.code == "simulation":  # its message has the place already
            raise
        names_them = "pamid.equations" in error.hint
        hint = f"{error.hint}. {FUNCTIONS_HINT}" if names_them else error.hint
        raise FileError(f"{where_}: {error.message}", hint) from error
    except Exception as error:
        line = traceback.extract_tb(error.__traceback__)[-1].lineno
        divided = isinstance(error, ZeroDivisionError)
        raise FileError(
            f"{where_}{method}, line {line}: {type(error).__name__}: {error}",
            "Correct that line: it divides by a number that is 0."
            if divided
            else f"Correct that line. {FUNCTIONS_HINT}",
        ) from error


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
            raise EquationError(
                f"there is no {self._what} {name!r}; there are: "
                f"{', '.join(self._values) or 'none'}",
                nearest(name, list(self._values)),
            ) from None


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


@dataclass(frozen=True)
class Traced:
    """Equations of an assembly as expressions."""

    rates: dict[str, Expr]
    outputs: dict[str, Expr]
    cells: tuple[Cell, ...]
    inputs: tuple[str, ...]
    passages: tuple[Passage, ...]
    linear: tuple[str, ...] = ()  # inputs that are linear over a sample; the others are held


class _Tracer:
    def __init__(
        self,
        rig: Rig,
        effects_at: EffectsAt,
        controller: dict[str, float],
        upper_bounds: Mapping[str, float],
    ) -> None:
        self.rig, self.effects_at, self.controller = rig, effects_at, controller
        self.upper_bounds = upper_bounds
        self.passages: dict[tuple[str, str], Passage] = {}
        self.effect_rates: dict[str, Expr] = {}
        self.inputs = list(self.rig.inputs)
        self.cells: list[Cell] = []

    def run(self) -> Traced:
        states = {s.name: symbol("state", s.name) for s in self.rig.states}
        x = Names(states | self.rig.auxiliary_signals(), "state")
        p = Names({q.name: symbol("parameter", q.name) for q in self.rig.parameters}, "parameter")
        columns: dict[str, Expr] = {c: symbol("input", c) for c in self.rig.inputs}
        if self.controller:
            for loop in self.rig.loops:
                self.inputs.remove(loop.command)
                columns[loop.command] = symbol("cell", loop.command)
        u = Names(columns, "input")
        rates = self._call("rates", x, u, p, self.rig.differential_states())
        outputs = self._call("measure", x, u, p, list(self.rig.outputs))
        # a log may read an output before it sends the command of the same row
        between = self.rig.between
        held_inputs = (u for column, u in columns.items() if between.get(column) != "linear")
        before = {u: u - tick("period") * rate_of(u) for u in held_inputs}
        outputs = {
            column: substitute([value], before)[0] if between.get(column) == BEFORE else value
            for column, value in outputs.items()
        }
        if self.controller:
            for loop in self.rig.loops:
                self._close(loop, outputs)
        for name, port in self.rig.ports.items():
            for place in port.places or ("",):
                if (name, place) not in self.passages:
                    at = f" at place {place!r}" if place else ""
                    raise FileError(
                        f"rig {self.rig.name!r} declares the port {name!r} but never passes a "
                        f"value through it{at}",
                        f"write ... = port({name!r}, value, ...) in rates or measure, "
                        "or drop the port",
                    )
        return Traced(
            {**rates, **self.effect_rates},
            outputs,
            tuple(self.cells),
            tuple(self.inputs),
            tuple(self.passages.values()),
            tuple(c for c in self.inputs if self.rig.between.get(c) == "linear"),
        )

    def _call(
        self, method: str, x: Names, u: Names, p: Names, wanted: list[str]
    ) -> dict[str, Expr]:
        where_ = f"rig {self.rig.name!r}, {self.rig.written_as.get(method, method)}()"
        with _named_errors(where_):
            values = getattr(self.rig, method)(x, u, p, self.port)
        if not isinstance(values, dict):
            raise FileError(
                f"{where_} returned {type(values).__name__}, not a dict of name: expression"
            )
        missing, strange = (
            [w for w in wanted if w not in values],
            [k for k in values if k not in wanted],
        )
        if strange:
            raise FileError(
                f"{where_} returned the unknown name {strange[0]!r}",
                nearest(strange[0], wanted) or f"names: {', '.join(wanted)}",
            )
        if missing:
            raise FileError(f"{where_} returned nothing for {', '.join(map(repr, missing))}")
        return {w: expression(values[w]) for w in wanted}

    def port(self, name: str, value: Any, place: str = "", **signals: Any) -> Expr:
        """Pass a value through a port, once; the same value again is the same passage."""
        if name not in self.rig.ports:
            raise EquationError(
                f"there is no port {name!r}; ports: {', '.join(self.rig.ports)}",
                nearest(name, list(self.rig.ports)),
            )
        port, place = self.rig.ports[name], str(place)
        if (place or port.places) and place not in port.places:
            raise EquationError(
                f"port {name!r} has no place {place!r}",
                f"places: {', '.join(port.places) or 'none'}",
            )
        lacking = [s for s in port.signals if s not in signals]
        if lacking:
            raise EquationError(
                f"port {name!r} declares the signal {lacking[0]!r} but gets no value for it",
                f"write port({name!r}, value, {lacking[0]}=...)",
            )
        value = expression(value)
        known = tuple(
            (k, v if callable(v) and not isinstance(v, Expr) else expression(v))
            for k, v in signals.items()
        )
        before = self.passages.get((name, place))
        if before is not None:
            plain = [kv for kv in known if isinstance(kv[1], Expr)]
            if before.value is not value or plain != [
                kv for kv in before.signals if isinstance(kv[1], Expr)
            ]:
                raise EquationError(
                    f"two different values pass through port {name!r} {place}".rstrip(),
                    "a value passes through its port exactly once; give the other value a separate "
                    "port",
                )
            return before.result
        result = value
        offered = {**{name: tick(name) for name in ("time", "step", "period")}, **dict(known)}
        for owner, effect in self.effects_at(name, place):
            result = self._apply(owner, effect, name, place, result, offered)
        self.passages[name, place] = Passage(name, place, value, known, result)
        return result

    def _apply(
        self,
        owner: str,
        effect: Effect,
        name: str,
        place: str,
        value: Expr,
        offered: dict[str, Any],
    ) -> Expr:
        where_ = f"effect {effect.name!r} at port {name!r} of {self.rig.name!r}"
        aliases = {
            signal: offered[other]
            for signal in effect.stand_ins
            if (other := effect.offered_as(signal, offered)) in offered
        }
        kind = self.rig.ports[name].kind
        values = {**offered, **aliases, "place": place, "kind": kind}
        ends = {
            q.name: self.upper_bounds.get(f"{owner}:{q.name}", math.inf) for q in effect.parameters
        }
        at = Signals(values, where_, self.rig.period_s, ends)
        p = Names(
            {q.name: symbol("parameter", f"{owner}:{q.name}") for q in effect.parameters},
            "parameter",
        )
        prefix = f"{owner}.{name}{place}."
        z = Names({s.name: symbol("state", prefix + s.name) for s in effect.states}, "state")
        with _named_errors(where_, ", act()"):
            result = effect.act(value, at, p, z)
        after, rates = result if isinstance(result, tuple) else (result, {})
        if set(rates) != {s.name for s in effect.states}:
            raise FileError(
                f"{where_}: act() gives rates for {sorted(rates)}, its states are "
                f"{[s.name for s in effect.states]}"
            )
        self.effect_rates |= {prefix + k: expression(v) for k, v in rates.items()}
        return expression(after)

    def _close(self, loop: Loop, outputs: dict[str, Expr]) -> None:
        """PD with filtered derivative on the measured reading, as section [controller] of a
        recording states."""
        c = self.controller
        unit = f"{loop.reading.rsplit('_', 1)[-1]}"
        noise = f"noise_{loop.reading}"
        self.inputs += [loop.reference, noise]
        scale = size_to_si(1.0, unit)
        error = (
            symbol("input", loop.reference) - outputs[loop.reading] - symbol("input", noise)
        ) / scale
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
            Cell(
                loop.command,
                clip(kp * error + kd * symbol("cell", slope), -limit, limit),
                clip(kp * error, -limit, limit),
                sampled=True,
            ),
        ]


def trace(
    rig: Rig,
    effects_at: EffectsAt,
    controller: dict[str, float],
    upper_bounds: Mapping[str, float] | None = None,
) -> Traced:
    """The rig's equations with the effects in place; upper_bounds (SI): of the effects'
    parameters, by key. FileError, naming rig, port or effect, for whatever is wrong."""
    return _Tracer(rig, effects_at, controller, upper_bounds or {}).run()


# ---- several models combined ---------------------------------------------------------------------


def signals_of(traced: Traced) -> dict[str, Expr]:
    """Inputs and outputs of a model by name (SI); a command that its controller makes is a cell."""
    return {
        **{c.name: c.here for c in traced.cells},
        **{name: symbol("input", name) for name in traced.inputs},
        **traced.outputs,
    }


def prefixed_model(model: Traced, other: Traced, prefix: str) -> Traced:
    """A model's equations with prefixed states and parameters, driven by the inputs of another
    model."""
    driven, roots = signals_of(other), [*model.rates.values(), *model.outputs.values()]
    new = {
        symbol(space, name): driven[name] if space == "input" else symbol(space, prefix + name)
        for space, name in symbols(roots)
        if space != "tick"
    }
    expressions = iter(substitute(roots, new))
    rates = {prefix + name: next(expressions) for name in model.rates}
    outputs = {name: next(expressions) for name in model.outputs}
    driven_cells = tuple(c for c in other.cells if c.name in model.inputs)
    return Traced(rates, outputs, driven_cells, other.inputs, (), other.linear)


def with_input_replaced(
    driven: Traced, before: Traced, name: str, value: Expr, cells: tuple[Cell, ...]
) -> Traced:
    """Both models combined: the outputs of the first, with this value in the place of any of its
    inputs."""
    put = {symbol("input", name): value}
    rates = dict(zip(driven.rates, substitute(driven.rates.values(), put), strict=True))
    outputs = dict(zip(driven.outputs, substitute(driven.outputs.values(), put), strict=True))
    fed_cells = []
    for c in driven.cells:
        update, start = substitute([c.update, c.start], put)
        fed_cells.append(Cell(c.name, update, start, c.sampled))
    return Traced(
        {**rates, **before.rates},
        outputs,
        (*fed_cells, *cells),
        tuple(i for i in driven.inputs if i != name),
        (),
        tuple(i for i in driven.linear if i != name),
    )
