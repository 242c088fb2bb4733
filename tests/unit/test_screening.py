"""Successive halving of candidates: which take further steps, and what they promise."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_cart import cart_evidence, record_cart

from pamid.diagnosis import input_response
from pamid.diagnosis.candidate_model import candidate_from
from pamid.diagnosis.screening import (
    ScreenedCandidate,
    ScreeningBaseline,
    advancing,
    promising,
    screen,
)
from pamid.diagnosis.settings import DEFAULT
from pamid.diagnosis.starting_hints import gather_hints
from pamid.estimation.grey_box import fit_model
from pamid.model.attachment import additions_of, attachments
from pamid.model.registry import effects


def candidate(name: str, gain: float, promised: float | None = None) -> Any:
    """A screened candidate; promised: the gain that a rival start expects."""
    a: Any = SimpleNamespace(label=name)
    rival = None if promised is None else ScreenedCandidate(a, None, {}, 0.0, promised=promised)
    assembly: Any = SimpleNamespace()
    return ScreenedCandidate(a, assembly, {}, gain, rival=rival)


def reference(attached: tuple[str, ...] = ()) -> Any:
    return SimpleNamespace(settings=DEFAULT, baseline=SimpleNamespace(attached=attached))


def names(screened: list[ScreenedCandidate]) -> list[str]:
    return [s.added.label for s in screened]


def test_twice_as_many_leaders_and_every_family_go_on():
    leading = [candidate(f"a{i:02d}", 100.0 - i) for i in range(2 * DEFAULT.refits)]
    others = [candidate("b0", -10.0), candidate("b1", -11.0)]
    family_of = {s.added.label: s.added.label[0] for s in (*leading, *others)}
    further = advancing(family_of, [*leading, *others], reference())
    assert names(further) == [*names(leading), "b0"]
    assert len(advancing(family_of, leading, reference(("a",)))) == 2 * DEFAULT.refits_further
    assert names(promising(family_of, leading, reference())) == names(leading[: DEFAULT.refits])


@pytest.fixture(scope="module")
def cart(tmp_path_factory) -> Any:
    data = cart_evidence(record_cart(tmp_path_factory.mktemp("cart")))
    return data, fit_model(data)


def test_no_candidate_is_screened_below_the_baseline(cart):
    """Every candidate that can be absent contains the baseline, so that none loses against it more
    than its prior costs."""
    data, model = cart
    base = candidate_from(model.assembly, model.fit, model.held_out)
    reference, hints = ScreeningBaseline.of(base), gather_hints(data, base)
    losses = {}
    for added in additions_of(data.rig, attachments(data.rig, effects().values())):
        tried = screen(data, reference, added, model.assembly.sizes, hints)
        bounds = [b for b in tried.assembly.parameters if b.owner in added.labels]
        absent = [b for b in bounds if b.null is not None]
        if absent:
            prior = sum(((b.null - b.value) / b.spread) ** 2 for b in absent)
            losses[added.label] = (-tried.gain - prior) / reference.cost
    assert len(losses) > 10 and max(losses.values()) < 1e-3, losses


def test_windows_are_replayed_only_where_free_runs_leave_it_open(cart, monkeypatch):
    _, model = cart
    base = candidate_from(model.assembly, model.fit, model.held_out)
    budget: Any = SimpleNamespace(settings=DEFAULT, model=SimpleNamespace(evidence=cart[0]))
    replays: list[int] = []

    def counted(*_):
        replays.append(1)
        return base.replays

    monkeypatch.setattr(input_response, "_replays", counted)
    rows = 2 + len(input_response.INPUT_SHIFTS)
    for free, expected in ((0.1, 0), (0.9, len(input_response.INPUT_SHIFTS))):
        replays.clear()
        errors = np.ones((rows, len(cart[0].channels)))
        errors[0] = free
        monkeypatch.setattr(input_response, "_free_run_errors", lambda *_, e=errors: e)
        input_response._responding(budget, base, base.replays, 0)
        assert len(replays) == expected
