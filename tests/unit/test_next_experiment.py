"""The next experiment: found by simulation, it separates what it says, by about as much as it
says."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cli import frame
from pamid.base.run_folder import Run
from pamid.diagnosis.tournament import Diagnosis, diagnose
from pamid.estimation.grey_box import fit_model
from pamid.excitation.aprbs import aprbs
from pamid.excitation.experiments import (
    MENU,
    Bench,
    Experiment,
    amplitude_sweep,
    external_columns,
    menu,
    odd_multisine,
    slow_reversals,
    speed_runs,
)
from pamid.model.registry import effects, rig_named, rig_of, rigs
from pamid.model.rig import Rig
from pamid.planning import experiment_ways
from pamid.planning.experiment_ways import NEXT_FILES, Predictions, Way, ways_to_run
from pamid.planning.next_experiment import (
    Proposal,
    Proposing,
    WithheldExperiment,
    bench_of,
    models_to_keep,
    next_experiment,
    pairs_to_separate,
    separations,
)
from pamid.recording.recording import Recording, read_recording, write_recording
from pamid.rigs.muscle_experiments import EXPERIMENTS
from pamid.simulation.data_split import Span, split_recordings
from pamid.simulation.virtual_rig import simulate_virtual_rig
from pamid.verdict import diagnosis_run
from pamid.verdict.diagnosis_run import diagnose_into
from pamid.verdict.verdict_figures import diagnosis_file, with_experiment

Array = NDArray[np.float64]

PERIOD_S = 0.005
CART_FILE = str(Path(__file__).resolve().parents[2] / "data" / "rigs" / "cart.py")
CART = Path(CART_FILE).read_text()
#: the cart of the README with a cord that keeps it in place, and a ruler that is good to 1 mm
CORDED = CART.replace("force / p.mass_kg", "(force - 20.0 * x.position) / p.mass_kg").replace(
    "    states = ", '    noise = {"position_m": 1e-3}\n    states = '
)
RIVALS = ("coulomb-friction", "quadratic-drag")
TRUTH = ("coulomb-friction:force_n=0.6,give_m=0.002",)


def drawn(folder: Path, name: str, columns: dict[str, Array], rig: Path, seed: int) -> Recording:
    """The cart with friction, recorded on these columns."""
    time = PERIOD_S * np.arange(len(next(iter(columns.values()))))
    write_recording(folder / f"{name}-sent.csv", time, columns)
    made = simulate_virtual_rig(
        str(rig),
        read_recording(folder / f"{name}-sent.csv"),
        TRUTH,
        {},
        {"mass_kg": 1.2},
        1.0,
        seed,
    )
    write_recording(folder / f"{name}.csv", time, made.columns, made.meta)
    return read_recording(folder / f"{name}.csv")


@pytest.fixture(scope="module")
def rubbing(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Path, Path, Recording, Diagnosis, Proposal]:
    """A cart with dry friction, recorded with hard pushes only, and what to do next about it."""
    folder = tmp_path_factory.mktemp("cart")
    rig = folder / "cart.py"
    rig.write_text(CORDED)
    made = drawn(folder, "rec", {"force_n": aprbs(20.0, PERIOD_S, 4.0, (0.1, 0.4), seed=1)}, rig, 2)
    d = diagnose(
        split_recordings(rig_named(str(rig)), [made], []), {k: effects()[k] for k in RIVALS}
    )
    # the recording decides for friction; what follows is of rivals that are tied
    assert d.answer is not None and d.verdict == "explained"
    (cause,), drag = d.answer.causes, {c.label: c for c in d.ranking}[RIVALS[1]]
    rival = replace(cause, effect=drag.attached[0], model=drag)
    d = replace(d, answer=replace(d.answer, verdict="ambiguous", causes=(cause, rival)))
    p = next_experiment(d)
    assert isinstance(p, Proposal)
    return folder, rig, made, d, p


def apart(d: Diagnosis, way: Way) -> float:
    """Separation of the pairs in question on an experiment, re-adjusted."""
    *_, last = separations(Predictions(d.evidence), way, pairs_to_separate(d))
    return float(np.sqrt((last**2).mean()))


def test_it_separates_more_than_the_same_excitation_again(
    rubbing: tuple[Path, Path, Recording, Diagnosis, Proposal],
) -> None:
    _, _, _, d, p = rubbing
    assert p.experiment.separates == RIVALS
    again = Experiment(
        "aprbs", 1.0, "", lambda b: {"force_n": aprbs(20.0, PERIOD_S, 4.0, (0.1, 0.4), seed=3)}
    )
    assert p.experiment.expected_separation > 1.2 * apart(d, Way(bench_of(d.evidence), again))


def test_what_it_expects_is_what_comes(
    rubbing: tuple[Path, Path, Recording, Diagnosis, Proposal],
) -> None:
    """The experiment is made, with noise, and both models are fitted to both recordings: the wrong
    one misses the new one by about what was expected, the right one by a small part of that."""
    folder, rig, old, d, p = rubbing
    new = drawn(folder, "new", p.columns, rig, 7)
    whole = split_recordings(rig_named(str(rig)), [old, new], [])
    # in windows of the same length: over longer ones a wrong model goes further astray
    evidence = replace(
        whole,
        fit=tuple(Span(s.recording, 0, len(s.recording)) for s in whole.fit),
        timescale_s=d.evidence.timescale_s,
    )
    at = [s.recording is new for s in evidence.fit].index(True)
    right, wrong = (
        fit_model(evidence, c.attached).fit.residuals[at] for c in pairs_to_separate(d)[0]
    )
    missed, met = (
        float(np.sqrt((left**2).mean()) / d.evidence.noise[0]) for left in (wrong, right)
    )
    assert 0.5 < np.sqrt(missed**2 - 1.0) / p.experiment.expected_separation < 2.0
    assert met < 0.2 * missed


def test_the_bounds_only_fall(rubbing: tuple[Path, Path, Recording, Diagnosis, Proposal]) -> None:
    _, _, _, d, _ = rubbing
    bench, predictions = bench_of(d.evidence), Predictions(d.evidence)
    for e in menu(bench):
        bounds = separations(predictions, Way(bench, e), pairs_to_separate(d))
        found = [float((a**2).mean()) for a in bounds]
        assert found == sorted(found, reverse=True)


def test_no_other_entry_is_better(
    rubbing: tuple[Path, Path, Recording, Diagnosis, Proposal],
) -> None:
    """What was passed over by its bound would not have won."""
    _, _, _, d, p = rubbing
    models = models_to_keep(d, pairs_to_separate(d))
    scores, bench = dict[str, float](), bench_of(d.evidence)
    for way in ways_to_run(Predictions(d.evidence), bench, menu(bench), models):
        name = way.experiment.name
        score = apart(d, way) / np.sqrt(way.minutes)
        scores[name] = max(scores.get(name, 0.0), score)
    assert max(scores, key=lambda name: scores[name]) == p.experiment.name
    expected = p.experiment.expected_separation / np.sqrt(p.experiment.minutes)
    assert scores[p.experiment.name] == pytest.approx(expected)


def test_a_cart_is_offered_no_air(
    rubbing: tuple[Path, Path, Recording, Diagnosis, Proposal],
) -> None:
    _, _, made, d, p = rubbing
    offered = {e.name for e in menu(bench_of(d.evidence))}
    assert offered == {"odd-multisine", "slow-reversals", "constant-rate-ramps", "amplitude-sweep"}
    assert p.experiment.name in offered and set(p.columns) == {"force_n"}
    assert np.abs(p.columns["force_n"]).max() <= np.abs(made.signal("force_n")).max()


def test_the_file_reads_back_and_simulates(
    rubbing: tuple[Path, Path, Recording, Diagnosis, Proposal],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder, rig, made, d, p = rubbing
    monkeypatch.setattr(diagnosis_run, "diagnose", lambda *_, **__: d)
    run = Run.create(folder / "run", command=["test"], seed=0)
    stored = diagnose_into(
        run, split_recordings(rig_named(str(rig)), [made], []), {k: effects()[k] for k in RIVALS}
    )
    assert stored["next_experiment"] == p.experiment.as_json()
    assert stored["next_experiment"]["excitation"] == NEXT_FILES[0]
    back = read_recording(run.path(NEXT_FILES[0]))
    assert back.loop == "open" and back.sampling_period_s == PERIOD_S
    np.testing.assert_allclose(back.signal("force_n"), p.columns["force_n"], rtol=1e-8, atol=1e-12)
    assert len(back) * PERIOD_S / 60.0 == pytest.approx(p.experiment.minutes)
    assert (
        frame.run(
            [
                "simulate",
                "--rig",
                str(rig),
                "--excitation",
                str(run.path(NEXT_FILES[0])),
                "--output",
                str(folder / "simulated.csv"),
            ]
        )
        == 0
    )
    assert len(read_recording(folder / "simulated.csv")) == len(back)


def test_nothing_in_question_nothing_to_do(
    rubbing: tuple[Path, Path, Recording, Diagnosis, Proposal],
) -> None:
    _, _, _, d, _ = rubbing
    assert d.answer is not None
    quiet = replace(d.answer, verdict="no-structural-gap", causes=())
    for found in (
        replace(d, answer=None),
        replace(d, answer=quiet),
        replace(d, silent=("position_m",)),
    ):
        assert next_experiment(found) is None


def decided(d: Diagnosis) -> Diagnosis:
    """The diagnosis of the recording as it is: friction explains the gap, and no rival ties."""
    assert d.answer is not None
    return replace(d, answer=replace(d.answer, verdict="explained", causes=d.answer.causes[:1]))


def test_no_experiment_separates_what_the_recordings_have_separated(
    rubbing: tuple[Path, Path, Recording, Diagnosis, Proposal],
) -> None:
    """A rival hundreds of standard errors behind needs no further minute at the rig; the reason
    stands among the notes."""
    _, _, _, d, _ = rubbing
    explained = decided(d)
    assert pairs_to_separate(explained) == []
    withheld = next_experiment(explained)
    assert isinstance(withheld, WithheldExperiment)
    assert re.search(
        r"no other family ties with coulomb-friction \(quadratic-drag, the nearest, is \d+ "
        r"standard errors behind\), and what remains is not a material share",
        withheld.why,
    )
    alone = next_experiment(replace(explained, ranking=d.ranking[:1]))
    assert isinstance(alone, WithheldExperiment) and "behind" not in alone.why
    assert with_experiment(diagnosis_file(explained), withheld).withheld == withheld.why


def test_a_remainder_is_no_reason_to_separate_what_is_separate(
    rubbing: tuple[Path, Path, Recording, Diagnosis, Proposal],
) -> None:
    _, _, _, d, _ = rubbing
    assert d.answer is not None
    partly = replace(d.answer, verdict="partly-explained", causes=d.answer.causes[:1])
    withheld = next_experiment(replace(d, answer=replace(partly, material_rest=True)))
    assert isinstance(withheld, WithheldExperiment)
    assert withheld.why.endswith("and what remains is taken up by no candidate.")


def test_every_pair_of_a_set_is_in_question_whatever_leads_the_ranking(
    rubbing: tuple[Path, Path, Recording, Diagnosis, Proposal],
) -> None:
    """A model of the second family may lead the ranking and yet be set aside."""
    _, _, _, d, _ = rubbing
    assert d.answer is not None
    friction, drag = ({c.label: c for c in d.ranking}[name] for name in RIVALS)
    cause, *_ = d.answer.causes
    tied = replace(
        d.answer,
        verdict="ambiguous",
        causes=(cause, replace(cause, effect=drag.attached[0], model=drag)),
    )
    for ranking in ((friction, drag), (drag, friction)):
        pairs = pairs_to_separate(replace(d, answer=tied, ranking=ranking))
        assert [(one.label, other.label) for one, other in pairs] == [RIVALS]


def test_nothing_is_proposed_that_leads_away(
    rubbing: tuple[Path, Path, Recording, Diagnosis, Proposal],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where every way leads beyond what was recorded, that is said instead, in a note."""
    _, _, _, d, p = rubbing
    assert any("recorded were" in text for text in p.experiment.cautions)
    monkeypatch.setattr(experiment_ways, "WAYS", ((1000.0, 1),))
    found = next_experiment(d)
    assert isinstance(found, WithheldExperiment) and "position_m from 0 to" in found.why
    assert Proposing().restored(d, vars(found)) == found
    said = with_experiment(diagnosis_file(d), found)
    assert said.next_experiment is None and found.why in said.notes


def joint(known: dict[str, float]) -> Bench:
    return Bench(
        rig_named("one-dof"),
        {"reference_deg": (0.0, 40.0)},
        0.003,
        ("command",),
        ("external_torque_nm",),
        known,
    )


def test_the_joint_is_offered_all_but_a_swing() -> None:
    bench = joint({})
    offered = menu(bench)
    assert [e.name for e in (*EXPERIMENTS, *MENU) if e not in offered] == ["gravity-test"]
    for e in offered:
        columns = e.signals(bench)
        lengths = {len(v) for v in columns.values()}
        assert len(lengths) == 1 and 10.0 <= lengths.pop() * bench.period_s <= 30.0, e.name
        assert np.abs(columns.get("command", np.zeros(1))).max() <= 1.0
        assert np.abs(columns.get("reference_deg", np.zeros(1))).max() <= 40.0 + 1e-9
        assert np.abs(columns.get("external_torque_nm", np.zeros(1))).max() <= 10.0
        assert any(np.ptp(v) > 0.0 for v in columns.values())


MECHANICAL = re.compile(r"friction|play|compliance|inertia|load|torque|joint|speed|motion|dry")


@pytest.mark.parametrize("rig", ["thermal-block", "pump-tank", "static-map"])
def test_reasons_for_a_rig_without_moving_parts_name_none(rig: str) -> None:
    for e in MENU:
        assert not MECHANICAL.search(f"{e.name} {e.reason(rig_named(rig))}"), e.name
    moving = " ".join(e.reason(rig_named("geared-motor")) for e in MENU)
    assert "compliance" in moving and "dry friction" in moving and "play" in moving


def test_another_inertia_is_another_one() -> None:
    e = next(e for e in MENU if e.name == "aprbs-other-setting")
    assert (
        e.settings(joint({}))
        == e.settings(joint({"inertia_kg_m2": 0.014}))
        == ({"inertia_kg_m2": 0.0896},)
    )
    assert e.settings(joint({"inertia_kg_m2": 0.0896})) == ({"inertia_kg_m2": 0.014},)


def test_a_rig_says_what_can_be_changed_at_it_and_what_acts_from_outside() -> None:
    e = next(e for e in MENU if e.name == "aprbs-other-setting")

    cart: Any = type(rig_named(CART_FILE))

    def settings(rig: Rig, known: dict[str, float]) -> Any:
        return e.settings(Bench(rig, {}, 0.003, known=known))

    class Changed(cart):  # type: ignore[misc]
        changeable = {"mass_kg": 3.0}
        external = {"external_force_n": 20.0}
        inputs = {**cart.inputs, "external_force_n": "N"}

    sheet = next(p.value for p in cart.parameters if p.outside_name == "mass_kg")
    assert settings(cart(), {}) == ()
    assert settings(Changed(), {}) == ({"mass_kg": 3.0},)
    assert settings(Changed(), {"mass_kg": 3.0 * sheet}) == ({"mass_kg": sheet},)
    arm = rig_named("two-link")
    assert settings(arm, {}) == ({"payload_kg": 0.5},)
    assert settings(arm, {"payload_kg": 0.2}) == ({"payload_kg": 0.0},)
    assert external_columns(Changed()) == {"external_force_n": 20.0}
    assert set(external_columns(arm).values()) == {8.0}


def test_one_rig_of_the_catalogue_is_the_usual_one() -> None:
    assert [name for name, kind in rigs().items() if vars(kind).get("usual")] == [rig_of([])]


@pytest.mark.parametrize("shape", [odd_multisine, slow_reversals, speed_runs, amplitude_sweep])
def test_shapes_keep_the_range_at_any_pace(shape: Callable[[Array], Array]) -> None:
    for samples in (400, 5000):
        t = 15.0 / samples * np.arange(samples)
        value = shape(t)
        assert value.shape == t.shape and np.abs(value).max() <= 1.0 + 1e-12
        assert np.abs(value).max() > 0.7


def test_a_multisine_holds_odd_lines_only() -> None:
    wave = odd_multisine(0.003 * np.arange(5000))[:2500]
    power = np.abs(np.fft.rfft(wave)) ** 2
    assert power[0::2].sum() < 1e-12 * power[1::2].sum()
