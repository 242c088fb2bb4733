"""Process that holds an FMU. If its binary prints, hangs or crashes, only this process does.

Requests come by a pipe from the parent process: a word, then numbers. Answers are numbers or a
sentence, never objects. Whole runs are made here (`pamid.engine.remote_program`). The equations
around the FMU are sent once, as text that is compiled.
"""

from __future__ import annotations

import json
import os
import struct
import sys
from contextlib import AbstractContextManager
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.engine.remote_program import Parcel, rebuilt_program, run_answer, run_of
from pamid.engine.simulator import LibraryStep
from pamid.engine.stepped import SteppedProgram
from pamid.simulators.fmu_host import SHAPE_HEAD, FmuHost
from pamid.simulators.fmu_link import FmuLink, FmuUnits, SavedState, SeenFmu, UnitScale

Array = NDArray[np.float64]

FAILED, NUMBERS = b"!", b"="
_LENGTH = struct.Struct("<q")


class NearFmu(FmuLink):
    """FMU in this process."""

    def __init__(self, host: FmuHost) -> None:
        self.host, self.longest_s = host, float("inf")
        self.whole_samples = not host.about["any_step"]
        self.units = FmuUnits(
            *(UnitScale(np.array(scale), np.array(offset)) for scale, offset in host.about["units"])
        )

    def _request(
        self, word: bytes, table: Array, h: float = 0.0, numbers: list[int] | None = None
    ) -> Array:
        return self.host.dispatch(word, table, h, numbers or [])

    def in_c(
        self, p: Array, h: float, places: NDArray[np.intp]
    ) -> AbstractContextManager[LibraryStep | None]:
        return self.host.in_c(self.units, p, h, places)


class FmuRuns:
    """Received programs, and their runs."""

    def __init__(self, host: FmuHost) -> None:
        self.host, self.near = host, NearFmu(host)
        self.count = 0

    def add(self, message: bytes) -> Array:
        """Add a program and return its number."""
        data, _ = split_message(message)
        simulator: Any = self.near
        if self.host.about["seen"]:
            states, forces = map(np.array, data["typical"])
            places = np.array(data["places"], np.intp)
            simulator = SeenFmu(self.near, places, (states, forces))
        self.count += 1
        self.host.programs[self.count] = rebuilt_program(data, simulator)
        return np.full((1, 1), float(self.count))

    def run(self, message: bytes) -> bytes:
        """Run a program and return the encoded result."""
        about, numbers = split_message(message)
        memory, course = run_of(Parcel(about, numbers))
        if about["saved"]:
            plain, *copies = about["saved"]
            memory.saved = SavedState(plain), {c: SavedState(number) for c, number in copies}
        program: SteppedProgram = self.host.programs[about["program"]]
        result = program.run(
            memory,
            course.u,
            course.p,
            period_s=course.period_s,
            time_s=course.time_s,
            stepping=course.stepping,
            columns=course.columns,
            weights=course.weights,
            after=course.after,
        )
        answer = run_answer(memory, result)
        header: dict[str, Any] = {**answer.about, "kept": [], "columns": []}
        if memory.saved and not self.host.about["seen"]:
            first, others = memory.saved
            header["kept"] = [first.number, *(other.number for other in others.values())]
            header["columns"] = list(others)
        header_bytes = json.dumps(header).encode()
        return _LENGTH.pack(len(header_bytes)) + header_bytes + answer.numbers.tobytes()


def split_message(message: bytes) -> tuple[dict[str, Any], Array]:
    """Header of a message, and the numbers behind it."""
    size = _LENGTH.unpack_from(message)[0]
    end = _LENGTH.size + size
    return json.loads(message[_LENGTH.size : end]), np.frombuffer(message, offset=end)


def serve(inlet: int, outlet: int) -> None:
    """Answer requests until the pipe closes. The first request describes the FMU."""
    incoming, outgoing = Connection(inlet, writable=False), Connection(outlet, readable=False)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the binary may print
    host: FmuHost | None = None
    runs: Any = None
    while True:
        try:
            request = incoming.recv_bytes()
        except EOFError:
            return
        try:
            if host is None:
                host, reply = FmuHost(json.loads(request)), np.zeros((0, 0))
                runs = FmuRuns(host)
            elif request[:1] == b"u":
                outgoing.send_bytes(NUMBERS + runs.run(request[1:]))
                continue
            else:
                reply = runs.add(request[1:]) if request[:1] == b"p" else host.answer(request)
            shape = SHAPE_HEAD.pack(0.0, *reply.shape)
            outgoing.send_bytes(NUMBERS + shape + np.ascontiguousarray(reply).tobytes())
        except Exception as error:
            kind = "" if isinstance(error, RuntimeError) else f"{type(error).__name__}: "
            outgoing.send_bytes(FAILED + f"{kind}{error}".encode())
