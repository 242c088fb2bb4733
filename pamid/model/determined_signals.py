"""Effects whose signals the recordings determine.

A state is determined where a measured output depends on it, or the rate of another determined state
does, or where it acts back on its rate. The absolute angle of a shaft of which only the speed is
measured is not: its rate is known, its zero is not. An effect that acts on increments alone (a
bristle, a stop) needs no zero and stays. One that acts on the value itself (a spring, cogging)
would be fitted to a zero that each window chooses anew.

Whether an expression changes when an undetermined state is shifted by s is found by passing s
through it. Every node is c s off: c is an expression, and nodes that are shifted otherwise than in
proportion to s are `ABSOLUTE`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from functools import cached_property
from typing import Any

from pamid.base.errors import FileError
from pamid.model.attachment import Attachment
from pamid.model.effect import Effect
from pamid.model.rig import Rig
from pamid.model.step_rig import SIMULATED, StepRig
from pamid.model.trace import Passage, Traced, trace
from pamid.symbolic.expression import ONE, ZERO, symbol, symbols, walk
from pamid.symbolic.vocabulary import Expr

NOT_MEASURED = "it changes nothing that was measured"
ABSOLUTE = None  # an expression that depends on the shifted value itself
SHIFTED_ALONG = frozenset({"play", "lag", "delay"})  # memories that follow a constant shift


def determined(
    rig: Rig, outputs: Collection[str], still: Collection[str], candidates: Iterable[Attachment]
) -> tuple[list[Attachment], dict[str, str]]:
    """Return the candidates whose signals are determined, and why the others are left out.

    Parameters
    ----------
    rig
        Rig that the candidates attach to.
    outputs
        Its measured outputs.
    still
        Inputs that are 0 in all recordings.
    candidates
        Effects at their ports.

    Returns
    -------
    list of Attachment, dict of label to reason
    """
    plain = trace(rig, lambda port, place: [], {})
    stepped = isinstance(rig, StepRig)  # its equations are not known
    check = None if stepped else _Determination(rig, tuple(outputs), plain)
    usable, reasons = list[Attachment](), dict[str, str]()
    for candidate in candidates:
        reason = _still(plain, candidate, frozenset(still))
        if not reason and check:
            reason = check.objection(candidate)
        if reason:
            reasons[candidate.label] = reason
        else:
            usable.append(candidate)
    return usable, reasons


def undetermined_states(traced: Traced, outputs: Collection[str]) -> frozenset[str]:
    """Integrator states on which neither these outputs depend nor the rates of states that they
    depend on. What acts back on its rate forgets where it started: a filter is determined by what
    it filters."""
    loose = unobserved_states(traced, outputs)
    return frozenset(n for n in loose if n not in _reached(traced, [traced.rates[n]]))


def unobserved_states(traced: Traced, outputs: Collection[str]) -> frozenset[str]:
    """States on which none of these outputs depends, at once or through rates."""
    return frozenset(traced.rates) - _reached(traced, [traced.outputs[o] for o in outputs])


def _reached(traced: Traced, roots: Iterable[Expr]) -> set[str]:
    """States on which these expressions depend, at once or through rates."""
    reached: set[str] = set()
    waiting = list(roots)
    while waiting:
        states = {name for space, name in symbols([waiting.pop()]) if space == "state"}
        waiting += [traced.rates[name] for name in states - reached if name in traced.rates]
        reached |= states
    return reached


def _still(plain: Traced, candidate: Attachment, still: frozenset[str]) -> str:
    """The input at rest that alone drives the effect; empty where something else does."""
    passed = [q for q in plain.passages if candidate.acts_at(q.port, q.place)]
    driving = [[q.value for q in passed]]
    driving += [_signal(passed, candidate.effect, name) for name in candidate.effect.signals]
    for sources in driving:
        at_rest = [_inputs_alone(root) for root in sources]
        if at_rest and all(inputs and inputs <= still for inputs in at_rest):
            names = sorted(set().union(*at_rest))
            return f"{' and '.join(names)} is 0 in all recordings"
    return ""


def _signal(passed: list[Passage], effect: Effect, name: str) -> list[Expr]:
    """A signal of the effect, under the name that each port offers it."""
    values = []
    for q in passed:
        offered = dict(q.signals)
        value = offered.get(effect.offered_as(name, set(offered)))
        values += [value] if isinstance(value, Expr) else []
    return values


def _inputs_alone(root: Expr) -> frozenset[str]:
    """The inputs that an expression depends on; none where it depends on something else that
    moves."""
    leaves = symbols([root])
    moving = {space for space, _ in leaves} - {"input", "parameter"}
    if moving or any(node.op == SIMULATED for node in walk([root])):
        return frozenset()
    return frozenset(name for space, name in leaves if space == "input")


class _Mark(Effect):
    """Anything that an effect may add to a value."""

    name = "mark"

    def __init__(self, at: str) -> None:
        self.at = at

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Expr:
        return value + symbol("mark", self.at)


class _Determination:
    """Signals of a rig that its measured outputs determine.

    Tracing a robot with each of its candidates would cost more than screening them. Whether an
    effect integrates a signal is the same at all ports of a kind; whether a port reaches the
    outputs is seen for all ports at once.
    """

    def __init__(self, rig: Rig, outputs: tuple[str, ...], plain: Traced) -> None:
        self.rig, self.outputs = rig, outputs
        self.loose = undetermined_states(plain, outputs)
        self.integrals = _integrals([*plain.rates.values(), *plain.outputs.values()])
        self.plainly_acting: set[tuple[str, str, str]] = set()

    @cached_property
    def reaching(self) -> set[str]:
        """Ports, with their places, on which an output depends."""
        marked = trace(self.rig, lambda port, place: [("mark", _Mark(f"{port} {place}"))], {})
        return {name for space, name in symbols(self.roots(marked)[0]) if space == "mark"}

    def roots(self, traced: Traced) -> tuple[list[Expr], set[str]]:
        """Outputs and the rates of the determined states that they depend on; all such states."""
        roots = [traced.outputs[name] for name in self.outputs]
        reached = _reached(traced, roots)
        rates = sorted(name for name in reached - self.loose if name in traced.rates)
        return roots + [traced.rates[name] for name in rates], reached

    def objection(self, candidate: Attachment) -> str:
        """The signal on whose zero the effect's action rests and that nothing determines; empty
        where there is none."""
        port = self.rig.ports[candidate.ports[0]]
        kind = candidate.effect.name, port.kind, port.unit
        if kind in self.plainly_acting:
            places = [
                f"{name} {place}"
                for name in candidate.ports
                for place in self.rig.ports[name].places or ("",)
                if candidate.acts_at(name, place)
            ]
            return "" if self.reaching.intersection(places) else NOT_MEASURED

        def effects_at(port: str, place: str) -> list[tuple[str, Effect]]:
            acting = candidate.acts_at(port, place)
            return [(candidate.label, candidate.effect)] if acting else []

        keys = [f"{candidate.label}:{p.name}" for p in candidate.effect.parameters]
        try:
            traced = trace(self.rig, effects_at, {}, dict.fromkeys(keys, 1.0))
        except FileError:  # the diagnosis reports it where it screens the candidate
            return ""
        roots, reached = self.roots(traced)
        if not {name for space, name in symbols(roots) if space == "parameter"} & set(keys):
            return NOT_MEASURED
        for name in sorted(self.loose & reached):
            if _is_absolute(roots, symbol("state", name)):
                return f"no measured output determines {name}"
        integrals = _integrals(roots) - self.integrals
        if any(_is_absolute(roots, node) for node in integrals):
            return f"nothing determines the position at {candidate.ports[0]}"
        if not integrals and not self.loose:
            self.plainly_acting.add(kind)
        return ""


def _integrals(roots: list[Expr]) -> set[Expr]:
    """Integrals of what depends on states: of a recorded input they are determined."""
    return {
        node
        for node in walk(roots)
        if node.op == "integral" and any(space == "state" for space, _ in symbols([node]))
    }


def _is_absolute(roots: list[Expr], shifted: Expr) -> bool:
    """Whether one of these depends on the value of a node, not on its changes alone."""
    by: dict[Expr, Expr | None] = {}

    def reaching(node: Expr) -> tuple[Expr, ...]:
        return node.args if node.reach & shifted.reach == shifted.reach else ()

    for node in walk(roots, reaching):
        shifts = [by[a] for a in reaching(node)]
        by[node] = ONE if node is shifted else _shift(node, shifts) if shifts else ZERO
    return any(by[root] is not ZERO for root in roots)


def _shift(node: Expr, args: list[Expr | None]) -> Expr | None:
    """Shift of a node, from those of its arguments."""
    if all(shift is ZERO for shift in args):
        return ZERO
    if ABSOLUTE in args:
        return ABSOLUTE
    first, *others = (shift for shift in args if shift is not None)
    alone = all(shift is ZERO for shift in others)
    if node.op in ("rate", "bristle") and alone:
        return ZERO
    if node.op == "neg" or (node.op in SHIFTED_ALONG and alone):
        return -first if node.op == "neg" else first
    if node.op in ("add", "sub"):
        return first + others[0] if node.op == "add" else first - others[0]
    if node.op == "mul" and ZERO in (first, *others):
        factor, shift = (node.args[1], first) if alone else (node.args[0], others[0])
        return shift * factor if _is_constant(factor) else ABSOLUTE
    if node.op == "div" and alone:
        return first / node.args[1] if _is_constant(node.args[1]) else ABSOLUTE
    return ABSOLUTE


def _is_constant(factor: Expr) -> bool:
    return all(space == "parameter" for space, _ in symbols([factor]))
