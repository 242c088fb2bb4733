"""Starting hints: effects that act beyond a limit begin within the range that recordings reach."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_cart import cart_evidence, record_cart
from virtual_joint import record

from pamid.diagnosis.candidate_model import candidate_from
from pamid.diagnosis.screening import ScreeningBaseline, screen
from pamid.diagnosis.starting_hints import _scale, gather_hints, spectrum_peaks
from pamid.engine.symbolic.expression import symbol
from pamid.engine.symbolic.vocabulary import log
from pamid.estimation.grey_box import fit_model
from pamid.model.attachment import Addition, attach
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import read_recording, write_recording
from pamid.simulation.data_split import split_recordings


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):  # type: ignore[no-untyped-def]
    """A joint whose end stops at 26 deg are hit; its baseline."""
    path = tmp_path_factory.mktemp("stop") / "rec.csv"
    evidence = split_recordings(
        rig_named("one-dof"),
        [record(path, 24.0, seed=3, effects=("end-stop:limit_rad=0.4538",))],
        [],
    )
    model = fit_model(evidence)
    return (
        evidence,
        candidate_from(model.assembly, model.fit, model.held_out),
        model.assembly.sizes,
    )


def test_stops_are_found_although_the_typical_ones_lie_outside(stopped):  # type: ignore[no-untyped-def]
    evidence, base, sizes = stopped
    hints, ground = gather_hints(evidence, base), ScreeningBaseline.of(base)
    stop = attach(evidence.rig, "end-stop", effects())
    made = sizes, hints
    found = screen(evidence, ground, Addition((stop,)), *made)
    rivals = [
        screen(
            evidence, ground, Addition((attach(evidence.rig, name, effects()),)), sizes, hints
        ).gain
        for name in ("coulomb-friction", "gravity", "leak")
    ]
    assert found.gain > 2.0 * max(rivals)
    assert found.first["end-stop:limit"] <= hints["joint"].reach["position"]


@pytest.mark.parametrize("samples", [120, 126, 1000])
def test_a_line_is_found_in_however_short_a_part(samples):
    """The shortest recording that can be fitted has 120 samples held out."""

    class Track:
        period_s, timescale_s = 0.01, 0.6

        def __len__(self):
            return samples

    hz, track = 6.0, Track()
    residual = np.sin(2.0 * np.pi * hz * track.period_s * np.arange(samples))[:, None]
    replayed: Any = SimpleNamespace(track=track, residual=residual)
    assert spectrum_peaks([replayed], np.ones(1))[0] == pytest.approx(hz, abs=0.5)


def test_a_reading_that_rests_on_plateaus_tells_its_step(tmp_path):
    """A converter of 16 levels before the logger: seen through the noise behind it."""
    told = read_recording(record_cart(tmp_path, planted=()))
    place, random = told.columns["position_m"], np.random.default_rng(2)
    step = float(np.ptp(place)) / 16.0
    rough = step * np.round(place / step) + 0.03 * step * random.normal(size=len(place))
    write_recording(tmp_path / "rough.csv", told.time, told.columns | {"position_m": rough})
    evidence = cart_evidence(tmp_path / "rough.csv")
    model = fit_model(evidence)
    base = candidate_from(model.assembly, model.fit, model.held_out)
    hints = gather_hints(evidence, base)
    assert not hints["force"].plateaus
    ((spacing, level),) = hints["sensor"].plateaus
    assert spacing == pytest.approx(step, rel=0.01)
    assert abs(level / step - round(level / step)) < 0.05, "zero is one of its levels"
    found = effects()["quantisation"]().starts(hints["sensor"])
    assert found == [{"quantum": spacing, "level": level}]


def test_an_output_tells_the_zero_and_the_slope_of_its_reading():
    """Kelvin above the room's temperature, of which the rig adds the latter."""
    reading, other = symbol("state", "above"), symbol("input", "room")
    assert _scale(293.15 + 2.0 * reading, reading) == pytest.approx((293.15, 2.0))
    assert _scale(reading, reading) == (0.0, 1.0)
    assert _scale(reading + other, reading) is None
    assert _scale(reading * reading, reading) is None
    assert _scale(3.0 + 0.0 * reading, reading) is None
    assert _scale(1.0 / reading, reading) is None, "not defined at zero"
    assert _scale(log(reading), reading) is None
