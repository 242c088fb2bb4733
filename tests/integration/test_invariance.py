"""What is a matter of writing changes no diagnosis: units of time, length and force, the unit of a
column, the sign of a coordinate, the order of columns and recordings, where a recording is cut, how
fast it is sampled, a column that says nothing, which states the model is written in.

A sprung cart with dry friction of another form than the catalogue's (tests/support/one_cart.py) is
diagnosed as it is and once more.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from one_cart import FRICTION, PLAIN, SAMPLES, Written, cart, part, recorded, turned_about

from pamid.api.given import evidence_of
from pamid.diagnosis.tournament import diagnose
from pamid.diagnosis.verdict import diagnosis_file
from pamid.model.registry import effects
from pamid.recording.recording import Recording
from pamid.schemas.diagnosis_file import DiagnosisFile

#: one of every kind of size: of the value, of the position, of the velocity, of the time that the
#: recordings remember, of the sampling period
FEW = ("coulomb-friction", "quadratic-drag", "linear-stiffness", "first-order-lag", "dead-time")
#: share of the error: nothing differs but the digits that a file keeps, which a fit ends by
SAME = 0.005
#: of what is planted: how near the level of the friction comes, whatever it is fitted to
NEAR = 0.05


def diagnosed(recordings: list[Recording], written: Written = PLAIN) -> DiagnosisFile:
    """As `pamid.diagnose` does it, checks included, without what to measure next."""
    given = evidence_of(recordings, cart(written), warn=lambda _: None)
    catalogue = {name: effects()[name] for name in FEW}
    return diagnosis_file(diagnose(given.evidence, catalogue), None, 0)


@cache
def plain() -> DiagnosisFile:
    return diagnosed([recorded()])


@cache
def in_two() -> DiagnosisFile:
    return diagnosed([half(0), half(1)])


def half(k: int) -> Recording:
    middle = SAMPLES // 2
    return part(recorded(), k * middle, (k + 1) * middle, f"part-{k}")


def require_alike(one: DiagnosisFile, other: DiagnosisFile, force: float = 1.0) -> None:
    """The same family at the same port, a level near what was planted (`force`: of the other's unit
    in a newton), and a shrinkage that either interval holds: 95 % of what other windows would
    show."""
    for found, unit in ((one, 1.0), (other, force)):
        assert found.verdict == "explained", found.sentence
        (cause,) = found.causes
        assert (cause.family, cause.port, found.where.port) == ("friction", "guide", "guide")
        level = next(p.value for name, p in cause.parameters.items() if not name.startswith("give"))
        assert level == pytest.approx(unit * FRICTION, rel=NEAR)
    ((a,), (b,)) = (tuple(found.how_far.values()) for found in (one, other))
    assert a.low <= b.shrinkage <= a.high and b.low <= a.shrinkage <= b.high


def require_same(one: DiagnosisFile, other: DiagnosisFile, force: float = 1.0) -> None:
    """Beyond that: every candidate as good, every port as likely, to a hundredth of either
    interval's usual width."""
    require_alike(one, other, force)
    a, b = ({c.effect: c.shrinkage for c in found.ranking} for found in (one, other))
    assert a == pytest.approx(b, abs=SAME)
    a, b = ({p.port: p.share for p in found.where.ports} for found in (one, other))
    assert a == pytest.approx(b, abs=SAME)
    ((far, last),) = zip(one.how_far.values(), other.how_far.values(), strict=True)
    for name in ("shrinkage", "low", "high"):
        assert getattr(far, name) == pytest.approx(getattr(last, name), abs=SAME)
    ratios = [far_.mae_refitted / far_.noise_floor for far_ in (far, last)]
    assert ratios[0] == pytest.approx(ratios[1], rel=SAME)


@pytest.mark.parametrize(
    "written",
    [
        pytest.param(Written(time=200.0), id="time-x-200"),
        pytest.param(Written(time=1.0 / 200.0), id="time-over-200"),
        pytest.param(Written(length=1000.0), id="length-x-1000"),
        pytest.param(Written(force=1000.0), id="force-x-1000"),
        pytest.param(Written(place="place_mm", push="push_kn"), id="mm-and-kN"),
        pytest.param(Written(sign=-1.0), id="sign-turned"),
    ],
)
def test_no_unit_and_no_sign_is_special(written: Written) -> None:
    other = diagnosed([recorded(written)], written)
    require_same(plain(), other, written.force)


def test_a_column_that_says_nothing_changes_nothing() -> None:
    require_same(plain(), diagnosed([recorded(room=np.full(SAMPLES, 21.5))]))


def test_columns_and_recordings_come_in_any_order() -> None:
    require_same(in_two(), diagnosed([turned_about(half(1)), turned_about(half(0))]))


def test_a_recording_cut_in_two_says_the_same() -> None:
    require_alike(plain(), in_two())


def test_another_sampling_says_the_same() -> None:
    require_alike(plain(), diagnosed([recorded(every=1)]))


def test_other_states_say_the_same() -> None:
    written = replace(PLAIN, state="momentum")
    require_alike(plain(), diagnosed([recorded(written)], written))
