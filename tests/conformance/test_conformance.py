"""Every effect of the catalogue, at every port it fits on every rig, found by scanning: no names in
here. A sample that meets every effect, every kind of port and every port is always run, the others
by `make slow`."""

import numpy as np
import pytest
from conformance_rules import (
    Case,
    assembled,
    at_null,
    cases,
    excitation,
    one_sided,
    own,
    plain_run,
    rig_names,
    rig_of,
    run,
    sample,
    typical,
)

from pamid.intake.checks.conformance import (
    SAME_SLOPE,
    finite_everywhere,
    follows_mean,
    null_error,
    sensitivity_error,
)
from pamid.model.assembly import Assembly
from pamid.model.attachment import Attachment, attachments
from pamid.model.effect import Hints, problems
from pamid.model.registry import effects
from pamid.model.rig import check_rig

CASES = cases()
CATALOGUE = list(effects().values())
SAMPLE = sample(CASES)


def each(cases: list[Case]) -> pytest.MarkDecorator:
    """Parametrise over cases; those that are not of the sample are slow."""
    marked = [pytest.param(c, marks=() if c in SAMPLE else pytest.mark.slow) for c in cases]
    return pytest.mark.parametrize("case", marked, ids=[str(c) for c in cases])


each_case = each(CASES)
each_effect = pytest.mark.parametrize("effect", CATALOGUE, ids=lambda e: e.name)


# ---- data sheets --------------------


@each_effect
def test_data_sheet_is_sound(effect):
    assert problems(effect) == []


@each_effect
def test_name_is_the_file_name(effect):
    assert effect.__module__ == f"pamid.effects.{effect.name.replace('-', '_')}"


@each_effect
def test_cross_references_exist(effect):
    assert set(effect.look_alikes) <= set(effects()) - {effect.name}
    assert len(set(effect.look_alikes)) == len(effect.look_alikes)
    known = {p.name for name in rig_names() for p in rig_of(name).parameters}
    assert set(effect.absorbed_by) <= known


@each_effect
def test_starts_are_admissible(effect):
    bounds = {p.name: p for p in effect.parameters}
    pace_s = 0.25
    unit = {p.name: 1.0 / pace_s if p.size == "1/timescale" else 1.0 for p in effect.parameters}
    for peaks in ((), (1e-3, 3.0, 0.7, 1e4), tuple(np.linspace(0.01, 200.0, 50))):
        for start in effect().starts(Hints(peaks, {}, (), pace_s)):
            assert start
            for k, v in start.items():
                assert bounds[k].low <= v / unit[k] <= bounds[k].high
    for start in effect().starts(Hints((3.0,), {"position": 0.5, "force": 900.0})):
        assert set(start) <= set(bounds)
    for q in effect.parameters:
        assert all(q.low <= t <= q.high for t in q.tries)


@each_effect
def test_fits_somewhere(effect):
    assert any(isinstance(c.attachment.effect, effect) for c in CASES)


@pytest.mark.parametrize("name", rig_names())
def test_rig_is_sound_and_its_background_vanishes(name):
    rig = rig_of(name)
    check_rig(rig, name)
    assert all(p.source for p in rig.parameters)
    with_background = Assembly(rig, background=True)
    y, _, bad = run(
        with_background, excitation(name), at_null(with_background, with_background.values())
    )
    assert bad == -1
    np.testing.assert_allclose(
        y, plain_run(name), rtol=0.0, atol=1e-12 * np.abs(plain_run(name)).max()
    )


@pytest.mark.parametrize("name", rig_names())
def test_excitation_moves_the_rig(name):
    """Otherwise every test below would pass on a rig at rest."""
    y = plain_run(name)
    assert np.all(np.ptp(y, axis=0) > 0.1 * np.abs(y).max(axis=0))


# ---- behaviour --------------------


@each_case
def test_it_is_sound_by_the_rules_of_check(case):
    """Exact at its null, finite within its bounds, its derivatives those of differences. What
    `pamid check` does not see is the matter of tests/unit/test_check_slopes.py and of
    tests/conformance/test_commands_catalogue.py."""
    rig, attachment = rig_of(case.rig), case.attachment
    assert null_error(rig, attachment) <= 1e-12
    assert finite_everywhere(rig, attachment) == []
    if not follows_mean(rig, attachment):  # a staircase: tests/unit/test_rounded_reading.py
        assert sensitivity_error(rig, attachment) < SAME_SLOPE


@each_case
def test_typical_size_is_seen(case):
    """An effect that changes nothing at its typical size is no effect. Force limits may lie beyond
    this motion."""
    assembly = assembled(case)
    plain = plain_run(case.rig)
    points = [assembly.values(), typical(assembly)]
    for i in own(assembly):
        for value in assembly.parameters[i].tries:
            points.append(assembly.values())
            points[-1][i] = value
    for start in case.attachment.effect.starts(Hints((3.0,), {"position": 0.2, "force": 400.0})):
        points.append(assembly.values())
        for name, value in start.items():
            points[-1][assembly.keys[f"{case.attachment.label}:{name}"]] = value
    changes = [
        np.max(np.abs(run(assembly, excitation(case.rig), p)[0] - plain) / np.ptp(plain, axis=0))
        for p in points
    ]
    if case.attachment.effect.family == "saturation" and one_sided(case):
        return  # a side that never comes cannot be cut off
    assert max(changes) > 1e-5


# ---- copies --------------------


def placed(case: Case) -> tuple[str, ...]:
    """Places of the case's port."""
    return rig_of(case.rig).ports[case.attachment.ports[0]].places


def apart(case: Case) -> bool:
    """Are the places of this rig uncoupled, so that one can be left alone?"""
    count = len(placed(case))
    return count > 0 and not rig_of(case.rig).loops and count == len(rig_of(case.rig).inputs)


@each([c for c in CASES if apart(c)])
def test_copies_share_nothing(case):
    assembly = assembled(case)
    u, p = excitation(case.rig), typical(assembly)
    y = run(assembly, u, p)[0]
    still = u.copy()
    still[:, 1] *= 0.3
    other = run(assembly, still, p)[0]
    np.testing.assert_array_equal(y[:, 0], other[:, 0])
    assert np.any(y[:, 1] != other[:, 1])


@each([c for c in CASES if placed(c) and not apart(c) and len(c.attachment.ports) == 1])
def test_one_copy_per_place(case):
    a = case.attachment
    port = a.ports[0]
    single = [
        Attachment(a.effect, a.ports, f"{a.effect.name}@{port}_{place}", place)
        for place in placed(case)
    ]
    both, singly = assembled(case), Assembly(rig_of(case.rig), tuple(single))
    p = typical(both)
    values = {both.parameters[i].key.split(":")[1]: p[i] for i in own(both)}
    q = singly.values()
    for i in own(singly):
        q[i] = values[singly.parameters[i].key.split(":")[1]]
    together, separate = (run(m, excitation(case.rig), v)[0] for m, v in ((both, p), (singly, q)))
    np.testing.assert_allclose(separate, together, rtol=0.0, atol=1e-12 * np.abs(together).max())


# ---- dry friction --------------------

FRICTION = [
    c
    for c in CASES
    if rig_of(c.rig).ports[c.attachment.ports[0]].kind == "motion"
    and apart(c)
    and c.attachment.effect.family_at("motion") == "friction"
    and any(q.size == "travel" for q in c.attachment.effect.parameters)
]


@pytest.mark.parametrize("case", FRICTION, ids=str)
def test_dry_friction_sticks(case):
    """A constant force below the level bends the contact and moves nothing; one above it does."""
    assembly = assembled(case)
    rig = assembly.rig
    # no overshoot, or it would break away
    p = assembly.values({"stiffness_n_per_m": 0.0, "viscous_n_s_per_m": 60.0})
    level = sliding_resistance(assembly, p)
    give = max(
        p[i]
        for i in own(assembly)
        if next(
            q
            for q in case.attachment.effect.parameters
            if assembly.parameters[i].key.endswith(f":{q.name}")
        ).size
        == "travel"
    )
    n = round(15.0 / rig.period_s)
    held, _, bad = run(assembly, np.full((n, 2), 0.7 * level), p)
    assert bad == -1
    x = held[round(10.0 / rig.period_s) :, 0]  # after the contact has taken up the load
    assert 0.0 < x[-1] < 2.0 * give
    assert np.ptp(x) < 1e-3 * give
    assert abs(x[-1] - x[-2]) / rig.period_s < 1e-6
    moved = run(assembly, np.full((n, 2), 4.0 * level), p)[0]
    assert moved[-1, 0] > 100.0 * give


def sliding_resistance(assembly: Assembly, p: np.ndarray) -> float:
    """Force lost to friction at speed: what is missing from the terminal speed under a strong
    push."""
    push, period = 40.0, assembly.rig.period_s
    y = run(assembly, np.full((round(8.0 / period), 2), push), p)[0][:, 0]
    speed = (y[-1] - y[-101]) / (100 * period)
    lost = push - p[assembly.index_of("viscous_n_s_per_m")] * speed
    assert 0.0 < lost < push
    return float(lost)


def test_friction_is_tested():
    named = {
        e.name
        for e in CATALOGUE
        if e.family_at("motion") == "friction" and any(q.size == "travel" for q in e.parameters)
    }
    assert named == {c.attachment.effect.name for c in FRICTION}
    assert len(attachments(rig_of(rig_names()[0]), CATALOGUE)) > 30
