"""Faults by injection, counted: every write of every command on a full disk, and kills at random
moments.

    python benchmarks/faults.py                     both, a few minutes python benchmarks/faults.py
    disk                every write of every command fails, once and from then on python
    benchmarks/faults.py kill --rounds 20    SIGKILL and SIGTERM at random moments, then --resume:
    same bytes? python benchmarks/faults.py disk --only report

Exit code 1 if anything is wrong. Commands are forked from one process that has everything loaded,
so that the moments lie in the work and not in the loading; the cases of the trial are not worked
through (`disturbed.quick_examine`).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "support"))

from disturbed import leftovers, quick_examine  # noqa: E402
from faulty import COMMANDS, complaints, prepared, walk  # noqa: E402
from pamid_cli import frame  # noqa: E402
from small_cart import RIG, others, record_cart  # noqa: E402

import pamid.api.trial_cases as work  # noqa: E402
import pamid.networks.network_training as training  # noqa: E402


def disks(only: str, most: int) -> int:
    """Walk through the writes of every command; how many complaints there are."""
    bad = 0
    with tempfile.TemporaryDirectory() as name:
        start = Path(name) / "start"
        start.mkdir()
        prepared(start, with_joint=True)
        print(
            f"{'command':20s}{'writes failed':>14s}{'exit 3':>8s}{'done':>6s}{'other':>7s}{'wrong':>7s}{'s':>7s}"  # noqa: E501
        )
        for number, (named, (words, together)) in enumerate(COMMANDS.items()):
            command = named.strip()
            if only not in command:
                continue
            place = Path(name) / str(number)
            shutil.copytree(start, place)
            os.chdir(place)
            begun = time.monotonic()
            before, whole, failed = walk([*command.split(), *words], place, every=most)
            # a case whose own folder cannot be made has failed
            codes = (3, 6) if command == "trial" else (3,)
            told = [
                text
                for one in failed
                for text in complaints(before, whole, one, together=together, codes=codes)
            ]
            tally = [
                sum(one.code == 3 for one in failed),
                sum(one.code == whole.code for one in failed),
            ]
            print(
                f"{command:20s}{len(failed):14d}{tally[0]:8d}{tally[1]:6d}{len(failed) - sum(tally):7d}"  # noqa: E501
                f"{len(told):7d}{time.monotonic() - begun:7.1f}",
                flush=True,
            )
            for text in told[:5]:
                print("   ", text[:300].replace("\n", " "))
            bad += len(told)
            os.chdir(name)
            shutil.rmtree(place)
    return bad


# ---- kills --------------------


def forked(words: list[str]) -> int:
    """The process that runs a command."""
    child = os.fork()
    if child:
        return child
    with open(os.devnull, "w") as nowhere:
        sys.stdout = sys.stderr = nowhere
        try:
            frame.main(words)
        except SystemExit as error:
            os._exit(int(error.code or 0))
        except BaseException:
            os._exit(99)
    os._exit(98)


def ended(child: int) -> int:
    code = os.waitpid(child, 0)[1]
    return os.waitstatus_to_exitcode(code)


def after_random(words: list[str], number: int, longest_s: float, draw: random.Random) -> int:
    """Run a command and send it a signal at a random moment; its exit code."""
    child = forked(words)
    time.sleep(draw.uniform(0.0, longest_s))
    with contextlib.suppress(ProcessLookupError):
        os.kill(child, number)
    return ended(child)


def kills(only: str, rounds: int, seed: int) -> int:
    """Kill each command at random moments and resume it; how often something was wrong."""
    training._CHECKPOINT_SECONDS = 0.0
    work.examine = quick_examine
    draw, bad = random.Random(seed), 0
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        recording = str(record_cart(place))
        assert (
            ended(forked(["fit", recording, "--rig", RIG, "--output", str(place / "fitted")])) == 0
        )

        def fresh(folder: Path) -> None:
            pass

        def fitted(folder: Path) -> None:
            shutil.copytree(place / "fitted", folder)

        diagnosed = [
            "diagnose",
            recording,
            "--rig",
            RIG,
            *others(),
            "--seed",
            "0",
            "--jobs",
            "2",
            "--output",
        ]
        table: dict[str, tuple[list[str], Callable[[Path], None], int]] = {
            "diagnose": (diagnosed, fresh, 1),
            "resume": (diagnosed, fresh, 3),
            "fit": (
                ["fit", recording, "--rig", RIG, "--bootstrap", "20", "--jobs", "2", "--output"],
                fresh,
                1,
            ),
            "trial": (["trial", "--cases", "40", "--jobs", "1", "--output"], fresh, 1),
            "train-residual": (
                ["train-residual", "--hidden", "3", "--iterations", "40", "--jobs", "1"],
                fitted,
                1,
            ),
        }
        print(
            f"{'command':16s}{'signal':>8s}{'rounds':>8s}{'disturbed':>11s}{'same bytes':>12s}{'wrong':>7s}{'s':>7s}"  # noqa: E501
        )
        for command, (words, prepare, times) in table.items():
            if only not in command:
                continue
            whole = place / f"{command}-whole"
            prepare(whole)
            code = ended(forked([*words, str(whole)]))  # compiles whatever is not compiled yet
            shutil.rmtree(whole)
            prepare(whole)
            begun = time.monotonic()
            assert ended(forked([*words, str(whole)])) == code
            longest = time.monotonic() - begun
            for number in (signal.SIGKILL, signal.SIGTERM):
                bad += _rounds(
                    command, words, prepare, whole, code, longest, number, rounds, times, draw
                )
    return bad


def _rounds(
    command: str,
    words: list[str],
    prepare: Callable[[Path], None],
    whole: Path,
    code: int,
    longest: float,
    number: int,
    rounds: int,
    times: int,
    draw: random.Random,
) -> int:
    begun, disturbed, same, wrong = time.monotonic(), 0, 0, []
    expected = _bytes(whole)
    for turn in range(rounds):
        folder = whole.parent / f"{command}-{number}-{turn}"
        prepare(folder)
        for attempt in range(times):
            found = after_random(
                [*words, str(folder), *(["--resume"] if attempt else [])], number, longest, draw
            )
            if found not in (code, -number, 130):
                wrong.append(f"exit code {found}")
            disturbed += found in (-number, 130)
            if number == signal.SIGTERM and found == 130 and leftovers(folder):
                wrong.append(f"left behind: {leftovers(folder)}")
            for file in folder.rglob("*.json"):
                json.loads(file.read_bytes())
        last = ended(forked([*words, str(folder), "--resume"]))
        got = _bytes(folder)
        if (last, got) != (code, expected):
            differ = sorted(
                k for k in got.keys() | expected.keys() if got.get(k) != expected.get(k)
            )
            wrong.append(f"round {turn}: exit code {last}, differ: {differ}")
        same += (last, got) == (code, expected)
        shutil.rmtree(folder)
    print(
        f"{command:16s}{signal.Signals(number).name:>8s}{rounds:8d}{disturbed:11d}{same:12d}{len(wrong):7d}"
        f"{time.monotonic() - begun:7.1f}",
        flush=True,
    )
    for text in wrong[:5]:
        print("   ", text)
    return len(wrong)


def _bytes(folder: Path) -> dict[str, bytes]:
    """All files but run.json, which has times."""
    return {
        p.relative_to(folder).as_posix(): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and p.name != "run.json"
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", nargs="?", choices=["disk", "kill"])
    parser.add_argument("--only", default="", help="of the commands those whose name holds this")
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--every", type=int, default=1, help="only each so-manieth write")
    asked = parser.parse_args()
    bad = 0
    if asked.part != "kill":
        bad += disks(asked.only, asked.every)
    if asked.part != "disk":
        bad += kills(asked.only, asked.rounds, asked.seed)
    print(f"{bad} wrong")
    sys.exit(bad > 0)


if __name__ == "__main__":
    main()
