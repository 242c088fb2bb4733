"""Short fits of a rig that is stepped: slopes serve again, and points are run before slopes."""

from dataclasses import replace

import numpy as np
import pytest
from pendulums import SteppedTwin, WrittenPendulum

from pamid.engine.sampled_inputs import SampledInputs
from pamid.intake.checks.short_fit import FitData, ShortFit, fit_data_of
from pamid.model.assembly import Assembly
from pamid.model.rig import Rig
from pamid.recording.recording import recording_of
from pamid.simulation.excitation.aprbs import aprbs

PERIOD = WrittenPendulum.period_s


def _data(rig: Rig) -> FitData:
    u = aprbs(4.0, PERIOD, 6.0, (0.1, 1.0), seed=1)[:, None]
    a = Assembly(rig)
    p = a.values()
    memory = a.program.memory(a.start(p), period_s=PERIOD)
    y, _, _ = a.program.run(memory, SampledInputs(u, PERIOD), p)
    columns = {"force_n": u[:, 0]} | dict(zip(a.program.outputs, y.T, strict=True))
    data = fit_data_of(recording_of(PERIOD * np.arange(len(u)), columns), rig)
    assert data is not None
    return data


@pytest.fixture(scope="module")
def stepped() -> FitData:
    return _data(SteppedTwin())


def test_a_point_is_differentiated_once_it_is_taken(stepped):
    for data in (stepped, _data(WrittenPendulum())):
        problem = ShortFit.of(data, data.rig)
        sheet = problem.sheet()
        moved = problem.moved(sheet, np.full(len(sheet.s) + sheet.x.size, 1e-3), False)
        assert not moved.linearised
        full = problem.linearised(moved, False)
        assert full.linearised and full.cost == pytest.approx(moved.cost, rel=1e-6)
        assert np.abs(full.g).max() > 0.0


def test_slopes_serve_other_measurements_of_the_same_inputs(stepped):
    problem = ShortFit.of(stepped, stepped.rig)
    sheet, known = problem.sheet(), problem.runner.known
    assert known is not None
    worked_out = int(known.counts[0])
    assert worked_out > 0
    other = replace(stepped, weight=0.5 * stepped.weight)
    assert problem.matches_data(other)
    again = problem.with_data(other).at(sheet.s, sheet.x)
    assert int(known.counts[0]) == worked_out
    assert np.allclose(again.errors, 0.25 * sheet.errors)
    turned = replace(stepped, track=replace(stepped.track, u=-stepped.track.u))
    assert not problem.matches_data(turned)
