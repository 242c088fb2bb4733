"""A rig with many like ports: what is looked at closely, and what is screened."""

import numpy as np
import pytest

from pamid.base.parallel.jobs import WorkerPool
from pamid.diagnosis.pipeline import candidates_to_screen
from pamid.estimation.port_evidence import (
    MANY_PORTS,
    OUTSTANDING,
    PortEvidence,
    _gains_at,
    _SmoothingWork,
)
from pamid.estimation.smoother import SmoothingResult
from pamid.model.attachment import attachments
from pamid.model.registry import effects, rig_named

ARM = rig_named("two-link")
EVERY = attachments(ARM, effects().values())


def located(gains: dict[str, float]) -> PortEvidence:
    return PortEvidence({name: gains.get(name, 0.0) for name in ARM.ports}, (), {}, {})


def test_of_many_those_where_something_is_missing():
    assert len(EVERY) > 100
    gains = {
        "joint_2": 100.0,
        "muscle_21": 90.0,
        "chain_21": 90.0,
        "pressure_21": 20.0,
        "relief_21": 20.0,
        "valve_21": 15.0,
        "pressure_sensor_21": 10.0,
    }
    kept = {a.label for a in candidates_to_screen(EVERY, ARM.ports, located(gains))}
    assert {
        "coulomb-friction@joint_2",
        "maxwell-slip-hysteresis@muscle_21",
        "maxwell-slip-hysteresis@muscle",
    } <= kept
    assert "leak@pressure_12" not in kept and len(kept) >= 30


def test_one_port_far_ahead_leaves_rivals_in_the_race():
    """A reading whose latent value explains everything is no reason to try the clock alone."""
    gains = {
        "contraction_sensor_11": 1000.0,
        "chain_11": 40.0,
        "muscle_11": 39.0,
        "pressure_11": 5.0,
        "valve_11": 5.0,
    }
    kept = {a.label for a in candidates_to_screen(EVERY, ARM.ports, located(gains))}
    assert {"clock-skew", "chain-stretch@chain_11", "leak@pressure_11"} <= kept


def _found(log_evidence: float) -> SmoothingResult:
    return SmoothingResult(log_evidence, 1.0, 1.0, np.zeros(0), (), (), True)


class Looked:
    """Stands in for a smoother: evidence with the parameters held, with them moving; counts who
    looks closely."""

    def __init__(self, rough: float, best: float, looked: list[float]) -> None:
        self.rough, self._best, self._looked = _found(rough), best, looked

    @property
    def best(self) -> SmoothingResult:
        self._looked.append(self._best)
        return _found(self._best)


def gains_beside_nothing(smoothers: dict[str, Looked]) -> dict[str, float]:
    held = {(): Looked(0.0, 0.0, [])} | {(name,): s for name, s in smoothers.items()}
    work = _SmoothingWork(None, None, True, smoothers=held)  # type: ignore[arg-type]
    return _gains_at(work, list(smoothers), WorkerPool(), {})


@pytest.mark.parametrize("count", [MANY_PORTS, MANY_PORTS + 1])
def test_many_ports_are_looked_at_roughly_first(count):
    looked, share = list[float](), 0.5 * OUTSTANDING
    smoothers = {
        f"p{k}": Looked(100.0 if k < 2 else share * 100.0, 80.0 - k, looked) for k in range(count)
    }
    found = gains_beside_nothing(smoothers)
    assert list(found) == list(smoothers) and found["p0"] == 80.0
    assert len(looked) == (count if count <= MANY_PORTS else 2)
    if count > MANY_PORTS:  # the rest keep their share of the largest
        assert found["p5"] == pytest.approx(share * 80.0)


def test_a_port_whose_parameters_run_away_keeps_its_rough_evidence():
    """Free to move, they end far below the evidence without any latent value."""
    smoothers = {f"p{k}": Looked(100.0, 80.0, []) for k in range(MANY_PORTS + 1)}
    smoothers["p3"] = Looked(90.0, -500.0, [])
    smoothers["p4"] = Looked(90.0, -5.0, [])  # taken up by the parameters
    found = gains_beside_nothing(smoothers)
    assert found["p3"] == pytest.approx(0.8 * 90.0) and found["p4"] == 0.0


def test_ports_without_rough_evidence_are_all_looked_at():
    """The coarse grid of sizes may put all of them a little below none."""
    smoothers = {f"p{k}": Looked(-5.0, 2.0, []) for k in range(MANY_PORTS + 1)}
    assert set(gains_beside_nothing(smoothers).values()) == {2.0}
