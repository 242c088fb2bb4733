"""Reading in a process of its own: a damaged file can make a foreign parser crash or never end, not
only raise.

What the process found comes back as plain numbers (npz without objects) and JSON; nothing in it is
executed.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from pamid.base.errors import FileError, PamidError
from pamid.base.files import LOG
from pamid.base.npz import load_arrays
from pamid.ingest.channels import Channel, Log, RobotValue

#: s that a reader may take, and more for each MB of the file
PATIENCE = 120.0
PATIENCE_PER_MB = 3.0


def read_in_child(path: Path, kind: str) -> Log:
    """`pamid.ingest.log_kinds.read_here` in another process. FileError as there, and if the process
    dies or hangs."""
    search = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
    command = [sys.executable, "-P", "-c", "from pamid.ingest.child_process import serve; serve()"]
    parts = path.rglob("*") if path.is_dir() else [path]
    size = sum(part.stat().st_size for part in parts if part.is_file())
    patience = PATIENCE + PATIENCE_PER_MB * size / 1e6
    with tempfile.TemporaryDirectory(prefix="pamid-") as folder:
        request = json.dumps({"path": str(path.absolute()), "kind": kind, "folder": folder})
        try:
            done = subprocess.run(
                command,
                input=request.encode(),
                env={**os.environ, "PYTHONPATH": search},
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                timeout=patience,
            )
        except subprocess.TimeoutExpired as error:
            raise _died(path, kind, f"the reader did not end within {patience:.0f} s") from error
        if done.returncode:
            last = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
            raise _died(path, kind, f"the reader crashed ({last or f'signal {-done.returncode}'})")
        return _fetch(path, Path(folder))


def serve() -> None:
    """What the other process does: one request from stdin, its answer into the folder."""
    from pamid.ingest.log_kinds import read_here

    request = json.load(sys.stdin)
    folder = Path(request["folder"])
    answer: dict[str, Any]
    try:
        log = read_here(Path(request["path"]), request["kind"])
    except PamidError as error:
        answer = {"message": error.message, "hint": error.hint, "code": error.code}
    else:
        arrays = {f"values_{index}": channel.values for index, channel in enumerate(log.channels)}
        stamps: dict[int, str] = {}  # channels of one group share theirs
        for index, channel in enumerate(log.channels):
            if channel.stamps is not None and id(channel.stamps) not in stamps:
                stamps[id(channel.stamps)] = f"stamps_{index}"
                arrays[f"stamps_{index}"] = channel.stamps
        np.savez(folder / "channels.npz", **arrays)  # type: ignore[arg-type]
        answer = {
            "channels": [
                (
                    channel.name,
                    channel.unit,
                    stamps.get(id(channel.stamps), ""),
                    None if channel.robot is None else asdict(channel.robot),
                )
                for channel in log.channels
            ],
            "details": log.details,
            "kind": log.kind,
        }
    (folder / "answer.json").write_text(json.dumps(answer), encoding="utf-8")


def _fetch(path: Path, folder: Path) -> Log:
    answer = json.loads((folder / "answer.json").read_text(encoding="utf-8"))
    if "message" in answer:
        raise FileError(
            answer["message"].replace(str(path.absolute()), str(path)),
            answer["hint"],
            code=answer["code"],
        )
    arrays = load_arrays(folder / "channels.npz", most=LOG)
    channels = tuple(
        Channel(
            name,
            arrays[f"values_{index}"],
            arrays[stamps] if stamps else None,
            unit,
            None if robot is None else RobotValue(**robot),
        )
        for index, (name, unit, stamps, robot) in enumerate(answer["channels"])
    )
    return Log(path, answer["kind"], channels, tuple(answer["details"]))


def _died(path: Path, kind: str, what: str) -> FileError:
    return FileError(
        f"{path} cannot be read as {kind}: {what}.",
        "It is most likely damaged: open it with the program that wrote it and export it again.",
        code="damaged",
    )
