"""A fuzz input in a process of its own, with limits on time and memory, and at times a SIGTERM.

The process is forked from one that has imported everything, which takes milliseconds. A process is
charged for its processor time and for the time that it sleeps. It is not charged for the time that
it waits for a processor, so that a busy machine changes no outcome.
"""

import contextlib
import json
import os
import re
import select
import shutil
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

from fuzz_child import ALLOWED, INTERRUPTED, RunLimits, Site, Words, serve

SIGNAL_SHARE = 0.3
SIGNAL_AFTER_S = (1e-3, 3.0)  # log-uniform, from the first command on
LOOK_EVERY_S = 0.25


@dataclass(frozen=True)
class Outcome:
    """One input after its run.

    codes    exit codes of its commands
    faults   names of the faults, of `FAULTS`
    details  what is known of the faults, and the output of the commands
    cpu      seconds of processor time
    memory   peak resident memory, bytes
    """

    kind: str
    number: int
    codes: tuple[int, ...]
    faults: tuple[str, ...]
    details: str
    cpu: float
    memory: int
    signalled: bool


#: fault -> line of the summary
FAULTS = {
    "exit 1": "exit 1",
    "exit other": "exit codes that do not exist",
    "escaped": "escaped exceptions",
    "crash": "crashes",
    "time": "over time",
    "memory": "over memory",
    "disk": "over disk",
    "deaf": "deaf to SIGTERM",
    "unfinished": "half-written outputs",
    "survivor": "processes left behind",
}


@dataclass
class _Run:
    """A process at work on an input."""

    kind: str
    number: int
    folder: Path
    pid: int
    handle: int  # pidfd
    pipe: int
    limit: float
    signal_after: float | None
    text: bytes = b""
    report: dict[str, Any] = field(default_factory=dict)
    ready_at: float = 0.0  # when its first command began
    looked_at: float = 0.0
    cpu: float = 0.0
    charged: float = 0.0
    charged_at_signal: float | None = None
    fault: str = ""


def run_inputs(
    inputs: Iterable[tuple[str, int]],
    generators: dict[str, Callable[[Site], list[Words]]],
    seeds: Path,
    scratch: Path,
    *,
    jobs: int = 1,
    limits: RunLimits | None = None,
    signals: bool = True,
    keep: Path | None = None,
) -> Iterator[Outcome]:
    """Run inputs, `jobs` at a time, and yield their outcomes as they end.

    Parameters
    ----------
    inputs
        Kind and number of each.
    generators
        Kind -> function that writes an input and returns its command lines.
    seeds
        Folder of `fuzz_seeds.make_seeds`.
    scratch
        Folder for the inputs; each is removed after its run.
    signals
        Whether a share of the inputs gets a SIGTERM.
    keep
        Folder to which inputs with a fault are copied.
    """
    limits, waiting, running = limits or RunLimits(), iter(inputs), dict[int, _Run]()
    more = True
    try:
        while more or running:
            while more and len(running) < jobs:
                kind, number = next(waiting, ("", 0))
                more = bool(kind)
                if more:
                    run = _start(kind, number, generators, seeds, scratch, limits, signals)
                    running[run.pid] = run
            for run in _ended(running, limits):
                del running[run.pid]
                yield _outcome(run, limits, keep)
    finally:
        for run in running.values():
            _kill(run)
            os.waitpid(run.pid, 0)


def signal_after(kind: str, number: int) -> float | None:
    """Seconds after which this input gets its SIGTERM; None where it gets none."""
    random = Random(f"signal-{kind}-{number}")
    low, high = SIGNAL_AFTER_S
    return low * (high / low) ** random.random() if random.random() < SIGNAL_SHARE else None


# ---- the child --------------------


def _start(
    kind: str,
    number: int,
    generators: dict[str, Callable[[Site], list[Words]]],
    seeds: Path,
    scratch: Path,
    limits: RunLimits,
    signals: bool,
) -> _Run:
    folder = scratch / f"{kind}-{number}"
    (folder / "input").mkdir(parents=True)
    (folder / "tmp").mkdir()
    reading, writing = os.pipe()
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if not pid:
        try:
            os.setsid()
            os.close(reading)
            serve(
                Site(seeds, folder / "input", Random(f"{kind}-{number}")),
                generators[kind],
                writing,
                limits,
            )
        finally:
            os._exit(0)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    os.close(writing)
    os.set_blocking(reading, False)
    after = signal_after(kind, number) if signals else None
    handle = os.pidfd_open(pid)
    return _Run(kind, number, folder, pid, handle, reading, limits.seconds, after)


# ---- the parent --------------------


def _ended(running: dict[int, _Run], limits: RunLimits) -> list[_Run]:
    """Wait for the next event; read reports, send signals, end processes beyond a limit. Return the
    runs whose process has ended."""
    poll, now = select.poll(), time.monotonic()
    waits = [LOOK_EVERY_S]
    for run in running.values():
        poll.register(run.handle, select.POLLIN)
        if not run.ready_at:
            poll.register(run.pipe, select.POLLIN)
        elif run.signal_after is not None and run.charged_at_signal is None:
            waits.append(max(run.ready_at + run.signal_after - now, 0.0))
    events = {handle for handle, _ in poll.poll(1e3 * min(waits) + 0.5)}
    for run in running.values():
        _read(run)
        now = time.monotonic()
        is_waiting = run.signal_after is not None and run.ready_at and run.charged_at_signal is None
        if is_waiting and now >= run.ready_at + (run.signal_after or 0.0):
            _charge(run, now)
            run.charged_at_signal = run.charged
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(run.handle, signal.SIGTERM)
        if run.handle not in events and not run.fault and now - run.looked_at >= LOOK_EVERY_S:
            _look(run, now, limits)
    return [run for run in running.values() if run.handle in events]


def _look(run: _Run, now: float, limits: RunLimits) -> None:
    """Charge a process for its time, and end it when that exceeds a limit."""
    _charge(run, now)
    if run.charged > run.limit:
        run.fault = "time"
    elif (
        run.charged_at_signal is not None and run.charged - run.charged_at_signal > limits.patience
    ):
        run.fault = "deaf"
    if run.fault:
        _kill(run)


def _charge(run: _Run, now: float) -> None:
    cpu, is_awake = _session_time(run.pid)
    if run.looked_at:
        worked = max(cpu - run.cpu, 0.0)
        run.charged += worked if is_awake else max(worked, now - run.looked_at)
    run.cpu, run.looked_at = max(cpu, run.cpu), now


def _session_time(session: int) -> tuple[float, bool]:
    """Processor seconds of the processes of a session, and whether any of them wants a
    processor."""
    ticks, is_awake = 0, False
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            with contextlib.suppress(OSError):
                fields = Path("/proc", entry, "stat").read_text().rpartition(")")[2].split()
                if int(fields[3]) == session:
                    ticks += sum(map(int, fields[11:15]))
                    is_awake |= fields[0] == "R"
    return ticks / os.sysconf("SC_CLK_TCK"), is_awake


def _read(run: _Run) -> None:
    with contextlib.suppress(BlockingIOError):
        while chunk := os.read(run.pipe, 1 << 16):
            run.text += chunk
    *lines, run.text = run.text.split(b"\n")
    for line in lines:
        run.report.update(json.loads(line))
    if "limit" in run.report and not run.ready_at:
        run.ready_at = run.looked_at = time.monotonic()
        run.cpu = _session_time(run.pid)[0] if run.signal_after is not None else 0.0
        run.limit = max(run.limit, run.report["limit"])


def _kill(run: _Run) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(run.pid, signal.SIGKILL)
    with contextlib.suppress(ProcessLookupError):
        signal.pidfd_send_signal(run.handle, signal.SIGKILL)


def _outcome(run: _Run, limits: RunLimits, keep: Path | None) -> Outcome:
    """Collect what a process has left, and remove it."""
    _, status, usage = os.wait4(run.pid, 0)
    _read(run)
    os.close(run.pipe)
    os.close(run.handle)
    code = os.waitstatus_to_exitcode(status)
    codes = tuple(run.report.get("codes", ()))
    details = run.report.get("details", "")
    faults = [run.fault] if run.fault else []
    # a SIGTERM that comes before the command has installed its handler ends the process
    is_early = run.charged_at_signal is not None and code == -signal.SIGTERM
    if not run.fault and "codes" not in run.report and not is_early:
        faults.append("crash")
        details += f"The process ended with code {code} and without a report.\n"
    faults += [run.report["fault"]] if run.report.get("fault") else []
    if "MemoryError" in details or usage.ru_maxrss * 1024 > limits.memory:
        faults.append("memory")
    elif 1 in codes:
        faults.append("exit 1")
    if "File too large" in details:
        faults.append("disk")
    if set(codes) - {*ALLOWED, 1, *([INTERRUPTED] if run.charged_at_signal is not None else [])}:
        faults.append("exit other")
    if _survivors(run.pid, limits.patience):
        faults.append("survivor")
        _kill_session(run.pid)
    if faults and keep is not None:
        _keep(run, keep / f"{run.kind}-{run.number}", faults, details)
    shutil.rmtree(run.folder, ignore_errors=True)
    return Outcome(
        run.kind,
        run.number,
        codes,
        tuple(faults),
        details,
        usage.ru_utime + usage.ru_stime,
        usage.ru_maxrss * 1024,
        run.charged_at_signal is not None,
    )


def _survivors(session: int, patience: float) -> bool:
    """Whether processes of an ended session stay alive; short-lived ones are waited for."""
    deadline = time.monotonic() + 2 * patience
    while True:
        try:
            os.killpg(session, 0)
        except (ProcessLookupError, PermissionError):
            return False
        if time.monotonic() > deadline:
            return True
        time.sleep(0.02)


def _kill_session(session: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(session, signal.SIGKILL)


def _keep(run: _Run, target: Path, faults: list[str], details: str) -> None:
    """Copy the regular files of an input, with its commands and its faults."""
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    for path in (run.folder / "input").rglob("*"):
        copied = target / path.relative_to(run.folder / "input")
        with contextlib.suppress(OSError):
            if path.is_dir():
                copied.mkdir(parents=True, exist_ok=True)
            elif path.is_file() and not path.is_symlink():
                copied.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, copied)
    commands = run.folder / "commands"
    text = commands.read_text() if commands.is_file() else "(not written)"
    (target / "COMMANDS").write_text(f"{text}\n{', '.join(faults)}\n{details}")


_FRAME = re.compile(r'File "[^"]*/((?:pamid|cli)/[^"]+)", line (\d+)')


def place_of(details: str) -> str:
    """File and line of pamid's deepest frame in a traceback, and the error; "" without one."""
    frames = _FRAME.findall(details)
    errors = [line for line in details.splitlines() if re.match(r"[\w.]+(Error|Exception)\b", line)]
    return f"{frames[-1][0]}:{frames[-1][1]} {errors[-1][:80] if errors else ''}" if frames else ""


def count(outcomes: Iterable[Outcome]) -> Counter[str]:
    """Number of inputs by kind, of commands by exit code, of signals, of faults by name and by
    place."""
    counts: Counter[str] = Counter()
    for outcome in outcomes:
        counts[f"input {outcome.kind}"] += 1
        counts[f"ms of {outcome.kind}"] += round(1e3 * outcome.cpu)
        counts["SIGTERM sent"] += outcome.signalled
        counts.update(f"exit {code}" for code in outcome.codes)
        counts.update(f"fault {fault}" for fault in outcome.faults)
        if outcome.faults and (place := place_of(outcome.details)):
            counts[f"at {place}"] += 1
    return counts
