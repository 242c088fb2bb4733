"""The equation of a cause as it acts at its port, set from the very code that was fitted: once in
names, once with the values found. For an effect that no catalogue holds, the formula that describes
it.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from pamid.base.errors import PamidError
from pamid.base.schemas.diagnosis_file import Unknown
from pamid.base.schemas.estimates import Estimate
from pamid.base.units import quantity_of, split_column
from pamid.engine.symbolic import vocabulary as equations
from pamid.engine.symbolic.expression import Expr, expression, substitute, symbol, text
from pamid.model.attachment import attach
from pamid.model.bound_parameter import bind, parameters_of
from pamid.model.effect import Effect, Signals
from pamid.model.registry import all_effects, catalogue_rig
from pamid.model.trace import Names
from pamid.report import formatting
from pamid.report.captions import at_port, missing_term
from pamid.report.formatting import channel_unit, effect_label
from pamid.report.formula import FormulaError, formula_html
from pamid.report.load import RunData
from pamid.report.markup import paragraphs, prose, tag
from pamid.report.mathml import Typeset, math_html, name, number_html, operator

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
    "law": "the rig's force at this position and pressure",
    "fill": "the flow through the fill valve at this supply pressure",
}
# letters of plain text: above it the catalogue's words are the better reading
_LONGEST_PLAIN = 700


class _NamedSignals(Signals):
    """Signals as names, also those that the port does not offer; a function of the rig becomes a
    call of that name."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if name in _CALLED:
            return lambda *arguments: Expr(name, tuple(map(expression, arguments)))
        return self._values.get(name, symbol("signal", name))


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
    except PamidError:
        return None
    effect, port_name = where.effect, where.ports[0]
    port = of.ports[port_name]
    bounds = {p.name: bind(p, "", port, port_name, {}) for p in parameters_of(effect, port)}
    offered = {name: symbol("signal", name) for name in (*port.signals, "time", "period")}
    upper_bounds = {name: bound.high for name, bound in bounds.items()}
    at = _NamedSignals({**offered, "place": "", "kind": port.kind}, "", of.period_s, upper_bounds)
    p = Names({name: symbol("parameter", name) for name in bounds}, "parameter")
    z = Names({state.name: symbol("state", state.name) for state in effect.states}, "state")
    letter, what = _TORQUE if quantity_of(port.unit) == "torque" else LETTERS[port.kind]
    try:
        change = effect.act(symbol("value", letter), at, p, z)
    except PamidError:
        return None
    value, rates = change if isinstance(change, tuple) else (change, {})
    return ActingEffect(
        effect,
        letter,
        what,
        expression(value),
        {state: expression(rate) for state, rate in rates.items()},
        {name: bound.name for name, bound in bounds.items()},
    )


def cause_equations(run: RunData) -> list[Markup]:
    """Equations of the causes, or the formula of the missing term without a cause."""
    diagnosis = run.diagnosis
    if diagnosis is None:
        return []
    if diagnosis.unknown is not None and diagnosis.unknown.formula:
        return _unknown_equation(diagnosis.unknown)
    return [
        equation
        for cause in diagnosis.causes
        if (equation := _equation(run.rig, cause.effect, cause.port, cause.parameters)) is not None
    ]


def remainder_equations(run: RunData) -> list[Markup]:
    """Formula of the missing term, in addition to the causes."""
    term = missing_term(run.diagnosis) if run.diagnosis and run.diagnosis.causes else None
    return _unknown_equation(term) if term is not None and term.formula else []


def model_equations(run: RunData) -> list[Markup]:
    """The equations of the effects that the fitted model already had."""
    equations = []
    for label in run.fit.effects if run.fit is not None else ():
        values = {
            name.removeprefix(f"{label}:"): parameter
            for name, parameter in run.fit.parameters.items()  # type: ignore[union-attr]
            if name.startswith(f"{label}:")
        }
        equations.append(_equation(run.rig, label, "", values))
    return [equation for equation in equations if equation is not None]


def _unknown_equation(unknown: Unknown) -> list[Markup]:
    try:
        math = formula_html(formatting.clean(unknown.formula))
    except FormulaError:
        return []  # the sentence above has it as text
    title = f"The term that is missing{at_port(unknown.port)}, as it is described best"
    return [_figure(title, _scrolled(title, math))]


def _equation(
    rig: str, label: str, port_name: str, values: Mapping[str, Estimate]
) -> Markup | None:
    """An effect in names and with its values, as plain text if it is too long."""
    act = acting(rig, label)
    if act is None:
        return None
    at = at_port(port_name) if "@" not in label else ""
    title = f"The equation of {effect_label(label)}{at}"
    title += ", and with the values found" if values else ""
    in_names = _plain(act, {})
    if len(in_names) > _LONGEST_PLAIN:
        return _figure(title, tag("pre", act.effect.story().get("Equation", "")))
    with_names = Typeset(_shown(act, {}))
    math = [math_html(_rows(act, with_names), in_names)]
    if values:
        with_values = Typeset(_shown(act, values))
        math.append(math_html(_rows(act, with_values), _plain(act, values)))
    legend = [
        f"{act.letter}: the {act.what} without the effect, {act.letter}′ with it. Plain numbers "
        "are in SI units."
    ]
    texts = []
    for function in with_names.functions:
        meaning = _CALLED.get(function)
        if meaning is None:  # the first sentence of its docstring
            name = {"sgn": "sign", "step": "smooth_step"}.get(function, function)
            of = getattr(equations, name, None)
            summary = " ".join((inspect.getdoc(of) or "").split()) if of is not None else ""
            summary = re.split(r"[;.](?:\s|$)", summary, maxsplit=1)[0]
            meaning = summary.replace("+-", "± ").replace("half_width", "its second value")
        if meaning:
            texts.append(f"{function}: {meaning}")
    if texts:
        legend.append("; ".join(texts) + ".")
    return _figure(title, _scrolled(title, *math), *legend)


def _scrolled(title: str, *math: Markup) -> Markup:
    return tag("div", *math, class_="scroll", tabindex="0", role="region", aria_label=title)


def _figure(title: str, content: Markup, *notes: str) -> Markup:
    caption, legend = tag("figcaption", prose(title)), paragraphs(notes, "note")
    return tag("figure", caption, content, legend, class_="equation")


def _rows(act: ActingEffect, typeset: Typeset) -> list[list[Markup]]:
    after = tag("mrow", name(act.letter), operator("′", lspace="0", rspace="0"))
    rows = [[after, tag("mrow", operator("="), typeset(act.value))]]
    for state, rate in act.rates.items():
        above, below = (tag("mrow", tag("mi", "d"), name(of)) for of in (state, "t"))
        left = tag("mfrac", above, below)
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
