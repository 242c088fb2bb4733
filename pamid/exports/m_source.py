"""A sample step as a single MATLAB function file.

It suits MATLAB, Simulink's code generation and GNU Octave.
"""

from __future__ import annotations

from itertools import accumulate
from string import Template

from pamid.exports.c_source import asset, comment
from pamid.exports.statements import MATLAB, ModelFunctions, identifiers
from pamid.exports.step import SampleStep, Variable


def m_file(step: SampleStep, name: str) -> str:
    """Text of <name>.m."""
    names = [v.name for v in step.parameters]
    fields = dict(zip(names, identifiers(names), strict=True))
    work = ModelFunctions(step, MATLAB, [f"s.p.{f}" for f in fields.values()], "d", "s.cells")
    ends = list(accumulate(step.lines, initial=0))

    def delayed(word: str, number: int, value: str, seconds: str) -> str:
        line, head = f"s.lines({ends[number] + 1}:{ends[number + 1]})", f"s.heads({number + 1})"
        call = f"delayed({line}, {head}, begin, {value}, {seconds}, {step.step_s!r})"
        return f"[{word}, {line}, {head}] = {call};"

    rates, slopes = "f = zeros(size(x));", "J = zeros(numel(x));"
    start = {
        "p": "p",
        "x": f"zeros({len(step.states)}, 1)",
        "cells": f"zeros(1, {len(step.updates)})",
        "lines": f"zeros(1, {sum(step.lines)})",
        "heads": f"zeros(1, {len(step.lines)})",
        "samples": "0",
    }
    begun = f"s = struct({', '.join(f'{name!r}, {value}' for name, value in start.items())});"
    known = [f"p.{fields[v.name]} = {v.start!r};   % {_about(v)}" for v in step.parameters]
    parts = [
        *([_function("s = update(s, x, u, time, d, begin, fresh)", work.updated(delayed))]
          if step.updates else []),
        _function("y = readings(s, x, u, time, d)",
                  [f"y = zeros(1, {len(step.readings)});", *work.stored("y", step.readings)]),
        _function("f = rates(s, x, u, time, d)", [rates, *work.stored("f", step.rates)]),
        *([_function("[f, J] = slopes(s, x, u, time, d)", [rates, slopes, *work.slopes()])]
          if step.implicit else []),
        asset("sdirk2.m" if step.implicit else "rk4.m").rstrip(),
        _function("d = derive(s)",
                  [f"d = zeros(1, {len(step.derived)});", *work.stored("d", step.derived)]),
        _function("s = start(p)", [begun, *work.stored("s.x", step.start)]),
        _function("p = parameters()", ["p = struct();", *known]),
        *([asset("delay.m").rstrip()] if step.lines else []),
        asset("helpers.m").rstrip(),
    ]  # fmt: skip
    update = (
        "    s = update(s, s.x, u, time, d, double(s.samples == 0 && part == 1), double(part "
        "== 1));\n"
    )
    return Template(asset("model.m")).substitute(
        model=name,
        MODEL=name.upper(),
        title=comment(step.name),
        period=repr(step.period_s),
        inputs=comment(", ".join(v.name for v in step.inputs)) or "none",
        outputs=comment(", ".join(v.name for v in step.outputs)),
        n_outputs=len(step.outputs),
        substeps=step.substeps,
        update=update if step.updates else "",
        functions="\n\n".join(parts),
    )


def _about(v: Variable) -> str:
    return comment(", ".join([v.name, *([v.about] if v.about else [])]))


def _function(head: str, lines: list[str]) -> str:
    return "\n".join([f"function {head}", *lines, "end"])
