"""Calibration: the logistic function behind the probability of a cause, and the spread of shares
from recording to recording.

Platt's calibration (1999, Advances in Large Margin Classifiers) with several features in the place
of a single score: logistic regression with a ridge penalty, which keeps the weights finite where
the cases can be separated without error (le Cessie and van Houwelingen 1992, Applied Statistics
41:191). Only the figures and labels of calibration parts are used, of any number of machines; test
parts stay unseen.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pamid.base.errors import DataError
from pamid.base.json_file import read_json
from pamid.base.metrics import calibration_error
from pamid.diagnosis.answer import logistic
from pamid.trial.machine import ONE_DOF
from pamid.trial.marking import Marked

Features = dict[str, float]

CALIBRATION_SCHEMA = "pamid.calibration/2"
RIDGE = 4.0  # prior precision of every weight, features in their standard deviations
FAMILIES = 3  # leading families of a ranking from which it is learnt what no cause looks like
COVERAGE = 0.95  # of the intervals of the share removed
LEAST_SHARE = 0.02  # of the error: the spread of a smaller share is not measured


@dataclass(frozen=True)
class Example:
    """Figures of an effect, whether it acts, and the machine it was seen on."""

    features: Features
    yes: bool
    machine: str


@dataclass(frozen=True)
class Lesson:
    """Finished calibration cases of a machine, marked; bare: without its tolerances."""

    machine: str
    seed: int
    digest: str
    cases: tuple[Marked, ...]
    bare: bool = False


def lesson_of(folder: Path) -> Lesson:
    """The finished cases of a trial's calibration part. DataError for another part."""
    content = read_json(folder / "labels.json")
    labels = {label["number"]: label for label in content["cases"]}
    if any(label["part"] != "calibration" for label in labels.values()):
        raise DataError(
            "The probabilities of a verdict are fitted only to the calibration part.",
            "Give the folder of a trial with --part calibration.",
        )
    results = map(read_json, sorted((folder / "cases").glob("*.json")))
    return Lesson(
        machine=str(content.get("rig", ONE_DOF)),
        seed=int(content["seed"]),
        digest=str(content["cases_sha256"]),
        cases=tuple(
            Marked(labels[r["case"]], r) for r in results if r["case"] in labels and not r["failed"]
        ),
        bare=bool(content.get("bare")),
    )


def calibration_json(lessons: Sequence[Lesson]) -> dict[str, Any]:
    """calibration.json: weights learnt from all of these machines."""
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
        "weights": learnt(_examples(lessons)),
        "spread": _spread([m for k in lessons for m in k.cases]),
    }


def learnt_text(lessons: Sequence[Lesson]) -> str:
    """The number of examples, and the calibration error on every machine by weights that were
    learnt from the others."""
    examples, errors = _examples(lessons), leave_machines_out(lessons)
    machines = dict.fromkeys(k.machine for k in lessons)
    return "\n".join(
        [
            "",
            f"{len(examples)} examples, {sum(e.yes for e in examples)} of effects that act",
            "calibration error on each machine, learnt from the others alone:",
            *(f"{k:24s}{errors[k]:8.3f}" for k in machines if k in errors),
        ]
    )


def leave_machines_out(lessons: Sequence[Lesson]) -> dict[str, float]:
    """Expected calibration error on every machine, by weights that were learnt from the others;
    machines whose answers are all the same, or whose others are, are left out."""
    errors = {}
    for machine in dict.fromkeys(k.machine for k in lessons):
        train = _examples([k for k in lessons if k.machine != machine])
        test = _examples([k for k in lessons if k.machine == machine])
        if len({e.yes for e in train}) == 2 and test:
            weights = learnt(train)
            errors[machine] = calibration_error(
                [logistic(weights, e.features) for e in test], [e.yes for e in test]
            )
    return errors


def learnt(examples: Sequence[Example]) -> dict[str, float]:
    """Weights by feature, and the constant. DataError if all examples have the same answer."""
    from sklearn.linear_model import LogisticRegression

    answers = np.array([e.yes for e in examples])
    if len(set(answers.tolist())) < 2:
        raise DataError(
            "All cases have the same answer, so no probability can be fitted.",
            "Draw more cases: pamid trial --part calibration --cases 60.",
        )
    names = sorted(examples[0].features)
    table = np.array([[e.features[k] for k in names] for e in examples])
    centre, spread = table.mean(axis=0), np.maximum(table.std(axis=0), 1e-6)
    model = LogisticRegression(C=1.0 / RIDGE, tol=1e-8, max_iter=10_000)
    model.fit((table - centre) / spread, answers)
    weights = model.coef_[0] / spread
    constant = float(model.intercept_[0] - weights @ centre)
    return {"constant": constant, **dict(zip(names, map(float, weights), strict=True))}


def _examples(lessons: Sequence[Lesson]) -> list[Example]:
    """The causes that each case names, and the best of the leading families of its ranking."""
    examples = []
    for lesson in lessons:
        for m in lesson.cases:
            leading: dict[str, dict[str, Any]] = {}
            for cause in [*m.causes, *m.ranking]:
                leading.setdefault(str(cause["family"]), cause)
            examples += [
                Example(candidate["figures"], m.is_right(candidate), lesson.machine)
                for candidate in list(leading.values())[:FAMILIES]
                if candidate.get("figures")
            ]
    return examples


def _spread(cases: Sequence[Marked]) -> float:
    """Factor that lets the intervals of a share cover 95 % of the cases: times the root of the
    share, added in squares to their half-widths (logarithm of the error ratio)."""
    need = []
    for m in cases:
        s = m.result["shrinkage"]
        if m.verdict == "ambiguous" or s is None:
            continue
        middle, low, high, got = (
            np.log(max(1.0 - s[k], 1e-9)) for k in ("predicted", "high", "low", "achieved")
        )
        half = high - middle if got > middle else middle - low
        share = max(s["predicted"], LEAST_SHARE)
        need.append(np.sqrt(max((got - middle) ** 2 - half**2, 0.0) / share))
    return float(np.quantile(need, COVERAGE)) if need else 0.5
