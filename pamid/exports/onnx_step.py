"""A sample of a flattened model as ONNX nodes: the cell that a host calls, or a Scan repeats."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pamid.base.arrays import Array
from pamid.engine.symbolic.expression import Expr, symbols, walk
from pamid.engine.symbolic.operators import OPERATORS
from pamid.exports.onnx_graph import Graph, Symbol, Values
from pamid.exports.onnx_newton import Implicit
from pamid.exports.step import SampleStep, Update
from pamid.networks.correction.identified_model import GIVEN_PREFIX, MEMORY, VALUE
from pamid.networks.trained_network import TrainedNetwork


@dataclass(frozen=True, eq=False)
class Sampled:
    """A model's sample step, with its network if that is written as a network.

    The state that a host carries is a single vector: the model's states (SI), the memory of its
    cells and its network, its delay lines, and last the number of samples so far.
    """

    step: SampleStep
    network: TrainedNetwork | None

    @cached_property
    def memory_cells(self) -> tuple[str, ...]:
        """Cells whose last value is needed, without those of the network."""
        s = self.step
        used = symbols(
            [*(e for u in s.updates for e in (u.value, u.seconds)), *s.rates, *s.readings]
        )
        return tuple(
            u.name for u in s.updates if ("past", u.name) in used and not self._of_network(u)
        )

    def _of_network(self, update: Update) -> bool:
        return self.network is not None and (update.name == VALUE or update.name.startswith(MEMORY))

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Length of every part of the state vector, in order."""
        memory = 0 if self.network is None else self.network.network.memory_size
        parts = {
            "states": len(self.step.states),
            "cells": len(self.memory_cells),
            "memory": memory,
            **{f"line {i}": size for i, size in enumerate(self.step.lines)},
            "samples": 1,
        }
        return {name: size for name, size in parts.items() if size}

    @cached_property
    def parameter_values(self) -> dict[Symbol, float]:
        """Parameters, and quantities derived from them."""
        values: dict[Symbol, float] = {("parameter", v.name): v.start for v in self.step.parameters}
        for i, root in enumerate(self.step.derived):
            values["derived", str(i)] = _number(root, values)
        return values

    @property
    def start(self) -> Array:
        """State vector before the first sample."""
        begin = [_number(e, self.parameter_values) for e in self.step.start]
        return np.array(begin + [0.0] * (sum(self.sizes.values()) - len(begin)))

    def nodes(self, g: Graph, inputs: str, state: str) -> tuple[str, str]:
        """Outputs (ny,) and next state, both vectors, for inputs (nu,) and state."""
        s = self.step
        part = dict(zip(self.sizes, g.parts(state, self.sizes.values()), strict=True))
        fixed = {key: g.number(value) for key, value in self.parameter_values.items()}
        given = dict(
            zip(
                (("input", v.name) for v in s.inputs), g.numbers(inputs, len(s.inputs)), strict=True
            )
        )
        first = g.add("Equal", part["samples"], g.number(0.0))
        since = g.add("Mul", part["samples"], g.number(s.period_s))
        now = dict(
            zip(
                self.memory_cells,
                g.numbers(part["cells"], len(self.memory_cells)) if self.memory_cells else (),
                strict=True,
            )
        )
        outputs = ""
        for sub in range(s.substeps):
            begin = g.add("Cast", first, to=11) if sub == 0 else g.number(0.0)
            ticks: dict[Symbol, str] = {
                ("tick", "time"): g.add("Add", since, g.number(sub * s.step_s)),
                ("tick", "begin"): begin,
                ("tick", "fresh"): g.number(float(sub == 0)),
            }
            past = {("past", n): t for n, t in now.items()}
            held = Values(g, {**fixed, **given, **ticks, **past})
            values = Values(g, self._states(g, part["states"]), held)
            now = self._updated(g, values, part, now, first, sub)
            if sub == 0:
                outputs = g.joined([values(e) for e in s.readings])
            part["states"] = self._moved(g, values, held, part["states"])
        part["samples"] = g.add("Add", part["samples"], g.number(1.0))
        if self.memory_cells:
            part["cells"] = g.joined([now[n] for n in self.memory_cells])
        return outputs, g.joined(list(part.values()))

    def _states(self, g: Graph, vector: str) -> dict[Symbol, str]:
        names = self.step.states
        return dict(zip((("state", n) for n in names), g.numbers(vector, len(names)), strict=True))

    def _updated(
        self,
        g: Graph,
        values: Values,
        part: dict[str, str],
        before: dict[str, str],
        first: str,
        sub: int,
    ) -> dict[str, str]:
        """Update all cells at the beginning of a substep, by name.

        The network's memory and the delay lines advance, too.
        """
        after: dict[str, str] = {}
        for update in self.step.updates:
            if not self._of_network(update):
                value = values(update.value)
                if update.line >= 0:
                    value = self._delayed(g, values, part, update, value, first if sub == 0 else "")
            elif update.name != VALUE:
                continue
            elif sub == 0:
                value = self._network(g, after, part, first)
            else:
                value = before[VALUE]
            after[update.name] = value
            assert values.around is not None
            values.around.know(("cell", update.name), value)
        return after

    def _network(self, g: Graph, cells: dict[str, str], part: dict[str, str], first: str) -> str:
        assert self.network is not None
        given = g.joined(
            [cells[f"{GIVEN_PREFIX}{i}"] for i in range(len(self.network.input_names))]
        )
        value, memory = self.network.network.onnx_nodes(
            g, self.network.weights, given, part.get("memory", ""), first
        )
        if "memory" in part:
            part["memory"] = memory
        return value

    def _delayed(
        self, g: Graph, values: Values, part: dict[str, str], update: Update, value: str, first: str
    ) -> str:
        """Put a value into its delay line, newest first.

        The result is the value `seconds` ago, linear between steps.
        """
        name, size = f"line {update.line}", self.step.lines[update.line]
        older = g.parts(part[name], [size - 1, 1])[0]
        line = g.joined([value, older])
        if first:
            line = g.choose(first, value, line)
        part[name] = line
        steps = g.add("Div", values(update.seconds), g.number(self.step.step_s))
        place = g.add("Min", g.add("Max", steps, g.number(0.0)), g.number(size - 2.0))
        steps_back = g.add("Floor", place)
        at = g.add("Cast", steps_back, to=7)
        near, far = (g.add("Gather", line, i, axis=0) for i in (at, g.add("Add", at, g.index(1))))
        share = g.add("Sub", place, steps_back)
        rest = g.add("Sub", g.number(1.0), share)
        return g.add("Add", g.add("Mul", rest, near), g.add("Mul", share, far))

    # ---- states ---------------------------------------------------------------------------------

    def _moved(self, g: Graph, symbols: Values, held: Values, state: str) -> str:
        """States after a substep; `symbols` are values at its beginning."""
        s, h, nx = self.step, self.step.step_s, len(self.step.states)
        if not s.implicit:
            return self._runge_kutta(g, symbols, held, state)

        def rates(inner: Graph, x: str) -> str:
            values = Values(inner, self._states(inner, x), held)
            return inner.joined([values(e) for e in s.rates])

        def slopes(inner: Graph, x: str) -> str:
            values = Values(inner, self._states(inner, x), held)
            entries = {(i, j): values(e) for i, j, e in s.slopes}
            zero = inner.number(0.0)
            flat = inner.joined([entries.get((i, j), zero) for i in range(nx) for j in range(nx)])
            return inner.add("Reshape", flat, inner.index(nx, nx))

        return Implicit(nx, rates, slopes).step(g, state, h)

    def _runge_kutta(self, g: Graph, symbols: Values, held: Values, state: str) -> str:
        h, moved, values = self.step.step_s, "", symbols
        for stage in range(4):
            slope = g.joined([values(e) for e in self.step.rates])
            part = g.add("Mul", slope, g.number(h / 6.0 if stage in (0, 3) else h / 3.0))
            moved = g.add("Add", moved, part) if moved else part
            if stage < 3:
                there = g.add(
                    "Add", state, g.add("Mul", slope, g.number(0.5 * h if stage < 2 else h))
                )
                values = Values(g, self._states(g, there), held)
        return g.add("Add", state, moved)


def _number(root: Expr, known: dict[Symbol, float]) -> float:
    """Value of an expression with known symbols; it may be infinite or NaN."""
    values: dict[Expr, float] = {}
    with np.errstate(all="ignore"):
        for node in walk([root]):
            arguments = [np.float64(values[a]) for a in node.args]
            if node.op == "const":
                values[node] = node.value
            elif node.op == "symbol":
                values[node] = known[node.value]
            elif node.op == "where":
                values[node] = float(arguments[1] if arguments[0] else arguments[2])
            else:
                values[node] = float(getattr(np, OPERATORS[node.op].numpy)(*arguments))
    return values[root]
