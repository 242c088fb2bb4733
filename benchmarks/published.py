"""Public benchmarks in free run: pamid beside SysIdentPy, deepSI and jax-sysid of the same run, and
beside what others have published.

    python benchmarks/published.py [--data FOLDER] [--environment FOLDER] [--install] [--quick]
    [--sets cascaded_tanks,emps,silverbox]
    [--rows pamid,pamid-loop,pamid-network,sysidentpy,deepsi,jax-sysid]

Fitted to one record of each set, judged on others: the whole input of a test record and the first
5 (tanks), 20 (EMPS) or 50 samples (silverbox) of its output are known, the root mean square of the
free run's error counts from there on (benchmarks/peers/public_sets.py). EMPS is force in, position
out, open loop; only the row pamid-loop is reference in, behind the recordings' controller.
pamid-network is pamid's grey box of the silverbox with a network for what it leaves. Every row is a
process of its own, one after the other, held to one thread. Peers live in an environment of their
own, which --install makes with the versions of the extra `peers` and constraints-peers.txt; a peer
or data that are not there are a row with the reason.
"""

import argparse
import json
import os
import subprocess
import sys
import tomllib
from datetime import date
from pathlib import Path
from typing import Any

from peers.environment import CACHE, python_with
from peers.public_sets import SETS, PublicSet

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
DATA = ROOT.parent / "shared" / "data"
CONSTRAINTS = ROOT / "constraints-peers.txt"
#: row -> script, package of a peer ("" for pamid's own)
ROWS = {
    "pamid": ("public_ours.py", ""),
    "pamid-loop": ("public_loop.py", ""),
    "pamid-network": ("public_network.py", ""),
    "sysidentpy": ("public_sysidentpy.py", "sysidentpy"),
    "deepsi": ("public_deepsi.py", "deepSI"),
    "jax-sysid": ("public_jax_sysid.py", "jax-sysid"),
}
#: rows that belong to one set
ONLY = {"pamid-loop": "emps", "pamid-network": "silverbox"}
ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "JAX_PLATFORMS": "cpu",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}
LONGEST_S = 1800.0


def peer_packages(text: str) -> list[str]:
    """The extra `peers` of a pyproject.toml."""
    return list(tomllib.loads(text)["project"]["optional-dependencies"]["peers"])


def vectors(cpuinfo: str) -> str:
    """The widest vectors that the processor says it has, from the text of /proc/cpuinfo."""
    flags = next((x.split(":")[1].split() for x in cpuinfo.splitlines() if "flags" in x), [])
    for flag, name in (("avx512f", "AVX-512"), ("avx2", "AVX2"), ("avx", "AVX")):
        if flag in flags:
            return name
    return "unknown"


def processor() -> str:
    path = Path("/proc/cpuinfo")
    return f"widest vectors {vectors(path.read_text() if path.exists() else '')}"


def rows_of(one: PublicSet, names: list[str]) -> list[str]:
    """Those of these rows that a set has."""
    return [name for name in names if ONLY.get(name, one.name) == one.name]


def row_of(name: str, one: PublicSet, data: Path, python: Path | None, quick: bool) -> dict:
    """What a row's process found, or {"skipped": why}."""
    script, package = ROWS[name]
    folder = data / one.name
    if missing := [f for f in (one.fit, *(t.file for t in one.tests)) if not (folder / f).exists()]:
        return {"skipped": f"{folder / missing[0]} is not there"}
    if python is None or not python.exists():
        return {"skipped": f"{package} is not installed: --install"}
    command = [str(python), str(HERE / "peers" / script), one.name, str(folder)]
    command += ["quick"] if quick else []
    try:
        done = subprocess.run(
            command,
            env={**os.environ, **ONE_THREAD, "PYTHONPATH": str(HERE)},
            capture_output=True,
            text=True,
            timeout=LONGEST_S,
        )
    except subprocess.TimeoutExpired:
        return {"skipped": f"took more than {LONGEST_S:g} s"}
    return told(done.returncode, done.stdout, done.stderr)


def told(code: int, out: str, err: str) -> dict[str, Any]:
    """The last line of a row's output, or why there is none."""
    if code or not out.strip():
        last = err.strip().splitlines()[-1:] or ["nothing was printed"]
        return {"skipped": f"failed: {last[0][:160]}"}
    found: dict[str, Any] = json.loads(out.strip().splitlines()[-1])
    return found


def lines(name: str, one: PublicSet, found: dict[str, Any]) -> list[str]:
    """Rows of the table, one per test record."""
    if "skipped" in found:
        return [f"| {one.name} | | {name} | skipped | | {found['skipped']} |"]
    return [
        f"| {one.name} | {test.name} | {found['version']} | "
        f"{'unstable' if error is None else f'{error:.3g}'} {one.unit} | {found['cpu_s']:.0f} s | "
        f"{found['remark']} |"
        for test, error in zip(one.tests, found["errors"], strict=True)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--environment", type=Path, default=CACHE / "published")
    parser.add_argument("--install", action="store_true", help="make the peers' environment")
    parser.add_argument("--quick", action="store_true", help="a tenth of the training")
    parser.add_argument("--sets", default=",".join(SETS))
    parser.add_argument("--rows", default=",".join(ROWS))
    options = parser.parse_args()
    for given, known in ((options.sets, SETS), (options.rows, ROWS)):
        for word in given.split(","):
            if word not in known:
                parser.error(f"nothing is named {word!r}; there are {', '.join(known)}")
    theirs: Path = options.environment / "bin" / "python"
    if options.install:
        wanted = peer_packages((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
        theirs = python_with(options.environment, ["-c", str(CONSTRAINTS), *wanted])
    quick = ", --quick" if options.quick else ""
    print(f"{date.today()}, {processor()}, one thread each{quick}\n")
    print("| set | test | model | RMSE, free run | CPU | remark |")
    print("|---|---|---|---:|---:|---|", flush=True)
    for word in options.sets.split(","):
        one = SETS[word]
        for name in rows_of(one, options.rows.split(",")):
            python = theirs if ROWS[name][1] else Path(sys.executable)
            found = row_of(name, one, options.data, python, options.quick)
            print("\n".join(lines(name, one, found)), flush=True)
        for test, others in zip(one.tests, one.published, strict=True):
            print(f"| {one.name} | {test.name} | published | {others} {one.unit} | | |", flush=True)


if __name__ == "__main__":
    main()
