"""Shares of the gap by port: what causes remove, and what remains where the evidence places it."""

from types import SimpleNamespace
from typing import Any

import pytest

from pamid.base.schemas.diagnosis_file import GapShare
from pamid.diagnosis.verdict.verdict_figures import _port_shares
from pamid.estimation.port_evidence import PortEvidence
from pamid.model.attachment import attach
from pamid.model.registry import effects, rig_named

RIG = rig_named("two-masses")


def located(**gains: float) -> PortEvidence:
    classes = tuple((name,) for name in sorted(gains, key=lambda name: -gains[name]))
    return PortEvidence(gains, classes, dict(gains), {})


def shares(removed: float, **causes: float) -> dict[str, float]:
    """causes: what each effect removes, by its label with _at_ for @."""
    answer = SimpleNamespace(
        causes=tuple(
            SimpleNamespace(
                effect=attach(RIG, label.replace("_at_", "@").replace("_", "-", 1), effects()),
                removes=GapShare(share=share, low=share, high=share),
            )
            for label, share in causes.items()
        ),
        free_forms=(),
    )
    d: Any = SimpleNamespace(
        evidence=SimpleNamespace(rig=RIG),
        answer=answer,
        cause=object() if causes else None,
        removed=GapShare(share=removed, low=removed, high=removed) if causes else None,
        located=located(carriage_1=3.0, carriage_2=1.0),
        left_at=located(carriage_1=1.0, carriage_2=1.0),
    )
    return {s.port: s.share for s in _port_shares(d)}


def test_causes_share_what_is_removed_and_the_evidence_what_remains():
    found = shares(0.8, coulomb_friction_at_carriage_1=0.6, coulomb_friction_at_carriage_2=0.2)
    assert found["carriage_1"] == pytest.approx(0.8 * 0.75 + 0.1)
    assert found["carriage_2"] == pytest.approx(0.8 * 0.25 + 0.1)
    assert sum(found.values()) == pytest.approx(1.0)


def test_without_a_cause_the_evidence_alone_counts():
    found = shares(0.0)
    assert found["carriage_1"] == found["carriage_2"] == pytest.approx(0.5)
