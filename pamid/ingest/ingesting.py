"""`pamid.ingest`: conversion of raw logs to recordings, and a first mapping of a log."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping as Mapped
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

from pamid.base.card import Cells, card, html_table, paragraph, text_table
from pamid.base.errors import FileError, UsageError, quoted
from pamid.base.files import PathLike, require_new, write_atomically
from pamid.base.printable_text import printable
from pamid.base.progress import ShowProgress, progress_steps
from pamid.base.schemas.ingest_file import IngestFile, RecordingMade
from pamid.base.trust import is_code
from pamid.ingest.conversion import Conversion, convert
from pamid.ingest.conversion_record import (
    conversion_records,
    outputs_for,
    tables_of,
    write_conversions,
)
from pamid.ingest.guessed_mapping import Answers, GuessedMapping, guess_of
from pamid.ingest.log_reader import read_log
from pamid.ingest.mapping import Repair, load_mapping, named_by_units
from pamid.ingest.memory_budget import limited_memory
from pamid.ingest.parts import log_per_part
from pamid.model.registry import RigLike, catalogue_rig, name_of, resolved_rig, rig_named
from pamid.model.rig import Rig
from pamid.recording.recording import Recording, read_recording, recording_of

CURES = get_args(Repair)


@dataclass(frozen=True)
class IngestResult:
    """Recordings from logs, with a record of all conversions.

    rig       rig that the recordings name, "" for none
    notes     remarks for the user
    accounts  conversion record of each recording, as in its .ingest.json: source, clocks, repairs
              and columns
    """

    recordings: tuple[Recording, ...]
    rig: str
    notes: tuple[str, ...]
    accounts: tuple[IngestFile, ...]
    _conversions: tuple[Conversion, ...]

    def to_dict(self) -> dict[str, Any]:
        """JSON object of the command."""
        return IngestFile(recordings=self.accounts).as_json()

    def summary(self) -> str:
        """Lines of text about the recordings, the logs and the repairs of their clocks."""
        lines = [
            f"{about.path}: {about.samples} samples, {about.sampling_period_s:g} s apart, "
            f"{about.duration_s:.4g} s: {', '.join(about.columns)}."
            for about in self._made()
        ]
        lines += [line for conversion in self._conversions for line in _lines(conversion)]
        return "\n".join(lines)

    def _made(self) -> list[RecordingMade]:
        return [account.recording for account in self.accounts if account.recording]

    def __repr__(self) -> str:
        return f"<IngestResult {self._headline()}>\n{text_table(self._rows())}"

    def _repr_html_(self) -> str:
        notes = [paragraph(note) for note in self.notes]
        return card(self._headline(), html_table(self._rows()), *notes)

    def _headline(self) -> str:
        logs, count = len(self._conversions), len(self.recordings)
        return (
            f"{count} recording{'' if count == 1 else 's'} of {logs} log"
            f"{'' if logs == 1 else 's'}, {len(self.notes)} notes"
        )

    def _rows(self) -> Cells:
        rows = [
            (r.path, str(r.samples), f"{r.sampling_period_s:g}", ", ".join(r.columns))
            for r in self._made()
        ]
        return ("recording", "samples", "period in s", "columns"), rows


def ingest(
    logs: PathLike | Sequence[PathLike],
    mapping: PathLike,
    *,
    rig: RigLike | None = None,
    pressures: str | None = None,
    period: float | None = None,
    repair: str | None = None,
    known: Mapped[str, float] | None = None,
    kind: str | None = None,
    memory_limit: float | None = None,
    output: PathLike | None = None,
    overwrite: bool = False,
    progress: ShowProgress = None,
) -> IngestResult:
    """Convert raw logs to recordings: columns, units, signs, gauge pressures, an even time base.

    Parameters
    ----------
    logs
        Path of a log, or of several with the same mapping.
    mapping
        TOML file that assigns channels to columns; `guess_mapping` writes a first version.
    rig
        Name, path of a rig file (it is run), or a Rig. Default: as the mapping names it.
    pressures
        "gauge" or "absolute", for all pressures that the mapping leaves open.
    period
        Sampling period of the recordings, s, instead of the mapping's time.period_s.
    repair
        Cure of uneven stamps, instead of the mapping's time.repair: "ask", "late-stamps",
        "jittered-sampling" or "none".
    known
        Known parameters of the rig for these recordings, in addition to the mapping's.
    kind
        Format of the logs, where name and content do not show it.
    memory_limit
        Memory for reading a log, GiB. Default: 1. A larger log is refused before it is read.
    output
        CSV file (several recordings are numbered) or folder. A TOML file and a conversion record
        are written next to each recording, all of them or none. Default: nothing is written.
    progress
        As in `pamid.fit`.

    Raises
    ------
    FileError
        A log or the mapping is wrong, or an output exists (without overwrite).
    DataError
        The data do not determine the repair of the time base, or too few samples remain.
    UsageError
        The call is wrong.
    """
    several = [logs] if isinstance(logs, str | os.PathLike) else logs
    paths = [Path(item) for item in several]
    if not paths:
        raise UsageError("There is no log to read.", "Give a log.")
    if repair is not None and repair not in CURES:
        raise UsageError(f"repair={repair!r} is not among {', '.join(CURES)}.")
    file, target = Path(mapping), None if output is None else Path(output)
    parsed = load_mapping(file, pressures, _period(period))
    given = resolved_rig(rig)
    named = name_of(given) if given is not None else parsed.rig
    target_rig = _rig(parsed.rig, file) if given is None else rig_named(given)
    values = {**parsed.known, **(known or {})}
    parsed = parsed.model_copy(update={"rig": named, "known": values})
    parsed = named_by_units(parsed, target_rig)
    sources = [signal.source for signal in parsed.signals.values()]
    sources += [parsed.time.source] if parsed.time.source is not None else []
    conversions, steps = [], progress_steps(progress, "reading logs", len(paths))
    with limited_memory(memory_limit), steps as (_, count):
        for number, path in enumerate(paths):
            count(number, path.name)
            conversions += [
                convert(part, parsed, target_rig, str(file), repair or "")
                for part in log_per_part(read_log(path, kind), sources, str(file))
            ]
    recordings, accounts = _written(conversions, target, file, overwrite)
    notes = dict.fromkeys(note for conversion in conversions for note in conversion.notes)
    return IngestResult(
        tuple(recordings), named or "", tuple(notes), tuple(accounts), tuple(conversions)
    )


def guess_mapping(
    log: PathLike,
    rig: RigLike | None = None,
    *,
    pressures: str | None = None,
    period: float | None = None,
    known: Mapped[str, float] | None = None,
    angles: str | None = None,
    only: str = "",
    kind: str | None = None,
    memory_limit: float | None = None,
    output: PathLike | None = None,
    overwrite: bool = False,
) -> GuessedMapping:
    """Propose a mapping from a log to a rig's columns, as TOML with comments to check.

    Parameters
    ----------
    rig
        As in `pamid.fit`. None: every channel keeps its name.
    pressures
        "gauge" or "absolute", for all pressures; never guessed.
    period
        Sampling period of a log without a clock, s; never guessed.
    known
        Known parameters of the rig for these recordings.
    angles
        "deg" or "rad", for angles without a unit.
    only
        For a log with several robots: text in the names of the channels to use.
    kind
        Format of the log, where its name and content do not show it.
    memory_limit
        Memory for reading, GiB. Default: 1.
    output
        TOML file to write. Default: none.

    Raises
    ------
    FileError
        The log cannot be read, has no joint of the rig or may hold several robots, or the output
        exists (without overwrite).
    """
    if angles not in (None, "deg", "rad"):
        raise UsageError(f"angles={angles!r} is neither deg nor rad.")
    answers = Answers(pressures or "", angles or "", _period(period), dict(known or {}))
    target = None if output is None else Path(output)
    require_new([target] if target else [], overwrite)
    given = resolved_rig(rig)
    target_rig, name = (None, "") if given is None else (rig_named(given), name_of(given))
    with limited_memory(memory_limit):
        guess = guess_of(read_log(Path(log), kind), target_rig, name, answers, only)
    guess = replace(guess, text=printable(guess.text))
    if target is not None:
        write_atomically(target, guess.text.encode())
    return guess


def _period(seconds: float | None) -> float | None:
    """A sampling period of the user; UsageError unless it is positive and finite."""
    if seconds is not None and not 0.0 < seconds < math.inf:
        raise UsageError(f"period={seconds!r}: a sampling period (s) must be above 0.")
    return seconds


def _rig(name: str | None, mapping: Path) -> Rig | None:
    """Rig that a mapping names, from the catalogue only."""
    if name is None:
        return None
    if is_code(name):
        raise FileError(
            f"{mapping} names the rig file {name!r}.",
            f"A rig file is code, which pamid runs only if you name it: add --rig {quoted(name)}.",
        )
    return catalogue_rig(name)


def _written(
    conversions: list[Conversion], output: Path | None, mapping: Path, overwrite: bool
) -> tuple[list[Recording], list[IngestFile]]:
    """Recordings with their conversion records, written if there is an output.

    Without an output they equal those that files would give.
    """
    if output is None:
        outputs = [outputs_for([c], Path(), as_folder=True)[0] for c in conversions]
        recordings = [
            recording_of(recording.time, recording.columns, tables_of(conversion), name=path.stem)
            for conversion, files in zip(conversions, outputs, strict=True)
            for recording, path in zip(conversion.recordings, files, strict=True)
        ]
        return recordings, conversion_records(conversions, outputs, mapping)
    as_folder = output.is_dir() or not output.suffix  # a Path does not keep a trailing slash
    if as_folder and output.is_file() or not as_folder and output.suffix != ".csv":
        raise FileError(
            f"{output} is neither a .csv file nor a folder.",
            "A recording's name ends in .csv.",
            code="write",
        )
    outputs = outputs_for(conversions, output, as_folder)
    accounts = write_conversions(conversions, outputs, mapping, overwrite)
    return [read_recording(path) for files in outputs for path in files], accounts


def _lines(conversion: Conversion) -> list[str]:
    """Summary of an ingested log: channels, repaired clocks and filled cells."""
    log, period = conversion.log, conversion.period
    part = f", part {log.part}" if log.part else ""
    details = f": {'; '.join(log.details)}" if log.details else ""
    lines = [f"{log.path.name}{part} ({log.kind}){details}."]
    for clock in conversion.clocks:
        if clock.diagnosis is not None:
            cure = "kept" if clock.cure == "none" else f"repaired as {clock.cure}"
            lines.append(f"  {clock.name}: {cure}; {clock.diagnosis.why}.")
        lines += [f"    {repair.detail}" for repair in (*clock.rows.repairs, *clock.base.repairs)]
    ppm = 1e6 * (conversion.stretch - 1.0)
    lines += [f"    its clock and {period:g} s differ by {ppm:.0f} ppm"] if abs(ppm) > 1.0 else []
    for column, track in conversion.tracks.items():
        if filled := track.filled:
            way = "with the value before them"
            way = way if track.course.signal.hold else "between their neighbours"
            cells = track.course.values.size
            lines.append(f"  {column}: {filled} empty cells of {cells} were filled {way}")
    return lines
