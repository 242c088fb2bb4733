"""The scorer, which alone reads the labels, and reads only the written result of the diagnosis.

Naming counts only where the fault shows: visibility is the refitted model's error over that of a
twin recording without the fault, in the channel where it is largest.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from pamid.base.arrays import Array
from pamid.base.metrics import PROBABILITY_BINS, calibration_error, probability_bin, wilson_interval
from pamid.base.schemas.estimates import FailedJob
from pamid.base.schemas.trial_file import Bin, Figure, Rate, TrialFile
from pamid.trial.cases import CLOSED, OPEN
from pamid.trial.machine import ONE_DOF
from pamid.trial.marking import LEAST_VISIBILITY, OPEN_ANSWERS, Marked

SLIGHT_VISIBILITY = 1.3  # ... below which it adds 10 to 30 % to the error
PLAIN_VISIBILITY = 2.0  # visibility from which a fault is plain to see
DRAWS = 1000


def score_cases(
    labels: Sequence[dict[str, Any]],
    results: Sequence[dict[str, Any]],
    *,
    part: str = "test",
    seed: int = 0,
    rig: str = ONE_DOF,
    cases_sha256: str = "",
    world: str = CLOSED,
) -> TrialFile:
    """trial.json: results compared with the labels of the same cases. seed: of the shuffled control
    and of the bootstrap."""
    known = {label["number"]: label for label in labels}
    marked = [Marked(known[r["case"]], r) for r in results if not r["failed"]]
    singles = [m for m in marked if m.stratum == "single"]
    rates = {
        "failed": _share(len(results) - len(marked), len(results)),
        "unseen": _rate((m for m in marked if m.truth), lambda m: not m.visible),
        **_naming(singles),
        **_refusing(marked),
    }
    if world == OPEN:  # a planted effect among lesser ones
        seen = [m for m in singles if m.material]
        named, answers = [m for m in seen if m.names], Counter(m.open_answer for m in seen)
        rates |= {
            "open_right": _rate(seen, lambda m: m.open_right),
            **{f"open_{k.replace('-', '_')}": _share(answers[k], len(seen)) for k in OPEN_ANSWERS},
            "open_remainder": _rate(named, lambda m: m.remainder_reported),
            "open_claims": _rate(named, lambda m: m.claims_hold),
        }
    else:
        doubles = [m for m in marked if m.stratum == "double" and m.visible]
        named = [m for m in singles if m.visible and m.names and m.verdict != "ambiguous"]
        rates |= {
            "both_of_two": _rate(doubles, lambda m: m.caught == 2),
            "both_seen": _rate((m for m in doubles if m.each_visible), lambda m: m.caught == 2),
            "one_of_two": _rate(doubles, lambda m: m.caught >= 1),
            "wrong_beside_right": _rate(
                (m for m in [*doubles, *singles] if m.visible), lambda m: m.wrong_beside_right
            ),
            "extra_causes": _rate(named, lambda m: len(m.causes) > 1),
        }
    figures, covered = _forecasts(marked, seed)
    rates["shrinkage_covered"] = covered
    sure, reliability = _calibration(
        [m for m in marked if m.names and (m.visible or not m.truth)], seed
    )
    visible = [m for m in singles if m.visible]
    # answers without a look at the recordings: always the most common family, and the labels dealt
    # at random
    planted = [m.family for m in visible]
    common = Counter(planted).most_common(1)[0][1] if planted else 0
    shuffled = np.random.default_rng(seed).permutation(np.array(planted, dtype=object))
    hits = sum(m.answer == family for m, family in zip(visible, shuffled, strict=True))
    return TrialFile(
        part=part,
        seed=seed,
        cases=len(results),
        rates=rates,
        figures={**sure, **figures},
        reliability=reliability,
        strata=_strata(marked),
        confusion={
            family: dict(Counter(m.answer for m in visible if m.family == family).most_common())
            for family in sorted(set(planted))
        },
        baselines={
            "most_common_family": _share(common, len(planted)),
            "shuffled_labels": _share(hits, len(planted)),
        },
        rig=rig,
        world=world,
        cases_sha256=cases_sha256,
        failures={str(r["case"]): r["failed"]["message"] for r in results if r["failed"]},
        failed_jobs=failed_jobs(results),
    )


def failed_jobs(results: Sequence[dict[str, Any]]) -> tuple[FailedJob, ...]:
    """Which cases failed, or jobs of their diagnosis, and why."""
    return (
        *(
            FailedJob(job=f"case {r['case']}", why=r["failed"]["message"])
            for r in results
            if r["failed"]
        ),
        *(
            FailedJob(job=f"case {r['case']}, {f['job']}", why=f["why"])
            for r in results
            if not r["failed"]
            for f in r["diagnosis"].get("failed_jobs", ())
        ),
    )


def _share(hits: int, of: int) -> Rate:
    """The share of cases that count with its 95 % Wilson interval; None if there were none."""
    low, high = wilson_interval(hits, of)
    return Rate(share=hits / of if of else None, low=low, high=high, hits=hits, of=of)


def _rate(cases: Iterable[Marked], right: Callable[[Marked], bool]) -> Rate:
    hits = [right(m) for m in cases]
    return _share(sum(hits), len(hits))


def _naming(singles: list[Marked]) -> dict[str, Rate]:
    """Whether a single known fault that shows is named."""
    seen = [m for m in singles if m.visible]
    return {
        "family_first": _rate(seen, lambda m: m.answer == m.family),
        "family_first_two": _rate(seen, lambda m: m.names and m.family in m.families[:2]),
        "exact_first": _rate(seen, lambda m: m.names and m.exact_first),
        "family_first_of_ranking": _rate(seen, lambda m: m.families[:1] == [m.family]),
        "port": _rate(seen, lambda m: m.port_right),
        "port_exact": _rate(seen, lambda m: m.port_exact),
        "ambiguous_holds": _rate(
            (m for m in seen if m.verdict == "ambiguous"), lambda m: m.exact_first
        ),
        "wrong_abstention": _rate(seen, lambda m: m.abstains),
        "missed": _rate(seen, lambda m: m.verdict == "no-structural-gap"),
        "left_open": _rate(seen, lambda m: m.verdict == "cannot-tell"),
        "family_first_slight": _rate(
            (m for m in seen if m.visibility < SLIGHT_VISIBILITY), lambda m: m.answer == m.family
        ),
    }


def _refusing(marked: list[Marked]) -> dict[str, Rate]:
    """Nothing to name: is nothing named?"""
    quiet = [m for m in marked if m.stratum == "no-gap"]
    clean = [m for m in quiet if m.conditions["background"] == 0.0]
    rough = [m for m in quiet if m.conditions["background"] > 0.0]
    unknown = [m for m in marked if m.stratum in ("withheld", "nameless") and m.visible]
    return {
        "false_alarm": _rate(quiet, lambda m: m.alarms),
        "named_in_vain": _rate(quiet, lambda m: m.names),
        "left_open_in_vain": _rate(quiet, lambda m: m.verdict == "cannot-tell"),
        "false_alarm_clean": _rate(clean, lambda m: m.alarms),
        "false_alarm_background": _rate(rough, lambda m: m.alarms),
        "abstains": _rate(unknown, lambda m: m.abstains),
        "leaves_nameless": _rate(unknown, lambda m: m.leaves_nameless),
        "abstains_plain": _rate(
            (m for m in unknown if m.visibility >= PLAIN_VISIBILITY), lambda m: m.abstains
        ),
        "abstains_withheld": _rate(
            (m for m in unknown if m.stratum == "withheld"), lambda m: m.abstains
        ),
        "abstains_nameless": _rate(
            (m for m in unknown if m.stratum == "nameless"), lambda m: m.abstains
        ),
        "unknown_port": _rate(unknown, lambda m: m.port_right),
    }


def _forecasts(marked: list[Marked], seed: int) -> tuple[dict[str, Figure], Rate]:
    """Predicted against achieved shrinkage of explained cases, and the time a diagnosis took."""
    forecasts = [
        s
        for m in marked
        if m.verdict in ("explained", "partly-explained")
        and (s := m.result["shrinkage"]) is not None
    ]
    error = np.array([abs(s["predicted"] - s["achieved"]) for s in forecasts])
    bias = np.array([s["predicted"] - s["achieved"] for s in forecasts])
    seconds = np.array([m.result["seconds"] for m in marked])
    covered = sum(s["low"] <= s["achieved"] <= s["high"] for s in forecasts)
    return (
        {
            "shrinkage_error": _figure(error, np.median, seed),
            "shrinkage_bias": _figure(bias, np.median, seed),
            "seconds": _figure(seconds, np.median, seed),
            "seconds_worst": Figure(
                value=max(seconds.tolist(), default=None), low=None, high=None, of=len(seconds)
            ),
        },
        _share(covered, len(forecasts)),
    )


def _figure(rows: Array, figure: Callable[[Array], Any], seed: int) -> Figure:
    """figure(rows) and its percentile interval under resampling of the rows."""
    n = len(rows)
    if n == 0:
        return Figure(value=None, low=None, high=None, of=0)
    drawn = np.random.default_rng(seed).integers(0, n, size=(DRAWS, n))
    low, high = np.percentile([figure(rows[k]) for k in drawn], [2.5, 97.5])
    return Figure(value=float(figure(rows)), low=float(low), high=float(high), of=n)


def _calibration(answers: list[Marked], seed: int) -> tuple[dict[str, Figure], tuple[Bin, ...]]:
    """The probability of every cause that was named against its being right: expected calibration
    error, Brier score, its skill against always saying the share that is right, area under the
    curve of risk over coverage, and the reliability bins (empty ones left out)."""
    rows = np.array(
        [(c["probability"], m.is_right(c)) for m in answers for c in m.causes], float
    ).reshape(-1, 2)
    bins = []
    place = probability_bin(rows[:, 0])
    for k in range(PROBABILITY_BINS):
        inside = rows[place == k]
        if len(inside):
            bins.append(
                Bin(
                    low=k / PROBABILITY_BINS,
                    high=(k + 1) / PROBABILITY_BINS,
                    said=inside[:, 0].mean(),
                    right=_share(int(inside[:, 1].sum()), len(inside)),
                )
            )
    return (
        {
            "ece": _figure(rows, lambda r: calibration_error(r[:, 0], r[:, 1]), seed),
            "brier": _figure(rows, _brier, seed),
            "brier_skill": _figure(rows, _skill, seed),
            "aurc": _figure(rows, _risk, seed),
        },
        tuple(bins),
    )


def _brier(rows: Array) -> float:
    return float(((rows[:, 0] - rows[:, 1]) ** 2).mean())


def _skill(rows: Array) -> float:
    base = float(rows[:, 1].var())
    return 1.0 - _brier(rows) / base if base > 0.0 else 0.0


def _risk(rows: Array) -> float:
    """Share that is wrong among the k surest answers, averaged over k: 0 where all doubt sits on
    wrong ones alone."""
    wrong = 1.0 - rows[np.argsort(-rows[:, 0], kind="stable"), 1]
    return float((np.cumsum(wrong) / np.arange(1, len(wrong) + 1)).mean())


#: condition -> its value in a case (None where its rig has no such condition), and the edges
#: between which cases are put together
DIMENSIONS: dict[str, tuple[Callable[[Marked], Any], tuple[float, ...]]] = {
    "visibility": (lambda m: m.visibility, (LEAST_VISIBILITY, 1.3, PLAIN_VISIBILITY)),
    "background": (lambda m: m.conditions["background"], (0.005, 0.01, 0.02)),
    "channels": (lambda m: m.conditions["channels"], ()),
    "loop": (lambda m: m.conditions["loop"], ()),
    "inertia_kg_m2": (lambda m: m.conditions.get("inertia_kg_m2"), ()),
    "payload_kg": (lambda m: m.conditions.get("payload_kg"), ()),
    "noise": (lambda m: m.conditions["noise"], ()),
}


def _between(value: Any, edges: tuple[float, ...]) -> str:
    below, above = [e for e in edges if e <= value], [e for e in edges if e > value]
    if below and above:
        return f"{below[-1]:g} to {above[0]:g}"
    return f"< {above[0]:g}" if above else f">= {below[-1]:g}" if below else str(value)


def _strata(marked: list[Marked]) -> dict[str, dict[str, dict[str, Rate]]]:
    """The main rates by condition, of those that the cases have. detected: single faults, visible
    or not, for which there is any alarm."""
    out: dict[str, dict[str, dict[str, Rate]]] = {}
    for dimension, (value, edges) in DIMENSIONS.items():
        bins: dict[str, list[Marked]] = {}
        counted = (
            m for m in marked if (m.truth or dimension != "visibility") and value(m) is not None
        )
        for m in sorted(counted, key=value):
            bins.setdefault(_between(value(m), edges), []).append(m)
        out[dimension] = {}
        for name, cases in bins.items():
            singles = [m for m in cases if m.stratum == "single"]
            quiet, named = (m for m in cases if m.stratum == "no-gap"), _naming(singles)
            out[dimension][name] = {
                "family_first": named["family_first"],
                "exact_first": named["exact_first"],
                "detected": _rate(singles, lambda m: m.alarms),
                "false_alarm": _rate(quiet, lambda m: m.alarms),
            }
    return {dimension: bins for dimension, bins in out.items() if bins}
