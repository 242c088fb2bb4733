"""Effects whose signals the recordings determine.

A state is determined if a measured output or the rate of another determined state depends on it. A
state that acts back on its rate is determined, too. The absolute angle of a shaft is not
determined if only the speed is measured: its rate is known, its zero is not. An effect that acts on
increments alone (a bristle, a stop) needs no zero and remains a candidate. An effect that acts on
the value itself (a spring, cogging) is left out, because each window would have a different zero.

To test whether an expression depends on the zero, we propagate a shift s of the state through it.
Every node then shifts by c s, where c is an expression. Nodes whose shift is not proportional to s
are `ABSOLUTE`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from functools import cached_property
from typing import Any

from pamid.base.errors import FileError
from pamid.engine.symbolic.expression import ONE, ZERO, symbol, symbols, walk
from pamid.engine.symbolic.vocabulary import Expr
from pamid.model.attachment import Attachment
from pamid.model.effect import Effect
from pamid.model.rig import Rig
from pamid.model.step_rig import SIMULATED, StepRig
from pamid.model.trace import Passage, Traced, trace

NOT_MEASURED = "it changes nothing that was measured"
ABSOLUTE = None  # shift of an expression that is not proportional to s
SHIFTED_ALONG = frozenset({"play", "lag", "delay"})  # memories whose output shifts with their input


def determined(
    rig: Rig, outputs: Collection[str], still: Collection[str], candidates: Iterable[Attachment]
) -> tuple[list[Attachment], dict[str, str]]:
    """Return the candidates whose signals are determined, and by label why others are left out.

    outputs: measured outputs of the rig; still: inputs that are 0 in all recordings.
    """
    traced = trace(rig, lambda port, place: [], {})
    is_stepped = isinstance(rig, StepRig)  # the equations of a stepped rig are unknown
    check = None if is_stepped else _Determination(rig, tuple(outputs), traced)
    usable, reasons = list[Attachment](), dict[str, str]()
    for candidate in candidates:
        reason = _at_rest(traced, candidate, frozenset(still))
        if not reason and check:
            reason = check.objection(candidate)
        if reason:
            reasons[candidate.label] = reason
        else:
            usable.append(candidate)
    return usable, reasons


def undetermined_states(traced: Traced, outputs: Collection[str]) -> frozenset[str]:
    """Return integrator states that these outputs do not determine.

    Neither the outputs nor the rates of states behind them depend on such a state. A state that
    acts back on its rate is excluded, because it forgets its initial value: the input of a
    filter determines its state.
    """
    unobserved = unobserved_states(traced, outputs)
    return frozenset(n for n in unobserved if n not in _reached(traced, [traced.rates[n]]))


def unobserved_states(traced: Traced, outputs: Collection[str]) -> frozenset[str]:
    """States on which none of these outputs depends, directly or through rates."""
    return frozenset(traced.rates) - _reached(traced, [traced.outputs[o] for o in outputs])


def _reached(traced: Traced, roots: Iterable[Expr]) -> set[str]:
    """States on which these expressions depend, directly or through rates."""
    reached: set[str] = set()
    pending = list(roots)
    while pending:
        states = {name for space, name in symbols([pending.pop()]) if space == "state"}
        pending += [traced.rates[name] for name in states - reached if name in traced.rates]
        reached |= states
    return reached


def _at_rest(traced: Traced, candidate: Attachment, inputs_at_rest: frozenset[str]) -> str:
    """Return why a candidate is not excited: only inputs at rest drive it. Empty if others do."""
    passages = [q for q in traced.passages if candidate.acts_at(q.port, q.place)]
    drivers = [[q.value for q in passages]]
    drivers += [_signal(passages, candidate.effect, name) for name in candidate.effect.signals]
    for sources in drivers:
        at_rest = []
        for root in sources:
            leaves = symbols([root])
            # an expression that depends on other signals, too, is not at rest with its inputs
            moving = {space for space, _ in leaves} - {"input", "parameter"}
            if moving or any(node.op == SIMULATED for node in walk([root])):
                leaves = set()
            at_rest.append({name for space, name in leaves if space == "input"})
        if at_rest and all(inputs and inputs <= inputs_at_rest for inputs in at_rest):
            names = sorted(set().union(*at_rest))
            return f"{' and '.join(names)} is 0 in all recordings"
    return ""


def _signal(passages: list[Passage], effect: Effect, name: str) -> list[Expr]:
    """Expressions of an effect's signal, an expression per port that offers it."""
    expressions = []
    for passage in passages:
        offered = dict(passage.signals)
        expression = offered.get(effect.offered_as(name, set(offered)))
        expressions += [expression] if isinstance(expression, Expr) else []
    return expressions


class _MarkerEffect(Effect):
    """Placeholder for any effect: it adds a symbol to the value at a port."""

    name = "mark"

    def __init__(self, at: str) -> None:
        self.at = at

    def act(self, value: Expr, at: Any, p: Any, z: Any) -> Expr:
        return value + symbol("mark", self.at)


class _Determination:
    """Check of whether the measured outputs determine the signals of candidates.

    Tracing a robot with each of its candidates would cost more than screening them. An effect is
    therefore traced once per kind of port to see whether it integrates a signal. Whether ports
    reach the outputs is traced for all ports at once.
    """

    def __init__(self, rig: Rig, outputs: tuple[str, ...], plain: Traced) -> None:
        self.rig, self.outputs = rig, outputs
        self.loose = undetermined_states(plain, outputs)
        self.integrals = _integrals([*plain.rates.values(), *plain.outputs.values()])
        self.plainly_acting: set[tuple[str, str, str]] = set()

    @cached_property
    def reaching(self) -> set[str]:
        """Ports, with their places, on which an output depends."""
        marked = trace(
            self.rig, lambda port, place: [("mark", _MarkerEffect(f"{port} {place}"))], {}
        )
        return {name for space, name in symbols(self.roots(marked)[0]) if space == "mark"}

    def roots(self, traced: Traced) -> tuple[list[Expr], set[str]]:
        """Outputs and rates of the determined states behind them; all states behind the outputs."""
        roots = [traced.outputs[name] for name in self.outputs]
        reached = _reached(traced, roots)
        rates = sorted(name for name in reached - self.loose if name in traced.rates)
        return roots + [traced.rates[name] for name in rates], reached

    def objection(self, candidate: Attachment) -> str:
        """Return why a candidate is left out: no output shows it, or it needs the zero of an
        undetermined signal. Empty if it stays."""
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
        except FileError:  # screening reports this error for the candidate
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
    """Integrals of expressions with states. Integrals of recorded inputs are determined."""
    return {
        node
        for node in walk(roots)
        if node.op == "integral" and any(space == "state" for space, _ in symbols([node]))
    }


def _is_absolute(roots: list[Expr], shifted: Expr) -> bool:
    """Whether a root depends on the value of a node and not only on its changes."""
    shift_of: dict[Expr, Expr | None] = {}

    def reaching(node: Expr) -> tuple[Expr, ...]:
        return node.args if node.reach & shifted.reach == shifted.reach else ()

    for node in walk(roots, reaching):
        shifts = [shift_of[a] for a in reaching(node)]
        shift_of[node] = ONE if node is shifted else _shift(node, shifts) if shifts else ZERO
    return any(shift_of[root] is not ZERO for root in roots)


def _shift(node: Expr, args: list[Expr | None]) -> Expr | None:
    """Shift of a node, from the shifts of its arguments."""
    if all(shift is ZERO for shift in args):
        return ZERO
    if ABSOLUTE in args:
        return ABSOLUTE
    first, *others = (shift for shift in args if shift is not None)
    others_fixed = all(shift is ZERO for shift in others)
    if node.op in ("rate", "bristle") and others_fixed:
        return ZERO
    if node.op == "neg" or (node.op in SHIFTED_ALONG and others_fixed):
        return -first if node.op == "neg" else first
    if node.op in ("add", "sub"):
        return first + others[0] if node.op == "add" else first - others[0]
    if node.op == "mul" and ZERO in (first, *others):
        factor, shift = (node.args[1], first) if others_fixed else (node.args[0], others[0])
        return shift * factor if _is_constant(factor) else ABSOLUTE
    if node.op == "div" and others_fixed:
        return first / node.args[1] if _is_constant(node.args[1]) else ABSOLUTE
    return ABSOLUTE


def _is_constant(factor: Expr) -> bool:
    return all(space == "parameter" for space, _ in symbols([factor]))
