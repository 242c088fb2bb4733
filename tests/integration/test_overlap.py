"""Samples that stand in two recordings are found by content, in whatever form; repeated experiments
are not."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_cart import RIG

from pamid.base.arrays import Array
from pamid.recording.overlap import overlaps
from pamid.recording.recording import Recording, read_recording, write_recording

PERIOD = 0.003
OUTPUTS = ("angle_deg", "pressure_kpa")


def motion(count: int, experiment: int, noise: float, seed: int) -> Array:
    random, time = np.random.default_rng(experiment), PERIOD * np.arange(count)
    smooth = sum(
        a * np.sin(2.0 * np.pi * f * time + p)
        for a, f, p in random.uniform([1, 0.05, 0], [5, 2, 6], (6, 3))
    )
    return np.asarray(smooth + noise * np.random.default_rng(seed).standard_normal(count))


def made(
    folder: Path,
    name: str,
    *,
    count: int = 8000,
    experiment: int = 1,
    noise: float = 0.04,
    seed: int = 1,
    digits: int = 9,
    step: float = 0.0,
    first: int = 0,
    last: int | None = None,
    change: Callable[[dict[str, Array]], dict[str, Array]] = lambda columns: columns,
) -> Recording:
    """The experiment, its sensors' noise by seed, as written with so many digits; step: of a
    converter."""
    angle, pressure = (
        motion(count, experiment, noise, seed),
        20.0 * motion(count, experiment + 5, noise, seed + 100),
    )
    columns = {"angle_deg": angle, "pressure_kpa": pressure}
    if step:
        columns = {k: np.round(v / step) * step for k, v in columns.items()}
    columns = change({k: v[first:last] for k, v in columns.items()})
    size = len(next(iter(columns.values())))
    write_recording(folder / f"{name}.csv", PERIOD * (np.arange(size) + 7), columns, digits=digits)
    return read_recording(folder / f"{name}.csv")


def radians(columns: dict[str, Array]) -> dict[str, Array]:
    return {
        "extra": np.arange(len(columns["angle_deg"])) * 1.0,
        "angle_rad": np.radians(columns["angle_deg"]),
    }


@pytest.mark.parametrize(
    ("other", "samples"),
    [
        ({}, 8000),
        ({"digits": 5}, 8000),
        ({"digits": 3}, 8000),
        ({"first": 3000, "last": 5000}, 2000),
        ({"first": 6000, "last": 6150}, 150),
        ({"change": radians}, 8000),
        ({"change": radians, "digits": 5}, 8000),
        (
            {"change": lambda c: {"pressure_kpa": c["pressure_kpa"], "angle_deg": c["angle_deg"]}},
            8000,
        ),
    ],
    ids=[
        "copy",
        "5 digits",
        "3 digits",
        "slice",
        "short slice",
        "radians",
        "radians, 5 digits",
        "columns turned",
    ],
)
def test_a_copy_is_found_in_every_form(other, samples, tmp_path):
    first, second = made(tmp_path, "a"), made(tmp_path, "b", **other)  # type: ignore[arg-type]
    for recordings in ([first, second], [second, first]):
        (found,) = overlaps(OUTPUTS, recordings)
        assert found.samples == samples


@pytest.mark.parametrize("noise", [0.0, 0.04])
@pytest.mark.parametrize("step", [0.0, 0.2])
def test_a_stretch_shared_by_two_slices_is_found(noise, step, tmp_path):
    a = made(tmp_path, "a", noise=noise, step=step, last=5000)
    b = made(tmp_path, "b", noise=noise, step=step, first=3500)
    (found,) = overlaps(OUTPUTS, [a, b])
    assert (found.start, found.again, found.samples) == (3500, 0, 1500)
    assert not list(overlaps(OUTPUTS, [a, made(tmp_path, "c", noise=noise, step=step, first=5000)]))


@pytest.mark.parametrize("kind", [{"noise": 0.0}, {"noise": 0.0, "step": 0.2}])
def test_a_doubled_response_is_no_copy(kind, tmp_path):
    """Without noise a linear machine answers a doubled input with a scaled copy."""

    def doubled(columns):
        return {k: np.round(2.0 * v / step) * step if step else 2.0 * v for k, v in columns.items()}

    step = kind.get("step", 0.0)
    first = made(tmp_path, "a", noise=0.0, step=step)
    second = made(tmp_path, "b", noise=0.0, change=doubled)
    assert not list(overlaps(OUTPUTS, [first, second]))


@pytest.mark.parametrize(
    "kind",
    [
        {"noise": 0.04},
        {"noise": 0.04, "step": 0.2},
        {"noise": 0.004, "step": 0.2},
        {"noise": 0.04, "digits": 4},
    ],
)
def test_the_same_experiment_made_again_is_another_recording(kind, tmp_path):
    again = [made(tmp_path, f"r{seed}", seed=seed, **kind) for seed in range(4)]  # type: ignore[arg-type]
    assert not list(overlaps(OUTPUTS, again))


def cart(folder: Path, name: str, seed: int, first: int = 0, last: int | None = None) -> Path:
    random = np.random.default_rng(seed)
    push = np.repeat(random.uniform(-3.0, 3.0, 40), 30)
    speed = np.cumsum(0.01 * push)
    columns = {
        "force_n": push,
        "position_m": np.cumsum(0.01 * speed) + 1e-4 * random.standard_normal(push.size),
    }
    write_recording(
        folder / f"{name}.csv",
        0.01 * np.arange(push.size)[first:last],
        {k: v[first:last] for k, v in columns.items()},
    )
    return folder / f"{name}.csv"


@pytest.mark.parametrize("role", ["fitted twice", "held out", "held out twice"])
@pytest.mark.parametrize("command", ["fit", "diagnose"])
def test_the_commands_refuse_it_naming_both(command, role, tmp_path, cli):
    one, other, new = (
        cart(tmp_path, "one", 1),
        cart(tmp_path, "other", 1, 200),
        cart(tmp_path, "new", 2),
    )
    given = {
        "fitted twice": [one, other],
        "held out": [one, "--held-out", other],
        "held out twice": [new, "--held-out", one, "--held-out", other],
    }[role]
    output = tmp_path / "run"
    said = cli(command, *given, "--rig", RIG, "--output", output, code=4)
    assert said["code"] == "overlap" and not output.exists()
    assert "one.csv (2 .. 11.99 s)" in said["message"] and "other.csv" in said["message"]
    assert "10 s of them" in said["message"]
    assert ("what was fitted is not held out" in said["message"]) == (role == "held out")
