"""An FMU in a process of its own, as the engine drives it (`pamid.engine.carried.Carrier`)."""

from __future__ import annotations

import json
import os
import select
import struct
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

Array = NDArray[np.float64]

PATIENCE_S = 120.0  # that one answer may take
FAILED, HEAD = b"!", struct.Struct("<dqq")  # as `pamid.simulators.fmu_host` has them
_EMPTY = np.zeros((0, 0))


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
        self.told = select.poll()
        self.told.register(self.from_child, select.POLLIN | select.POLLHUP)
        weakref.finalize(self, _close, self.child, self.to_child, self.folder)
        self._answer(json.dumps({**file.request, "folder": self.folder.name}).encode())

    # ---- as a carrier ----------------------------------------------------------------------------

    def begin(self, p: Array) -> Array:
        return self._readings(b"b", self.file.parameters.outside(p))

    def resume(self, saved: Sequence[Any], p: Array) -> Array:
        kept = [one.number for one in saved]
        return self._readings(b"r", self.file.parameters.outside(p), kept=kept)

    def step(self, f: Array, h: float) -> Array:
        return self._readings(b"s", self.file.inputs.outside(f), h)

    def save(self) -> tuple[_Kept, ...]:
        found = tuple(_Kept(int(number)) for number in self._request(b"k", _EMPTY)[0])
        for one in found:
            weakref.finalize(one, self.dropped.append, one.number)
        if self.dropped:
            gone = [self.dropped.pop() for _ in range(len(self.dropped))]
            self._request(b"d", _EMPTY, kept=gone)
        return found

    # ---- where its states are seen ---------------------------------------------------------------

    def moved(self, x: Array, f: Array, p: Array, h: float) -> tuple[Array, Array]:
        """States and outputs h later, of n copies; all SI."""
        return self._parted(self._request(b"x", self._rows(x, f, p), h))

    def derived(self, x: Array, f: Array, p: Array, h: float) -> tuple[Array, Array, Array]:
        """Of the first copy outputs and states h later, in a row, and their derivatives by its
        states and what goes in (outputs and states, both); the same of every copy, where there are
        others. Empty where the FMU cannot tell."""
        found = self._request(b"l", self._rows(x, f, p), h)
        if not len(found):
            return _EMPTY, _EMPTY, _EMPTY
        wide, file = x.shape[1] + f.shape[1], self.file
        after = np.concatenate([file.outputs.scale, file.states.scale])
        before = np.concatenate([file.states.scale, file.inputs.scale])
        slopes = found[1 : 1 + wide].T * after[:, None] / before
        first, others = (
            np.concatenate(self._parted(rows)[::-1], axis=1)
            for rows in (found[:1], found[1 + wide :])
        )
        return first[0], slopes, others

    def shown(self, x: Array, p: Array) -> Array:
        """Outputs at these states; all SI."""
        rows = np.concatenate([self.file.states.outside(x), self.file.parameters.outside(p)], 1)
        return self._readings(b"o", rows)

    def _rows(self, x: Array, f: Array, p: Array) -> Array:
        file = self.file
        given = file.states.outside(x), file.inputs.outside(f), file.parameters.outside(p)
        return np.concatenate(given, axis=1)

    def _parted(self, rows: Array) -> tuple[Array, Array]:
        seen = len(self.file.outputs.variables)
        return self.file.states.inside(rows[:, seen:]), self.file.outputs.inside(rows[:, :seen])

    # ---- what is sent ----------------------------------------------------------------------------

    def _readings(
        self, word: bytes, table: Array, h: float = 0.0, kept: list[int] | None = None
    ) -> Array:
        return self.file.outputs.inside(self._request(word, table, h, kept))

    def _request(
        self, word: bytes, table: Array, h: float = 0.0, kept: list[int] | None = None
    ) -> Array:
        said = b"" if kept is None else json.dumps(kept).encode()
        return self._answer(word + HEAD.pack(h, *table.shape) + table.tobytes() + said)

    def _answer(self, message: bytes) -> Array:
        try:
            self.to_child.send_bytes(message)
            if not self.told.poll(1000.0 * PATIENCE_S):
                self.child.kill()
                self.child.wait()
                raise self._failed(f"it did not answer within {PATIENCE_S:g} s, and was ended")
            answer = self.from_child.recv_bytes()
        except (EOFError, OSError) as error:
            code = self.child.wait()
            said = f"it crashed (signal {-code})" if code < 0 else f"it ended (exit code {code})"
            raise self._failed(said) from error
        if answer.startswith(FAILED):
            raise self._failed(answer[1:].decode(errors="replace"))
        _, rows, columns = HEAD.unpack_from(answer, 1)
        return np.frombuffer(answer, offset=1 + HEAD.size).reshape(rows, columns)

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
