"""The refitted parameters of the answer's model, after the causes: on terminal and page, and in the
page's table."""

from typing import Any

from report_pages import flat, text_of
from synthetic_run import make_run

from pamid.base.schemas.estimates import Estimate
from pamid.report.answers import refitted_texts
from pamid.report.evidence import parameter_table, parameters_of
from pamid.report.load import load_run


def estimate(value: float, *, prior: float = 0.5, half: float = 0.01, **more: Any) -> Estimate:
    return Estimate(value=value, low=value - half, high=value + half, prior=prior, **more)


def test_of_many_parameters_only_those_that_moved_are_shown():
    same = {f"length_{i}_m": estimate(0.5, strain=0.0) for i in range(4)}
    resolved = {"inertia_kg_m2": estimate(0.502, half=1e-4, strain=0.01)}  # but no shift to act on
    weak = {"damping_n_s_per_m": estimate(0.6, half=0.2, strain=0.8)}
    moved = {
        "m1_kg": estimate(0.6, strain=1.0),
        "m2_kg": estimate(0.3, strain=-2.0, at_bound="low"),
    }
    first, second, rest = refitted_texts({**same, **resolved, **weak, **moved})
    assert flat(first) == "m2 0.5 → 0.3 kg (95 % interval 0.29 to 0.31), at its lower bound"
    assert second.startswith("m1 ") and rest == "6 others not moved materially"
    assert refitted_texts({**same, **resolved}) == ["5 parameters not moved materially"]


def test_parameters_that_the_recordings_do_not_determine_are_named():
    silent = {f"link{i}_mass_kg": estimate(0.5, word="silent", strain=0.0) for i in range(6)}
    settled = {"m1_kg": estimate(0.6, strain=1.0, word="settled")}
    (moved, rest) = refitted_texts({**settled, "m2_kg": silent["link0_mass_kg"]})
    assert flat(moved).startswith("m1 0.5 → 0.6 kg")
    assert rest == "1 other not moved materially; not determined by these recordings: m2"
    (rest,) = refitted_texts(silent)
    assert rest.endswith("link2_mass, link3_mass, 2 more")


def test_page_and_table_show_the_model_of_the_answer(tmp_path):
    folder = make_run(tmp_path / "RUN", "explained")
    page = flat(text_of(folder))
    assert "damping 0.0014 → 0.0016 m² s (95 % interval 0.0015 to 0.0017)" in page
    assert "without cause" in page
    answer, refitted = parameters_of(load_run(folder))
    assert (answer["damping_m2_s"].value, refitted["damping_m2_s"].value) == (0.0016, 0.00213)
    shown = parameter_table(answer, refitted)
    assert "Table 2 of the first paper" in str(shown), "of a diagnosis that does not state it"
    alone, compared = parameters_of(load_run(make_run(tmp_path / "NONE", "no-structural-gap")))
    assert alone["damping_m2_s"].value == 0.00213 and not compared
