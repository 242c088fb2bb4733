"""Resolution of user input: rigs, effects and recordings by name, by path or as Python objects."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from pamid.base.errors import FileError, PamidError, UsageError, listed, nearest, quoted
from pamid.base.files import PathLike, sha256_of
from pamid.intake.checks.inspection import require_sound
from pamid.intake.checks.sampling_slips import misstated_holds
from pamid.intake.logs.matcher import with_stand_ins
from pamid.model.assembly import Assembly
from pamid.model.effect import Effect
from pamid.model.known_bounds import CURE
from pamid.model.registry import RigLike, as_file, catalogue_rig, resolved_rig, rig_named, rig_of
from pamid.model.rig import Rig
from pamid.recording.recording import (
    EXACT_DIGITS,
    Recording,
    match_column,
    read_recording,
    recording_files,
    recording_of,
)
from pamid.simulation.data_split import DataSplit, split_recordings

if TYPE_CHECKING:
    from pandas import DataFrame

#: a recording, the path of its CSV file, or a table with the column time_s
RecordingLike: TypeAlias = "Recording | PathLike | DataFrame"
#: NAME or NAME@PORT, the path of an effect file (it is run), or an effect
EffectLike: TypeAlias = PathLike | type[Effect]
Warn: TypeAlias = Callable[[str], None]

MOST_STRANGERS = 8  # columns that a rig does not know, each with a separate sentence
RECORDINGS_FOLDER = "recordings"  # folder of a run with the recordings that came to it in no file


def warn_in_python(text: str) -> None:
    """Raise a UserWarning at the line that called pamid."""
    warnings.warn(text, stacklevel=5)  # below: evidence_of, fit, its form with a record


@dataclass(frozen=True)
class Given:
    """Recordings, read and divided for a rig.

    rig: as it was named, or as the recordings name it; inputs: files that were read; kept:
    contents of files that the run folder must hold, by name, for recordings not given as files.
    """

    evidence: DataSplit
    rig: str | Rig
    inputs: tuple[Path, ...]
    kept: dict[str, bytes]


def effects_given(effects: EffectLike | Iterable[EffectLike]) -> tuple[str | type[Effect], ...]:
    """Effect names, file paths and classes for `effects_with`. UsageError for other types."""
    single = isinstance(effects, str | os.PathLike | type)
    resolved: list[str | type[Effect]] = []
    for effect in [effects] if single else effects:  # type: ignore[list-item, union-attr]
        if isinstance(effect, str) or isinstance(effect, type) and issubclass(effect, Effect):
            resolved.append(effect)
        elif isinstance(effect, os.PathLike):
            resolved.append(as_file(effect))
        else:
            raise UsageError(
                f"{effect!r:.60} is no effect.",
                "Give a name (see `pamid effects`), the path of an effect file, or a class "
                "derived from pamid.Effect.",
            )
    return tuple(resolved)


def recording_given(recording: RecordingLike, name: str = "recording") -> Recording:
    """The recording, read where it is a path; UsageError for what is none."""
    if isinstance(recording, Recording):
        return recording
    if isinstance(recording, str | os.PathLike):
        return read_recording(Path(recording))
    if hasattr(recording, "columns") and hasattr(recording, "to_numpy"):
        return Recording.from_pandas(recording, name)
    raise UsageError(
        f"{recording!r:.60} is no recording.",
        "Give a pamid.Recording, the path of a CSV file, or a pandas.DataFrame with the column "
        "time_s.",
    )


def recordings_given(given: RecordingLike | Sequence[RecordingLike]) -> list[RecordingLike]:
    """A list, also of a single item."""
    return list(given) if isinstance(given, list | tuple) else [given]  # type: ignore[list-item]


def evidence_of(
    recordings: RecordingLike | Sequence[RecordingLike],
    rig: RigLike | None = None,
    held_out: RecordingLike | Sequence[RecordingLike] = (),
    *,
    check: bool = True,
    warn: Warn | None = None,
) -> Given:
    """Read the recordings, refuse those that are wrong for the rig (default: the catalogue's rig
    that they name), and divide them for it. Errors as of `read_recording`,
    `require_sound` and `split_recordings`.

    check: refuse recordings with which any fit is nonsense.
    """
    warn = warn or warn_in_python
    named = resolved_rig(rig)
    model = rig_named(named) if named else None
    fitted, judged = recordings_given(recordings), recordings_given(held_out)
    if not fitted:
        raise UsageError("There is no recording to fit.", "Give a recording.")
    resolved = [_taken(item, k) for k, item in enumerate((*fitted, *judged))]
    read = [recording for recording, _ in resolved]
    unnamed = not named and not any(recording.rig for recording in read)
    named = named or rig_of(read)
    model = model or catalogue_rig(str(named))
    if unnamed:
        _require_its_columns(model, read)
    for k, original in enumerate(read):
        recording, stand_ins = with_stand_ins(original, model)
        read[k] = recording
        odd = [*stand_ins, *unknown_columns(model, recording)]
        plain = Assembly(model)
        try:
            plain.values(recording.known)
        except FileError as error:  # a value that cannot be, or is of no parameter
            message = f"{recording.path}: {error.message}"
            raise FileError(message, error.hint, code=error.code) from None
        odd += [f"{fault.text}. {CURE}" for fault in plain.known_objections(recording.known)]
        for text in (*recording.warnings, *odd):
            warn(f"{recording.path}: {text}")
    evidence = split_recordings(model, read[: len(fitted)], read[len(fitted) :])
    model = evidence.rig
    doubts: dict[str, None] = {}
    for recording in evidence.recordings:
        if check:
            doubts |= dict.fromkeys(require_sound(recording, model))
            # inputs whose hold between samples is not stated, and which are not held
            for hold in misstated_holds(recording, model):
                warn(f"{recording.path}: {hold.text(recording)}.")
        if lacks := evidence.lacking(recording):
            warn(
                f"{recording.path} lacks {', '.join(lacks)}, which other recordings have. A "
                "channel is used only in the recordings that contain it."
            )
    unused = [
        c for c in model.outputs if c not in evidence.channels and any(r.has(c) for r in read)
    ]
    if unused:
        warn(
            f"{', '.join(unused)} is left out: a channel must move and have a fitted and a "
            "held-out part."
        )
    evidence = replace(evidence, doubts=tuple(doubts))
    contents = {name: content for _, files in resolved for name, content in files.items()}
    in_files = [recording.path for recording, files in resolved if not files]
    tomls = [path.with_suffix(".toml") for path in in_files]
    inputs = tuple(
        file for pair in zip(in_files, tomls, strict=True) for file in pair if file.exists()
    )
    return Given(evidence, named, inputs, contents)


def _require_its_columns(rig: Rig, recordings: Sequence[Recording]) -> None:
    """Refuse recordings that neither name a rig nor suit the usual rig."""
    for recording in recordings:
        needed = [c for c in rig.inputs if c not in rig.optional]
        if any(recording.has(c) for c in rig.outputs) and all(recording.has(c) for c in needed):
            continue
        raise UsageError(
            f"No rig is named, and {recording.path} does not suit {rig.name!r}, the usual rig.",
            "Name its rig with --rig (rig= in Python): a name from `pamid rigs` or a file of "
            "yours. "
            f"`pamid new-rig {quoted(recording.path)}` writes a rig for its columns.",
        )


def unknown_columns(rig: Rig, recording: Recording) -> list[str]:
    """A sentence per column that the rig does not know: it is kept and not used."""
    wanted = [*rig.inputs, *rig.outputs, *(loop.reference for loop in rig.loops)]
    matches = {name: match_column(recording.columns, name) for name in wanted}
    used, lacking = set(matches.values()), [name for name, column in matches.items() if not column]
    strangers = [c for c in recording.columns if c not in used]
    if len(strangers) > MOST_STRANGERS:
        return [
            f"rig {rig.name!r} does not know {len(strangers)} columns, which are not used: "
            f"{listed(strangers)}."
        ]
    return [
        f"rig {rig.name!r} does not know the column {c!r}; it is not used. {nearest(c, lacking)}".rstrip()  # noqa: E501
        for c in strangers
    ]


def _taken(given: RecordingLike, number: int) -> tuple[Recording, dict[str, bytes]]:
    """Return a recording and the files to store with the run.

    Files are needed for tables, simulations and parts. The recording is then rounded exactly as in
    these files.
    """
    recording = recording_given(given, f"recording-{number + 1}")
    if isinstance(given, str | os.PathLike) or isinstance(given, Recording) and _is_its_file(given):
        return recording, {}
    about = {
        "rig": recording.rig,
        "loop": recording.loop,
        "sampling_period_s": recording.sampling_period_s,
    }
    meta: dict[str, Any] = {"recording": {k: v for k, v in about.items() if v is not None}}
    tables = ("known", "controller", "between", "free")
    meta |= {name: table for name in tables if (table := getattr(recording, name))}
    name = f"{number + 1}-{Path(recording.path).stem}"
    path = Path(RECORDINGS_FOLDER, f"{name}.csv")
    files = recording_files(path, recording.time, recording.columns, meta, digits=EXACT_DIGITS)
    rounded = recording_of(recording.time, recording.columns, meta, name=name, digits=EXACT_DIGITS)
    named = replace(rounded, name=recording.name, path=path)
    return named, {file.as_posix(): content for file, content in files.items()}


def _is_its_file(recording: Recording) -> bool:
    """Does the file that it names hold just this? A part of a recording, or a recording whose known
    values were changed, still has the path of the whole."""
    try:
        if sha256_of(recording.path) != recording.sha256:
            return False
        reread = read_recording(recording.path)
    except (PamidError, OSError):
        return False
    same = ("rig", "loop", "known", "controller", "between", "sampling_period_s")
    return (
        all(getattr(reread, name) == getattr(recording, name) for name in same)
        and np.array_equal(reread.time, recording.time)
        and reread.columns.keys() == recording.columns.keys()
        and all(np.array_equal(x, recording.columns[name]) for name, x in reread.columns.items())
    )
