"""Equations of a rig with effects made executable: compiled, and where the rig is stepped, compiled
around its simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any, TypeAlias, cast

from pamid.base.errors import UsageError
from pamid.engine.lane_program import LaneProgram, build_lane_program
from pamid.engine.program import Program, build_program
from pamid.engine.serial_lanes import SerialLanes
from pamid.engine.stepped import SteppedProgram
from pamid.engine.symbolic.expression import ZERO, substitute, symbol, walk
from pamid.engine.symbolic.memory_cells import Cell, StateEquations, expand_memory
from pamid.engine.symbolic.vocabulary import Expr
from pamid.model.rig import Rig
from pamid.model.step_rig import SIMULATED, RigSimulator, StepRig
from pamid.model.trace import Traced

Executable: TypeAlias = Program | SteppedProgram


def program_of(
    rig: Rig,
    traced: Traced,
    outputs: Mapping[str, Expr],
    parameters: tuple[str, ...],
    sensitive: frozenset[str] | None = None,
) -> Executable:
    """Program of these outputs; parameters: all keys, the rig's first. See
    `pamid.engine.program.build_program`."""
    if isinstance(rig, StepRig):
        return _stepped(rig, traced, outputs, parameters, sensitive)
    return build_program(
        _lowered(traced, outputs),
        traced.inputs,
        parameters,
        tuple(outputs),
        sensitive,
        traced.linear,
    )


def lane_program_of(
    rig: Rig, traced: Traced, outputs: Mapping[str, Expr], parameters: tuple[str, ...]
) -> LaneProgram:
    """The same for several hypotheses side by side, or in sequence where a simulator steps
    the rig."""
    if isinstance(rig, StepRig):
        serial = SerialLanes(_stepped(rig, traced, outputs, parameters, frozenset()))
        return cast(LaneProgram, serial)  # it has the same methods
    lowered = _lowered(traced, outputs)
    return build_lane_program(lowered, traced.inputs, parameters, tuple(outputs), traced.linear)


def _lowered(traced: Traced, outputs: Mapping[str, Expr]) -> StateEquations:
    return _expanded(
        tuple(traced.rates.items()), tuple(outputs.items()), traced.cells, traced.linear
    )


@lru_cache(maxsize=32)
def _expanded(
    rates: tuple[tuple[str, Expr], ...],
    outputs: tuple[tuple[str, Expr], ...],
    cells: tuple[Cell, ...],
    linear: tuple[str, ...],
) -> StateEquations:
    """`expand_memory`; a fit needs the same equations several times."""
    return expand_memory(dict(rates), dict(outputs), cells, linear)


def _stepped(
    rig: StepRig,
    traced: Traced,
    outputs: Mapping[str, Expr],
    parameters: tuple[str, ...],
    sensitive: frozenset[str] | None,
) -> SteppedProgram:
    equation_states = tuple(rig.differential_states())
    simulated = [e for e in traced.rates.values() if e.op == SIMULATED]
    if len(simulated) > len(equation_states):
        raise UsageError(
            f"rig {rig.name!r} is stepped: a model cannot contain it twice",
            "a correction at a port needs a rig with equations; a correction of a channel does not",
        )
    goes_in: dict[str, Expr] = {}
    for node in simulated:
        used, into = node.value[2:]
        goes_in |= dict(zip(used, node.args[len(node.args) - len(used) :], strict=True))
    parts = [e for c in traced.cells for e in (c.update, c.start)]
    read = {
        node: symbol("state", f"read.{node.value[1]}")
        for node in walk([*traced.rates.values(), *outputs.values(), *parts])
        if node.op == SIMULATED and node.value[0] == "read"
    }
    held = {f"read.{name}": ZERO for name in rig.readings} | dict.fromkeys(equation_states, ZERO)
    far = rig.far_runner()
    simulator: Any = far if rig.carries else RigSimulator(rig, into)
    rates = {name: e for name, e in traced.rates.items() if name not in equation_states}
    around = {**outputs, **{f"into.{name}": goes_in[name] for name in into}}
    expressions = iter(substitute([*rates.values(), *around.values()], read))
    rates = held | {name: next(expressions) for name in rates}
    around = {name: next(expressions) for name in around}
    cells = []
    for c in traced.cells:
        update, start = substitute([c.update, c.start], read)
        cells.append(replace(c, update=update, start=start))
    lowered = expand_memory(rates, around, tuple(cells), traced.linear)
    return SteppedProgram(
        simulator,
        build_program(lowered, traced.inputs, parameters, tuple(around), sensitive, traced.linear),
        len(rig.readings),
        len(rig.states),
        len(into),
        len(rig.parameters),
        far,
    )
