"""Implicit step of `pamid.engine.integrator` as ONNX nodes.

It has two SDIRK2 stages, each solved by damped Newton.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pamid.engine.integrator import DAMPED, GAMMA, HALVINGS, LAST_STEP, NEWTON_STEPS
from pamid.exports.onnx_graph import Graph, graph_of

#: a graph and a state (nx,) -> rates (nx,) there, and df/dx (nx, nx)
Rates = Callable[[Graph, str], str]


@dataclass(frozen=True)
class Implicit:
    """x = base + gh f(x) for a state of nx numbers. rates: f at a state; slopes: df/dx there (nx,
    nx)."""

    nx: int
    rates: Rates
    slopes: Rates

    def step(self, g: Graph, state: str, h: float) -> str:
        """State (nx,) after a step of h; NaN if Newton does not converge."""
        gh = g.number(GAMMA * h)
        first = self._newton(g, state, state, gh)
        slope = g.add("Div", g.add("Sub", first, state), gh)
        base = g.add("Add", state, g.add("Mul", g.number((1.0 - GAMMA) * h), slope))
        return self._newton(g, base, first, gh)

    def _newton(self, g: Graph, base: str, guess: str, gh: str) -> str:
        """Newton from a guess, to round-off."""
        from onnx import TensorProto

        b = g.inside()
        count, going, settled, x = (
            g.fresh(stem) for stem in ("iteration", "going", "settled", "x")
        )
        matrix = b.add("Sub", b.array(np.eye(self.nx)), b.add("Mul", gh, self.slopes(b, x)))
        change = _quotient(b, matrix, self._residual(b, base, gh, x), self.nx)
        worst = _largest(b, change, x)
        # a large change is shortened if Newton's next change would not become smaller
        full, shorter = b.inside(), b.inside()
        after = full.add("Add", x, change)
        shortened = self._backtracked(shorter, base, gh, x, matrix, change, worst)
        large = b.add("Squeeze", b.add("Greater", worst, b.number(DAMPED)))
        accepted = b.add(
            "If",
            large,
            then_branch=graph_of(shorter, "shortened", {}, {shortened: (self.nx,)}),
            else_branch=graph_of(full, "whole", {}, {after: (self.nx,)}),
        )
        done = b.add("Squeeze", b.add("Less", worst, b.number(LAST_STEP)))
        unfinished = b.add("Not", done)
        boolean = {name: TensorProto.BOOL for name in (going, unfinished, settled, done)}
        body = graph_of(
            b,
            "newton",
            {count: (), going: (), x: (self.nx,), settled: ()},
            {unfinished: (), accepted: (self.nx,), done: ()},
            types={count: TensorProto.INT64, **boolean},
        )
        solution, fine = g.several(
            "Loop",
            2,
            g.array(NEWTON_STEPS, np.int64),
            g.array(True, np.bool_),
            guess,
            g.array(False, np.bool_),
            body=body,
        )
        return g.choose(fine, solution, g.number(np.nan))

    def _residual(self, g: Graph, base: str, gh: str, x: str) -> str:
        return g.add("Sub", g.add("Add", base, g.add("Mul", gh, self.rates(g, x))), x)

    def _backtracked(
        self, g: Graph, base: str, gh: str, x: str, matrix: str, change: str, worst: str
    ) -> str:
        from onnx import TensorProto

        b = g.inside()
        count, going, trial, reach = (
            g.fresh(stem) for stem in ("iteration", "going", "trial", "reach")
        )
        there = b.add("Add", x, b.add("Mul", reach, change))
        next_change = _quotient(b, matrix, self._residual(b, base, gh, there), self.nx)
        left = _largest(b, next_change, x)
        allowed = b.add(
            "Mul", b.add("Sub", b.number(1.0), b.add("Mul", b.number(0.25), reach)), worst
        )
        too_large = b.add("Not", b.add("Squeeze", b.add("LessOrEqual", left, allowed)))
        halved = b.add("Mul", reach, b.number(0.5))
        body = graph_of(
            b,
            "halving",
            {count: (), going: (), trial: (self.nx,), reach: (1,)},
            {too_large: (), there: (self.nx,), halved: (1,)},
            types={count: TensorProto.INT64, going: TensorProto.BOOL, too_large: TensorProto.BOOL},
        )
        return g.several(
            "Loop",
            2,
            g.array(HALVINGS, np.int64),
            g.array(True, np.bool_),
            x,
            g.number(1.0),
            body=body,
        )[0]


def _largest(g: Graph, change: str, x: str) -> str:
    """Largest relative change (1,)."""
    scale = g.add("Add", g.add("Abs", x), g.number(1e-6))
    return g.add("ReduceMax", g.add("Div", g.add("Abs", change), scale), g.index(0), keepdims=1)


def _quotient(g: Graph, matrix: str, right: str, n: int) -> str:
    """matrix^-1 right (n,), by Gauss-Jordan elimination with partial pivoting."""
    augmented = g.add("Concat", matrix, g.add("Unsqueeze", right, g.index(1)), axis=1)
    rows, numbers = np.arange(n), g.array(np.arange(n), np.int64)
    for k in range(n):
        column = g.add("Abs", g.add("Gather", augmented, g.array(k, np.int64), axis=1))
        open_ones = g.choose(g.array(rows >= k, np.bool_), column, g.number(-1.0))
        pivot = g.add("ArgMax", open_ones, axis=0, keepdims=1)
        order = g.choose(g.add("Equal", numbers, pivot), g.index(k), numbers)
        order = g.choose(g.array(rows == k, np.bool_), pivot, order)
        augmented = g.add("Gather", augmented, order, axis=0)
        row = g.add("Gather", augmented, g.index(k), axis=0)
        row = g.add("Div", row, g.add("Gather", row, g.index(k), axis=1))
        factor = g.add("Gather", augmented, g.index(k), axis=1)
        row_mask = g.array((rows == k)[:, None], np.bool_)
        augmented = g.choose(row_mask, row, g.add("Sub", augmented, g.add("Mul", factor, row)))
    return g.add("Gather", augmented, g.array(n, np.int64), axis=1)
