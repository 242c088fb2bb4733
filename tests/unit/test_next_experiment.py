"""The next experiment: found by simulation, it separates what it says, by about as much as it
says."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pamid_cli import frame
from virtual_recordings import virtual_recording

from pamid.base.arrays import Array
from pamid.base.run_folder import Run
from pamid.diagnosis.pipeline import Diagnosis, diagnose
from pamid.diagnosis.planning.experiment_ways import NEXT_FILES, Predictions, Way
from pamid.diagnosis.planning.next_experiment import (
    Proposal,
    WithheldExperiment,
    bench_of,
    next_experiment,
    pairs_to_separate,
    separations,
)
from pamid.diagnosis.verdict import diagnosis_run
from pamid.diagnosis.verdict.diagnosis_run import diagnose_into
from pamid.diagnosis.verdict.verdict_figures import diagnosis_file, with_experiment
from pamid.estimation.grey_box import fit_model
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import Recording, read_recording
from pamid.simulation.data_split import Span, split_recordings
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.excitation.experiments import (
    Experiment,
)

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
    true, path = {"mass_kg": 1.2}, folder / f"{name}.csv"
    return virtual_recording(str(rig), columns, PERIOD_S, *TRUTH, true=true, seed=seed, path=path)


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory) -> tuple[Path, Path, Recording, Diagnosis, Proposal]:
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


def test_it_separates_more_than_the_same_excitation_again(rubbing):
    _, _, _, d, p = rubbing
    assert p.experiment.separates == RIVALS
    again = Experiment(
        "aprbs", 1.0, "", lambda b: {"force_n": aprbs(20.0, PERIOD_S, 4.0, (0.1, 0.4), seed=3)}
    )
    assert p.experiment.expected_separation > 1.2 * apart(d, Way(bench_of(d.evidence), again))


def test_what_it_expects_is_what_comes(rubbing):
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
    at = [s.recording.sha256 == new.sha256 for s in evidence.fit].index(True)
    right, wrong = (
        fit_model(evidence, c.attached).fit.residuals[at] for c in pairs_to_separate(d)[0]
    )
    missed, met = (
        float(np.sqrt((left**2).mean()) / d.evidence.noise[0]) for left in (wrong, right)
    )
    assert 0.5 < np.sqrt(missed**2 - 1.0) / p.experiment.expected_separation < 2.0
    assert met < 0.2 * missed


def test_the_file_reads_back_and_simulates(rubbing, monkeypatch):
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
    files = f"--excitation {run.path(NEXT_FILES[0])} --output {folder}/simulated.csv"
    assert frame.run(f"simulate --rig {rig} {files}".split()) == 0
    assert len(read_recording(folder / "simulated.csv")) == len(back)


def test_nothing_in_question_nothing_to_do(rubbing):
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


def test_no_experiment_separates_what_the_recordings_have_separated(rubbing):
    """A rival hundreds of standard errors behind needs no further minute at the rig; the reason
    stands among the notes."""
    _, _, _, d, _ = rubbing
    explained = decided(d)
    assert pairs_to_separate(explained) == []
    withheld = next_experiment(explained)
    assert isinstance(withheld, WithheldExperiment)
    assert re.search(
        r"no other family ties with coulomb-friction \(the nearest, quadratic-drag, is \d+ "
        r"standard errors behind\), and the remainder is not a material share",
        withheld.why,
    )
    alone = next_experiment(replace(explained, ranking=d.ranking[:1]))
    assert isinstance(alone, WithheldExperiment) and "behind" not in alone.why
    assert with_experiment(diagnosis_file(explained), withheld).withheld == withheld.why
