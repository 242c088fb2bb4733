"""`pamid.ingest`: conversion of raw logs to recordings, and a first mapping of a log."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

from pamid.api.options.logs import IngestArguments, MappingArguments
from pamid.api.options.record import verb
from pamid.base.card import Cells, card, html_table, paragraph, text_table
from pamid.base.errors import FileError, UsageError, quoted
from pamid.base.files import require_new, write_atomically
from pamid.base.printable_text import printable
from pamid.base.progress import progress_steps
from pamid.base.schemas.ingest_file import IngestFile, RecordingMade
from pamid.base.trust import is_code
from pamid.intake.logs.conversion import Conversion, convert
from pamid.intake.logs.conversion_record import (
    conversion_records,
    outputs_for,
    tables_of,
    write_conversions,
)
from pamid.intake.logs.guessed_mapping import Answers, GuessedMapping, guess_of
from pamid.intake.logs.log_reader import read_log
from pamid.intake.logs.mapping import Repair, load_mapping, named_by_units
from pamid.intake.logs.memory_budget import limited_memory
from pamid.intake.logs.parts import log_per_part
from pamid.model.registry import catalogue_rig, name_of, resolved_rig, rig_named
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


@verb(IngestArguments)
def ingest(arguments: IngestArguments) -> IngestResult:
    """Convert raw logs to recordings: columns, units, signs, gauge pressures, an even time base.

    Raises
    ------
    FileError
        A log or the mapping is wrong, or an output exists (without overwrite).
    DataError
        The data do not determine the repair of the time base, or too few samples remain.
    UsageError
        The call is wrong.
    """
    a = arguments
    several = [a.logs] if isinstance(a.logs, str | os.PathLike) else a.logs
    paths = [Path(item) for item in several]
    if not paths:
        raise UsageError("There is no log to read.", "Give a log.")
    if a.mapping is None:
        raise UsageError("mapping is missing.", "`pamid.guess_mapping` writes a first one.")
    if a.repair is not None and a.repair not in CURES:
        raise UsageError(f"repair={a.repair!r} is not among {', '.join(CURES)}.")
    file, target = Path(a.mapping), None if a.output is None else Path(a.output)
    parsed = load_mapping(file, a.pressures, _period(a.period))
    given = resolved_rig(a.rig)
    named = name_of(given) if given is not None else parsed.rig
    target_rig = _rig(parsed.rig, file) if given is None else rig_named(given)
    values = {**parsed.known, **(a.known or {})}
    parsed = parsed.model_copy(update={"rig": named, "known": values})
    parsed = named_by_units(parsed, target_rig)
    sources = [signal.source for signal in parsed.signals.values()]
    sources += [parsed.time.source] if parsed.time.source is not None else []
    conversions, steps = [], progress_steps(a.progress, "reading logs", len(paths))
    with limited_memory(a.memory_limit), steps as (_, count):
        for number, path in enumerate(paths):
            count(number, path.name)
            conversions += [
                convert(part, parsed, target_rig, str(file), a.repair or "")
                for part in log_per_part(read_log(path, a.kind), sources, str(file))
            ]
    recordings, accounts = _written(conversions, target, file, a.overwrite)
    notes = dict.fromkeys(note for conversion in conversions for note in conversion.notes)
    return IngestResult(
        tuple(recordings), named or "", tuple(notes), tuple(accounts), tuple(conversions)
    )


@verb(MappingArguments)
def guess_mapping(arguments: MappingArguments) -> GuessedMapping:
    """Propose a mapping from a log to a rig's columns, as TOML with comments to check.

    Raises
    ------
    FileError
        The log cannot be read, has no joint of the rig or may hold several robots, or the output
        exists (without overwrite).
    """
    a = arguments
    if a.angles not in (None, "deg", "rad"):
        raise UsageError(f"angles={a.angles!r} is neither deg nor rad.")
    answers = Answers(a.pressures or "", a.angles or "", _period(a.period), dict(a.known or {}))
    target = None if a.output is None else Path(a.output)
    require_new([target] if target else [], a.overwrite)
    given = resolved_rig(a.rig)
    target_rig, name = (None, "") if given is None else (rig_named(given), name_of(given))
    with limited_memory(a.memory_limit):
        log = read_log(Path(a.log), a.kind)
        guess = guess_of(log, target_rig, name, answers, a.only or "")
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
