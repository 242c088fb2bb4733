"""Three views of a run: free over the whole recording, its worst window, the error over the signal
that explains it."""

import re
from dataclasses import replace

import numpy as np
import pytest
from report_pages import flat
from synthetic_run import make_run

from pamid.report.channel_errors import whole_recording, worst_window
from pamid.report.evidence_figures import error_over_signal, error_signal_drawing
from pamid.report.figures import free_run_drawing
from pamid.report.load import Residual, RunData, load_run
from pamid.report.style import render

MOST_BYTES = 60_000


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> RunData:
    return load_run(make_run(tmp_path_factory.mktemp("views") / "run"))


# ---- the free run ---------------------------------------------


def test_the_whole_recording_is_drawn_with_its_free_runs(run):
    assert run.residual is not None
    drawing = free_run_drawing(run, run.residual, "angle_deg")
    assert drawing is not None and flat(drawing.title) == (
        "Free run over the whole recording: the angle error is 1.09 deg on average, 0.18 deg with "
        "Coulomb friction"
    )
    picture = render(drawing)
    for form in (picture.wide, picture.narrow):
        assert len(form) < MOST_BYTES and "angle [deg]" in form and "time [s]" in form
    whole, worst = (
        whole_recording(run.residual, "angle_deg", 0),
        worst_window(run.residual, "angle_deg"),
    )
    assert whole is not None and worst is not None
    assert whole.rows == slice(0, 4000) and worst.rows.stop - worst.rows.start < 1000
    assert whole.mae["free_run"] == pytest.approx(
        np.abs(
            run.residual.columns["angle_deg"] - run.residual.columns["angle_free_run_deg"]
        ).mean()
    )


# ---- the error over a signal ----------------------------------


def table(error: np.ndarray, position: np.ndarray, cause: np.ndarray | None = None) -> Residual:
    """A recording of one channel whose refitted model leaves this error."""
    rows = np.arange(error.size)
    columns = {
        "time_s": 0.01 * rows,
        "recording": 0.0 * rows,
        "part": 1.0 * (rows >= error.size // 2),
        "window": np.floor(rows / 100.0),
        "position_m": position,
        "position_refitted_m": position - error,
        "force_n": np.sin(0.37 * rows),
    }
    if cause is not None:
        columns["position_cause_m"] = position - cause
    return Residual(columns)


@pytest.fixture
def moved() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, its rate, and noise."""
    time = 0.01 * np.arange(4000)
    position = np.sin(1.3 * time) + 0.5 * np.sin(2.9 * time)
    noise = np.random.default_rng(6).normal(0.0, 0.02, time.size)
    return position, np.gradient(position, time), noise


def test_an_error_that_follows_the_velocity_is_found_to_do_so(moved):
    position, velocity, noise = moved
    found = error_over_signal(table(0.1 * np.sign(velocity) + noise, position, noise), "position_m")
    assert found is not None and (found.signal, found.unit) == ("velocity", "m/s")
    assert found.share > 0.9 and found.removed is not None and found.removed > 0.95
    assert found.values.size == 2000, "what was held out alone"
    assert np.corrcoef(found.values, velocity[2000:])[0, 1] > 0.99


def test_the_picture_says_what_the_cause_removes(run, moved):
    position, velocity, noise = moved
    residual = table(0.1 * np.sign(velocity) + noise, position, noise)
    drawing = error_signal_drawing(replace(run, residual=residual), "position_m")
    assert drawing is not None
    assert re.fullmatch(
        r"Velocity alone accounts for \d\d % of the variance of the refitted position error; "
        r"Coulomb friction removes \d\d(\.\d)? % of that part",
        flat(drawing.title),
    )
    picture = render(drawing)
    for form in (picture.wide, picture.narrow):
        assert len(form) < MOST_BYTES
        assert "velocity [m/s]" in form and "position error [m]" in form
