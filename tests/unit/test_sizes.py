"""By what amounts of effects are sized: magnitudes at the ports, and the travel of a position."""

from __future__ import annotations

import numpy as np
import pytest

from pamid.model.bound_parameter import TRAVEL, bind
from pamid.model.registry import effects
from pamid.model.rig import Port
from pamid.simulation.free_runs import sizes_of

PROBES = [("joint", "joint", "position"), ("joint", "joint", "value")]
JOINT = Port("motion", "N m", {"position": "rad", "velocity": "rad/s"})


def swing(zero: float) -> np.ndarray:
    turn = np.linspace(0.0, 40.0, 4001)
    return np.stack([zero + 0.3 * np.sin(turn), 2.0 * np.cos(turn)], axis=1)


@pytest.mark.parametrize("zero", [0.0, np.pi, -50.0])
def test_travel_is_the_same_wherever_the_position_is_counted_from(zero: float) -> None:
    sizes = sizes_of(PROBES, [swing(zero)])
    assert sizes["joint", TRAVEL] == pytest.approx(0.3, rel=0.01)
    give = next(q for q in effects()["coulomb-friction"].parameters if q.name == "give")
    bound = bind(give, "coulomb-friction", JOINT, "joint", sizes)
    assert bound.unit == "rad"
    assert bound.high == pytest.approx(0.02 * 0.3, rel=0.01)


def test_about_its_zero_travel_is_the_magnitude() -> None:
    sizes = sizes_of(PROBES, [swing(0.0)])
    assert sizes["joint", TRAVEL] == pytest.approx(sizes["joint", "position"], rel=1e-3)


def test_a_position_whose_size_is_stated_is_taken_to_travel_as_far() -> None:
    stated = Port("motion", "N m", {"position": "rad", "velocity": "rad/s"}, size={"position": 0.7})
    give = next(q for q in effects()["coulomb-friction"].parameters if q.name == "give")
    bound = bind(
        give, "coulomb-friction", stated, "joint", sizes_of(PROBES[1:], [swing(0.0)[:, 1:]])
    )
    assert bound.high == pytest.approx(0.02 * 0.7)
