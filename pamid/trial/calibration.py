"""Calibration: the logistic functions behind a verdict, and how wide an interval has to be.

The probabilities are those of Platt's calibration (1999, Advances in Large Margin Classifiers),
with several features in the place of one score: logistic regression with a ridge penalty, which
keeps the weights finite where the cases can be separated without error (le Cessie and van
Houwelingen 1992, Applied Statistics 41:191). A cause is named where it is more probable than not;
from which probability on what is left counts as real follows from the rates of error that are
allowed below. Only the statistics and labels of calibration parts are used, of any number of
machines; test parts stay unseen.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pamid.base.errors import DataError
from pamid.base.json_file import read_json
from pamid.base.metrics import calibration_error
from pamid.diagnosis.forward_selection import ForwardStep
from pamid.diagnosis.judgement import QUESTIONS, Line
from pamid.diagnosis.settings import DEFAULT
from pamid.diagnosis.signature import Signature
from pamid.diagnosis.verdict_grounds import VerdictStatistics
from pamid.trial.machine import ONE_DOF
from pamid.trial.marking import Marked

Array = NDArray[np.float64]
Features = dict[str, float]

CALIBRATION_SCHEMA = "pamid.calibration/1"
#: question -> prior precision of every weight, features in their standard deviations; these and the
#: features below left the smallest log loss on machines that were left out (1 to 16, six sets)
RIDGE = {"missing": 1.0, "cause": 4.0, "further": 4.0}
#: question -> features it looks at; more of them fit the machines at hand and mislead on others.
#: What a network takes beyond an effect is left out of `cause`: on virtual machines it helps (log
#: loss 0.259 for 0.272), but a network learns more from a real machine's recordings, where it spoke
#: against the right cause on three of three measured sets. So is by how much residuals become white
#: (0.221 for 0.226; three of five right causes of measured sets less probable): on a real machine
#: something more is always missing. Of the evidence the lead counts (0.226; without 0.235). What
#: an effect takes of what the others leave counts, not of the whole gap, of which the weaker of two
#: takes little (alone: the same)
LOOKS_AT = {
    "missing": (
        "floors",
        "of_signal",
        "missing",
        "next_sure",
        "network",
        "network_of_error",
        "stated",
    ),
    "cause": ("of_left", "sure", "lead_sure", "wins", "evidence_lead", "bounds"),
    "further": ("sure", "margin", "evidence"),
}
# targets of figure_table.py: alarms where only noise and tolerances are left, real gaps missed
FALSE_ALARMS, MISSES = 0.03, 0.12
EVEN_ODDS = 0.5  # what is less probable than not is not named
# a further effect is weighed as a cause, beside the others, once it is added: one that is not
# probable enough is dropped again. Added at even odds, a third of those that were there never were
WORTH_ADDING = 0.25
#: what an effect is judged by; cases that were judged without some of it teach nothing of causes
FIGURES = frozenset(f.name for f in fields(Signature))
FAMILIES = 3  # leading families of a ranking from which it is learnt what no cause looks like
COVERAGE = 0.95  # of the intervals of the shrinkage


@dataclass(frozen=True)
class Example:
    """What a question was asked of, the right answer, and the machine it was seen on."""

    features: Features
    yes: bool
    machine: str


@dataclass(frozen=True)
class Lesson:
    """The finished calibration cases of a machine, marked; bare: the tool was not told of its
    tolerances."""

    machine: str
    seed: int
    digest: str
    cases: tuple[Marked, ...]
    bare: bool = False


def lesson_of(folder: Path) -> Lesson:
    """The finished cases in the folder of a trial's calibration part. DataError for another
    part."""
    labels = read_json(folder / "labels.json")
    results = [read_json(path) for path in sorted((folder / "cases").glob("*.json"))]
    return lesson(
        labels["cases"],
        results,
        machine=str(labels.get("rig", ONE_DOF)),
        seed=int(labels["seed"]),
        digest=str(labels["cases_sha256"]),
        bare=bool(labels.get("bare")),
    )


def lesson(
    labels: Sequence[dict[str, Any]],
    results: Sequence[dict[str, Any]],
    *,
    machine: str,
    seed: int,
    digest: str,
    bare: bool = False,
) -> Lesson:
    """The same from labels and results."""
    if any(label["part"] != "calibration" for label in labels):
        raise DataError(
            "the probabilities of a verdict are fitted to the calibration part alone",
            "give the folder of a trial with --part calibration",
        )
    known = {label["number"]: label for label in labels}
    return Lesson(
        machine,
        seed,
        digest,
        tuple(
            Marked(known[r["case"]], r) for r in results if r["case"] in known and not r["failed"]
        ),
        bare,
    )


def calibration_json(lessons: Sequence[Lesson]) -> dict[str, Any]:
    """calibration.json: lines learnt from all of these machines."""
    examples = {q: _examples(lessons, q) for q in QUESTIONS}
    lines = {q: learnt(found, RIDGE[q]) for q, found in examples.items()}
    silent = [lines["missing"].probability(e.features) for e in examples["missing"] if not e.yes]
    # a refitted model at the noise floor was not even asked
    silent += [0.0] * sum(not m.truth and not _grounds(m) for k in lessons for m in k.cases)
    told = [e for e in examples["missing"] if e.features["stated"]]
    bare = [e for e in examples["missing"] if not e.features["stated"]]
    yes = {
        "missing": _balanced(bare or told, lines["missing"]),
        "cause": EVEN_ODDS,
        "further": WORTH_ADDING,
    }
    digests = "".join(k.digest for k in lessons)
    return {
        "schema": CALIBRATION_SCHEMA,
        "cases": {
            "part": "calibration",
            "sha256": hashlib.sha256(digests.encode()).hexdigest(),
            "used": sum(len(k.cases) for k in lessons),
            "machines": [
                {"rig": k.machine, "seed": k.seed, "sha256": k.digest, "used": len(k.cases)}
                | ({"bare": True} if k.bare else {})
                for k in lessons
            ],
        },
        "lines": {q: asdict(replace(line, yes=yes[q])) for q, line in lines.items()},
        "stated_yes": _balanced(told or bare, lines["missing"]),
        "silent": sorted(silent),
        "spread": _spread([m for k in lessons for m in k.cases]),
    }


def learnt_text(lessons: Sequence[Lesson]) -> str:
    """What was learnt from how many cases, and how well calibrated it is on machines that it was
    not learnt from."""
    rows = [
        "",
        f"{'learnt from':24s}{'examples':>10s}{'yes':>8s}"
        + "".join(f"{k:>18s}" for k in dict.fromkeys(k.machine for k in lessons)),
    ]
    for q in QUESTIONS:
        found = _examples(lessons, q)
        errors = leave_one_machine_out(lessons, q)
        rows.append(
            f"{q:24s}{len(found):10d}{sum(e.yes for e in found):8d}"
            + "".join(
                f"{errors[k]:18.3f}" if k in errors else f"{'-':>18s}"
                for k in dict.fromkeys(k.machine for k in lessons)
            )
        )
    rows.append("calibration error on each machine, learnt from the others alone")
    return "\n".join(rows)


def leave_one_machine_out(lessons: Sequence[Lesson], question: str) -> dict[str, float]:
    """Expected calibration error of a question on every machine, by a line that was learnt from
    the others; machines whose answers are all the same, or whose others are, are left out."""
    found = {}
    for own in dict.fromkeys(k.machine for k in lessons):
        train = _examples([k for k in lessons if k.machine != own], question)
        test = _examples([k for k in lessons if k.machine == own], question)
        if len({e.yes for e in train}) == 2 and test:
            line = learnt(train, RIDGE[question])
            found[own] = calibration_error(
                [line.probability(e.features) for e in test], [e.yes for e in test]
            )
    return found


def learnt(examples: Sequence[Example], ridge: float) -> Line:
    """Weights of the features as they are; `yes` is even odds until it is chosen. DataError where
    the examples all have one answer."""
    from sklearn.linear_model import LogisticRegression

    answers = np.array([e.yes for e in examples])
    if len(set(answers.tolist())) < 2:
        raise DataError(
            "a judgement cannot be learnt from cases that all have the same answer",
            "draw more cases: pamid trial --part calibration --cases 60",
        )
    names = sorted(examples[0].features)
    table = np.array([[e.features[k] for k in names] for e in examples])
    centre, spread = table.mean(axis=0), np.maximum(table.std(axis=0), 1e-6)
    model = LogisticRegression(C=1.0 / ridge, tol=1e-8, max_iter=10_000)
    model.fit((table - centre) / spread, answers)
    weights = model.coef_[0] / spread
    return Line(
        float(model.intercept_[0] - weights @ centre),
        dict(zip(names, (float(w) for w in weights), strict=True)),
        EVEN_ODDS,
    )


def _examples(lessons: Sequence[Lesson], question: str) -> list[Example]:
    asked = {"missing": _missing_in, "cause": _causes_in, "further": _further_in}[question]
    return [
        Example({k: features[k] for k in LOOKS_AT[question]}, yes, taught.machine)
        for taught in lessons
        for m in taught.cases
        for features, yes in asked(m)
    ]


def _grounds(m: Marked) -> VerdictStatistics | None:
    found = m.found.get("grounds")
    return VerdictStatistics(**found) if found else None


def _missing_in(m: Marked) -> list[tuple[Features, bool]]:
    """Is what a model leaves more than noise and tolerances? The refitted model of a case with a
    fault that shows, and of one without any; the best model where it has all of the planted faults,
    or one of two that both show."""
    g = _grounds(m)
    if g is None or (m.truth and not m.visible):
        return []
    found = [(g.before.features(), bool(m.truth))]
    right = {str(one["family"]) for one in m.members if m.is_right(one)}
    steps = [ForwardStep(**one) for one in m.found["further"]]
    if m.stratum in ("single", "double") and right and len(right) == len(m.members):
        planted = {str(t["family"]) for t in m.truth}
        if right == planted:
            found.append((g.after(steps).features(), False))
        elif m.each_visible:
            found.append((g.after(steps).features(), True))
    return found


def _causes_in(m: Marked) -> list[tuple[Features, bool]]:
    """Is an effect really there? Asked of every effect of the best model, and of the best of the
    leading families of the ranking."""
    leading: dict[str, dict[str, Any]] = {}
    for one in m.ranking:
        leading.setdefault(str(one["family"]), one)
    weighed = [*list(leading.values())[:FAMILIES], *m.beside_others]
    return [
        (Signature(**one["signature"]).features(), m.is_right(one))
        for one in weighed
        if set(one.get("signature") or ()) >= FIGURES
    ]


def _further_in(m: Marked) -> list[tuple[Features, bool]]:
    """Is an effect, weighed beside a first one, of a planted family?"""
    planted = {t["family"] for t in m.truth} if m.stratum in ("single", "double") else set()
    steps = m.found.get("further") or ()
    return [
        (ForwardStep(**one).features(), one["family"] in planted)
        for one in steps
        if "evidence" in one
    ]


def _balanced(examples: Sequence[Example], line: Line) -> float:
    """Where false alarms and misses, each against what is allowed, are equally rare."""
    p = np.array([line.probability(e.features) for e in examples])
    real = np.array([e.yes for e in examples])
    if real.all() or not real.any():
        return EVEN_ODDS
    grid = np.linspace(0.05, 0.95, 91)
    worst = [
        max((p[~real] >= t).mean() / FALSE_ALARMS, (p[real] < t).mean() / MISSES) for t in grid
    ]
    best = np.flatnonzero(np.array(worst) <= min(worst) + 1e-12)
    return float(grid[best].mean())


def _spread(cases: Sequence[Marked]) -> float:
    """What, times the root of the shrinkage and added in squares to the half-widths of the
    moving-block intervals (logarithm of the error ratio), lets them cover 95 % of the cases."""
    need = []
    for m in cases:
        s = m.result["shrinkage"]
        if m.verdict == "ambiguous" or s is None:
            continue
        middle, low, high, got = (
            np.log(max(1.0 - s[k], 1e-9)) for k in ("predicted", "raw_high", "raw_low", "achieved")
        )
        half = high - middle if got > middle else middle - low
        shrinkage = max(s["predicted"], DEFAULT.least_shrinkage)
        need.append(np.sqrt(max((got - middle) ** 2 - half**2, 0.0) / shrinkage))
    return float(np.quantile(need, COVERAGE)) if need else 0.5
