"""An FMU in a separate process, driven by the engine (`pamid.engine.shadow_simulators.Carrier`)."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import tempfile
import weakref
from multiprocessing import Pipe
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.engine.program import Memory
from pamid.engine.remote_program import (
    Course,
    Parcel,
    packed,
    program_data,
    run_request,
    take_answer,
)
from pamid.engine.shadow_simulators import Carrier
from pamid.engine.stepped import SteppedProgram
from pamid.rigs.simulators.fmu_file import FmuFile, extracted

PATIENCE_S = 120.0  # longest wait for an answer
COMPILING = 5.0  # factor on the first wait, because the first run may compile code
FAILED = b"!"  # as in `pamid.rigs.simulators.fmu_host`
PATIENT_SAMPLES = 10000.0  # samples per additional PATIENCE_S of a run


class SavedState:
    """A saved state, by its number in the other process; it is dropped there with this object."""

    def __init__(self, number: int, dropped: list[int]) -> None:
        self.number = number
        weakref.finalize(self, dropped.append, number)


class FmuProcess(Carrier):
    """Copies of an FMU, held by another process, which makes whole runs of it.

    The process starts with the first copy, and loads the FMU's binary then.
    """

    def __init__(self, file: FmuFile) -> None:
        self.file = file
        self.programs: weakref.WeakKeyDictionary[SteppedProgram, int] = weakref.WeakKeyDictionary()
        self.whole_samples, self.longest_s = not file.any_step, float("inf")
        self.dropped: list[int] = []
        self.compiled = False
        self.folder = tempfile.TemporaryDirectory(prefix="pamid-fmu-")
        extracted(file.path, self.folder.name)
        inlet, self.to_child = Pipe(duplex=False)
        self.from_child, outlet = Pipe(duplex=False)
        ends = inlet.fileno(), outlet.fileno()
        code = f"from pamid.rigs.simulators.fmu_host import serve; serve({ends[0]}, {ends[1]})"
        self.child = subprocess.Popen(
            [sys.executable, "-P", "-c", code],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(e or os.getcwd() for e in sys.path)},
            pass_fds=ends,
            stdin=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        inlet.close()
        outlet.close()
        self.poller = select.poll()
        self.poller.register(self.from_child, select.POLLIN | select.POLLHUP)
        weakref.finalize(self, _close, self.child, self.to_child, self.folder)
        self._exchange(packed({**file.request, "folder": self.folder.name}, []))

    # ---- whole runs ------------------------------------------------------------------------------

    def run_there(
        self, program: SteppedProgram, memory: Memory, course: Course
    ) -> tuple[Array, Array, int]:
        """See `pamid.engine.stepped.FarRunner`."""
        request = run_request(memory, course)
        saved = memory.saved and [
            memory.saved[0].number,
            *(sorted((c, state.number) for c, state in memory.saved[1].items())),
        ]
        about = {"what": "run", "program": self._number(program), "saved": saved}
        patience = 1.0 + len(course.inputs) / PATIENT_SAMPLES
        parcel = self._exchange(Parcel({**request.about, **about}, request.numbers), patience)
        self.compiled, header = True, parcel.about
        result = take_answer(memory, parcel)
        states = [SavedState(int(k), self.dropped) for k in header["kept"]]
        if states:
            memory.saved = (
                states[0],
                dict(zip(map(int, header["columns"]), states[1:], strict=True)),
            )
        return result

    def _number(self, program: SteppedProgram) -> int:
        """Number of a program in the other process.

        An unknown program is sent first. States and programs that are no longer in use are dropped
        there.
        """
        if self.dropped:
            gone = [self.dropped.pop() for _ in range(len(self.dropped))]
            self._request("drop", [], gone)
        number = self.programs.get(program)
        if number is None:
            answer = self._exchange(packed({"what": "program", **program_data(program)}, []))
            number = self.programs[program] = int(answer.numbers[0])
            weakref.finalize(program, self.dropped.append, -number)
        return number

    # ---- what is sent ----------------------------------------------------------------------------

    def steps(self, x: Array, f: Array, p: Array, h: float) -> tuple[Array, Array]:
        """See `pamid.engine.simulator.Simulator`, for seen states."""
        after, readings = self._request("steps", [x, f, p], h)
        return after, readings

    def reads(self, x: Array, p: Array) -> Array:
        """See `pamid.engine.simulator.Simulator`, for seen states."""
        return np.array(self._request("reads", [x, p]))

    def _request(self, what: str, arrays: list[Array | None], *values: Any) -> list[Array]:
        """Answer of a method in the other process, of `pamid.rigs.simulators.fmu_host.CALLS`."""
        answer = self._exchange(packed({"what": what, "values": values}, arrays))
        return list(answer.arrays())

    def _exchange(self, request: Parcel, patience: float = 1.0) -> Parcel:
        waits_s = PATIENCE_S * patience * (1.0 if self.compiled else COMPILING)
        try:
            self.to_child.send_bytes(request.message)
            if not self.poller.poll(1000.0 * waits_s):
                self.child.kill()
                self.child.wait()
                raise self._failed(f"it did not answer within {waits_s:.3g} s, and was ended")
            answer = self.from_child.recv_bytes()
        except (EOFError, OSError) as error:
            code = self.child.wait()
            reason = f"it crashed (signal {-code})" if code < 0 else f"it ended (exit code {code})"
            raise self._failed(reason) from error
        if answer.startswith(FAILED):
            raise self._failed(answer[1:].decode(errors="replace"))
        return Parcel.of(answer[1:])

    def _failed(self, what: str) -> FileError:
        return FileError(
            f"{self.file.path}: the FMU failed: {what}.",
            "Run it on the same inputs with `fmpy simulate`, and repair it or export it again.",
            code="simulation",
        )


def _close(child: subprocess.Popen[bytes], ask: Any, folder: Any) -> None:
    ask.close()
    child.kill()
    child.wait()
    folder.cleanup()
