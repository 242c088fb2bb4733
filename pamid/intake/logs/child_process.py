"""Reading a log in a separate process (`pamid.base.parallel.limited_process`): on a damaged file a
foreign parser may crash or never end, and not only raise.

Channels are returned as plain numbers (npz without objects) and JSON, which execute nothing.
"""

from __future__ import annotations

import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from pamid.base.errors import FileError
from pamid.base.files import LOG, MIB
from pamid.base.npz import load_arrays
from pamid.base.parallel.limited_process import ProcessFailure, ProcessLimits, run_limited
from pamid.intake.logs.channels import Channel, Log, RobotValue

#: processor time of a reader, s, and the addition for each MB of the file
READER_S = 50.0
READER_S_PER_MB = 3.0
#: elapsed time, s, in addition to READER_S_PER_MB
PATIENCE = 120.0
#: bytes that a reader may allocate, and more for each byte of the file
READER_MEMORY = 3072 * MIB
READER_MEMORY_PER_BYTE = 6


def read_in_child(path: Path, kind: str) -> Log:
    """`pamid.intake.logs.log_kinds.read_here` in another process.

    Raises FileError as there, and if the process crashes or exceeds its limits.
    """
    parts = path.rglob("*") if path.is_dir() else [path]
    size = sum(part.stat().st_size for part in parts if part.is_file())
    longer = READER_S_PER_MB * size / 1e6
    limits = ProcessLimits(
        READER_S + longer, PATIENCE + longer, READER_MEMORY + READER_MEMORY_PER_BYTE * size
    )
    whole = str(path.absolute())
    with tempfile.TemporaryDirectory(prefix="pamid-") as name:
        folder = Path(name)
        try:
            arguments = {"path": whole, "kind": kind}
            function, label = f"{__name__}:packed_log", f"reading {path.name}"
            answer = run_limited(function, arguments, folder, limits, label)
        except ProcessFailure as failure:
            raise FileError(
                f"{path} cannot be read as {kind}: the reader failed: {failure}.",
                "The file is probably damaged. Export it again from the program that wrote it, or "
                "export fewer channels.",
                code="damaged",
            ) from failure
        except FileError as error:
            raise FileError(
                error.message.replace(whole, str(path)), error.hint, code=error.code
            ) from error
        arrays = load_arrays(folder / "channels.npz", most=LOG)
        channels = []
        for index, (name, unit, stamps, robot) in enumerate(answer["channels"]):
            values, times = arrays[f"values_{index}"], arrays[stamps] if stamps else None
            channels.append(Channel(name, values, times, unit, robot and RobotValue(**robot)))
        return Log(path, answer["kind"], tuple(channels), tuple(answer["details"]))


def packed_log(path: str, kind: str, folder: Path) -> dict[str, Any]:
    """Read a log, write its numbers into the folder, and return the other fields for JSON."""
    from pamid.intake.logs.log_kinds import read_here

    log = read_here(Path(path), kind)
    arrays = {f"values_{index}": channel.values for index, channel in enumerate(log.channels)}
    stamps: dict[int, str] = {}  # channels of a group share them
    for index, channel in enumerate(log.channels):
        if channel.stamps is not None and id(channel.stamps) not in stamps:
            stamps[id(channel.stamps)] = f"stamps_{index}"
            arrays[f"stamps_{index}"] = channel.stamps
    np.savez(folder / "channels.npz", **arrays)  # type: ignore[arg-type]
    return {
        "channels": [
            (c.name, c.unit, stamps.get(id(c.stamps), ""), c.robot and asdict(c.robot))
            for c in log.channels
        ],
        "details": log.details,
        "kind": log.kind,
    }
