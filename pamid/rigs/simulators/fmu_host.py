"""Process that holds an FMU. If its binary prints, hangs or crashes, only this process does.

Requests come by a pipe from the parent process. They and the answers are JSON and numbers, or a
sentence, never objects (`pamid.engine.remote_program.Parcel`). Whole runs are made here. The
equations around the FMU are sent once, as text that is compiled. The work at every sample is
compiled, too (`pamid.rigs.simulators.fmi_kernels`).
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.engine.remote_program import Parcel, packed, rebuilt_program, run_answer, run_of
from pamid.engine.shadow_simulators import Carrier
from pamid.engine.simulator import LibraryStep
from pamid.engine.stepped import SteppedProgram
from pamid.rigs.simulators.fmi_kernels import (
    LEADS,
    MOST_STEPS,
    STATUS,
    FmuUnits,
    UnitScale,
    advance_copies,
    exchange,
    exchange_of,
    exchange_words,
    get_outputs,
    rates_at,
    table_in,
)
from pamid.rigs.simulators.fmu_instance import FATAL, FmuInstance, why

FAILED, NUMBERS = b"!", b"="
#: methods that may be requested
CALLS = ("steps", "reads", "drop")
MOST_INSTANCES = 64  # with different parameters, for seen states
LATER_S = 1.2345  # arbitrary time at which a time-invariant model behaves as at 0
TIMED = (
    "its equations depend explicitly on time, which is not a state; write seen = false into the "
    "TOML file next to the FMU"
)


@dataclass
class _Copy:
    """Copy of the FMU between runs: its time, its parameters and its state.

    The state is the address of a state that the FMU has saved. If the FMU cannot save a state, the
    copy has the inputs of all steps from the start, the last first, each with its predecessors.
    """

    time_s: float
    p: Array
    state: int
    past: Any
    x: Array
    due: Array


class FmuHost:
    """Instances of an FMU, and the programs that run it; all SI.

    about: `FmuFile.request`, and the folder of the unpacked FMU. If an FMU saves states, a single
    instance serves all copies. Otherwise each copy has an instance.
    """

    def __init__(self, about: dict[str, Any]) -> None:
        self.about, self.saves = about, about["saves"]
        self.longest_s = float("inf")
        self.units = FmuUnits(*(UnitScale(*map(np.array, group)) for group in about["units"]))
        self.instances: list[FmuInstance] = []
        self.m = self.instance(0).model()
        # True after a complete run: a later failure is due to the trial parameters
        self.went = False
        self.programs: list[SteppedProgram | None] = [None]

    def instance(self, number: int) -> FmuInstance:
        """Instance of a copy."""
        number = 0 if self.saves else number
        while len(self.instances) <= number:
            self.instances.append(FmuInstance(self.about, len(self.instances)))
        return self.instances[number]

    def judge(self, statuses: NDArray[np.int64], y: Array, at_s: float) -> None:
        """Turn failures into NaN; before the first successful run, into an error."""
        if not statuses.any() and np.isfinite(y).all():
            return
        for status in statuses[statuses != 0]:
            if not self.went or status == FATAL:
                raise RuntimeError(why(self.m, int(status), at_s))
        y[statuses != 0] = np.nan
        if not self.went:
            _, column = np.argwhere(~np.isfinite(y))[0]
            name = self.about["called"][column]
            raise RuntimeError(f"its output {name!r} is {y[_, column]:g} at {at_s:.4g} s")

    def answer(self, request: Parcel) -> Parcel:
        what = request.about["what"]
        if what == "run":
            return self.run(request)
        if what == "program":
            simulator: Any = self  # `HiddenFmu` or `SeenFmu`
            self.programs.append(rebuilt_program(request.about, simulator))
            return packed({}, [np.array([len(self.programs) - 1.0])])
        if what not in CALLS:
            raise ValueError(what)
        answer = getattr(self, what)(*request.arrays(), *request.about["values"])
        return packed({}, list(answer))

    def run(self, request: Parcel) -> Parcel:
        about = request.about
        memory, course = run_of(request)
        if about["saved"]:
            plain, *copies = about["saved"]
            memory.saved = plain, dict(copies)
        program = self.programs[about["program"]]
        assert program is not None
        result = program.run(
            memory,
            course.inputs,
            course.p,
            stepping=course.stepping,
            columns=course.columns,
            weights=course.weights,
        )
        answer = run_answer(memory, result)
        header: dict[str, Any] = {**answer.about, "kept": [], "columns": []}
        if memory.saved and not self.about["seen"]:
            first, others = memory.saved
            header["kept"] = [first, *others.values()]
            header["columns"] = list(others)
        return Parcel(header, answer.numbers)

    def drop(self, numbers: Sequence[int]) -> tuple[()]:
        """Drop saved states and programs; the numbers of programs are negative."""
        for number in numbers:
            if number < 0:
                self.programs[-number] = None
        return ()


class HiddenFmu(FmuHost, Carrier):
    """Copies that keep their states to themselves."""

    def __init__(self, about: dict[str, Any]) -> None:
        super().__init__(about)
        self.whole_samples = not about["any_step"]
        self.copies: list[_Copy] = []
        self.standing = -1  # copy whose state the single instance has
        self.statuses = np.zeros(0, np.int64)
        self.kept: dict[int, _Copy] = {}
        self.count = 0

    def begin(self, p: Array) -> Array:
        self.release(self.copies)
        self.copies, readings = [], []
        for k, row in enumerate(self.units.parameters.outside(p)):
            instance = self.instance(k)
            instance.restart(self.m, row)
            self.copies.append(
                _Copy(0.0, row.copy(), 0, None, instance.x.copy(), instance.due.copy())
            )
            readings.append(self._store_readings(k, instance))
        return self._run_begins(readings)

    def resume(self, saved: Sequence[int], p: Array) -> Array:
        self.release(self.copies)
        self.copies, readings = [], []
        rows = self.units.parameters.outside(p)
        for k, (number, row) in enumerate(zip(saved, rows, strict=True)):
            before = self.kept[number]
            instance = self._restored_instance(k, before)
            instance.x, instance.due = before.x.copy(), before.due.copy()
            changed = np.flatnonzero(before.p != row).tolist()
            if not all(self.about["tunable"][i] for i in changed):
                raise ValueError("a parameter that is fixed from the start was to be changed")
            if changed:
                instance.change_parameters(self.m, changed, row)
            self.copies.append(
                _Copy(before.time_s, row.copy(), 0, before.past, instance.x, instance.due)
            )
            readings.append(self._store_readings(k, instance))
        return self._run_begins(readings)

    def _run_begins(self, readings: list[Array]) -> Array:
        n = len(self.copies)
        self.standing = 0 if self.saves and n == 1 else -1
        self.statuses = np.zeros(n, np.int64)
        self.handles = np.array([self.instance(k).handle for k in range(n)], np.int64)
        self.saved = np.array([c.state for c in self.copies], np.int64)
        self.times = np.array([c.time_s for c in self.copies])
        self.x = np.array([c.x for c in self.copies]).reshape(n, -1)
        self.due = np.array([c.due for c in self.copies]).reshape(n, 1)
        self.y = np.array(readings)
        return self.units.outputs.inside(self.y)

    def step(self, f: Array, h: float) -> Array:
        f = np.ascontiguousarray(self.units.inputs.outside(f))
        rows = self.x, self.due, self.y, self.statuses
        advance_copies(self.m, self.handles, self.saved, self.standing, self.times, f, h, *rows)
        self.judge(self.statuses, self.y, self.times[0] + h)
        self.times += h
        if not self.saves:
            for copy, row in zip(self.copies, f, strict=True):
                copy.past = (copy.past, row.copy(), h)
        return self.units.outputs.inside(self.y)

    def _store_readings(self, k: int, instance: FmuInstance) -> Array:
        """Readings of the instance, for a copy in the same state."""
        if self.saves:
            self.copies[k].state = instance.save(self.m)
        else:
            instance.past = self.copies[k].past
        return instance.outputs(self.m)

    def _restored_instance(self, k: int, copy: _Copy) -> FmuInstance:
        """Instance in the state of the copy."""
        instance = self.instance(k)
        if self.saves:
            instance.restore(self.m, copy.state)
            return instance
        if not instance.fresh and instance.past is copy.past and copy.past is not None:
            return instance
        instance.restart(self.m, copy.p)
        rows, past, time_s = [], copy.past, 0.0
        while past is not None:
            past, f, h = past
            rows.append((f, h))
        x, due = instance.x[None].copy(), instance.due[None].copy()
        y, handles = np.zeros((1, len(self.m.outputs))), np.array([instance.handle])
        none, status = np.zeros(1, np.int64), np.zeros(1, np.int64)
        for f, h in reversed(rows):
            at = np.array([time_s])
            advance_copies(self.m, handles, none, -1, at, f[None], h, x, due, y, status)
            instance.check(self.m, int(status[0]), time_s)
            time_s += h
        return instance

    def save(self) -> tuple[int, ...]:
        first = self.count + 1
        self.count += len(self.copies)
        if self.standing == 0:
            self.saved[0] = self.instance(0).save(self.m, int(self.saved[0]))
        for k, copy in enumerate(self.copies):
            copy.time_s, copy.state = float(self.times[k]), int(self.saved[k])
            copy.x, copy.due = self.x[k].copy(), self.due[k].copy()
            if not self.saves:
                self.instance(k).past = copy.past
        self.went = self.went or not self.statuses.any()
        self.kept.update(zip(range(first, self.count + 1), self.copies, strict=True))
        self.copies = []
        return tuple(range(first, self.count + 1))

    def drop(self, numbers: Sequence[int]) -> tuple[()]:
        self.release([self.kept.pop(number) for number in numbers if number > 0])
        return super().drop(numbers)

    def release(self, copies: list[_Copy]) -> None:
        for copy in copies:
            if copy.state:
                self.instance(0).free(copy.state)


class SeenFmu(FmuHost):
    """Copies whose states are their whole memory, of model exchange.

    It is a `pamid.engine.simulator.Simulator`. places: indices of the readings among the outputs.
    """

    def __init__(self, about: dict[str, Any]) -> None:
        super().__init__(about)
        outputs, states = about["outputs"], about["states"]
        self.places = np.array([i for i, v in enumerate(outputs) if v not in states], np.intp)
        self.sizes = self.units.states.scale * about["nominals"], np.ones(len(about["inputs"]))
        self.of_values: dict[bytes, FmuInstance] = {}

    def with_values(self, p: Array) -> FmuInstance:
        """Instance with these parameters."""
        key = p.tobytes()
        # moved to the end: the least recently used is restarted
        instance = self.of_values.pop(key, None)
        if instance is None:
            if len(self.of_values) >= self.instance_limit:
                instance = self.of_values.pop(next(iter(self.of_values)))
            elif not self.of_values:
                instance = self.instance(0)
            else:
                instance = FmuInstance(self.about, len(self.of_values))
            instance.restart(self.m, p)
            if not self.went:
                # rates and outputs that change with the time alone are those of a clock
                rows = []
                for at_s in (0.0, LATER_S):
                    rates = np.zeros(len(instance.x))
                    status = rates_at(self.m, instance.handle, at_s, instance.x, rates)
                    instance.check(self.m, status, at_s)
                    rows.append([*rates, *instance.outputs(self.m)])
                same = np.array_equal(rows[0], rows[1], equal_nan=True)
                if np.isfinite(instance.due[0]) or not same:
                    raise RuntimeError(TIMED)
        self.of_values[key] = instance
        return instance

    @property
    def instance_limit(self) -> int:
        """Largest number of instances with different parameters."""
        return 1 if self.about["alone"] else MOST_INSTANCES

    @contextmanager
    def in_c(self, p: Array, h: float) -> Iterator[LibraryStep | None]:
        """See `pamid.engine.simulator.Simulator`. None for more copies than instances."""
        if len(p) > self.instance_limit:
            yield None
            return
        rows = self.units.parameters.outside(p)
        handles = np.array([self.with_values(row).handle for row in rows], np.int64)
        words = exchange_words(self.m, self.units, h)
        table = table_in(words)

        def of(numbers: NDArray[Any]) -> NDArray[np.int64]:
            return np.asarray(numbers.ctypes.data + 8 * np.arange(len(numbers)), np.int64)

        assert exchange_of.address is not None
        address: Any = exchange_of.address
        yield LibraryStep(
            address,
            words.ctypes.data,
            of(handles),
            1,
            of(table.x),
            of(table.f),
            np.zeros(0, np.int64),
            of(table.y)[self.places],
            words.ctypes.data + 8 * LEADS,
        )
        status = int(words[STATUS])
        if status and (not self.went or status == FATAL):
            raise RuntimeError(why(table.model, status, h))
        self.went = self.went or not status

    def steps(self, x: Array, f: Array, p: Array, h: float) -> tuple[Array, Array]:
        """See `pamid.engine.simulator.Simulator`."""
        units, ny = self.units, len(self.m.outputs)
        values, statuses = np.zeros((len(x), ny + x.shape[1])), np.zeros(len(x), np.int64)
        values[:, ny:] = units.states.outside(x)
        inputs, grid, due = units.inputs.outside(f), np.zeros(MOST_STEPS + 1), np.zeros(1)
        for k, row in enumerate(units.parameters.outside(p)):
            c = self.with_values(row).handle
            statuses[k] = exchange(self.m, c, 0.0, h, inputs[k], values[k, ny:], due, grid)
            statuses[k] = statuses[k] or get_outputs(self.m, c, values[k, :ny])
        self.judge(statuses, values, h)
        self.went = True
        outputs = units.outputs.inside(values[:, :ny])
        return units.states.inside(values[:, ny:]), outputs[:, self.places]

    def reads(self, x: Array, p: Array) -> Array:
        """See `pamid.engine.simulator.Simulator`."""
        if not len(self.places):
            return np.empty((len(x), 0))
        rows = zip(self.units.states.outside(x), self.units.parameters.outside(p), strict=True)
        outputs = [self.with_values(row).outputs_at(self.m, state) for state, row in rows]
        return self.units.outputs.inside(np.array(outputs))[:, self.places]


def serve(inlet: int, outlet: int) -> None:
    """Answer requests until the pipe closes. The first request describes the FMU."""
    incoming, outgoing = Connection(inlet, writable=False), Connection(outlet, readable=False)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the binary may print
    host: FmuHost | None = None
    while True:
        try:
            request = Parcel.of(incoming.recv_bytes())
        except EOFError:
            return
        try:
            reply = request  # an empty reply is as good
            if host is None:
                host = (SeenFmu if request.about["seen"] else HiddenFmu)(request.about)
            else:
                reply = host.answer(request)
            outgoing.send_bytes(NUMBERS + reply.message)
        except Exception as error:
            kind = "" if isinstance(error, RuntimeError) else f"{type(error).__name__}: "
            outgoing.send_bytes(FAILED + f"{kind}{error}".encode())
