"""Of long recordings evenly spread stretches are searched; short ones are used whole."""

from dataclasses import replace

import numpy as np
import pytest
from small_cart import PERIOD_S, RIG, cart_evidence, record_cart
from virtual_recordings import virtual_recording

from pamid.diagnosis.pipeline import diagnose
from pamid.diagnosis.settings import DEFAULT
from pamid.diagnosis.verdict.notes import notes_of
from pamid.model.registry import effects, rig_named
from pamid.simulation import data_split
from pamid.simulation.data_split import STRETCHES, DataSplit, Span, split_recordings

LONG_S = 40.0
LEAST = 1.2  # correlation times of a stretch, so that a small recording is a long one


@pytest.fixture(autouse=True)
def short_stretches(monkeypatch) -> None:
    monkeypatch.setattr(data_split, "LEAST_FITTED", LEAST)
    monkeypatch.setattr(data_split, "LEAST_HELD_OUT", LEAST)


@pytest.fixture(scope="module")
def whole() -> DataSplit:
    """A cart with friction whose pushes bring it back, so that it soon forgets them."""
    sizes = np.random.default_rng(3).uniform(2.0, 6.0, round(LONG_S / (80 * PERIOD_S)))
    sent = {"force_n": np.kron(sizes, np.repeat([1.0, -1.0, -1.0, 1.0], 20))}
    true = {"mass_kg": 1.2}
    made = virtual_recording(RIG, sent, PERIOD_S, "coulomb-friction", true=true)
    return split_recordings(rig_named(RIG), [made], [])


def times(evidence: DataSplit, spans: tuple[Span, ...]) -> np.ndarray:
    """Lengths of spans in correlation times."""
    return np.array(
        [(s.stop - s.start) * s.recording.sampling_period_s / evidence.timescale_s for s in spans]
    )


def test_stretches_are_bounded_and_reach_from_the_first_sample_to_the_last(whole):
    fitted, held = 4.0 * LEAST, 3.01 * LEAST
    assert times(whole, whole.fit).sum() > fitted and times(whole, whole.held_out).sum() > held
    part = whole.excerpt(fitted, held)
    for spans, of, most in ((part.fit, whole.fit, fitted), (part.held_out, whole.held_out, held)):
        assert len(spans) == STRETCHES
        assert times(whole, spans).sum() == pytest.approx(most, rel=0.02)
        assert spans[0].start == of[0].start and spans[-1].stop == of[-1].stop
        assert all(a.stop < b.start for a, b in zip(spans[:-1], spans[1:], strict=True))
    assert part.spread == [] and part.noise is whole.noise
    used_s, all_s = part.used_s
    assert used_s == pytest.approx((fitted + held) * whole.timescale_s, rel=0.02)
    assert all_s == pytest.approx(LONG_S, rel=0.01) and whole.used_s[0] == all_s


def test_what_is_short_stays_whole(whole, tmp_path):
    short = cart_evidence(record_cart(tmp_path, seconds=20.0))
    assert short.excerpt(DEFAULT.fitted_most, DEFAULT.held_out_most) == short
    # many short recordings: no stretch of them would be long enough
    (span,), count = short.fit, 200
    many = replace(short, fit=(span,) * count)
    share = 0.5 * LEAST / times(many, many.fit)[0]
    most = share * times(many, many.fit).sum()
    assert many.excerpt(most, DEFAULT.held_out_most).fit == many.fit


def test_a_diagnosis_of_stretches_finds_the_cause_and_says_what_was_used(whole):
    settings = replace(DEFAULT, fitted_most=9.0, held_out_most=6.0)
    catalogue = {name: effects()[name] for name in ("coulomb-friction", "dead-time")}
    found = diagnose(whole, catalogue, settings=settings)
    assert found.ranking[0].label == "coulomb-friction"
    used_s, all_s = found.evidence.used_s
    assert used_s < 0.5 * all_s
    assert sum(len(t) for t in found.budget.model.fit.problem.tracks) < 0.5 * 0.7 * 100.0 * all_s
    assert any(f"{used_s:.4g} s were used" in note for note in notes_of(found))
