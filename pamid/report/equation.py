"""The equation of a cause as it acts at its port, set from the very code that was fitted: once in
names, once with the values found. For an effect that no catalogue holds, the formula that describes
it.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from pamid.base.errors import PamidError
from pamid.base.units import quantity_of, split_column
from pamid.model.attachment import attach
from pamid.model.bound_parameter import bind, parameters_of
from pamid.model.effect import Effect
from pamid.model.registry import all_effects, catalogue_rig
from pamid.model.rig import Port
from pamid.report import formatting
from pamid.report.document import Equation
from pamid.report.formatting import channel_unit, effect_label, port_label
from pamid.report.formula import FormulaError, formula_html
from pamid.report.load import RunData
from pamid.report.markup import tag
from pamid.report.mathml import Typeset, fraction, math_html, name, number_html, operator
from pamid.report.missing_term import missing_term
from pamid.schemas.diagnosis_file import Cause, Unknown
from pamid.schemas.estimates import Estimate
from pamid.symbolic import vocabulary as equations
from pamid.symbolic.expression import Expr, expression, substitute, symbol, text

#: kind of port -> the letter and the name of what passes through it
LETTERS = {
    "command": ("u", "command"),
    "flow": ("q", "flow"),
    "rate": ("r", "rate of change"),
    "actuator-force": ("F", "force"),
    "motion": ("F", "force"),
    "transmission": ("F", "force"),
    "reading": ("y", "reading"),
}
_TORQUE = ("M", "torque")
_CALLED = {
    "law": "the rig's own force at this position and pressure",
    "fill": "the flow through the fill valve at this supply pressure",
}
# letters of plain text: above it the catalogue's own words are the better reading
_LONGEST_PLAIN = 700


class _NamedSignals:
    """Signals as names; a function of the rig becomes a call of that name."""

    def __init__(
        self,
        offered: frozenset[str],
        kind: str,
        rig_period_s: float,
        upper_bounds: dict[str, float],
    ) -> None:
        self._offered, self._kind, self.rig_period_s = offered, kind, rig_period_s
        self.upper_bounds = upper_bounds

    def offers(self, signal: str) -> bool:
        return signal in self._offered

    def __getattr__(self, signal: str) -> Any:
        if signal.startswith("__"):
            raise AttributeError(signal)
        if signal == "place":
            return ""
        if signal == "kind":
            return self._kind
        if signal in _CALLED:
            return lambda *arguments: Expr(signal, tuple(map(expression, arguments)))
        return symbol("signal", signal)


class _Symbols:
    """Any attribute as a symbol of one space."""

    def __init__(self, space: str) -> None:
        self._space = space

    def __getattr__(self, key: str) -> Expr:
        if key.startswith("__"):
            raise AttributeError(key)
        return symbol(self._space, key)


@dataclass(frozen=True)
class ActingEffect:
    """An effect at a port: letter and meaning of the value, the rates of its states, and names:
    parameter -> its name outside."""

    effect: Effect
    letter: str
    what: str
    value: Expr
    rates: Mapping[str, Expr]
    names: Mapping[str, str]


def acting(rig: str, label: str) -> ActingEffect | None:
    """The effect of this label on a rig of the catalogue; None for rigs and effects from users'
    files, which are code that a report does not run."""
    try:
        of = catalogue_rig(rig)
        where = attach(of, label, all_effects())
        port = of.ports[where.ports[0]]
        return _acting(where.effect, port, where.ports[0], of.period_s)
    except PamidError:
        return None


def _acting(effect: Effect, port: Port, port_name: str, rig_period_s: float) -> ActingEffect:
    offered = frozenset(port.signals) | {"time", "period"}
    bounds = {p.name: bind(p, "", port, port_name, {}) for p in parameters_of(effect, port)}
    at = _NamedSignals(offered, port.kind, rig_period_s, {k: b.high for k, b in bounds.items()})
    letter, what = _TORQUE if quantity_of(port.unit) == "torque" else LETTERS[port.kind]
    change = effect.act(symbol("value", letter), at, _Symbols("parameter"), _Symbols("state"))
    value, rates = change if isinstance(change, tuple) else (change, {})
    names = {name: b.name for name, b in bounds.items()}
    return ActingEffect(
        effect, letter, what, expression(value), {k: expression(v) for k, v in rates.items()}, names
    )


def cause_equations(run: RunData) -> tuple[Equation, ...]:
    """Equations of the causes, or the formula of the missing term without a cause."""
    diagnosis = run.diagnosis
    if diagnosis is None:
        return ()
    if diagnosis.unknown is not None and diagnosis.unknown.formula:
        return _unknown_equation(diagnosis.unknown)
    return _known(_cause_equation(run.rig, cause) for cause in diagnosis.causes)


def remainder_equations(run: RunData) -> tuple[Equation, ...]:
    """Formula of the missing term, in addition to the causes."""
    term = missing_term(run.diagnosis) if run.diagnosis and run.diagnosis.causes else None
    return _unknown_equation(term) if term is not None and term.formula else ()


def model_equations(run: RunData) -> tuple[Equation, ...]:
    """The equations of the effects that the fitted model already had."""
    if run.fit is None:
        return ()
    equations = []
    for label in run.fit.effects:
        parameters = {
            name.removeprefix(f"{label}:"): parameter
            for name, parameter in run.fit.parameters.items()
            if name.startswith(f"{label}:")
        }
        equations.append(
            _cause_equation(
                run.rig,
                Cause(
                    effect=label,
                    family="",
                    port="",
                    or_at=(),
                    instead=(),
                    figures={},
                    parameters=parameters,
                    probability=None,
                    removes=None,
                    share=None,
                ),
            )
        )
    return _known(equations)


def _known(equations: Iterable[Equation | None]) -> tuple[Equation, ...]:
    return tuple(equation for equation in equations if equation is not None)


def _unknown_equation(unknown: Unknown) -> tuple[Equation, ...]:
    formula = formatting.clean(unknown.formula)
    try:
        math = formula_html(formula)
    except FormulaError:
        return ()  # the sentence above has it as text
    at = f" at the {port_label(unknown.port)} port" if unknown.port else ""
    title = f"The term that is missing{at}, as it is described best"
    return (Equation(title, (math,)),)


def _cause_equation(rig: str, cause: Cause) -> Equation | None:
    act = acting(rig, cause.effect)
    if act is None:
        return None
    title, in_names = _title(cause), _plain(act, {})
    if len(in_names) > _LONGEST_PLAIN:
        return Equation(title, code=act.effect.story().get("Equation", ""))
    with_names = Typeset(_shown(act, {}))
    math = [math_html(_rows(act, with_names), in_names)]
    if cause.parameters:
        with_values = Typeset(_shown(act, cause.parameters))
        math.append(math_html(_rows(act, with_values), _plain(act, cause.parameters)))
    return Equation(title, tuple(math), notes=tuple(_legend(act, with_names)))


def _title(cause: Cause) -> str:
    at = f" at the {port_label(cause.port)} port" if cause.port and "@" not in cause.effect else ""
    values = ", and with the values found" if cause.parameters else ""
    return f"The equation of {effect_label(cause.effect)}{at}{values}"


def _rows(act: ActingEffect, typeset: Typeset) -> list[list[Markup]]:
    after = tag("mrow", name(act.letter), operator("′", lspace="0", rspace="0"))
    rows = [[after, tag("mrow", operator("="), typeset(act.value))]]
    for state, rate in act.rates.items():
        left = fraction(
            tag("mrow", tag("mi", "d"), name(state)), tag("mrow", tag("mi", "d"), name("t"))
        )
        rows.append([left, tag("mrow", operator("="), typeset(rate))])
    return rows


def _plain(act: ActingEffect, values: Mapping[str, Estimate]) -> str:
    """The same in plain text."""
    shown = {
        key: formatting.with_unit_text(values[outside].value, channel_unit(outside))
        if outside in values
        else split_column(outside)[0]
        for key, outside in act.names.items()
    }
    named = {symbol("parameter", key): symbol("shown", name) for key, name in shown.items()}
    value, *rates = substitute([act.value, *act.rates.values()], named)
    return "; ".join(
        [
            f"{act.letter}′ = {text(value)}",
            *(f"d {state}/dt = {text(rate)}" for state, rate in zip(act.rates, rates, strict=True)),
        ]
    )


def _shown(act: ActingEffect, values: Mapping[str, Estimate]) -> Any:
    """How symbols are shown: parameters by the names of the tables, or as their values."""

    def shown(space: str, key: str) -> Markup:
        if space != "parameter":
            return name(key)
        outside = act.names[key]
        if outside in values:
            return number_html(values[outside].value, channel_unit(outside))
        return name(split_column(outside)[0])

    return shown


def _legend(act: ActingEffect, typeset: Typeset) -> Iterator[str]:
    """Meanings of the letters and the functions."""
    letter = act.letter
    yield (
        f"{letter}: the {act.what} without the effect, {letter}′ with it. Plain numbers are "
        "in SI units."
    )
    meanings = [
        f"{function}: {_meaning(function)}" for function in typeset.functions if _meaning(function)
    ]
    if meanings:
        yield "; ".join(meanings) + "."


def _meaning(function: str) -> str:
    if function in _CALLED:
        return _CALLED[function]
    of = getattr(equations, {"sgn": "sign", "step": "smooth_step"}.get(function, function), None)
    summary = " ".join((inspect.getdoc(of) or "").split()) if of is not None else ""
    summary = re.split(r"[;.](?:\s|$)", summary, maxsplit=1)[0]
    return summary.replace("+-", "± ").replace("half_width", "its second value")
