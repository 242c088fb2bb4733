"""An FMU in a process of its own, as the engine drives it (`pamid.engine.carried.Carrier`)."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Sequence
from multiprocessing import Pipe
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import FileError
from pamid.simulators.fmu_file import FmuFile, extracted
from pamid.simulators.fmu_host import FAILED

Array = NDArray[np.float64]

PATIENCE_S = 120.0  # that one answer may take


class _Kept:
    """A saved state in the other process, until nobody knows of it any more."""

    def __init__(self, number: int) -> None:
        self.number = number


class FmuProcess:
    """Copies of an FMU, held by another process; it is started, and the FMU's binary loaded, when
    the first of them begins."""

    def __init__(self, file: FmuFile) -> None:
        self.file = file
        self.whole_samples, self.longest_s = not file.any_step, float("inf")
        self.dropped: list[int] = []
        self.folder = tempfile.TemporaryDirectory(prefix="pamid-fmu-")
        extracted(file.path, self.folder.name)
        inlet, self.to_child = Pipe(duplex=False)
        self.from_child, outlet = Pipe(duplex=False)
        ends = inlet.fileno(), outlet.fileno()
        code = f"from pamid.simulators.fmu_host import serve; serve({ends[0]}, {ends[1]})"
        self.child = subprocess.Popen(
            [sys.executable, "-P", "-c", code],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(e or os.getcwd() for e in sys.path)},
            pass_fds=ends,
            stdin=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        inlet.close()
        outlet.close()
        weakref.finalize(self, _close, self.child, self.to_child, self.folder)
        self._answer(json.dumps({**file.request, "folder": self.folder.name}).encode())

    # ---- as a carrier ----------------------------------------------------------------------------

    def begin(self, p: Array) -> Array:
        return self._readings(b"b", {}, self.file.parameters.outside(p))

    def resume(self, saved: Sequence[Any], p: Array) -> Array:
        kept = [one.number for one in saved]
        return self._readings(b"r", {"kept": kept}, self.file.parameters.outside(p))

    def step(self, f: Array, h: float) -> Array:
        return self._readings(b"s", {"h": h}, self.file.inputs.outside(f))

    def save(self) -> tuple[_Kept, ...]:
        empty = np.zeros((0, 0))
        found = tuple(_Kept(int(number)) for number in self._request(b"k", {}, empty)[0])
        for one in found:
            weakref.finalize(one, self.dropped.append, one.number)
        if self.dropped:
            gone = [self.dropped.pop() for _ in range(len(self.dropped))]
            self._request(b"d", {"kept": gone}, empty)
        return found

    # ---- what is sent ----------------------------------------------------------------------------

    def _readings(self, word: bytes, about: dict[str, Any], table: Array) -> Array:
        return self.file.outputs.inside(self._request(word, about, table))

    def _request(self, word: bytes, about: dict[str, Any], table: Array) -> Array:
        said = json.dumps({**about, "shape": table.shape}).encode()
        return self._answer(word + said + b"\0" + np.ascontiguousarray(table).tobytes())

    def _answer(self, message: bytes) -> Array:
        try:
            self.to_child.send_bytes(message)
            if not self.from_child.poll(PATIENCE_S):
                self.child.kill()
                raise self._failed(f"it did not answer within {PATIENCE_S:g} s")
            answer = self.from_child.recv_bytes()
        except (EOFError, OSError) as error:
            code = self.child.wait()
            said = f"it crashed (signal {-code})" if code < 0 else f"it ended (exit code {code})"
            raise self._failed(said) from error
        if answer.startswith(FAILED):
            raise self._failed(answer[1:].decode(errors="replace"))
        shape, numbers = answer[1:].split(b"\0", 1)
        return np.frombuffer(numbers).reshape(json.loads(shape))

    def _failed(self, what: str) -> FileError:
        return FileError(
            f"{self.file.path}: the FMU failed: {what}.",
            "Run it on the same inputs with `fmpy simulate`, and mend it or export it again.",
            code="simulation",
        )


def _close(child: subprocess.Popen[bytes], ask: Any, folder: Any) -> None:
    ask.close()
    child.kill()
    child.wait()
    folder.cleanup()
