"""Public benchmarks and how a model is scored on them: shared by pamid's row and the peers', each a
process of its own, so it needs NumPy alone.

A model gets the whole input of a test record and the first `start` samples of its output; the root
mean square of its error counts from sample `start` on. That is how the package
`nonlinear_benchmarks` and Champneys, Beintema, Toth, Schoukens, Rogers (2024), Baseline results for
selected nonlinear system identification benchmarks, IFAC-PapersOnLine 58(15) (arXiv 2405.10779)
score, with their numbers of samples.
"""

import json
import resource
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Test:
    """A record to judge by: its file, and how many of its rows (None: all)."""

    name: str
    file: str
    rows: int | None = None


@dataclass(frozen=True)
class PublicSet:
    """A benchmark. fit: the one file that parameters may be fitted to; start: samples of a test
    record whose output may be seen; scale, unit: of the errors shown; published: by test, of
    others."""

    name: str
    fit: str
    tests: tuple[Test, ...]
    columns: tuple[str, str]  # input, output
    start: int
    scale: float
    unit: str
    published: tuple[str, ...]


SETS = {
    s.name: s
    for s in (
        PublicSet(
            "cascaded_tanks",
            "estimation.csv",
            (Test("validation", "validation.csv"),),
            ("pump_v", "level_v"),
            5,
            1.0,
            "V",
            ("0.191 grey box; 0.396 GRU",),
        ),
        PublicSet(
            "emps",
            "estimation.csv",
            (Test("pulses", "pulses.csv"),),
            ("force_n", "position_m"),
            20,
            1000.0,
            "mm",
            ("0.452 dynoNet; 5.17 pNARX",),
        ),
        PublicSet(
            "silverbox",
            "multisine.csv",
            (
                Test("multisine (tail)", "tail.csv"),
                Test("arrow", "arrow.csv"),
                Test("arrow, no extrapolation", "arrow.csv", 32000),
            ),
            ("drive_v", "response_v"),
            50,
            1000.0,
            "mV",
            ("0.301 GP-NARX; 0.36 SUBNET", "0.60 GP-NARX; 1.4 SUBNET", "-"),
        ),
    )
}


@dataclass(frozen=True)
class Record:
    """Samples of one file: u, y (samples,), period in seconds."""

    u: Array
    y: Array
    period_s: float


def read_record(path: Path, columns: tuple[str, str], rows: int | None = None) -> Record:
    """Two columns of a recording by name; ValueError where one is missing or no number."""
    with path.open(encoding="utf-8") as lines:
        header = lines.readline().strip().split(",")
    for name in ("time_s", *columns):
        if name not in header:
            raise ValueError(f"{path} has no column {name!r}; it has {', '.join(header)}")
    table = np.loadtxt(path, delimiter=",", skiprows=1, max_rows=rows)
    if not np.isfinite(table).all():
        raise ValueError(f"{path} holds something that is no number")
    t, u, y = (table[:, header.index(name)] for name in ("time_s", *columns))
    return Record(u, y, float((t[-1] - t[0]) / (len(t) - 1)))


def read_set(folder: Path, one: PublicSet) -> tuple[Record, list[Record]]:
    """The record to fit and those to judge by."""
    return (
        read_record(folder / one.fit, one.columns),
        [read_record(folder / t.file, one.columns, t.rows) for t in one.tests],
    )


def rmse(measured: Array, model: Array, start: int, scale: float = 1.0) -> float:
    """Root mean square error behind the first `start` samples, times scale; infinite where the
    model is not finite. ValueError where the lengths differ or nothing is left to score."""
    if measured.shape != model.shape:
        raise ValueError(f"the model has {model.shape} values, the record {measured.shape}")
    if not 0 <= start < len(measured):
        raise ValueError(f"{len(measured)} samples, of which the first {start} do not count")
    if not np.isfinite(model[start:]).all():
        return float("inf")
    return float(scale * np.sqrt(np.mean((model[start:] - measured[start:]) ** 2)))


#: (input, first outputs, of the whole record) -> outputs of the whole record
Simulate = Callable[[Array, Array], Array]


def tell(version: str, errors: list[float], remark: str = "") -> None:
    """What a peer's process found, as the last line that it prints."""
    spent = resource.getrusage(resource.RUSAGE_SELF)
    found = {
        "version": version,
        "errors": [e if np.isfinite(e) else None for e in errors],
        "cpu_s": spent.ru_utime + spent.ru_stime,
        "remark": remark,
    }
    print(json.dumps(found))


def judge(one: PublicSet, tests: list[Record], simulate: Simulate) -> list[float]:
    """Errors of a model that sees no more of a test's output than it may."""
    return [rmse(t.y, simulate(t.u, t.y[: one.start].copy()), one.start, one.scale) for t in tests]


def asked() -> tuple[PublicSet, Path, bool]:
    """What the command line of a peer's script names: set, folder, quick or not."""
    return SETS[sys.argv[1]], Path(sys.argv[2]), "quick" in sys.argv[3:]


class Scaled:
    """Input and output of mean 0 and standard deviation 1 over the record that is fitted."""

    def __init__(self, fit: Record) -> None:
        self.of_u = (fit.u.mean(), fit.u.std())
        self.of_y = (fit.y.mean(), fit.y.std())

    def u(self, u: Array) -> Array:
        return (u - self.of_u[0]) / self.of_u[1]

    def y(self, y: Array) -> Array:
        return (y - self.of_y[0]) / self.of_y[1]

    def back(self, y: Array) -> Array:
        return y * self.of_y[1] + self.of_y[0]
