"""Summaries of runs: content and result of each folder, without figures."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from pamid.base.errors import FileError, PamidError
from pamid.report import formatting
from pamid.report.captions import verdict_sentence
from pamid.report.channel_errors import errors_of
from pamid.report.load import RunData, load_run, read_steps
from pamid.schemas.run_file import Step
from pamid.schemas.runs_file import RunSummary

DEEPEST = 4  # folders below the one that is searched
MOST_LISTED = 2000
_RECORD = "run.json"
_KINDS = {"trial.json": "trial", "paper.json": "paper", "arm-paper.json": "paper"}


def summary_of(folder: Path) -> RunSummary:
    """Summary of a run; FileError if the folder is not a run or a file of it is damaged."""
    steps = read_steps(folder / _RECORD)
    kind = next((kind for name, kind in _KINDS.items() if (folder / name).exists()), "")
    has_result = any((folder / name).exists() for name in ("fit.json", "diagnosis.json"))
    run = load_run(folder) if has_result and not kind else None
    first = steps[0]
    summary = RunSummary(
        path=str(folder),
        kind=kind or _kind_of(run),
        command=command_name(first),
        rig=formatting.clean(run.rig if run is not None else first.rig),
        begun=formatting.clean(first.begun),
        outcome=formatting.clean(first.outcome or ""),
        recordings=(),
        verdict="",
        sentence="",
        causes=(),
        mae={},
    )
    return summary if run is None else _with_findings(summary, run)


def _kind_of(run: RunData | None) -> str:
    if run is None:
        return "other"
    return "fit" if run.diagnosis is None else "diagnosis"


def _with_findings(summary: RunSummary, run: RunData) -> RunSummary:
    rows = errors_of(run)
    diagnosis = run.diagnosis
    return summary.model_copy(
        update={
            "recordings": tuple(
                formatting.clean(recording.name)
                for recording in (run.fit.recordings if run.fit else ())
            ),
            "verdict": diagnosis.verdict if diagnosis is not None else "",
            "sentence": verdict_sentence(run, rows),
            "causes": tuple(
                formatting.clean(cause.effect) for cause in (diagnosis.causes if diagnosis else ())
            ),
            "mae": {row.channel: row.known() for row in rows},
        }
    )


def command_name(step: Step) -> str:
    """ "diagnose" of ["pamid", "diagnose", "rec.csv"]; "" if the record does not say."""
    words = [word for part in step.command for word in part.split()]
    return formatting.clean(words[1]) if len(words) > 1 else ""


def runs_below(folder: Path) -> list[RunSummary]:
    """Every run in the folder and below it, by path; a damaged run is listed with its fault.

    FileError if there is no such folder.
    """
    if not folder.is_dir():
        raise FileError(
            f"{folder} is not a folder.",
            "Give the folder that contains your run folders.",
            code="no-folder",
        )
    return [_listed(run_folder) for run_folder in _run_folders(folder)]


def _listed(folder: Path) -> RunSummary:
    try:
        return summary_of(folder)
    except PamidError as error:
        return RunSummary(
            path=str(folder),
            kind="damaged",
            command="",
            rig="",
            recordings=(),
            begun="",
            outcome="",
            verdict="",
            sentence=formatting.clean(str(error)),
            causes=(),
            mae={},
        )


def _run_folders(folder: Path) -> Iterator[Path]:
    """Folders with a run.json, those inside a run left out; links are not followed."""
    count, depth = 0, len(folder.parts)
    for place, below, files in os.walk(folder):
        path = Path(place)
        below.sort()
        if _RECORD in files:
            count += 1
            yield path
            below.clear()
        if len(path.parts) - depth >= DEEPEST or count >= MOST_LISTED:
            below.clear()
