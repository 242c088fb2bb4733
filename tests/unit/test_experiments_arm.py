"""Experiments of a rig with several joints: what is sent, and what the virtual arm does with it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pamid_cli import frame

from pamid.base.arrays import Array
from pamid.model.registry import rig_named
from pamid.recording.recording import Recording, read_recording
from pamid.rigs.muscle_experiments import EXPERIMENTS
from pamid.simulation.excitation.aprbs import aprbs
from pamid.simulation.excitation.experiments import MENU, Bench, menu

PERIOD = 0.003


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("arm")


def done(*words: object) -> None:
    assert frame.run([*map(str, words), "--overwrite"]) == 0


def generate(path: Path, *more: str) -> None:
    done("generate-aprbs", "--rig", "two-link", *more, "--output", path)


def simulated(path: Path, *more: str) -> Recording:
    """What the virtual arm records of the excitation at `path`."""
    output = path.with_name(f"{path.stem}-recorded.csv")
    done("simulate", "--excitation", path, *more, "--output", output)
    return read_recording(output)


def noted(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.with_suffix(".json").read_text())
    return found


# ---- random steps --------------------


def test_every_joint_gets_steps_of_its_own(folder):
    path = folder / "steps.csv"
    options = ("--duration", "60", "--amplitude", "reference_2_deg=25")
    generate(path, *options, "--seed", "4")
    made, about = read_recording(path), noted(path)
    assert list(made.columns) == ["reference_1_deg", "reference_2_deg"]
    one, two = made.columns.values()
    np.testing.assert_allclose(one, aprbs(60.0, PERIOD, 20.0, seed=4), rtol=1e-8)
    assert abs(np.corrcoef(one, two)[0, 1]) < 0.3
    assert len(np.intersect1d(np.flatnonzero(np.diff(one)), np.flatnonzero(np.diff(two)))) < 3
    assert [c["range"] for c in about["columns"]] == [[-20.0, 20.0], [-25.0, 25.0]]
    assert all(c["coverage"]["visited"] > 0.9 for c in about["columns"]) and "column" not in about
    assert not path.with_suffix(".toml").exists()
    again = folder / "again.csv"
    generate(again, *options, "--seed", "5")
    assert not any(
        np.array_equal(made.columns[c], read_recording(again).columns[c]) for c in made.columns
    )


# ---- swings --------------------


def crossings_hz(angle: Array) -> float:
    """Frequency of a decaying swing from the times between its zero crossings."""
    at = np.flatnonzero(np.diff(np.sign(angle)))
    return float((len(at) - 1) / (2.0 * PERIOD * (at[-1] - at[0])))


def swing(folder: Path, *more: str) -> Recording:
    path = folder / "swing.csv"
    generate(path, "--experiment", "gravity-test", "--duration", "8", *more)
    return simulated(path, "--noise", "none")


def test_a_clamped_arm_swings_as_a_pendulum(folder):
    """Link 2 alone: f = sqrt(m g c/(I + m c^2))/2pi = 1.08 Hz, lower by its damping and for wide
    swings."""
    made = swing(folder, "--release", "0", "10", "--clamped", "1")
    assert np.ptp(made.signal("angle_1_deg")) == 0.0
    assert made.signal("angle_2_deg")[0] == pytest.approx(10.0, abs=0.01)
    plain = np.sqrt(0.70 * 9.81 * 0.13 / (0.0075 + 0.70 * 0.13**2)) / (2.0 * np.pi)
    assert crossings_hz(made.signal("angle_2_deg")[:1200]) == pytest.approx(plain, rel=0.05)
    heavier = swing(folder, "--release", "0", "10", "--clamped", "1", "--payload", "0.5")
    loaded = np.sqrt((0.70 * 0.13 + 0.5 * 0.3) * 9.81 / (0.0075 + 0.70 * 0.13**2 + 0.5 * 0.09)) / (
        2.0 * np.pi
    )
    assert crossings_hz(heavier.signal("angle_2_deg")[:1200]) == pytest.approx(loaded, rel=0.05)


# ---- the menu --------------------


def bench() -> Bench:
    rig = rig_named("two-link")
    return Bench(
        rig,
        {"reference_1_deg": (0.0, 20.0), "reference_2_deg": (5.0, 30.0)},
        PERIOD,
        tuple(q.command for q in rig.loops),
        ("external_torque_1_nm", "external_torque_2_nm"),
    )


def test_the_arm_is_offered_everything():
    assert menu(bench()) == [*EXPERIMENTS, *MENU]
    for e in (*EXPERIMENTS, *MENU):
        columns = e.signals(bench())
        assert len({len(v) for v in columns.values()}) == 1, e.name
        assert {"reference_1_deg", "reference_2_deg"} <= set(columns) or not {
            "reference_1_deg",
            "reference_2_deg",
        } & set(columns)


@pytest.mark.parametrize(
    "name", ["torque-loops-two-pressures", "quick-release", "valve-pulses", "duty-staircase"]
)
def test_joints_take_turns(name):
    e = next(e for e in EXPERIMENTS if e.name == name)
    columns = e.signals(bench())
    half = len(next(iter(columns.values()))) // 2
    kind = "external_torque_{}_nm" if e.pushed else "command_{}"
    one, two = (columns[kind.format(j)] for j in "12")
    assert one[:half].any() and not one[half:].any() and not two[:half].any()
    np.testing.assert_array_equal(one[:half], two[half:])
    assert e.minutes_on(bench()) == 2.0 * e.minutes
    if e.pushed:
        assert not any(columns[f"command_{j}"].any() for j in "12")
