"""Memory operators become cells: discrete states that the engine carries from step to step.

A cell is updated at the start of every step (of every sample where `sampled`), from the state at
that instant and its own past, and holds over the step. Inside the step an operator is evaluated
relative to its cell, so a play or a bristle is exact for a motion one way, whatever the
integrator's stages do, and no operator is stiff. With x_k at the start of the step, k - 1 at that
of the one before, and h its length:

    play     s_k = clip(s_k-1 + x_k - x_k-1, -r, r); the value is x - clip(s_k + x - x_k, -r, r),
             and stop(x) = x - play(x) (Krasnosel'skii and Pokrovskii 1989; Brokate and Sprekels
             1996)
    bristle  dz/dx = 1 - sign(dx) z / reach (Dahl 1968), solved exactly from z_k over x - x_k:
             z = e + (z_k - e) exp(-|x - x_k| / reach) with e = +-reach, the sign of the motion
    lag      tau dy/dt = x - y, solved exactly: for a held x as the mean over the step, for a moving
             one with x linear over the step (first-order hold)
    delay    ring buffer of the integrator, linear between steps
    integral an ordinary state
    rate     (x_k - x_k-1) / period, k of samples, held over a sample

    Krasnosel'skii and Pokrovskii (1989), Systems with Hysteresis
    Brokate and Sprekels (1996), Hysteresis and Phase Transitions
    Dahl (1968), A solid friction model, Aerospace Corporation TOR-0158(3107-18)-1

Where the state is set anew between two windows of a recording, deflections stay as they are:
memories are stored relative to the signal, so that a corrected position is not taken for a motion.
"""

from __future__ import annotations

from dataclasses import dataclass

from pamid.symbolic.expression import rebuild, symbol, symbols, text, walk
from pamid.symbolic.vocabulary import EquationError, Expr, exp, maximum, minimum, where

TICKS = ("time", "step", "period", "fresh", "begin", "join")
# s, s, s; 1 at the first step of a sample, at the very first step, at the first one after the state
# was set anew


def tick(name: str) -> Expr:
    return symbol("tick", name)


@dataclass(frozen=True)
class Cell:
    """A remembered value, a discrete state. `update` may read states, inputs, parameters, its own
    past and other cells' new values."""

    name: str
    update: Expr
    start: Expr
    sampled: bool = False
    joined: Expr | None = None  # the update where the state was set anew
    # > 0: a delay line of that length; `update` is what goes in, `seconds` the delay
    buffer_s: float = 0.0
    seconds: Expr | None = None

    @property
    def here(self) -> Expr:
        return symbol("cell", self.name)

    @property
    def past(self) -> Expr:
        return symbol("past", self.name)


@dataclass(frozen=True)
class StateEquations:
    """Equations without memory operators."""

    states: tuple[str, ...]
    rates: tuple[Expr, ...]
    outputs: tuple[Expr, ...]
    cells: tuple[Cell, ...]  # in the order they have to be updated


def _is_held_over_step(node: Expr) -> bool:
    """Does the value stay put over a step?"""
    return all(space != "state" for space, _ in symbols([node]))


class _MemoryExpansion:
    def __init__(self) -> None:
        self.new: dict[Expr, Expr] = {}
        self.cells: list[Cell] = []
        self.states: list[tuple[str, Expr]] = []

    def name(self, kind: str) -> str:
        return f"{kind}{len(self.cells) + len(self.states)}"

    def position_at_step_start(self, name: str, x: Expr) -> tuple[Expr, Expr]:
        """x at the last step start, before and after this step's update."""
        self.cells.append(Cell(f"{name}_origin", x, x))
        return symbol("past", f"{name}_origin"), symbol("cell", f"{name}_origin")

    def play(self, x: Expr, r: Expr) -> Expr:
        name = self.name("play")
        past, here = symbol("past", name), symbol("cell", name)
        before, origin = self.position_at_step_start(name, x)

        def deflected(s: Expr, travel: Expr) -> Expr:
            return maximum(-r, minimum(r, s + travel))

        self.cells.append(Cell(name, deflected(past, x - before), 0.0 * x, joined=past))
        return x - deflected(here, x - origin)

    def bristle(self, x: Expr, reach: Expr) -> Expr:
        name = self.name("bristle")
        past, here = symbol("past", name), symbol("cell", name)
        before, origin = self.position_at_step_start(name, x)

        def moved(z: Expr, step: Expr) -> Expr:
            decay = exp(-abs(step) / reach)
            end = where(step > 0.0, reach, where(step < 0.0, -reach, z))
            return end + (z - end) * decay

        self.cells.append(Cell(name, moved(past, x - before), 0.0 * x, joined=past))
        return moved(here, x - origin)

    def lag(self, x: Expr, tau: Expr) -> Expr:
        tau = tau + 1e-15  # not a maximum: a fit that starts at the null must see the slope
        h = tick("step")
        decay = exp(-h / tau)
        name = self.name("lag")
        y, before = symbol("past", name), symbol("past", f"{name}_input")
        if _is_held_over_step(x):
            # the cell holds y_k; mean over the step of y(t) = x + (y_k - x) exp(-t / tau)
            cell = Cell(name, before + (y - before) * decay, x)
            out = x + (cell.here - x) * (tau / h) * (1.0 - decay)
        else:
            # over the step that has ended x = before + slope t, and so its end
            # y_k = x_k - slope tau + (y_k-1 - before + slope tau) exp(-h / tau);
            # within the new step y moves along with x
            slope = (x - before) / h
            cell = Cell(
                name,
                x - slope * tau + (y - before + slope * tau) * decay,
                x,
                joined=x + (y - before),
            )
            out = x + (cell.here - symbol("cell", f"{name}_input"))
        self.cells += [Cell(f"{name}_input", x, x), cell]
        return out

    def delay(self, x: Expr, seconds: Expr, longest_s: float) -> Expr:
        name = self.name("delay")
        now = symbol("cell", f"{name}_input")
        self.cells += [
            Cell(f"{name}_input", x, x),
            Cell(name, now, now, buffer_s=longest_s, seconds=seconds),
        ]
        out = symbol("cell", name)
        return out if _is_held_over_step(x) else x + (out - now)

    def integral(self, x: Expr) -> Expr:
        name = self.name("integral")
        self.states.append((name, x))
        return symbol("state", name)

    def rate(self, x: Expr) -> Expr:
        name = self.name("rate")
        before, here = symbol("past", f"{name}_input"), symbol("cell", name)
        change = (x - before) / tick("period")
        # a state that is set anew has not moved; what is recorded goes on as it is
        kept = None if _is_held_over_step(x) else symbol("past", name)
        self.cells += [
            Cell(f"{name}_input", x, x, sampled=True),
            Cell(name, change, 0.0 * x, sampled=True, joined=kept),
        ]
        return here

    def run(self, roots: list[Expr]) -> None:
        for node in walk(roots):
            if node in self.new:
                continue
            args = tuple(self.new[a] for a in node.args)
            if node.op == "delay":
                self.new[node] = self.delay(args[0], args[1], node.value)
            elif node.op in ("play", "bristle", "lag", "integral", "rate"):
                self.new[node] = getattr(self, node.op)(*args)
            else:
                self.new[node] = rebuild(node, args) if args else node


def _ordered(cells: list[Cell]) -> tuple[Cell, ...]:
    """Cells such that each one reads only new values of cells before it."""
    names = {c.name: c for c in cells}
    needs = {
        c.name: {
            n
            for space, n in symbols(
                [e for e in (c.update, c.start, c.joined, c.seconds) if e is not None]
            )
            if space == "cell"
        }
        - {c.name}
        for c in cells
    }
    order: list[Cell] = []
    placed: set[str] = set()
    while len(order) < len(cells):
        ready = [c for c in cells if c.name not in placed and needs[c.name] <= placed]
        if not ready:  # the topological sort is at a cycle
            stuck = [n for n in names if n not in placed]
            raise EquationError(
                f"algebraic loop through {', '.join(stuck)}: {text(names[stuck[0]].update)[:120]}",
                "put a delay, a lag or a state into the loop",
            )
        order += ready[:1]
        placed.add(ready[0].name)
    return tuple(order)


def expand_memory(
    rates: dict[str, Expr], outputs: dict[str, Expr], cells: tuple[Cell, ...] = ()
) -> StateEquations:
    """Replace every memory operator by cells; adds a state per integral."""
    work = _MemoryExpansion()
    explicit = [e for c in cells for e in (c.update, c.start)]
    work.run([*rates.values(), *outputs.values(), *explicit])
    done = [Cell(c.name, work.new[c.update], work.new[c.start], c.sampled) for c in cells]
    rate_nodes = [work.new[e] for e in rates.values()]
    out_nodes = [work.new[e] for e in outputs.values()]
    return StateEquations(
        (*rates, *(n for n, _ in work.states)),
        (*rate_nodes, *(e for _, e in work.states)),
        tuple(out_nodes),
        _ordered(done + work.cells),
    )


def cell_update(cell: Cell) -> Expr:
    """What the cell becomes at the start of a step."""
    update = cell.update
    if cell.sampled:
        update = where(tick("fresh") > 0.5, update, cell.past)
    if cell.joined is not None:
        update = where(tick("join") > 0.5, cell.joined, update)
    return where(tick("begin") > 0.5, cell.start, update)
