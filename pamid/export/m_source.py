"""A sample step as one MATLAB function file.

It suits MATLAB, Simulink's code generation and GNU Octave.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import accumulate
from string import Template

from pamid.export.c_source import asset, comment
from pamid.export.statements import MATLAB, Statements, Symbol, Writer, identifiers
from pamid.export.step import SampleStep, Variable
from pamid.symbolic.expression import Expr


def m_file(step: SampleStep, name: str) -> str:
    """Text of <name>.m."""
    work = _MatlabFunctions(step)
    parts = [work.update()] if step.updates else []
    parts += [
        work.readings(),
        work.rates(),
        *([work.slopes()] if step.implicit else []),
        asset("sdirk2.m" if step.implicit else "rk4.m").rstrip(),
        work.derive(),
        work.start(),
        work.parameters(),
        *([asset("delay.m").rstrip()] if step.lines else []),
        asset("helpers.m").rstrip(),
    ]
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


class _MatlabFunctions:
    """Functions with the model's equations."""

    def __init__(self, step: SampleStep) -> None:
        self.step = step
        names = [v.name for v in step.parameters]
        self.fields = dict(zip(names, identifiers(names), strict=True))
        places: dict[Symbol, str] = {("tick", t): t for t in ("time", "begin", "fresh")}
        places |= {("state", n): f"x({i})" for i, n in enumerate(step.states, 1)}
        places |= {("input", v.name): f"u({i})" for i, v in enumerate(step.inputs, 1)}
        places |= {("parameter", name): f"s.p.{field}" for name, field in self.fields.items()}
        places |= {("derived", str(i)): f"d({i + 1})" for i in range(len(step.derived))}
        for space in ("cell", "past"):
            places |= {(space, c.name): f"s.cells({i})" for i, c in enumerate(step.updates, 1)}
        self.writer = Writer(MATLAB, places)

    def update(self) -> str:
        """Cells, one after the other."""
        step, cells, words = self.step, self.step.updates, self.writer.words
        ends = list(accumulate(step.lines, initial=0))

        def write(work: Statements) -> None:
            for c in cells:
                if c.line < 0:
                    work.name(c.value, words["cell", c.name])
                    continue
                line, head = (
                    f"s.lines({ends[c.line] + 1}:{ends[c.line + 1]})",
                    f"s.heads({c.line + 1})",
                )
                value, seconds = work.value(c.value), work.value(c.seconds)
                call = f"delayed({line}, {head}, begin, {value}, {seconds}, {step.step_s!r})"
                work.lines.append(f"[{words['cell', c.name]}, {line}, {head}] = {call};")
            work.lines += [
                f"s.cells({i}) = {words['cell', c.name]};" for i, c in enumerate(cells, 1)
            ]

        roots = [e for c in cells for e in (c.value, c.seconds)]
        return _function(
            "s = update(s, x, u, time, d, begin, fresh)",
            self.writer.lines(roots, write, [("cell", c.name) for c in cells]),
        )

    def readings(self) -> str:
        return _function(
            "y = readings(s, x, u, time, d)",
            [
                f"y = zeros(1, {len(self.step.readings)});",
                *self.writer.values(*_numbered("y", self.step.readings)),
            ],
        )

    def rates(self) -> str:
        return _function(
            "f = rates(s, x, u, time, d)",
            ["f = zeros(size(x));", *self.writer.values(*_numbered("f", self.step.rates))],
        )

    def slopes(self) -> str:
        """Rates, and their derivatives by the states."""
        partials = (
            (f"J({row + 1}, {column + 1})", value) for row, column, value in self.step.slopes
        )
        return _function(
            "[f, J] = slopes(s, x, u, time, d)",
            [
                "f = zeros(size(x));",
                "J = zeros(numel(x));",
                *self.writer.values(*_numbered("f", self.step.rates), *partials),
            ],
        )

    def derive(self) -> str:
        """Quantities that only depend on the parameters."""
        return _function(
            "d = derive(s)",
            [
                f"d = zeros(1, {len(self.step.derived)});",
                *self.writer.values(*_numbered("d", self.step.derived)),
            ],
        )

    def start(self) -> str:
        step = self.step
        fields = {
            "p": "p",
            "x": f"zeros({len(step.states)}, 1)",
            "cells": f"zeros(1, {len(step.updates)})",
            "lines": f"zeros(1, {sum(step.lines)})",
            "heads": f"zeros(1, {len(step.lines)})",
            "samples": "0",
        }
        return _function(
            "s = start(p)",
            [
                f"s = struct({', '.join(f'{name!r}, {value}' for name, value in fields.items())});",
                *self.writer.values(*_numbered("s.x", step.start)),
            ],
        )

    def parameters(self) -> str:
        lines = [
            f"p.{self.fields[v.name]} = {v.start!r};   % {_about(v)}" for v in self.step.parameters
        ]
        return _function("p = parameters()", ["p = struct();", *lines])


def _about(v: Variable) -> str:
    return comment(", ".join([v.name, *([v.about] if v.about else [])]))


def _numbered(array: str, values: Iterable[Expr]) -> list[tuple[str, Expr]]:
    return [(f"{array}({i})", value) for i, value in enumerate(values, 1)]


def _function(head: str, lines: list[str]) -> str:
    return "\n".join([f"function {head}", *lines, "end"])
