"""Three views of a run: free over the whole recording, its worst window, the error over the signal
that explains it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report_pages import flat
from small_cart import cart_evidence, record_cart
from synthetic_run import make_run

from pamid.estimation.fit_files import residual_table
from pamid.estimation.grey_box import GreyBox, fit_model
from pamid.estimation.whole_runs import free_run_csv, free_runs
from pamid.report.channel_errors import errors_of, whole_recording, worst_window
from pamid.report.error_signal_figure import error_over_signal, error_signal_drawing
from pamid.report.figures import free_run_drawing
from pamid.report.load import Residual, RunData, load_run
from pamid.report.samples import FREE_RUNS, inputs_of
from pamid.report.style import render
from pamid.report.traces import traces_of
from pamid.simulation.data_split import DataSplit
from pamid.simulation.replay import Replay
from pamid.simulation.windows import Runner

MOST_BYTES = 60_000


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> GreyBox:
    return fit_model(cart_evidence(record_cart(tmp_path_factory.mktemp("cart"))))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunData:
    return load_run(make_run(tmp_path_factory.mktemp("views") / "run"))


def written(e: DataSplit, models: dict[str, tuple[Replay, ...]]) -> dict[str, np.ndarray]:
    """The columns of free-run.csv by name; blank cells are nan."""
    header, *lines = free_run_csv(e, models).decode().splitlines()
    rows = [[float(cell or "nan") for cell in line.split(",")] for line in lines]
    return dict(zip(header.split(","), np.array(rows).T, strict=True))


# ---- the free run ---------------------------------------------


def test_a_free_run_has_one_start_over_what_was_fitted_and_held_out(fitted: GreyBox) -> None:
    e, a, p, stepping = fitted.evidence, fitted.assembly, fitted.fit.p, fitted.fit.stepping
    assert len(e.fit) == len(e.held_out) == 1 and e.fit[0].stop == e.held_out[0].start
    (free,) = free_runs(e, a, p, stepping)
    assert len(free.model) == len(e.recordings[0])
    # the plain simulation from that start
    runner = Runner(a, free.track, stepping)
    values = runner.parameters(p)
    memory = runner.memory(values)
    runner.enter(memory, free.entered[0])
    whole = replace(free.windows[0], stop=len(free.model))
    assert free.model == pytest.approx(runner.run(memory, whole, values, False)[0], rel=1e-9)
    found = written(e, {"free_run": (free,), "cause_free_run": (free,)})
    assert list(found) == [
        "time_s",
        "recording",
        "position_free_run_m",
        "position_cause_free_run_m",
    ]
    assert found["position_free_run_m"] == pytest.approx(free.model[:, 0], rel=1e-8)


def test_two_recordings_are_two_free_runs_in_the_order_of_the_rows(tmp_path: Path) -> None:
    for name, seconds in (("one", 9.0), ("two", 12.0)):
        (tmp_path / name).mkdir()
        record_cart(tmp_path / name, seconds=seconds)
    one, two = (cart_evidence(tmp_path / name / "rec.csv") for name in ("one", "two"))
    both = replace(one, fit=(*two.fit, *one.fit), held_out=(*one.held_out, *two.held_out))
    g = fit_model(both)
    runs = free_runs(both, g.assembly, g.fit.p, g.fit.stepping)
    assert [len(r.model) for r in runs] == [len(r) for r in both.recordings]
    header, rows = residual_table(g)
    measured = rows[:, header.index("position_m")]
    assert np.concatenate([r.track.y[:, 0] for r in runs]) == pytest.approx(measured)
    found = written(both, {"free_run": runs})
    for key in ("time_s", "recording"):
        assert found[key] == pytest.approx(rows[:, header.index(key)])


def test_a_free_run_that_becomes_unstable_is_left_blank(fitted: GreyBox) -> None:
    (free,) = free_runs(fitted.evidence, fitted.assembly, fitted.fit.p, fitted.fit.stepping)
    lost = {"free_run": (free,), "cause_free_run": (replace(free, finite=False),)}
    found = written(fitted.evidence, lost)
    assert np.isnan(found["position_cause_free_run_m"]).all()
    assert np.isfinite(found["position_free_run_m"]).all()


def test_the_whole_recording_is_drawn_with_its_free_runs(run: RunData) -> None:
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


def test_all_samples_offer_the_free_runs_and_hide_them_at_first(run: RunData) -> None:
    section = str(traces_of(run, errors_of(run)).section)
    assert "refitted, free run" in section and "with Coulomb friction, free run" in section
    for kind in FREE_RUNS:
        plan = re.search(rf"&#34;{kind}&#34;:{{(.*?)}}", section)
        assert plan is not None and "&#34;off&#34;:true" in plan[1]
    assert run.residual is not None and inputs_of(run.residual) == ["command"]


@pytest.mark.parametrize("change", ["missing", "of other rows"])
def test_a_run_of_an_earlier_version_has_no_free_run(change: str, tmp_path: Path) -> None:
    file = make_run(tmp_path / "run") / "free-run.csv"
    if change == "missing":
        file.unlink()
    else:
        file.write_text("".join(file.read_text().splitlines(keepends=True)[:-1]))
    old = load_run(tmp_path / "run")
    assert old.residual is not None and free_run_drawing(old, old.residual, "angle_deg") is None
    assert "free run" not in str(traces_of(old, errors_of(old)).section)


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


def test_an_error_that_follows_the_velocity_is_found_to_do_so(
    moved: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    position, velocity, noise = moved
    found = error_over_signal(table(0.1 * np.sign(velocity) + noise, position, noise), "position_m")
    assert found is not None and (found.signal, found.unit) == ("velocity", "m/s")
    assert found.share > 0.9 and found.removed is not None and found.removed > 0.95
    assert found.values.size == 2000, "what was held out alone"
    assert np.corrcoef(found.values, velocity[2000:])[0, 1] > 0.99


def test_an_error_that_follows_what_was_sent_is_found_to_do_so(
    moved: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    position, _, noise = moved
    residual = table(noise, position)
    residual.columns["position_refitted_m"] -= 0.1 * residual.columns["force_n"]
    found = error_over_signal(residual, "position_m")
    assert found is not None and found.signal == "force" and found.removed is None


def test_noise_follows_no_signal(
    run: RunData, moved: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> None:
    position, _, noise = moved
    drawing = error_signal_drawing(replace(run, residual=table(noise, position)), "position_m")
    assert drawing is not None
    assert flat(drawing.title).startswith("No recorded signal alone accounts for more than ")


def test_a_signal_that_only_drifts_explains_no_error(
    run: RunData, moved: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> None:
    """A room warms up once while the error, as slow as it, happens to grow: one coincidence, though
    the samples are thousands. The same over many cycles is none."""
    position, _, noise = moved
    time = 0.01 * np.arange(position.size)
    for cycles, named in ((0.8, False), (12.0, True)):
        slow = np.sin(2.0 * np.pi * cycles * time / time[-1] * 2.0)
        residual = table(0.1 * slow + noise, position)
        room = 20.0 + slow + 0.05 * np.random.default_rng(2).normal(size=time.size)
        residual.columns["room_degc"] = room
        share = np.corrcoef(room[2000:], slow[2000:])[0, 1] ** 2
        assert share > 0.9
        drawing = error_signal_drawing(replace(run, residual=residual), "position_m")
        assert drawing is not None
        assert flat(drawing.title).startswith("Room alone accounts for ") == named
        assert ("No recorded signal" in flat(drawing.title)) != named


def test_the_picture_says_what_the_cause_removes(
    run: RunData, moved: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> None:
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


def test_without_a_scored_sample_there_is_no_picture(run: RunData) -> None:
    assert run.residual is not None
    columns = run.residual.columns | {"window": np.full(4000, -1.0)}
    unscored = replace(run, residual=Residual(columns))
    assert error_signal_drawing(unscored, "angle_deg") is None
    assert error_over_signal(run.residual, "pressure_9_kpa") is None


def test_a_split_of_stretches_is_run_over_each(fitted: GreyBox) -> None:
    e: DataSplit = fitted.evidence
    first, held = e.fit[0], e.held_out[0]
    apart = replace(e, fit=(replace(first, stop=first.stop - 50),), held_out=(held,))
    runs = free_runs(apart, fitted.assembly, fitted.fit.p, fitted.fit.stepping)
    assert [len(r.model) for r in runs] == [first.stop - 50, held.stop - held.start]
