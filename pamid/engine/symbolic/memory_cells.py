"""Memory operators become cells: discrete states that the engine carries from step to step.

A cell is updated at the start of every step (of every sample where `sampled`), from the state at
that instant and its past, and holds over the step. Within the step an operator is computed from
the value of its cell. A play or a bristle is then exact for a monotonic motion, whatever the stages
of the integrator, and no operator makes the equations stiff. Index k is the start of the present
step, k - 1 that of the previous step, and h the length of a step:

    play     s_k = clip(s_k-1 + x_k - x_k-1, -r, r); the value is x - clip(s_k + x - x_k, -r, r),
             and stop(x) = x - play(x) (Krasnosel'skii and Pokrovskii 1989; Brokate and Sprekels
             1996)
    bristle  dz/dx = 1 - sign(dx) z / reach (Dahl 1968), solved exactly from z_k over x - x_k:
             z = e + (z_k - e) exp(-|x - x_k| / reach) with e = +-reach, the sign of the motion
    lag      tau dy/dt = x - y, solved exactly: for a held x as the mean over the step, for a moving
             lag with x linear over the step (first-order hold)
    delay    ring buffer of the integrator, linear between steps. If a held x is late by q of a
             step, the far value acts for q h, and the near value for (1 - q) h. A rate f counts
             by its mean over the step, (1 - q) f(near) + q f(far), not by f of the mean: for a
             valve that opens either way, the mean of two commands is hardly any command (the
             modified z-transform splits a sample so; Franklin, Powell and Workman 1998)
    input    held over the sample, or interpolated linearly to the next sample. An expression of
             such inputs that has no state is known in advance for the whole step. A lag then
             takes its slope over the step, and a delay reads its buffer at both ends of the step
    integral an ordinary state
    rate     (x_k - x_k-1) / period, k of samples, held over a sample

    Krasnosel'skii and Pokrovskii (1989), Systems with Hysteresis
    Brokate and Sprekels (1996), Hysteresis and Phase Transitions
    Dahl (1968), A solid friction model, Aerospace Corporation TOR-0158(3107-18)-1
    Franklin, Powell and Workman (1998), Digital Control of Dynamic Systems, 4.3.2

A window of a recording resets the state. A deflection that is driven by a state does not change
then: it is stored relative to its signal, so that a corrected position is not taken for a motion. A
deflection that is driven by recorded inputs alone is updated as usual.
"""

from __future__ import annotations

from dataclasses import dataclass

from pamid.engine.symbolic.expression import rebuild, substitute, symbol, symbols, text, walk
from pamid.engine.symbolic.vocabulary import (
    EquationError,
    Expr,
    exp,
    floor,
    maximum,
    minimum,
    where,
)

TICKS = ("time", "step", "period", "fresh", "begin", "join", "part", "along")
# time, step and period in s; fresh, begin and join are 1 at the first step of a sample, of the run,
# and after a reset of the state; part, along: elapsed fractions of the sample and of the step

MOST_SPLIT = 3  # held delays whose effect on the rates is averaged over the step


def tick(name: str) -> Expr:
    return symbol("tick", name)


@dataclass(frozen=True)
class Cell:
    """A remembered value, a discrete state. `update` may read states, inputs, parameters, its past
    and other cells' new values."""

    name: str
    update: Expr
    start: Expr
    sampled: bool = False
    joined: Expr | None = None  # the update where the state was set anew
    # > 0: a delay line of that length; `update` is its input, `seconds` the delay
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


# symbols that move within a step in addition to the states
_AT_STAGE = {("tick", "part"), ("tick", "along")}
_SAME_AT_EVERY_STEP = {("tick", "step"), ("tick", "period")}


def _is_held_over_step(node: Expr) -> bool:
    """Whether the value is constant over a step."""
    used = symbols([node])
    return all(space != "state" for space, _ in used) and not used & _AT_STAGE


def _is_driven(node: Expr) -> bool:
    """Whether the value moves over a step with linear inputs alone, so that its end is known at its
    start."""
    used = symbols([node])
    return all(space != "state" for space, _ in used) and bool(used & _AT_STAGE)


@dataclass(frozen=True)
class _Split:
    """A held value that changes within a step: its mean, its value before and after the change, and
    the share of the step before the change."""

    mean: Expr
    before: Expr
    after: Expr
    share: Expr

    def means_of(self, roots: list[Expr]) -> list[Expr]:
        """Means over the step of expressions that contain the value.

        Only the outermost nonlinear expressions are formed twice, with the value before and after.
        """
        # whether each node below the roots is affine in the mean; None if it does not contain it
        straight: dict[Expr, bool | None] = {}
        for node in walk(roots):
            followed = [straight[a] for a in node.args]
            if node is self.mean:
                straight[node] = True
            elif all(f is None for f in followed):
                straight[node] = None
            else:
                straight[node] = False not in followed and _is_linear(node, straight)

        def bent_arguments(node: Expr) -> tuple[Expr, ...]:
            linear = _is_linear(node, straight)
            return tuple(a for a in node.args if straight[a] is False) if linear else ()

        bent = [r for r in roots if straight[r] is False]
        doubled = [n for n in walk(bent, bent_arguments) if not bent_arguments(n)]
        early = substitute(doubled, {self.mean: self.before})
        late = substitute(doubled, {self.mean: self.after})
        means = (b + self.share * (a - b) for a, b in zip(early, late, strict=True))
        return substitute(roots, dict(zip(doubled, means, strict=True)))


def _is_linear(node: Expr, straight: dict[Expr, bool | None]) -> bool:
    """Whether the operation itself is linear in those of its arguments that have the part."""
    followed = [straight[a] for a in node.args]
    once = node.op == "mul" and None in followed
    divided = node.op == "div" and followed[1] is None
    # a tangent is the solution of an equation; its derivatives come from a linear correction
    return once or divided or node.op in ("add", "sub", "neg", "tangent")


class _MemoryExpansion:
    def __init__(self) -> None:
        self.new: dict[Expr, Expr] = {}
        self.cells: list[Cell] = []
        self.states: list[tuple[str, Expr]] = []
        self.splits: list[_Split] = []

    def name(self, kind: str) -> str:
        return f"{kind}{len(self.cells) + len(self.states)}"

    def position_at_step_start(self, name: str, x: Expr) -> tuple[Expr, Expr]:
        """x at the last step start, before and after this step's update."""
        self.cells.append(Cell(f"{name}_origin", x, x))
        return symbol("past", f"{name}_origin"), symbol("cell", f"{name}_origin")

    def follows_a_state(self, x: Expr) -> bool:
        """Whether x reads a state, itself or through its cells. True for cells of the rig."""
        cells = {c.name: c for c in self.cells}
        seen: set[str] = set()
        todo = [x]
        while todo:
            used = symbols(todo)
            todo = []
            for space, name in used:
                if space == "state":
                    return True
                if space in ("cell", "past") and name not in seen:
                    if name not in cells:
                        return True
                    seen.add(name)
                    cell = cells[name]
                    parts = (cell.update, cell.start, cell.joined, cell.seconds)
                    todo += [e for e in parts if e is not None]
        return False

    def unchanged_on_reset(self, x: Expr, past: Expr) -> Expr | None:
        """Update of a memory of x at a reset of the state: its past value if x depends on a state,
        None (the usual update) if x depends on recorded inputs alone."""
        return past if self.follows_a_state(x) else None

    def play(self, x: Expr, r: Expr) -> Expr:
        name = self.name("play")
        past, current = symbol("past", name), symbol("cell", name)
        before, origin = self.position_at_step_start(name, x)

        def deflected(s: Expr, travel: Expr) -> Expr:
            return maximum(-r, minimum(r, s + travel))

        unchanged = self.unchanged_on_reset(x, past)
        self.cells.append(Cell(name, deflected(past, x - before), 0.0 * x, joined=unchanged))
        return x - deflected(current, x - origin)

    def bristle(self, x: Expr, reach: Expr) -> Expr:
        name = self.name("bristle")
        past, current = symbol("past", name), symbol("cell", name)
        before, origin = self.position_at_step_start(name, x)

        def moved(z: Expr, step: Expr) -> Expr:
            decay = exp(-abs(step) / reach)
            end = where(step > 0.0, reach, where(step < 0.0, -reach, z))
            return end + (z - end) * decay

        unchanged = self.unchanged_on_reset(x, past)
        self.cells.append(Cell(name, moved(past, x - before), 0.0 * x, joined=unchanged))
        return moved(current, x - origin)

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
        elif _is_driven(x):
            rise, ended = self.rise(name, x)
            slope = symbol("past", f"{name}_rise") / h
            cell = Cell(
                name,
                before + slope * (h - tau) + (y - before + slope * tau) * decay,
                x,
            )
            slope, begun = rise / h, symbol("cell", f"{name}_input")
            passed, mean = exp(-tick("along") * h / tau), (tau / h) * (1.0 - decay)
            # a jump at the start of the step counts by its mean, as where the input is held
            out = x - slope * tau + (cell.here - ended + slope * tau) * passed
            out = out - (begun - ended) * mean
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

    def rise(self, name: str, x: Expr) -> tuple[Expr, Expr]:
        """Rise of a driven value over this step, and its value at the end of the step before."""
        part, along = tick("part"), tick("along")
        ends = {part: part + tick("step") / tick("period"), along: along + 1.0}
        rises = substitute([x], ends)[0] - x
        ended = symbol("past", f"{name}_input") + symbol("past", f"{name}_rise")
        self.cells += [Cell(f"{name}_rise", rises, rises), Cell(f"{name}_ended", ended, x)]
        return symbol("cell", f"{name}_rise"), symbol("cell", f"{name}_ended")

    def delay(self, x: Expr, seconds: Expr, longest_s: float) -> Expr:
        name = self.name("delay")
        now = symbol("cell", f"{name}_input")
        is_settled = all(
            space == "parameter" or (space, leaf) in _SAME_AT_EVERY_STEP
            for space, leaf in symbols([seconds])
        )
        if _is_held_over_step(x) and is_settled:
            return self.split_delay(name, x, seconds, longest_s)
        self.cells += [
            Cell(f"{name}_input", x, x),
            Cell(name, now, now, buffer_s=longest_s, seconds=seconds),
        ]
        out = symbol("cell", name)
        if _is_held_over_step(x):
            return out
        if not _is_driven(x):
            return x + (out - now)
        h, along = tick("step"), tick("along")
        rise, _ = self.rise(name, x)
        self.cells.append(
            Cell(f"{name}_end", now, now, buffer_s=longest_s, seconds=maximum(seconds - h, 0.0))
        )
        end = symbol("cell", f"{name}_end") + maximum(1.0 - seconds / h, 0.0) * rise
        return x + (1.0 - along) * (out - now) + along * (end - now - rise)

    def split_delay(self, name: str, x: Expr, seconds: Expr, longest_s: float) -> Expr:
        """A held value a fixed time late, of which a step sees two values, in sequence."""
        h, now = tick("step"), symbol("cell", f"{name}_input")
        steps = floor(seconds / h)
        after, before = symbol("cell", f"{name}_near"), symbol("cell", f"{name}_far")
        split = _Split(symbol("cell", name), before, after, seconds / h - steps)
        self.cells += [
            Cell(f"{name}_input", x, x),
            Cell(f"{name}_near", now, now, buffer_s=longest_s, seconds=steps * h),
            Cell(f"{name}_far", now, now, buffer_s=longest_s, seconds=(steps + 1.0) * h),
            Cell(name, after + split.share * (before - after), now),
        ]
        self.splits.append(split)
        return split.mean

    def integral(self, x: Expr) -> Expr:
        name = self.name("integral")
        self.states.append((name, x))
        return symbol("state", name)

    def rate(self, x: Expr) -> Expr:
        name = self.name("rate")
        before, current = symbol("past", f"{name}_input"), symbol("cell", name)
        change = (x - before) / tick("period")
        unchanged = self.unchanged_on_reset(x, symbol("past", name))
        self.cells += [
            Cell(f"{name}_input", x, x, sampled=True),
            Cell(name, change, 0.0 * x, sampled=True, joined=unchanged),
        ]
        return current

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
    """Cells such that each reads only new values of cells before it."""
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
    rates: dict[str, Expr],
    outputs: dict[str, Expr],
    cells: tuple[Cell, ...] = (),
    linear: tuple[str, ...] = (),
) -> StateEquations:
    """Replace every memory operator by cells; adds a state per integral.

    linear: inputs that lead to the next sample in a straight line; the others are held.
    """
    work = _MemoryExpansion()
    explicit = [e for c in cells for e in (c.update, c.start)]
    roots = [*rates.values(), *outputs.values(), *explicit]
    if linear:
        inputs = ((symbol("input", n), symbol("rise", n)) for n in linear)
        roots = substitute(roots, {u: u + tick("part") * rise for u, rise in inputs})
    work.run(roots)
    expanded = iter([work.new[e] for e in roots])
    rate_nodes = [next(expanded) for _ in rates]
    out_nodes = [next(expanded) for _ in outputs]
    done = [Cell(c.name, next(expanded), next(expanded), c.sampled) for c in cells]
    rate_nodes += [e for _, e in work.states]
    # each delayed input doubles the nonlinear expressions (an arm of seven joints: 2^7); beyond
    # MOST_SPLIT the mean of the value is used
    for split in work.splits if len(work.splits) <= MOST_SPLIT else ():
        rate_nodes = split.means_of(rate_nodes)
    return StateEquations(
        (*rates, *(n for n, _ in work.states)),
        tuple(rate_nodes),
        tuple(out_nodes),
        _ordered(done + work.cells),
    )


def cell_update(cell: Cell) -> Expr:
    """New value of the cell at the start of a step."""
    update = cell.update
    if cell.sampled:
        update = where(tick("fresh") > 0.5, update, cell.past)
    if cell.joined is not None:
        update = where(tick("join") > 0.5, cell.joined, update)
    return where(tick("begin") > 0.5, cell.start, update)
