"""The child process of a fuzz input: it writes the input, runs its commands and reports."""

import contextlib
import io
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

GIB = 1 << 30
ALLOWED = (0, 2, 3, 4, 5, 6)
INTERRUPTED = 130
#: a command with a limit of its own: it works long on purpose
LONG_COMMANDS = {"diagnose": 1800.0}

Words = tuple[str | Path, ...]


@dataclass(frozen=True)
class Site:
    """An empty folder for an input, the whole files to damage, and the source of chance."""

    seeds: Path
    place: Path
    random: Random

    def copy(self, name: str) -> Path:
        """Copy a whole file or folder into the place."""
        source, target = self.seeds / name, self.place / Path(name).name
        return Path(
            shutil.copytree(source, target) if source.is_dir() else shutil.copy(source, target)
        )

    def one_of(self, *names: str) -> str:
        return self.random.choice(names)


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


def serve(
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
    most = resource.getrlimit(resource.RLIMIT_AS)[1]  # children of pamid set limits of their own
    resource.setrlimit(resource.RLIMIT_AS, (own + limits.allocation, most))
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
        preexec = rest[20]
        pid = os.fork()
        if not pid:
            try:
                _interpret(words, cwd, ends, preexec)
            except BaseException:
                traceback.print_exc()
            finally:
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
