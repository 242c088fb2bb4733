"""Rigs and effects described: as plain data for scripts, and as text for people, equations
included."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pamid.base.schemas import catalogue_files as result
from pamid.base.units import unit_label
from pamid.engine.symbolic.expression import plain, rebuild, symbol, text, walk
from pamid.engine.symbolic.vocabulary import Expr
from pamid.model.assembly import Assembly
from pamid.model.attachment import attachments
from pamid.model.effect import SECTIONS, Effect
from pamid.model.isolability import cut_rig
from pamid.model.no_place import no_places
from pamid.model.parameter import Parameter
from pamid.model.port_guide import WIDTH, wrapped
from pamid.model.rig import Rig, background_by_port

SIGN = (
    "a value is positive along the position of its port: pass the force on the moving part; an "
    "effect subtracts friction along the velocity. If a bench imposes the motion and measures "
    "the force, the reading is the negative of this value. `pamid check RIG.py` states the sign "
    "for every port."
)
HOLD_OR_RELEASE = (
    "a parameter that is not marked as held is fitted. In the TOML file next to a recording, "
    "`NAME = VALUE` under [known] holds it at this value, and `NAME = DEVIATION` under [free] "
    "fits a held parameter, within this standard deviation. A parameter held at zero can still "
    "be a missing effect: a diagnosis tries friction and stiffness as effects, at all joints "
    "together."
)
ON_REQUEST = (
    "NAME = SHARE under [free] releases the whole inertia of a body: its centre of mass and all "
    "moments of inertia, known within this share (1: 100 %)"
)
MANY_TERMS = 6  # of a background: longer lists are printed as the first and the last
MOST_EQUATION_LINES = 250  # of the shipped rigs fewer; of a robot of seven joints 600
LONG = 6  # nodes: an expression used twice and larger than this is given a name


def effect_row(effect: type[Effect]) -> result.EffectRow:
    """A line of the list."""
    return result.EffectRow(**_row(effect))


def _row(effect: type[Effect]) -> dict[str, Any]:
    kinds = (*effect.kinds, *(k for k in effect.general_kinds if k not in effect.kinds))
    return {
        "name": effect.name,
        "title": effect.story().get("title", ""),
        "kinds": kinds,
        "families": {k: effect.family_at(k) for k in kinds},
        "home": effect.kinds,
        "general": effect.general_kinds,
        "symptoms": effect.symptoms,
    }


def effect_story(
    effect: type[Effect], rigs: Iterable[Rig], known: Iterable[type[Effect]]
) -> result.EffectStory:
    """Everything about an effect: its story, parameters, look-alikes, and where on the rigs it
    fits."""
    known = list(known)
    return result.EffectStory(
        **_row(effect),
        story=effect.story(),
        signals=effect.signals,
        stand_ins={s: tuple(names) for s, names in effect.stand_ins.items()},
        roles=tuple(tuple(role) for role in effect.roles),
        unit=effect.unit,
        parameters=tuple(map(_parameter, effect.parameters)),
        home_signals=effect.home_signals,
        general_parameters=tuple(map(_parameter, effect.general_parameters)),
        states=tuple(s.name for s in effect.states),
        look_alikes=effect.look_alikes,
        absorbed_by=effect.absorbed_by,
        places=tuple(
            result.EffectPlace(
                rig=rig.name,
                effect=a.label,
                ports=a.ports,
                parameters=tuple(
                    result.NamedUnit(name=b.name, unit=b.unit)
                    for b in Assembly(rig, (a,)).parameters
                    if b.owner == a.label
                ),
            )
            for rig in rigs
            for a in attachments(rig, known)
            if a.effect.name == effect.name
        ),
    )


def rig_row(rig: type[Rig]) -> result.RigRow:
    """A line of the list."""
    return result.RigRow(
        name=rig.name,
        title=_title(rig),
        inputs=tuple(rig.inputs),
        outputs=tuple(rig.outputs),
        variants=_variants(rig),
    )


def _title(rig: type[Rig]) -> str:
    return (rig.__doc__ or "").strip().splitlines()[0] if rig.__doc__ else ""


def _variants(rig: type[Rig]) -> tuple[str, ...]:
    return tuple(getattr(rig, "variants", ()))


def rig_story(
    rig: Rig, known: Iterable[type[Effect]], rigs: Mapping[str, type[Rig]]
) -> result.RigStory:
    """Everything about a rig: signals, ports, parameters, background, equations, effects that
    fit, and those that fit other rigs for the same quantities."""
    known = list(known)
    fit = attachments(rig, known)
    return result.RigStory(
        name=rig.name,
        title=_title(type(rig)),
        story=type(rig).story(),
        inputs=tuple(
            result.RigInput(column=c, unit=unit, optional=c in rig.optional)
            for c, unit in rig.inputs.items()
        ),
        outputs=tuple(
            result.RigOutput(column=c, unit=unit, noise=rig.noise.get(c))
            for c, unit in rig.outputs.items()
        ),
        variants=_variants(type(rig)),
        states=tuple(result.NamedUnit(name=s.name, unit=s.unit) for s in rig.states),
        ports=tuple(
            result.RigPort(
                name=name,
                kind=port.kind,
                unit=port.unit,
                places=port.places,
                group=rig.group_of(name),
                signals={s: port.unit_of(s) for s in port.signals},
                effects=tuple(sorted({a.effect.name for a in fit if name in a.ports})),
            )
            for name, port in rig.ports.items()
        ),
        no_place=tuple(no_places(rig, known, rigs)),
        parameters=tuple(map(_parameter, rig.parameters)),
        on_request=tuple(rig.on_request),
        background=_background(rig),
        loops=tuple(
            result.LoopRow(command=x.command, reference=x.reference, reading=x.reading)
            for x in rig.loops
        ),
        equations=equations(rig),
    )


def _background(rig: Rig) -> tuple[result.BackgroundRow, ...]:
    return tuple(
        result.BackgroundRow(
            name=term.name,
            port=port,
            terms=tuple(p.name for p in term.parameters if p.fitted),
            tolerance=term.parameters[0].spread,
        )
        for port, terms in background_by_port(rig).items()
        for term in terms
    )


def _parameter(p: Parameter) -> result.ParameterRow:
    low, high = (value if abs(value) < float("inf") else None for value in (p.low, p.high))
    return result.ParameterRow(
        name=p.outside_name,
        value=p.value,
        low=low,
        high=high,
        unit=unit_label(p.unit),
        multiple_of=p.size,
        null=p.null,
        fitted=p.fitted,
        source=p.source,
    )


# ---- equations ---------------------------------------------------------------------------------


def equations(rig: Rig) -> result.RigEquations:
    """The rig's equations as text: rates, what passes through each port, outputs, and shorthands
    used in them."""
    traced = cut_rig(rig, "port", "{0}[{1}]")
    parts = {
        "rates": {f"d {name}/dt": e for name, e in traced.rates.items()},
        "ports": {f"{q.port}[{q.place}]" if q.place else q.port: q.value for q in traced.passages},
        "outputs": dict(traced.outputs),
    }
    parts = {k: dict(zip(part, plain(part.values()), strict=True)) for k, part in parts.items()}
    roots = [e for part in parts.values() for e in part.values()]
    # long expressions that occur more than once are replaced by names
    order = walk(roots)
    uses: dict[Expr, int] = {}
    for parent in order:
        for child in parent.args:
            uses[child] = uses.get(child, 0) + 1
    for root in roots:
        uses[root] = uses.get(root, 0) + 1
    new: dict[Expr, Expr] = {}
    size: dict[Expr, int] = {}
    names: dict[str, Expr] = {}
    for node in order:
        args = tuple(new[a] for a in node.args)
        new[node] = rebuild(node, args) if args else node
        size[node] = 1 + sum(size[a] for a in node.args)
        if uses[node] > 1 and size[node] > LONG:
            name = f"k{len(names) + 1}"
            names[name], new[node], size[node] = new[node], symbol("short", name), 1
    printed = {
        part: {name: text(new[e]) for name, e in listed.items()} for part, listed in parts.items()
    }
    return result.RigEquations(**printed, where={name: text(e) for name, e in names.items()})


# ---- text --------------------------------------------------------------------------------------


def effects_text(rows: Sequence[result.EffectRow]) -> str:
    """Effects by family: name, kinds of port, title."""
    if not rows:
        return "No effect fits there. All of them: pamid effects"
    families: dict[str, list[result.EffectRow]] = {}
    for row in rows:
        for family in dict.fromkeys(row.families.values()):
            families.setdefault(family, []).append(row)
    lines = []
    for family in sorted(families):
        lines.append(family)
        for row in families[family]:
            kinds = ", ".join(k for k, f in row.families.items() if f == family)
            lines.append(f"  {row.name:<31} {kinds:<19} {row.title}"[: WIDTH + 20])
    return "\n".join([*lines, "", f"{len(rows)} effects. Details: pamid effects {rows[0].name}"])


def effect_text(story: result.EffectStory) -> str:
    """The whole story of an effect."""
    lines = [
        f"{story.name}: {story.story.get('title', '')}",
        "",
        "family "
        + ", ".join(dict.fromkeys(story.families.values()))
        + "; port "
        + ", ".join(story.kinds)
        + (f" in {story.unit}" if story.unit else "")
        + (f", offering {', '.join(story.signals)}" if story.signals else ""),
        *(f"{s} may be offered as {', '.join(names)}" for s, names in story.stand_ins.items()),
        *(
            [
                "ports together: "
                + "; ".join(f"a port offering {' and '.join(r)}" for r in story.roles)
            ]
            if story.roles
            else []
        ),
    ]
    for section in SECTIONS:
        if story.story.get(section):
            lines += ["", section, textwrap.indent(story.story[section], "    ")]
    lines += ["", "Parameters", *_parameter_lines(story.parameters)]
    if story.general_parameters:
        where = ", ".join(k for k in story.general if k not in story.home)
        if story.home_signals:
            where = f"{', '.join(story.home)} without {', '.join(story.home_signals)}"
        lines += ["", f"At port {where}", *_parameter_lines(story.general_parameters)]
    for key, title in (
        ("symptoms", "Symptoms"),
        ("look_alikes", "Look-alikes"),
        ("absorbed_by", "Absorbed by a rig's"),
    ):
        if names := getattr(story, key):
            lines += ["", f"{title}: {', '.join(names)}"]
    lines += ["", "Fits"] + [
        f"    {place.rig}: {place.effect} at {', '.join(place.ports)} ("
        + ", ".join(p.name for p in place.parameters)
        + ")"
        for place in story.places
    ]
    return "\n".join(lines if story.places else [*lines, "    no port of the rigs looked at"])


def rig_text(story: result.RigStory, *, everything: bool = True) -> str:
    """The whole story of a rig; its equations only up to `MOST_EQUATION_LINES`, unless everything
    is wanted."""
    lines = [f"{story.name}: {story.title}"]
    if story.variants:
        lines.append(f"variants: {', '.join(story.name + ':' + v for v in story.variants)}")
    for section in ("What it is", "Typically missing"):
        if story.story.get(section):
            lines += ["", section, textwrap.indent(story.story[section], "    ")]
    for part in ("inputs", "outputs"):
        lines += [
            "",
            part.capitalize(),
            *(
                f"    {row.column}{' (optional)' if getattr(row, 'optional', False) else ''}"
                f"{_in(row.unit)}"
                for row in getattr(story, part)
            ),
        ]
    lines += [
        "",
        "States",
        "    " + (", ".join(f"{s.name}{_in(s.unit)}" for s in story.states) or "none"),
        "",
        "Ports",
    ]
    # ports that differ in nothing but their names are listed together
    alike: dict[str, tuple[list[str], result.RigPort]] = {}
    for port in story.ports:
        rest = port.model_copy(update={"name": "", "group": ""})
        alike.setdefault(repr(rest), ([], port))[0].append(port.name)
    for names, port in alike.values():
        signals = ", ".join(f"{s}{_in(unit)}" for s, unit in port.signals.items())
        places = f" at places {', '.join(port.places)}" if port.places else ""
        lines += wrapped(
            f"{', '.join(names)}: {port.kind}{_in(port.unit)}{places}"
            + (f"; offers {signals}" if signals else ""),
            4,
        )
        lines += wrapped(f"effects: {', '.join(port.effects) or 'none'}", 8)
    if story.no_place:
        lines += ["", "Effects without a port in this rig, and rigs with such a port"]
    for none in story.no_place:
        effects = ", ".join(f"{name} ({title})" for name, title in none.effects.items())
        lines += wrapped(f"{effects}: {', '.join(none.rigs)}, with {none.needs}", 4)
    lines += ["", *wrapped(f"Sign: {SIGN}", 0)]
    lines += ["", "Parameters", *_parameter_lines(story.parameters)]
    lines += ["", *wrapped(f"Hold or release: {HOLD_OR_RELEASE}", 0)]
    if story.on_request:
        lines += wrapped(f"{ON_REQUEST}: {', '.join(story.on_request)}.", 0)
    if story.background:
        lines += ["", "Background (tolerance-sized, in every model compared)"]
    for b in story.background:
        few = len(b.terms) <= MANY_TERMS
        terms = ", ".join(b.terms) if few else f"{b.terms[0]} .. {b.terms[-1]}"
        lines.append(f"    {b.name} at {b.port}: {terms}, sd {b.tolerance:g}")
    equations = []
    for part, title in (
        ("rates", "Equations (SI)"),
        ("ports", "Through the ports"),
        ("outputs", "Outputs"),
        ("where", "where"),
    ):
        if formulas := getattr(story.equations, part):
            equations += ["", title]
            for name, value in formulas.items():
                equations += wrapped(f"{name} = {value}", 4)
    if not everything and len(equations) > MOST_EQUATION_LINES:
        equations = ["", f"Equations (SI): {len(equations)} lines, printed with --all"]
    return "\n".join([*lines, *equations])


def _in(unit: str) -> str:
    return f" [{unit}]" if unit else ""


def _parameter_lines(parameters: Sequence[result.ParameterRow]) -> list[str]:
    lines = []
    for p in parameters:
        low, high = ("-" if v is None else f"{v:g}" for v in (p.low, p.high))
        unit = f" x {p.multiple_of}" if p.multiple_of else (f" {p.unit}" if p.unit else "")
        null = "" if p.null is None else f"; null {p.null:g}"
        held = "" if p.fitted else "; held"
        source = f" - {p.source}" if p.source else ""
        lines += wrapped(f"{p.name}: {p.value:g} ({low} .. {high}){unit}{null}{held}{source}", 4)
    return lines
