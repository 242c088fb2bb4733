"""Rank of the planted family in screening, and its cost, under some settings.

    python benchmarks/screened.py [--seed 77] [--cases 2] [--rig NAME ...] [--setting NAME=VALUE ..]

Open cases of the trial are drawn and screened, once under the defaults and once under every setting
that is given. Printed per case and setting: rank of the planted family by gain, whether one of its
effects would be refitted, how many effects would be, and seconds of CPU.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from pamid.base.parallel.jobs import WorkerPool
from pamid.base.progress import silent
from pamid.diagnosis.budget import gap_budget
from pamid.diagnosis.screening import ScreeningBaseline, by_gain
from pamid.diagnosis.search import Search, screened_candidates
from pamid.diagnosis.settings import DEFAULT, settings_from
from pamid.diagnosis.starting_hints import gather_hints
from pamid.model.attachment import additions_of, attachments
from pamid.trial.case_machine import CaseMachine, RecordedCase
from pamid.trial.cases import OPEN, draw_cases

RIGS = ("dc-motor", "thermal-block", "servo-pendulum", "damper-bench", "cylinder-bench")


def setting_of(text: str) -> dict[str, float]:
    """A setting as NAME=VALUE; empty for none."""
    name, _, value = text.partition("=")
    return {name: float(value)} if name else {}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=77)
    parser.add_argument("--cases", type=int, default=2)
    parser.add_argument("--rig", nargs="*", default=RIGS)
    parser.add_argument("--setting", nargs="*", default=())
    chosen = parser.parse_args()
    for rig in chosen.rig:
        for number in range(chosen.cases):
            with tempfile.TemporaryDirectory() as folder:
                drawn = draw_cases("calibration", number + 1, chosen.seed, rig, world=OPEN)
                case = CaseMachine.of(drawn[number]).recorded(Path(folder))
                if case.acting and case.acting[0].family:  # not an effect without a name
                    print(rig, number, case.acting[0].family)
                    tabulate(case, ["", *chosen.setting])


def tabulate(case: RecordedCase, variants: list[str]) -> None:
    data = case.data.excerpt(DEFAULT.fitted_most, DEFAULT.held_out_most)
    budget = gap_budget(data, seed=0, pool=WorkerPool(), progress=silent, settings=DEFAULT)
    base, hints = budget.baseline, gather_hints(budget.evidence, budget.baseline)
    candidates = additions_of(case.rig, attachments(case.rig, case.catalogue.values()))
    search = Search(budget.evidence, budget, candidates, hints, 0, WorkerPool(), silent)
    for text in variants:
        settings, begun = settings_from(setting_of(text)), time.process_time()
        reference = ScreeningBaseline.of(base, len(candidates), settings)
        screened, leading = screened_candidates(search, reference, candidates)
        seconds = time.process_time() - begun
        found = [search.family(s.added) for s in by_gain(s for s in screened if s.usable)]
        refitted = [search.family(s.added) for s in leading]
        right = case.acting[0].family
        rank = found.index(right) + 1 if right in found else "-"
        print(
            f"  {text or 'defaults':20s} rank {rank} of {len(found)}, "
            f"{'' if right in refitted else 'not '}among {len(refitted)} refits, {seconds:.1f} s"
        )


if __name__ == "__main__":
    main()
