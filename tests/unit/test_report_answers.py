"""What the page says of a diagnosis: sensors, regimes, transfer, the missing term, and what went
wrong."""

import re
from typing import Any

import pytest
from report_pages import VERDICTS, text_of
from synthetic_run import diagnosis_json, fit_json, make_run, run_json

from pamid import DiagnosisResult, open_run
from pamid.base.schemas.diagnosis_file import CAUSED
from pamid.report.channel_errors import errors_of
from pamid.report.load import load_run
from pamid.report.writing import drawings_of

NO_TRACES = ("residual.csv", "trace.csv", "network.json")


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_page_says_what_was_found(verdict, tmp_path):
    text = re.sub(
        r" (?=[,.):;])", "", text_of(make_run(tmp_path / "RUN", verdict, without=NO_TRACES))
    )
    for told in (
        "expected to differ there by 4.2 times the noise of the sensors; it takes about 8 min",
        "are next-experiment.csv and next-experiment-2.csv in the run folder",
        "Run 1: initial pressure 200 kPa. Run 2: initial pressure 500 kPa.",
        "These sensors allow 3 independent checks.",
    ):
        assert told in text, told
    apart = "These sensors cannot separate effects of unknown form at muscle and joint"
    assert (apart in text) == (verdict != "no-structural-gap")
    assert ("Does it hold elsewhere?" in text) == (verdict in CAUSED)
    assert ("At the joint port; these sensors cannot separate it from muscle." in text) == (
        verdict in ("ambiguous", "unknown-effect", "cannot-tell")
    )
    nature = "It is odd in the velocity. It is a function of these signals, without memory."
    assert (nature in text) == (verdict == "unknown-effect")
    assert ("The formula covers 62 % of its variance" in text) == (verdict == "unknown-effect")


#: keys of pamid.diagnosis/2 that are gone
GONE: dict[str, object] = {
    "members": [{"effect": "coulomb-friction", "family": "friction", "probability": 0.91}],
    "dropped": [],
    "look_alikes": [["coulomb-friction", "lugre-friction"]],
    "units": None,
    "further": [],
    "grounds": {"visible": 10.4, "left": 0.07, "wins": 0.93},
    "confidence": {"gap": 0.995, "known": 0.93, "first": 0.91},
}


def as_second_version(verdict: str) -> dict[str, Any]:
    """A diagnosis as pamid.diagnosis/2 had it at first."""
    made = diagnosis_json(verdict) | {"schema": "pamid.diagnosis/2"} | GONE
    for key in ("comparison", "horizon_s", "forecast", "transfer", "a_later_key"):
        del made[key]
    for key in ("redundancy", "unseen", "sensors"):
        del made["where"][key]
    for key in ("expected_separation", "minutes", "excitation", "excitations", "settings"):
        del made["next_experiment"][key]
    for key in ("parity", "memory", "described") if made["unknown"] else ():
        del made["unknown"][key]
    for row in made["ranking"]:
        for key in ("removes", "behind", "figures", "set_aside"):
            del row[key]
        row["signature"] = {"gain": 0.7, "wins": 0.93}
    for named in made["causes"]:
        for key in ("instead", "figures"):
            del named[key]
        del named["removes"]["standard_errors"]
        named |= {"bent": False, "again": []}
    made["remainder"] |= {"probability": 0.21, "p_value": 0.43, "probable_from": 0.78}
    for reach in made["how_far"].values():
        del reach["mae_refitted_short"]
        reach["black_box"] = 0.3
    for form in (made["unknown"] or {}).get("free_forms", []):
        del form["removes"]
    return made


@pytest.mark.parametrize("verdict", VERDICTS)
def test_files_of_the_second_version_are_read(verdict, tmp_path):
    """By the page and by Python; what they lack is not told."""
    made, without = as_second_version(verdict), (*NO_TRACES, "missing.csv")
    folder = make_run(tmp_path / "RUN", verdict, diagnosis=made, without=without)
    result = open_run(folder)
    assert isinstance(result, DiagnosisResult) and result.verdict == verdict
    assert [c.effect for c in result.causes] == [
        c["effect"] for c in diagnosis_json(verdict)["causes"]
    ]
    assert verdict in repr(result) and "<" in result._repr_html_()
    text = text_of(folder)
    assert "Torque loops two pressures." in text
    assert "None" not in text.replace("None of the catalogue", "")
    run = load_run(folder)
    drawn = {d.name for d in drawings_of(run, errors_of(run))}
    assert {"ranking", "budget"} <= drawn and "missing" not in drawn


def test_nothing_found_is_null_in_places(tmp_path):
    """As a diagnosis without a gap writes it."""
    diagnosis = {
        **diagnosis_json("no-structural-gap"),
        "comparison": [],
        "forecast": None,
        "next_experiment": None,
        "ranking": [],
    }
    diagnosis["where"] |= {"regimes": [], "frequency_hz": [], "sensors": []}
    text = text_of(
        make_run(tmp_path / "RUN", "no-structural-gap", diagnosis=diagnosis, without=NO_TRACES)
    )
    assert "The diagnosis recommends no further experiment." in text
    assert "Comparison of the candidates" not in text


def test_an_unfinished_run_and_a_failed_fit_say_so(tmp_path):
    run, fit = (
        {**run_json(), "ended": None},
        {**fit_json(), "converged": False, "why": "it wandered off"},
    )
    text = text_of(make_run(tmp_path / "RUN", run=run, fit=fit))
    assert "This command did not end: pamid diagnose rec.csv" in text
    assert "The fit did not converge: it wandered off." in text


def test_a_control_loop_is_shown_where_one_was_closed(tmp_path):
    heading = "In its control loop"
    assert heading in text_of(make_run(tmp_path / "CLOSED"))
    open_loop = make_run(tmp_path / "OPEN", fit=fit_json() | {"closed_loop": {}})
    assert heading not in text_of(open_loop)
