"""Run of a trial case: simulated, diagnosed blind, compared with the truth.

The diagnosis gets a recording like that of a user, and a catalogue. In addition the trial simulates
the same recording without the fault (does the fault show at all?) and a fresh recording with it
(does the shrinkage hold elsewhere?).
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pamid.api.diagnosing import diagnose
from pamid.api.results import DiagnosisResult
from pamid.api.scoring import score
from pamid.base.arrays import Array
from pamid.base.errors import PamidError
from pamid.base.files import make_folder, sweep
from pamid.base.json_file import read_json, write_json
from pamid.base.parallel.jobs import Failed, Work, WorkerPool, fault_text
from pamid.base.schemas.command_files import ErrorFile
from pamid.base.schemas.model import read
from pamid.base.schemas.trial_case_files import (
    CaseLabel,
    ChannelForecast,
    ShrinkageForecast,
    TrialCaseFile,
    TrialLabelsFile,
)
from pamid.estimation.grey_box import fit_model
from pamid.simulation.scored_recording import REPLAYED
from pamid.trial.case_machine import CaseMachine, RecordedCase
from pamid.trial.cases import CLOSED, OPEN, Case, cases_sha256, draw_cases
from pamid.trial.machine import ONE_DOF
from pamid.trial.own_machine import OwnMachine
from pamid.trial.scoring import score_cases

# of a diagnosis, against a case with a single fault, about
COSTS = {"no-gap": 0.2, "double": 2.0}
Done = Callable[[int, int], None]


@dataclass(frozen=True)
class CaseSelection:
    """Selection of trial cases: `count` cases of `part`, drawn from `seed` for a rig.

    only: restricts them to a stratum; rig: its name, or a machine made of it; bare: without the
    tolerances of the rig; world: "closed" or "open".
    """

    part: str
    count: int
    seed: int
    rig: str | OwnMachine = ONE_DOF
    only: str = ""
    bare: bool = False
    world: str = CLOSED

    @property
    def rig_name(self) -> str:
        return self.rig if isinstance(self.rig, str) else self.rig.name

    def draw(self) -> list[Case]:
        drawn = draw_cases(
            self.part, self.count, self.seed, self.rig, bare=self.bare, world=self.world
        )
        return [c for c in drawn if self.only in ("", c.stratum)]


def run_trial(
    folder: Path,
    selection: CaseSelection,
    pool: WorkerPool,
    *,
    done: Done,
) -> dict[str, Any]:
    """Draw, run and score the cases; writes labels.json, cases/ and trial.json, returns it.

    A case whose result is in the folder already is not run again.
    """
    cases = selection.draw()
    labels = [c.label() for c in cases]
    digest = cases_sha256(cases)
    sweep(folder / "cases")
    unusual: dict[str, Any] = {"bare": True} if selection.bare else {}
    unusual |= {"world": selection.world} if selection.world != CLOSED else {}
    about = TrialLabelsFile(
        rig=selection.rig_name,
        part=selection.part,
        seed=selection.seed,
        cases_sha256=digest,
        cases=tuple(CaseLabel(**label) for label in labels),
        **unusual,
    )
    write_json(folder / "labels.json", about.as_json())
    results = run_cases(cases, folder, pool, done=done)
    scores = score_cases(
        labels,
        results,
        part=selection.part,
        seed=selection.seed,
        rig=selection.rig_name,
        cases_sha256=digest,
        world=selection.world,
    ).as_json()
    write_json(folder / "trial.json", scores)
    return scores


def forget_cases(folder: Path) -> None:
    """Take away the results of cases, and nothing else."""
    for path in (folder / "cases").glob("[0-9]*.json"):
        path.unlink()


def run_cases(
    cases: Sequence[Case],
    folder: Path,
    pool: WorkerPool,
    *,
    done: Done = lambda finished, total: None,
) -> list[dict[str, Any]]:
    """Results in the order of the cases, each written as it comes; done(finished, total) counts
    those that were there already, too. A case whose process is killed again and again counts as
    failed."""
    make_folder(folder / "cases")
    results = {c.number: r for c in cases if (r := finished(c, folder)) is not None}
    todo = [c for c in cases if c.number not in results]
    if pool.executor is None and pool.jobs > 1 and len(todo) > 1:
        CaseMachine.of(todo[0]).run({})  # compiles the machine: the processes inherit it
    for i, result in pool.finished(CaseWork(), todo):
        c = todo[i]
        if isinstance(result, Failed):
            result = _result(c, failed=PamidError(result.why, code="killed").as_dict())
        write_json(_path(c, folder), result)
        results[c.number] = result
        done(len(results), len(cases))
    return [results[c.number] for c in cases]


def finished(case: Case, folder: Path) -> dict[str, Any] | None:
    """The result in the folder, if it is of this very case and the case did not fail."""
    path = _path(case, folder)
    stored = read_json(path) if path.exists() else {}
    return stored if stored.get("sha256") == case.sha256 and not stored["failed"] else None


@dataclass(frozen=True)
class CaseWork(Work[Case, dict[str, Any]]):
    """A case worked through; an error is a result, too."""

    what = "case"

    def __call__(self, item: Case) -> dict[str, Any]:
        try:
            with tempfile.TemporaryDirectory() as place:
                return _result(item, **examine(item, Path(place)))
        except PamidError as error:
            return _result(item, failed=error.as_dict())
        # the tool's fault: it counts against it, and must not cost the other cases
        except Exception as error:
            return _result(item, failed=PamidError(fault_text(error), code="unexpected").as_dict())

    def name(self, item: Case) -> str:
        return str(item.number)

    def cost(self, item: Case) -> float:
        return item.conditions.seconds * COSTS.get(item.stratum, 1.0)


def _result(case: Case, *, failed: dict[str, str] | None = None, **found: Any) -> dict[str, Any]:
    error = None if failed is None else read(ErrorFile, failed)
    return TrialCaseFile(case=case.number, sha256=case.sha256, failed=error, **found).as_json()


def _path(case: Case, folder: Path) -> Path:
    return folder / "cases" / f"{case.number:04d}.json"


def examine(case: Case, place: Path) -> dict[str, Any]:
    """Diagnose a case and measure the truth: diagnosis, CPU seconds, visibility, shrinkage.

    visibility: None if nothing is planted; visibility_each: of two faults, the visibility of the
    less visible with the other present; shrinkage: predicted and achieved.
    """
    bench = CaseMachine.of(case)
    recorded = bench.recorded(place)
    begun = time.process_time()
    run = diagnosed(recorded, place / "run")
    seconds = time.process_time() - begun
    planted = list(case.planted)
    with_all = _refit_errors(recorded) if planted else np.zeros(0)

    def visibility(*sites: str) -> float:
        """Refitted error over that without these effects, in the worst channel."""
        twin = bench.recorded(place / "twin", bench.without(*sites), fresh=0)
        return float((with_all / _refit_errors(twin)).max())

    # what the refitted parameters take up removes nothing, however much it moves
    shows = {a.fault: visibility(a.fault) for a in recorded.acting}
    acting = [
        a.model_copy(update={"removes": 1.0 - 1.0 / shows[a.fault]})
        for a in sorted(recorded.acting, key=lambda a: -shows[a.fault])
    ]
    seen = None
    if planted:
        seen = max(shows.values()) if shows else visibility(*planted)
    # of two faults each with the other alone
    each = [visibility(*(k for k in planted if k != name)) for name in planted if planted[1:]]
    return {
        "diagnosis": run.to_dict(),
        "seconds": seconds,
        "visibility": seen,
        "visibility_each": min(each, default=seen),
        "shrinkage": _shrinkage(run, recorded),
        **({"acting": tuple(acting)} if case.world == OPEN else {}),
    }


def diagnosed(recorded: RecordedCase, folder: Path) -> DiagnosisResult:
    """The tool under trial, as its users run it: it is given this and nothing else."""
    return diagnose(
        list(recorded.fitted),
        recorded.rig,
        held_out=list(recorded.held_out),
        without=recorded.case.removed,
        jobs=1,
        output=folder,
        warn=lambda text: None,  # nobody reads remarks on recordings in a trial
    )


def _refit_errors(recorded: RecordedCase) -> Array:
    """Held-out error of the refitted model by channel, in standard deviations of its noise."""
    fitted = fit_model(recorded.data)
    return np.asarray(np.concatenate([r.losses(1) for r in fitted.held_out]).mean(axis=0))


def _shrinkage(run: DiagnosisResult, recorded: RecordedCase) -> ShrinkageForecast | None:
    """Shrinkage predicted (with its interval) and achieved on a fresh recording, by channel, and in
    the channel with the largest gap; None without a cause, or where a model became unstable."""
    scored = score(run, list(recorded.fresh), rig=recorded.rig, warn=lambda text: None)
    if "with_cause" not in scored.models:
        return None
    how_far, channels = run.to_dict()["how_far"], {}
    for row in scored.recordings:
        before, after = row.mae["refitted"], row.mae["with_cause"]
        if row.comparison != REPLAYED:
            continue
        if before is None or after is None:
            return None
        claim = how_far[row.channel]
        channels[row.channel] = ChannelForecast(
            predicted=claim["shrinkage"],
            low=claim["low"],
            high=claim["high"],
            achieved=1.0 - after / before,
        )
    gap = {c: how_far[c]["mae_refitted"] / how_far[c]["noise_floor"] for c in channels}
    largest = channels[max(gap, key=lambda c: gap[c])]
    return ShrinkageForecast(**vars(largest), channels=channels)
