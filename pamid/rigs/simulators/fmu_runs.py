"""Process that holds an FMU. If its binary prints, hangs or crashes, only this process does.

Requests come by a pipe from the parent process. They and the answers are JSON and numbers, or a
sentence, never objects (`pamid.engine.remote_program.Parcel`). Whole runs are made here. The
equations around the FMU are sent once, as text that is compiled.
"""

from __future__ import annotations

import os
import sys
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.engine.remote_program import Parcel, packed, rebuilt_program, run_answer, run_of
from pamid.engine.stepped import SteppedProgram
from pamid.rigs.simulators.fmu_host import FmuHost
from pamid.rigs.simulators.fmu_link import SeenFmu

Array = NDArray[np.float64]

FAILED, NUMBERS = b"!", b"="
#: methods of `FmuHost` that may be requested
CALLS = ("step_states", "read_outputs", "drop")


class FmuRuns:
    """Received programs, and their runs."""

    def __init__(self, host: FmuHost) -> None:
        self.host, self.count = host, 0

    def answer(self, request: Parcel) -> Parcel:
        """Answer a request."""
        what = request.about["what"]
        if what == "run":
            return self.run(request)
        if what == "program":
            return packed({}, [self.add(request.about)])
        if what not in CALLS:
            raise ValueError(what)
        answer = getattr(self.host, what)(*request.arrays(), *request.about["values"])
        return packed({}, list(answer))

    def add(self, data: dict[str, Any]) -> Array:
        """Add a program and return its number."""
        simulator: Any = self.host
        if self.host.about["seen"]:
            states, forces = map(np.array, data["typical"])
            places = np.array(data["places"], np.intp)
            simulator = SeenFmu(self.host, places, (states, forces))
        self.count += 1
        self.host.programs[self.count] = rebuilt_program(data, simulator)
        return np.array([float(self.count)])

    def run(self, request: Parcel) -> Parcel:
        """Run a program."""
        about = request.about
        memory, course = run_of(request)
        if about["saved"]:
            plain, *copies = about["saved"]
            memory.saved = plain, dict(copies)
        program: SteppedProgram = self.host.programs[about["program"]]
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
        if memory.saved and not self.host.about["seen"]:
            first, others = memory.saved
            header["kept"] = [first, *others.values()]
            header["columns"] = list(others)
        return Parcel(header, answer.numbers)


def serve(inlet: int, outlet: int) -> None:
    """Answer requests until the pipe closes. The first request describes the FMU."""
    incoming, outgoing = Connection(inlet, writable=False), Connection(outlet, readable=False)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the binary may print
    runs: FmuRuns | None = None
    while True:
        try:
            request = Parcel.of(incoming.recv_bytes())
        except EOFError:
            return
        try:
            reply = request  # an empty reply is as good
            if runs is None:
                runs = FmuRuns(FmuHost(request.about))
            else:
                reply = runs.answer(request)
            outgoing.send_bytes(NUMBERS + reply.message)
        except Exception as error:
            kind = "" if isinstance(error, RuntimeError) else f"{type(error).__name__}: "
            outgoing.send_bytes(FAILED + f"{kind}{error}".encode())
