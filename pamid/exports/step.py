"""An identified model flattened to the computation of a sample, in the units of its columns: the
ground of every export.

A sample, as `pamid.engine.integrator.sweep` does it, with the inputs held:
    substeps times
        the cells, in order, from the state, the inputs and their past; a delay line takes in
            its value and returns the value `seconds` ago, linear between steps
        first time only: the outputs
        the states by a Runge-Kutta step of order 4, or an SDIRK2 step with damped Newton where
            `implicit`
Symbols of the expressions: state, cell (after its update), past (before it), input and parameter
(in the units of their names), derived (what follows from the parameters alone) and the ticks time
(s since the start), fresh (1 at the first substep) and begin (1 at the very first).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from math import ceil, isclose, nan

from pamid.base.errors import PamidError, UsageError
from pamid.base.units import NONE, as_column, quantity_of, split_column, unit
from pamid.engine.llvm_ir import extract_derived, with_partials
from pamid.engine.symbolic.expression import (
    ONE,
    ZERO,
    Expr,
    add,
    const,
    div,
    expression,
    mul,
    plain,
    sub,
    substitute,
    symbol,
    symbols,
)
from pamid.engine.symbolic.memory_cells import StateEquations, cell_update, tick
from pamid.model.bound_parameter import Bound
from pamid.model.rig import Rig
from pamid.model.step_rig import StepRig
from pamid.model.trace import Names
from pamid.networks.correction.identified_model import UNCORRECTED, Identified
from pamid.simulation.excitation.experiments import held_level

# dummy state of a model without states, because no target language has vectors of length 0
STILL = "still"
ROOM_K = 293.15


@dataclass(frozen=True)
class Variable:
    """An external input, output or parameter.

    unit      symbol, "" for none
    start     in that unit; of an output NaN: it follows from the rest
    fixed     a parameter that only acts on the start
    required  an input without which the model cannot run
    """

    name: str
    unit: str
    start: float
    about: str = ""
    fixed: bool = False
    required: bool = False


@dataclass(frozen=True)
class Update:
    """New value of a cell.

    A delay line (line >= 0) stores `value` and gives the cell the value `seconds` ago.
    """

    name: str
    value: Expr
    line: int = -1
    seconds: Expr = ZERO


@dataclass(frozen=True, eq=False)
class SampleStep:
    """See the module.

    slopes: (row, column, d rate / d state), if implicit; lines: number of values in each delay
    line.
    """

    name: str
    period_s: float
    substeps: int
    implicit: bool
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    parameters: tuple[Variable, ...]
    states: tuple[str, ...]
    start: tuple[Expr, ...]
    derived: tuple[Expr, ...]
    updates: tuple[Update, ...]
    rates: tuple[Expr, ...]
    readings: tuple[Expr, ...]
    slopes: tuple[tuple[int, int, Expr], ...]
    lines: tuple[int, ...]

    @property
    def step_s(self) -> float:
        return self.period_s / self.substeps

    def feedthrough(self) -> tuple[tuple[str, ...], ...]:
        """Inputs that each output depends on at the same instant."""
        behind: dict[str, set[str]] = {}

        def reached(roots: list[Expr]) -> set[str]:
            used = symbols(roots)
            through = (behind[name] for space, name in used if space == "cell")
            return {name for space, name in used if space == "input"}.union(*through)

        for update in self.updates:
            behind[update.name] = reached([update.value, update.seconds])
        needs = [reached([reading]) for reading in self.readings]
        return tuple(tuple(v.name for v in self.inputs if v.name in need) for need in needs)


@dataclass(frozen=True)
class _Owned:
    """A parameter of the model, or of its uncorrected version: its symbol and its external name."""

    key: str
    name: str
    bound: Bound
    value: float

    @property
    def surface(self) -> Expr:
        """SI value from the external value."""
        return mul(symbol("parameter", self.name), self.bound.factor)

    def variable(self, running: set[str]) -> Variable:
        b = self.bound
        return Variable(
            self.name, b.unit, self.value / b.factor, b.source, fixed=self.name not in running
        )


def step_of(model: Identified) -> SampleStep:
    """Flatten a model. UsageError if its network needs the control loop."""
    if model.network is not None and model.network.in_loop:
        raise UsageError(
            "This network corrects the model in its control loop, not on given commands.",
            "Leave it out with --which refitted.",
        )
    if isinstance(model.assembly.rig, StepRig):
        raise UsageError(
            f"Rig {model.assembly.rig.name!r} is stepped by its simulation: it has no "
            "equations that could be exported.",
            "Run it with `pamid simulate --model`.",
        )
    if moving := model.equations.linear:
        raise UsageError(
            f"{', '.join(moving)} is linear between samples in this "
            "model, and an exported step is not given the next input.",
            "Run it with `pamid simulate --model`, or fit with the input held: "
            f'between = {{"{moving[0]}": "held"}} in the rig file, or [between] in the TOML.',
        )
    stepping, lowered = model.stepping, model.lowered
    parts = {"": (model.assembly, model.values)}
    if model.uncorrected:
        parts[UNCORRECTED] = model.uncorrected
    owned = [
        _Owned(prefix + b.key, prefix + b.full_name, b, float(value))
        for prefix, (assembly, values) in parts.items()
        for b, value in zip(assembly.parameters, values, strict=True)
    ]
    h = model.period_s / stepping.substeps
    outside = {symbol("parameter", o.key): o.surface for o in owned}
    settled = {
        tick("step"): const(h),
        tick("period"): const(model.period_s),
        tick("join"): ZERO,
        **outside,
    }
    if stepping.substeps == 1:
        settled[tick("fresh")] = ONE
    settled |= {
        symbol("input", name): _si(symbol("input", name), split_column(name)[1])
        for name in model.inputs
    }
    readings = [
        _shown(value, split_column(name)[1])
        for name, value in zip(model.outputs, lowered.outputs, strict=True)
    ]
    slopes = _slopes(lowered) if stepping.implicit else []
    groups = [
        [cell.update if cell.buffer_s else cell_update(cell) for cell in lowered.cells],
        [ZERO if cell.seconds is None else cell.seconds for cell in lowered.cells],
        list(lowered.rates),
        readings,
        [value for _, _, value in slopes],
    ]
    (values, seconds, rates, readings, partials), derived = extract_derived(
        [substitute(plain(g), settled) for g in groups]
    )
    lines = {cell.name: ceil(cell.buffer_s / h) + 3 for cell in lowered.cells if cell.buffer_s}
    start = substitute(_start(model, owned), outside)
    begins = model.assembly.begin(model.values)
    running = _parameters([*derived, *values, *seconds, *rates, *readings, *partials])
    needed = running | _parameters(start)
    return SampleStep(
        model.name,
        model.period_s,
        stepping.substeps,
        stepping.implicit,
        tuple(_input(model.assembly.rig, name, begins) for name in model.inputs),
        tuple(_column(name, nan) for name in model.outputs),
        tuple(o.variable(running) for o in owned if o.name in needed),
        lowered.states or (STILL,),
        tuple(start) or (ZERO,),
        tuple(derived),
        tuple(
            Update(
                cell.name, value, list(lines).index(cell.name) if cell.name in lines else -1, wait
            )
            for cell, value, wait in zip(lowered.cells, values, seconds, strict=True)
        ),
        tuple(rates) or (ZERO,),
        tuple(readings),
        tuple((row, column, v) for (row, column, _), v in zip(slopes, partials, strict=True)),
        tuple(lines.values()),
    )


def _parameters(roots: Iterable[Expr]) -> set[str]:
    return {name for space, name in symbols(roots) if space == "parameter"}


def _si(value: Expr, shown: str) -> Expr:
    kind = unit(shown)
    return add(mul(value, kind.factor), kind.offset)


def _shown(value: Expr, shown: str) -> Expr:
    kind = unit(shown)
    return div(sub(value, kind.offset), kind.factor)


def _column(name: str, start: float) -> Variable:
    shown = split_column(name)[1]
    return (
        Variable(name, "", start)
        if shown == NONE
        else Variable(name, shown, start, quantity_of(shown))
    )


def _input(rig: Rig, name: str, begins: Mapping[str, float]) -> Variable:
    """An input with its value before the first command.

    It is the default of the input, else the usual value in the rig. A temperature without either
    begins at the temperature of a state of the rig; begins: these by name, SI.
    """
    if name in rig.optional:
        return _column(name, as_column(name, rig.optional[name]))
    level = held_level(rig, name)
    if level is None:
        warm = (begins[s.name] for s in rig.states if s.unit == "K" and begins[s.name] > 0.0)
        level = as_column(name, next(warm, ROOM_K))
    return replace(_column(name, level), required=True)


def _slopes(equations: StateEquations) -> list[tuple[int, int, Expr]]:
    """Non-zero d rate / d state."""
    places = {name: i for i, name in enumerate(equations.states)}
    beyond = len(places)

    def column(space: str, name: str) -> int:
        return places[name] if space == "state" else beyond

    values, pointer, columns = with_partials(list(equations.rates), column, frozenset())
    first = len(equations.rates)
    return [
        (row, columns[e], values[first + e])
        for row in range(first)
        for e in range(pointer[row], pointer[row + 1])
        if columns[e] < beyond
    ]


def _start(model: Identified, owned: list[_Owned]) -> list[Expr]:
    """Initial state as a function of the parameters (SI), or as a number if it does not depend on
    them."""
    rig, formulas = model.assembly.rig, dict[str, Expr]()
    for prefix in ("", UNCORRECTED):
        symbols = {
            b.key: symbol("parameter", prefix + b.key)
            for b in model.assembly.parameters
            if not b.owner
        }
        try:
            given = rig.start(Names(symbols, "parameter"))
            formulas |= {
                prefix + s.name: expression(given.get(s.name, s.start)) for s in rig.states
            }
        except (PamidError, ArithmeticError, TypeError, ValueError):
            pass  # start() may use operations that symbols do not support
    numbers = {symbol("parameter", o.key): const(o.value) for o in owned}
    starts = []
    for name, value in zip(model.lowered.states, model.start.tolist(), strict=True):
        formula = formulas.get(name, const(value))
        (check,) = substitute([formula], numbers)
        starts.append(formula if isclose(float(check), value, rel_tol=1e-12) else const(value))
    return starts
