"""Record of the conversion of a log, and its files: recordings, their TOML and <stem>.ingest.json,
all of them or none."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.arrays import Array
from pamid.base.errors import FileError
from pamid.base.files import (
    make_folder,
    refuse_write,
    replace_together,
    require_new,
    sha256_of,
    sweep_stages,
    temporary_of,
)
from pamid.base.json_file import write_json
from pamid.base.metrics import runs_of
from pamid.base.schemas import ingest_file as result
from pamid.intake.logs.clocks import Clock
from pamid.intake.logs.conversion import ColumnPieces, Conversion
from pamid.recording.recording import write_recording

STAGE = "ingest-unfinished"  # temporary folder, so that all files replace their targets together
# samples in a row at the highest or lowest value of a channel: it may be clipped there
AT_LIMIT = 3

_READ_IN_FOLDERS = (".parquet", ".json", ".yaml", ".mcap", ".db3")  # of a log that is a folder


def outputs_for(
    conversions: Sequence[Conversion], output: Path, as_folder: bool
) -> list[list[Path]]:
    """CSV files to write for each log.

    That is `output` for a single recording, and numbered files for several. In a folder the files
    have the names of the logs. Raises FileError if two would be the same file.
    """
    counts = [len(conversion.recordings) for conversion in conversions]
    if as_folder:
        logs = [conversion.log for conversion in conversions]
        stems = [output / "-".join(filter(None, (log.path.stem, log.part))) for log in logs]
        paths = [_numbered(stem, count) for stem, count in zip(stems, counts, strict=True)]
    else:
        every = _numbered(output.with_suffix(""), sum(counts))
        paths = [every[sum(counts[:i]) : sum(counts[: i + 1])] for i in range(len(counts))]
    named = [path for part in paths for path in part]
    for path in named:
        if named.count(path) > 1:
            raise FileError(
                f"Two logs have the same name, so both would be written to {path}.",
                "Give a single --output file, or ingest the logs into two folders.",
                code="exists",
            )
    return paths


def write_conversions(
    conversions: Sequence[Conversion],
    outputs: Sequence[Sequence[Path]],
    mapping_file: Path,
    overwrite: bool,
) -> list[result.IngestFile]:
    """Write every recording with its TOML and conversion record, or nothing; return the records.

    Raises FileError if a file exists (without `overwrite`), or would replace a log or the mapping.
    """
    endings, paths = (".csv", ".toml", ".ingest.json"), [path for part in outputs for path in part]
    targets = [path.with_suffix(suffix) for path in paths for suffix in endings]
    sources = {path.resolve() for path in (mapping_file, *(c.log.path for c in conversions))}
    for target in targets:
        if target.resolve() in sources:
            raise FileError(
                f"{target} is an input of this command and would be overwritten.",
                "Choose another --output.",
                code="exists",
            )
    require_new(targets, overwrite)
    accounts = conversion_records(conversions, outputs, mapping_file)
    folder = targets[0].parent
    make_folder(folder)
    try:
        sweep_stages(folder, STAGE)
        stage = temporary_of(folder / STAGE)
        stage.mkdir(mode=0o700)
    except OSError as error:
        refuse_write(folder, error)
    try:
        recordings = [(c, recording) for c in conversions for recording in c.recordings]
        for (conversion, r), path, account in zip(recordings, paths, accounts, strict=True):
            file = stage / path.name
            write_recording(file, r.time, r.columns, tables_of(conversion))
            write_json(file.with_suffix(".ingest.json"), account.as_json())
        replace_together({target: stage / target.name for target in targets})
    except OSError as error:
        refuse_write(folder, error)
    finally:
        shutil.rmtree(stage, ignore_errors=True)
    return accounts


def conversion_records(
    conversions: Sequence[Conversion], outputs: Sequence[Sequence[Path]], mapping_file: Path
) -> list[result.IngestFile]:
    """Conversion record of each recording, by file."""
    return [
        shared.model_copy(
            update={
                "recording": result.RecordingMade(
                    path=str(path),
                    samples=recording.time.size,
                    sampling_period_s=conversion.period,
                    duration_s=recording.time.size * conversion.period,
                    columns=tuple(recording.columns),
                    begins_s=recording.begins_s,
                    first_row=recording.first_row,
                )
            }
        )
        for conversion, part in zip(conversions, outputs, strict=True)
        for shared in [_of_log(conversion, mapping_file)]
        for recording, path in zip(conversion.recordings, part, strict=True)
    ]


def _numbered(stem: Path, count: int) -> list[Path]:
    if count == 1:
        return [stem.with_name(stem.name + ".csv")]
    return [stem.with_name(f"{stem.name}-{number}.csv") for number in range(1, count + 1)]


def tables_of(conversion: Conversion) -> dict[str, Any]:
    mapping = conversion.mapping
    about = {"rig": mapping.rig, "loop": mapping.loop, "sampling_period_s": conversion.period}
    tables = {
        "recording": {key: value for key, value in about.items() if value is not None},
        "known": mapping.known,
        "controller": mapping.controller,
        "between": mapping.between,
    }
    return {title: table for title, table in tables.items() if table}


def _digest(path: Path) -> str:
    """SHA-256 of a log; of a folder that of the names and checksums of the files that are read."""
    if not path.is_dir():
        return sha256_of(path)
    files = sorted(part for part in path.rglob("*") if part.suffix in _READ_IN_FOLDERS)
    lines = [f"{sha256_of(part)}  {part.relative_to(path).as_posix()}\n" for part in files]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _of_log(conversion: Conversion, mapping_file: Path) -> result.IngestFile:
    log, lead = conversion.log, conversion.lead
    return result.IngestFile(
        source=result.LogRead(
            path=str(log.path), sha256=_digest(log.path), kind=log.kind, details=log.details
        ),
        mapping=result.MappingUsed(
            path=str(mapping_file),
            sha256=sha256_of(mapping_file),
            **conversion.mapping.model_dump(exclude_none=True),
        ),
        clock_ppm=1e6 * (conversion.stretch - 1.0),
        clocks=tuple(_of_clock(clock, clock is lead) for clock in conversion.clocks),
        signals={
            column: _of_track(track, conversion) for column, track in conversion.tracks.items()
        },
        notes=conversion.notes,
    )


def _of_clock(clock: Clock, leads: bool) -> result.ClockUsed:
    about: dict[str, Any] = {"state": "events", "why": "each value holds until the next"}
    if clock.diagnosis is not None:
        about = {
            "state": clock.diagnosis.state,
            "why": clock.diagnosis.why,
            "numbers": clock.diagnosis.numbers,
            "signals": clock.diagnosis.witnesses,
        }
    return result.ClockUsed(
        name=clock.name,
        rows=clock.rows.stamps.size,
        cure=clock.cure,
        **about,
        repairs=(*clock.rows.repairs, *clock.base.repairs),
        leads=leads,
    )


def _of_track(track: ColumnPieces, conversion: Conversion) -> result.ColumnMade:
    signal, values = track.course.signal, track.course.values
    empty = ~np.isfinite(values)
    about: dict[str, Any] = {}
    if signal.unit is not None:
        about["unit"] = signal.unit.text
    if signal.absolute:
        about["atmosphere_taken_off_kpa"] = conversion.mapping.atmosphere.pressure_kpa
    return result.ColumnMade(
        source=signal.stated.source,
        clock=track.clock.name,
        interpolation="hold" if signal.hold else "smooth",
        empty_cells=empty.sum(),
        longest_empty_run=_lengths(empty).max(initial=0),
        at_limit=at_limit(values[~empty]),
        filtered=track.coarser(conversion.period * conversion.stretch),
        **about,
    )


def at_limit(values: Array) -> int:
    """Number of samples in runs of three and more at the highest or lowest value; 0 for a constant
    signal."""
    if values.size < AT_LIMIT or np.ptp(values) == 0.0:
        return 0
    return sum(
        int(length)
        for edge in (values.min(), values.max())
        for length in _lengths(values == edge)
        if length >= AT_LIMIT
    )


def _lengths(mask: NDArray[np.bool_]) -> NDArray[np.intp]:
    starts, stops = runs_of(mask)
    return stops - starts
