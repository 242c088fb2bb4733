"""A sample step as C99: a header and a source, without allocation or globals.

The whole state is in a single struct.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from importlib.resources import files
from itertools import accumulate
from string import Template

from pamid.engine.symbolic.operators import OPERATORS
from pamid.exports.statements import C, ModelFunctions, identifier, identifiers
from pamid.exports.step import SampleStep, Variable


def asset(name: str) -> str:
    """Text of a file in pamid/exports/assets."""
    return (files("pamid.exports") / "assets" / name).read_text(encoding="utf-8")


def model_name(step: SampleStep) -> str:
    """Name of the exported files, functions and types: pamid_one_dof."""
    return identifier(f"pamid_{step.name}")


def file_names(step: SampleStep) -> tuple[str, str, str]:
    """Names of the header, the source and an example host."""
    return f"{model_name(step)}.h", f"{model_name(step)}.c", "main.c"


def c_files(step: SampleStep) -> dict[str, str]:
    """Name -> text of each file."""
    return dict(zip(file_names(step), (header(step), source(step), example(step)), strict=True))


def comment(text: str) -> str:
    """`text` in a form that is safe inside a C comment."""
    plain = text.encode("ascii", "replace").decode()
    return (
        re.sub(r"\s+", " ", plain)
        .replace("*/", "* /")
        .replace("/*", "/ *")
        .replace("\\", "/")
        .replace("??", "? ?")
    )


# ---- header ------------------------------------------------------------------------------------


def header(step: SampleStep) -> str:
    name = model_name(step)
    return Template(asset("model.h")).substitute(
        model=name,
        MODEL=name.upper(),
        title=comment(step.name),
        period=repr(step.period_s),
        inputs=len(step.inputs),
        outputs=len(step.outputs),
        parameters=len(step.parameters),
        places="\n".join(
            _places(step, kind, what)
            for kind, what in (("U", step.inputs), ("Y", step.outputs), ("P", step.parameters))
        ),
        fields="\n".join(f"    {line}" for line in _fields(step)),
    )


def _places(step: SampleStep, kind: str, variables: tuple[Variable, ...]) -> str:
    """Enum of the indices of inputs, outputs or parameters, each with its unit."""
    if not variables:
        return ""
    words = identifiers(v.name.upper() for v in variables)
    lines = [
        f"    {model_name(step).upper()}_{kind}_{word}{',' if v is not variables[-1] else ''}   "
        f"/* {_about(v)} */"
        for word, v in zip(words, variables, strict=True)
    ]
    return "\n".join(["enum {", *lines, "};"])


def _about(v: Variable) -> str:
    parts = [
        v.name,
        v.unit or "-",
        *([v.about] if v.about else []),
        *(["acts on the start only"] if v.fixed else []),
    ]
    return comment(", ".join(parts))


def _fields(step: SampleStep) -> list[str]:
    sizes = {
        "p": (len(step.parameters), "parameters, in the units of their names"),
        "derived": (len(step.derived), "what follows from them"),
        "x": (len(step.states), "states, SI"),
        "cells": (len(step.updates), "memories"),
        "lines": (sum(step.lines), "delay lines"),
    }
    fields = [
        f"double {name}[{size}];   /* {about} */" for name, (size, about) in sizes.items() if size
    ]
    if step.lines:
        fields.append(f"int heads[{len(step.lines)}];")
    return [*fields, "long long samples;   /* since the start */"]


# ---- source ------------------------------------------------------------------------------------


def source(step: SampleStep) -> str:
    name = model_name(step)
    body = "\n\n".join([*_functions(step), _init(step)])
    return Template(asset("model.c")).substitute(
        model=name,
        states=len(step.states),
        period=repr(step.period_s),
        substeps=step.substeps,
        body="\n\n".join([*helpers(body), body]),
        update="        update(m, u, time, m->samples == 0 && s == 0, s == 0);\n"
        if step.updates
        else "",
        look="    update(&now, u, time, m->samples == 0, 1);\n" if step.updates else "",
    )


def helpers(body: str) -> list[str]:
    """Sources of the functions that a text calls and C lacks.

    They are the operators with a file among the assets, and the delay line.
    """
    folder = files("pamid.exports") / "assets"
    names = {o.c: o.c for o in OPERATORS.values() if o.c} | {"delayed": "delay"}
    return [
        asset(f"{file}.c").rstrip()
        for name, file in names.items()
        if (folder / f"{file}.c").is_file() and re.search(rf"\b{name}\(", body)
    ]


def _functions(step: SampleStep) -> list[str]:
    """Functions with the model's equations."""
    name = model_name(step)
    parameters = [f"m->p[{i}]" for i in range(len(step.parameters))]
    work = ModelFunctions(step, C, parameters, "m->derived", "m->cells")
    first = list(accumulate(step.lines, initial=0))

    def delayed(word: str, line: int, value: str, seconds: str) -> str:
        at = f"m->lines + {first[line]}, {step.lines[line]}, &m->heads[{line}]"
        return C.assign.format(word, f"delayed({at}, begin, {value}, {seconds})")

    at = "const double x[], const double u[], double time"
    # None: a function that this model does not need
    bodies: dict[str, list[str] | None] = {
        "static void update(model *m, const double u[], double time, int begin, int fresh)":
            work.updated(delayed) if step.updates else None,
        "static void readings(const model *m, const double u[], double time, double y[])":
            work.stored("y", step.readings),
        f"static void rates(const model *m, {at}, double f[])": work.stored("f", step.rates),
        f"static void slopes(const model *m, {at}, double f[], double J[NX][NX])":
            ["memset(J, 0, NX * sizeof J[0]);", *work.slopes()] if step.implicit else None,
        "": [asset("sdirk2.c" if step.implicit else "rk4.c").rstrip()],
        f"void {name}_prepare(model *m)": work.stored("m->derived", step.derived),
        f"void {name}_start(model *m)": [
            "memset((char *)m + offsetof(model, x), 0, sizeof *m - offsetof(model, x));",
            f"{name}_prepare(m);",
            *work.stored("m->x", step.start),
        ],
    }  # fmt: skip
    return [
        _function(head, lines) if head else lines[0]
        for head, lines in bodies.items()
        if lines is not None
    ]


def _function(head: str, lines: list[str]) -> str:
    """A function; without a given state it has the model's, and unused arguments are marked."""
    text = "\n".join(lines)
    if " x[]" not in head and re.search(r"= x\[", text):
        lines = ["const double *const x = m->x;", *lines]
    unused = [
        f"(void){word};"
        for word in re.findall(r"(\w+)(?:\[\w*\])*[,)]", head)
        if not re.search(rf"\b{word}\b", "\n".join(lines))
    ]
    return "\n".join([head, "{", *(f"    {line}" for line in (*unused, *lines)), "}"])


def _init(step: SampleStep) -> str:
    lines = [f"void {model_name(step)}_init(model *m)", "{"]
    if step.parameters:
        lines += [
            "    static const double p[] = {",
            *(f"        {v.start!r},   /* {comment(v.name)} */" for v in step.parameters),
            "    };",
        ]
    lines += ["", "    memset(m, 0, sizeof *m);"]
    if step.parameters:
        lines.append("    memcpy(m->p, p, sizeof p);")
    return "\n".join([*lines, f"    {model_name(step)}_start(m);", "}"])


def example(step: SampleStep) -> str:
    """Host program that reads and writes CSV."""

    def listed(names: Iterable[str]) -> str:
        return ", ".join(f'"{n}"' for n in names)

    return Template(asset("main.c")).substitute(
        model=model_name(step),
        n_inputs=max(len(step.inputs), 1),
        n_outputs=len(step.outputs),
        inputs=listed(v.name for v in step.inputs) or "NULL",
        outputs=listed(v.name for v in step.outputs),
        starts=", ".join(repr(v.start) for v in step.inputs) or "0.0",
        required=", ".join(str(int(v.required)) for v in step.inputs) or "0",
    )
