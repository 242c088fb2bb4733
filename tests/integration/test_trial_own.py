"""The blind trial of any rig: how its machines are drawn, what the tool is shown of them, and that
what is planted is no effect of the catalogue."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pamid_cli import frame

from pamid.api.replications.demonstration import TRUTH_FILE, write_rig_recording
from pamid.base.errors import UsageError
from pamid.base.json_file import read_json
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment, attachments
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import Recording, recording_of, write_recording
from pamid.report.trial_results import read_trial
from pamid.simulation.free_runs import free_run
from pamid.simulation.rig_data import data_of
from pamid.trial.case_machine import CaseMachine
from pamid.trial.cases import Case, cases_sha256, draw_cases
from pamid.trial.faults import NAMELESS
from pamid.trial.own_excitation import MAX_SAMPLES, made_excitation, sampled
from pamid.trial.own_forms import (
    FORM_BEND,
    FORM_SCALE,
    FORM_SETTLING,
    FORM_SKEW,
    TIMES_TYPICAL,
    in_another_form,
)
from pamid.trial.own_machine import OwnMachine, draw_specimen, machine_of

CART = str(Path(__file__).parents[2] / "data" / "rigs" / "cart.py")
STARTER = "two-masses"
RIGS = (CART, STARTER)


def short(rig: str, samples: int = 1200) -> Recording:
    """An excitation of the user's own."""
    time = 0.01 * np.arange(samples)
    sent = 2.0 * np.sign(np.sin(1.3 * time)) * np.sin(0.4 * time)
    columns = {c: sent for c in rig_named(rig).inputs}
    return recording_of(time, columns, {"recording": {"sampling_period_s": 0.01}}, name="sent")


@pytest.fixture(scope="module", params=RIGS)
def machine(request) -> OwnMachine:
    return machine_of(request.param, short(request.param))


def planted_case(machine: OwnMachine) -> Case:
    """A case with an effect of the catalogue at a motion port, and a roughness."""
    drawn = draw_cases("test", 12, 0, machine)
    return next(
        c
        for c in drawn
        if c.stratum == "single" and "@sensor" not in str(c.planted) and c.conditions.background
    )


# ---- how machines are drawn --------------------


def test_a_bare_case_leaves_the_rig_that_its_machine_is_made_of(machine):
    stated = dict(machine.rig.background)
    (bare,) = draw_cases("test", 1, 0, machine, bare=True)
    assert bare.tools_rig is not machine.rig and bare.tools_rig.background == {}
    assert machine.rig.background == stated


def test_a_case_does_not_depend_on_how_many_are_drawn(machine):
    few, many = draw_cases("test", 3, 5, machine), draw_cases("test", 40, 5, machine)
    assert [c.sha256 for c in few] == [c.sha256 for c in many[:3]]
    assert cases_sha256(many) != cases_sha256(draw_cases("test", 40, 6, machine))
    again = machine_of(CART if machine.name == "cart.py" else STARTER, machine.sent)
    assert cases_sha256(draw_cases("test", 3, 5, again)) == cases_sha256(few)
    assert {c.stratum for c in many} == {"single", "double", "no-gap", "withheld", "nameless"}


def test_labels_are_plain_and_tell_the_answer(machine):
    families = {e.name: e for e in effects().values()}
    for case in draw_cases("calibration", 30, 2, machine):
        label = json.loads(json.dumps(case.label()))
        assert "own" not in label and label["rig"] == machine.name
        assert len(label["truth"]) == len(case.planted)
        for site, truth in zip(case.planted, label["truth"], strict=True):
            name = site.partition("@")[0]
            assert truth["port"] and site.startswith(NAMELESS) == (truth["family"] == "")
            assert site.startswith(NAMELESS) or truth["exact"] == [name]
            if case.stratum == "withheld":
                assert name in case.removed
                kin = {n for n, e in families.items() if e.family == truth["family"]}
                assert kin <= set(case.removed)


def test_a_machine_is_drawn_again_from_its_seed(machine):
    case = planted_case(machine)
    one, two = (CaseMachine.of(case).run(case.planted) for _ in range(2))
    other = CaseMachine.of(replace(case, seed=case.seed + 1)).run(case.planted)
    for column in machine.rig.outputs:
        np.testing.assert_array_equal(one[column], two[column])
        assert not np.array_equal(one[column], other[column])


# ---- what the tool is shown --------------------


def test_nothing_of_the_truth_is_in_a_recording(machine, tmp_path):
    case = planted_case(machine)
    made = CaseMachine.of(case)
    given = made.recording(case.planted, tmp_path / "one.csv")
    twin = made.recording({}, tmp_path / "two.csv")
    rig = machine.rig
    assert set(given.columns) == {*rig.inputs, *rig.outputs} == set(twin.columns)
    told = (tmp_path / "one.toml").read_text()
    assert told == (tmp_path / "two.toml").read_text() and not given.known and not given.effects
    assert given.rig == (None if machine.name == "cart.py" else STARTER)
    for site in case.planted:
        for word in (site, site.partition("@")[0], "planted", "seed", "cart.py"):
            assert word not in told
    header = (tmp_path / "one.csv").read_text().splitlines()[0]
    assert header == (tmp_path / "two.csv").read_text().splitlines()[0]


def test_a_recording_does_not_name_the_file_of_the_rig_that_made_it(here, cli):
    truth = here / "cart_with_secret_friction.py"
    truth.write_text(Path(CART).read_text())
    sent = short(CART, 200)
    write_recording("sent.csv", sent.time, dict(sent.columns))
    words = ["simulate", "--excitation", "sent.csv", "--output", "rec.csv", "--rig"]
    assert (
        cli(*words, truth.name, "--effect", "coulomb-friction")["rig"] == truth.name
    )  # said to who asked
    assert "secret" not in Path("rec.toml").read_text() + Path("rec.csv").read_text()
    assert "friction" not in Path("rec.toml").read_text()


# ---- what is planted --------------------


@pytest.mark.parametrize(
    "name", [a.effect.name for a in attachments(rig_named(CART), effects().values())]
)
def test_the_other_form_vanishes_exactly_at_the_null(name):
    rig, sent = rig_named(CART), short(CART, 400)
    (a,) = (a for a in attachments(rig, effects().values()) if a.effect.name == name)
    signals = [s for port in a.ports for s in rig.ports[port].signals]
    bent = Attachment(in_another_form(type(a.effect), signals)(), a.ports, "bent")
    healthy, other = Assembly(rig), Assembly(rig, (bent,))
    u, p = data_of(healthy.rig, sent).inputs(healthy), other.values()
    for b in other.parameters:
        if b.null is not None:
            p[other.keys[b.key]] = b.null
    for word, value in (
        (FORM_BEND, 0.4),
        (FORM_SKEW, 0.1),
        (FORM_SETTLING, 0.05),
        (FORM_SCALE, 0.3),
    ):
        p[other.index_of(f"bent:{word}")] = value
    was = free_run(healthy, u, healthy.values(), 0.01).outputs
    now = free_run(other, u, p, 0.01).outputs
    np.testing.assert_allclose(now, was, rtol=0.0, atol=1e-10 * np.ptp(was))


def test_what_is_planted_is_raised_until_it_shows_and_never_lowered(machine):
    case = planted_case(machine)
    (site, sizes) = next(iter(case.planted.items()))
    drawn = draw_specimen(machine, np.random.default_rng(3), case.conditions)
    small, large = ({**sizes, TIMES_TYPICAL: times} for times in (1e-4, 2.0))
    assert drawn.settled(site, small) == pytest.approx(4e-4)  # no more than four times
    assert drawn.settled(site, large) >= 2.0
    with pytest.raises(UsageError, match="cannot be planted"):
        drawn.record({"coulomb-frction@force": sizes}, {}, 0)


# ---- what is sent --------------------


@pytest.mark.parametrize(
    "rig", [CART, STARTER, "cascaded-tanks", "servo-pendulum", "thermal-block"]
)
def test_what_is_sent_is_long_enough_and_within_the_rigs_ranges(rig):
    made = rig_named(rig)
    period, seconds, _ = sampled(made)
    columns = made_excitation(made, "open", 1.2, 4)
    again = made_excitation(made, "open", 1.2, 4)
    for name, column in columns.items():
        assert len(column) == round(seconds / period) <= MAX_SAMPLES
        low, high = made.ranges.get(name, (-np.inf, np.inf))
        assert low <= column.min() < column.max() <= high
        np.testing.assert_array_equal(column, again[name])


# ---- commands --------------------


def test_a_demo_of_any_rig_withholds_what_it_says(machine, tmp_path):
    recording = write_rig_recording(tmp_path, machine, seed=2)
    truth = read_json(tmp_path / TRUTH_FILE)
    assert truth["family"] == effects()[truth["effect"]].family_at(
        machine.rig.ports[truth["as_simulated"][0].partition(":")[0].partition("@")[2]].kind
    )
    assert truth["parameters"].keys() == truth["over_data_sheet"].keys() != set()
    told = recording.with_suffix(".toml").read_text()
    assert truth["effect"] not in told and "form_" not in json.dumps(truth)


@pytest.mark.slow
def test_a_trial_of_a_rig_file(here, capsys):
    sent = short(CART)
    write_recording("sent.csv", sent.time, dict(sent.columns))
    Path("mine.py").write_text(Path(CART).read_text())
    asked = ["trial", "--rig", "mine.py", "--excitation", "sent.csv", "--cases", "3"]
    asked += ["--output", "run", "--json"]
    assert frame.run(asked) == 0, capsys.readouterr().out
    found = json.loads(capsys.readouterr().out)
    assert (found["rig"], found["cases"], found["failures"]) == ("mine.py", 3, {})
    assert len(list(Path("run/cases").iterdir())) == 3
    trial = read_trial(Path("run/trial.json"))
    assert trial is not None and trial.content["rig"] == "mine.py"
    assert frame.run([*asked, "--resume"]) == 0
    capsys.readouterr()
    Path("mine.py").write_text(Path(CART).read_text().replace("1.0, low", "1.2, low"))
    assert frame.run([*asked, "--resume"]) == 3
    assert "contains the trial of mine.py" in json.loads(capsys.readouterr().out)["message"]


@pytest.mark.slow
def test_a_whole_demo_of_a_rig_file(tmp_path, cli):
    folder = tmp_path / "demo"
    asked = ["demo", "--rig", CART, "--seed", "1", "--jobs", "1", "--output", str(folder)]
    found = cli(*asked)
    assert found["network"] is None and found["hit"] in ("right", "among", "missed")
    assert (folder / "report.html").is_file() and "mass_kg" in found["parameters"]
