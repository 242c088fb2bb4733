"""Every free form, found by scanning: complete, exact at nothing, linear in its coefficients, and
its curve is what it does."""

from types import SimpleNamespace

import numpy as np
import pytest

from pamid.base.arrays import Array
from pamid.engine.sampled_inputs import SampledInputs
from pamid.intake.checks.conformance import effect_findings
from pamid.model.assembly import Assembly
from pamid.model.attachment import attachments
from pamid.model.effect import KINDS, problems
from pamid.model.free_form import FreeFormEffect
from pamid.model.registry import all_effects, free_form_effects, rig_named, rigs
from pamid.model.rig import Port, Rig
from pamid.simulation.virtual_rig import attach_specs

LOW, HIGH = -3.0, 3.0
FORMS = list(free_form_effects().values())
each = pytest.mark.parametrize("form", FORMS, ids=lambda e: e.name)


def numbers(form: type[FreeFormEffect]) -> SimpleNamespace:
    """Coefficients of all sizes, and shapes over the range between LOW and HIGH."""
    values = {name: 0.3 - 0.07 * k for k, name in enumerate(form.coefficients())}
    return SimpleNamespace(**{"give": 0.01, "span": 3.0}, **form.placed(LOW, HIGH), **values)


@each
def test_data_sheet_is_sound(form):
    assert problems(form) == []
    assert form.__module__ == f"pamid.effects.free_forms.{form.name.replace('-', '_')}"
    assert form.along and form.shown and form.known_by
    assert set(form.look_alikes) <= set(all_effects()) - {form.name}


@each
def test_without_coefficients_there_is_nothing(form):
    for p in form.parameters:
        assert not p.fitted or p.value == p.null == 0.0 and p.low == -p.high and p.prior_spread > 0


@each
def test_it_behaves_at_a_port_of_every_kind(form):
    found = effect_findings(form, [])
    assert [f for f in found if not f.ok] == []
    assert len(found) > 1


def test_every_kind_of_port_has_one():
    """On a rig with a catalogue of its own as on any other."""
    assert {kind for form in FORMS for kind in form.kinds} == set(KINDS)
    for name in rigs():
        rig = rig_named(name)
        served = {a.ports[0] for a in attachments(rig, FORMS) if len(a.ports) == 1}
        left = {n: p for n, p in rig.ports.items() if n not in served}
        for port in left.values():  # nothing to be a function of
            assert not {"position", "velocity", "stored", "stretch"} & set(port.signals)


@each
def test_its_curve_is_linear_in_the_coefficients(form):
    p = numbers(form)
    found = form().curve(p, LOW, HIGH)
    assert found.columns.shape == (len(found.x), len(form.coefficients())) and len(found.base)
    assert np.isfinite(found.columns).all() and np.abs(found.columns).max() <= 1.0
    # no coefficient says what another says already
    assert np.linalg.matrix_rank(found.columns) == len(form.coefficients())


def straight(form: type[FreeFormEffect]) -> Rig:
    """One port through which a value passes unchanged, at signals that are imposed."""
    own = form.along in ("value", "time")

    class StraightRig(Rig):
        """Two inputs to one output."""

        inputs = {"at": "", "speed": ""}
        outputs = {"seen": ""}
        ports = {"here": Port(form.kinds[0], "", ("position", "velocity", "stored"))}
        period_s = 0.01

        def measure(self, x, u, p, port):
            value = u.at if own else 0.0 * u.at
            signals = {"position": u.at, "velocity": u.speed, "stored": u.at}
            return {"seen": port("here", value, **signals)}

    return StraightRig()


def run(form: type[FreeFormEffect], at: Array, speed: Array, period_s: float) -> Array:
    """What comes out."""
    rig = straight(form)
    ((attached, _),) = attach_specs(rig, (form.name,))
    assembly, known = Assembly(rig, (attached,)), vars(numbers(form))
    p = np.array([known[b.key.rpartition(":")[2]] for b in assembly.parameters])
    memory = assembly.program.memory(assembly.start(p), period_s=period_s)
    u = np.column_stack([at, speed])
    seen, _, bad = assembly.program.run(memory, SampledInputs(u, period_s), p)
    assert bad == -1
    return seen[:, 0]


def drawn(form: type[FreeFormEffect]) -> tuple[Array, Array]:
    """x and y of its curve."""
    p = numbers(form)
    found = form().curve(p, LOW, HIGH)
    return found.x, found.base + found.columns @ [getattr(p, n) for n in form.coefficients()]


@pytest.mark.parametrize("form", [f for f in FORMS if f.along != "time"], ids=lambda e: e.name)
def test_its_curve_is_what_it_takes_off_or_adds(form):
    """In a run on which the signal goes along the curve, the second time."""
    x, y = drawn(form)
    at = np.tile(x, 2)
    # what sticks is far beyond its presliding after every sample
    fast = form.along == "velocity"
    seen = run(form, np.cumsum(at) if fast else at, at, 0.01)[len(x) :]
    done = seen - x if form.along == "value" else seen
    moving = np.abs(x) > 1e-9 if fast else np.ones(len(x), bool)
    moving[0] = False  # the way leaps back to its beginning
    np.testing.assert_allclose(done[moving], (-y if form.subtracted else y)[moving], atol=1e-9)


def test_the_curve_of_a_lag_is_its_response_to_a_step():
    """A filter of second order takes what the first one hands on as held over a sample: late by a
    hundredth of its own time."""
    form = next(f for f in FORMS if f.along == "time")
    t, y = drawn(form)
    fine = 40  # samples between two points
    step = np.ones(1 + fine * (len(t) - 1) + 1)
    step[0] = 0.0
    seen = run(form, step, step, (t[1] - t[0]) / fine)
    np.testing.assert_allclose(seen[1::fine][1:], y[1:], atol=0.01)
