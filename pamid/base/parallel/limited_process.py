"""A function of pamid in a separate process, with limits on its time and its memory.

Foreign code that reads a file can crash, hang, or take all memory, and native code hears no signal.
Here it runs in another process, which ends at its limits, with its parent, or on Ctrl-C. Arguments
and answers are JSON; arrays travel as files in a folder that both know. Nothing that comes back is
executed.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import json
import math
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pamid.base.errors import FileError, PamidError
from pamid.base.files import MIB
from pamid.base.progress import tell

_ANSWER, _ERRORS = "answer.json", "stderr.txt"
_SAY_S = 0.5  # between two lines of progress
_OUT_OF_MEMORY = 77  # exit code of a child whose allocation failed
_LAST_BYTES = 4096  # of its stderr, which may be long
_PR_SET_PDEATHSIG = 1


@dataclass(frozen=True)
class ProcessLimits:
    """Limits of a child process.

    seconds   of processor time
    patience  seconds that may pass, on a busy machine or while it waits for something
    memory    bytes that it may allocate in addition to those of a bare interpreter
    """

    seconds: float
    patience: float
    memory: int


class ProcessFailure(Exception):
    """The child process has no answer; the text is a clause with the reason."""


def run_limited(
    function: str, arguments: Mapping[str, Any], folder: Path, limits: ProcessLimits, label: str
) -> dict[str, Any]:
    """Call a function in a child process and return its answer.

    function: "module:name" of a function of pamid; it takes `arguments` and `folder` by name and
    returns a dict that JSON can hold. arguments: plain values. folder: an empty temporary folder:
    the child's working folder, and the place of its files. limits: what the child may take. label:
    progress text while it runs. Raises FileError: as the function raised it (any `PamidError`).
    Raises ProcessFailure: the child crashed, or exceeded a limit.
    """
    request = {
        "function": function,
        "arguments": dict(arguments),
        "folder": str(folder),
        "seconds": limits.seconds,
        "memory": limits.memory,
        "parent": os.getpid(),
    }
    code = _finished(json.dumps(request).encode(), folder, limits.patience, label)
    if code:
        raise ProcessFailure(_reason(code, folder, limits))
    answer: dict[str, Any] = json.loads((folder / _ANSWER).read_text(encoding="utf-8"))
    if "error" in answer:
        raise FileError(**answer["error"])
    content: dict[str, Any] = answer["answer"]
    return content


def _finished(request: bytes, folder: Path, patience: float, label: str) -> int:
    """The exit code of a child that got this request. It does not outlive this function."""
    places = dict.fromkeys(os.path.abspath(entry or os.getcwd()) for entry in sys.path)
    command = [sys.executable, "-P", "-c", f"from {__name__} import serve; serve()"]
    with open(folder / _ERRORS, "wb") as errors:
        child = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            cwd=folder,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(places)},
        )
    assert child.stdin is not None
    try:
        with contextlib.suppress(BrokenPipeError), child.stdin as stdin:
            stdin.write(request)
        begun = time.monotonic()
        while True:
            with contextlib.suppress(subprocess.TimeoutExpired):
                return child.wait(min(_SAY_S, patience))
            if time.monotonic() - begun >= patience:
                raise ProcessFailure(f"it did not end within {patience:.0f} s")
            tell(label)
    finally:
        child.kill()
        child.wait()


def _reason(code: int, folder: Path, limits: ProcessLimits) -> str:
    if code == _OUT_OF_MEMORY:
        return f"it needs more than {limits.memory // MIB} MiB of memory"
    if code == -signal.SIGXCPU:
        return f"it took more than {limits.seconds:.0f} s of processor time"
    if code < 0:
        had = f"{limits.memory // MIB} MiB"
        return f"it crashed (signal {-code}), perhaps for lack of memory (limit {had})"
    with open(folder / _ERRORS, "rb") as file:
        file.seek(max(0, os.fstat(file.fileno()).st_size - _LAST_BYTES))
        last = file.read().decode(errors="replace").strip().rpartition("\n")[2]
    return f"it crashed ({last or f'exit code {code}'})"


# ---- in the child ------------------------------------------------------------------------------


def serve() -> None:
    """Answer the request on stdin; the entry point of the child process."""
    request = json.load(sys.stdin)
    _end_with(request["parent"])
    folder = Path(request["folder"])
    module, _, name = request["function"].partition(":")
    answer: dict[str, Any]
    try:
        function = getattr(importlib.import_module(module), name)
        _limit(request["seconds"], request["memory"])
        answer = {"answer": function(**request["arguments"], folder=folder)}
        text = json.dumps(answer)
    except PamidError as error:
        failure = {n: getattr(error, n) for n in ("message", "hint", "code", "exit_code")}
        text = json.dumps({"error": failure})
    except MemoryError:
        os._exit(_OUT_OF_MEMORY)
    (folder / _ANSWER).write_text(text, encoding="utf-8")


def _end_with(parent: int) -> None:
    """End this process when its parent ends, whatever it is doing then."""
    if sys.platform != "linux":
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it ended before
        os._exit(1)


def _limit(seconds: float, memory: int) -> None:
    """Set the limits of this process.

    RLIMIT_DATA counts memory that is writable and private. RLIMIT_AS also counts address space that
    allocators reserve and never use, a GiB at a time, and files that are mapped to be read.
    """
    whole = math.ceil(seconds)
    wanted = {"RLIMIT_CORE": (0, 0), "RLIMIT_CPU": (whole, whole + 5)}
    statm = Path("/proc/self/statm")
    if statm.exists():
        data = int(statm.read_text().split()[5]) * resource.getpagesize()
        wanted["RLIMIT_DATA"] = (data + memory, data + memory)
    for name, limits in wanted.items():
        with contextlib.suppress(OSError, ValueError):  # a stricter limit holds already
            resource.setrlimit(getattr(resource, name), limits)
