"""Summaries of runs: content and result of each folder, without figures."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from pamid.base.errors import FileError, PamidError
from pamid.base.run_files import read_steps
from pamid.base.run_folder import DIAGNOSIS_FILE, FIT_FILE, RUN_FILE
from pamid.base.schemas.command_files import RunSummary
from pamid.report import formatting
from pamid.report.captions import verdict_sentence
from pamid.report.channel_errors import errors_of
from pamid.report.load import load_run

DEEPEST = 4  # folders below the searched folder
MOST_LISTED = 2000
_NO_FINDINGS: dict[str, Any] = {
    "recordings": (),
    "verdict": "",
    "sentence": "",
    "causes": (),
    "mae": {},
}
_KINDS = {"trial.json": "trial", "paper.json": "paper", "arm-paper.json": "paper"}


def summary_of(folder: Path) -> RunSummary:
    """Summary of a run; FileError if the folder is not a run or a file of it is damaged."""
    first = read_steps(folder / RUN_FILE)[0]
    kind = next((kind for name, kind in _KINDS.items() if (folder / name).exists()), "")
    has_result = any((folder / name).exists() for name in (FIT_FILE, DIAGNOSIS_FILE))
    words = [word for part in first.command for word in part.split()]
    about: dict[str, Any] = {
        "path": str(folder),
        "command": formatting.clean(words[1]) if len(words) > 1 else "",
        "begun": formatting.clean(first.begun),
        "outcome": formatting.clean(first.outcome or ""),
    }
    if kind or not has_result:
        rig = formatting.clean(first.rig)
        return RunSummary(**_NO_FINDINGS, **about, kind=kind or "other", rig=rig)
    run = load_run(folder)
    rows, diagnosis = errors_of(run), run.diagnosis
    causes = diagnosis.causes if diagnosis is not None else ()
    return RunSummary(
        **about,
        kind="fit" if diagnosis is None else "diagnosis",
        rig=formatting.clean(run.rig),
        recordings=tuple(formatting.clean(recording.name) for recording in run.recordings),
        verdict=diagnosis.verdict if diagnosis is not None else "",
        sentence=verdict_sentence(run, rows),
        causes=tuple(formatting.clean(cause.effect) for cause in causes),
        mae={row.channel: row.known() for row in rows},
    )


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
    listed: list[RunSummary] = []
    for place, below, files in os.walk(folder):
        path = Path(place)
        below.sort()
        if RUN_FILE in files:
            listed.append(_listed(path))
            below.clear()  # no run lies inside a run
        if len(path.parts) - len(folder.parts) >= DEEPEST or len(listed) >= MOST_LISTED:
            below.clear()
    return listed


def _listed(folder: Path) -> RunSummary:
    try:
        return summary_of(folder)
    except PamidError as error:
        about = {name: "" for name in ("command", "rig", "begun", "outcome")}
        fault = {"kind": "damaged", "sentence": formatting.clean(str(error))}
        return RunSummary(**{**_NO_FINDINGS, **about, **fault, "path": str(folder)})
