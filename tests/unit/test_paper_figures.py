"""The figures of the papers: what their titles say is what is drawn, and each is a picture."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from PIL import Image

from pamid.recording.recording import Recording, recording_of
from pamid.replications import joint_figures as figures
from pamid.replications.joint_paper import PUBLISHED_TRAINING
from pamid.replications.joint_twin import PERIOD_S
from pamid.report.arm_paper_figure import Swung, coupling_picture
from pamid.rigs.muscle import POLYNOMIAL

TIME = PERIOD_S * np.arange(1000)


def recorded(reference: np.ndarray, angle: np.ndarray) -> Recording:
    columns = {
        "reference_deg": reference,
        "command": 0.0 * reference,
        "angle_deg": angle,
        "pressure_1_kpa": 300.0 + reference,
        "pressure_2_kpa": 300.0 - reference,
    }
    return recording_of(TIME, columns, name="steps")


@pytest.fixture
def steps() -> dict[str, Recording]:
    reference = np.where(TIME > 1.0, 20.0, -20.0)
    return {case: recorded(reference, 0.9 * reference) for case in ("6.4 Jn", "Jn")}


def size_of(png: bytes) -> tuple[int, int]:
    with Image.open(io.BytesIO(png), formats=("PNG",)) as picture:
        assert np.ptp(np.asarray(picture.convert("L"))) > 100
        return picture.size


def told(monkeypatch: pytest.MonkeyPatch, name: str) -> list[tuple[Any, ...]]:
    """What a picture is asked to draw; it is drawn none the less."""
    heard: list[tuple[Any, ...]] = []
    drawn = getattr(figures, name)

    def listen(*given: Any) -> bytes:
        heard.append(given)
        return drawn(*given)  # type: ignore[no-any-return]

    monkeypatch.setattr(figures, name, listen)
    return heard


def test_responses_say_how_far_each_model_is_off(
    steps: dict[str, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    heard = told(monkeypatch, "responses_picture")
    measured = steps["Jn"].signal("angle_deg")
    models = {
        "analytic model": {"6.4 Jn": measured + 1.5, "Jn": measured - 0.25},
        "with the network": {"6.4 Jn": measured + 0.125, "Jn": None},
    }
    wide, tall = size_of(figures.responses_png(steps, models))
    assert wide > 1000 and tall > 700
    _, responses, title = heard[0]
    assert title == (
        "On the steps: analytic model off by 1.50 deg at 6.4 Jn and 0.25 deg at Jn; "
        "with the network off by 0.12 deg at 6.4 Jn"
    )
    assert [list(one.models) for one in responses] == [list(models), ["analytic model"]]


def test_pressures_are_those_of_the_analytic_model_in_its_loop(
    steps: dict[str, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    heard = told(monkeypatch, "pressures_picture")
    monkeypatch.setattr(
        figures,
        "analytic_run",
        lambda r: {name: r.signal(name) + 3.0 for name in figures.PRESSURE_COLUMNS},
    )
    size_of(figures.pressures_png(steps))
    assert heard[0][2] == (
        "The analytic model misses the two pressures by 3.0 and 3.0 kPa at 6.4 Jn, "
        "by 3.0 and 3.0 kPa at Jn"
    )


def test_the_error_signal_is_measured_less_model(monkeypatch: pytest.MonkeyPatch) -> None:
    heard = told(monkeypatch, "excitation_picture")
    reference = 40.0 * np.sin(7.0 * TIME)
    model = reference - np.cos(3.0 * TIME)
    size_of(figures.excitation_png(recorded(reference, reference), model))
    _, sent, error, closer, title = heard[0]
    assert (sent.min(), sent.max(), error.min(), error.max()) == pytest.approx((-1, 1, -1, 1))
    assert np.corrcoef(error, np.cos(3.0 * TIME))[0, 1] == pytest.approx(1.0)
    size = np.sqrt(np.mean(np.cos(3.0 * TIME) ** 2))
    assert closer[0] == 0.0
    assert title.startswith(f"3 s of steps within 40 deg leave an error of {size:.2f} deg RMS")


def test_the_training_stands_beside_the_paper_s(monkeypatch: pytest.MonkeyPatch) -> None:
    heard = told(monkeypatch, "training_picture")
    steps_ = np.arange(50.0)
    trace = {
        "iteration": steps_,
        "mse": 0.1 * np.exp(-steps_ / 9.0),
        "gradient": 1e4 * np.exp(-steps_ / 5.0),
        "mu": 0.005 * 2.0**steps_,
        "gamma": 171.0 - 60.0 * np.exp(-steps_ / 4.0),
    }
    size_of(figures.training_png(trace, PUBLISHED_TRAINING))
    assert heard[0][1] == {"mse": 0.0015, "gradient": 1.43, "mu": 5e5, "gamma": 156.0}
    assert "After 49 iterations" in heard[0][3] and "0.0015 with 156 after 5000" in heard[0][3]


def test_the_force_surface_is_the_paper_s_polynomial(monkeypatch: pytest.MonkeyPatch) -> None:
    heard = told(monkeypatch, "force_surface_picture")
    size_of(figures.force_surface_png())
    contraction, pressure, own, other, title = heard[0]
    assert own.shape == other.shape == (len(contraction), len(pressure))
    x, y = contraction[30] / 0.25, pressure[40] / 600.0
    terms = (c * x**i * y**j for i, row in enumerate(POLYNOMIAL) for j, c in enumerate(row))
    by_hand = sum(terms)
    assert own[30, 40] == pytest.approx(by_hand, rel=1e-9)
    pulls = (own > 0.0) | (other > 0.0)
    off = np.sqrt(np.mean((np.maximum(own, 0.0) - np.maximum(other, 0.0))[pulls] ** 2))
    assert f"differs from it by {off:.1f} N RMS" in title and own.min() < 0.0


def test_the_coupling_is_drawn() -> None:
    wave = np.sin(9.0 * TIME)
    swung = [Swung(f"angle {j} [deg]", TIME, wave, wave, 0.0 * wave) for j in "12"]
    picture = coupling_picture("Pulses on one joint swing the other", swung)
    assert picture.name == "coupling" and "coupling terms left out" in picture.wide
    size_of(picture.png)
