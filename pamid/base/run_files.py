"""Reading the result files of a run: its tables, its diagnosis and the record of its commands."""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import partial
from pathlib import Path

import numpy as np

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.base.files import TABLE, read_data
from pamid.base.result_file import REMEDY, damaged, read_result
from pamid.base.schemas.diagnosis_file import CAUSED, DiagnosisFile
from pamid.base.schemas.run_file import RunFile, Step

PERIODS_AGREE = 0.01  # share by which the periods of recordings may differ for a network
RESIDUAL_KEYS = ("time_s", "recording", "part", "window")  # columns of residual.csv, not signals
SQUARED = 1e150  # what is larger cannot be squared
_BLANK_CELL = re.compile(r"(?<=,)(?=[,\n])")


def read_columns(path: Path) -> dict[str, Array] | None:
    """Columns of a numeric CSV by name, each (n,); None if there is no such file. A blank cell
    becomes nan."""
    if not path.exists():
        return None
    fault = partial(FileError, hint=REMEDY, code="damaged")
    try:
        text = read_data(path, TABLE).decode("utf-8").replace("\r\n", "\n")
    except (OSError, UnicodeDecodeError) as error:
        raise fault(f"{path} cannot be read as text: {error}.") from None
    header, _, body = text.partition("\n")
    names = header.split(",")
    if not body.strip():
        raise fault(f"{path} has no rows.")
    if len(set(names)) != len(names) or not all(names):
        raise fault(f"{path}: the names of the columns must differ.")
    try:
        table = np.loadtxt(
            _BLANK_CELL.sub("nan", body).splitlines(), delimiter=",", ndmin=2, comments=None
        )
    except ValueError as error:
        raise fault(f"{path}, below the header: {error}.") from None
    if table.shape[1] != len(names):
        raise fault(f"{path} has {len(names)} names for {table.shape[1]} columns.")
    if (np.abs(table) > SQUARED).any():
        raise fault(f"{path} has a number beyond {SQUARED:g}, too large to draw.")
    return dict(zip(names, table.T.copy(), strict=True))


def read_diagnosis(path: Path) -> DiagnosisFile | None:
    """The diagnosis in a file; None if there is no such file, FileError if it is damaged."""
    diagnosis = read_result(path, DiagnosisFile)
    if diagnosis is not None and diagnosis.verdict in CAUSED and not diagnosis.causes:
        needed = f"a list of effects, not an empty list, as the verdict is {diagnosis.verdict!r}"
        raise damaged(path, "causes", needed, "empty")
    return diagnosis


def read_steps(path: Path) -> tuple[Step, ...]:
    """The commands that run.json notes."""
    record = read_result(path, RunFile, any_schema=True)
    assert record is not None
    return (record, *record.steps)


def repeats_refit(part: Array, cause: Array, refitted: Array) -> bool:
    """Whether the trace of the model with the causes is that of the refitted model over the fitted
    part, as an earlier version wrote it."""
    return np.array_equal(cause[part == 0], refitted[part == 0], equal_nan=True)


def equal_periods(periods: Iterable[float]) -> bool:
    """Are recordings with these sampling periods (s) alike enough for a network?"""
    every = sorted(periods)
    return every[-1] <= (1.0 + PERIODS_AGREE) * every[0]
