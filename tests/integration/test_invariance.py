"""What is a matter of writing changes no diagnosis: units of time, length and force, the unit of a
column, the sign of a coordinate, the order of columns and recordings, where a recording is cut,
which part of it is held out, how fast it is sampled, a column that says nothing, which states the
model is written in. The horizon of the comparison and its confidence sets are part of that.

A sprung cart with dry friction of another form than the catalogue's (tests/support/one_cart.py) is
diagnosed as it is and once more.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from effect_bench import carts, inputs_of, tanks
from one_cart import FRICTION, PLAIN, SAMPLES, Written, cart, part, recorded, turned_about

from pamid.api.given import evidence_of
from pamid.base.schemas.diagnosis_file import DiagnosisFile
from pamid.diagnosis.pipeline import diagnose
from pamid.diagnosis.verdict.verdict_figures import diagnosis_file
from pamid.model.registry import effects
from pamid.model.rig import Rig
from pamid.recording.recording import Recording, recording_of
from pamid.simulation.virtual_rig import simulate_virtual_rig

#: one of every kind of size: of the value, of the position, of the velocity, of the time that the
#: recordings remember, of the sampling period
FEW = ("coulomb-friction", "quadratic-drag", "linear-stiffness", "first-order-lag", "dead-time")
#: share of the error: nothing differs but the digits that a file keeps, which a fit ends by
SAME = 0.005
#: of what is planted: how near the level of the friction comes, whatever it is fitted to
NEAR = 0.05
FEWER = 3000  # samples of the other benches
SPECIMEN = {carts: {"mass": 1.6, "damping": 3.6}, tanks: {"fill": 0.33, "outlet": 0.14}}


def diagnosed(
    recordings: list[Recording], written: Written = PLAIN, held_out: tuple[Recording, ...] = ()
) -> DiagnosisFile:
    """As `pamid.diagnose` does it, checks included, without what to measure next."""
    given = evidence_of(recordings, cart(written), held_out, warn=lambda _: None)
    catalogue = {name: effects()[name] for name in FEW}
    return diagnosis_file(diagnose(given.evidence, catalogue))


@cache
def plain() -> DiagnosisFile:
    return diagnosed([recorded()])


@cache
def in_two() -> DiagnosisFile:
    return diagnosed([half(0), half(1)])


@cache
def elsewhere(
    bench: Callable[..., Rig], effect: str, catalogue: tuple[str, ...], time: float
) -> DiagnosisFile:
    """Of a bench with that effect, recorded once and kept in a unit of which so many make up a
    second; its rig says nothing of a sampling period."""
    rig = bench()
    stamps = rig.period_s * np.arange(FEWER)
    sent = recording_of(stamps, dict(zip(rig.inputs, inputs_of(rig, FEWER).T, strict=True)))
    made = simulate_virtual_rig(rig, sent, (effect,), {}, SPECIMEN[bench], 1.0, 4)
    kept = bench(time=time)
    del type(kept).period_s
    given = evidence_of([recording_of(time * stamps, made.columns)], kept, warn=lambda _: None)
    known = {name: effects()[name] for name in catalogue}
    return diagnosis_file(diagnose(given.evidence, known))


def piece(k: int, of: int) -> Recording:
    length = SAMPLES // of
    return part(recorded(), k * length, (k + 1) * length, f"part-{k}")


def half(k: int) -> Recording:
    return piece(k, 2)


def require_alike(one: DiagnosisFile, other: DiagnosisFile, force: float = 1.0) -> None:
    """The same family at the same port, a level near what was planted (`force`: of the other's unit
    in a newton), and shares of the error of which either forecast holds the other's."""
    for found, unit in ((one, 1.0), (other, force)):
        assert found.verdict == "explained", found.sentence
        (cause,) = found.causes
        assert (cause.family, cause.port, found.where.port) == ("friction", "guide", "guide")
        level = next(p.value for name, p in cause.parameters.items() if not name.startswith("give"))
        assert level == pytest.approx(unit * FRICTION, rel=NEAR)
    a, b = one.forecast, other.forecast
    assert a is not None and b is not None
    assert a.low <= b.share <= a.high and b.low <= a.share <= b.high


def require_same(one: DiagnosisFile, other: DiagnosisFile, written: Written = PLAIN) -> None:
    """Beyond that: every candidate as good, every port as likely, the same interval: nothing is
    drawn or dealt anew."""
    require_alike(one, other, written.force)
    require_same_figures(one, other, written.time)


def require_same_figures(one: DiagnosisFile, other: DiagnosisFile, time: float = 1.0) -> None:
    """time: of the other's unit in a second."""
    assert one.horizon_s is not None and other.horizon_s is not None
    assert other.horizon_s == pytest.approx(time * one.horizon_s)
    assert [s.reference for s in one.comparison] == [s.reference for s in other.comparison]
    for step, again in zip(one.comparison, other.comparison, strict=True):
        assert [m.effect for m in step.tied] == [m.effect for m in again.tied]
        assert step.reference_losses == pytest.approx(again.reference_losses, rel=SAME)
    a, b = ({c.effect: c.shrinkage for c in found.ranking} for found in (one, other))
    assert a == pytest.approx(b, abs=SAME)
    a, b = ({p.port: p.share for p in found.where.ports} for found in (one, other))
    assert a == pytest.approx(b, abs=SAME)
    for far, last in zip(one.how_far.values(), other.how_far.values(), strict=True):
        for name in ("shrinkage", "low", "high"):
            assert getattr(far, name) == pytest.approx(getattr(last, name), abs=SAME)
        floors = [reach.mae_refitted / reach.noise_floor for reach in (far, last)]
        assert floors[0] == pytest.approx(floors[1], rel=SAME)


@pytest.mark.parametrize(
    "written",
    [
        pytest.param(Written(time=200.0), id="time-x-200"),
        pytest.param(Written(length=1000.0), id="length-x-1000", marks=pytest.mark.slow),
        pytest.param(Written(force=1000.0), id="force-x-1000", marks=pytest.mark.slow),
        pytest.param(Written(place="place_mm", push="push_kn"), id="mm-and-kN"),
        pytest.param(Written(sign=-1.0), id="sign-turned"),
    ],
)
def test_no_unit_and_no_sign_is_special(written):
    other = diagnosed([recorded(written)], written)
    require_same(plain(), other, written)


def test_a_column_that_says_nothing_changes_nothing():
    require_same(plain(), diagnosed([recorded(room=np.full(SAMPLES, 21.5))]))


def test_columns_and_recordings_come_in_any_order():
    require_same(in_two(), diagnosed([turned_about(half(1)), turned_about(half(0))]))


def test_a_recording_cut_in_two_says_the_same():
    require_alike(plain(), in_two())


@pytest.mark.slow
def test_recordings_in_several_files_say_the_same():
    """Each file begins in a state of its own, and three tenths of each are held out."""
    require_alike(plain(), diagnosed([piece(k, 3) for k in range(3)]))


def test_either_half_may_be_held_out():
    one, other = (diagnosed([half(k)], held_out=(half(1 - k),)) for k in range(2))
    for found in (one, other):
        (cause,) = found.causes
        assert (cause.family, cause.port) == ("friction", "guide"), found.sentence
    assert [m.family for m in one.comparison[0].tied] == [
        m.family for m in other.comparison[0].tied
    ]


def test_another_sampling_says_the_same():
    require_alike(plain(), diagnosed([recorded(every=1)]))


def test_other_states_say_the_same():
    written = replace(PLAIN, state="momentum")
    require_alike(plain(), diagnosed([recorded(written)], written))


LEAKS = ("orifice-loss", "first-order-loss", "overflow")


@pytest.mark.parametrize(
    ("bench", "effect", "catalogue", "family", "time"),
    [
        pytest.param(
            tanks,
            "orifice-loss@upper_balance:loss=0.05,ambient=0",
            LEAKS,
            "leak",
            200.0,
            id="tanks",
        ),
        pytest.param(
            tanks,
            "orifice-loss@upper_balance:loss=0.05,ambient=0",
            (*LEAKS, "leak"),
            "leak",
            1.0 / 200.0,
            id="tanks-any-leak",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            carts,
            "external-vibration",
            ("external-vibration", "coulomb-friction"),
            "external-disturbance",
            200.0,
            id="vibration",
        ),
    ],
)
def test_no_pace_is_special(bench, effect, catalogue, family, time):
    """A line of a spectrum, a rate of loss: what has a time in its parameters."""
    one, other = (elsewhere(bench, effect, catalogue, unit) for unit in (1.0, time))
    for found in (one, other):
        assert [c.family for c in found.causes] == [family], found.sentence
    require_same_figures(one, other, time)


LATE_S = 0.1  # more than is first looked at where samples are 4 ms apart, less where they are 8


def late(every: int) -> DiagnosisFile:
    """Of two carts whose drive is late, one sample kept of so many; their rig says nothing of a
    sampling period, by which a dead time is sized."""
    rig = carts()
    sent = np.repeat(inputs_of(rig, FEWER // 2), 2, axis=0)
    stamps = rig.period_s * np.arange(len(sent))
    made = simulate_virtual_rig(
        rig,
        recording_of(stamps, dict(zip(rig.inputs, sent.T, strict=True))),
        (f"dead-time@amplifier:delay_s={LATE_S}",),
        {},
        SPECIMEN[carts],
        1.0,
        4,
    )
    kept = carts()
    del type(kept).period_s
    columns = {name: column[::every] for name, column in made.columns.items()}
    recordings = [recording_of(stamps[::every], columns, name="late")]
    given = evidence_of(recordings, kept, warn=lambda _: None)
    known = {name: effects()[name] for name in ("dead-time", "first-order-lag", "coulomb-friction")}
    return diagnosis_file(diagnose(given.evidence, known))


def test_a_dead_time_is_as_long_however_fast_it_is_sampled():
    """The range that is looked at first is one of samples; a fit that ends there goes on."""
    for found in (late(1), late(2)):
        assert [c.effect for c in found.causes] == ["dead-time@amplifier"], found.sentence
        delay = found.causes[0].parameters["delay_s"].value
        assert delay == pytest.approx(LATE_S, rel=NEAR)
