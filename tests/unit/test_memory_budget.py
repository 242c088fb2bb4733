"""What a raw log declares is charged to a budget before anything is allocated for it."""

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pamid import guess_mapping
from pamid.base.errors import FileError, UsageError
from pamid.base.files import GIB, LOG_MEMORY
from pamid.intake.logs.log_reader import read_here, read_log
from pamid.intake.logs.memory_budget import LIMIT_VARIABLE, limited_memory, memory_limit


def declared(path: Path, shapes: list[Any], dtype: Any = "f8", *, written: bool = True) -> Path:
    """HDF5 data sets of which one chunk was written, or nothing."""
    import h5py

    with h5py.File(path, "w") as file:
        for number, shape in enumerate(shapes):
            part = tuple(min(n, 100) for n in shape)
            made = file.create_dataset(
                f"x{number}", shape, dtype, chunks=part, compression="gzip" if written else None
            )
            if written:
                made[(0,) * len(shape)] = np.zeros((), dtype)
        file["t"] = np.arange(100.0)
    return path


def refusal(path: Path, kind: str) -> FileError:
    with pytest.raises(FileError) as caught:
        read_here(path, kind)
    return caught.value


def test_the_sum_of_arrays_counts_not_each_alone(tmp_path):
    path = declared(tmp_path / "many.h5", [(20_000_000,)] * 8)  # each would fit
    error = refusal(path, "hdf5")
    assert error.code == "too-large" and str(path) in error.message
    assert "1 GiB" in error.message and "--memory-limit" in error.hint
    assert refusal(path, "hdf5").hint.count("memory_limit") == 1


def test_an_array_beyond_the_limit_is_left_out_with_the_rest_read(tmp_path):
    log = read_here(declared(tmp_path / "one.h5", [(10**12,)]), "hdf5")
    assert [channel.name for channel in log.channels] == ["t"]
    assert any("memory limit" in detail and "x0" in detail for detail in log.details)


def parquet_of_repeats(path: Path) -> None:
    import pyarrow
    import pyarrow.parquet

    column = pyarrow.array(np.zeros(20_000, dtype=np.float32))
    names = [f"x{k}" for k in range(8)]
    pyarrow.parquet.write_table(pyarrow.table([column] * 8, names), path, compression="zstd")


def tdms(path: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(path) as writer:
        writer.write_segment([ChannelObject("g", f"c{k}", np.zeros(20_000)) for k in range(8)])


def mdf(path: Path) -> None:
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        clock = np.arange(20_000.0)
        file.append([Signal(clock, clock, name=f"x{k}") for k in range(8)])
        file.save(path, overwrite=True)


def level_5(path: Path, body: bytes, kind: int = 15) -> None:
    head = b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + struct.pack("<H", 0x0100) + b"IM"
    path.write_bytes(head + struct.pack("<2I", kind, len(body)) + body)


def part(kind: int, data: bytes) -> bytes:
    return struct.pack("<2I", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix(name: str, values: bytes, kind: int = 9) -> bytes:
    """A double array of a MAT file of version 5, its values as `kind`."""
    count = len(values) // (8 if kind == 9 else 1)
    parts = [
        part(6, struct.pack("<2I", 6, 0)),
        part(5, struct.pack("<2i", count, 1)),
        part(1, name.encode()),
        part(kind, values),
    ]
    return part(14, b"".join(parts))


def bomb(path: Path) -> None:
    """120 MB of zeros, which are doubles stored as bytes: 1 GB in memory, 120 kB in the file."""
    level_5(path, zlib.compress(matrix("x", bytes(120_000_000), kind=2), 9))


@pytest.mark.parametrize(
    ("suffix", "kind", "write", "gib"),
    [
        ("parquet", "parquet", parquet_of_repeats, 0.001),
        ("tdms", "tdms", tdms, 0.001),
        ("mf4", "mdf", mdf, 0.002),
    ],
)
def test_other_formats_are_refused_by_the_sum_of_their_channels(tmp_path, suffix, kind, write, gib):
    write(path := tmp_path / f"log.{suffix}")
    assert len(read_here(path, kind).channels) == 8
    with limited_memory(gib):
        assert refusal(path, kind).code == "too-large"


def test_a_compressed_variable_is_measured_before_it_is_unpacked(tmp_path):
    bomb(path := tmp_path / "bomb.mat")
    assert path.stat().st_size < 1_000_000
    assert refusal(path, "mat").code == "too-large"


def test_the_limit_holds_in_the_reading_process_too(tmp_path):
    path = declared(tmp_path / "log.h5", [(40_000,)] * 8)
    assert len(read_log(path).channels) == 9
    with limited_memory(0.002), pytest.raises(FileError, match="too large"):
        read_log(path)
    with pytest.raises(FileError, match="too large"):
        guess_mapping(path, None, memory_limit=0.002)


def test_the_limit_is_stated_once_and_can_be_raised(monkeypatch):
    monkeypatch.delenv(LIMIT_VARIABLE, raising=False)
    assert memory_limit() == LOG_MEMORY
    with limited_memory(3.5):
        assert memory_limit() == 3.5 * GIB
        with limited_memory(None):
            assert memory_limit() == 3.5 * GIB
    assert memory_limit() == LOG_MEMORY
    for wrong in ("many", "-1", "nan", "inf"):
        monkeypatch.setenv(LIMIT_VARIABLE, wrong)
        with pytest.raises(UsageError):
            memory_limit()
    with pytest.raises(UsageError), limited_memory(0.0):
        pass
