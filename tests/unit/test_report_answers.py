"""What the page says of a diagnosis: sensors, regimes, transfer, the missing term, and what went
wrong."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, get_args

import pytest
from matplotlib.figure import Figure
from report_pages import VERDICTS, text_of
from synthetic_run import cause, diagnosis_json, fit_json, make_run, network_json, run_json

from pamid import DiagnosisResult, open_run
from pamid.base.errors import FileError
from pamid.checks.row_order import OF_THE_LOG
from pamid.report.captions import ports_title
from pamid.report.channel_errors import errors_of
from pamid.report.figures import missing_drawing, ranking_drawing, regimes_drawing
from pamid.report.glance import todo_of
from pamid.report.load import load_run
from pamid.report.style import render
from pamid.report.writing import drawings_of
from pamid.schemas.diagnosis_file import CAUSED, WITHHELD, Verdict, Where
from pamid.schemas.model import read

NO_TRACES = ("residual.csv", "trace.csv", "network.json")


def test_the_verdicts_are_those_of_the_contract() -> None:
    assert set(VERDICTS) == set(get_args(Verdict))


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_page_says_what_was_found(verdict: str, tmp_path: Path) -> None:
    text = re.sub(
        r" (?=[,.):;])", "", text_of(make_run(tmp_path / "RUN", verdict, without=NO_TRACES))
    )
    for told in (
        "A probability is how often, among virtual machines with figures like these, an effect of "
        "that family was really there.",
        "The nearest two of these models are expected to differ there by 4.2 times the "
        "noise of the sensors; it takes about 8 min at the rig.",
        "Its excitations, one for each run, are next-experiment.csv and next-experiment-2.csv in "
        "the run folder",
        "Run 1: initial pressure 200 kPa. Run 2: initial pressure 500 kPa.",
        "one more sensor takes apart Force 1 and force 2 muscle and joint",
        "These sensors allow 3 independent checks.",
    ):
        assert told in text, told
    apart = (
        "These sensors cannot separate effects of unknown form at muscle and joint, or at valve "
        "and pressure; they do not respond to leak; measuring force 1 and force 2 as well would "
        "separate muscle and joint."
    )
    assert (apart in text) == (verdict != "no-structural-gap")
    assert ("Does it hold elsewhere?" in text) == (verdict in CAUSED)
    assert ("At the joint port; these sensors cannot separate it from muscle." in text) == (
        verdict in ("ambiguous", "unknown-effect", "cannot-tell")
    )
    nature = (
        "It changes its sign with the velocity. It follows these signals without memory. It takes "
        "energy out, as friction does."
    )
    assert (nature in text) == (verdict == "unknown-effect")
    assert ("The formula covers 62 % of its variance" in text) == (verdict == "unknown-effect")


@pytest.mark.parametrize("verdict", VERDICTS)
def test_a_diagnosis_of_an_older_version_makes_a_page(verdict: str, tmp_path: Path) -> None:
    diagnosis = diagnosis_json(verdict)
    for key in ("transfer", "comparison", "forecast", "horizon_s"):
        del diagnosis[key]
    for key in ("redundancy", "unseen", "sensors"):
        del diagnosis["where"][key]
    for key in ("expected_separation", "minutes", "excitation", "excitations", "settings"):
        del diagnosis["next_experiment"][key]
    for key in ("parity", "memory", "described") if diagnosis["unknown"] else ():
        del diagnosis["unknown"][key]
    folder = make_run(
        tmp_path / "RUN", verdict, diagnosis=diagnosis, without=(*NO_TRACES, "missing.csv")
    )
    assert "Torque loops two pressures." in text_of(folder)
    run = load_run(folder)
    assert "missing" not in {drawing.name for drawing in drawings_of(run, errors_of(run))}


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
    """A diagnosis as pamid.diagnosis/2 had it."""
    made = diagnosis_json(verdict) | {"schema": "pamid.diagnosis/2"} | GONE
    for key in ("comparison", "horizon_s", "forecast", "a_later_key"):
        del made[key]
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
def test_files_of_the_second_version_are_read(verdict: str, tmp_path: Path) -> None:
    """By the page and by Python; what they lack is not told."""
    folder = make_run(
        tmp_path / "RUN", verdict, diagnosis=as_second_version(verdict), without=NO_TRACES
    )
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
    assert {"ranking", "budget"} <= {d.name for d in drawings_of(run, errors_of(run))}


def test_the_first_version_is_refused_with_what_has_changed(tmp_path: Path) -> None:
    made = diagnosis_json("explained") | {"schema": "pamid.diagnosis/1"}
    with pytest.raises(FileError, match="now pamid.diagnosis/3.*probability of its own") as caught:
        load_run(make_run(tmp_path / "RUN", diagnosis=made, without=NO_TRACES))
    assert "pamid diagnose" in caught.value.hint
    later = make_run(tmp_path / "LATER", diagnosis=made | {"schema": "pamid.diagnosis/4"})
    with pytest.raises(FileError, match="schema should be 'pamid.diagnosis/3'"):
        load_run(later)


def test_one_file_of_an_older_diagnosis_is_named(tmp_path: Path) -> None:
    diagnosis = diagnosis_json("explained")
    del diagnosis["next_experiment"]["excitations"]
    folder = make_run(tmp_path / "RUN", "explained", diagnosis=diagnosis, without=NO_TRACES)
    assert "Its excitation is next-experiment.csv in the run folder" in re.sub(
        r" (?=[,.):;])", "", text_of(folder)
    )


def test_nothing_found_is_null_in_places(tmp_path: Path) -> None:
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
    assert "The diagnosis asks for no further experiment." in text
    assert "Comparison of the candidates" not in text


def test_an_experiment_that_would_lead_too_far_is_not_called_needless(tmp_path: Path) -> None:
    """Where none is proposed although causes are in question, the page says why; what is sent
    beside a proposed one, and where it leads, stands with it."""
    bare = diagnosis_json("ambiguous") | {"next_experiment": None}
    note = f"{WITHHELD}: each would lead the stage to 183 mm."
    text = text_of(
        make_run(
            tmp_path / "NONE",
            "ambiguous",
            diagnosis=bare | {"notes": [note]},
            without=NO_TRACES,
        )
    )
    assert note in text and "asks for no further experiment" not in text
    assert "Nothing more needs to be measured" not in text and "Hold the rig by a loop" in text
    asked = diagnosis_json("ambiguous")
    asked["next_experiment"] |= {"cautions": ["beside it oil_degc is held at 40, as recorded"]}
    made = make_run(tmp_path / "RUN", "ambiguous", diagnosis=asked, without=NO_TRACES)
    assert "Beside it oil_degc is held at 40, as recorded." in text_of(made)


def test_a_remark_on_the_recordings_is_the_whole_answer(tmp_path: Path) -> None:
    remark = "Nothing of the model shows: check the columns."
    diagnosis = {**diagnosis_json("cannot-tell"), "remark": remark}
    text = text_of(
        make_run(tmp_path / "RUN", "cannot-tell", diagnosis=diagnosis, without=NO_TRACES)
    )
    assert remark in text and "may be missing" not in text
    assert text.count("Undetermined. ") == 2, "neither where nor which"
    assert "What is left" not in text and "A probability is" not in text


def test_what_the_terminal_notes_stands_on_the_page(tmp_path: Path) -> None:
    note = "Background force_map_1 stands at 3.0 tolerances: length-asymmetry would look like this."
    diagnosis = {**diagnosis_json("explained"), "notes": [note]}
    text = text_of(make_run(tmp_path / "RUN", diagnosis=diagnosis, without=NO_TRACES))
    assert note in re.sub(r" (?=[,.):;])", "", text)
    bare = text_of(make_run(tmp_path / "BARE", without=NO_TRACES))
    assert "What to know before believing" not in bare


def test_two_causes_share_what_they_remove(tmp_path: Path) -> None:
    diagnosis = diagnosis_json("partly-explained")
    diagnosis["causes"] += [cause("leak", "leak", "pressure", 0.07, 0.81, 0.05)]
    text = re.sub(
        r" (?=[,.):;])",
        "",
        text_of(make_run(tmp_path / "RUN", diagnosis=diagnosis, without=NO_TRACES)),
    )
    for told in (
        "Coulomb friction at the joint port (P 0.91) and leak at the pressure port (P 0.81) "
        "together remove 64 % of the gap, without Coulomb friction 0 % and without leak 59 %. "
        "36 % of the gap remains, 3.7 times the noise floor. It enters at the muscle port.",
        "At the joint and pressure ports.",
        "Leak removes 5 % of the gap next to the other (95 % interval",
        "Of what they remove one by one, Coulomb friction accounts for 93 % and leak accounts for "
        "7 %.",
    ):
        assert told in text, told


def test_horizon_and_forecast_are_told_once_each(tmp_path: Path) -> None:
    """The gap over the horizon and, next to it, over single windows."""
    text = text_of(make_run(tmp_path / "RUN", without=NO_TRACES)).replace("\u00a0", " ")
    for sentence in (
        "The model predicts over up to 40 s from one estimated state.",
        "With a state estimated in every window the refitted error is 0.312 deg.",
        "On a new recording 77 % of the error would be removed (95 % interval 60 to 87 %).",
    ):
        assert text.count(sentence) == 1, sentence
    made = diagnosis_json("explained") | {"horizon_s": None, "forecast": None}
    made["how_far"]["angle_deg"]["mae_refitted_short"] = None
    bare = text_of(make_run(tmp_path / "BARE", diagnosis=made, without=NO_TRACES))
    assert "On a new recording" not in bare and "estimated state" not in bare


def test_a_port_that_the_shares_do_not_lead_is_said() -> None:
    shares = [{"port": "joint", "share": 0.81}, {"port": "muscle", "share": 0.12}]
    where = read(Where, {"port": "muscle", "ports": shares})
    told = ports_title(where).replace("\u00a0", " ")
    assert (
        told == "81 % of the gap might enter at the joint port; the verdict names the muscle port, "
        "with 12 %"
    )


def test_regimes_stand_as_pairs_of_bars(tmp_path: Path) -> None:
    diagnosis = load_run(make_run(tmp_path / "RUN", without=NO_TRACES)).diagnosis
    assert diagnosis is not None
    drawing = regimes_drawing(diagnosis)
    assert drawing is not None
    title = drawing.title.replace("\u00a0", " ")
    assert title == "70 % of the gap lies in 20 % of the time: velocity between \u22122 and 2 deg/s"
    figure = Figure()
    drawing.draw(figure, False)
    widths = [bar.get_width() for bar in figure.axes[0].patches]
    assert widths == pytest.approx([70.0, 20.0, 61.0, 35.0])
    names = [text.get_text().replace("\u00a0", " ") for text in figure.axes[0].get_yticklabels()]
    assert names == ["velocity\n\u22122 to 2 deg/s", "valve ratio 1\n0 to 0.43"]


def test_the_missing_force_is_shown_against_its_main_signal(tmp_path: Path) -> None:
    """Between the two signs of a force of 0.42 N with a noise of 0.15 N lies 0.42^2/(0.42^2 +
    0.15^2) = 89 % of its variance, less 7 % of it where the part around standstill holds both
    signs."""
    run = load_run(make_run(tmp_path / "RUN", "unknown-effect", without=NO_TRACES))
    drawing = missing_drawing(run)
    assert drawing is not None
    title = drawing.title.replace("\u00a0", " ")
    share = re.fullmatch(
        r"Velocity alone accounts for (\d+) % of what is missing at the joint port", title
    )
    assert share is not None and int(share[1]) == pytest.approx(82, abs=5)
    figure = Figure()
    drawing.draw(figure, False)
    axes = figure.axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("velocity [deg/s]", "missing [N]")
    middles = axes.get_lines()[1]
    assert all(y * x < 0.0 for x, y in zip(*middles.get_data(), strict=True) if abs(x) > 5.0)


def test_strain_bounds_and_disagreement_are_said(tmp_path: Path) -> None:
    network = network_json()
    network["mae"]["angle_deg"]["refitted"] = 0.6
    text = text_of(make_run(tmp_path / "RUN", network=network))
    assert "weak, may be absorbing structure" in text
    assert "silent, at its lower bound" in text
    assert text.count("may be absorbing structure") == 1
    assert "network.json scored the refitted model on other windows: angle 0.6 deg." in text


def test_an_unfinished_run_and_a_failed_fit_say_so(tmp_path: Path) -> None:
    run, fit = (
        {**run_json(), "ended": None},
        {**fit_json(), "converged": False, "why": "it wandered off"},
    )
    text = text_of(make_run(tmp_path / "RUN", run=run, fit=fit))
    assert "This command did not end: pamid diagnose rec.csv" in text
    assert "The fit did not converge: it wandered off." in text


def test_a_network_that_did_not_converge_is_no_warning_above_the_verdict(tmp_path: Path) -> None:
    network = network_json()
    network["training"] |= {"converged": False, "why": "100 iterations are done"}
    page = text_of(make_run(tmp_path / "RUN", network=network))
    assert page.count("100 iterations are done") == 1
    assert "how training ended: 100 iterations are done" in page
    assert "Trained on measured angle_deg - the refitted model on recorded commands." in page


def test_a_cause_whose_refit_did_not_converge_is_said(tmp_path: Path) -> None:
    diagnosis = diagnosis_json("explained")
    diagnosis["ranking"][0] |= {"converged": False, "why": "out of iterations"}
    text = text_of(make_run(tmp_path / "RUN", diagnosis=diagnosis))
    assert "The refit with Coulomb friction did not converge: out of iterations." in text


def test_a_row_of_the_ranking_says_what_it_shows_where_a_pointer_rests(tmp_path: Path) -> None:
    run = load_run(make_run(tmp_path / "RUN", "explained"))
    assert run.diagnosis is not None
    drawing = ranking_drawing(run.diagnosis)
    assert drawing is not None
    picture = render(drawing)
    told = "<title>Bouc-Wen hysteresis removes 41\u00a0% of the held-out error over all channels"
    assert told in picture.wide and told in picture.narrow


def test_a_log_that_is_a_row_off_comes_before_an_experiment(tmp_path: Path) -> None:
    note = f"dead-time@ammeter comes to 1.01 sampling periods: {OF_THE_LOG}. Shift that column."
    told = diagnosis_json("explained")
    plain = make_run(tmp_path / "A", diagnosis=told)
    noted = make_run(tmp_path / "B", diagnosis=told | {"notes": [note]})
    assert "Run the experiment" in todo_of(load_run(plain))
    assert todo_of(load_run(noted)).startswith("Set the order of the log's rows right")


def test_a_control_loop_is_shown_where_one_was_closed(tmp_path: Path) -> None:
    heading = "In its own control loop"
    assert heading in text_of(make_run(tmp_path / "CLOSED"))
    open_loop = make_run(tmp_path / "OPEN", fit=fit_json() | {"closed_loop": {}})
    assert heading not in text_of(open_loop)
