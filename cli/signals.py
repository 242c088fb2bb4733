"""End of a command after a signal (SIGTERM, or SIGINT of Ctrl-C).

Python runs a signal handler between two bytecode instructions, so native code that runs for a
minute delays it by a minute. A KeyboardInterrupt raised in a callback of native code is lost.
Therefore a thread waits for the first signal. It repeats a lost interrupt, and ends the process
when the grace period is over. Files are written atomically, so no half-written file is left.
"""

from __future__ import annotations

import _thread
import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

INTERRUPTED = 130
GRACE_S = 4.0  # from the first signal; then the process ends, whatever it is doing
_LOOK_S = 0.1
_WATCHED_SIGNALS = (signal.SIGTERM, signal.SIGINT)


@dataclass
class _Signals:
    came: bool = False
    lost: bool = False  # was the interrupt raised where nothing could catch it?


_STATE = _Signals()


def was_signalled() -> bool:
    """Whether this process has received a signal to end."""
    return _STATE.came


def watch_signals(last_words: Callable[[], None]) -> None:
    """End the command on SIGTERM as on Ctrl-C, within the grace period in any case.

    last_words: prints that the command was interrupted, if the command could not do so itself.
    """
    signal.signal(signal.SIGTERM, _interrupt)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt_again)
    sys.unraisablehook = _note_lost
    ours, theirs = os.pipe()
    os.set_blocking(theirs, False)
    signal.set_wakeup_fd(theirs, warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(ours, last_words), daemon=True).start()


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Handle SIGTERM. Finished work is kept, and a second SIGTERM has no effect."""
    if not _STATE.came or _STATE.lost:
        _interrupt_again(number, frame)


def _interrupt_again(number: int, frame: FrameType | None) -> None:
    """Handle SIGINT. Every Ctrl-C interrupts, also the clean-up after an earlier Ctrl-C."""
    _STATE.came, _STATE.lost = True, False
    raise KeyboardInterrupt


def _note_lost(lost: sys.UnraisableHookArgs) -> None:
    if _STATE.came and issubclass(lost.exc_type, KeyboardInterrupt):
        _STATE.lost = True  # raised here it would be lost as well; the watching thread repeats it
    else:
        sys.__unraisablehook__(lost)


def _watch(signals: int, last_words: Callable[[], None]) -> None:
    while not set(_WATCHED_SIGNALS) & set(os.read(signals, 1)):
        pass
    deadline = time.monotonic() + GRACE_S
    while (left := deadline - time.monotonic()) > 0.0:
        time.sleep(min(_LOOK_S, left))
        if _STATE.lost:
            _thread.interrupt_main(signal.SIGTERM)
    # children of native code ignore the signal and would outlive this process
    for task in Path("/proc/self/task").glob("*/children"):  # on Linux
        with contextlib.suppress(OSError):
            for child in task.read_text().split():
                os.kill(int(child), signal.SIGKILL)
    with contextlib.suppress(Exception):
        last_words()
    os._exit(INTERRUPTED)
