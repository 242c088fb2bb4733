"""Damaged files and words through the command line: how many are refused, how many taken, and does
anything escape?

    python benchmarks/fuzz.py [--inputs 100000] [--first 0] [--kinds recording mapping ...] [--keep
    FOLDER] [--drawn] python benchmarks/fuzz.py --kinds mapping --first 1234 --inputs 1     # makes
    that input again, and says its answer

An input is made from its kind and its number alone (tests/support/fuzz_inputs.py,
tests/support/fuzzing.py): recordings, the TOML beside them, pamid.toml, raw logs of every kind,
mappings, run folders, checkpoints, models, networks, results of jobs, trials, force maps,
excitations, words of a command line. A process works through them, limited in memory; another one
watches it. What counts as a fault: exit code 1, an exception, a process that dies, more than HANG_S
of CPU for one input. Each is printed with its number and its files are kept.

Figures take a hundred times as long as what they show: without --drawn only one page in 100 has
them.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import json
import os
import resource
import select
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))

HANG_S = 60.0  # of CPU
MEMORY = 6 * 2**30  # bytes of address space
ALLOWED = (0, 2, 3, 4, 5, 6)
TOLD_EVERY = 1000  # inputs
DRAWN_EVERY = 100  # inputs
_NUMBER = [0]  # of the input at work
_NOTHING = '<svg viewBox="0 0 1 1"></svg>'


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", nargs="+")
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "pamid-fuzz")
    parser.add_argument("--drawn", action="store_true")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.worker:
        _work(asked)
    else:
        sys.exit(_watch(asked))


# ---- the one who watches --------------------


def _watch(asked: argparse.Namespace) -> int:
    """Run the worker until all inputs are done; begin it again behind an input that it did not
    survive."""
    asked.keep.mkdir(parents=True, exist_ok=True)
    counts: Counter[str] = Counter()
    began, first, end = time.monotonic(), asked.first, asked.first + asked.inputs
    cpu = 0.0
    while first < end:
        at, seconds, why = _one_worker(asked, first, end, counts)
        cpu += seconds
        if at >= end:
            break
        counts["hangs" if why == "hang" else "died"] += 1
        print(
            f"input {at}: {'still at work after' if why == 'hang' else 'the process died'} ({why})",
            flush=True,
        )
        first = at + 1
    done = sum(n for word, n in counts.items() if word.startswith("exit "))
    escaped = counts["exit 1"] + counts["escaped"] + counts["died"]
    print(
        f"\n{asked.inputs} inputs, {done} commands, {cpu:.0f} s CPU, "
        f"{time.monotonic() - began:.0f} s on the clock"
    )
    for word in sorted(counts):
        print(f"  {word:<28} {counts[word]}")
    print(f"escaped exceptions {escaped}, hangs {counts['hangs']}")
    return 1 if escaped or counts["hangs"] else 0


def _one_worker(
    asked: argparse.Namespace, first: int, end: int, counts: Counter[str]
) -> tuple[int, float, str]:
    """(input it stands at, CPU seconds, why it ended) of one worker."""
    words = [
        sys.executable,
        __file__,
        "--worker",
        "--first",
        str(first),
        "--inputs",
        str(end - first),
        "--keep",
        str(asked.keep),
        *(["--drawn"] if asked.drawn else []),
        *(["--kinds", *asked.kinds] if asked.kinds else []),
    ]
    process = subprocess.Popen(
        words,
        stdout=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )
    assert process.stdout is not None
    pipe = process.stdout.fileno()
    at, since, seconds, rest = first, 0.0, 0.0, b""
    while True:
        ready = bool(select.select([pipe], [], [], 1.0)[0])
        text = os.read(pipe, 1 << 16) if ready else b""
        *lines, rest = (rest + text).split(b"\n")
        for line in lines:
            said = json.loads(line)
            at = said.get("next", at)
            since = said.get("cpu", since)
            counts.update(said.get("counts", {}))
            if "next" in said and at > first and at % TOLD_EVERY == 0:
                print(f"{at}: {dict(sorted(counts.items()))}", flush=True)
            if "told" in said:
                print(said["told"], flush=True)
        if ready and not text:
            return at, seconds, f"exit code {process.wait()}"
        seconds = _cpu_seconds(process.pid) or seconds
        if since and seconds - since > HANG_S:
            process.kill()
            process.wait()
            return at, seconds, "hang"


def _cpu_seconds(process: int) -> float:
    """CPU seconds of a process and its ended children."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


# ---- the one who works --------------------


def _work(asked: argparse.Namespace) -> None:
    from fuzz_inputs import KINDS, WEIGHTS
    from fuzz_seeds import make_seeds

    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)

    def tell(**said: Any) -> None:
        print(json.dumps(said), file=out, flush=True)

    warnings.simplefilter("ignore")
    os.fsync = lambda _: None  # type: ignore[assignment]
    shared = Path("/dev/shm") if os.access("/dev/shm", os.W_OK) else None
    place = Path(tempfile.mkdtemp(prefix="pamid-fuzz-", dir=shared))
    os.environ["TMPDIR"] = str(place)
    tempfile.tempdir = None
    kinds = asked.kinds or list(KINDS)
    weights = [WEIGHTS[kind] if len(kinds) > 1 else 1 for kind in kinds]
    try:
        seeds = make_seeds(place / "seeds")
        _in_process(asked.drawn)
        for package in (
            "h5py",
            "nptdms",
            "asammdf",
            "rosbags.highlevel",
            "pyarrow.parquet",
            "matio",
        ):
            importlib.import_module(package)  # once, and not in every fork
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        for number in range(asked.first, asked.first + asked.inputs):
            kind = Random(f"which-{number}").choices(kinds, weights)[0]
            tell(
                next=number, cpu=sum(os.times()[:4])
            )  # with ended children, as the one who watches counts
            before = time.process_time()
            counts, told = _one(
                seeds, place / str(number), kind, number, asked.keep, asked.inputs == 1
            )
            counts[f"ms of {kind}"] += round(1e3 * (time.process_time() - before))
            tell(counts=counts, **({"told": told} if told else {}))
        tell(next=asked.first + asked.inputs)
    finally:
        os.chdir("/")
        shutil.rmtree(place, ignore_errors=True)


def _in_process(drawn: bool) -> None:
    """What would start a process for every input forks instead; without `drawn` pictures are not
    rendered."""
    import pamid.parallel.limited_process as apart
    import pamid.report.style as style
    import pamid.report.writing as writing

    def forked(request: bytes, folder: Path, patience: float, label: str) -> int:
        reading, writing_end = os.pipe()
        child = os.fork()
        if not child:
            os.close(writing_end)
            os.dup2(reading, 0)
            sys.stdin = os.fdopen(0)
            code = 1
            with contextlib.suppress(BaseException):
                os.chdir(folder)
                apart.serve()
                code = 0
            os._exit(code)
        os.close(reading)
        with open(writing_end, "wb") as line:
            line.write(request)
        (folder / "stderr.txt").touch()
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

    apart._finished = forked
    whole = style.render

    def blank(drawing: Any) -> Any:
        if drawn or _NUMBER[0] % DRAWN_EVERY == 0:
            return whole(drawing)
        return style.Picture(drawing.name, drawing.title, _NOTHING, _NOTHING, _NOTHING, b"")

    writing.render = blank  # type: ignore[attr-defined]


def _one(
    seeds: Path, place: Path, kind: str, number: int, keep: Path, loud: bool
) -> tuple[Counter[str], str]:
    """Make one input, run its commands; counts of what came of it, and what is to be told."""
    from fuzz_inputs import KINDS, Site

    _NUMBER[0] = number
    place.mkdir()
    os.chdir(place)
    counts: Counter[str] = Counter({f"input {kind}": 1})
    told = ""
    commands: list[tuple[str | Path, ...]] = []
    try:
        commands = KINDS[kind](Site(seeds, place, Random(f"{kind}-{number}")))
        for words in commands:
            code, said = run_words(words)
            counts[f"exit {code}"] += 1
            if code not in ALLOWED:
                told += f"{words}: {said}\n"
            if loud:
                print(code, said, file=sys.stderr)
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        counts["escaped"] += 1
        told += "".join(traceback.format_exception(error))[-3000:]
    if told:
        kept = keep / f"{kind}-{number}"
        shutil.rmtree(kept, ignore_errors=True)
        shutil.copytree(place, kept, ignore_dangling_symlinks=True)
        (kept / "COMMANDS").write_text(f"{commands!r}\n{told}")
        told = f"input {number} ({kind}): {told}"
    os.chdir("/")
    shutil.rmtree(place, ignore_errors=True)
    return counts, told


def run_words(words: tuple[str | Path, ...]) -> tuple[int, str]:
    """Exit code of a command, and what it said where that is a fault."""
    from pamid_cli.frame import run

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run([*map(str, words), "--json", "--debug"])
    if code not in (1,):
        json.loads(out.getvalue())
        return code, out.getvalue()[-2000:]
    return code, out.getvalue()[-600:] + err.getvalue()[-1500:]


if __name__ == "__main__":
    main()
