"""Starting hints: effects that act beyond a limit begin within the range that recordings reach."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_cart import cart_evidence, record_cart
from virtual_joint import record

from pamid.diagnosis.candidate_model import candidate_from
from pamid.diagnosis.screening import ScreeningBaseline, screen, starting_points
from pamid.diagnosis.starting_hints import GapHints, _scale, gather_hints, spectrum_peaks
from pamid.estimation.grey_box import fit_model, model_with
from pamid.model.attachment import Addition, attach
from pamid.model.effect import Hints
from pamid.model.registry import effects, rig_named
from pamid.recording.recording import read_recording, write_recording
from pamid.simulation.data_split import split_recordings
from pamid.symbolic.expression import symbol
from pamid.symbolic.vocabulary import log


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory):  # type: ignore[no-untyped-def]
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


def test_reach_is_near_that_of_the_recording(stopped) -> None:  # type: ignore[no-untyped-def]
    """The baseline knows of no stop and runs past it, but not where a window has just begun."""
    evidence, base, _ = stopped
    hints = gather_hints(evidence, base)
    seen = max(float(np.abs(t.y[:, 0]).max()) for t in base.fit.problem.tracks)
    assert 0.9 * seen < hints.at("joint").reach["position"] < 1.5 * seen
    assert len(hints.peaks_hz) == 3 and not hints.at("nowhere").reach


def test_stops_are_found_although_the_typical_ones_lie_outside(stopped) -> None:  # type: ignore[no-untyped-def]
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
    assert found.first["end-stop:limit"] <= hints.at("joint").reach["position"]


def test_starting_points_hold_a_trace_of_the_effect(stopped) -> None:  # type: ignore[no-untyped-def]
    evidence, _, sizes = stopped
    leak = attach(evidence.rig, "leak", effects())
    points, hinted = starting_points(
        model_with(evidence, (leak,), sizes), Addition((leak,)), GapHints((), {})
    )
    assert hinted == []
    assert {} in points
    assert any(
        0.0 < p.get("leak:share", 0.0) < 0.2 * effects()["leak"].parameters[0].value for p in points
    )


def test_the_ground_is_where_the_baseline_is_worst(stopped) -> None:  # type: ignore[no-untyped-def]
    _, base, _ = stopped
    ground, problem = ScreeningBaseline.of(base), base.fit.problem
    track, left = problem.tracks[0], (base.fit.residuals[0] * base.fit.weights.root) ** 2
    windows = problem.windows(track)
    (start, stop), losses = ground.spans[0], [left[w.start : w.stop].sum() for w in windows]
    count = sum(start <= w.start and w.stop <= stop for w in windows)
    assert count < len(windows)
    runs = [sum(losses[i : i + count]) for i in range(len(windows) - count + 1)]
    assert left[start:stop].sum() == pytest.approx(max(runs))


@pytest.mark.parametrize("samples", [120, 126, 1000])
def test_a_line_is_found_in_however_short_a_part(samples: int) -> None:
    """The shortest recording that can be fitted has 120 samples held out."""

    class Track:
        period_s, timescale_s = 0.01, 0.6

        def __len__(self) -> int:
            return samples

    hz, track = 6.0, Track()
    residual = np.sin(2.0 * np.pi * hz * track.period_s * np.arange(samples))[:, None]
    replayed: Any = SimpleNamespace(track=track, residual=residual)
    assert spectrum_peaks([replayed], np.ones(1))[0] == pytest.approx(hz, abs=0.5)


@pytest.mark.parametrize("hz", [2.9471, 3.0, 3.0123])
def test_a_line_between_two_points_of_the_spectrum(hz: float) -> None:
    """Resolved to a hundredth of 1/duration: pulses over 120 periods stay in step."""
    t = 0.01 * np.arange(4000)

    class Track(list[float]):
        period_s, timescale_s = 0.01, 0.6

    replay: Any = SimpleNamespace(
        residual=np.sin(2.0 * np.pi * hz * t + 0.7)[:, None], track=Track(t.tolist())
    )
    assert spectrum_peaks([replay], np.ones(1))[0] == pytest.approx(hz, abs=0.01 / 40.0)


def test_a_reading_that_rests_on_plateaus_tells_its_step(tmp_path: Path) -> None:
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
    assert not hints.at("force").plateaus
    ((spacing, level),) = hints.at("sensor").plateaus
    assert spacing == pytest.approx(step, rel=0.01)
    assert abs(level / step - round(level / step)) < 0.05, "zero is one of its levels"
    found = effects()["quantisation"]().starts(hints.at("sensor"))
    assert found == [{"quantum": spacing, "level": level}]


def test_an_output_tells_the_zero_and_the_slope_of_its_reading() -> None:
    """Kelvin above the room's temperature, of which the rig adds the latter."""
    reading, other = symbol("state", "above"), symbol("input", "room")
    assert _scale(293.15 + 2.0 * reading, reading) == pytest.approx((293.15, 2.0))
    assert _scale(reading, reading) == (0.0, 1.0)
    assert _scale(reading + other, reading) is None
    assert _scale(reading * reading, reading) is None
    assert _scale(3.0 + 0.0 * reading, reading) is None
    assert _scale(1.0 / reading, reading) is None, "not defined at zero"
    assert _scale(log(reading), reading) is None


def test_a_pattern_is_looked_for_where_the_machine_was(tmp_path: Path) -> None:
    """A cart that snaps from magnet to magnet: the model without them strays by a period, and over
    its own way other lines are stronger."""
    recording = record_cart(tmp_path, planted=("cogging:sine_force_n=4,period_m=0.1",))
    evidence = cart_evidence(recording)
    model = fit_model(evidence)
    base = candidate_from(model.assembly, model.fit, model.held_out)
    strays = float(np.abs(np.concatenate(base.fit.residuals)).max())
    assert strays > 0.1
    assert gather_hints(evidence, base).at("force").periods[0] == pytest.approx(0.1, rel=0.02)


def test_pulses_begin_with_the_lines_of_the_gap_that_may_be_theirs() -> None:
    """Of a heater sampled every 10 s, pulses of 126 s: their line, not that of a day nor one
    between samples; where the sampling is not known, none."""
    pulses = effects()["pwm-quantisation"]()
    # a spectrum without further lines fills up with zeros
    lines = (1.0 / 86400.0, 1.0 / 126.0, 1.0 / 21.0, 0.0)
    begun = pulses.starts(Hints(lines, period_s=10.0))
    assert [start["pulse_period"] for start in begun] == pytest.approx(8 * [126.0])
    assert {start["phase"] for start in begun} == {k / 8.0 for k in range(8)}
    assert all(start["ripple"] == 1.0 for start in begun)
    assert pulses.starts(Hints(lines)) == []
