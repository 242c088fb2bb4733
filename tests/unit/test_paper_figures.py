"""The figures of the papers: what their titles say is what is drawn, and each is a picture."""

import io
from typing import Any

import numpy as np
import pytest
from PIL import Image

from pamid.api.replications import joint_figures as figures
from pamid.api.replications.joint_twin import PERIOD_S
from pamid.recording.recording import Recording, recording_of
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


def test_pressures_are_those_of_the_analytic_model_in_its_loop(steps, monkeypatch):
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


def test_the_force_surface_is_the_paper_s_polynomial(monkeypatch):
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
