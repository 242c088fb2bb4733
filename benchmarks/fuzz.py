"""Damaged and hostile inputs through the command line: exit codes, faults, inputs per second.

    python benchmarks/fuzz.py [--inputs 100000] [--first 0] [--jobs 2] [--kinds values declared ...]
                              [--keep FOLDER] [--drawn]
    python benchmarks/fuzz.py --kinds values --first 1234 --inputs 1    # repeats that input

Kind and number determine an input and the moment of its SIGTERM (tests/support/fuzz_inputs.py).
There are recordings, TOML files, raw logs, run folders, checkpoints, models, networks, trials,
force maps, excitations, command lines, archives that declare more than they hold, and MJCF, URDF
and FMU files.

Each input runs in a process of its own (tests/support/fuzz_runs.py). A fault is: exit code 1, an
exception that escapes, a crash, 60 s of work or sleep (diagnoses excepted), 2 GiB of memory, a file
of 256 MiB, deafness to SIGTERM for 5 s, a half-written output, or a process left behind. Of 10
inputs, 3 get a SIGTERM. Faults are printed with kind and number, and the files are kept.

Without --drawn, one report in 100 has figures. A figure takes a hundred times as long as its data.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import importlib
import io
import os
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))
sys.path.insert(0, str(ROOT / "tests" / "integration"))

REPORT_EVERY = 1000  # inputs
DRAWN_SHARE = 0.01
_EMPTY_FIGURE = '<svg viewBox="0 0 1 1"></svg>'
PACKAGES = (
    *("h5py", "nptdms", "asammdf", "rosbags.highlevel", "pyarrow.parquet", "matio", "scipy.io"),
    *("mujoco", "fmpy", "onnx", "matplotlib.figure", "matplotlib.backends.backend_svg"),
    *(
        "pamid.rigs.simulators.kinds.mujoco",
        "pamid.rigs.simulators.kinds.fmi",
        "pamid.intake.logs.log_reader",
    ),
)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--kinds", nargs="+")
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "pamid-fuzz")
    parser.add_argument("--drawn", action="store_true")
    options = parser.parse_args()
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"
    shared = Path("/dev/shm") if os.access("/dev/shm", os.W_OK) else None
    scratch = Path(tempfile.mkdtemp(prefix="pamid-fuzz-", dir=shared))
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        sys.exit(_run(options, scratch))
    finally:
        os.chdir("/")
        shutil.rmtree(scratch, ignore_errors=True)


def _run(options: argparse.Namespace, scratch: Path) -> int:
    from fuzz_inputs import KINDS
    from fuzz_runs import FAULTS, count, run_inputs
    from fuzz_seeds import make_seeds

    began = time.monotonic()
    warnings.simplefilter("ignore")
    os.fsync = lambda _: None  # type: ignore[assignment]
    seeds = make_seeds(scratch / "seeds")
    _warm_up(seeds, scratch / "warm")
    _draw_few(options.drawn)
    print(f"ready after {time.monotonic() - began:.0f} s", flush=True)
    began, cpu = time.monotonic(), _cpu_seconds()
    counts: Counter[str] = Counter()
    outcomes = run_inputs(
        _inputs(options), KINDS, seeds, scratch / "inputs", jobs=options.jobs, keep=options.keep
    )
    done = 0
    try:
        for outcome in outcomes:
            done += 1
            counts += count([outcome])
            if outcome.faults or options.inputs == 1:
                faults = ", ".join(FAULTS[fault] for fault in outcome.faults) or "no fault"
                print(
                    f"{outcome.kind} {outcome.number}: {faults}; {outcome.cpu:.1f} s CPU, "
                    f"{outcome.memory / 2**20:.0f} MiB\n{outcome.details}",
                    flush=True,
                )
            if done % REPORT_EVERY == 0:
                rate = done / (time.monotonic() - began)
                print(f"{done} inputs, {rate:.1f}/s, {_faults(counts)}", flush=True)
    finally:  # also of a run that was interrupted
        _print_summary(counts, done, time.monotonic() - began, _cpu_seconds() - cpu)
    return 1 if _faults(counts) else 0


def _inputs(options: argparse.Namespace) -> Iterator[tuple[str, int]]:
    from fuzz_inputs import KINDS, WEIGHTS

    kinds = options.kinds or list(KINDS)
    weights = [WEIGHTS[kind] if len(kinds) > 1 else 1 for kind in kinds]
    for number in range(options.first, options.first + options.inputs):
        yield Random(f"which-{number}").choices(kinds, weights)[0], number


def _faults(counts: Counter[str]) -> dict[str, int]:
    return {
        name.removeprefix("fault "): n for name, n in counts.items() if name.startswith("fault ")
    }


def _cpu_seconds() -> float:
    """Processor seconds of this process and of its ended children."""
    return sum(os.times()[:4])


def _print_summary(counts: Counter[str], inputs: int, seconds: float, cpu: float) -> None:
    from fuzz_runs import FAULTS

    print(f"\n{inputs} inputs in {seconds:.0f} s, {inputs / seconds:.1f}/s; {cpu:.0f} s CPU")
    print(f"{'kind':<14} {'inputs':>7} {'CPU, s':>8} {'per CPU s':>9}")
    for name in sorted(name for name in counts if name.startswith("input ")):
        kind = name.removeprefix("input ")
        its = counts[f"ms of {kind}"] / 1e3
        print(f"{kind:<14} {counts[name]:>7} {its:>8.1f} {counts[name] / max(its, 1e-3):>9.1f}")
    for name in sorted(name for name in counts if name.startswith("exit ")):
        print(f"{name:<30} {counts[name]}")
    print(f"{'SIGTERM sent':<30} {counts['SIGTERM sent']}")
    for fault, line in FAULTS.items():
        print(f"{line:<30} {counts[f'fault {fault}']}")
    for place in sorted(name for name in counts if name.startswith("at ")):
        print(f"{counts[place]:>5} {place}")


def _warm_up(seeds: Path, place: Path) -> None:
    """Import and compile, once and not in every fork."""
    from pamid_cli.frame import run
    from small_cart import RIG

    for package in PACKAGES:
        with contextlib.suppress(ImportError):
            importlib.import_module(package)
    shutil.copytree(seeds, place)
    os.chdir(place)
    network = ("--iterations", "1", "--hidden", "2", "--jobs", "1")
    for words in (
        ("check", "rec.csv", "--rig", "one-dof"),
        ("check", "cart.csv", "--rig", RIG),
        ("fit", "fit.csv", "--output", "run"),
        ("fit", "cart.csv", "--rig", RIG, "--output", "run-cart"),
        ("simulate", "--excitation", "cart.csv", "--rig", RIG, "--output", "simulated.csv"),
        ("simulate", "--excitation", "sent.csv", "--rig", "one-dof", "--output", "out.csv"),
        ("simulate", "--model", "fitted", "--excitation", "sent.csv", "--output", "other.csv"),
        *(
            ("export", "fitted", "--to", to, "--output", f"as-{to}")
            for to in ("c", "matlab", "onnx")
        ),
        *(("report", folder) for folder in ("explained", "unknown-effect", "trial")),
        ("train-residual", "explained", *network),
        ("animate", "explained", "--size", "160"),
        ("force-law", "map.csv", "--sets", "2", "--held-out", "2", "--output", "law"),
        ("ingest", "--guess", "log.csv"),
        ("generate-aprbs", "--output", "sent-again.csv"),
        ("config",),
        ("new-rig", "cart.csv", "--output", "out.py"),
    ):
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            code = run([*words, "--json"])
        assert code != 1, words
    os.chdir(place.parent)
    gc.collect()
    gc.freeze()  # pages that no collection writes to stay shared with the forks


def _draw_few(drawn: bool) -> None:
    """Leave the figures out of most pages, by the name of the folder and so by the input."""
    import pamid.report.style as style
    import pamid.report.writing as writing

    render = style.render

    def blank(drawing: Any) -> Any:
        if drawn or Random(os.path.basename(os.path.dirname(os.getcwd()))).random() < DRAWN_SHARE:
            return render(drawing)
        empty = (_EMPTY_FIGURE,) * 3
        return style.Picture(drawing.name, drawing.title, *empty, b"\x89PNG")

    writing.render = blank  # type: ignore[attr-defined]


if __name__ == "__main__":
    main()
