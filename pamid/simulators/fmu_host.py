"""The process that holds an FMU: its binary may print, hang, or crash, and then only this process
does.

Requests come by a pipe from the program that started this process: a word, then numbers. Answers
are numbers or a sentence, never objects.
"""

from __future__ import annotations

import json
import os
import sys
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FAILED, NUMBERS = b"!", b"="


@dataclass
class _Copy:
    """A copy of the FMU: its time, its parameters, and where it stands: a state that the FMU has
    saved, or where it cannot save one, the inputs of all steps from the start (the last one first,
    each with what was before it)."""

    time_s: float
    p: Array
    state: Any = None
    past: Any = None


@dataclass
class FmuHost:
    """Copies of one FMU. parameters: value references, of which `tunable` may be set later;
    inputs, outputs: value references; saves: it can save its state."""

    path: str
    folder: str
    version: int
    identifier: str
    token: str
    parameters: list[int]
    tunable: list[bool]
    inputs: list[int]
    outputs: list[int]
    saves: bool
    copies: list[_Copy] = field(default_factory=list)
    instances: list[Any] = field(default_factory=list)
    kept: dict[int, _Copy] = field(default_factory=dict)
    count: int = 0

    # ---- one instance ----------------------------------------------------------------------------

    def instance(self, number: int) -> Any:
        """The instance of a copy; of an FMU that saves states one serves them all."""
        number = 0 if self.saves else number
        while len(self.instances) <= number:
            from fmpy import fmi2, fmi3

            kind = fmi2.FMU2Slave if self.version == 2 else fmi3.FMU3Slave
            made = kind(
                guid=self.token,
                unzipDirectory=self.folder,
                modelIdentifier=self.identifier,
                instanceName=f"pamid_{len(self.instances)}",
            )
            made.instantiate()
            made.fresh, made.past = True, None
            self.instances.append(made)
        return self.instances[number]

    def put(self, fmu: Any, references: list[int], values: Array) -> None:
        if references:
            (fmu.setReal if self.version == 2 else fmu.setFloat64)(references, values.tolist())

    def read(self, fmu: Any) -> Array:
        get = fmu.getReal if self.version == 2 else fmu.getFloat64
        return np.array(get(self.outputs), float)

    def started(self, number: int, p: Array) -> Any:
        """The instance at time 0 with these parameters."""
        fmu = self.instance(number)
        if not fmu.fresh:
            fmu.reset()
        fmu.fresh, fmu.past = False, None
        if self.version == 2:
            fmu.setupExperiment(startTime=0.0)
        self.put(fmu, self.parameters, p)
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        return fmu

    def stepped(self, fmu: Any, f: Array, time_s: float, h: float) -> None:
        self.put(fmu, self.inputs, f)
        fmu.doStep(currentCommunicationPoint=time_s, communicationStepSize=h)

    # ---- states ----------------------------------------------------------------------------------

    def entered(self, number: int, copy: _Copy) -> Any:
        """An instance where the copy stands."""
        if self.saves:
            fmu = self.instance(0)
            fmu.setFMUState(copy.state)
            return fmu
        fmu = self.instance(number)
        if not fmu.fresh and fmu.past is copy.past and copy.past is not None:
            return fmu
        fmu, rows, past = self.started(number, copy.p), [], copy.past
        while past is not None:
            past, f, h = past
            rows.append((f, h))
        time_s = 0.0
        for f, h in reversed(rows):
            self.stepped(fmu, f, time_s, h)
            time_s += h
        fmu.past = copy.past
        return fmu

    def left(self, fmu: Any, copy: _Copy) -> Array:
        """What the instance reads, for a copy that stands where it does."""
        if self.saves:
            if copy.state is not None:
                fmu.freeFMUState(copy.state)
            copy.state = fmu.getFMUState()
        else:
            fmu.past = copy.past
        return self.read(fmu)

    def let_go(self, copies: list[_Copy]) -> None:
        for copy in copies:
            if copy.state is not None:
                self.instance(0).freeFMUState(copy.state)

    # ---- requests --------------------------------------------------------------------------------

    def begin(self, p: Array) -> Array:
        self.let_go(self.copies)
        self.copies = [_Copy(0.0, row.copy()) for row in p]
        return np.array(
            [self.left(self.started(k, copy.p), copy) for k, copy in enumerate(self.copies)]
        )

    def resume(self, kept: list[int], p: Array) -> Array:
        self.let_go(self.copies)
        self.copies, found = [], []
        for k, (number, row) in enumerate(zip(kept, p, strict=True)):
            before = self.kept[number]
            fmu = self.entered(k, before)
            for i in np.flatnonzero(before.p != row).tolist():
                if not self.tunable[i]:
                    raise ValueError("a parameter that is fixed from the start was to be changed")
                self.put(fmu, [self.parameters[i]], row[i : i + 1])
            copy = _Copy(before.time_s, row.copy(), past=before.past)
            self.copies.append(copy)
            found.append(self.left(fmu, copy))
        return np.array(found)

    def step(self, f: Array, h: float) -> Array:
        found = []
        for k, (copy, row) in enumerate(zip(self.copies, f, strict=True)):
            fmu = self.entered(k, copy)
            self.stepped(fmu, row, copy.time_s, h)
            copy.time_s += h
            copy.past = None if self.saves else (copy.past, row.copy(), h)
            found.append(self.left(fmu, copy))
        return np.array(found)

    def keep(self) -> Array:
        first = self.count + 1
        self.count += len(self.copies)
        self.kept.update(zip(range(first, self.count + 1), self.copies, strict=True))
        self.copies = []
        return np.arange(first, self.count + 1, dtype=float)[None]

    def drop(self, numbers: list[int]) -> Array:
        self.let_go([self.kept.pop(number) for number in numbers])
        return np.zeros((0, 0))

    def answer(self, request: bytes) -> Array:
        """To one request: its word, what it says besides (JSON), a zero, a table of numbers."""
        about, numbers = request[1:].split(b"\0", 1)
        said = json.loads(about)
        table = np.frombuffer(numbers).reshape(said["shape"])
        if request[:1] == b"b":
            return self.begin(table)
        if request[:1] == b"r":
            return self.resume(said["kept"], table)
        if request[:1] == b"s":
            return self.step(table, said["h"])
        return self.keep() if request[:1] == b"k" else self.drop(said["kept"])


def serve(inlet: int, outlet: int) -> None:
    """Answer requests until there are no more. The first one says which FMU it is."""
    asked, told = Connection(inlet, writable=False), Connection(outlet, readable=False)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the binary may print
    host: FmuHost | None = None
    while True:
        try:
            request = asked.recv_bytes()
        except EOFError:
            return
        try:
            if host is None:
                host, found = FmuHost(**json.loads(request)), np.zeros((0, 0))
            else:
                found = host.answer(request)
            shape = json.dumps(found.shape).encode()
            told.send_bytes(NUMBERS + shape + b"\0" + np.ascontiguousarray(found).tobytes())
        except Exception as error:
            told.send_bytes(FAILED + f"{type(error).__name__}: {error}".encode())
