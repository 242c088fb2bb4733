"""The blind trial's books: which cases are drawn, what the tool is shown of them, and every figure
by hand."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
from pamid_cli import frame

from pamid.api import trial_cases
from pamid.api.trial_cases import CaseWork
from pamid.base.errors import DataError, UsageError
from pamid.base.json_file import read_json
from pamid.base.metrics import wilson_interval
from pamid.base.parallel.jobs import WorkerPool
from pamid.base.run_folder import Run
from pamid.base.schemas.diagnosis_file import CAUSED
from pamid.base.schemas.trial_file import TrialFile
from pamid.model.registry import effects
from pamid.trial.cases import Case, cases_sha256, draw_cases
from pamid.trial.faults import FAULTS, NAMELESS
from pamid.trial.figure_table import trial_text
from pamid.trial.scoring import score_cases

CONDITIONS = {
    "inertia_kg_m2": 0.014,
    "loop": "closed",
    "channels": "all",
    "noise": 1.0,
    "background": 0.015,
    "seconds": 40.0,
    "amplitude_deg": 35.0,
    "hold_s": [0.4, 1.6],
}
FRICTION = {
    "fault": "coulomb-friction",
    "family": "friction",
    "port": "joint",
    "exact": ["coulomb-friction"],
}
LEAK = {"fault": "leak", "family": "leak", "port": "pressure", "exact": ["leak"]}
KNOWN = {
    "coulomb-friction": ("friction", "joint"),
    "stribeck-friction": ("friction", "joint"),
    "leak": ("leak", "pressure"),
    "tube-lag": ("tube-lag", "valve"),
    "gravity": ("gravity", "joint"),
}


def label(number: int, stratum: str, *truth: dict[str, Any], **conditions: Any) -> dict[str, Any]:
    return {
        "number": number,
        "stratum": stratum,
        "truth": list(truth),
        "conditions": {**CONDITIONS, **conditions},
    }


def answer(
    number: int,
    verdict: str,
    *ranking: str,
    causes: tuple[str, ...] = (),
    port: str = "",
    p: float = 1.0,
    visibility: float | None = 3.0,
    alike: tuple[tuple[str, ...], ...] = (),
    tied: tuple[str, ...] = (),
    shrinkage: tuple[float, float, float, float] | None = None,
    seconds: float = 10.0,
) -> dict[str, Any]:
    """A result as work.CaseWork gives it. shrinkage: predicted, low, high, achieved."""

    def row(effect: str, probability: float) -> dict[str, Any]:
        family, at = KNOWN[effect]
        return {"effect": effect, "family": family, "port": at, "probability": probability}

    named = causes or ranking[:1] if verdict in CAUSED else ()
    held = (
        dict(zip(("predicted", "low", "high", "achieved"), shrinkage, strict=True))
        if shrinkage
        else None
    )
    return {
        "case": number,
        "failed": None,
        "visibility": visibility,
        "visibility_each": visibility,
        "seconds": seconds,
        "shrinkage": held,
        "diagnosis": {
            "verdict": verdict,
            "causes": [row(e, p) for e in named],
            "ranking": [row(e, p if i == 0 else 0.0) for i, e in enumerate(ranking)]
            + [{"effect": "two-mass", "family": "", "port": "", "probability": 0.0}],
            "where": {
                "port": port or (KNOWN[ranking[0]][1] if ranking else "muscle"),
                "indistinguishable": [list(tied)] if tied else [],
            },
            "comparison": [{"tied": [{"effect": name} for name in k]} for k in alike],
        },
    }


def both(found: TrialFile, name: str) -> tuple[int, int]:
    return found.rates[name].hits, found.rates[name].of


# ---- figures by hand --------------------


def test_naming():
    """Five visible singles and a hidden one: right; look-alike first; second family right;
    abstains; no gap."""
    labels = [label(i, "single", FRICTION) for i in range(6)]
    results = [
        answer(0, "explained", "coulomb-friction", "leak"),
        answer(
            1, "explained", "stribeck-friction", alike=(("stribeck-friction", "coulomb-friction"),)
        ),
        answer(
            2,
            "explained",
            "leak",
            "tube-lag",
            "coulomb-friction",
            causes=("leak", "coulomb-friction"),
        ),
        answer(3, "unknown-effect", "coulomb-friction", "leak"),
        answer(4, "no-structural-gap"),
        answer(5, "no-structural-gap", visibility=1.05),
    ]
    found = score_cases(labels, results)
    assert both(found, "family_first") == (2, 5)
    assert both(found, "family_first_two") == (2, 5), (
        "third family of the third case, abstention of the fourth"
    )
    assert both(found, "exact_first") == (2, 5)
    assert both(found, "family_first_of_ranking") == (3, 5)
    assert both(found, "wrong_abstention") == both(found, "missed") == (1, 5)
    assert both(found, "port") == (3, 5), "an abstention may still place the gap"
    assert both(found, "unseen") == (1, 6)
    assert both(found, "extra_causes") == (1, 3)
    assert found.confusion == {
        "friction": {"friction": 2, "leak": 1, "(unknown effect)": 1, "(no gap)": 1}
    }
    assert found.baselines["most_common_family"].share == 1.0
    assert both(
        found.model_copy(update={"rates": found.strata["visibility"]["< 1.1"]}), "detected"
    ) == (0, 1)
    assert both(
        found.model_copy(update={"rates": found.strata["visibility"][">= 2"]}), "detected"
    ) == (4, 5)


def test_exact_needs_the_effect_itself_or_what_was_measured_to_be_alike():
    labels = [label(i, "single", FRICTION) for i in range(3)]
    found = score_cases(
        labels,
        [
            answer(0, "explained", "stribeck-friction"),
            answer(
                1,
                "explained",
                "stribeck-friction",
                alike=(("stribeck-friction", "coulomb-friction"),),
            ),
            answer(2, "ambiguous", "leak", "coulomb-friction", causes=("leak", "coulomb-friction")),
        ],
    )
    assert both(found, "exact_first") == (1, 3), "only the tie contains it"
    assert both(found, "family_first") == (2, 3)


def test_refusing_to_name():
    quiet = [label(i, "no-gap", background=0.0 if i < 2 else 0.02) for i in range(5)]
    unknown = [
        label(5, "withheld", FRICTION),
        label(6, "withheld", FRICTION),
        label(7, "nameless", {**FRICTION, "exact": []}),
        label(8, "nameless", FRICTION),
    ]
    results = [
        *(answer(i, "no-structural-gap", visibility=None) for i in range(4)),
        answer(4, "explained", "leak", visibility=None),
        answer(5, "unknown-effect", "leak", port="joint"),
        answer(6, "explained", "leak", visibility=1.5),
        answer(7, "unknown-effect", port="muscle", visibility=1.9),
        answer(8, "explained", "leak", visibility=1),
    ]
    found = score_cases([*quiet, *unknown], results)
    assert [both(found, f"false_alarm{k}") for k in ("", "_clean", "_background")] == [
        (1, 5),
        (0, 2),
        (1, 3),
    ]
    assert [both(found, f"abstains{k}") for k in ("", "_plain", "_withheld", "_nameless")] == [
        (2, 3),
        (1, 1),
        (1, 2),
        (1, 1),
    ]
    assert both(found, "unknown_port") == (1, 3)
    assert both(found, "unseen") == (1, 4)
    alarms = {k: r["false_alarm"] for k, r in found.strata["background"].items()}
    assert {k: (r.hits, r.of) for k, r in alarms.items()} == {
        "< 0.005": (0, 2),
        "0.01 to 0.02": (0, 0),
        ">= 0.02": (1, 3),
    }


def test_calibration_by_hand():
    """Said 0.95 three times (one right, one of them an alarm where nothing is planted) and 0.42
    twice (none right).

    ECE is (1.85 + 0.84)/5; an abstention says nothing and does not count.
    """
    labels = [*(label(i, "single", FRICTION) for i in range(5)), label(5, "no-gap")]
    found = score_cases(
        labels,
        [
            answer(0, "explained", "coulomb-friction", p=0.95),
            answer(1, "explained", "leak", p=0.95),
            answer(2, "explained", "leak", p=0.42),
            answer(3, "ambiguous", "leak", p=0.42),
            answer(4, "unknown-effect", "coulomb-friction", p=0.7),
            answer(5, "explained", "leak", p=0.95, visibility=None),
        ],
    )
    ece, brier, skill = (found.figures[k].value for k in ("ece", "brier", "brier_skill"))
    assert ece == pytest.approx((3 * 0.95 - 1 + 2 * 0.42) / 5)
    assert brier == pytest.approx((0.05**2 + 2 * 0.95**2 + 2 * 0.42**2) / 5)
    assert found.figures["aurc"].value == pytest.approx((0.0 + 1 / 2 + 2 / 3 + 3 / 4 + 4 / 5) / 5)
    assert both(found, "ambiguous_holds") == (0, 1)
    assert skill == pytest.approx(1.0 - (0.05**2 + 2 * 0.95**2 + 2 * 0.42**2) / 5 / (0.2 * 0.8))
    assert [(b.low, b.said, b.right.hits, b.right.of) for b in found.reliability] == [
        (0.4, pytest.approx(0.42), 0, 2),
        (0.9, pytest.approx(0.95), 1, 3),
    ]


def test_shuffled_labels_fall_to_chance():
    truths = [FRICTION if i % 2 else LEAK for i in range(60)]
    results = [answer(i, "explained", str(t["fault"])) for i, t in enumerate(truths)]
    found = score_cases([label(i, "single", t) for i, t in enumerate(truths)], results, seed=1)
    assert found.rates["family_first"].share == 1.0
    low, high = wilson_interval(found.baselines["shuffled_labels"].hits, 60)
    assert low < 0.5 < high
    assert found.baselines["most_common_family"].share == 0.5


def test_failed_cases_are_counted_and_shown():
    failed = {"case": 1, "failed": {"message": "too short"}}
    found = score_cases(
        [label(0, "single", FRICTION), label(1, "single", LEAK)],
        [answer(0, "explained", "coulomb-friction"), failed],
    )
    assert both(found, "failed") == (1, 2) and both(found, "family_first") == (1, 1)
    told = {**json.loads(json.dumps(found.as_json())), "failures": {"1": "too short"}}
    text = trial_text(told)
    assert (
        "family named first" in text
        and "100.0 %" in text
        and ">= 90 %" in text
        and "case 1: too short" in text
    )


# ---- drawing --------------------


def test_a_case_depends_on_its_number_alone():
    few, many = draw_cases("test", 7, 3), draw_cases("test", 40, 3)
    assert few == many[:7] == draw_cases("test", 7, 3)
    assert cases_sha256(few) != cases_sha256(draw_cases("test", 7, 4)) != cases_sha256(many)
    assert [Case(**{**asdict(c), "conditions": c.conditions}) for c in few] == list(few)
    with pytest.raises(UsageError, match="calibration"):
        draw_cases("tset", 1, 0)


def test_parts_are_disjoint():
    test, calibration = draw_cases("test", 100, 0), draw_cases("calibration", 100, 0)
    assert not {c.seed for c in test} & {c.seed for c in calibration}
    assert len({c.seed for c in (*test, *calibration)}) == 200
    assert not {json.dumps(c.planted) for c in test if c.planted} & {
        json.dumps(c.planted) for c in calibration
    }


def test_what_is_planted():
    for case in draw_cases("test", 200, 1):
        named = [n for n in case.planted if not n.startswith(NAMELESS)]
        assert (len(case.planted), len(named)) == {
            "single": (1, 1),
            "withheld": (1, 1),
            "double": (2, 2),
            "nameless": (1, 0),
            "no-gap": (0, 0),
        }[case.stratum]
        assert bool(case.removed) == (case.stratum == "withheld")
        if case.stratum == "double":
            assert len({FAULTS[n].family for n in case.planted}) == 2
        if case.stratum == "withheld":
            left = {n: e for n, e in effects().items() if n not in case.removed}
            fault = FAULTS[named[0]]
            assert not fault.exact & left.keys()
            assert not any(fault.family in (e.family, *e.families.values()) for e in left.values())
            assert not any(fault.exact & set(e.look_alikes) for e in left.values())


# ---- what the tool is shown --------------------


def example(stratum: str, **conditions: Any) -> Case:
    """The first case of a stratum, made short."""
    case = next(c for c in draw_cases("calibration", 60, 5) if c.stratum == stratum)
    return replace(
        case, conditions=replace(case.conditions, seconds=9.0, hold_s=(0.4, 1.6), **conditions)
    )


@pytest.mark.parametrize(
    ("stratum", "loop", "channels"),
    [
        ("single", "closed", "all"),
        ("double", "open", "angle"),
        ("withheld", "closed", "all"),
        ("nameless", "open", "angle"),
    ],
)
def test_the_label_is_in_nothing_the_tool_is_given(stratum, loop, channels, tmp_path, monkeypatch):
    shown: list[tuple[dict[str, Any], tuple[str, ...]]] = []

    def diagnose(recordings, rig, *, without, **how):
        (recording,) = recordings
        assert rig.name == "one-dof" and how["held_out"] == []
        told = {
            **vars(recording),
            "path": recording.path.name,
            "toml": recording.path.with_suffix(".toml").read_text(),
            "columns": list(recording.columns),
            "time": len(recording),
            "sha256": "",
        }
        shown.append((told, without))
        raise DataError("seen enough")

    monkeypatch.setattr(trial_cases, "diagnose", diagnose)
    case = example(stratum, loop=loop, channels=channels)
    assert CaseWork()(case)["failed"]["message"] == "seen enough"
    CaseWork()(replace(case, planted={}, removed=(), stratum="no-gap", number=0))
    (told, removed), (unplanted, nothing) = shown
    assert told == unplanted, "but for what was measured, nothing depends on the label"
    assert removed == case.removed and nothing == ()
    assert (
        told["columns"]
        == {
            "closed": [
                "reference_deg",
                "command",
                "angle_deg",
                "pressure_1_kpa",
                "pressure_2_kpa",
                "force_1_n",
                "force_2_n",
            ],
            "open": ["command", "angle_deg"],
        }[loop]
    )
    assert told["known"].keys() == {"inertia_kg_m2", "supply_pressure_kpa", "initial_pressure_kpa"}
    for word in (*case.planted, case.stratum, "calibration", str(case.seed)):
        assert word not in repr(told)


# ---- the run --------------------


@pytest.fixture
def examined(monkeypatch) -> list[int]:
    """Numbers of the cases that were worked through; the work itself is left out."""
    numbers: list[int] = []

    def examine(case, place):
        numbers.append(case.number)
        found = answer(case.number, "explained", "leak", visibility=3.0 if case.planted else None)
        return {
            k: found[k]
            for k in (
                "diagnosis",
                "visibility",
                "visibility_each",
                "shrinkage",
                "seconds",
            )
        }

    monkeypatch.setattr(trial_cases, "examine", examine)
    return numbers


def trial(folder: Path, cases: int, *more: str) -> int:
    return frame.run(
        ["trial", "--output", str(folder), "--cases", str(cases), "--jobs", "1", *more]
    )


def test_a_finished_case_is_not_run_again(tmp_path, examined, capsys):
    assert trial(tmp_path / "run", 3) == 0
    assert "family named first" in capsys.readouterr().out
    assert trial(tmp_path / "run", 5, "--json") == 3
    assert "--resume" in json.loads(capsys.readouterr().out)["hint"]
    assert trial(tmp_path / "run", 5, "--resume", "--json") == 0
    assert sorted(examined) == [0, 1, 2, 3, 4] and len(examined) == 5
    found = json.loads(capsys.readouterr().out)
    assert (
        found == read_json(tmp_path / "run" / "trial.json") and found["schema"] == "pamid.trial/1"
    )
    assert found["cases"] == 5 and found["cases_sha256"] == cases_sha256(draw_cases("test", 5, 0))
    labels = read_json(tmp_path / "run" / "labels.json")
    assert [c["number"] for c in labels["cases"]] == [0, 1, 2, 3, 4]
    kept = read_json(tmp_path / "run" / "cases" / "0001.json")
    (tmp_path / "run" / "cases" / "0001.json").write_text(
        json.dumps({**kept, "sha256": "of another case"})
    )
    assert trial(tmp_path / "run", 5, "--resume") == 0
    assert examined[5:] == [1]
    capsys.readouterr()
    assert trial(tmp_path / "run", 5, "--seed", "1", "--json") == 3
    assert "seed 0" in json.loads(capsys.readouterr().out)["message"] and len(examined) == 6


def test_a_trial_is_replaced_as_a_whole_and_nothing_else_is(tmp_path, examined, capsys):
    folder, notes = tmp_path / "run", tmp_path / "run" / "cases" / "notes.txt"
    assert trial(folder, 4) == 0 and len(examined) == 4
    notes.write_text("mine")
    assert trial(folder, 2, "--overwrite", "--resume") == 2 and len(examined) == 4
    assert trial(folder, 2, "--overwrite", "--seed", "1") == 0
    assert examined[4:] and len(examined) == 6, "results of the earlier trial count for nothing"
    assert sorted(path.name for path in (folder / "cases").iterdir()) == [
        "0000.json",
        "0001.json",
        "notes.txt",
    ]
    assert read_json(folder / "run.json")["seed"] == 1
    other = tmp_path / "other"
    Run.create(other, command=["pamid", "fit"], seed=0)
    capsys.readouterr()
    assert trial(other, 2, "--overwrite") == 3
    assert "it contains no trial" in capsys.readouterr().err and len(examined) == 6


@pytest.mark.parametrize("error", [DataError("too short"), ZeroDivisionError("oops")])
def test_a_failed_case_costs_only_itself(error, tmp_path, examined, monkeypatch, capsys):
    fine = trial_cases.examine

    def examine(case, place):
        if case.number == 1:
            raise error
        return fine(case, place)

    monkeypatch.setattr(trial_cases, "examine", examine)
    assert trial(tmp_path / "run", 3) == 6
    assert f"{error}" in capsys.readouterr().out and sorted(examined) == [0, 2]
    told = read_json(tmp_path / "run" / "trial.json")["failed_jobs"]
    assert [f["job"] for f in told] == ["case 1"] and f"{error}" in told[0]["why"]
    monkeypatch.setattr(trial_cases, "examine", fine)
    assert trial(tmp_path / "run", 3, "--resume") == 0
    assert examined[2:] == [1], "what failed is tried again"


def test_shares_of_a_trial_are_gathered_and_scored_once(tmp_path, examined, capsys):
    folder = tmp_path / "run"
    assert trial(folder, 7, "--index", "2/3") == 0
    capsys.readouterr()
    assert trial(folder, 7, "--index", "1/3", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert (
        told["schema"] == "pamid.trial-share/1"
        and told["cases"] == [0, 3, 6]
        and told["failed_jobs"] == []
    )
    assert sorted(examined) == [0, 1, 3, 4, 6] and not (folder / "trial.json").exists()
    assert trial(folder, 7, "--index", "1/3", "--seed", "1") == 3, "another trial's share"
    for wrong in ("0/3", "4/3", "3", "a/b", "-1/2"):
        assert trial(folder, 7, f"--index={wrong}") == 2
    assert trial(folder, 7) == 3 and trial(folder, 7, "--resume") == 0
    assert sorted(examined) == list(range(7)) and len(examined) == 7
    whole = tmp_path / "whole"
    assert trial(whole, 7) == 0
    assert (folder / "trial.json").read_bytes() == (whole / "trial.json").read_bytes()


def test_a_case_from_end_to_end(tmp_path):
    few = {"dead-time", "gravity"}
    case = replace(
        example(
            "single",
            loop="closed",
            channels="no-forces",
            noise=1.0,
            background=0.01,
            amplitude_deg=35.0,
            inertia_kg_m2=0.014,
        ),
        planted={"dead-time": {"delay_s": 0.03}},
        removed=tuple(n for n in effects() if n not in few),
    )
    (found,) = trial_cases.run_cases([case], tmp_path, WorkerPool())
    assert found["failed"] is None and found == trial_cases.finished(case, tmp_path)
    assert trial_cases.finished(replace(case, seed=1), tmp_path) is None
    assert found["visibility"] > 1.5 and found["seconds"] > 0.0
    marked = score_cases([case.label()], [found])
    assert both(marked, "exact_first") == both(marked, "port") == (1, 1)
    held = found["shrinkage"]
    assert held["channels"].keys() == {"angle_deg", "pressure_1_kpa", "pressure_2_kpa"}
    how_far = found["diagnosis"]["how_far"]
    largest = max(how_far, key=lambda c: how_far[c]["mae_refitted"] / how_far[c]["noise_floor"])
    assert [held[k] for k in ("predicted", "low", "high")] == [
        how_far[largest][k] for k in ("shrinkage", "low", "high")
    ]
    assert held["achieved"] == held["channels"][largest]["achieved"]
    each = [c["achieved"] for c in held["channels"].values()]
    assert 0.5 < min(each) <= held["achieved"] <= max(each) < 1.0
