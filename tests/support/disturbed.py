"""A pamid command in a process of its own that halts at an event, to be killed, ended or
interrupted right there.

Nothing here waits for a time: what is disturbed stands still at a known point, however busy the
machine is.
"""

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

PATIENCE_S = 600.0  # for what has to come: only a failure waits as long

# a process begun in the background inherits SIGINT as ignored
_HALTING = """
import os, signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)
when, name, number, event = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
replace, seen = os.replace, 0

def happened(what, target):
    global seen
    if what == when and name in os.path.basename(str(target)):
        seen += 1
        if seen == number:
            os.write(event, b"halted")
            while True:
                time.sleep(0.01)    # one long wait would never hear a signal that comes just before it begins

def replacing(source, target, **more):
    happened("before", target)
    replace(source, target, **more)
    happened("after", target)

os.replace = replacing
from pamid_cli import signals, frame
signals.GRACE_S = 600.0    # a command that halts is not in native code, and the machine may be busy
STAND_IN
frame.main(sys.argv[5:])
"""  # noqa: E501

#: every step of a training is kept
EVERY_STEP = (
    "import pamid.networks.network_training as training; training._CHECKPOINT_SECONDS = 0.0"
)
#: the cases of a trial are not worked through: what is tried is the trial, which has to survive
#: between them
QUICK_CASES = f"""
sys.path.insert(0, {str(Path(__file__).parent)!r})
import disturbed, pamid.api.trial_cases as work
work.examine = disturbed.quick_examine
"""


def quick_examine(case: Any, place: Path) -> dict[str, Any]:
    """What `pamid.api.trial_cases.examine` returns, with nothing in it."""
    return {
        "diagnosis": {
            "verdict": "no-structural-gap",
            "causes": [],
            "ranking": [],
            "comparison": [],
            "where": {"port": "muscle", "indistinguishable": []},
        },
        "seconds": 1.0,
        "shrinkage": None,
        "visibility": 3.0 if case.planted else None,
        "visibility_each": 3.0 if case.planted else None,
    }


class Halted:
    """The process, standing still before or after it gives its `number`-th file of such a name its
    place."""

    def __init__(
        self, command: Sequence[str], when: str, name: str, number: int, *, stand_in: str = ""
    ) -> None:
        ours, theirs = os.pipe()
        script = _HALTING.replace("STAND_IN", stand_in)
        words = [sys.executable, "-c", script, when, name, str(number), str(theirs), *command]
        self.process = subprocess.Popen(
            words,
            start_new_session=True,
            pass_fds=(theirs,),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        os.close(theirs)
        with open(ours, "rb") as line:
            halted = line.read(len(b"halted"))
        if not halted:
            raise AssertionError(f"it ended before that: {self.process.communicate()[1]}")

    def end(self, number: int, *, everyone: bool = False) -> tuple[int, str]:
        """Send a signal, to the process alone or to its children as well; exit code and what it
        said on stderr."""
        if everyone:
            os.killpg(self.process.pid, number)
        else:
            self.process.send_signal(number)
        said = self.process.communicate()[1]
        return self.process.returncode, said

    def require_no_survivors(self) -> None:
        """Wait until no process of the command is left; AssertionError if one stays."""
        deadline = time.monotonic() + PATIENCE_S
        while left := alive(self.process.pid):
            assert time.monotonic() < deadline, left
            time.sleep(0.02)


def alive(session: int) -> list[str]:
    """Command lines of the processes of a session that are at work."""
    found = subprocess.run(
        ["ps", "-o", "stat=,args=", "-s", str(session)], capture_output=True, text=True
    ).stdout
    return [line[:100] for line in found.splitlines() if not line.startswith("Z")]


def leftovers(folder: Path) -> list[str]:
    """Files that were not finished."""
    return [p.name for p in folder.rglob(".*.tmp")]
