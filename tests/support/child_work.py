"""Functions for the child process of `pamid.base.parallel.limited_process`, each with another
end."""

import os
import signal
import threading
from pathlib import Path
from typing import Any

from pamid.base.errors import DataError


def answer(folder: Path, number: int) -> dict[str, Any]:
    Path("left.txt").write_text("in the working folder")
    return {"number": number, "folder": str(folder), "at": os.getcwd()}


def refuse(folder: Path) -> dict[str, Any]:
    raise DataError("too short", "record more", code="too-short")


def crash(folder: Path) -> dict[str, Any]:
    os.kill(os.getpid(), signal.SIGSEGV)
    return {}


def fail(folder: Path) -> dict[str, Any]:
    raise AttributeError("no such thing")


def fill_memory(folder: Path) -> dict[str, Any]:
    return {"length": len(bytearray(1 << 36))}


def compute(folder: Path) -> dict[str, Any]:
    while True:
        pass


def wait(folder: Path) -> dict[str, Any]:
    threading.Event().wait()
    return {}
