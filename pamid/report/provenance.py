"""Provenance of a run: commands, recordings, input files and versions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePath

from pamid.base.errors import join_words
from pamid.base.schemas.fit_file import FitFile
from pamid.base.schemas.run_file import Step
from pamid.base.units import duration_text
from pamid.report.formatting import DASH, clean, count
from pamid.report.page import Section, code, note, table


def provenance(
    steps: tuple[Step, ...], fit: FitFile | None = None, level: int = 2, notes: Sequence[str] = ()
) -> Section:
    """Every command that worked on the run, the recordings, input files and versions."""
    body = []
    for step in steps:
        first, *rest = step.command or ("",)
        # the program by its name, wherever it lies
        typed = " ".join([PurePath(first.replace("\\", "/")).name, *rest])
        begun, ended = (
            clean(stamp or "").replace("T", " ").replace("+00:00", " UTC")
            for stamp in (step.begun, step.ended)
        )
        cells = [count(step.seed), begun or DASH, ended or "did not end", step.outcome or DASH]
        body.append([code(clean(typed)), *cells])
    tables = [table(["command", "seed", "begun", "ended", "outcome"], body, (1,), "steps")]
    if fit is not None and fit.recordings:
        heads = ["recording", "role", "samples", "period", "loop"]
        body = [
            [
                clean(recording.name),
                clean(recording.role),
                count(recording.samples),
                DASH if recording.period_s is None else duration_text(recording.period_s, 4),
                clean(recording.loop or "") or DASH,
            ]
            for recording in fit.recordings
        ]
        tables.append(table(heads, body, (2, 3)))
    inputs = dict.fromkeys((input_.path, input_.sha256) for step in steps for input_ in step.inputs)
    if inputs:
        body = [[clean(path), code(clean(sha))] for path, sha in inputs]
        tables.append(table(["input", "sha256"], body))
    # versions of the software that the commands ran on; the latest of several
    versions = dict(pair for step in steps for pair in step.versions.items())
    listed = ", ".join(f"{clean(name)} {clean(version)}" for name, version in versions.items())
    places = join_words(dict.fromkeys(clean(s.platform) for s in steps if s.platform))
    ran_on = f"Versions: {listed}{f'; on {places}' if places else ''}." if listed else ""
    return Section("Provenance", (*tables, note(*notes, ran_on)), level)
