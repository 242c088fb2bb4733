"""Small things that several commands take: name=value pairs, noise factors, recordings and their
division."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .terminal import aside

if TYPE_CHECKING:
    from pamid.model.rig import Rig
    from pamid.recording.recording import Recording
    from pamid.simulation.data_split import DataSplit


def parse_known(pairs: tuple[str, ...]) -> dict[str, float]:
    """("inertia_kg_m2=0.0896", ...) as a table."""
    from pamid.base.errors import UsageError

    table = {}
    for pair in pairs:
        name, sign, value = pair.partition("=")
        try:
            table[name.strip()] = float(value)
        except ValueError:
            sign = ""
        if not sign:
            raise UsageError(
                f"{pair!r} is not NAME=VALUE with a number.", "For example inertia_kg_m2=0.0896."
            )
    return table


def noise_factor(text: str) -> float:
    """default -> 1, none -> 0, a number as it is."""
    from pamid.base.errors import UsageError

    words = {"default": 1.0, "none": 0.0}
    try:
        factor = words[text] if text in words else float(text)
    except ValueError:
        factor = -1.0
    if factor < 0.0:
        raise UsageError(f"--noise {text!r}: it takes default, none or a factor of at least 0.")
    return factor


no_check_option = click.option(
    "--no-check",
    is_flag=True,
    help="Fit recordings as they are, also where `pamid check` calls them wrong for the rig.",
)


def evidence_from(
    rig_name: str | None,
    recordings: tuple[Path, ...],
    held_out: tuple[Path, ...],
    *,
    check: bool = True,
) -> DataSplit:
    """Read the recordings, refuse those that are wrong for the rig (default: the one of the
    catalogue that they name), and divide them for it."""
    from pamid.checks.inspection import require_sound
    from pamid.model.registry import catalogue_rig, rig_named, rig_of
    from pamid.recording.recording import read_recording
    from pamid.simulation.data_split import split_recordings

    rig = rig_named(rig_name) if rig_name else None
    read = [read_recording(p) for p in (*recordings, *held_out)]
    rig = rig or catalogue_rig(rig_of(read))
    for recording in read:
        for warning in (*recording.warnings, *unknown_columns(rig, recording)):
            aside(f"Warning: {recording.path}: {warning}")
    evidence = split_recordings(rig, read[: len(recordings)], read[len(recordings) :])
    for recording in evidence.recordings:
        if check:
            require_sound(recording, rig)
        lacks = evidence.lacking(recording)
        if lacks:
            aside(
                f"Warning: {recording.path} lacks {', '.join(lacks)}, which other recordings "
                "have; each is used "
                "where it was recorded."
            )
    unused = [c for c in rig.outputs if c not in evidence.channels and any(r.has(c) for r in read)]
    if unused:
        aside(
            f"Warning: {', '.join(unused)} cannot be judged and is left out: at rest in every "
            "recording, or not "
            "both fitted and held out."
        )
    return evidence


def unknown_columns(rig: Rig, recording: Recording) -> list[str]:
    """A sentence per column that the rig does not know: it is kept and not used."""
    from pamid.base.errors import nearest
    from pamid.recording.recording import match_column

    wanted = [*rig.inputs, *rig.outputs, *(loop.reference for loop in rig.loops)]
    used = {match_column(recording.columns, name) for name in wanted}
    return [
        f"rig {rig.name!r} does not know the column {c!r}; it is not used. {nearest(c, wanted)}".rstrip()  # noqa: E501
        for c in recording.columns
        if c not in used
    ]


def with_sidecar(path: Path) -> list[Path]:
    """A recording and the TOML beside it, if there is one."""
    toml = path.with_suffix(".toml")
    return [path, toml] if toml.exists() else [path]
