"""A rig that is stepped: a simulation as it is, in place of equations.

    class Cart(StepRig):
        inputs = {"force_n": "N"}
        outputs = {"position_m": "m"}
        ports = {
            "force": Port("motion", "N", signals=("velocity", "position")),
            "sensor": Port("reading", "m"),
        }
        states = (State("position", "m"), State("velocity", "m/s"))
        parameters = (Parameter("mass_kg", 1.0, low=0.1, high=10.0, source="kitchen scale"),)

        def drive(self, x, u, p, port):
            return {"push": port("force", u.force_n, velocity=x.velocity, position=x.position)}

        def step(self, x, f, p, h):
            velocity = x.velocity + h * f.push / p.mass_kg
            return {"position": x.position + h * velocity, "velocity": velocity}

        def measure(self, x, u, p, port):
            return {"position_m": port("sensor", x.position)}

`drive` and `measure` are equations, as `rates` and `measure` of a Rig are: they say what goes into
the simulation and what is read from it, through which ports, and effects act there. `step` is any
Python: it is given numbers (SI), returns the states h seconds later, and may call what it likes, so
long as the same arguments lead to the same states. `read(x, p)` returns the readings of the
equations besides, its names and units in `readings`.

What acts from outside is held over an exchange, which is `exchange_s` long, or a sample where that
is shorter: state it where the machine is fast compared with its sampling.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import cached_property
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.errors import FileError, nearest
from pamid.engine.simulator import DIFFERENCE, LibraryStep
from pamid.engine.stepped import FarRunner, slopes_of
from pamid.engine.symbolic.expression import Expr, expression, symbol
from pamid.engine.symbolic.vocabulary import Number
from pamid.model.rig import Rig

SIMULATED = "simulated"  # the operator of values that only a simulation has
TRIED_POINTS = 4  # points at which dependences are tried
# of a slope: what a quarter of the step leaves of a dependence through another state; what is
# there at all, of the largest in its row
BY_WAY, THERE = 0.5, 1e-5


class StepRig(Rig):
    """Base of all rigs that are stepped. See the module's docstring for a whole example.

    Members that cannot be sent to another process (a window, a library's handle) belong into a
    `cached_property`, which each process computes anew.
    """

    written_as = {"rates": "drive"}
    # the simulation keeps its states to itself, and there are readings alone
    carries: ClassVar[bool] = False
    # values of `read`: name -> SI unit
    readings: ClassVar[dict[str, str]] = {}
    # longest time, s, over which forces are held; a sample where that is shorter
    exchange_s: ClassVar[float] = float("inf")
    # typical magnitude (SI) of a state, or of what goes in, where it is far from 1: differences
    # are taken over a millionth of it
    scales: ClassVar[dict[str, float]] = {}

    def drive(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        """Inputs of the simulation (SI), held over an exchange: commands, forces from outside."""
        raise FileError("there is none", _WHOLE)

    def step(self, x: Any, f: Any, p: Any, h: float) -> Mapping[str, float] | Sequence[float]:
        """States h seconds after x, under f (of `drive`) with parameters p, by name or in the order
        of `states`; all numbers, SI."""
        raise FileError("there is none", _WHOLE)

    def read(self, x: Any, p: Any) -> Mapping[str, float] | Sequence[float]:
        """Further readings of states x: numbers, SI, by name or in the order of `readings`."""
        raise FileError(
            "The rig declares `readings`, but does not define read().",
            "Add read(x, p), or remove `readings`.",
        )

    def steps(
        self, x: Array, f: Array, p: Array, h: float, into: tuple[str, ...]
    ) -> tuple[Array, Array]:
        """See `pamid.engine.simulator.Simulator`; copies in sequence. into: names of what
        goes in."""
        states, parameters = self._named
        after = np.array(
            [
                self._called(
                    self.step,
                    states,
                    _numbers(states, row),
                    _numbers(into, forces),
                    _numbers(parameters, values),
                    h,
                )
                for row, forces, values in zip(x.tolist(), f.tolist(), p.tolist(), strict=True)
            ]
        )
        return after, self.reads(after, p)

    def reads(self, x: Array, p: Array) -> Array:
        """See `pamid.engine.simulator.Simulator`; copies in sequence."""
        wanted, (states, parameters) = tuple(self.readings), self._named
        if not wanted:
            return np.empty((len(x), 0))
        rows = zip(x.tolist(), p.tolist(), strict=True)
        return np.array(
            [
                self._called(self.read, wanted, _numbers(states, row), _numbers(parameters, values))
                for row, values in rows
            ]
        )

    def in_c(
        self, p: Array, h: float, into: tuple[str, ...]
    ) -> AbstractContextManager[LibraryStep | None]:
        """See `pamid.engine.simulator.Simulator`; what is written in Python is none."""
        return nullcontext()

    def _called(
        self, method: Callable[..., Any], wanted: tuple[str, ...], *given: Any
    ) -> list[float]:
        """Result of `step` or `read`, in the wanted order. FileError for any fault in it."""
        what = "step" if method == self.step else "read"
        try:
            values = method(*given)
            if isinstance(values, dict):
                values = [values[name] for name in wanted] if len(values) == len(wanted) else values
            row = list(map(float, values))
        except Exception as error:
            raise self._failed(what, wanted, given, error) from error
        if len(row) != len(wanted):
            raise FileError(
                f"rig {self.name!r}, {what}() returned {len(row)} values, not {len(wanted)}",
                f"return them by name, or in the order {', '.join(wanted)}",
                code="simulation",
            )
        return row

    def _failed(
        self, method: str, wanted: tuple[str, ...], given: tuple[Any, ...], error: Exception
    ) -> FileError:
        """Error for an exception in the user's code: where, why, and at which states."""
        where_ = f"rig {self.name!r}, {method}()"
        if isinstance(error, FileError):
            return FileError(f"{where_}: {error.message}", error.hint, code=error.code)
        if isinstance(error, KeyError) and error.args and error.args[0] in wanted:
            return FileError(
                f"{where_} returned nothing for {error.args[0]!r}",
                f"names: {', '.join(wanted)}",
                code="simulation",
            )
        frames = traceback.extract_tb(error.__traceback__)
        line = f", line {frames[-1].lineno} of {frames[-1].filename}" if len(frames) > 1 else ""
        states = ", ".join(f"{k} = {v:.4g}" for k, v in vars(given[0]).items())
        hint = "Return numbers for any states that a fit may try, NaN where there are none."
        if isinstance(error, AttributeError) and error.name:
            known = [
                n for value in given if isinstance(value, SimpleNamespace) for n in vars(value)
            ]
            hint = nearest(error.name, known) or f"Use a name that exists: {', '.join(known)}."
        return FileError(
            f"{where_}{line}: {type(error).__name__}: {error} (at {states})",
            hint,
            code="simulation",
        )

    @cached_property
    def _named(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Names of the states and of the parameters."""
        return tuple(s.name for s in self.states), tuple(q.name for q in self.parameters)

    # ---- signals of the equations --------------------------------------------------------

    def far_runner(self) -> FarRunner | None:
        """Runner of whole runs for a simulation in another process; a `Carrier` where the rig
        `carries`."""
        return None

    def differential_states(self) -> list[str]:
        return list(map(_read, self.readings)) if self.carries else super().differential_states()

    def auxiliary_signals(self) -> dict[str, Expr]:
        """Readings, of which it is known which states they depend on."""
        if self.carries:
            return {name: symbol("state", _read(name)) for name in self.readings}
        states = self._named[0]
        by = self._dependence if self.readings else np.zeros((0, len(states)), bool)
        return {
            name: Expr(SIMULATED, _chosen(states, row), ("read", name))
            for name, row in zip(self.readings, by, strict=True)
        }

    def rates(self, x: Any, u: Any, p: Any, port: Any) -> dict[str, Number]:
        """Dependences of every state's rate. Only the simulation has its value."""
        if not (self.states or self.carries):
            raise FileError(
                "there are no states, so nothing can be stepped",
                "name what step() needs to know of the past and returns: states = (State(...),)",
            )
        into = self.drive(x, u, p, port)
        if not isinstance(into, dict) or not into:
            raise FileError(f"returned {into!r:.60}, not a dict of name: expression", _WHOLE)
        forces = {name: expression(value) for name, value in into.items()}
        states, names = self._named[0], tuple(forces)
        if self.carries:  # whatever is inside may lead from anywhere to anywhere
            anything = (*self.auxiliary_signals().values(), *forces.values())
            return {
                _read(name): Expr(SIMULATED, anything, ("rate", name, names, names))
                for name in self.readings
            }
        by_state, by_force = self._links(names)
        by_state_name: dict[str, Number] = {}
        for state, states_read, driven in zip(states, by_state, by_force, strict=True):
            used = tuple(name for name, there in zip(names, driven, strict=True) if there)
            args = (*_chosen(states, states_read), *(forces[name] for name in used))
            by_state_name[state] = Expr(SIMULATED, args, ("rate", state, used, names))
        return by_state_name

    @cached_property
    def _dependence(self) -> NDArray[np.bool_]:
        """Dependence of the readings (rows) on the states, by trial."""
        linked = np.zeros((len(self.readings), len(self.states)), bool)
        for x in _draws(self):
            n, size = len(x), self.sizes(())[0]
            by = DIFFERENCE * np.maximum(np.abs(x), size)
            moved = x + np.concatenate([np.zeros((1, n)), np.diag(by)])
            rows = self.reads(moved, _sheet(self, 1 + n))
            linked |= _above_rounding((rows[1:] - rows[0]).T / by * size)
        return linked

    def _links(self, into: tuple[str, ...]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Dependence of the states' rates (rows) on the states and on the forces: by differences
        over two steps, at points about the start. An influence by way of another state fades with
        the step and does not count; a value that moves nothing there is assumed to move everything.
        """
        known: dict[tuple[str, ...], Any] = self.__dict__.setdefault("_known_links", {})
        if into in known:
            return known[into]  # type: ignore[no-any-return]
        n, sizes = len(self.states), np.concatenate(self.sizes(into))
        _check_repeats(self, into)
        linked = np.zeros((n, n + len(into)), bool)
        none = np.zeros(0, np.intp)
        simulation = RigSimulator(self, into)
        longest = min(self.period_s, self.exchange_s)
        random = np.random.default_rng(1)
        for x in _draws(self):
            f = sizes[n:] * random.standard_normal(len(into))
            rates = []
            for h in (longest, 0.25 * longest):
                s = slopes_of(simulation, x, f, _sheet(self, 1)[0], h, none)
                by = np.concatenate([s.by_state, s.by_force], axis=1)[len(self.readings) :]
                by[:, :n] -= np.eye(n)
                rates.append(np.abs(by / h * sizes))
            whole, quarter = rates
            linked |= _above_rounding(quarter) & (quarter > BY_WAY * whole)
        linked[:, n:] |= ~linked[:, n:].any(axis=0)
        known[into] = linked[:, :n], linked[:, n:]
        return linked[:, :n], linked[:, n:]

    def sizes(self, into: tuple[str, ...]) -> tuple[Array, Array]:
        """Typical magnitudes (SI) of the states, and of what goes in."""
        states, forces = (
            np.array([self.scales.get(name, 1.0) for name in names])
            for names in (self._named[0], into)
        )
        return states, forces

    def __getstate__(self) -> dict[str, Any]:
        """Sent to another process without what was made here."""
        cached = {
            name
            for kind in type(self).__mro__
            for name, value in vars(kind).items()
            if isinstance(value, cached_property)
        }
        return {k: v for k, v in vars(self).items() if k not in {"_known_links", *cached}}


def _numbers(names: tuple[str, ...], values: list[float]) -> SimpleNamespace:
    return SimpleNamespace(**dict(zip(names, values, strict=True)))


class RigSimulator:
    """A stepped rig as the engine drives it (`pamid.engine.simulator.Simulator`)."""

    def __init__(self, rig: StepRig, into: tuple[str, ...]) -> None:
        self.rig, self.into = rig, into
        self.sizes, self.longest_s = rig.sizes(into), rig.exchange_s

    def steps(self, x: Array, f: Array, p: Array, h: float) -> tuple[Array, Array]:
        return self.rig.steps(x, f, p, h, self.into)

    def reads(self, x: Array, p: Array) -> Array:
        return self.rig.reads(x, p)

    def in_c(self, p: Array, h: float) -> AbstractContextManager[LibraryStep | None]:
        return self.rig.in_c(p, h, self.into)


def _read(name: str) -> str:
    """A reading as a state of the equations."""
    return f"read.{name}"


_WHOLE = "a stepped rig has drive(x, u, p, port), step(x, f, p, h) and measure(x, u, p, port)"


def _chosen(states: tuple[str, ...], row: NDArray[np.bool_]) -> tuple[Expr, ...]:
    return tuple(symbol("state", name) for name, there in zip(states, row, strict=True) if there)


def _sheet(rig: StepRig, copies: int) -> Array:
    """The data sheet's parameters, SI (copies x parameters)."""
    return np.tile([q.value * q.factor for q in rig.parameters], (copies, 1))


def _draws(rig: StepRig) -> list[Array]:
    """The states at the start of a recording, and points about them; SI."""
    values = dict(zip(rig._named[1], _sheet(rig, 1)[0].tolist(), strict=True))
    given = rig.start(SimpleNamespace(**values))
    start = np.array([given.get(s.name, s.start) for s in rig.states])
    away = np.random.default_rng(0).standard_normal((TRIED_POINTS, len(start)))
    return [start, *(start + 0.3 * rig.sizes(())[0] * away)]


def _above_rounding(slopes: Array) -> NDArray[np.bool_]:
    """Slopes above rounding, row by row."""
    size = np.abs(np.nan_to_num(slopes, nan=np.inf))
    largest = size.max(axis=1, initial=0.0, keepdims=True)
    return (size > THERE * largest) & (size > 0.0)


def _check_repeats(rig: StepRig, into: tuple[str, ...]) -> None:
    """Refuse a simulation that gives no numbers where a recording starts, or that remembers more
    than its states."""
    state, other = _draws(rig)[:2]
    h, f = min(rig.period_s, rig.exchange_s), np.outer([0.0, 1.0, 0.0], np.ones(len(into)))
    first, _, repeated = rig.steps(np.stack([state, other, state]), f, _sheet(rig, 3), h, into)[0]
    for name, value in zip(rig._named[0], first, strict=True):
        if not np.isfinite(value):
            raise FileError(
                f"rig {rig.name!r}, step() returned {value} for {name!r} in the first step of "
                f"{h:g} s from the start",
                "correct the initial state or a parameter, or shorten the step (exchange_s)",
                code="simulation",
            )
    if not np.array_equal(first, repeated):
        name = rig._named[0][int(np.argmax(first != repeated))]
        raise FileError(
            f"rig {rig.name!r}, step() returns another {name!r} for the same states after another "
            "call: it has a memory that is not a state",
            "set everything from x at the beginning of step(), or declare it as a state",
            code="simulation",
        )
