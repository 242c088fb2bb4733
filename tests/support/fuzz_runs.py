"""A fuzz input in a process of its own, with limits on time and memory, and at times a SIGTERM.

The process is forked from one that has imported everything, which takes milliseconds. A process is
charged for its processor time and for the time that it sleeps. It is not charged for the time that
it waits for a processor, so that a busy machine changes no outcome.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

from fuzz_site import Site, Words

GIB = 1 << 30
ALLOWED = (0, 2, 3, 4, 5, 6)
INTERRUPTED = 130
SIGNAL_SHARE = 0.3
SIGNAL_AFTER_S = (1e-3, 3.0)  # log-uniform, from the first command on
LOOK_EVERY_S = 0.25
#: a command with a limit of its own: it works long on purpose
LONG_COMMANDS = {"diagnose": 1800.0}


@dataclass(frozen=True)
class RunLimits:
    """Limits of one input. More is a fault.

    seconds      that a process works or sleeps
    memory       bytes of peak resident memory
    patience     seconds that a process works or sleeps after SIGTERM
    allocation   bytes that may be allocated in addition to those of the parent
    file_size    bytes of a file that is written
    """

    seconds: float = 60.0
    memory: int = 2 * GIB
    patience: float = 5.0
    allocation: int = 4 * GIB
    file_size: int = GIB // 4


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
            _serve(
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


def _serve(
    site: Site, generate: Callable[[Site], list[Words]], pipe: int, limits: RunLimits
) -> None:
    """Write the input, report its commands, run them, report their exit codes."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    _limit_process(site.place.parent / "tmp", limits)
    os.chdir(site.place)

    def report(**content: Any) -> None:
        os.write(pipe, json.dumps(content).encode() + b"\n")

    codes: list[int] = []
    details, escaped = "", ""
    try:
        commands = generate(site)
        snapshot = _snapshot(site.place)
        long = max((LONG_COMMANDS.get(str(words[0]), 0.0) for words in commands), default=0.0)
        (site.place.parent / "commands").write_text(repr(commands), errors="backslashreplace")
        report(limit=long)
        for words in commands:
            code, output = run_words(words)
            codes.append(code)
            details += f"exit {code}: {output}\n"
            unfinished = _unfinished(site.place, snapshot, failed=code in (2, 3))
            if unfinished:
                escaped = "unfinished"
                details += f"unfinished: {unfinished}\n"
            if code == INTERRUPTED:
                break
    except KeyboardInterrupt:
        codes.append(INTERRUPTED)
    except BaseException as error:
        escaped = "escaped"
        details += "".join(traceback.format_exception(error))[-3000:]
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    report(codes=codes, details=details[-8000:], fault=escaped)


def _limit_process(temporary: Path, limits: RunLimits) -> None:
    os.environ["TMPDIR"] = str(temporary)
    tempfile.tempdir = None
    own = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (own + limits.allocation,) * 2)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limits.file_size,) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with open(os.devnull) as nothing:
        os.dup2(nothing.fileno(), 0)
    _fork_interpreters()


def run_words(words: Words) -> tuple[int, str]:
    """Exit code and output of a command, run as the script `pamid` runs it.

    Raises
    ------
    AssertionError
        The output is not one JSON object.
    """
    from pamid_cli.frame import main

    out, err = io.StringIO(), io.StringIO()
    code = 0
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
        try:
            main([*map(str, words), "--json", "--debug"])
        except SystemExit as leaving:
            code = int(leaving.code or 0)
    if code in ALLOWED:
        try:
            json.loads(out.getvalue())
        except ValueError as error:
            raise AssertionError(f"{words}: stdout is no JSON: {out.getvalue()[-500:]}") from error
    return code, out.getvalue()[-1000:] + err.getvalue()[-2000:]


Snapshot = dict[str, tuple[int, int]]


def _snapshot(folder: Path) -> Snapshot:
    files = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    return {str(p): (p.stat().st_mtime_ns, p.stat().st_size) for p in files}


def _unfinished(folder: Path, before: Snapshot, *, failed: bool) -> list[str]:
    """Outputs that are not whole: temporary files, JSON that breaks off, tables without a last line
    end, and any `out.*` of a command that failed."""
    return [
        name
        for name, content in _snapshot(folder).items()
        if before.get(name) != content and not _is_whole(Path(name), failed)
    ]


def _is_whole(path: Path, failed: bool) -> bool:
    if path.suffix == ".tmp" or (failed and path.stem == "out"):
        return False
    if path.suffix == ".json":
        try:
            json.loads(path.read_bytes())
        except ValueError:
            return False
    if path.suffix in (".csv", ".toml"):
        return path.read_bytes().endswith(b"\n")
    return path.stat().st_size > 0 or path.parent.name == "jobs"


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


# ---- the child's own children --------------------


def _fork_interpreters() -> None:
    """Fork instead of starting `python -c CODE`: the package is imported already."""
    import subprocess

    start = subprocess._fork_exec  # type: ignore[attr-defined]

    def fork_exec(args: Any, *rest: Any) -> int:
        words = [os.fsdecode(word) for word in args]
        if words[0] != sys.executable or words[1:3] != ["-P", "-c"]:
            return int(start(args, *rest))
        cwd, _, *ends = rest[3:13]
        preexec = rest[19]
        pid = os.fork()
        if not pid:
            with contextlib.suppress(BaseException):
                _interpret(words, cwd, ends, preexec)
            os._exit(1)
        return pid

    subprocess._fork_exec = fork_exec  # type: ignore[attr-defined]
    subprocess._USE_POSIX_SPAWN = False  # type: ignore[attr-defined]


def _interpret(words: list[str], cwd: Any, ends: list[int], preexec: Any) -> None:
    """Run `python -P -c CODE` in a forked process, with the pipes of `subprocess.Popen`."""
    stdin, their_stdin, their_stdout, stdout, their_stderr, stderr, theirs, errors = ends
    for handle in (their_stdin, their_stdout, their_stderr, theirs):
        if handle > 2:
            os.close(handle)
    for number, handle in enumerate((stdin, stdout, stderr)):
        if handle >= 0:
            os.dup2(handle, number)
    os.close(errors)
    if cwd is not None:
        os.chdir(cwd)
    if preexec is not None:
        preexec()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.stdin = os.fdopen(0, "r", closefd=False)
    sys.stdout, sys.stderr = (os.fdopen(k, "w", closefd=False) for k in (1, 2))
    sys.argv = ["-c", *words[4:]]
    code = 0
    try:
        exec(compile(words[3], "<string>", "exec"), {"__name__": "__main__"})
    except SystemExit as leaving:
        code = leaving.code if isinstance(leaving.code, int) else 1
    except BaseException:
        traceback.print_exc()
        code = 1
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(code)


def count(outcomes: Iterable[Outcome]) -> Counter[str]:
    """Number of inputs by kind, of commands by exit code, of signals, and of faults by name."""
    counts: Counter[str] = Counter()
    for outcome in outcomes:
        counts[f"input {outcome.kind}"] += 1
        counts[f"ms of {outcome.kind}"] += round(1e3 * outcome.cpu)
        counts["SIGTERM sent"] += outcome.signalled
        counts.update(f"exit {code}" for code in outcome.codes)
        counts.update(f"fault {fault}" for fault in outcome.faults)
    return counts
